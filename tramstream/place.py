"""From positions in `l` to geodetic ones and the level of the place, a hundred times a second.

The exact conversion (`geodesy`) takes tens of microseconds. A vehicle moves a metre or two between
estimates, so it is done once every `STEP_M` and continued from there by the radii of curvature.
Against the exact one that is good to 0.1 mm.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream import geodesy
from tramstream.geodesy import LocalLevel

STEP_M = 20.0


class Place(NamedTuple):
    """A point, and how its own level stands to that of `l`."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    convergence_rad: float
    """Yaw against east of the place is yaw in `l` minus this."""
    east_tilt_rad: float
    """By which the place's up leans east and north of that of `l`."""
    north_tilt_rad: float


class Places:
    """Places near the last exact one, in one frame `l`."""

    def __init__(self, level: LocalLevel) -> None:
        self.level = level
        self._at = (math.inf, math.inf, math.inf)

    def _move(self, east: float, north: float, up: float) -> None:
        latitude, longitude, height = self.level.to_geodetic((east, north, up)).tolist()
        here = LocalLevel(latitude, longitude, height)
        self._C = (here.C_le @ self.level.C_le.T).tolist()  # of the place's level from l
        self._geodetic = latitude, longitude, height
        sin2 = math.sin(latitude) ** 2
        w = math.sqrt(1.0 - geodesy.E2 * sin2)
        self._north_radius = geodesy.SEMI_MAJOR_M * (1.0 - geodesy.E2) / w**3 + height
        self._east_radius = geodesy.SEMI_MAJOR_M / w + height
        self._cos, self._tan = math.cos(latitude), math.tan(latitude)
        self._at = (east, north, up)

    def at(self, east: float, north: float, up: float) -> Place:
        """Place of a position in `l`, m."""
        e, n, u = east - self._at[0], north - self._at[1], up - self._at[2]
        if not (abs(e) < STEP_M and abs(n) < STEP_M and abs(u) < STEP_M):
            self._move(east, north, up)
            e = n = u = 0.0
        (c00, c01, c02), (c10, c11, c12), (c20, c21, c22) = self._C
        e, n, u = (
            c00 * e + c01 * n + c02 * u,
            c10 * e + c11 * n + c12 * u,
            c20 * e + c21 * n + c22 * u,
        )
        latitude, longitude, height = self._geodetic
        dn = (n - 0.5 * e * e * self._tan / self._east_radius) / self._north_radius
        de = e / (self._east_radius * self._cos) * (1.0 + n * self._tan / self._north_radius)
        height += u + 0.5 * (e * e / self._east_radius + n * n / self._north_radius)
        return Place(
            math.degrees(latitude + dn),
            math.degrees(longitude + de),
            height,
            math.atan2(c01, c00) + e * self._tan / self._east_radius,
            c20 + e / self._east_radius,
            c21 + n / self._north_radius,
        )

    def snapshot(self) -> list[float]:
        """Where the last exact conversion was: from it all others follow to the last digit."""
        return list(self._at)

    def restore(self, at: list[float]) -> None:
        if math.isfinite(sum(at)):
            self._move(*at)
