"""What makes a ride useless, told before any figure; and a mounting that changed on the way.

Sensors are asked first (dead, stuck, clipped), then the ride (fixes, motion), then whether forces,
rates and fixes speak of one right-handed frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tramstream.analysis.calibration.samples import AXES
from tramstream.analysis.mounting.coarse import Coarse
from tramstream.analysis.mounting.drive import NODE_S, Array, Drive
from tramstream.analysis.mounting.read import Readings

STUCK_S = 30.0
"""Means of inertial readings that are one number for so long are no measurements."""
CLIPPED_SHARE = 0.001
"""Share of an axis' readings that are its least or greatest: of a Gaussian it is one of all."""
LEAST_WAY_M = 100.0
LEAST_MPS = 2.0
RATE_OFF = 0.3
"""Slope of the rate about up against that of the course is 1 but for this."""
SIZE_OFF = 0.3
"""Of the force against acceleration and curve."""
MOVED_RAD = np.radians(1.5)
"""A turn of the case that is told by means of force alone; a slope that the fixes' height misses
looks like half a degree."""
MOVED_TIMES = 25.0
"""How much better two mountings must explain the force than one, in times of the scatter."""
ALIKE_S = 8.0
"""So long what the regression leaves is alike: slopes of the fixes' heights are means of that."""
MOVED_SIGMAS = 8.0
"""Straight rides with the work's noise came to 5.5, a case that was moved by 4° to 12
(`tests/analysis/test_mounting.py`)."""
LEAST_SIZE = 0.5
"""Of a regression's forward, which is 1 where the ride tells it."""
_EACH_S = 1.0
_EDGE_S = 40.0


class Moved(NamedTuple):
    """The case sits otherwise from a time on."""

    at_s: float
    angle_rad: float


def sensor_troubles(readings: Readings) -> list[str]:
    """Dead, stuck and clipped axes, a sentence each."""
    found = []
    values = np.concatenate([readings.omega_b, readings.f_b], axis=1)
    for axis, name in enumerate(AXES):
        if readings.lowest[axis] == readings.highest[axis]:
            found.append(f"{name} reads {readings.lowest[axis]:g} throughout: it is dead")
            continue
        run_s, begin_s = _longest_run(values[:, axis])
        if run_s >= STUCK_S:
            found.append(f"{name} is stuck from {begin_s:.0f} s on, for {run_s:.0f} s")
        elif readings.ends[axis] > max(CLIPPED_SHARE * readings.samples, 20):
            share = readings.ends[axis] / readings.samples
            found.append(
                f"{name} is clipped: {100 * share:.2g} % of its readings are "
                f"{readings.lowest[axis]:.4g} or {readings.highest[axis]:.4g}; choose a wider range"
            )
    return found


def _longest_run(values: Array) -> tuple[float, float]:
    """How long the means are one and the same number, and from when on, s."""
    same = np.concatenate([[0], (np.diff(values) == 0).astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(same)).reshape(-1, 2)
    if not len(edges):
        return 0.0, 0.0
    longest = int(np.argmax(edges[:, 1] - edges[:, 0]))
    first, end = edges[longest].tolist()
    return (end - first + 1) * NODE_S, first * NODE_S


def ride_trouble(drive: Drive, found: Coarse) -> str:
    """Why a ride cannot tell the mounting; empty if it can."""
    if len(drive.fixes.node) < 30:
        return "there are no fixes: without a receiver nothing says how the vehicle moves"
    kin = found.kinematics
    fast = kin.speed_mps[kin.moving]
    way_m = float(fast.sum()) * drive.dt_s
    if way_m < LEAST_WAY_M or not len(fast) or float(fast.max()) < LEAST_MPS:
        return "the vehicle does not move: standing tells two angles and not the third; drive"
    if not np.all(np.isfinite(found.C_vb)):
        return "the vehicle moves too little; drive a minute with halts and curves"
    if np.isfinite(found.rate_size) and abs(found.rate_size - 1) > RATE_OFF:
        return (
            f"the gyroscopes read {found.rate_size:.2f} times the turns of the course about the "
            "axis that the accelerometers call up: their axes are not those of the accelerometers, "
            "one is reversed, swapped or dead"
        )
    if found.handed < -0.5:
        return (
            "the case's axes are left-handed: braking and curves say opposite sides; two axes are "
            "swapped, or one is reversed"
        )
    if abs(found.size - 1) > SIZE_OFF:
        return (
            f"the accelerometers read {found.size:.2f} times what the vehicle's acceleration and "
            "curves press: an axis is swapped, dead or clipped, or fixes and IMU are of other times"
        )
    return ""


def moved(drive: Drive, found: Coarse) -> Moved | None:
    """Find where one mounting becomes another: the best cut of a regression of force on motion.

    f_b = (s' + g·slope) x + s ω_z y + g up: three columns of the mounting by least squares, before
    and after each second.
    """
    kin = found.kinematics
    each = max(round(_EACH_S / drive.dt_s), 1)
    omega_z = kin.omega_b @ found.C_vb[2]
    if drive.standing.sum() > 50:
        omega_z = omega_z - omega_z[drive.standing].mean()
    sign = np.where(found.reverse, -1.0, 1.0)
    fast = kin.speed_mps > 3.0
    slope = np.zeros(drive.length)
    if fast.sum() > 100:
        rows = np.flatnonzero(fast)
        slope = np.interp(np.arange(drive.length), rows, kin.vel_l[rows, 2] / kin.speed_mps[rows])
        width = max(round(8.0 / drive.dt_s), 1)
        slope = np.convolve(np.pad(slope, width, mode="edge"), np.ones(width) / width, "same")
        slope = slope[width:-width] * sign
    a = sign * kin.acceleration_mps2 + drive.gravity_mps2 * slope
    A = np.stack([a, sign * kin.speed_mps * omega_z, np.full(drive.length, drive.gravity_mps2)], 1)
    A, f = A[::each], kin.f_b[::each]
    AA = np.cumsum(A[:, :, None] * A[:, None, :], axis=0)
    Af = np.cumsum(A[:, :, None] * f[:, None, :], axis=0)
    ff = np.cumsum(np.sum(f * f, axis=1))
    edge = max(round(_EDGE_S / (each * drive.dt_s)), 3)
    if len(A) < 3 * edge:
        return None
    ridge = np.diag([1e-3, 1e-3, 1e-6])

    def fit(S: Array, b: Array, square: Array) -> tuple[Array, Array]:
        B: Array = np.asarray(np.linalg.solve(S + ridge, b), dtype=float)
        left: Array = np.asarray(square - np.sum(B * b, axis=(-2, -1)))
        return B, left

    rows = np.arange(edge, len(A) - edge)
    before, left = fit(AA[rows], Af[rows], ff[rows])
    after, right = fit(AA[-1] - AA[rows], Af[-1] - Af[rows], ff[-1] - ff[rows])
    _, whole = fit(AA[-1], Af[-1], ff[-1])
    split = left + right
    best = int(np.argmin(split))
    scatter = max(float(split[best]) / len(A), 1e-9)
    gained = (float(whole) - float(split[best])) / scatter
    cut = AA[rows[best]]
    parts = (before[best], cut), (after[best], AA[-1] - cut)
    tilt, turn = _angles(*parts)
    # What is left over is alike for some time: so many fewer readings tell each of the angles.
    left_over = scatter * ALIKE_S / _EACH_S
    tilt_std = math.sqrt(sum(left_over / float(S[2, 2]) for _, S in parts))
    turn_std = math.sqrt(sum(left_over / max(float(S[0, 0] + S[1, 1]), 1e-9) for _, S in parts))
    angle = math.hypot(
        tilt if tilt > MOVED_SIGMAS * tilt_std else 0.0,
        turn if turn > MOVED_SIGMAS * turn_std else 0.0,
    )
    if gained < MOVED_TIMES * 9 or angle < MOVED_RAD:
        return None
    return Moved(float(rows[best]) * each * drive.dt_s, angle)


def _angles(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[float, float]:
    """How far the up of two mountings is tilted, and how far they are turned besides.

    Each is three rows of a regression and its normal matrix. Departures and curves both say where
    forward is, each as much as there was of it: on a straight way the row of curves is chance.
    """
    turns: list[Array] = []
    ups: list[Array] = []
    for B, S in (one, other):
        up = B[2] / np.linalg.norm(B[2])
        departures, curves = float(S[0, 0]), float(S[1, 1])
        x = (departures * B[0] + curves * np.cross(B[1], up)) / max(departures + curves, 1e-9)
        x = x - up * (x @ up)
        size = float(np.linalg.norm(x))
        ups.append(up)
        if size >= LEAST_SIZE:
            x = x / size
            turns.append(np.stack([x, np.cross(up, x), up]))
    tilt = float(np.arccos(np.clip(ups[0] @ ups[1], -1, 1)))
    if len(turns) < len(ups):
        return tilt, 0.0
    whole = float(Rotation.from_matrix(turns[0] @ turns[1].T).magnitude())
    return tilt, math.sqrt(max(whole**2 - tilt**2, 0.0))
