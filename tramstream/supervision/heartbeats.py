"""Who has not been heard for too long, in time during which somebody listened.

Every node gives a heartbeat a second. One that has given none for `SAID_S` is said, after
`FROZEN_S` it is taken for frozen. What is not held against a node:

- time in which the listener itself stood still (a turn counts for `TURN_MAX_S` at most), as when
  the machine slept or the supervisor was stopped;
- time in which the router was away or silent, for nothing comes through then; once it is heard
  again, all ages begin anew;
- its start: before the first heartbeat it has `FIRST_SAID_S` and `FIRST_FROZEN_S`, for the recorder
  repairs its last file then.

The limits: with six busy processes a core (nice 0) for a minute the longest pause between two
heartbeats of a healthy node was 1.7 s (docs/architecture.md, "Processes that watch each other"), so
five missed ones in a row are no matter of load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

SAID_S = 3.0
FROZEN_S = 5.0
FIRST_SAID_S = 30.0
FIRST_FROZEN_S = 120.0
TURN_MAX_S = 0.5
"""The watch loop turns ten times a second; a longer turn is one in which it did not run."""
ROUTER_FRESH_S = 2.0
"""A router that was heard so lately brings everybody's heartbeats."""


class Silence(NamedTuple):
    """A node that has given no heartbeat for `limit_s`; `frozen` if that is to end it."""

    name: str
    limit_s: float
    frozen: bool


@dataclass
class _Beat:
    age_s: float = 0.0
    heard: bool = False
    said: bool = False
    frozen: bool = False

    def limits_s(self) -> tuple[float, float]:
        return (SAID_S, FROZEN_S) if self.heard else (FIRST_SAID_S, FIRST_FROZEN_S)


class Heartbeats:
    """Ages of the last heartbeats by node.

    Parameters
    ----------
    router : str
        The node through which all others are heard.
    """

    def __init__(self, router: str) -> None:
        self._router = router
        self._beats: dict[str, _Beat] = {}

    def started(self, name: str, heard: bool = False) -> None:
        """A new process of a node; `heard` if it had begun to beat before we listened."""
        self._beats[name] = _Beat(heard=heard)

    def ended(self, name: str) -> None:
        """The node has no process now: nobody can be heard."""
        self._beats.pop(name, None)

    def beat(self, name: str) -> bool:
        """Take note of a heartbeat; whether the node had been said to be silent before."""
        beat = self._beats.get(name)
        if beat is None:
            return False
        if name == self._router and not self._router_is_fresh():
            for other in self._beats.values():
                other.age_s = 0.0
        was_said = beat.said
        self._beats[name] = _Beat(heard=True, frozen=beat.frozen)
        return was_said

    def pass_time(self, dt_s: float) -> list[Silence]:
        """Let a turn of the watch loop pass; return whose age has just gone beyond a limit."""
        dt_s = min(dt_s, TURN_MAX_S)
        fresh = self._router_is_fresh()
        found = []
        for name, beat in self._beats.items():
            if not (fresh or name == self._router):
                continue
            beat.age_s += dt_s
            said_s, frozen_s = beat.limits_s()
            if beat.age_s >= frozen_s and not beat.frozen:
                beat.said = beat.frozen = True
                found.append(Silence(name, frozen_s, True))
            elif beat.age_s >= said_s and not beat.said:
                beat.said = True
                found.append(Silence(name, said_s, False))
        return found

    def _router_is_fresh(self) -> bool:
        beat = self._beats.get(self._router)
        return beat is not None and beat.heard and beat.age_s < ROUTER_FRESH_S
