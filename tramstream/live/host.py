"""Runs processors live: the bus' messages and the ports' bytes go through `step`, results go out.

Between the processors of one process objects are passed, not bytes; each output is encoded once,
for the bus. Where a processor listens to ticks, the host makes them, ten a second, each with how
far every input had been read: that, and the snapshots, is what reprocessing repeats a ride by.
An input that is no message, or has a stamp from the future, is refused: counted, told, named.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median_low
from typing import Any

from tramstream import keys
from tramstream.boundary import Undecodable, decode
from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.events.messages import message_of
from tramstream.graph import Graph
from tramstream.keys import Key
from tramstream.live import snapshots
from tramstream.live.events import (
    FUTURE_STAMP,
    MEMORY_OF_OTHERS,
    MEMORY_TAKEN,
    SECOND_PUBLISHER,
    UNDECODABLE,
)
from tramstream.live.node import Node
from tramstream.live.ports import Port, PortReader
from tramstream.live.stamps import MAX_AHEAD_NS, ahead_ns
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.health_pb2 import DeviceHealth, Loss
from tramstream.proto.sync_pb2 import Position, Snapshot, Tick
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.descriptions import tell

TICK_S = 0.1
RAW_S = 0.1
"""Raw bytes and frames are published this often: ten messages a second instead of two hundred."""
SNAPSHOT_S = 5.0
"""The memory on disk, from which a process that was killed goes on, is never older."""
SNAPSHOT_RECORDED_S = 30.0
"""In the record it is for what begins in the middle of a ride; 60 kB each."""
DEVICE_HEALTH_S = 1.0
LEAD_WINDOW_S = 2.0
"""Event time follows the newest input of at least this long."""


@dataclass(frozen=True)
class Memory:
    """How the memory of a node's processors survives."""

    path: Path | None = None
    """File from which a process that was killed goes on; None keeps none."""
    settings: str = ""
    """Digest of the processors' settings: memory made with others is not taken back."""
    ticks: bool = True
    """Whether this node makes the ticks that its processors read, or has them off the bus."""


class ProcessorNode(Node):
    """A node made of processors, and of the ports that feed them.

    Parameters
    ----------
    processors : sequence of Processor
    ports : sequence of Port
        Their raw messages are stepped through the processors and published.
    memory : Memory or None
        How the processors' memory survives; a bridge has none to keep.
    """

    def __init__(
        self,
        name: str,
        vehicle: str,
        bus: Bus,
        stop: threading.Event,
        processors: Sequence[Processor],
        ports: Sequence[Port] = (),
        memory: Memory | None = None,
    ) -> None:
        super().__init__(name, vehicle, bus, stop)
        self.processors = list(processors)
        self.readers = [PortReader(port, self._from_port(port), stop) for port in ports]
        self.graph = Graph(processors, self.fault)
        if keys.EVENT.at(name).path in self.graph.outputs:
            self.source = f"{name}-node"  # two cannot number one key
        self._by_topic: dict[str, Key] = {}
        self._positions: dict[str, Position] = {}
        self._raw: dict[str, list[Any]] = {}
        self._lead = _Lead()
        self._ticks = (memory is None or memory.ticks) and self.graph.reads(keys.SYNC_TICK.path)
        self._tick_sequence = 0
        self._tick_ns = 0
        self._received = 0
        self._session = int.from_bytes(os.urandom(8), "little")
        self._memory = memory or Memory()
        self._last_snapshot_ns = self._recorded_snapshot_ns = 0
        self._remembers = False  # whether it goes on from its predecessor's memory
        self._began: Snapshot | None = None  # with what, until it has been said
        self._taken: set[str] | None = None  # keys of which inputs were taken

    # Setting up ----------------------------------------------------------------------------------
    def expressions(self) -> list[str]:
        made_here = {reader.port.key.path for reader in self.readers}
        if self._ticks:
            made_here.add(keys.SYNC_TICK.path)
        return sorted(path for path in self.graph.inputs if path not in made_here)

    def begin(self) -> None:
        for path in self.expressions():
            key = self.graph.inputs[path]
            self._by_topic[key.on(self.vehicle)] = key
        self._describe_types()
        self._restore()
        if self._ticks:
            self._take_snapshot(start=True)
            self.every(TICK_S, self.tick)
        elif self._memory.path is not None:
            self._began, self._taken = self._remembered(start=True), set()
            if not self._remembers:
                for each in self._began.states:
                    each.ClearField("state")
            self.every(SNAPSHOT_S, self._take_snapshot)
        if self.readers:
            self.every(RAW_S, self.publish_raw)
            self.every(DEVICE_HEALTH_S, self.device_health)
            for reader in self.readers:
                reader.start()

    def _describe_types(self) -> None:
        """Tell whoever asks what messages of other packages are; the router knows ours."""
        types = (key.type for key in self.graph.outputs.values())
        tell(self.bus, (each for each in types if each.DESCRIPTOR.full_name not in keys.TYPES))

    def finish(self) -> None:
        for reader in self.readers:
            reader.join(1.0)
        self.drain()
        if self.readers:
            self.publish_raw()
            self.device_health()
        if self._ticks:
            self.tick()
        if self._ticks or self._memory.path is not None:
            self._take_snapshot(end=True)

    def _restore(self) -> None:
        """Go on from the snapshot file of a process that died a moment ago."""
        path = self._memory.path
        if path is None:
            return
        state = snapshots.load(path, self.clock.now_ns())
        if isinstance(state, Event):
            self.tell(state)
        if not isinstance(state, Snapshot):
            return
        same = state.configuration == self._memory.settings
        if same and snapshots.restore(state, self.processors):
            self._tick_sequence, self._remembers = state.tick_sequence, True
            self.tell(MEMORY_TAKEN(node=self.name))
        else:
            self.tell(MEMORY_OF_OTHERS(path=path))

    # One item ------------------------------------------------------------------------------------
    def _from_port(self, port: Port) -> Any:
        return lambda message: self.ring.put(port.key.path, (port.key, message))

    def handle(self, envelope: Envelope) -> None:
        self._received += 1
        topic = envelope.topic
        key = self._by_topic.get(topic)
        if key is None:
            who = self.sources.name(envelope.session)
            self._refuse(envelope, Loss.SOURCE, SECOND_PUBLISHER(key=topic, who=who))
            return
        message = decode(key.type, envelope.payload, topic)
        if isinstance(message, Undecodable):
            why = UNDECODABLE(key=topic, reason=message.reason)
            self._refuse(envelope, Loss.UNDECODABLE, why)
            return
        ahead = ahead_ns(message, envelope.arrival_ns)
        if ahead > MAX_AHEAD_NS:
            why = FUTURE_STAMP(key=topic, ahead_s=ahead / S, limit_s=MAX_AHEAD_NS / S)
            self._refuse(envelope, Loss.STAMP, why)
            return
        if self.refusals.runs:
            self.refusals.close(topic)
        sample = Sample(key, message, message.stamp_ns, envelope.sequence, envelope.publish_ns)
        if self._ticks:
            self._note(sample, envelope.arrival_ns)
        elif self._taken is not None and key.path not in self._taken:
            self._tell_first(sample, self._taken)
        self.dispatch(sample)

    def _refuse(self, envelope: Envelope, cause: Loss.Cause, why: Event) -> None:
        self.refusals.refuse(envelope, cause, why, self.clock.now_ns())
        self.tell(why)

    def handle_item(self, item: Any) -> None:
        """Keep the raw bytes for the record, whatever the decoder then makes of them."""
        key, message = item
        if isinstance(message, Exception):
            raise message  # a bug in the port; its thread goes on
        self._raw.setdefault(key.path, []).append(message)
        self.dispatch(Sample(key, message, message.stamp_ns, message.sequence))

    def dispatch(self, sample: Sample) -> None:
        """Step a sample through the processors and publish all that follows."""
        for made in self.graph.step(sample):
            self.send(made)

    def _note(self, sample: Sample, arrival_ns: int) -> None:
        """Remember how far this key has been read, and what it says about event time."""
        position = self._positions.get(sample.key.path)
        if position is None:
            position = Position(key=sample.key.path, first_publish_ns=sample.publish_ns)
            self._positions[sample.key.path] = position
        position.last_publish_ns = sample.publish_ns
        position.count += 1
        self._lead.see(sample.key.path, sample.stamp_ns, arrival_ns)

    # Timers --------------------------------------------------------------------------------------
    def tick(self) -> None:
        """Let time pass; not before the first input, for event time follows the inputs.

        While messages wait in the queue, it is not later than the last one that was read: a process
        that stood still for a moment must not take its own delay for silence of the devices.
        """
        known = self._lead.event_ns(len(self.ring) > 0, self.clock.now_ns())
        if known is None:
            return
        now_ns = self._tick_ns = max(known, self._tick_ns)
        self.tell_refusals()  # before the tick that counts what was used instead
        self._tick_sequence += 1
        message = Tick(
            stamp_ns=now_ns,
            sequence=self._tick_sequence,
            session=self._session,
            positions=self._positions.values(),
        )
        sample = Sample(keys.SYNC_TICK, message, now_ns, self._tick_sequence)
        self.send(sample)
        self.dispatch(sample)
        if self.clock.now_ns() - self._last_snapshot_ns > SNAPSHOT_S * S:
            self._take_snapshot()

    def _tell_first(self, sample: Sample, taken: set[str]) -> None:
        """Name the first input of a key before it is taken, and with what this process began."""
        taken.add(sample.key.path)
        message = self._began or Snapshot(session=self._session)
        self._began = None
        message.positions.add(
            key=sample.key.path,
            first_publish_ns=sample.publish_ns,
            first_stamp_ns=sample.stamp_ns,
        )
        self.publish(keys.MEMORY.at(self.name), message)

    def _remembered(self, start: bool = False) -> Snapshot:
        return Snapshot(
            session=self._session,
            start=start,
            tick_sequence=self._tick_sequence,
            positions=self._positions.values(),
            states=snapshots.take(self.processors),
            configuration=self._memory.settings,
        )

    def _take_snapshot(self, start: bool = False, end: bool = False) -> None:
        now_ns = self._last_snapshot_ns = self.clock.now_ns()
        message = self._remembered(start)
        due = start or end or now_ns - self._recorded_snapshot_ns >= SNAPSHOT_RECORDED_S * S
        if self._ticks and due:
            self._recorded_snapshot_ns = now_ns
            self.publish(keys.SYNC_SNAPSHOT, message)
        if self._memory.path is not None:
            message.stamp_ns = now_ns
            try:
                snapshots.save(self._memory.path, message)
            except OSError as error:
                self.fault(error)

    def publish_raw(self) -> None:
        for reader in self.readers:
            key = reader.port.key
            reads = self._raw.get(key.path)
            if reads:
                self.publish_numbered(key, reader.port.join(reads))
                reads.clear()

    def publish_numbered(self, key: Key, message: Any) -> None:
        """Publish a raw message that has its stamp already."""
        message.sequence = self._sequences[key.path] = self._sequences.get(key.path, 0) + 1
        self.put(key, message, message.sequence)

    def device_health(self) -> None:
        self.troubles = []
        for reader in self.readers:
            state, trouble = reader.health()
            found = [] if trouble is None else [trouble]
            processors = self.graph.readers(reader.port.key.path)
            for processor in processors:
                found += processor.device_troubles()
            self.troubles += found
            trouble = found[0] if found else None
            message = DeviceHealth(
                device=self.name,
                port=reader.place,
                state=state,
                text="" if trouble is None else str(trouble),
                trouble=None if trouble is None else message_of(trouble),
                opened=reader.opened,
                bytes_received=reader.bytes_received,
                silence_s=reader.silence_s,
            )
            for processor in processors:
                for name, value in processor.device_counters().items():
                    if name == "rejected_by_reason":
                        message.rejected_by_reason.update(value)
                    elif value is not None:
                        setattr(message, name, value)
            self.publish(keys.DEVICE.at(self.name), message)

    def ledgers(self) -> list[Ledger]:
        inside = [ledger for processor in self.processors for ledger in processor.ledgers()]
        return [self.refusals.ledger(self._received, 0), *inside] if self._by_topic else inside


class _Lead:
    """How far event time is ahead of the clock: of each input the most it was lately.

    Live it is a few milliseconds negative; for a replayed record it is the age of the record. The
    (lower) median over the inputs counts, so that one device with broken stamps moves nothing.
    """

    def __init__(self) -> None:
        self._since_ns = 0
        self._now: dict[str, int] = {}
        self._before: dict[str, int] = {}
        self._read_ns = 0

    def see(self, path: str, stamp_ns: int, arrival_ns: int) -> None:
        self._read_ns = arrival_ns
        if arrival_ns - self._since_ns > LEAD_WINDOW_S * S:
            self._since_ns, self._before, self._now = arrival_ns, self._now, {}
        lead_ns = stamp_ns - arrival_ns
        self._now[path] = max(lead_ns, self._now.get(path, lead_ns))

    def event_ns(self, waiting: bool, now_ns: int) -> int | None:
        """Event time now, or of the last message read if more are `waiting`; None before any."""
        known = self._before | {
            path: max(lead_ns, self._before.get(path, lead_ns))
            for path, lead_ns in self._now.items()
        }
        if not known:
            return None
        return (self._read_ns if waiting else now_ns) + median_low(known.values())
