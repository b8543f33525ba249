"""How far the clocks of IMU, wheels and receiver are apart, by one motion that all three see.

A coarse search over ±`FARTHEST_S` compares two series that should be one but for a delay, by their
normalised product; Gauss and Newton go on from the best, with the deviation that the misfit gives.

    wheels and IMU        the wheels' acceleration and the force ahead
    fixes and wheels      the speed over ground of both
    fixes and IMU         rate of the course and rate about the vertical, in curves

Two differences describe three clocks; the third comparison says which clock stands apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.material import FixColumns
from tramstream.analysis.odometry.ways import Way, smooth
from tramstream.estimation.kalman import Array as Columns

Array = NDArray[np.float64]

FARTHEST_S = 15.0
GRID_S = 0.1
OFF_S = 0.5
"""Clocks that are further apart are named; less is a delay."""
LEAST_LIKENESS = 0.5
"""Of two series at their best delay, without which nothing is said."""
PASSES = 6
CLIP = 3.0


class Delay(NamedTuple):
    """By how much the second series is behind the first."""

    delay_s: float
    std_s: float
    likeness: float
    """Correlation at the best delay; 0 where nothing could be compared."""

    @property
    def clear(self) -> bool:
        return self.likeness > LEAST_LIKENESS and bool(np.isfinite(self.delay_s))


UNKNOWN = Delay(np.nan, np.inf, 0.0)


def compared(time_s: Array, first: Array, at_s: Array, second: Array, white: float = 1.0) -> Delay:
    """Find τ with second(t) ≈ c · first(t − τ) + constant.

    Parameters
    ----------
    time_s, first : ndarray, shape (n,)
        On a grid that is finer than the motion.
    at_s, second : ndarray, shape (m,)
        Any instants.
    white : float
        Readings of `second` that are worth one: more than 1 where neighbours share their error.
    """
    good = np.isfinite(second)
    at_s, second = at_s[good], second[good]
    if len(time_s) < 100 or len(at_s) < 30 or not np.ptp(first) > 0.0 or not np.ptp(second) > 0.0:
        return UNKNOWN
    delays = np.arange(-FARTHEST_S, FARTHEST_S + 0.5 * GRID_S, GRID_S)
    alike = [_likeness(time_s, first, at_s - tau, second) for tau in delays.tolist()]
    best = int(np.argmax(alike))
    if best in (0, len(delays) - 1) or alike[best] < 0.3:
        return UNKNOWN
    return _refined(float(delays[best]), time_s, first, at_s, second, white)


def _likeness(time_s: Array, first: Array, at_s: Array, second: Array) -> float:
    inside = (at_s > time_s[0]) & (at_s < time_s[-1])
    if inside.sum() < 30:
        return 0.0
    a = np.interp(at_s[inside], time_s, first)
    b = second[inside]
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / scale if scale > 0.0 else 0.0


def _refined(
    tau: float, time_s: Array, first: Array, at_s: Array, second: Array, white: float
) -> Delay:
    step = 0.5 * GRID_S
    std = np.inf
    for _ in range(PASSES):
        before, here, after = (
            np.interp(at_s - tau + each, time_s, first) for each in (-step, 0.0, step)
        )
        slope = (before - after) / (2.0 * step)
        A = np.stack([slope, here, np.ones_like(here)], axis=1)
        weight = np.ones(len(here))
        for _ in range(4):
            W = A * weight[:, None]
            N = A.T @ W
            if np.linalg.cond(N) > 1e14:
                return UNKNOWN
            x = np.linalg.solve(N, W.T @ second)
            off = second - A @ x
            spread = max(1.4826 * float(np.median(np.abs(off))), 1e-9)
            weight = np.minimum(1.0, CLIP * spread / np.maximum(np.abs(off), 1e-12))
        moved = float(np.clip(x[0] / x[1], -GRID_S, GRID_S)) if x[1] > 0.0 else np.nan
        if not np.isfinite(moved):
            return UNKNOWN
        tau += moved
        std = spread * float(np.sqrt(white * np.linalg.inv(N)[0, 0])) / float(x[1])
    return Delay(tau, std, _likeness(time_s, first, at_s - tau, second))


# Pairs --------------------------------------------------------------------------------------------
def imu_behind_wheels(way: Way, time_s: Array, driving_mps2: Array) -> Delay:
    """By how much the stamps of the IMU are later than those of the wheels.

    The force ahead, as far as it is not the slope's, adds up to a speed; of that and of the wheels'
    what lasts for ten seconds is left out.
    """
    first, last = way.span
    grid = np.arange(max(time_s[0], first) + 1.0, min(time_s[-1], last) - 1.0, 0.05)
    if len(grid) < 1000:
        return UNKNOWN
    force = np.interp(grid, time_s, driving_mps2)
    felt = _fast(np.cumsum(0.025 * (force + np.concatenate([force[:1], force[:-1]]))), 0.05)
    v = way.speed(grid, 0.2)
    moves = (smooth(np.abs(v), 101) > 0.5) & way.known(grid)
    if moves.sum() < 500:
        return UNKNOWN
    # Derivatives are taken of the force's speed, which is the smoother one.
    wheels = compared(grid, felt, grid[moves], _fast(v, 0.05)[moves], white=21.0)
    return wheels._replace(delay_s=-wheels.delay_s)


def fixes_behind_wheels(way: Way, fixes: FixColumns) -> Delay:
    """By how much the stamps of the fixes are later than those of the wheels."""
    at_s, speed, over_s = fix_speeds(fixes)
    if not len(at_s):
        return UNKNOWN
    first, last = way.span
    grid = np.arange(first + 1.0, last - 1.0, 0.1)
    wheels = np.abs(way.speed(grid, max(over_s, 0.4)))
    return compared(grid, wheels, at_s, speed, white=1.0 if over_s == 0.0 else 2.0)


def fixes_behind_imu(time_s: Array, turned_rad: Array, fixes: FixColumns) -> Delay:
    """By how much the stamps of the fixes are later than those of the IMU, by curves."""
    at_s, rate = _course_rates(fixes)
    if len(at_s) < 30:
        return UNKNOWN
    grid = np.arange(time_s[0], time_s[-1], 0.1)
    yaw = np.interp(grid, time_s, turned_rad)
    rates = smooth(np.gradient(yaw, grid), 31)
    return compared(grid, rates, at_s, rate, white=3.0)


def fix_speeds(fixes: FixColumns) -> tuple[Array, Array, float]:
    """Instants and speeds over ground; the span of displacements where there is no velocity."""
    given = np.isfinite(fixes.velocity_l)
    if given.sum() > 0.5 * len(fixes.time_s):
        return fixes.time_s[given], np.abs(fixes.velocity_l[given]), 0.0
    over_s = 3.0
    p = fixes.p_l[:, 0] + 1j * fixes.p_l[:, 1]
    right = np.searchsorted(fixes.time_s, fixes.time_s + over_s - 1e-3)
    good = right < len(fixes.time_s)
    left = np.flatnonzero(good)
    right = right[good]
    dt = fixes.time_s[right] - fixes.time_s[left]
    near = np.abs(dt - over_s) < 0.3
    left, right, dt = left[near], right[near], dt[near]
    middle = 0.5 * (fixes.time_s[left] + fixes.time_s[right])
    return middle, np.abs(p[right] - p[left]) / dt, over_s


def _course_rates(fixes: FixColumns) -> tuple[Array, Array]:
    """Rate of the course over three seconds, where the fixes move."""
    p = fixes.p_l[:, 0] + 1j * fixes.p_l[:, 1]
    n = len(p)
    if n < 10:
        return np.empty(0), np.empty(0)
    span = np.searchsorted(fixes.time_s, fixes.time_s + 3.0 - 1e-3)
    given = bool(np.isfinite(fixes.velocity_l).mean() > 0.5)
    at, rate = [], []
    v = fixes.velocity_l
    for k in range(n):
        m = int(span[k])
        if m >= n or abs(fixes.time_s[m] - fixes.time_s[k] - 3.0) > 0.3:
            continue
        if given:
            one, two = v[k], v[m]
        else:
            q = int(span[m])
            if q >= n or abs(fixes.time_s[q] - fixes.time_s[m] - 3.0) > 0.3:
                continue
            one, two = (p[m] - p[k]) / 3.0, (p[q] - p[m]) / 3.0
        if not min(abs(one), abs(two)) > 3.0:
            continue
        at.append(0.5 * (fixes.time_s[k] + fixes.time_s[m]) + (0.0 if given else 1.5))
        rate.append(float(np.angle(two / one)) / 3.0)
    return np.array(at), np.array(rate)


def _fast(values: Columns, step_s: float) -> Array:
    """What of a series does not last: less its mean over ten seconds."""
    return values - smooth(values, round(10.0 / step_s) | 1)


class Apart(NamedTuple):
    """The clock that stands apart from the two others."""

    sensor: str
    """`imu`, `wheels`, `gnss`; empty: none, or nobody can tell."""
    offset_s: float
    """Its stamps are later than the truth by so much."""
    std_s: float


NONE = Apart("", 0.0, np.inf)


def apart(imu: Delay, fixes: Delay, fixes_imu: Delay) -> Apart:
    """Which clock is off, by the three comparisons.

    Parameters
    ----------
    imu, fixes : Delay
        Behind the wheels.
    fixes_imu : Delay
        Fixes behind the IMU; where it is not clear, the two others decide.
    """

    def off(delay: Delay) -> bool:
        return delay.clear and abs(delay.delay_s) > OFF_S

    if off(fixes) and not off(imu):
        return Apart("gnss", fixes.delay_s, fixes.std_s)
    if off(imu) and not off(fixes):
        return Apart("imu", imu.delay_s, imu.std_s)
    if off(imu) and off(fixes):
        # An antenna ahead of the pivot turns into curves earlier, by up to a second.
        if fixes_imu.clear and abs(fixes_imu.delay_s) > 0.5 * abs(fixes.delay_s):
            return Apart("", np.nan, np.inf)
        return Apart("wheels", -fixes.delay_s, fixes.std_s)
    return NONE
