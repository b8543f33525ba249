"""Networks made by hand for tests: a list of tracks, and which run may follow which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tramstream.network import BACKWARDS, FORWARDS, SAMPLE_M, Network, Stop, Way

BOTH = FORWARDS | BACKWARDS


class Track(NamedTuple):
    """A polyline; `rule` as in `Network.rules`."""

    corners: Sequence[tuple[float, float]]
    rule: int = FORWARDS


def made(
    tracks: Sequence[Track],
    following: Sequence[tuple[int, int]],
    stops: Sequence[Stop] = (),
    ways: Sequence[Way] = (),
) -> Network:
    """Sample the tracks; nodes are where their ends coincide. Node k has number 100 + k."""
    ends = [each.corners[k] for each in tracks for k in (0, -1)]
    places = sorted(set(ends))
    nodes = np.array([places.index(end) for end in ends], dtype=np.int32).reshape(-1, 2)
    sampled, lengths = [], []
    for each in tracks:
        corners = np.array(each.corners, dtype=float)
        chainage = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        count = int(np.ceil(chainage[-1] / SAMPLE_M)) + 1
        at = np.linspace(0, chainage[-1], count)
        east, north = (np.interp(at, chainage, corners[:, k]) for k in (0, 1))
        yaw = np.unwrap(np.arctan2(np.gradient(north), np.gradient(east)))
        sampled.append(np.stack([east, north, yaw]))
        lengths.append(chainage[-1])
    east, north, yaw = np.concatenate(sampled, axis=1)
    after: list[list[int]] = [[] for _ in range(2 * len(tracks))]
    for run, follower in following:
        after[run].append(follower)
    count = len(east)
    starts = np.cumsum([0, *(each.shape[1] for each in sampled)])
    switch = np.zeros(len(places), dtype=np.int8)
    for run, followers in enumerate(after):
        if len(followers) > 1:
            switch[nodes[run >> 1, 1 - run % 2]] = 1
    unknown = np.full(count, np.nan, dtype=np.float32)
    more: dict[str, Any] = {
        "height": unknown,
        "grade_rad": unknown,
        "grade_std_rad": unknown,
        "across_std_m": np.full(count, 0.1, dtype=np.float32),
        "yaw_std_rad": np.full(count, 0.01, dtype=np.float32),
        "curvature_per_m": np.zeros(count),
        "partner": np.zeros(count, dtype=np.int8),
    }
    return Network(
        latitude_rad=float(np.radians(50.08)),
        longitude_rad=float(np.radians(14.43)),
        height_m=250.0,
        starts=starts.astype(np.int32),
        length_m=np.array(lengths),
        rules=np.array([each.rule for each in tracks], dtype=np.int8),
        from_node=nodes[:, 0],
        to_node=nodes[:, 1],
        node_id=100 + np.arange(len(places), dtype=np.int64),
        node_switch=switch,
        following_starts=np.cumsum([0, *map(len, after)]).astype(np.int32),
        following=np.array([each for one in after for each in one], dtype=np.int32),
        east=east,
        north=north,
        yaw_rad=yaw,
        stops=tuple(stops),
        ways=tuple(ways),
        source="made by hand",
        node_std_m=0.1,
        **more,
    )


# A street of two tracks from west to east with a loop at each end: a ring. From switch S a branch
# goes south, both ways; from its begin a crossover leads to the westbound track.
#
#         ┌──────── 4 (drawn eastwards, gone westwards) ──T──── 3 ────────┐
#    loop 7                                              6│              loop 2
#         └──────────────── 0 ────────────────────────────S──── 1 ────────┘
#                                                          5 ↘ branch
TOWN = (
    Track([(0, 0), (600, 0)]),
    Track([(600, 0), (1000, 0)]),
    Track([(1000, 0), (1100, 0), (1100, 100), (1000, 100)]),
    Track([(1000, 100), (600, 100)]),
    Track([(0, 100), (600, 100)], BACKWARDS),
    Track([(600, 0), (900, -400)], BOTH),
    Track([(600, 0), (600, 100)]),
    Track([(0, 100), (-100, 100), (-100, 0), (0, 0)]),
)
TOWN_FOLLOWING = ((0, 2), (0, 10), (2, 4), (4, 6), (6, 9), (9, 14), (14, 0), (11, 12), (12, 9))
RING_M = 600 + 400 + 300 + 400 + 600 + 300
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
    return made(TOWN, TOWN_FOLLOWING, stops, ways)
