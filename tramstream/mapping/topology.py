"""Which rails join which: ways of a map become tracks between nodes, and runs that follow runs.

A node of the map is a node of the network where tracks join, end, cross or change their rules;
all others are passed through (a directed contraction). A ring that no track joins gets one node,
its first. One-way tracks are drawn in their direction of use.

Which run rails let follow which is geometry, rules aside: nobody turns on the spot. Directions are
those of the chain over `LOOK_M` beside the node, since a map's nodes are noisy and switches are
drawn with a kink; there even the tightest curves turn by less than `TURN_MAX_RAD`. Two tracks that
cross at one node are told from a switch by their straight ways on: who turns by more than
`SLIP_MAX_RAD` where both runs have a straighter way would leave the rails.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.mapping.osm import OsmWay
from tramstream.tracks.network import BACKWARDS, FORWARDS, rule

Array = NDArray[np.float64]

TURN_MAX_RAD = math.radians(45.0)
"""Prague's legal ways on need 39 deg, and all but a stub that is drawn with corners 29 deg."""
SLIP_MAX_RAD = math.radians(25.0)
"""Two curves of 18 m radius that part turn by 2 · 8 m / 36 m over `LOOK_M` on either side."""
LOOK_M = 8.0
_REVERSED = ("-1", "reverse")
_ONE_WAY = ("yes", "true", "1")


class Chain(NamedTuple):
    """A track: its nodes as drawn, its ways, one a segment, and its rules."""

    nodes: tuple[int, ...]
    ways: tuple[int, ...]
    """Number of the way of each segment; shape (nodes - 1,)."""
    rules: int


@dataclass(frozen=True)
class Topology:
    """Tracks and how they join."""

    chains: tuple[Chain, ...]
    nodes: tuple[int, ...]
    """The network's nodes, by the map's numbers."""
    following: tuple[tuple[int, ...], ...]
    """Of each run."""
    turn_rad: dict[tuple[int, int], float]
    """Change of direction from a run to any other that leaves the node where it arrives."""

    def run_ends(self, run: int) -> tuple[int, int]:
        """The map's numbers of the nodes that a run goes from and to."""
        nodes = self.chains[run >> 1].nodes
        return (nodes[0], nodes[-1]) if run % 2 == 0 else (nodes[-1], nodes[0])

    def is_edge(self, run: int) -> bool:
        """Whether trams are meant to go there."""
        return bool(self.chains[run >> 1].rules & (FORWARDS if run % 2 == 0 else BACKWARDS))


def direction(tags: Mapping[str, str]) -> int:
    """Rules of a way as it is drawn, from tag `oneway`; both ways for a value nobody knows."""
    oneway = tags.get("oneway", "no")
    return rule(oneway not in _REVERSED, oneway not in _ONE_WAY)


def contract(ways: Iterable[OsmWay]) -> tuple[Chain, ...]:
    """Make tracks of ways; see the module."""
    after, before, segment_way = _segments(ways)
    beside = {node: list(dict.fromkeys([*after[node], *before[node]])) for node in after}
    joins = [node for node in beside if not _is_passed(after[node], before[node])]
    drawn: set[tuple[int, int]] = set()
    chains: list[Chain] = []
    starts = [*joins, *beside]  # what no node reaches are rings: they start anywhere
    stops = set(joins)
    for start in starts:
        for first in beside[start]:
            if (start, first) in drawn:
                continue
            stops.add(start)
            nodes = [start, first]
            while nodes[-1] not in stops:
                ahead = beside[nodes[-1]]
                nodes.append(ahead[0] if ahead[0] != nodes[-2] else ahead[1])
            drawn.update(pairwise(nodes))
            drawn.update(pairwise(nodes[::-1]))
            chains.append(_chain(nodes, after, segment_way))
    return tuple(chains)


def _segments(
    ways: Iterable[OsmWay],
) -> tuple[dict[int, list[int]], dict[int, list[int]], dict[tuple[int, int], int]]:
    """Nodes that may be gone to from each node, from which it may be reached, and the way."""
    after: dict[int, list[int]] = {}
    before: dict[int, list[int]] = {}
    segment_way: dict[tuple[int, int], int] = {}
    for way in ways:
        rules = direction(way.tags)
        for a, b in pairwise(way.nodes):
            if a == b:
                continue
            for one, other, bit in ((a, b, FORWARDS), (b, a, BACKWARDS)):
                after.setdefault(one, [])
                before.setdefault(one, [])
                segment_way.setdefault((one, other), way.osm_id)
                if rules & bit and other not in after[one]:
                    after[one].append(other)
                    before.setdefault(other, []).append(one)
    return after, before, segment_way


def _is_passed(after: list[int], before: list[int]) -> bool:
    """Whether a node is only passed through: one way, or both ways."""
    if len(after) == len(before) == 1:
        return after != before
    return len(after) == 2 and set(after) == set(before)


def _chain(
    nodes: list[int], after: dict[int, list[int]], segment_way: dict[tuple[int, int], int]
) -> Chain:
    rules = rule(nodes[1] in after[nodes[0]], nodes[0] in after[nodes[1]])
    if rules == BACKWARDS:
        nodes, rules = nodes[::-1], FORWARDS
    return Chain(tuple(nodes), tuple(segment_way[pair] for pair in pairwise(nodes)), rules)


def join(chains: tuple[Chain, ...], plan: Mapping[int, tuple[float, float]]) -> Topology:
    """Find which runs rails let follow which.

    Parameters
    ----------
    chains : tuple of Chain
    plan : mapping
        East and north of each node, m.
    """
    yaw_begin, yaw_end = {}, {}
    leaving: dict[int, list[int]] = {}
    for track, chain in enumerate(chains):
        points = np.array([plan[node] for node in chain.nodes])
        out, back = _yaw_from_begin(points), _yaw_from_begin(points[::-1])
        yaw_begin[2 * track], yaw_end[2 * track] = out, back + math.pi
        yaw_begin[2 * track + 1], yaw_end[2 * track + 1] = back, out + math.pi
        leaving.setdefault(chain.nodes[0], []).append(2 * track)
        leaving.setdefault(chain.nodes[-1], []).append(2 * track + 1)
    turns = _turns(leaving, yaw_begin, yaw_end)
    following = tuple(_following(run, turns) for run in range(2 * len(chains)))
    return Topology(chains, tuple(leaving), following, _pairs(turns))


class _Turns(NamedTuple):
    """Changes of direction at nodes, one's own way back left out."""

    onto: list[dict[int, float]]
    """By run: the runs that leave the node where it arrives, and the turn onto each, rad."""
    least_from: list[float]
    """By run: the least size of a turn from it, rad."""
    least_onto: list[float]
    """By run: the least size of a turn onto it, rad."""


def _turns(
    leaving: dict[int, list[int]], yaw_begin: dict[int, float], yaw_end: dict[int, float]
) -> _Turns:
    count = len(yaw_begin)
    found = _Turns([{} for _ in range(count)], [math.inf] * count, [math.inf] * count)
    for runs in leaving.values():
        for opposite in runs:
            run = opposite ^ 1  # arrives where its opposite leaves
            for other in runs:
                if other == opposite:
                    continue
                turn = math.remainder(yaw_begin[other] - yaw_end[run], 2 * math.pi)
                found.onto[run][other] = turn
                found.least_from[run] = min(found.least_from[run], abs(turn))
                found.least_onto[other] = min(found.least_onto[other], abs(turn))
    return found


def _following(run: int, turns: _Turns) -> tuple[int, ...]:
    """Runs that rails let follow a run, straightest first."""
    allowed = []
    for other, turn in turns.onto[run].items():
        straightest = max(turns.least_from[run], turns.least_onto[other])
        limit = TURN_MAX_RAD if abs(turn) <= straightest else SLIP_MAX_RAD
        if abs(turn) < limit:
            allowed.append((abs(turn), other))
    return tuple(other for _, other in sorted(allowed))


def _pairs(turns: _Turns) -> dict[tuple[int, int], float]:
    return {
        (run, other): turn for run, onto in enumerate(turns.onto) for other, turn in onto.items()
    }


def _yaw_from_begin(points: Array) -> float:
    """Direction from the first point to where the chain has left it by `LOOK_M`."""
    away = np.hypot(*(points - points[0]).T)
    beyond = int(np.argmax(away >= LOOK_M))
    if away[beyond] < LOOK_M:
        target = points[int(np.argmax(away))]
    else:
        share = (LOOK_M - away[beyond - 1]) / (away[beyond] - away[beyond - 1])
        target = points[beyond - 1] + share * (points[beyond] - points[beyond - 1])
    east, north = target - points[0]
    return math.atan2(north, east)


def straightest(topology: Topology, run: int) -> int:
    """The run that goes straightest on from a run, -1 where rails end."""
    following = topology.following[run]
    return following[0] if following else -1
