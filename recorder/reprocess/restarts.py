"""Processes of their own, as they ran live: what each began with, and which inputs it never got.

A processor with a process of its own begins when that process does, and goes on from its last
memory when it was killed. It says so (`sync/<processor>/memory`) right before it takes its first
input of a key: memory and the input are named. What its predecessor took last nobody says, so it
takes all inputs until then, and what the record does not hold of its outputs is not handed on.

What the bus lost on the way between two processes is named in a `Loss`, by its time of publication;
what is made again has none, so it is known by its number.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

from tramstream import keys
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.proto.sync_pb2 import Position, Snapshot
from tramstream.recorder.reader import Record

NUMBERS = 0xFFFFFFFF
"""MCAP keeps 32 bits of a sequence number."""


class Spans:
    """Open intervals, asked whether an instant lies in one of them."""

    def __init__(self, spans: Iterable[tuple[int, int]]) -> None:
        ordered = sorted(spans)
        self._after_ns = [after_ns for after_ns, _ in ordered]
        # The furthest end so far: intervals may overlap.
        self._before_ns = list(accumulate((before_ns for _, before_ns in ordered), max))

    def __contains__(self, stamp_ns: int) -> bool:
        index = bisect_left(self._after_ns, stamp_ns) - 1
        return index >= 0 and stamp_ns < self._before_ns[index]


@dataclass
class Start:
    """One start of a process that runs one processor."""

    memory: Snapshot | None
    """None: its beginning is not in the record; it begins fresh and takes everything."""
    publish_ns: int
    firsts: dict[str, Position] = field(default_factory=dict)
    """By path: the first input that it took."""
    lasts: dict[str, int] | None = None
    """By path: number of the last output that the record has of it; None: it was the last start."""

    @property
    def fresh(self) -> bool:
        """Whether it remembered nothing."""
        return self.memory is None or not any(each.state for each in self.memory.states)

    def has_come(self, sample: Sample) -> bool:
        """Whether a sample is the first that it took of a key, or comes after that."""
        if self.memory is None:
            return True
        first = self.firsts.get(sample.key.path)
        if first is None:
            return False
        if sample.publish_ns:
            return sample.publish_ns >= first.first_publish_ns
        return sample.stamp_ns >= first.first_stamp_ns


class Door:
    """Steps a processor as its processes did live.

    Parameters
    ----------
    processor : Processor
    starts : list of Start
        Of its own processes; none if it shared one.
    lost : mapping
        By path: numbers of what the bus lost on the way to it.
    """

    def __init__(
        self, processor: Processor, starts: list[Start], lost: Mapping[str, set[int]]
    ) -> None:
        self._processor, self._starts, self._lost = processor, starts, lost
        self._fresh = processor.snapshot()
        self._at = -1 if starts else 0
        self._open: set[str] = set()

    def step(self, sample: Sample) -> list[Sample]:
        """Step a sample, if the process that ran then got it; what it published of that."""
        path, starts = sample.key.path, self._starts
        if sample.publish_ns == 0 and sample.sequence & NUMBERS in self._lost.get(path, ()):
            return []
        if not starts:
            return self._processor.step(sample)
        while self._at + 1 < len(starts) and starts[self._at + 1].has_come(sample):
            self._begin(self._at + 1)
        if self._at < 0:
            return []
        start = starts[self._at]
        if path not in self._open:
            if not start.has_come(sample):
                return []
            self._open.add(path)
        made = self._processor.step(sample)
        if start.lasts is None:
            return made
        lasts = start.lasts
        return [each for each in made if each.sequence & NUMBERS <= lasts.get(each.key.path, 0)]

    def _begin(self, number: int) -> None:
        self._at = number
        self._open.clear()
        start = self._starts[number]
        if start.fresh:
            self._processor.restore(self._fresh)
        elif start.memory is not None:
            fit = snapshots.restore(start.memory, [self._processor])
            assert fit  # or else the plan would have left it out


def see_memory(starts: dict[str, list[Start]], snapshot: Snapshot, publish_ns: int) -> None:
    """Take note of what a process said before its first input of a key."""
    if snapshot.start and snapshot.states:
        starts.setdefault(snapshot.states[0].name, []).append(Start(snapshot, publish_ns))
    for known in starts.values():
        memory = known[-1].memory
        if memory is not None and memory.session == snapshot.session:
            known[-1].firsts.update({each.key: each for each in snapshot.positions})


def find_lasts(record: Record, own: Mapping[str, list[Start]]) -> None:
    """Look up what the record holds of each start but a processor's last.

    Parameters
    ----------
    own : mapping
        By path of an output: the starts of whoever makes it.
    """
    for entry in record.messages(lambda topic: keys.split(topic)[1] in own):
        path = keys.split(entry.topic)[1]
        known = own[path]
        index = bisect_right([each.publish_ns for each in known], entry.publish_ns) - 1
        if index < 0:
            known.insert(0, Start(None, 0))
            index = 0
        if index + 1 < len(known):
            start = known[index]
            start.lasts = start.lasts or {}
            start.lasts[path] = entry.sequence & NUMBERS
    for known in own.values():
        for each in known[:-1]:
            each.lasts = each.lasts or {}


def find_lost(record: Record, spans: Mapping[str, Spans]) -> dict[str, set[int]]:
    """Look up the numbers of what was published in spans of time, by path."""
    found: dict[str, set[int]] = {}
    for entry in record.messages(lambda topic: keys.split(topic)[1] in spans):
        path = keys.split(entry.topic)[1]
        if entry.publish_ns in spans[path]:
            found.setdefault(path, set()).add(entry.sequence & NUMBERS)
    return found
