"""Heading and speed out of the way between two fixes, where nothing else tells of the motion.

A vehicle with a receiver alone goes where its fixes go. Between two of them the filter knows how it
moved before and how a vehicle may turn and brake; where the way to a new fix says something else,
the way is right, for neighbouring fixes share most of their error. Heading and speed are then taken
from it at once, and the place from the fix. What no vehicle could do is left to the gate.

Equations: docs/theory.md, section 7.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tramstream.clock import S
from tramstream.estimation.fixes import FASTEST_MPS, antenna_l
from tramstream.estimation.localiser import Verdict
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram_filter.alignment import HARDEST_MPS2, NOISE_SIGMA, WHITE_SHARE
from tramstream.processors.tram_filter.filter import SPEED, TramFilter
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.coasting import SPEED_STD_MPS_RTS, YAW_STD_RAD_RTM
from tramstream.processors.tram_sources.gnss import Fixes
from tramstream.proto.gnss_pb2 import GnssFix

YAW = int(Ix.YAW)
LONGEST_S = 5.0
"""Fixes that are further apart show no velocity of the vehicle; chosen by hand."""
USUAL_MPS2 = 1.5
"""By so much a second the velocity between fixes may be off the filter's; chosen by hand."""
SHOWN_SIGMA = 3.0
"""A velocity of so many of its deviations shows a heading; chosen by hand."""


@dataclass
class CourseMemory:
    """What a `Course` remembers: the fix before, and the velocity from the one before that."""

    stamp_ns: int = 0
    """0: there is none."""
    east_m: float = 0.0
    north_m: float = 0.0
    velocity: complex = 0j
    """m/s; to the east and, imaginary, to the north."""
    agreed: bool = False
    """Whether there is one."""


class Course:
    """Watches the way between fixes.

    Parameters
    ----------
    tau_s : float
        Correlation time of the error of the fixes.
    """

    def __init__(self, tau_s: float, memory: CourseMemory | None = None) -> None:
        self._tau_s = tau_s
        self.memory = CourseMemory() if memory is None else memory

    def follow(
        self,
        fix: GnssFix,
        verdicts: list[Verdict],
        ekf: TramFilter,
        fixes: Fixes,
        level: LocalLevel,
    ) -> None:
        """Hold the filter to the way to a fix that it has just taken, or refused."""
        dt_s = (fix.stamp_ns - self.memory.stamp_ns) / S
        east, north, _ = antenna_l(fix, level)
        std_mps = self._way(fix.stamp_ns, east, north, fixes.noise.deviations(fix)[0])
        if std_mps is None:
            return
        refused = not verdicts[0].accepted
        if self._correct(ekf, dt_s, std_mps, refused) and refused:
            fixes.move_to(verdicts, ekf)

    def _way(self, stamp_ns: int, east_m: float, north_m: float, std_m: float) -> float | None:
        """Take the velocity since the last fix; gives its deviation, None if there is none."""
        memory = self.memory
        dt_s = (stamp_ns - memory.stamp_ns) / S
        way = complex(east_m - memory.east_m, north_m - memory.north_m)
        known = memory.stamp_ns != 0 and 0.0 < dt_s < LONGEST_S
        memory.stamp_ns, memory.east_m, memory.north_m = stamp_ns, east_m, north_m
        if not known:
            memory.agreed = False
            return None
        apart = 1.0 - math.exp(-dt_s / self._tau_s) + WHITE_SHARE * WHITE_SHARE
        std_mps = std_m * math.sqrt(2.0 * apart) / dt_s
        before, memory.velocity = memory.velocity, way / dt_s
        changed = abs(memory.velocity - before)
        possible = changed < HARDEST_MPS2 * dt_s + NOISE_SIGMA * std_mps
        possible = possible and abs(memory.velocity) < FASTEST_MPS
        agreed, memory.agreed = memory.agreed, True
        return std_mps if possible or not agreed else None

    def _correct(self, ekf: TramFilter, dt_s: float, std_mps: float, refused: bool) -> bool:
        """Let the filter go the way between the fixes, if it went another; whether it did."""
        shown = self.memory.velocity
        yaw, speed = ekf.state[YAW], ekf.state[SPEED]
        own = speed * complex(math.cos(yaw), math.sin(yaw))
        if not refused and abs(shown - own) < USUAL_MPS2 * dt_s + NOISE_SIGMA * std_mps:
            return False
        mps = abs(shown)
        ekf.reset(Ix.SPEED, mps, math.hypot(std_mps, SPEED_STD_MPS_RTS * math.sqrt(dt_s)))
        if mps > SHOWN_SIGMA * std_mps:
            turned = YAW_STD_RAD_RTM * math.sqrt(mps * dt_s)
            ekf.reset(Ix.YAW, math.atan2(shown.imag, shown.real), math.hypot(std_mps / mps, turned))
        return True
