"""How many lines a minute each node may say to people, whatever happens to it.

A device with a loose plug comes and goes twice a second, and a node that is started again and again
says each time what it begins with. Each source has lines for a while, and new ones come one by one;
what is not said is counted and told with the next line. The record has all of it.
"""

from __future__ import annotations

from collections.abc import Callable

LINES = 20
"""A source may say so much at once,"""
AGAIN_S = 3.0
"""and one line more each time so long has gone: twenty a minute."""
SOURCES = 64
"""Sources that have a budget of their own; strangers may make up any number, and share one."""
OTHERS = ""


class Budget:
    """Lines that sources may still say.

    Parameters
    ----------
    now_s : callable
        Monotonic seconds.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._lines: dict[str, tuple[float, float]] = {}
        """What a source had left, and when that was."""
        self._unsaid: dict[str, int] = {}

    def spend(self, source: str, *, counted: bool = True) -> int | None:
        """Take a line of a source; how many of its lines were not said before it.

        None if this one is not said either; it then is `counted`, unless it will be tried again.
        """
        known = source in self._lines or len(self._lines) < SOURCES
        name = source if known else OTHERS
        now_s = self._now_s()
        left, since_s = self._lines.get(name, (float(LINES), now_s))
        left = min(float(LINES), left + (now_s - since_s) / AGAIN_S)
        if left < 1.0:
            self._lines[name] = left, now_s
            self._unsaid[name] = self._unsaid.get(name, 0) + counted
            return None
        self._lines[name] = left - 1.0, now_s
        return self._unsaid.pop(name, 0)
