"""Small track networks made of exact lines, and estimates of vehicles that run on them.

Each track is a `Line`, sampled in the network's plan at most a metre apart. What the estimates are
off is made here: a first-order Gauss-Markov error of position and heading, with the covariance that
it truly has. The filter's frame lies kilometres away from the network's and at another height.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.clock import S
from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.line import Line, Segment, parse_plan
from tramstream.localisation import COVARIANCE, TRACKING, Estimate, OnTrack, values_of
from tramstream.network import BACKWARDS, FORWARDS, SAMPLE_M, Network

Array = NDArray[np.float64]

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
"""Of the networks and their lines."""
FILTER_LEVEL = LocalLevel.at_deg(50.10, 14.45, 190.0)
"""Of the estimates: 3 km away, 60 m lower."""
YAW_RAD = 0.35
"""Nothing here runs along an axis."""
BOTH = FORWARDS | BACKWARDS
PARALLEL_M = 3.3
"""Between the middles of two parallel tracks."""
SWITCH_M = 50.0
"""Radius of a switch's branch."""
STEP_S = 0.05
BEGIN_NS = 1_000 * S
LADDER_RAD = 0.2
"""Between a depot's lead and its tracks."""


# Lines --------------------------------------------------------------------------------------------
def straight(length_m: float) -> list[Segment]:
    return [Segment(length_m)]


def arc(radius_m: float, angle_rad: float) -> list[Segment]:
    """A circle's piece without transitions, as switches are; left positive."""
    k = math.copysign(1.0 / radius_m, angle_rad)
    return [Segment(radius_m * abs(angle_rad), k, k)]


def aside(way_m: float, radius_m: float = SWITCH_M) -> list[Segment]:
    """Two arcs that lead to a parallel, so far to the left."""
    angle = math.copysign(math.acos(1.0 - abs(way_m) / (2.0 * radius_m)), way_m)
    return arc(radius_m, angle) + arc(radius_m, -angle)


def laid(
    segments: Sequence[Segment],
    start: Sequence[float] = (0.0, 0.0),
    yaw_rad: float = YAW_RAD,
    level: LocalLevel = LEVEL,
) -> Line:
    length_m = math.fsum(each.length_m for each in segments)
    return Line(segments, [0.0, length_m], level, yaw_rad, (start[0], start[1], 0.0))


def after(line: Line, segments: Sequence[Segment]) -> Line:
    """A line that goes on where another ends."""
    end = line.position_l(line.length_m)
    return laid(segments, end[:2], float(line.yaw_rad(line.length_m)), line.level)


def chained(*lines: Line) -> Line:
    """One line of several that follow each other as they are drawn."""
    first = lines[0]
    segments = [each for line in lines for each in line.segments]
    return laid(segments, first.position_l(0.0)[:2], float(first.yaw_rad(0.0)), first.level)


def left_of(line: Line, way_m: float) -> tuple[float, float]:
    """Where a parallel on the left begins."""
    east, north, _ = line.position_l(0.0).tolist()
    yaw = float(line.yaw_rad(0.0))
    return east - way_m * math.sin(yaw), north + way_m * math.cos(yaw)


# Networks -----------------------------------------------------------------------------------------
def network_of(
    lines: Sequence[Line],
    joins: Iterable[tuple[int, int]] = (),
    rules: Sequence[int] = (),
    std_m: float = 0.01,
    source: str = "a test",
) -> Network:
    """A network of exact tracks.

    Parameters
    ----------
    joins : iterable of (int, int)
        Runs that follow each other. What follows the other way round is added.
    rules : sequence of int
        Of each track; by default trams go as it is drawn.
    """
    level = lines[0].level
    tracks = len(lines)
    following: list[set[int]] = [set() for _ in range(2 * tracks)]
    leaves = list(range(2 * tracks))  # node that a run leads to; it begins at that of run ^ 1
    for before, behind in joins:
        following[before].add(behind)
        following[behind ^ 1].add(before ^ 1)
        old, new = leaves[behind ^ 1], leaves[before]
        leaves = [new if node == old else node for node in leaves]
    nodes = {node: number for number, node in enumerate(sorted(set(leaves)))}
    switch = np.zeros(len(nodes), np.int8)
    for run, runs in enumerate(following):
        if len(runs) > 1:
            switch[nodes[leaves[run]]] = 1
    sampled = [_sampled(line, level) for line in lines]
    counts = [len(each) for each in sampled]
    rows = np.concatenate(sampled)

    def singles(value: float) -> NDArray[np.float32]:
        return np.full(len(rows), value, np.float32)

    return Network(
        latitude_rad=level.latitude_rad,
        longitude_rad=level.longitude_rad,
        height_m=level.height_m,
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        length_m=np.array([float(each[-1, 4]) for each in sampled]),
        rules=np.array(rules or [FORWARDS] * tracks, np.int8),
        from_node=np.array([nodes[leaves[2 * k + 1]] for k in range(tracks)], np.int32),
        to_node=np.array([nodes[leaves[2 * k]] for k in range(tracks)], np.int32),
        node_id=np.arange(100, 100 + len(nodes), dtype=np.int64),
        node_switch=switch,
        following_starts=np.cumsum([0, *(len(each) for each in following)]).astype(np.int32),
        following=np.array([run for each in following for run in sorted(each)], np.int32),
        east=rows[:, 0].copy(),
        north=rows[:, 1].copy(),
        yaw_rad=rows[:, 2].copy(),
        curvature_per_m=rows[:, 3].copy(),
        across_std_m=singles(std_m),
        yaw_std_rad=singles(std_m / 10.0),
        height=singles(math.nan),
        grade_rad=singles(math.nan),
        grade_std_rad=singles(math.nan),
        partner=np.zeros(len(rows), np.int8),
        source=source,
    )


def _sampled(line: Line, level: LocalLevel) -> Array:
    """East, north, yaw, curvature and way in the plan, at even distances there."""
    s = np.linspace(0.0, line.length_m, math.ceil(line.length_m / SAMPLE_M) + 1)
    flat = np.cos(line.grade((s[1:] + s[:-1]) / 2.0))  # a plan does not know grades
    way = np.concatenate([[0.0], np.cumsum(np.diff(s) * flat)])
    even = np.linspace(0.0, way[-1], len(s))
    s = np.interp(even, way, s)
    geodetic = line.level.to_geodetic(line.position_l(s))
    geodetic[:, 2] = level.height_m
    plan = level.from_geodetic(geodetic)[:, :2]
    curvature = line.curvature_per_m(s) / np.cos(line.grade(s))
    return np.column_stack([plan, line.yaw_rad(s), curvature, even])


class Made(NamedTuple):
    """A network and its lines, by name of the track; tracks are numbered in that order."""

    network: Network
    lines: dict[str, Line]

    def run(self, name: str) -> int:
        """Number of a run: `stem` as it is drawn, `-stem` against that."""
        return 2 * list(self.lines).index(name.removeprefix("-")) + name.startswith("-")

    def path(self, *names: str) -> Line:
        """The line over some tracks, as they are drawn."""
        return chained(*(self.lines[name] for name in names))


def made(
    lines: dict[str, Line],
    joins: Iterable[tuple[str, str]] = (),
    rules: dict[str, int] | None = None,
) -> Made:
    """Make a network of named tracks; see `network_of`."""
    empty = Made(None, lines)  # type: ignore[arg-type]
    numbered = [(empty.run(before), empty.run(behind)) for before, behind in joins]
    given = [(rules or {}).get(name, FORWARDS) for name in lines]
    return Made(network_of(list(lines.values()), numbered, given), lines)


@cache
def curved() -> Made:
    """A single track with curves both ways."""
    segments, _ = parse_plan("80 L60/70 60 R90/60 50 L40/90 70 R120/40 120")
    return made({"track": laid(segments)})


@cache
def single() -> Made:
    """One straight track and nothing else."""
    return made({"track": laid(straight(400.0))})


@cache
def double() -> Made:
    """Straight double track, one way each; the opposite one is on the left."""
    right = laid(straight(600.0))
    ahead = right.position_l(600.0)[:2] - right.position_l(0.0)[:2]
    start = np.array(left_of(right, PARALLEL_M)) + ahead
    left = laid(straight(600.0), start.tolist(), YAW_RAD + math.pi)
    return made({"right": right, "left": left})


@cache
def switch(rules: int = BOTH) -> Made:
    """A stem of 300 m that branches: straight on, and to the left with a radius of 50 m."""
    stem = laid(straight(300.0))
    return made(
        {
            "stem": stem,
            "straight": after(stem, straight(150.0)),
            "branch": after(stem, arc(SWITCH_M, math.radians(60.0)) + straight(100.0)),
        },
        [("stem", "straight"), ("stem", "branch")],
        dict.fromkeys(("stem", "straight", "branch"), rules),
    )


@cache
def crossover() -> Made:
    """Double track, one way each, with a crossover from the right one to the left one.

    Both are drawn in the same direction; trams go on the left one against that.
    """
    before = laid(straight(200.0))
    link = after(before, aside(PARALLEL_M))
    way = 2.0 * math.sqrt(PARALLEL_M * SWITCH_M - PARALLEL_M**2 / 4.0)
    left_before = laid(straight(200.0 + way), left_of(before, PARALLEL_M))
    return made(
        {
            "before": before,
            "behind": after(before, straight(250.0)),
            "link": link,
            "left_before": left_before,
            "left_behind": after(left_before, straight(250.0 - way)),
        },
        [
            ("before", "behind"),
            ("before", "link"),
            ("link", "left_behind"),
            ("left_before", "left_behind"),
        ],
        {"left_before": BACKWARDS, "left_behind": BACKWARDS, "link": BOTH},
    )


@cache
def passing_loop(radius_m: float = SWITCH_M) -> Made:
    """A track that parts into two, 3.3 m apart for 120 m, and is one again."""
    before = laid(straight(200.0))
    half = PARALLEL_M / 2.0
    left, right = (
        after(before, aside(way, radius_m) + straight(120.0) + aside(-way, radius_m))
        for way in (half, -half)
    )
    names = "left", "right"
    return made(
        {"before": before, "left": left, "right": right, "behind": after(left, straight(200.0))},
        [*(("before", name) for name in names), *((name, "behind") for name in names)],
        dict.fromkeys(("before", "left", "right", "behind"), BOTH),
    )


@cache
def ladder(count: int = 64, apart_m: float = 4.0) -> Made:
    """A depot: a lead from which parallel tracks branch to the left, one after the other."""
    way = apart_m / math.sin(LADDER_RAD)
    lines = {"lead 0": laid(straight(60.0))}
    joins = []
    for k in range(count):
        lead = lines[f"lead {k}"]
        lines[f"track {k}"] = after(lead, arc(SWITCH_M, -LADDER_RAD) + straight(150.0))
        lines[f"lead {k + 1}"] = after(lead, straight(way))
        joins += [(f"lead {k}", f"track {k}"), (f"lead {k}", f"lead {k + 1}")]
    return made(lines, joins, dict.fromkeys(lines, BOTH))


# Motion -------------------------------------------------------------------------------------------
class Course(NamedTuple):
    """A motion along a line."""

    time_s: Array
    s: Array
    """Way along the line, m."""
    rate: Array
    """Its derivative, m/s; negative: against the line."""


def course(*legs: tuple[float, float], start_m: float = 0.0, step_s: float = STEP_S) -> Course:
    """Go legs of (metres, seconds), each from standstill to standstill; no metres: stand."""
    time, way, rate = [np.zeros(1)], [np.full(1, start_m)], [np.zeros(1)]
    for metres, seconds in legs:
        u = np.arange(1, round(seconds / step_s) + 1) / round(seconds / step_s)
        time.append(time[-1][-1] + u * seconds)
        way.append(way[-1][-1] + metres * (3.0 - 2.0 * u) * u * u)
        rate.append(metres / seconds * 6.0 * u * (1.0 - u))
    return Course(*(np.concatenate(each) for each in (time, way, rate)))


def steady(metres: float, speed_mps: float, start_m: float = 0.0) -> Course:
    """Go at one speed from the first instant to the last."""
    time = np.arange(0.0, metres / speed_mps, STEP_S)
    return Course(time, start_m + speed_mps * time, np.full(len(time), speed_mps))


@dataclass(frozen=True)
class Noise:
    """Gauss-Markov errors of the estimates, and what they claim.

    They change while the vehicle moves: one that stands is held by its wheels.
    """

    std_m: float = 0.5
    """Per axis."""
    time_s: float = 300.0
    yaw_std_rad: float = 0.01
    yaw_time_s: float = 300.0
    offset_l: tuple[float, float] = (0.0, 0.0)
    """East, north: what is added and not claimed."""


class Obeying:
    """A filter's share in the estimates: it takes what a matcher tells it about the rails.

    A Kalman filter of the error of place and heading, which is what `driven` makes: each forgets
    itself, and what it was told with it.
    """

    def __init__(self, noise: Noise) -> None:
        self._initial = np.diag([noise.std_m**2, noise.std_m**2, noise.yaw_std_rad**2])
        self._times_s = np.array([noise.time_s, noise.time_s, noise.yaw_time_s])
        self.P = self._initial.copy()
        self.correction = np.zeros(3)
        """East, north, yaw: what to add to an estimate."""

    def wait(self, dt_s: float) -> None:
        keep = np.exp(-dt_s / self._times_s)
        self.correction *= keep
        both = np.outer(keep, keep)
        self.P = both * self.P + (1.0 - both) * self._initial

    def take(self, told: OnTrack) -> None:
        """See `tramstream.localisation.Localiser.constrain`."""
        east, north, bend = told.normal_east, told.normal_north, told.bend_per_m
        H = np.array([[east, north, 0.0], [-bend * north, bend * east, 1.0]])
        S = H @ self.P @ H.T + np.diag([told.across_variance, told.yaw_variance])
        K = np.linalg.solve(S, H @ self.P).T
        self.correction -= K @ (told.across_m, told.yaw_off_rad)
        self.P = self.P - K @ S @ K.T

    def apply(self, estimate: Estimate) -> Estimate:
        """The estimate of a filter that has been told."""
        values = estimate.values.copy()
        values[[0, 1, 6]] += self.correction
        covariance = values[COVARIANCE:].reshape(7, 7)
        covariance[np.ix_([0, 1, 6], [0, 1, 6])] = self.P
        return replace(estimate, values=values)


@dataclass(frozen=True)
class Driven:
    """Estimates of a vehicle, and the truth."""

    estimates: list[Estimate]
    course: Course
    plan: Array
    """(n, 2): true place in the network's plan."""
    off_l: Array
    """(n, 2): error of the estimates."""
    noise: Noise

    @property
    def stamps(self) -> list[int]:
        return [each.stamp_ns for each in self.estimates]

    def altered(self, begin: int, end: int, **changes: object) -> Driven:
        """Estimates of a part with other fields, such as a mode."""
        estimates = list(self.estimates)
        estimates[begin:end] = [replace(each, **changes) for each in estimates[begin:end]]
        return replace(self, estimates=estimates)


def gauss_markov(rng: Generator, time_s: Array, std: float, correlation_s: float) -> Array:
    """First-order, stationary."""
    error = np.empty(len(time_s))
    error[0] = rng.normal(0.0, std)
    for k, dt in enumerate(np.diff(time_s).tolist()):
        keep = math.exp(-dt / correlation_s)
        error[k + 1] = keep * error[k] + rng.normal(0.0, std * math.sqrt(1.0 - keep * keep))
    return error


def driven(
    line: Line, way: Course, noise: Noise | None = None, seed: int = 0, rear: bool = False
) -> Driven:
    """Estimates along a line.

    Parameters
    ----------
    rear : bool
        The vehicle's x axis points against the line: it goes along it with a negative speed.
    """
    noise = noise or Noise()
    rng = np.random.default_rng(seed)
    geodetic = line.level.to_geodetic(line.position_l(way.s))
    flat = geodetic.copy()
    flat[:, 2] = LEVEL.height_m
    p_l = FILTER_LEVEL.from_geodetic(geodetic)
    moving_s = np.concatenate([[0.0], np.cumsum(np.diff(way.time_s) * (way.rate[1:] != 0.0))])
    off = [gauss_markov(rng, moving_s, noise.std_m, noise.time_s) for _ in range(2)]
    off_l = np.column_stack(off) + noise.offset_l
    p_l[:, :2] += off_l
    yaw = line.yaw_rad(way.s) + np.pi * rear
    yaw = yaw - convergence_rad(line.level, geodetic[:, 1])
    yaw = yaw + convergence_rad(FILTER_LEVEL, geodetic[:, 1])
    yaw = yaw + gauss_markov(rng, moving_s, noise.yaw_std_rad, noise.yaw_time_s)
    turn = way.rate * line.curvature_per_m(way.s)
    speed = -way.rate if rear else way.rate
    covariance = np.diag(
        [noise.std_m**2, noise.std_m**2, 1.0, 0.01, 1e-4, 1e-4, noise.yaw_std_rad**2]
    )
    estimates = [
        Estimate(
            BEGIN_NS + round(time * S),
            TRACKING,
            values_of((*place, v, 0.0, 0.0, heading), covariance, 0.0, rate),
            v == 0.0,
        )
        for time, place, v, heading, rate in zip(
            way.time_s.tolist(), p_l, speed.tolist(), yaw.tolist(), turn.tolist(), strict=True
        )
    ]
    return Driven(estimates, way, LEVEL.from_geodetic(flat)[:, :2], off_l, noise)
