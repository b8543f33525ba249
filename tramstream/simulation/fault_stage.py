"""What stages of faults share: a fault with its times, and a stage over messages of one key."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from tramstream.keys import Key
from tramstream.processor import Sample
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, Odometry
from tramstream.simulation.event_kinds import Fault

M = TypeVar("M", ImuBatch, GnssFix, Odometry)


class Timed(NamedTuple):
    """A fault from one stamp until before another."""

    fault: Fault
    start_ns: int
    end_ns: int

    def lasts(self, stamp_ns: int) -> bool:
        """Whether an instant belongs to it."""
        return self.start_ns <= stamp_ns < self.end_ns


class Stage:
    """One fault over the messages of its sensor; other keys pass."""

    key: Key

    def __init__(self, timed: Timed) -> None:
        self.timed = timed

    def step(self, sample: Sample) -> list[Sample]:
        """Give what is recorded instead of a sample, and of those held back before."""
        if sample.key.path != self.key.path:
            return [sample]
        return self._take(sample)

    def end(self) -> list[Sample]:
        """Give what is still held back."""
        return []

    def _take(self, sample: Sample) -> list[Sample]:
        raise NotImplementedError


def copied(message: M) -> M:
    """Give a copy: messages are shared, and nobody may change them."""
    made = type(message)()
    made.CopyFrom(message)
    return made
