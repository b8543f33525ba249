"""The IMU levelled: turning about the vertical, force ahead, and the slope of the way.

Upright in the case is the mean specific force of the whole ride: its accelerations cancel, for it
begins and ends at a stand. Ahead is where the wheels accelerate to, by the regression that the
check of the configuration makes (`consistency.mounting`). The slope is what the force ahead has
beyond the wheels' acceleration; the accelerometer's bias and what the mounting leaves are one
constant in it, which the heights of the fixes tell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.material import MEAN_S, FixColumns, Inertial, Ride
from tramstream.analysis.odometry.ways import Way, gathered, smooth
from tramstream.attitude import C_bv_of
from tramstream.processors.consistency.mounting import Mounting, MountingMemory, turn_upright

Array = NDArray[np.float64]

GRAVITY_MPS2 = 9.81
STEEPEST = 0.12
"""Of a slope as its sine; more is a slip of the wheels, or a kerb."""
SLOPE_S = 5.0
"""The slope is the median over so long: a slip is shorter."""
CANT_S = 1.5
ACCELERATION_S = 1.0


class Level(NamedTuple):
    """The ride by its IMU, one row a mean."""

    time_s: Array
    turned_rad: Array
    """Yaw since the beginning, less the bias at stands."""
    force_mps2: Array
    """Ahead, level."""
    slope_rad: Array
    """Uphill positive along x."""
    cant_rad: Array
    """Roll, right side down positive, but for a constant."""
    turn_deg: float
    """How far the case is turned about the vertical against what is configured."""
    turn_std_deg: float
    stands: int
    """That the gyroscope's bias was taken from."""

    @property
    def driving_mps2(self) -> Array:
        """Force ahead without the slope's."""
        return self.force_mps2 - GRAVITY_MPS2 * np.sin(self.slope_rad)


def levelled(ride: Ride, imu: Inertial, way: Way) -> Level:
    """Level the IMU, whose stamps are on the wheels' clock.

    Parameters
    ----------
    ride : Ride
    imu : Inertial
    way : Way
        Of the wheels.
    """
    C_vb = C_bv_of(ride.vehicle.imu).T
    force_v = imu.force_mps2 @ C_vb.T
    up = force_v.mean(axis=0)
    level = turn_upright(up / max(float(np.linalg.norm(up)), 1e-9))
    force = force_v @ level.T
    rate = (imu.rate_radps @ C_vb.T @ level.T)[:, 2]
    speed = way.speed(imu.time_s)
    standing = way.standing(imu.time_s)
    bias, stands = _bias(imu.time_s, rate, standing)
    step = np.diff(imu.time_s, prepend=imu.time_s[0])
    step = np.where(step < 10 * MEAN_S, step, 0.0)
    mean = rate - bias
    turned = np.cumsum(step * 0.5 * (mean + np.concatenate([mean[:1], mean[:-1]])))
    angle, std = _turn(ride, imu, way)
    ahead = force[:, 0] * np.cos(angle) + force[:, 1] * np.sin(angle)
    aside = force[:, 1] * np.cos(angle) - force[:, 0] * np.sin(angle) - speed * mean
    more = _lever(ride, imu.time_s, mean)
    ahead, aside = ahead + more[0], aside + more[1]
    slope = _slope(imu.time_s, ahead, speed, ride.fixes, way)
    return Level(
        imu.time_s,
        turned,
        ahead,
        slope,
        _cant(aside),
        float(np.degrees(angle)),
        float(np.degrees(std)),
        stands,
    )


def _bias(time_s: Array, rate: Array, standing: NDArray[np.bool_]) -> tuple[Array, int]:
    """The gyroscope's bias at stands, straight between them; nothing without any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], standing.astype(int), [0]])))
    at, value = [], []
    for begin, end in edges.reshape(-1, 2).tolist():
        if (end - begin) * MEAN_S > 2.0:
            at.append(float(time_s[begin:end].mean()))
            value.append(float(rate[begin:end].mean()))
    if not at:
        return np.zeros(len(time_s)), 0
    return np.interp(time_s, at, value), len(at)


def _lever(ride: Ride, time_s: Array, rate: Array) -> tuple[Array, Array]:
    """What a case beside the point that does not slip feels less in curves: ahead, to the left."""
    known = ride.vehicle.imu
    if known is None:
        return np.zeros(len(time_s)), np.zeros(len(time_s))
    x, y, _ = known.lever_arm_m
    x += ride.vehicle.ekf.pivot_m
    change = np.gradient(smooth(rate, 5), time_s)
    return rate**2 * x + change * y, rate**2 * y - change * x


def _cant(aside: Array) -> Array:
    """Roll by the force to the left that is not the curve's; upright is what is most often."""
    stride = max(round(0.25 / MEAN_S), 1)
    thin = smooth(aside, 2 * stride + 1)[::stride]
    size = round(CANT_S / (stride * MEAN_S)) | 1
    padded = np.pad(thin, size // 2, mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, size), axis=1)
    at = np.arange(len(aside))
    sine = np.interp(at, at[::stride], median - np.median(median)) / GRAVITY_MPS2
    found: Array = np.arcsin(np.clip(sine, -STEEPEST, STEEPEST))
    return found


def _turn(ride: Ride, imu: Inertial, way: Way) -> tuple[float, float]:
    """How far the case is turned about the vertical, as the check of the configuration finds it."""
    if ride.vehicle.imu is None:
        return 0.0, np.inf
    judge = Mounting(ride.vehicle.imu, MountingMemory())
    course = way.course()
    for end_s, mean, still in gathered(imu, way):
        judge.take(end_s, mean, still)
        if not still:
            judge.drive(course)
    found = judge.turn()
    return (0.0, np.inf) if found is None else (found.angle_rad, found.std_rad)


def _slope(time_s: Array, ahead: Array, speed: Array, fixes: FixColumns, way: Way) -> Array:
    """Slope along the way; its constant is that which the heights of the fixes want."""
    window = round(ACCELERATION_S / MEAN_S)
    a = np.gradient(smooth(speed, window), time_s)
    sine = (smooth(smooth(ahead, window), window) - smooth(a, window)) / GRAVITY_MPS2
    stride = max(round(0.5 / MEAN_S), 1)
    thin = np.clip(sine[::stride], -10 * STEEPEST, 10 * STEEPEST)
    size = round(SLOPE_S / (stride * MEAN_S)) | 1
    padded = np.pad(thin, size // 2, mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, size), axis=1)
    constant = float(np.median(median))
    sine = np.interp(time_s, time_s[::stride], median)
    constant = _constant(time_s, sine, fixes, way, constant)
    return np.arcsin(np.clip(sine - constant, -STEEPEST, STEEPEST))


def _constant(time_s: Array, sine: Array, fixes: FixColumns, way: Way, otherwise: float) -> float:
    """What of the sine is no slope: climb by it against the heights, robustly."""
    good = np.isfinite(fixes.p_l[:, 2]) if len(fixes.time_s) else np.zeros(0, bool)
    good &= fixes.up_std_m < 50.0
    if good.sum() < 30:
        return otherwise
    gone = way.at(time_s)
    climb = np.concatenate([[0.0], np.cumsum(sine[1:] * np.diff(gone))])
    at_s, height = fixes.time_s[good], fixes.p_l[good, 2]
    s, z = np.interp(at_s, time_s, gone), np.interp(at_s, time_s, climb)
    # Straight up in the tangent plane the Earth falls away by d²/2r.
    height = height + (fixes.p_l[good, :2] ** 2).sum(axis=1) / (2 * 6.371e6)
    A = np.stack([s, np.ones_like(s)], axis=1)
    weight = np.ones(len(s))
    found = np.zeros(2)
    for _ in range(5):
        W = A * weight[:, None]
        N = A.T @ W
        if np.linalg.cond(N) > 1e14:
            return otherwise
        found = np.linalg.solve(N, W.T @ (z - height))
        off = np.abs(z - height - A @ found)
        weight = 1.0 / np.maximum(1.0, off / max(2.0 * float(np.median(off)), 1e-3))
    return float(found[0])
