"""A track network made by hand: two parallel tracks, a crossover between them, and a branch.

::

    7 <---------------------------- 5 ------------------------------ 8 <------ 4 ------> 4
                                                    ____ 6 (crossover) _/
    0 ------ 0 ------> 1 ---------- 1 -----------> 2 ----------- 3 -----------> 6
                        \\____ 2 (branch) ____ 3

Nodes stand at the ends, track numbers in the middle; arrows are where trams are meant to go. A
tram from node 0 meets two facing switches, at nodes 1 and 2.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.geodesy import LocalLevel
from tramstream.line import Line, Segment, curve
from tramstream.network import (
    FORWARDS,
    PARTNER_LEFT,
    PARTNER_RIGHT,
    LineStop,
    Network,
    RouteLine,
    Stop,
    rule,
)

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
CROSSOVER = [Segment(15.0, 0.0, 0.0073), Segment(15.0, 0.0073, 0.0), Segment(15.0, 0.0, -0.0073),
             Segment(15.0, -0.0073, 0.0)]  # fmt: skip
BRANCH = [*curve(50.0, math.radians(-40.0)), Segment(300.0)]
MAIN_M = 300.0, 600.0, 300.0
"""Of the lower track, between nodes 0, 1, 2 and 6."""

_FOLLOWING: dict[int, list[int]] = {
    0: [2, 4], 2: [6, 12], 12: [8], 9: [10, 13], 13: [3], 3: [1], 5: [1], 7: [3], 11: [8],
}  # fmt: skip


def small_network() -> Network:
    """Make it; the plan's origin is node 0, east along the lower track."""
    crossover = _laid(CROSSOVER, (900.0, 0.0))
    far = crossover.position_l(crossover.length_m)[:2]
    lines = [
        _laid([Segment(MAIN_M[0])], (0.0, 0.0)),
        _laid([Segment(MAIN_M[1])], (300.0, 0.0)),
        _laid(BRANCH, (300.0, 0.0)),
        _laid([Segment(MAIN_M[2])], (900.0, 0.0)),
        _laid([Segment(240.0)], (far[0], far[1])),
        _laid([Segment(float(far[0]))], (far[0], far[1]), math.pi),
        crossover,
    ]
    counts = [math.ceil(line.length_m) + 1 for line in lines]
    arc_lengths = [
        np.linspace(0.0, line.length_m, count) for line, count in zip(lines, counts, strict=True)
    ]
    each = list(zip(lines, arc_lengths, strict=True))
    plan = np.vstack([line.position_l(s)[:, :2] for line, s in each])
    total = len(plan)
    follows = [_FOLLOWING.get(run, []) for run in range(2 * len(lines))]
    level, unknown = np.zeros(total, dtype=np.float32), np.full(total, np.nan, dtype=np.float32)
    return Network(
        latitude_rad=LEVEL.latitude_rad,
        longitude_rad=LEVEL.longitude_rad,
        height_m=LEVEL.height_m,
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        length_m=np.array([line.length_m for line in lines]),
        rules=np.array([*[FORWARDS] * 4, rule(True, True), *[FORWARDS] * 2], dtype=np.int8),
        from_node=np.array([0, 1, 1, 2, 8, 8, 2], dtype=np.int32),
        to_node=np.array([1, 2, 3, 6, 4, 7, 8], dtype=np.int32),
        node_id=100 + np.arange(9),
        node_switch=np.isin(np.arange(9), [1, 2, 8]).astype(np.int8),
        following_starts=np.cumsum([0, *map(len, follows)]).astype(np.int32),
        following=np.array([run for each in follows for run in each], dtype=np.int32),
        east=plan[:, 0],
        north=plan[:, 1],
        yaw_rad=np.concatenate([line.yaw_rad(s) for line, s in each]),
        curvature_per_m=np.concatenate([line.curvature_per_m(s) for line, s in each]),
        across_std_m=level + np.float32(0.4),
        yaw_std_rad=level + np.float32(0.01),
        height=level + np.float32(LEVEL.height_m),
        grade_rad=level,
        grade_std_rad=unknown,
        partner=np.repeat(
            [PARTNER_LEFT, PARTNER_LEFT, 0, PARTNER_LEFT, PARTNER_RIGHT, PARTNER_LEFT, 0], counts
        ).astype(np.int8),
        stops=(Stop("branch", 2, 200.0), Stop("meadow", 1, 250.0)),
        lines=(
            RouteLine(
                "1", "0", "west", "east", (0, 2, 6), 10.0, 1150.0,
                (LineStop("west", 0.0), LineStop("middle", 500.0), LineStop("east", 1150.0)),
            ),
        ),
    )  # fmt: skip


def _laid(segments: list[Segment], start: tuple[float, float], yaw_rad: float = 0.0) -> Line:
    length_m = sum(segment.length_m for segment in segments)
    return Line(segments, [0.0, length_m], LEVEL, yaw_rad, (*start, 0.0))
