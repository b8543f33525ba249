"""Where wheels slip or slide: their speed against that which the force ahead adds up to.

The wheels' speed less the integral of the force (without the slope, a median over five seconds)
changes slowly, with the error of slope and bias. A slip makes it leave that course and come back.
In a slip the force carries the way over, bent so that it meets the wheels' speed at either end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.level import Level
from tramstream.analysis.odometry.material import MEAN_S, WheelWay
from tramstream.analysis.odometry.ways import Way

Array = NDArray[np.float64]

LEAST_MPS = 0.12
"""A smaller difference is the body's nodding; by hand."""
SPREADS = 7.0
LEAST_S = 0.15
TREND_S = 9.0
"""A slip is shorter than half of it."""
LEAST_WAY_M = 0.1
"""Less is not told from a kerb, and what is wrongly mended adds up."""
MARGIN_S = 0.3
MOST_SHARE = 0.2
"""Of the ride that may be slips; more is something else."""


class Slip(NamedTuple):
    """One period of one wheel."""

    wheel: str
    start_s: float
    end_s: float
    way_m: float
    """That the wheel turned beyond the vehicle's way; negative for a slide."""


def mended(way: Way, level: Level) -> tuple[Way, list[Slip], NDArray[np.bool_]]:
    """Ways without slips, the slips, and at each mean whether there was one."""
    wheels, slips = [], []
    any_ = np.zeros(len(level.time_s), dtype=bool)
    for k, one in enumerate(way.wheels):
        made, found, slipping = _mended(k, one, way, level)
        wheels.append(made)
        slips += found
        any_ |= slipping
    return Way(tuple(wheels)), slips, any_


def _mended(
    k: int, one: WheelWay, way: Way, level: Level
) -> tuple[WheelWay, list[Slip], NDArray[np.bool_]]:
    t = level.time_s
    rate = np.gradient(level.turned_rad, t)
    at_s = np.clip(t, one.time_s[0] + 0.1, one.time_s[-1] - 0.1)
    speed = (way.of(k, at_s + 0.1) - way.of(k, at_s - 0.1)) / 0.2 + rate * one.left_m
    step = np.diff(t, prepend=t[0])
    felt = np.cumsum(np.where(step < 10 * MEAN_S, step, 0.0) * level.driving_mps2)
    beside = speed - felt
    off = beside - _median(beside)
    limit = max(LEAST_MPS, SPREADS * 1.4826 * float(np.median(np.abs(off))))
    moving = ~way.standing(t)
    slipping = _grown((np.abs(off) > limit) & moving)
    if slipping.mean() > MOST_SHARE:
        return one, [], np.zeros(len(t), dtype=bool)
    slips, extra = [], np.zeros(len(t))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slipping.astype(int), [0]])))
    for begin, end in edges.reshape(-1, 2).tolist():
        first, last = max(begin - 1, 0), min(end, len(t) - 1)
        ends = np.interp(t[first : last + 1], t[[first, last]], beside[[first, last]])
        true = felt[first : last + 1] + ends
        more = np.cumsum((speed[first : last + 1] - true) * step[first : last + 1])
        if abs(float(more[-1])) < LEAST_WAY_M:
            slipping[begin:end] = False
            continue
        extra[first : last + 1] += more
        extra[last + 1 :] += more[-1]
        slips.append(Slip(one.name, float(t[first]), float(t[last]), float(more[-1])))
    way_m = one.way_m - np.interp(one.time_s, t, extra)
    made = WheelWay(one.name, one.time_s, way_m, one.left_m, one.m_per_pulse)
    return made, slips, slipping


def _median(values: Array) -> Array:
    """Running median over `TREND_S`, four a second."""
    stride = max(round(0.25 / MEAN_S), 1)
    thin = values[::stride]
    size = round(TREND_S / (stride * MEAN_S)) | 1
    padded = np.pad(thin, size // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, size)
    at = np.arange(len(values))
    return np.interp(at, at[::stride], np.median(windows, axis=1))


def _grown(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Only what lasts, with a margin to either side."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    kept = np.zeros(len(flags), dtype=bool)
    margin = round(MARGIN_S / MEAN_S)
    for begin, end in edges.reshape(-1, 2).tolist():
        if (end - begin) * MEAN_S >= LEAST_S:
            kept[max(begin - margin, 0) : end + margin] = True
    return kept
