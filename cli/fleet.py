"""A vehicle's nodes as a context: router, supervisor, and what its nodes have to say."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys, machine_code
from tramstream.bus import Bus, Envelope, ZenohBus
from tramstream.clock import VehicleClock
from tramstream.config import Vehicle
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.ring import Ring
from tramstream.supervisor import Child, RouterNode, Supervisor

WATCH_S = 0.1


class Fleet:
    """The running nodes of one vehicle."""

    def __init__(self, bus: Bus, supervisor: Supervisor, vehicle: Vehicle, voice: _Voice) -> None:
        self.bus = bus
        self.vehicle = vehicle
        self._supervisor = supervisor
        self._voice = voice

    @property
    def children(self) -> list[Child]:
        return self._supervisor.children

    def until(
        self,
        stop: threading.Event,
        duration_s: float = 0.0,
        each: Callable[[], None] | None = None,
    ) -> None:
        """Keep the nodes running until `stop` or for `duration_s` of the vehicle clock."""
        end_s = time.monotonic() + duration_s / self.bus.clock.rate if duration_s else float("inf")
        while not stop.is_set() and time.monotonic() < end_s:
            self._supervisor.watch()
            self._voice.speak()
            if each is not None:
                each()
            stop.wait(WATCH_S)


class _Voice:
    """Tells people what nodes log and when their state changes; each sentence once."""

    def __init__(self, bus: Bus, vehicle: str, say: Callable[[str], None]) -> None:
        self._say = say
        self._texts: dict[str, str] = {}
        self._ring: Ring[Envelope] = Ring(1000)
        self._log_type = keys.LOG.encoding
        for key in (keys.LOG, keys.HEARTBEAT):
            bus.subscribe(key.on(vehicle), lambda envelope: self._ring.put("", envelope))

    def speak(self) -> None:
        """Say what has come."""
        while (envelope := self._ring.get(0.0)) is not None:
            if envelope.encoding == self._log_type:
                self._log(Log.FromString(envelope.payload))
            else:
                self._health(NodeHealth.FromString(envelope.payload))

    def _log(self, message: Log) -> None:
        self._say(f"{message.name}: {message.message}")

    def _health(self, message: NodeHealth) -> None:
        before = self._texts.get(message.node, "")
        # A sentence that counts seconds is the same sentence.
        kind = "".join(char for char in message.text if not char.isdigit())
        self._texts[message.node] = kind
        if kind != before:
            self._say(f"{message.node}: {message.text or 'all is well again'}")


@contextmanager
def running(
    vehicle: Vehicle,
    config_path: Path,
    say: Callable[[str], None],
    separate: bool = False,
    rate: float = 1.0,
) -> Iterator[Fleet]:
    """Start router and nodes; end them in order when the block is left.

    Raises
    ------
    BusError
        If another router is there already.
    NodeError
        With a node's own exit status if it ends at its start.
    """
    machine_code.ensure(say)
    clock = VehicleClock.shared(vehicle.runtime_dir, rate)
    bus = ZenohBus.route(vehicle.runtime_dir, clock)
    end_router = threading.Event()
    router = RouterNode(vehicle.vehicle, bus, end_router)
    thread = threading.Thread(target=router.run, name="router", daemon=True)
    supervisor = Supervisor(vehicle, config_path, bus, say, separate)
    voice = _Voice(bus, vehicle.vehicle, say)
    thread.start()
    try:
        supervisor.start()
        yield Fleet(bus, supervisor, vehicle, voice)
    finally:
        supervisor.stop()
        voice.speak()
        end_router.set()
        thread.join(2.0)
        bus.close()
