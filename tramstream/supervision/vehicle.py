"""A vehicle's nodes as a context: supervisor, bus, and what the nodes have to say."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.config import Vehicle
from tramstream.events.kinds import Event
from tramstream.events.messages import log_of, message_of
from tramstream.keys import Key
from tramstream.machine import compilation
from tramstream.processor import stamp
from tramstream.supervision.child import Child
from tramstream.supervision.supervisor import Plan, Supervisor
from tramstream.supervision.voice import SUPERVISOR, Voice
from tramstream.transport.bus import Bus, ZenohBus

WATCH_S = 0.1
TRACE_AGAIN_S = 10.0
"""A fault that repeats is told so often."""


class Fleet:
    """The running nodes of one vehicle."""

    def __init__(
        self, bus: Bus, supervisor: Supervisor, voice: Voice, say: Callable[[str], None]
    ) -> None:
        self.bus = bus
        self._supervisor = supervisor
        self._voice = voice
        self._say = say
        self._fault_s = -TRACE_AGAIN_S

    @property
    def vehicle(self) -> Vehicle:
        return self._supervisor.plan.vehicle

    @property
    def children(self) -> list[Child]:
        return self._supervisor.children

    @property
    def took_over(self) -> bool:
        """Whether the nodes had been started by a supervisor that has vanished."""
        return self._supervisor.took_over

    @property
    def lost(self) -> int:
        """Messages that are missing in the records of this run; final when the nodes have ended."""
        return self._supervisor.lost

    @property
    def unheard(self) -> Event | None:
        """Why messages may be missing that nobody could count."""
        return self._supervisor.unheard

    def until(
        self,
        stop: threading.Event,
        duration_s: float = 0.0,
        each: Callable[[], None] | None = None,
    ) -> None:
        """Keep the nodes running until `stop` or for `duration_s` of the vehicle clock."""
        end_s = time.monotonic() + duration_s / self.bus.clock.rate if duration_s else 0.0
        self._supervisor.end_at(end_s)
        works = [self._voice.speak, self._supervisor.watch, *([each] if each is not None else [])]
        while not stop.is_set() and not 0.0 < end_s <= time.monotonic():
            for work in works:
                try:
                    work()
                except Exception as error:  # noqa: BLE001  an orderly stop alone ends a vehicle
                    self._tell_fault(error)
            stop.wait(WATCH_S)

    def _tell_fault(self, error: Exception) -> None:
        if time.monotonic() - self._fault_s >= TRACE_AGAIN_S:
            self._fault_s = time.monotonic()
            self._say("".join(traceback.format_exception(error)).rstrip())


class Teller:
    """Tells what the supervisor does: people at once, and the bus while there is one."""

    def __init__(self, vehicle: str, say: Callable[[str], None]) -> None:
        self.bus: Bus | None = None
        self._say = say
        self._event, self._log = keys.EVENT.at(SUPERVISOR), keys.LOG.at(SUPERVISOR)
        self._vehicle = vehicle
        self._sequence = 0

    def tell(self, event: Event) -> None:
        self._say(str(event))
        if self.bus is None:
            return
        self._sequence += 1
        message, stamp_ns = message_of(event, SUPERVISOR), self.bus.clock.now_ns()
        self._publish(self._event, message, stamp_ns)
        self._publish(self._log, log_of(message), stamp_ns)

    def _publish(self, key: Key, message: Any, stamp_ns: int) -> None:
        assert self.bus is not None  # asked by `tell`
        stamp(message, stamp_ns, self._sequence)
        data = message.SerializeToString()
        self.bus.publish(key.on(self._vehicle), data, key.encoding, self._sequence)


@contextmanager
def running(
    plan: Plan, say: Callable[[str], None], stop: threading.Event | None = None
) -> Iterator[Fleet]:
    """Start router and nodes, or take over those that live; end them in order at the end.

    `stop` ends the wait for the compilation too, by KeyboardInterrupt.

    Raises
    ------
    BusError
        If another vehicle, or another router, is there already.
    NodeError
        With a node's own exit status if it ends at its start.
    """

    def safe_say(text: str) -> None:
        with suppress(OSError):  # the terminal is closed; what nodes say is in the record
            say(text)

    runtime_dir = plan.vehicle.runtime_dir
    clock = VehicleClock.shared(runtime_dir, plan.rate)
    teller = Teller(plan.vehicle.vehicle, safe_say)
    supervisor = Supervisor(plan, teller.tell)
    supervisor.claim()
    bus: Bus | None = None
    voice: Voice | None = None
    try:
        if not supervisor.took_over:
            compilation.ensure(safe_say, stop=stop)
        bus = supervisor.join(lambda: ZenohBus.connect(runtime_dir, clock))
        teller.bus = bus
        voice = Voice(bus, plan.vehicle.vehicle, safe_say, supervisor)
        supervisor.start(bus, voice.speak)
        yield Fleet(bus, supervisor, voice, safe_say)
    finally:
        try:
            supervisor.stop_nodes(bus, voice.speak if voice is not None else lambda: None)
            teller.bus = None
            if bus is not None:
                bus.close()
        finally:
            supervisor.stop_router()
