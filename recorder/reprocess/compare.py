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
REORDERED = 10_000
"""So many outputs of a key, 100 s of the quickest, wait for a recorded one; then there is none."""
TOLD = 10
"""So many differences are described; the others are counted."""


@dataclass(slots=True)
class _Place:
    """Of one key in one session, what has no counterpart yet, by its number.

    A number comes again where a process goes on from its memory of some seconds ago.
    """

    made: dict[int, deque[bytes]] = field(default_factory=dict)
    expected: dict[int, deque[bytes]] = field(default_factory=dict)


@dataclass
class Comparison:
    """Feed both sides in any interleaving, then `close`.

    Outputs are paired by their numbers: what processors name late between two ticks may be made
    again in another order, with the numbers that it had.

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
        self._places: dict[tuple[int, str], _Place] = {}
        self._latest_session = 0

    def expect(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        """Take an output that the live run published."""
        self._latest_session = max(self._latest_session, session)
        place = self._place(session, path)
        ours = _first(place.made, sequence)
        if ours is None:
            place.expected.setdefault(sequence, deque()).append(payload)
        else:
            self._compare(path, sequence, ours, payload)

    def make(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        """Take an output that was made again."""
        place, number = self._place(session, path), sequence & SEQUENCE_MASK
        theirs = _first(place.expected, number)
        if theirs is not None:
            self._compare(path, number, payload, theirs)
            return
        place.made.setdefault(number, deque()).append(payload)
        if len(place.made) > REORDERED:
            self.unrecorded += len(place.made.pop(next(iter(place.made))))

    def close(self) -> None:
        """Account for what has no counterpart."""
        for (session, path), place in self._places.items():
            self.unrecorded += sum(map(len, place.made.values()))
            if session < self._latest_session:
                self.unanchored += sum(map(len, place.expected.values()))
            else:
                for sequence, payloads in place.expected.items():
                    for _ in payloads:
                        self._differ(_missed, path, sequence)

    def _place(self, session: int, path: str) -> _Place:
        place = self._places.get((session, path))
        if place is None:
            place = self._places[session, path] = _Place()
        return place

    def _compare(self, path: str, sequence: int, ours: bytes, theirs: bytes) -> None:
        self.compared += 1
        if ours != theirs:
            self._differ(_describe, path, sequence, ours, theirs)

    def _differ(self, describe: Callable[..., str], *arguments: Any) -> None:
        self.difference_count += 1
        if len(self.differences) < TOLD:
            self.differences.append(describe(*arguments))


def _missed(path: str, sequence: int) -> str:
    return f"{path} sequence {sequence}: recorded, but not made again"


def _first(waiting: dict[int, deque[bytes]], sequence: int) -> bytes | None:
    """Take the first of those with a number out of what waits."""
    payloads = waiting.get(sequence)
    if payloads is None:
        return None
    first = payloads.popleft()
    if not payloads:
        del waiting[sequence]
    return first


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
