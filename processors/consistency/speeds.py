"""Fixes against wheels and gyroscope: scale, delay, and where the antenna is, over two minutes.

With the wheels' speed v(t), the yaw ψ(t) by the gyroscope, and a receiver that says speed g and
course χ of its antenna, (l_x, l_y) from the point that does not slip sideways:

    g(t) = c |v(t − τ)| − l_y ω sgn v,        χ(t) = ψ(t − τ) + const + l_x ω/v

where the constant is another every quarter of a minute, for gyroscopes drift. c and τ are found
together: for each τ of a grid c by robust least squares, then by Gauss and Newton from the best.
Outliers weigh what three deviations weigh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tramstream.estimation.kalman import Array
from tramstream.processors.consistency.way import Course

DELAYS_S = np.arange(-20, 21) * 0.05
"""That are tried; fixes that are further behind do not reach the horizon, those further ahead are
not waited for."""
LEAST_FIXES = 15
LEAST_SPAN_S = 8.0
LEAST_WAY_M = 30.0
MOVING_MPS = 2.0
"""Of the fixes, from which they tell a scale."""
TURNING_MPS = 2.5
"""Of the wheels, from which the course tells a heading."""
CLIP = 3.0
PASSES = 4
"""Of reweighting."""
BLOCK_S = 15.0
"""So long the gyroscope keeps its heading; curves begin and end within."""
LEAST_SPREAD_PER_M = 0.02
"""Root of the summed squares of the curvature about its mean, without which nothing is said of the
antenna; how well it is known decides."""


class Fixes(NamedTuple):
    """Fixes as columns."""

    time_s: Array
    speed_mps: Array
    course_rad: Array
    """As a yaw; NaN where there is none."""
    smeared: Array
    """1 where the speed is that of a displacement over seconds."""


@dataclass(frozen=True)
class Speeds:
    """Fixes' speed against the wheels'."""

    factor: float
    """Fixes' over wheels'."""
    factor_std: float
    delay_s: float
    """By which the fixes' is later; NaN where that is not clear."""
    delay_std_s: float
    fixes: int
    fix_mps: float
    wheel_mps: float
    """In the median of fixes that move."""


@dataclass(frozen=True)
class Lever:
    """Where the antenna is by how it moves in curves; NaN where that is not clear."""

    forward_m: float
    forward_std_m: float
    left_m: float
    left_std_m: float


def compared(fixes: Fixes, path: Course) -> Speeds | None:
    """Hold the fixes' speed to the wheels'; None while that is not clear."""
    if len(path) < 2:
        return None
    delay_s, delay_std_s = _delay(fixes, path)
    shift_s = delay_s if np.isfinite(delay_s) else 0.0
    wheel = np.abs(path.rate(fixes.time_s - shift_s))
    moving = np.isfinite(wheel) & (fixes.speed_mps > MOVING_MPS) & (wheel > 0.0)
    if moving.sum() < LEAST_FIXES or np.ptp(fixes.time_s[moving]) < LEAST_SPAN_S:
        return None
    g, v = fixes.speed_mps[moving], wheel[moving]
    if g.mean() * np.ptp(fixes.time_s[moving]) < LEAST_WAY_M:
        return None
    ratio = np.log(g / v)
    factor = float(np.exp(np.median(ratio)))
    std = factor * _spread(ratio) / np.sqrt(len(ratio))
    medians = float(np.median(g)), float(np.median(v))
    return Speeds(factor, std, delay_s, delay_std_s, len(ratio), *medians)


def _delay(fixes: Fixes, path: Course) -> tuple[float, float]:
    """Delay of the fixes' speed and its deviation; NaN where they tell none."""
    nothing = np.nan, np.nan
    sharp = fixes.smeared == 0.0
    time_s, g = fixes.time_s[sharp], fixes.speed_mps[sharp]
    if len(time_s) < LEAST_FIXES:
        return nothing
    v = np.abs(path.rate((time_s[None, :] - DELAYS_S[:, None]).ravel()))
    v = v.reshape(len(DELAYS_S), -1)
    known = np.isfinite(v).all(axis=0)
    if known.sum() < LEAST_FIXES:
        return nothing
    v, g, time_s = v[:, known], g[known], time_s[known]
    best = int(_misfit(v, g).argmin())
    if best in (0, len(DELAYS_S) - 1):
        return nothing
    return _refined(float(DELAYS_S[best]), time_s, g, path)


def _refined(delay_s: float, time_s: Array, g: Array, path: Course) -> tuple[float, float]:
    """Delay and its deviation by Gauss and Newton from a delay near by."""
    step_s, std_s = float(DELAYS_S[1] - DELAYS_S[0]), np.nan
    for _ in range(PASSES):
        before, here, after = (
            np.abs(path.rate(time_s - delay_s + each)) for each in (-step_s, 0.0, step_s)
        )
        known = np.isfinite(before + here + after)
        slope = (before - after)[known] / (2.0 * step_s)
        (moved, scale), std = _regress(np.stack([slope, here[known]], 1), g[known])
        if not np.isfinite(moved) or scale <= 0.0:
            return np.nan, np.nan
        delay_s += float(moved / scale)
        std_s = float(std[0] / scale)
    return (delay_s, std_s) if abs(delay_s) < DELAYS_S[-1] else (np.nan, np.nan)


def _misfit(v: Array, g: Array) -> Array:
    """Robust sum of squares of g − c v, with the best c; for each row of v."""
    weight = np.ones(v.shape)
    for _ in range(PASSES):
        c = (weight * v * g).sum(axis=1) / np.maximum((weight * v * v).sum(axis=1), 1e-9)
        off = np.abs(g - c[:, None] * v)
        limit = CLIP * np.maximum(1.4826 * np.median(off, axis=1, keepdims=True), 1e-3)
        weight = np.minimum(1.0, limit / np.maximum(off, 1e-9))
    squares: Array = np.minimum(off, limit) ** 2
    return np.asarray(squares.sum(axis=1))


def lever(fixes: Fixes, path: Course, turned: Course, found: Speeds, wheels_left_m: float) -> Lever:
    """Find where the antenna is; `wheels_left_m` is how far to the left the wheels are."""
    shift_s = found.delay_s if np.isfinite(found.delay_s) else 0.0
    at_s = fixes.time_s - shift_s
    v, rate, yaw = path.rate(at_s), turned.rate(at_s), turned.at(at_s)
    good = np.isfinite(v + rate + yaw + fixes.course_rad) & (np.abs(v) > TURNING_MPS)
    good &= fixes.smeared == 0.0
    if good.sum() < 2 * LEAST_FIXES:
        return Lever(*[np.nan] * 4)
    v, rate, yaw, speed = v[good], rate[good], yaw[good], fixes.speed_mps[good]
    block = np.floor(at_s[good] / BLOCK_S)
    curvature = _about_means(rate / v, block)
    if np.sqrt((curvature**2).sum()) < LEAST_SPREAD_PER_M:
        return Lever(*[np.nan] * 4)
    ahead = _about_means(np.unwrap(fixes.course_rad[good] - yaw), block)
    forward = _regress(curvature[:, None], ahead)
    left = _regress(np.stack([-rate * np.sign(v), np.abs(v)], 1), speed)
    to_left_m = float(left[0][0]) + wheels_left_m
    return Lever(float(forward[0][0]), float(forward[1][0]), to_left_m, float(left[1][0]))


def _about_means(values: Array, block: Array) -> Array:
    """Values less the mean of their block."""
    _, of = np.unique(block, return_inverse=True)
    means: Array = np.bincount(of, values) / np.bincount(of)
    less: Array = values - means[of]
    return less


def _regress(A: Array, y: Array) -> tuple[Array, Array]:
    """Coefficients of robust least squares, and their deviations; NaN where A does not tell."""
    weight = np.ones(len(y))
    for _ in range(PASSES):
        W = weight[:, None] * A
        N = A.T @ W
        if np.linalg.cond(N) > 1e12:
            return np.full(A.shape[1], np.nan), np.full(A.shape[1], np.nan)
        x = np.linalg.solve(N, W.T @ y)
        off = y - A @ x
        scale = max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        weight = np.minimum(1.0, CLIP * scale / np.maximum(np.abs(off), 1e-12))
    std: Array = scale * np.sqrt(np.diagonal(np.linalg.inv(N)))
    return np.asarray(x, dtype=float), std


def _spread(values: Array) -> float:
    """Robust deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
