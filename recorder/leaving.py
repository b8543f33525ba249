"""Publishers that are about to end, and wait until the record has all of theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class Leaving:
    """A publisher that waits to end: its session, and the call that lets it go."""

    session: int
    answer: Callable[[], None]
    swept: bool = False
    """Whether it has said that it holds nothing that is missing here."""
    silent_ns: int = 0
    """Since when it has answered nothing; 0 if it answered the last question. A full link drops
    questions and answers at once, so how often says nothing."""
    due: bool = False
    """Whether it is to be asked again."""


@dataclass(slots=True)
class Seen:
    """How many answers a publisher that is leaving gave when it was asked for everything."""

    leaving: Leaving
    answers: int
