"""Heading out of motion: which way did the vehicle face when it left?

Between two fixes the vehicle has moved along its heading, whatever its speed. The displacements,
each turned back by what the vertical gyroscope has turned since the departure, all point the same
way: their sum's direction is the heading at the departure, and its length the way that the answer
rests on. Running backwards gives the opposite; that is for others to tell.

A fix that is far off makes a long way of no meaning. Neighbouring displacements of a vehicle differ
by no more than it can accelerate; where they do, the sum begins anew.

Equations: docs/theory.md, section 7.3.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

LEAST_WAY_M = 1.0
ENOUGH_RAD = 0.1
"""How well the heading must be known; the filter does the rest."""
WHITE_SHARE = 0.1
"""Of a fix's error that neighbours do not share."""
HARDEST_MPS2 = 5.0
"""No tram brakes or accelerates harder."""
NOISE_SIGMA = 4.0


@dataclass
class AlignmentMemory:
    """What an `Alignment` remembers."""

    sum: complex = 0j
    fix: tuple[float, float, float, float] | None = None
    """Time, east, north, turned."""
    first_s: float = 0.0
    std_m: float = 0.0
    velocity: complex = 0j
    """Of the last displacement."""
    middle_s: float = math.inf
    """Of it; the first one has nothing to agree with."""
    agreed: bool = False
    """The last two."""


class Alignment:
    """Sums displacements; one per departure."""

    def __init__(self, tau_s: float, memory: AlignmentMemory | None = None) -> None:
        self._tau_s = tau_s
        self.memory = AlignmentMemory() if memory is None else memory

    def take(self, time_s: float, east_m: float, north_m: float, turned: float, std: float) -> None:
        """Take a fix.

        Parameters
        ----------
        time_s : float
            Since the departure.
        turned : float
            By the vertical gyroscope since the departure, rad.
        std : float
            Of the fix, each axis, m.
        """
        memory = self.memory
        memory.std_m = max(memory.std_m, std)
        if memory.fix is None:
            memory.first_s = time_s
        else:
            before_s, east, north, before = memory.fix
            if time_s <= before_s:
                return
            way = complex(east_m - east, north_m - north) * cmath.exp(-0.5j * (before + turned))
            self._add(way, before_s, time_s)
        memory.fix = (time_s, east_m, north_m, turned)

    def _add(self, way: complex, start_s: float, end_s: float) -> None:
        memory = self.memory
        velocity, middle_s = way / (end_s - start_s), 0.5 * (start_s + end_s)
        noise = NOISE_SIGMA * math.sqrt(2.0) * self._noise_m(end_s - start_s) / (end_s - start_s)
        most = HARDEST_MPS2 * (middle_s - memory.middle_s) + noise
        memory.agreed = abs(velocity - memory.velocity) < most
        if memory.agreed:
            memory.sum += way
        else:
            memory.sum, memory.first_s = way, start_s
        memory.velocity, memory.middle_s = velocity, middle_s

    def _noise_m(self, dt_s: float) -> float:
        """Deviation of a displacement between fixes that are so far apart in time."""
        apart = 1.0 - math.exp(-dt_s / self._tau_s)
        return self.memory.std_m * math.sqrt(2.0 * (apart + WHITE_SHARE))

    @property
    def way_m(self) -> float:
        """The way that the answer rests on."""
        return abs(self.memory.sum)

    @property
    def yaw_rad(self) -> float:
        """Direction of motion at the departure, counter-clockwise from east."""
        return cmath.phase(self.memory.sum)

    @property
    def yaw_std_rad(self) -> float:
        """Deviation of `yaw_rad`; infinite without a way, or while displacements disagree."""
        memory = self.memory
        if memory.fix is None or not memory.agreed or self.way_m < LEAST_WAY_M:
            return math.inf
        return self._noise_m(memory.fix[0] - memory.first_s) / self.way_m

    @property
    def ready(self) -> bool:
        return self.yaw_std_rad < ENOUGH_RAD
