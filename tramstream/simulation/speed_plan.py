"""Speed along a line with bounded jerk: phases from stop to stop.

The line is cut where the permitted speed changes (√(lateral limit / curvature), at most the limit)
and at the stops. At each cut the speed is the highest that both sides permit and that can be
reached from the neighbouring cuts, with no acceleration there; between two cuts the speed rises to
a top, keeps it, and falls. So the whole ride is a table of phases of constant jerk, and arc length,
speed and acceleration are polynomials of time: exact at every instant, forwards or at random.

Track that was drawn by hand or mapped has curvature that changes everywhere. A driver does not
follow that: where a higher speed is permitted for less than `WORTH_M`, he keeps the lower one.

A ride is one leg from the first stop to the last, or several where the driver turns back: he
changes to the other cab, the vehicle stays as it stands, and the next leg goes over the same track
in the other direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.config import NotNegative, Positive, Struct
from tramstream.errors import ConfigError
from tramstream.lines.line import Line

Array = NDArray[np.float64]

WORTH_M = 25.0
"""No driver changes speed for less."""


class Break(Struct, frozen=True, kw_only=True):
    """A halt that lasts longer."""

    halt: Annotated[int, Meta(ge=1)]
    """In the order in which the vehicle halts; 1 is the start, as `stop` of an event."""
    duration_s: Positive


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
    turns_back: tuple[Annotated[int, Meta(ge=1)], ...] = ()
    """Stops, by their number on the line, where the driver changes to the other cab and goes back
    over the same track: forwards to the first of these, backwards to the second, and so on; after
    the last one to the end of the line that lies ahead."""
    turn_s: NotNegative = 120.0
    """Dwell where he does so."""
    breaks: tuple[Break, ...] = ()

    def __post_init__(self) -> None:
        if self.dwell_max_s is not None and self.dwell_max_s < self.dwell_s:
            raise ValueError("`dwell_max_s` is the longest dwell: not below `dwell_s`")


class Phases(NamedTuple):
    """Constant jerk from `t0` on, until the next phase; the state at `t0`.

    Speed, acceleration and jerk are in the direction of travel.
    """

    t0: Array
    s0: Array
    v0: Array
    a0: Array
    jerk: Array
    along: Array
    """1 where arc length grows, −1 on legs that go back."""
    fold_m: Array
    """The way gone, as arc length of a line without turns, is fold + along·s."""


class Region(NamedTuple):
    """Track of one permitted speed between two cuts; `stop` if the vehicle halts at its end.

    On a leg that goes back it ends where arc length is less.
    """

    start_m: float
    end_m: float
    limit_mps: float
    stop: bool

    @property
    def length_m(self) -> float:
        return abs(self.end_m - self.start_m)


class Leg(NamedTuple):
    """A part of a ride in one direction along the line."""

    along: float
    """1 or −1."""
    fold_m: float
    """See `Phases`."""
    parts: list[Region]

    @property
    def ends_m(self) -> tuple[float, float]:
        """Ways gone at its begin and its end."""
        start, end = self.parts[0].start_m, self.parts[-1].end_m
        return self.fold_m + self.along * start, self.fold_m + self.along * end


def legs(line: Line, limits: Limits) -> list[Leg]:
    """Cut a ride where the driver turns back.

    Raises
    ------
    ConfigError
        For a stop that the line does not have, or that does not lie ahead.
    """
    hops: list[list[Region]] = [[]]
    for region in regions(line, limits):
        hops[-1].append(region)
        if region.stop:
            hops.append([])
    hops.pop()
    found: list[Leg] = []
    at, along, fold_m = 0, 1.0, 0.0
    for number, turn in enumerate([*limits.turns_back, None]):
        to = turn - 1 if turn is not None else (len(hops) if along > 0 else 0)
        if not (at < to <= len(hops) if along > 0 else 0 <= to < at):
            raise ConfigError(
                f"$.driver.turns_back[{number}]: no stop {to + 1} lies ahead of stop {at + 1}, "
                f"going {'on' if along > 0 else 'back'}; the line has {len(hops) + 1}"
            )
        found.append(Leg(along, fold_m, _gone(hops, at, to)))
        fold_m += 2 * along * found[-1].parts[-1].end_m
        at, along = to, -along
    return found


def _gone(hops: list[list[Region]], first: int, last: int) -> list[Region]:
    """Regions from one stop to another, in the order in which they are gone."""
    if first < last:
        return [region for hop in hops[first:last] for region in hop]
    back: list[Region] = []
    for hop in reversed(hops[last:first]):
        turned = [Region(each.end_m, each.start_m, each.limit_mps, False) for each in hop[::-1]]
        back += [*turned[:-1], turned[-1]._replace(stop=True)]
    return back


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


def plan(gone: Sequence[Leg], limits: Limits, rng: Generator | None = None) -> Phases:
    """Plan a ride over its legs as phases of constant jerk.

    `rng` draws the dwells, where they differ; without it each is the shortest.

    Raises
    ------
    ConfigError
        For a break at a halt that the ride does not have.
    """
    rows: list[tuple[float, ...]] = []
    breaks = {each.halt: each.duration_s for each in limits.breaks}
    first = gone[0]
    rows.append((0.0, first.parts[0].start_m, 0.0, 0.0, 0.0, first.along, first.fold_m))
    time, halt = breaks.get(1, limits.first_dwell_s), 1
    for leg in gone:
        speeds = _cut_speeds(leg.parts, limits)
        way = (leg.along, leg.fold_m)
        for part, v0, v1 in zip(leg.parts, speeds[:-1], speeds[1:], strict=True):
            s, v, a = part.start_m, v0, 0.0
            for duration, jerk in _region_phases(part.length_m, v0, v1, part, limits):
                rows.append((time, s, v, a, jerk, *way))
                s += leg.along * (duration * (v + duration * (a / 2 + duration * jerk / 6)))
                v += duration * (a + duration * jerk / 2)
                a += duration * jerk
                time += duration
            if part.stop:
                rows.append((time, part.end_m, 0.0, 0.0, 0.0, *way))
                halt += 1
                usual_s = _dwell_s(limits, rng)
                if part is leg.parts[-1]:
                    usual_s = max(usual_s, limits.turn_s)
                time += breaks.get(halt, usual_s)
    if max(breaks, default=0) > halt:
        raise ConfigError(f"$.driver.breaks: the ride has {halt} halts, none {max(breaks)}")
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
    return _highest(
        speed_mps, part.limit_mps, lambda top: _change_m(speed_mps, top, limits) <= part.length_m
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
