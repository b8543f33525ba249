"""From states in `l` to what is published, compiled: geodetic place, its own level, deviations.

The exact conversion (`geodesy`) takes tens of microseconds. A vehicle moves a metre or two between
estimates, so it is done once every `STEP_M` and continued from there by the radii of curvature.
Against the exact one that is good to 0.1 mm.

All numbers but the place itself are published with the 24 bits of a single, about seven digits: the
other 29 bits of a double are noise that no compression takes out of a record, 60 MB an hour.

Equations: docs/theory.md, sections 2.2 and 13.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from math import isnan

import numpy as np

from tramstream import geodesy
from tramstream.estimation import encode
from tramstream.estimation.encode import Bytes, fill
from tramstream.estimation.kalman import Array, compiled, sound
from tramstream.estimation.localiser import (
    ACCELERATION,
    COVARIANCE,
    HEADING_UNKNOWN,
    LEVEL_ERROR,
    LEVEL_STD,
    YAW_RATE,
    Estimate,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import MotionState

STEP_M = 20.0
TRIANGLE = 28
FIELDS = {
    "latitude_deg": 1,
    "longitude_deg": 1,
    "height_ellipsoid_m": 1,
    "speed_mps": 1,
    "acceleration_mps2": 1,
    "roll_rad": 1,
    "pitch_rad": 1,
    "yaw_rad": 1,
    "yaw_rate_radps": 1,
    "along_std_m": 1,
    "across_std_m": 1,
    "up_std_m": 1,
    "speed_std_mps": 1,
    "yaw_std_rad": 1,
    "protection_along_m": 1,
    "protection_across_m": 1,
    "level_error_rad": 1,
    "level_std_rad": 1,
    "covariance": TRIANGLE,
}
"""Numbers of a `MotionState`, in the order in which `_describe` finds them."""
_EMPTY, _PLACES = encode.doubles(MotionState, FIELDS)
SIZE = len(_PLACES)
NEAR, C, GEODETIC, RADII, CONSTANTS = 0, 3, 12, 15, 19
"""In the constants: the last exact position, turn into its level, geodetic place, radii."""
DESCRIBED, UNSOUND, AWAY = range(3)
"""What came of it: all is there; something is no number; the last exact position is too far off."""


@compiled
def _describe(
    near: Array, values: Array, quantile: float, any_heading: bool, out: Array, encoded: Bytes
) -> int:
    motion, P = values[:ACCELERATION], values[COVARIANCE:].reshape((7, 7))
    if not sound(motion, P):
        return UNSOUND
    e, n, u = motion[0] - near[0], motion[1] - near[1], motion[2] - near[2]
    if not (abs(e) < STEP_M and abs(n) < STEP_M and abs(u) < STEP_M):
        return AWAY
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
    out[3], out[4] = motion[3], values[ACCELERATION]
    # North of the place, and its up, lean against those of l.
    cos, sin = math.cos(motion[6]), math.sin(motion[6])
    lean_east, lean_north = C[6] + e / east, C[7] + n / north
    out[5] = motion[4] + lean_north * cos - lean_east * sin
    out[6] = motion[5] - lean_east * cos - lean_north * sin
    yaw = motion[6] - math.atan2(C[1], C[0]) - e * tan_latitude / east
    out[7] = yaw - 2.0 * math.pi * math.floor(yaw / (2.0 * math.pi) + 0.5)
    out[8] = values[YAW_RATE]
    ee, en, nn = P[0, 0], P[0, 1], P[1, 1]
    if any_heading:
        out[9] = out[10] = math.sqrt(0.5 * (ee + nn) + math.hypot(0.5 * (ee - nn), en))
    else:
        out[9] = math.sqrt(max(cos * cos * ee + 2.0 * cos * sin * en + sin * sin * nn, 0.0))
        out[10] = math.sqrt(max(sin * sin * ee - 2.0 * cos * sin * en + cos * cos * nn, 0.0))
    out[11] = math.sqrt(max(P[2, 2], 0.0))
    out[12] = math.sqrt(max(P[3, 3], 0.0))
    out[13] = math.sqrt(max(P[6, 6], 0.0))
    out[14], out[15] = quantile * out[9], quantile * out[10]
    out[16], out[17] = values[LEVEL_ERROR], values[LEVEL_STD]
    k = 18
    for i in range(7):
        for j in range(i, 7):
            out[k] = P[i, j]
            k += 1
    for k in range(3, SIZE):
        out[k] = np.float32(out[k])
    fill(encoded, _PLACES, out)
    return DESCRIBED


def _nowhere() -> Array:
    near = np.zeros(CONSTANTS)
    near[NEAR:C] = math.inf
    return near


@dataclass
class PlacesMemory:
    """Where the last exact conversion was: from it all others follow to the last digit."""

    near: Array = field(default_factory=_nowhere)
    """Position in `l`, turn into its own level, geodetic place, radii; shape (19,)."""


class Places:
    """Places near the last exact one, in one frame `l`.

    Parameters
    ----------
    level : LocalLevel
    memory : PlacesMemory or None
        Part of its owner's memory; one of its own by default.
    """

    def __init__(self, level: LocalLevel, memory: PlacesMemory | None = None) -> None:
        self.level = level
        self.memory = PlacesMemory() if memory is None else memory
        self._found = np.zeros(SIZE)
        self._encoded = _EMPTY.copy()

    def _move(self, east: float, north: float, up: float) -> None:
        latitude, longitude, height = self.level.to_geodetic((east, north, up)).tolist()
        here = LocalLevel(latitude, longitude, height)
        w = math.sqrt(1.0 - geodesy.E2 * math.sin(latitude) ** 2)
        near = self.memory.near
        near[NEAR:C] = east, north, up
        near[C:GEODETIC] = (here.C_le @ self.level.C_le.T).ravel()
        near[GEODETIC:RADII] = latitude, longitude, height
        near[RADII:CONSTANTS] = (
            geodesy.SEMI_MAJOR_M * (1.0 - geodesy.E2) / w**3 + height,
            geodesy.SEMI_MAJOR_M / w + height,
            math.cos(latitude),
            math.tan(latitude),
        )

    def describe(self, estimate: Estimate, quantile: float) -> MotionState | None:
        """Give the numbers of an estimate as they are published; None if one is no number.

        Parameters
        ----------
        quantile : float
            Protection levels over deviations along and across the vehicle's x axis. While its
            heading is not known, those are the greatest of any direction.
        """
        any_heading = estimate.mode == HEADING_UNKNOWN
        numbers = self.memory.near, estimate.values, quantile, any_heading, self._found
        encoded = self._encoded
        found = _describe(*numbers, encoded)
        if found == AWAY:
            self._move(*estimate.p_l)
            found = _describe(*numbers, encoded)
        if found != DESCRIBED:
            return None
        message = MotionState.FromString(encoded.tobytes())
        if isnan(estimate.values.item(LEVEL_ERROR)):
            message.ClearField("level_error_rad")
            message.ClearField("level_std_rad")
        return message
