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
from typing import Any

LEAST_WAY_M = 1.0
ENOUGH_RAD = 0.1
"""How well the heading must be known; the filter does the rest."""
WHITE_SHARE = 0.1
"""Of a fix's error that neighbours do not share."""
HARDEST_MPS2 = 5.0
"""No tram brakes or accelerates harder."""
NOISE_SIGMA = 4.0


class Alignment:
    """Sums displacements; one per departure."""

    def __init__(self, tau_s: float) -> None:
        self._tau_s = tau_s
        self._sum = 0j
        self._fix: tuple[float, float, float, float] | None = None  # time, east, north, turned
        self._first_s = 0.0
        self._std_m = 0.0
        self._velocity = 0j  # of the last displacement
        self._middle_s = math.inf  # of it; the first one has nothing to agree with
        self._agreed = False  # the last two

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
        self._std_m = max(self._std_m, std)
        if self._fix is None:
            self._first_s = time_s
        else:
            before_s, east, north, before = self._fix
            if time_s <= before_s:
                return
            way = complex(east_m - east, north_m - north) * cmath.exp(-0.5j * (before + turned))
            self._add(way, before_s, time_s)
        self._fix = (time_s, east_m, north_m, turned)

    def _add(self, way: complex, start_s: float, end_s: float) -> None:
        velocity, middle_s = way / (end_s - start_s), 0.5 * (start_s + end_s)
        noise = NOISE_SIGMA * math.sqrt(2.0) * self._noise_m(end_s - start_s) / (end_s - start_s)
        most = HARDEST_MPS2 * (middle_s - self._middle_s) + noise
        self._agreed = abs(velocity - self._velocity) < most
        if self._agreed:
            self._sum += way
        else:
            self._sum, self._first_s = way, start_s
        self._velocity, self._middle_s = velocity, middle_s

    def _noise_m(self, dt_s: float) -> float:
        """Deviation of a displacement between fixes that are so far apart in time."""
        apart = 1.0 - math.exp(-dt_s / self._tau_s)
        return self._std_m * math.sqrt(2.0 * (apart + WHITE_SHARE))

    @property
    def way_m(self) -> float:
        """The way that the answer rests on."""
        return abs(self._sum)

    @property
    def yaw_rad(self) -> float:
        """Direction of motion at the departure, counter-clockwise from east."""
        return cmath.phase(self._sum)

    @property
    def yaw_std_rad(self) -> float:
        """Deviation of `yaw_rad`; infinite without a way, or while displacements disagree."""
        if self._fix is None or not self._agreed or self.way_m < LEAST_WAY_M:
            return math.inf
        return self._noise_m(self._fix[0] - self._first_s) / self.way_m

    @property
    def ready(self) -> bool:
        return self.yaw_std_rad < ENOUGH_RAD

    def snapshot(self) -> dict[str, Any]:
        return {
            "sum": [self._sum.real, self._sum.imag],
            "fix": None if self._fix is None else list(self._fix),
            "first_s": self._first_s,
            "std_m": self._std_m,
            "velocity": [self._velocity.real, self._velocity.imag],
            "middle_s": self._middle_s,
            "agreed": self._agreed,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._sum, self._velocity = complex(*state["sum"]), complex(*state["velocity"])
        self._fix = None if state["fix"] is None else tuple(state["fix"])
        self._first_s, self._std_m = state["first_s"], state["std_m"]
        self._middle_s, self._agreed = state["middle_s"], state["agreed"]
