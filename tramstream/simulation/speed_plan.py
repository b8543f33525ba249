"""Speed along a line with bounded jerk: phases from stop to stop.

The line is cut where the permitted speed changes (√(lateral limit / curvature), at most the limit)
and at the stops. At each cut the speed is the highest that both sides permit and that can be
reached from the neighbouring cuts, with no acceleration there; between two cuts the speed rises to
a top, keeps it, and falls. So the whole ride is a table of phases of constant jerk, and arc length,
speed and acceleration are polynomials of time: exact at every instant, forwards or at random.

Track that was drawn by hand or mapped has curvature that changes everywhere. A driver does not
follow that: where a higher speed is permitted for less than `WORTH_M`, he keeps the lower one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.config import NotNegative, Positive, Struct
from tramstream.lines.line import Line

Array = NDArray[np.float64]

WORTH_M = 25.0
"""No driver changes speed for less."""


class Limits(Struct, frozen=True, kw_only=True):
    """How the driver drives: docs/theory.md, section 3.9."""

    speed_mps: Positive = 15.0
    acceleration_mps2: Positive = 0.5
    jerk_mps3: Positive = 0.2
    lateral_mps2: Positive = 0.1
    dwell_s: NotNegative = 8.0
    dwell_max_s: NotNegative | None = None
    """At each stop the dwell is drawn evenly between `dwell_s` and this; None: all are alike."""
    first_dwell_s: NotNegative = 2.0
    """Short, so that a demo sees a departure at once."""

    def __post_init__(self) -> None:
        if self.dwell_max_s is not None and self.dwell_max_s < self.dwell_s:
            raise ValueError("`dwell_max_s` is the longest dwell: not below `dwell_s`")


class Phases(NamedTuple):
    """Constant jerk from `t0` on, until the next phase; the state at `t0`."""

    t0: Array
    s0: Array
    v0: Array
    a0: Array
    jerk: Array


class Region(NamedTuple):
    """Track of one permitted speed between two cuts; `stop` if the vehicle halts at its end."""

    start_m: float
    end_m: float
    limit_mps: float
    stop: bool


def regions(line: Line, limits: Limits) -> list[Region]:
    """Cut a line where the permitted speed changes and at its stops."""
    stops = {float(stop) for stop in line.stops_m}
    first, last = float(line.stops_m[0]), float(line.stops_m[-1])
    cuts = np.array(sorted({float(start) for start in line.starts_m} | stops))
    cuts = cuts[(cuts >= first) & (cuts <= last)]
    inside = np.stack([cuts[:-1], (cuts[:-1] + cuts[1:]) / 2, np.nextafter(cuts[1:], cuts[:-1])])
    bent = np.max(np.abs(line.curvature_per_m(inside)), axis=0)
    with np.errstate(divide="ignore", over="ignore"):
        permitted = np.minimum(limits.speed_mps, np.sqrt(limits.lateral_mps2 / bent))
    found: list[Region] = []
    leg: list[Region] = []
    for (start, end), limit in zip(pairwise(cuts.tolist()), permitted.tolist(), strict=True):
        leg.append(Region(start, end, limit, end in stops))
        if end in stops:
            found += _worthwhile(_joined(leg))
            leg = []
    return found


def _joined(leg: list[Region]) -> list[Region]:
    """Join neighbours of one limit."""
    joined: list[Region] = []
    for region in leg:
        if joined and math.isclose(joined[-1].limit_mps, region.limit_mps):
            limit = min(joined[-1].limit_mps, region.limit_mps)
            joined[-1] = Region(joined[-1].start_m, region.end_m, limit, region.stop)
        else:
            joined.append(region)
    return joined


def _worthwhile(leg: list[Region]) -> list[Region]:
    """Lower the limit where a short piece is faster than a neighbour, until none is worth less.

    The shortest goes first, to the limit of its faster neighbour if both are slower, else of the
    slower one.
    """
    while True:
        short = [
            (region.end_m - region.start_m, index)
            for index, region in enumerate(leg)
            if region.end_m - region.start_m < WORTH_M and _slower(leg, index)
        ]
        if not short:
            return leg
        index = min(short)[1]
        leg = list(leg)
        leg[index] = leg[index]._replace(limit_mps=max(_slower(leg, index)))
        leg = _joined(leg)


def _slower(leg: list[Region], index: int) -> list[float]:
    """Limits of the neighbours that are slower."""
    beside = leg[max(index - 1, 0) : index] + leg[index + 1 : index + 2]
    return [region.limit_mps for region in beside if region.limit_mps < leg[index].limit_mps]


def plan(line: Line, limits: Limits, rng: Generator | None = None) -> Phases:
    """Plan a ride from the first stop to the last as phases of constant jerk.

    `rng` draws the dwells, where they differ; without it each is the shortest.
    """
    parts = regions(line, limits)
    speeds = _cut_speeds(parts, limits)
    rows: list[tuple[float, float, float, float, float]] = []
    first_m = parts[0].start_m
    rows.append((0.0, first_m, 0.0, 0.0, 0.0))
    time = limits.first_dwell_s
    for part, v0, v1 in zip(parts, speeds[:-1], speeds[1:], strict=True):
        s, v, a = part.start_m, v0, 0.0
        for duration, jerk in _region_phases(part.end_m - part.start_m, v0, v1, part, limits):
            rows.append((time, s, v, a, jerk))
            s += duration * (v + duration * (a / 2 + duration * jerk / 6))
            v += duration * (a + duration * jerk / 2)
            a += duration * jerk
            time += duration
        if part.stop:
            rows.append((time, part.end_m, 0.0, 0.0, 0.0))
            time += _dwell_s(limits, rng)
    return Phases(*(np.array(column) for column in zip(*rows, strict=True)))


def _dwell_s(limits: Limits, rng: Generator | None) -> float:
    if limits.dwell_max_s is None or rng is None:
        return limits.dwell_s
    return float(rng.uniform(limits.dwell_s, limits.dwell_max_s))


def _cut_speeds(parts: list[Region], limits: Limits) -> list[float]:
    """Highest speed at each cut that both sides permit and both neighbours can reach."""
    speeds = [0.0]
    for part, after in zip(parts, [*parts[1:], None], strict=True):
        permitted = 0.0 if part.stop or after is None else min(part.limit_mps, after.limit_mps)
        speeds.append(min(permitted, _reach(speeds[-1], part, limits)))
    for index in range(len(parts) - 1, -1, -1):
        speeds[index] = min(speeds[index], _reach(speeds[index + 1], parts[index], limits))
    return speeds


def _reach(speed_mps: float, part: Region, limits: Limits) -> float:
    """Highest speed within the region's limit that its length allows to go to from `speed_mps`."""
    length = part.end_m - part.start_m
    return _highest(
        speed_mps, part.limit_mps, lambda top: _change_m(speed_mps, top, limits) <= length
    )


def _highest(low: float, high: float, possible: Callable[[float], bool]) -> float:
    """Bisect for the highest speed that is possible, where every lower one is."""
    if low >= high or possible(high):
        return high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if possible(middle) else (low, middle)
    return low


def _change_phases(dv_mps: float, limits: Limits) -> list[tuple[float, float]]:
    """Durations and jerks that change the speed by `dv_mps`, without acceleration at the ends."""
    peak = min(limits.acceleration_mps2, math.sqrt(abs(dv_mps) * limits.jerk_mps3))
    if peak == 0:
        return []
    jerk = math.copysign(limits.jerk_mps3, dv_mps)
    ramp = peak / limits.jerk_mps3
    return [(ramp, jerk), (max(abs(dv_mps) / peak - ramp, 0.0), 0.0), (ramp, -jerk)]


def _change_m(v0_mps: float, v1_mps: float, limits: Limits) -> float:
    """Way that a change of speed takes: the acceleration is symmetric in time."""
    duration = math.fsum(phase[0] for phase in _change_phases(v1_mps - v0_mps, limits))
    return (v0_mps + v1_mps) / 2 * duration


def _region_phases(
    length_m: float, v0: float, v1: float, part: Region, limits: Limits
) -> list[tuple[float, float]]:
    """Durations and jerks from one end of a region to the other: up, along, down."""

    def way(top: float) -> float:
        return _change_m(v0, top, limits) + _change_m(top, v1, limits)

    top = _highest(max(v0, v1), part.limit_mps, lambda speed: way(speed) <= length_m)
    along = (max(length_m - way(top), 0.0) / top, 0.0)
    return [*_change_phases(top - v0, limits), along, *_change_phases(v1 - top, limits)]
