"""Tokens of liveliness: who is on the bus, since when, under which session.

A token is `<topic>/<since>-<session>`, both in hexadecimal; it is gone within milliseconds when its
process dies.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Announced(NamedTuple):
    """A topic that somebody is alive under, and the session of all that is published there."""

    topic: str
    since_ns: int
    session: int

    @property
    def token(self) -> str:
        return f"{self.topic}/{self.since_ns:016x}-{self.session:08x}"


def read(tokens: Iterable[str]) -> list[Announced]:
    """Who announced `tokens`, in order; what is none of ours is passed over."""
    found = []
    for token in tokens:
        topic, _, name = token.rpartition("/")
        since, _, session = name.partition("-")
        if _is_hex(since) and _is_hex(session):
            found.append(Announced(topic, int(since, 16), int(session, 16)))
    return sorted(found)


def _is_hex(text: str) -> bool:
    return bool(text) and set(text) <= set("0123456789abcdef")
