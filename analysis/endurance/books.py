"""Books of a vehicle that ran for long, kept from the parts of its record as they are finished.

Exact means three things, each counted here:

- a stage: received = delivered + dropped + pending, in every heartbeat of every node;
- a line: of what a simulated device put onto it whole, its bridge has had every frame;
- the record: of a key's messages, which are numbered from 1 on, each is in it or named lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from tramstream import keys
from tramstream.boundary import Undecodable, name_of
from tramstream.bridges.simulators.node import NAME as SIMULATORS
from tramstream.bridges.simulators.node import OVERRUN
from tramstream.proto.health_pb2 import DeviceHealth, Event, Loss, NodeHealth, StageLedger
from tramstream.recorder.node import NAME as RECORDER
from tramstream.recorder.reader import Record

_DECODED = (NodeHealth, DeviceHealth, Loss, Event)
MOST_GAPS = 100_000
"""Of one leap of the numbers; a greater one is a number that was made up."""
MOST_TOLD = 20
"""Examples of what does not add up that are kept."""
_LINES = {"gnss": "frames", "odometer": "frames", "imu": "samples"}
"""Unit in which simulated device and bridge of one name count alike."""


@dataclass
class Numbers:
    """Which numbers of a key's messages have come, from 1 on; what comes late fills its gap."""

    following: int = 1
    gaps: set[int] = field(default_factory=set)
    twice: int = 0
    """That had come; those of a process included that has replaced another."""

    def take(self, number: int) -> None:
        """Take note of a message."""
        if number >= self.following:
            self.gaps.update(range(self.following, min(number, self.following + MOST_GAPS)))
            self.following = number + 1
        elif number in self.gaps:
            self.gaps.discard(number)
        elif number == 1:  # a new process
            self.following = 2
        else:
            self.twice += 1


class Line(NamedTuple):
    """Between a simulated device and its bridge, in frames or samples."""

    device: str
    unit: str
    sent: int
    """Onto the line, whole."""
    overrun: int
    """Cut short, for the reader was too slow: some of it may have come."""
    before: int
    """Of what was sent, what came before the port was open, and was thrown away when it was."""
    received: int

    @property
    def exact(self) -> bool:
        """Whether the bridge has had all that was sent, and no more than was made."""
        due = self.sent - self.before
        return due <= self.received <= due + self.overrun


@dataclass
class Books:
    """What the parts that were taken say; of bounded size, however many they are."""

    messages: int = 0
    heartbeats: int = 0
    ledgers: int = 0
    """Looked at: those of all stages in all heartbeats."""
    wrong: int = 0
    """Of them, those that do not add up."""
    restarts: Counter[str] = field(default_factory=Counter)
    """Processes of a node that came after its first."""
    losses: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Messages named lost or not used, by consumer and cause."""
    events: Counter[tuple[str, str]] = field(default_factory=Counter)
    """By source and kind."""
    examples: list[str] = field(default_factory=list)
    """Of what is wrong."""
    last: dict[str, NodeHealth] = field(default_factory=dict)
    devices: dict[str, DeviceHealth] = field(default_factory=dict)
    begin_ns: int = 0
    end_ns: int = 0
    began: dict[str, int] = field(default_factory=dict)
    """Frames of a device that came before the first that its bridge has had."""
    early: Counter[str] = field(default_factory=Counter)
    """By topic: numbers before the first that the record has; the recorder was not there yet."""
    frames_before: Mapping[int, int] = field(default_factory=dict)
    """Of the receiver's capture: frames before the epoch of a time of week, ms."""
    _numbers: dict[str, Numbers] = field(default_factory=dict)
    _named: Counter[str] = field(default_factory=Counter)
    _pids: dict[str, int] = field(default_factory=dict)

    def take(self, record: Record) -> None:
        """Add a part of the record: all its messages."""
        self.begin_ns = self.begin_ns or record.start_ns
        self.end_ns = max(self.end_ns, record.end_ns)
        for entry in record.messages():
            topic = entry.topic
            self.messages += 1
            numbers = self._numbers.get(topic)
            if numbers is None:
                numbers = self._numbers[topic] = Numbers(entry.sequence)
                if entry.sequence > 1:
                    self.early[topic] = entry.sequence - 1
                self._note_first(topic, record.decode(entry))
            numbers.take(entry.sequence)
            if record.class_of(topic) in _DECODED:
                message = record.decode(entry)
                if isinstance(message, Undecodable):
                    self._tell(f"{topic} {entry.sequence}: {message.reason}")
                else:
                    self.add(topic, message)

    def _note_first(self, topic: str, message: Any) -> None:
        """Tell by the first message of a device how much of what it had sent was thrown away."""
        path = keys.split(topic)[1]
        if path == keys.IMU_BATCH.path:
            self.began["imu"] = message.first_sample_sequence
        elif path == keys.GNSS_FIX.path:
            self.began["gnss"] = self.frames_before.get(message.itow_ms, 0)

    def add(self, topic: str, message: Any) -> None:
        """Add one message of health."""
        source = keys.split(topic)[1].split("/")[1]
        if isinstance(message, NodeHealth):
            self._add_node(source, message)
        elif isinstance(message, DeviceHealth):
            self.devices[source] = message
        elif isinstance(message, Loss):
            self.losses[message.consumer, name_of(Loss.Cause, message.cause)] += message.count
            if message.consumer == RECORDER:
                self._named[message.key] += message.count
        elif isinstance(message, Event):
            self.events[message.source or source, message.kind] += 1 + message.unsaid

    def _add_node(self, source: str, beat: NodeHealth) -> None:
        self.heartbeats += 1
        before = self._pids.setdefault(source, beat.pid)
        if before != beat.pid:
            self._pids[source] = beat.pid
            self.restarts[source] += 1
        for stage in beat.stages:
            self.ledgers += 1
            if stage.received != stage.delivered + stage.dropped + stage.pending:
                self.wrong += 1
                self._tell(f"{source} {stage.stage} {stage.unit}: {_worded(stage)}")
        self.last[source] = beat

    def _tell(self, what: str) -> None:
        if len(self.examples) < MOST_TOLD:
            self.examples.append(what)

    @property
    def missing(self) -> dict[str, int]:
        """By topic: numbers that are neither in the record nor named lost; less than 0: twice.

        Where a process was replaced, it may have gone on from a memory that was a little older.
        """
        found = {}
        for topic, numbers in self._numbers.items():
            off = len(numbers.gaps) - self._named[topic]
            off -= numbers.twice if not self.restarts else 0
            if off:
                found[topic] = off
        return found

    @property
    def topics(self) -> int:
        return len(self._numbers)

    @property
    def lost(self) -> int:
        """Messages that somebody never had, or did not use."""
        return sum(self.losses.values())

    def made(self, device: str, unit: str) -> int:
        """What a simulated device has made until its last heartbeat, wherever it went."""
        simulated = self.last.get(SIMULATORS)
        return 0 if simulated is None else _stage(simulated, device, unit).received

    def lines(self) -> list[Line]:
        """The lines between simulated devices and bridges, as of the last heartbeats."""
        simulated = self.last.get(SIMULATORS)
        found = []
        for device, unit in _LINES.items():
            bridge = self.last.get(device)
            if simulated is None or bridge is None:
                continue
            sent = _stage(simulated, device, unit)
            overrun = _stage(simulated, f"{device} {OVERRUN}", unit)
            received = _stage(bridge, device, unit)
            before = self.began.get(device, 0)
            found.append(
                Line(device, unit, sent.delivered, overrun.dropped, before, received.received)
            )
        return found

    @property
    def exact(self) -> bool:
        """Whether all books add up: stages, lines and the record."""
        lines = self.lines()
        return (
            not self.wrong
            and not self.missing
            and len(lines) == len(_LINES)
            and all(line.exact for line in lines)
        )


def _stage(beat: NodeHealth, name: str, unit: str) -> StageLedger:
    """A stage's ledger; an empty one if there is none."""
    for stage in beat.stages:
        if stage.stage == name and stage.unit == unit:
            return stage
    return StageLedger()


def _worded(stage: StageLedger) -> str:
    return (
        f"{stage.received} received, {stage.delivered} delivered, {stage.dropped} dropped, "
        f"{stage.pending} pending"
    )
