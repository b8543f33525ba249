"""Which messages of a record are exported: keys, a part of the time, at most so many a second."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from tramstream import keys
from tramstream.clock import S
from tramstream.recorder.reader import Entry, Record


@dataclass(frozen=True)
class Window:
    """What is wanted.

    Parameters
    ----------
    key : str
        Key expression, with or without `tram/<vehicle>/`; empty: all.
    start_s, duration_s : float
        Of the record's time, from its first arrival; a duration of 0 is all.
    rate_hz : float
        Of each key no more messages a second than this; 0 is all.
    """

    key: str = ""
    start_s: float = 0.0
    duration_s: float = 0.0
    rate_hz: float = 0.0

    def means(self, topic: str) -> bool:
        """Whether the key is wanted."""
        if not self.key:
            return True
        path = keys.split(topic)[1]
        return bool(keys.matches(self.key, topic) or keys.matches(self.key, path))

    @property
    def told(self) -> str:
        """What was asked for, as part of a sentence; empty if everything was."""
        parts = [f" on key {self.key}"] if self.key else []
        if self.start_s or self.duration_s:
            parts.append(" in that part of its time")
        return "".join(parts)

    def span(self, record: Record) -> tuple[int, int | None]:
        """First and last arrival that is wanted, ns."""
        start_ns = record.start_ns + int(self.start_s * S)
        return start_ns, start_ns + int(self.duration_s * S) if self.duration_s else None

    def decoded(self, record: Record, topic: str) -> Iterator[tuple[Entry, Any]]:
        """The messages of one key that are wanted."""
        if not self.means(topic):
            return
        start_ns, end_ns = self.span(record)
        period_ns = S / self.rate_hz if self.rate_hz else 0.0
        due_ns = float("-inf")
        for entry, message in record.decoded(topic.__eq__, start_ns, end_ns):
            if entry.log_ns < due_ns:
                continue
            if period_ns:  # by a grid, not from the last one: 100 Hz at 30 Hz shall be 30 Hz
                due_ns = entry.log_ns + period_ns - (entry.log_ns - start_ns) % period_ns
            yield entry, message


WHOLE = Window()
