"""From states in `l` to what is published, compiled: geodetic place, its own level, deviations.

The exact conversion (`geodesy`) takes tens of microseconds. A vehicle moves a metre or two between
estimates, so it is done once every `STEP_M` and continued from there by the radii of curvature.
Against the exact one that is good to 0.1 mm.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream import geodesy
from tramstream.geodesy import LocalLevel
from tramstream.kernels import Array, compiled

STEP_M = 20.0
LATITUDE, LONGITUDE, HEIGHT, ROLL, PITCH, YAW = range(6)
"""Slots of what `Places.describe` gives: degrees, m, rad; then deviations along and across the
vehicle's x axis, up, of speed and yaw; then the greatest of any direction; then the upper triangle
of the covariance."""
ALONG, ACROSS, UP, SPEED, YAW_STD, WORST, COVARIANCE = range(6, 13)
SIZE = COVARIANCE + 28
NEAR, C, GEODETIC, RADII = 0, 3, 12, 15
"""In the constants: the last exact position, turn into its level, geodetic place, radii."""


@compiled
def _describe(near: Array, motion: Array, P: Array, out: Array) -> None:
    e, n, u = motion[0] - near[0], motion[1] - near[1], motion[2] - near[2]
    C = near[3:12]
    e, n, u = (
        C[0] * e + C[1] * n + C[2] * u,
        C[3] * e + C[4] * n + C[5] * u,
        C[6] * e + C[7] * n + C[8] * u,
    )
    north, east, cos_latitude, tan_latitude = near[15], near[16], near[17], near[18]
    dn = (n - 0.5 * e * e * tan_latitude / east) / north
    de = e / (east * cos_latitude) * (1.0 + n * tan_latitude / north)
    out[0] = math.degrees(near[12] + dn)
    out[1] = math.degrees(near[13] + de)
    out[2] = near[14] + u + 0.5 * (e * e / east + n * n / north)
    # North of the place, and its up, lean against those of l.
    cos, sin = math.cos(motion[6]), math.sin(motion[6])
    lean_east, lean_north = C[6] + e / east, C[7] + n / north
    out[3] = motion[4] + lean_north * cos - lean_east * sin
    out[4] = motion[5] - lean_east * cos - lean_north * sin
    yaw = motion[6] - math.atan2(C[1], C[0]) - e * tan_latitude / east
    out[5] = yaw - 2.0 * math.pi * math.floor(yaw / (2.0 * math.pi) + 0.5)
    ee, en, nn = P[0, 0], P[0, 1], P[1, 1]
    out[6] = math.sqrt(max(cos * cos * ee + 2.0 * cos * sin * en + sin * sin * nn, 0.0))
    out[7] = math.sqrt(max(sin * sin * ee - 2.0 * cos * sin * en + cos * cos * nn, 0.0))
    out[8] = math.sqrt(max(P[2, 2], 0.0))
    out[9] = math.sqrt(max(P[3, 3], 0.0))
    out[10] = math.sqrt(max(P[6, 6], 0.0))
    out[11] = math.sqrt(0.5 * (ee + nn) + math.hypot(0.5 * (ee - nn), en))
    k = 12
    for i in range(7):
        for j in range(i, 7):
            out[k] = P[i, j]
            k += 1


class Places:
    """Places near the last exact one, in one frame `l`."""

    def __init__(self, level: LocalLevel) -> None:
        self.level = level
        self._near = np.zeros(19)
        self._at = (math.inf, math.inf, math.inf)
        self._out = np.zeros(SIZE)

    def _move(self, east: float, north: float, up: float) -> None:
        latitude, longitude, height = self.level.to_geodetic((east, north, up)).tolist()
        here = LocalLevel(latitude, longitude, height)
        w = math.sqrt(1.0 - geodesy.E2 * math.sin(latitude) ** 2)
        near = self._near
        near[NEAR:C] = east, north, up
        near[C:GEODETIC] = (here.C_le @ self.level.C_le.T).ravel()
        near[GEODETIC:RADII] = latitude, longitude, height
        near[RADII:] = (
            geodesy.SEMI_MAJOR_M * (1.0 - geodesy.E2) / w**3 + height,
            geodesy.SEMI_MAJOR_M / w + height,
            math.cos(latitude),
            math.tan(latitude),
        )
        self._at = (east, north, up)

    def describe(self, motion: Array, covariance: Array) -> list[float]:
        """Give a state in `l` as it is published; see the slots above.

        Parameters
        ----------
        motion : ndarray, shape (7,)
            East, north, up, speed, roll, pitch, yaw in `l`; finite.
        covariance : ndarray, shape (7, 7)
        """
        east, north, up = motion[:3].tolist()
        at = self._at
        if not (
            abs(east - at[0]) < STEP_M and abs(north - at[1]) < STEP_M and abs(up - at[2]) < STEP_M
        ):
            self._move(east, north, up)
        _describe(self._near, motion, covariance, self._out)
        found: list[float] = self._out.tolist()
        return found

    def snapshot(self) -> list[float]:
        """Where the last exact conversion was: from it all others follow to the last digit."""
        return list(self._at)

    def restore(self, at: list[float]) -> None:
        if math.isfinite(sum(at)):
            self._move(*at)
