"""Outputs made again against outputs recorded live, byte by byte."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tramstream import boundary, keys
from tramstream.boundary import Undecodable

SEQUENCE_MASK = 0xFFFFFFFF
"""MCAP keeps 32 bits of the sequence number."""
TOLD = 10
"""So many differences are described; the others are counted."""


@dataclass
class Comparison:
    """Feed both sides in any interleaving, then `close`.

    Per session and key the recorded outputs must be made again, all of them and equal. What we
    make and the record does not hold (the recorder started later, ended sooner, or lost it) is
    counted, and so are recorded outputs of a session that died after its last tick: nobody knows
    what it had read by then.
    """

    compared: int = 0
    unrecorded: int = 0
    unanchored: int = 0
    differences: list[str] = field(default_factory=list)
    difference_count: int = 0

    def __post_init__(self) -> None:
        self._made: dict[tuple[int, str], deque[tuple[int, bytes]]] = {}
        self._expected: dict[tuple[int, str], deque[tuple[int, bytes]]] = {}
        self._latest_session = 0

    def expect(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        """Take an output that the live run published."""
        self._latest_session = max(self._latest_session, session)
        place = (session, path)
        self._expected.setdefault(place, deque()).append((sequence, payload))
        self._settle(place)

    def make(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        """Take an output that was made again."""
        place = (session, path)
        self._made.setdefault(place, deque()).append((sequence & SEQUENCE_MASK, payload))
        self._settle(place)

    def close(self) -> None:
        """Account for what has no counterpart."""
        for waiting in self._made.values():
            self.unrecorded += len(waiting)
        for (session, path), waiting in self._expected.items():
            if session < self._latest_session:
                self.unanchored += len(waiting)
            else:
                for sequence, _ in waiting:
                    self._differ(_missed, path, sequence)

    def _settle(self, place: tuple[int, str]) -> None:
        _, path = place
        made = self._made.get(place)
        expected = self._expected.get(place)
        while made and expected:
            ours, payload = made[0]
            theirs, recorded = expected[0]
            if ours < theirs:
                made.popleft()
                self.unrecorded += 1
            elif ours > theirs:
                expected.popleft()
                self._differ(_missed, path, theirs)
            else:
                made.popleft()
                expected.popleft()
                self.compared += 1
                if payload != recorded:
                    self._differ(_describe, path, ours, payload, recorded)

    def _differ(self, describe: Callable[..., str], *arguments: Any) -> None:
        self.difference_count += 1
        if len(self.differences) < TOLD:
            self.differences.append(describe(*arguments))


def _missed(path: str, sequence: int) -> str:
    return f"{path} sequence {sequence}: recorded, but not made again"


def _describe(path: str, sequence: int, payload: bytes, recorded: bytes) -> str:
    """Name the first field that differs."""
    key = keys.find(path)
    if key is None:
        return f"{path} sequence {sequence}: other bytes"
    ours = boundary.decode(key.type, payload, path)
    theirs = boundary.decode(key.type, recorded, path)
    for side in (ours, theirs):
        if isinstance(side, Undecodable):
            return f"{path} sequence {sequence}: {side.size} bytes are {side.reason}"
    for descriptor in key.type.DESCRIPTOR.fields:
        mine, live = getattr(ours, descriptor.name), getattr(theirs, descriptor.name)
        if mine != live:
            shown = f"{live!r}"[:80], f"{mine!r}"[:80]
            return (
                f"{path} sequence {sequence}: {descriptor.name} was {shown[0]}, is now {shown[1]}"
            )
    return f"{path} sequence {sequence}: equal fields in other bytes"
