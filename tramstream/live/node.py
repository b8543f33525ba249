"""The one loop. Everything that runs on the vehicle is a node; a node adds work, never a loop.

The bus' and the ports' threads only append to the node's ring. One worker takes items off it,
handles them, and between items runs the timers that are due: heartbeat, ticks, flushes. What goes
wrong in a stage is published under `health/<node>/` and counted; the loop goes on.
"""

from __future__ import annotations

import os
import resource
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from google.protobuf.message import Message

from tramstream import keys
from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.events.messages import log_of, message_of
from tramstream.events.repeats import Repeats
from tramstream.keys import Key
from tramstream.live.events import FAULT, FAULTY
from tramstream.live.refusals import Refusals
from tramstream.processor import Ledger, Sample, stamp
from tramstream.proto.health_pb2 import NodeHealth, StageLedger
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.losses import LossCounter
from tramstream.transport.ring import Ring
from tramstream.transport.sources import ASK_S, Sources

RING_CAPACITY = 8192
"""Ten seconds of all keys at full live load."""
IDLE_S = 0.2
"""Longest wait of the loop: how fast it notices that it shall stop."""
HEARTBEAT_S = 1.0


class _Timer:
    def __init__(self, period_s: float, run: Callable[[], None], now_ns: int) -> None:
        self.period_ns = int(period_s * S)
        self.run = run
        self.due_ns = now_ns + self.period_ns


class Node(ABC):
    """A process on the bus: subscriptions, one loop, heartbeat, losses.

    Parameters
    ----------
    name : str
        Source of its health keys.
    vehicle : str
        Identifier in the keys.
    bus : Bus
    stop : threading.Event
        Set from outside (a signal) to end `run`.
    """

    gather_s: ClassVar[float] = 0.0
    """Let items gather for so long before the worker wakes: for nodes that nobody waits for."""

    def __init__(self, name: str, vehicle: str, bus: Bus, stop: threading.Event) -> None:
        self.name = name
        self.vehicle = vehicle
        self.bus = bus
        self.clock = bus.clock
        self.stop = stop
        self.ring: Ring[Any] = Ring(RING_CAPACITY)
        self.losses = LossCounter(name)
        self.refusals = Refusals(name)
        self.sources = Sources(lambda: bus.announced(keys.alive(vehicle, keys.ANY_SOURCE)))
        self.faults = 0
        self.troubles: list[Event] = []
        """What is wrong now; part of the heartbeat."""
        self.source = name
        """Of its events; another than `name` where a processor of that name tells some too."""
        self._repeats = Repeats()
        self._fault_text = ""
        self._sequences: dict[str, int] = {}
        self._topics: dict[str, tuple[str, str]] = {}
        self._timers: list[_Timer] = []
        self._started_s = time.monotonic()

    # What a node is made of ----------------------------------------------------------------------
    @abstractmethod
    def expressions(self) -> list[str]:
        """Key expressions to subscribe to, below `tram/<vehicle>/`."""

    @abstractmethod
    def handle(self, envelope: Envelope) -> None:
        """Work on one message from the bus; one of a second publisher has a topic of its own."""

    def handle_item(self, item: Any) -> None:
        """Work on something that this node's own threads put into the ring."""
        raise TypeError(f"{self.name} has no use for {type(item).__name__}")

    def begin(self) -> None:  # noqa: B027  most nodes have nothing to do here
        """Right before the first item: after all subscriptions are open."""

    def finish(self) -> None:  # noqa: B027
        """Right after the last item, while the bus is still open."""

    def take_leave(self) -> None:
        """Right before the end: the recorder shall have the last word of everybody."""
        self.bus.until_recorded(self.vehicle)

    def ledgers(self) -> list[Ledger]:
        """Ledgers of the stages inside."""
        return []

    def every(self, period_s: float, run: Callable[[], None]) -> None:
        """Call `run` on the worker every `period_s` of the vehicle clock."""
        self._timers.append(_Timer(period_s, run, self.clock.now_ns()))

    # The loop ------------------------------------------------------------------------------------
    def run(self) -> None:
        """Work until `stop` is set, then on what is still queued, then finish."""
        subscriptions = [
            self.bus.subscribe(keys.full(self.vehicle, expression), self._deliver)
            for expression in self.expressions()
        ]
        self.bus.announce(keys.alive(self.vehicle, self.name))
        self.every(HEARTBEAT_S, self.heartbeat)
        if subscriptions:
            self.sources.know(self.clock.now_ns())
            self.every(ASK_S, self.settle_sources)
        try:
            self.begin()
            self.heartbeat()
            while not self.stop.is_set():
                if self.gather_s:
                    self.stop.wait(min(self.gather_s, self._patience_s()))
                    self.drain()
                self._turn(0.0 if self.gather_s else self._patience_s())
            for subscription in subscriptions:
                subscription.close()
            self.drain()
            self.settle_sources(at_end=True)
        finally:
            self.finish()
            self.heartbeat()
            self.take_leave()

    def drain(self) -> None:
        """Work on what is queued."""
        while len(self.ring):
            self._turn(0.0)

    def _deliver(self, envelope: Envelope) -> None:
        self.ring.put(envelope.topic, envelope)

    def _patience_s(self) -> float:
        due_ns = min(timer.due_ns for timer in self._timers)
        wait_s = (due_ns - self.clock.now_ns()) / S / self.clock.rate
        return min(max(wait_s, 0.0), IDLE_S)

    def _turn(self, timeout_s: float) -> None:
        item = self.ring.get(timeout_s)
        if item is not None:
            try:
                if isinstance(item, Envelope):
                    self._take(item)
                else:
                    self.handle_item(item)
            except Exception as error:  # noqa: BLE001  the boundary: told in health, never hidden
                self.fault(error)
        self._run_timers()

    def _take(self, envelope: Envelope) -> None:
        """Work on a message if it is the key's publisher's; see `tramstream.transport.sources`."""
        source = self.sources.by_topic.get(envelope.topic)
        if (
            source is not None
            and source.session == envelope.session
            and not source.rivals
            and envelope.sequence
        ):
            source.last_ns = envelope.publish_ns
            self._work(envelope)
            return
        for each in self.sources.judge(envelope, self.clock.now_ns()):
            self._work(each)

    def _work(self, envelope: Envelope) -> None:
        for loss in self.losses.see(envelope, self.ring.dropped):
            self.publish(keys.LOSS.at(self.name), loss)
        self.handle(envelope)

    def settle_sources(self, at_end: bool = False) -> None:
        """Go on with messages whose publisher was in doubt."""
        if self.sources.contested:
            for envelope in self.sources.settle(self.clock.now_ns(), at_end):
                self._work(envelope)

    def _run_timers(self) -> None:
        now_ns = self.clock.now_ns()
        for timer in self._timers:
            if now_ns < timer.due_ns:
                continue
            missed = (now_ns - timer.due_ns) // timer.period_ns
            timer.due_ns += (missed + 1) * timer.period_ns
            try:
                timer.run()
            except Exception as error:  # noqa: BLE001  see above
                self.fault(error)

    # What it says --------------------------------------------------------------------------------
    def publish(self, key: Key, message: Any, stamp_ns: int = 0) -> int:
        """Number, stamp (now, if not told otherwise) and publish a message of the node's own."""
        sequence = self._sequences.get(key.path, 0) + 1
        self._sequences[key.path] = sequence
        stamp(message, stamp_ns or self.clock.now_ns(), sequence)
        return self.put(key, message, sequence)

    def send(self, sample: Sample) -> int:
        """Publish a sample that a processor emitted; return the time of publication."""
        return self.put(sample.key, sample.message, sample.sequence)

    def put(self, key: Key, message: Message, sequence: int) -> int:
        known = self._topics.get(key.path)
        if known is None:
            known = self._topics[key.path] = (key.on(self.vehicle), key.encoding)
        return self.bus.publish(known[0], message.SerializeToString(), known[1], sequence)

    def tell(self, event: Event) -> None:
        """Say what happened on `health/<node>/event`; the same again only now and then."""
        unsaid = self._repeats.take(event, self.clock.now_ns())
        if unsaid is not None:
            self._publish_event(event, unsaid)

    def _publish_event(self, event: Event, unsaid: int) -> None:
        message = message_of(event, self.source, unsaid)
        self.publish(keys.EVENT.at(self.source), message)
        self.publish(keys.LOG.at(self.source), log_of(message), message.stamp_ns)

    def fault(self, error: Exception) -> None:
        """An exception out of a stage: a bug. Publish it, count it, go on."""
        self.faults += 1
        self._fault_text = f"{type(error).__name__}: {error}"
        trace = "".join(traceback.format_exception(error)).rstrip()
        self.tell(FAULT(error=self._fault_text, trace=trace))

    def tell_refusals(self) -> None:
        """Name what was read and not used since the last time."""
        for loss in self.refusals.take_losses():
            self.publish(keys.LOSS.at(self.name), loss)

    def heartbeat(self) -> None:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        self.tell_refusals()
        now_ns = self.clock.now_ns()
        for event, more in self._repeats.overdue(now_ns):
            self._publish_event(event, more)
        troubles = [*self.troubles, *self.refusals.troubles(now_ns)]
        if self.faults and not troubles:
            troubles = [FAULTY(faults=self.faults, error=self._fault_text, node=self.source)]
        self.publish(
            keys.HEARTBEAT.at(self.name),
            NodeHealth(
                node=self.name,
                state=NodeHealth.DEGRADED if troubles else NodeHealth.OK,
                text="; ".join(map(str, troubles)),
                troubles=[message_of(event) for event in troubles],
                pid=os.getpid(),
                uptime_s=time.monotonic() - self._started_s,
                cpu_s=usage.ru_utime + usage.ru_stime,
                rss_bytes=_rss_bytes(),
                messages_lost=self.losses.total,
                faults=self.faults,
                stages=[_stage(ledger) for ledger in [self.ring.ledger(), *self.ledgers()]],
            ),
        )


def _stage(ledger: Ledger) -> StageLedger:
    return StageLedger(
        stage=ledger.stage,
        unit=ledger.unit,
        received=ledger.received,
        delivered=ledger.delivered,
        dropped=ledger.dropped,
        pending=ledger.pending,
    )


def _rss_bytes() -> int:
    with open("/proc/self/statm", "rb") as statm:
        return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
