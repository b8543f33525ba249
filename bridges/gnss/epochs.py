"""Which message is an epoch's last, for receivers that say in several what belongs together."""

from __future__ import annotations

from dataclasses import dataclass, field

_MOST_MESSAGES = 64
"""Messages of interest that one epoch can have; a time that stands still must not fill memory."""


@dataclass
class EndOfEpoch:
    """Learns from each epoch with which kind of message the next one ends. It is its own memory.

    So nobody waits for the next epoch to have the last. The first epoch, and one whose last message
    was lost, ends where the next begins. What comes after an epoch is complete teaches the next
    one's end and is otherwise left out.
    """

    complete: bool = False
    """Nothing of the epoch under way is wanted any more."""
    _seen: list[str] = field(default_factory=list)
    """Kinds of the epoch under way, in order."""
    _before: list[str] = field(default_factory=list)
    """Those of the epoch before."""

    def begin(self) -> None:
        """Another epoch begins."""
        self.complete = False
        self._seen, self._before = [], self._seen

    def room(self) -> bool:
        """Whether the epoch under way may have another message: not if its time stands still."""
        return len(self._seen) < _MOST_MESSAGES

    def note(self, kind: str) -> bool:
        """Take note of a message; whether it is the last."""
        self._seen.append(kind)
        last = self._before[-1] if self._before else ""
        return kind == last and self._seen.count(kind) == self._before.count(kind)
