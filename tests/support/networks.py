"""Small track networks made of exact lines; `estimates` are of vehicles that run on them.

Each track is a `Line`, sampled in the network's plan at most a metre apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Segment, curve, parse_plan
from tramstream.tracks.network import (
    BACKWARDS,
    FORWARDS,
    PARTNER_LEFT,
    PARTNER_RIGHT,
    SAMPLE_M,
    LineStop,
    Network,
    RouteLine,
    Stop,
    Way,
)

Array = NDArray[np.float64]

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
"""Of the networks and their lines."""
YAW_RAD = 0.35
"""Nothing runs along an axis where nothing else is said."""
BOTH = FORWARDS | BACKWARDS
PARALLEL_M = 3.3
"""Between the middles of two parallel tracks."""
SWITCH_M = 50.0
"""Radius of a switch's branch."""
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


def between(begin: tuple[float, float], end: tuple[float, float]) -> Line:
    """A straight from one place to another."""
    east, north = end[0] - begin[0], end[1] - begin[1]
    return laid(straight(math.hypot(east, north)), begin, math.atan2(north, east))


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
    source: str = "made by hand",
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
        node_std_m=std_m,
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
def passing_loop(radius_m: float = SWITCH_M, apart_m: float = PARALLEL_M) -> Made:
    """A track that parts into two, 3.3 m apart for 120 m, and is one again."""
    before = laid(straight(200.0))
    half = apart_m / 2.0
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


# A street of two tracks from west to east with a loop at each end: a ring. From switch S a branch
# goes south, both ways; from its begin a crossover leads to the westbound track.
#
#         ┌──────── 4 (drawn eastwards, gone westwards) ──T──── 3 ────────┐
#    loop 7                                              6│              loop 2
#         └──────────────── 0 ────────────────────────────S──── 1 ────────┘
#                                                          5 ↘ branch
LOOP_M = 300.0
_CORNER_M = 5.0
"""Radius of the loops' corners, which are drawn 100 m apart."""
_LOOP = [
    *straight((LOOP_M - 100.0 - (math.pi - 2.0) * _CORNER_M) / 2.0),
    *arc(_CORNER_M, math.pi / 2.0),
    *straight(100.0 - 2.0 * _CORNER_M),
    *arc(_CORNER_M, math.pi / 2.0),
    *straight((LOOP_M - 100.0 - (math.pi - 2.0) * _CORNER_M) / 2.0),
]
TOWN_LINES = (
    between((0.0, 0.0), (600.0, 0.0)),
    between((600.0, 0.0), (1000.0, 0.0)),
    laid(_LOOP, (1000.0, 0.0), 0.0),
    between((1000.0, 100.0), (600.0, 100.0)),
    between((0.0, 100.0), (600.0, 100.0)),
    between((600.0, 0.0), (900.0, -400.0)),
    between((600.0, 0.0), (600.0, 100.0)),
    laid(_LOOP, (0.0, 100.0), math.pi),
)
TOWN_M = tuple(line.length_m for line in TOWN_LINES)
RING_M = 600.0 + 400.0 + LOOP_M + 400.0 + 600.0 + LOOP_M
TOWN_STOPS = (
    Stop("West", 0, 50.0),
    Stop("Square", 0, 300.0, "A"),
    Stop("Twin", 1, 100.0),
    Stop("Far", 2, 150.0),
    Stop("Square", 4, 310.0, "B"),
    Stop("West", 4, 60.0),
    Stop("Twin", 5, 200.0),
    Stop("Branch end", 5, 450.0),
)


def town(stops: Sequence[Stop] = TOWN_STOPS, ways: Sequence[Way] = ()) -> Network:
    """The street above; run 0 leads to S, 9 goes west from T, 10 along the branch."""
    joins = (0, 2), (0, 10), (2, 4), (4, 6), (6, 9), (9, 14), (14, 0), (11, 12), (12, 9)
    rules = [FORWARDS] * len(TOWN_LINES)
    rules[4], rules[5] = BACKWARDS, BOTH
    network = network_of(TOWN_LINES, joins, rules, std_m=0.1)
    return replace(network, stops=tuple(stops), ways=tuple(ways))


# Two parallel tracks, a crossover between them, and a branch.
#
#    <---------------------------- 5 ------------------------------ N <------ 4 ------>
#                                                   ____ 6 (crossover) _/
#    ----- 0 ------> B ---------- 1 -----------> C ----------- 3 ----------->
#                     \____ 2 (branch) ____
#
# Arrows are where trams are meant to go. One on track 0 meets two facing switches, at B and C.
_CROSSOVER = [
    Segment(15.0, 0.0, 0.0073),
    Segment(15.0, 0.0073, 0.0),
    Segment(15.0, 0.0, -0.0073),
    Segment(15.0, -0.0073, 0.0),
]
_BRANCH = [*curve(50.0, math.radians(-40.0)), Segment(300.0)]


@cache
def junctions() -> Network:
    """The tracks above, on level ground; the plan's origin is the begin of track 0, going east."""
    before = laid(straight(300.0), yaw_rad=0.0)
    middle = after(before, straight(600.0))
    crossover = after(middle, _CROSSOVER)
    east, north, _ = crossover.position_l(crossover.length_m).tolist()
    lines = [
        before,
        middle,
        after(before, _BRANCH),
        after(middle, straight(300.0)),
        between((east, north), (east + 240.0, north)),
        between((east, north), (0.0, north)),
        crossover,
    ]
    joins = (0, 2), (0, 4), (2, 6), (2, 12), (12, 8), (11, 8)
    network = network_of(lines, joins, [*[FORWARDS] * 4, BOTH, *[FORWARDS] * 2], std_m=0.4)
    partners = [PARTNER_LEFT, PARTNER_LEFT, 0, PARTNER_LEFT, PARTNER_RIGHT, PARTNER_LEFT, 0]
    level = np.zeros(len(network.east), np.float32)
    stops = LineStop("west", 0.0), LineStop("middle", 500.0), LineStop("east", 1150.0)
    return replace(
        network,
        yaw_std_rad=level + np.float32(0.01),
        height=level + np.float32(LEVEL.height_m),
        grade_rad=level,
        partner=np.repeat(partners, np.diff(network.starts)).astype(np.int8),
        stops=(Stop("branch", 2, 200.0), Stop("meadow", 1, 250.0)),
        lines=(RouteLine("1", "0", "west", "east", (0, 2, 6), 10.0, 1150.0, stops),),
    )
