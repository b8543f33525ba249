"""Fixes as a short history of speed and course; of receivers that say neither, of displacements."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tramstream.estimation.fixes import NO_COURSE_DEG, measures_speed, unusable
from tramstream.processors.consistency.speeds import Fixes
from tramstream.processors.consistency.way import Way
from tramstream.proto.gnss_pb2 import GnssFix

MOST, DROPPED = 600, 100
"""Fixes that are kept, and that are forgotten together: two minutes of driving."""
EVERY_S = 0.18
"""Fixes that come faster than five a second are thinned."""
SMEARED_S = 3.0
"""Displacements are taken over so long."""
STANDS_MPS = 0.5
"""A fix that is faster contradicts wheels that stand."""
FRESH_S = 2.0
"""So long a fix, or a reading of the wheels, says whether the vehicle stands."""
METRES_A_RADIAN = 6.371e6


@dataclass
class FixesMemory:
    """What a `FixHistory` remembers."""

    rows: list[list[float]] = field(default_factory=list)
    """Time, speed, course as a yaw, 1 if it is a displacement's."""
    places: list[list[float]] = field(default_factory=list)
    """Of the last seconds: time, degrees of latitude and longitude."""
    time_s: float = -1e9
    speed_mps: float = 0.0
    """Of the last fix."""


class FixHistory:
    """Keeps fixes in motion."""

    def __init__(self, way: Way, memory: FixesMemory) -> None:
        self.memory = memory
        self._way = way

    def take(self, fix: GnssFix) -> None:
        """Take a fix that its receiver calls valid."""
        if not fix.valid or unusable(fix, None) is not None:
            return
        memory, time_s = self.memory, self._way.time_s(fix.stamp_ns)
        speed, smeared = _speed(fix), 0.0
        if speed is None:
            (speed, time_s), smeared = self._displaced(fix, time_s), 1.0
        if not math.isfinite(speed):
            return
        memory.time_s, memory.speed_mps = time_s, speed
        moves = speed > STANDS_MPS or time_s - self._way.memory.moved_s < FRESH_S
        before_s = memory.rows[-1][0] if memory.rows else -1e9
        if moves and time_s - before_s >= EVERY_S:
            memory.rows.append([time_s, speed, _course(fix), smeared])
            if len(memory.rows) > MOST:
                del memory.rows[:DROPPED]

    def _displaced(self, fix: GnssFix, time_s: float) -> tuple[float, float]:
        """Speed of the displacement over the last seconds, NaN without, and its middle."""
        places = self.memory.places
        places.append([time_s, fix.latitude_deg, fix.longitude_deg])
        while len(places) > 2 and time_s - places[1][0] >= SMEARED_S:
            del places[0]
        before_s, latitude_deg, longitude_deg = places[0]
        dt_s = time_s - before_s
        if not SMEARED_S <= dt_s < 2.0 * SMEARED_S:
            return math.nan, time_s
        north = math.radians(fix.latitude_deg - latitude_deg)
        east = math.radians(fix.longitude_deg - longitude_deg)
        east *= math.cos(math.radians(fix.latitude_deg))
        return METRES_A_RADIAN * math.hypot(north, east) / dt_s, time_s - 0.5 * dt_s

    def newer(self, time_s: float) -> bool:
        """Whether there is a fix in motion since then."""
        return bool(self.memory.rows) and self.memory.rows[-1][0] > time_s

    def columns(self) -> Fixes:
        """All that are kept."""
        return Fixes(*np.array(self.memory.rows).T)


def _speed(fix: GnssFix) -> float | None:
    """Speed over ground, None if the receiver gives none."""
    if fix.HasField("vel_n_mps") and fix.HasField("vel_e_mps"):
        return math.hypot(fix.vel_n_mps, fix.vel_e_mps)
    return fix.speed_mps if measures_speed(fix) else None


def _course(fix: GnssFix) -> float:
    """Course of the antenna as a yaw, NaN where there is none."""
    if fix.HasField("vel_n_mps") and fix.HasField("vel_e_mps"):
        return math.atan2(fix.vel_n_mps, fix.vel_e_mps)
    if fix.speed_mps > 0.0 and fix.course_std_deg < NO_COURSE_DEG:
        return math.radians(90.0 - fix.course_deg)
    return math.nan
