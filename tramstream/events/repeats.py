"""What repeats itself is said now and then, with how often it was not said.

The same event (kind and texts) is said at once, and again only after ten seconds, with the number
of those in between. Of one kind twenty different events are told apart; whatever more there are,
for a stranger may make up any number of keys, count as one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tramstream.events.kinds import Event, Kind

AGAIN_NS = 10_000_000_000
"""What repeats is said so often."""
MOST = 20
"""Events of one kind that are told apart."""


class Repeats:
    """Decides for one source which events are said.

    Its memory is plain data and belongs into a processor's snapshot: what is said is an output.

    Parameters
    ----------
    kinds : iterable of Kind
        Those that its memory may be of; more are learned as they come.
    """

    def __init__(self, kinds: Iterable[Kind] = ()) -> None:
        self._kinds = {kind.name: kind for kind in kinds}
        self._said: dict[str, dict[str, list[Any]]] = {}
        """By kind and identity: when it was said last, how often not since, facts of the newest."""

    def take(self, event: Event, now_ns: int) -> int | None:
        """How often this was not said since it was said last; None if it is not said now."""
        self._kinds[event.kind.name] = event.kind
        said = self._said.setdefault(event.kind.name, {})
        identity = "\n".join(event.identity)
        if identity not in said and len(said) >= MOST:
            identity = ""
        known = said.get(identity)
        if known is None:
            said[identity] = [now_ns, 0, {}]
            return 0
        if 0 <= now_ns - known[0] < AGAIN_NS:
            known[1], known[2] = known[1] + 1, dict(event.facts)
            return None
        unsaid: int = known[1]
        known[:] = [now_ns, 0, {}]
        return unsaid

    def overdue(self, now_ns: int) -> list[tuple[Event, int]]:
        """The newest of what was not said for long, and how often besides; it is said with this."""
        found = []
        for name, said in self._said.items():
            kind = self._kinds.get(name)
            for known in said.values():
                if kind is not None and known[1] and not 0 <= now_ns - known[0] < AGAIN_NS:
                    found.append((Event(kind, known[2]), known[1] - 1))
                    known[:] = [now_ns, 0, {}]
        return found

    def snapshot(self) -> dict[str, Any]:
        """Memory as plain data that shares nothing."""
        return {
            kind: {identity: [*known[:2], dict(known[2])] for identity, known in said.items()}
            for kind, said in self._said.items()
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `snapshot` gave."""
        self._said = {
            kind: {identity: [*known[:2], dict(known[2])] for identity, known in said.items()}
            for kind, said in state.items()
        }
