"""Where a vehicle stands that has not moved yet, of which nothing but fixes is known.

Fixes at a stop share their error, which walks: no mean of them is better than one of them. But they
jump, the first ones too. So fixes that follow each other without a jump are of one *level*, which a
fix that comes back to it takes up again; the vehicle is where the first fix of that level was in
which fixes have been for longest.

Equations: docs/theory.md, section 7.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream.clock import S

REACH_SIGMA = 5.5
"""Beyond so many deviations of what neighbouring fixes do not share, a fix has jumped: the gate of
a pair."""
WHITE_SHARE = 0.1
"""Of a fix's error that neighbours do not share, as in the alignment (section 7.3); by hand."""
LONGEST_S = 2.0
"""No fix stands for longer; chosen by hand."""
MOST = 8
"""Levels that are kept; chosen by hand."""


@dataclass
class Level:
    """Fixes without a jump between them."""

    east_m: float
    """Of the first one."""
    north_m: float
    last_east_m: float
    last_north_m: float
    last_ns: int
    lasted_s: float = 0.0


@dataclass
class FirstPlaceMemory:
    """What `FirstPlace` remembers; the first level is the one that is believed."""

    levels: list[Level] = field(default_factory=list)
    fix_ns: int = 0
    """Of the last fix."""


class FirstPlace:
    """Finds the level that is to be believed.

    Parameters
    ----------
    tau_s : float
        Correlation time of the error of the fixes.
    """

    def __init__(self, tau_s: float, memory: FirstPlaceMemory) -> None:
        self._tau_s = tau_s
        self.memory = memory

    def forget(self) -> None:
        """Begin anew: the vehicle has moved."""
        self.memory.levels.clear()

    def begin(self, level: Level) -> None:
        """Begin with what is believed, by the fixes before."""
        self.memory.levels.append(level)
        self.memory.fix_ns = level.last_ns

    def take(
        self, stamp_ns: int, east_m: float, north_m: float, std_m: float
    ) -> tuple[float, float] | None:
        """Take a fix; gives the place of another level, if that is to be believed from here on."""
        memory = self.memory
        dt_s = min((stamp_ns - memory.fix_ns) / S, LONGEST_S) if memory.levels else 0.0
        memory.fix_ns = stamp_ns
        levels = memory.levels
        found = self._level_of(stamp_ns, east_m, north_m, std_m)
        if found is None:
            found = Level(east_m, north_m, east_m, north_m, stamp_ns)
            if len(levels) == MOST:
                del levels[min(range(1, MOST), key=lambda k: levels[k].lasted_s)]
            levels.append(found)
        found.last_east_m, found.last_north_m, found.last_ns = east_m, north_m, stamp_ns
        found.lasted_s += max(dt_s, 0.0)
        if found.lasted_s <= levels[0].lasted_s:
            return None
        levels.remove(found)
        levels.insert(0, found)
        return found.east_m, found.north_m

    def _level_of(self, stamp_ns: int, east_m: float, north_m: float, std_m: float) -> Level | None:
        """Give the nearest level that a fix can be of."""
        near: tuple[float, Level] | None = None
        for level in self.memory.levels:
            age_s = (stamp_ns - level.last_ns) / S
            apart = 1.0 - math.exp(-age_s / self._tau_s) + WHITE_SHARE * WHITE_SHARE
            off_m = math.hypot(east_m - level.last_east_m, north_m - level.last_north_m)
            if off_m < REACH_SIGMA * std_m * math.sqrt(2.0 * apart) and (
                near is None or off_m < near[0]
            ):
                near = off_m, level
        return near[1] if near is not None else None
