"""Tracks as chains of nodes for the fit, each with what its neighbours say beyond its ends.

So that a curve does not kink where a track ends, its chain goes on for `REACH_M` along the
straightest continuation over the rails on either side; only the inner part of the curve is kept.
Where two tracks are each other's straightest way on, both chains hold the same nodes there and
meet to millimetres. Of a branch that is not so: rails part tangentially, but maps draw a kink at
the switch, and one curve cannot have the direction of two. What is left of it is stated: near its
ends the deviations of a curve hold half the step to those that rails let follow (`_doubted`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.mapping.fit import Curves, Fit, fit
from tramstream.mapping.topology import Topology, straightest

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

REACH_M = 60.0
"""Six times what the fit looks around itself."""
FADES_M = 4.0
"""So far from a switch its kink is spread."""
CORNER_RAD = math.radians(60.0)
"""No rail turns so far at one node: what is drawn so (the outline of an area, say) is followed."""
CORNER_STEP_M = 2.0
"""Nodes are put so close on the chords that meet there, for a smooth curve swings out of them."""


class Laid(NamedTuple):
    """Curves of all tracks."""

    fit: Fit
    node_starts: NDArray[np.int64]
    """First of each track's nodes in `fit.node_arc_m`, and the number of all."""

    nodes: Array
    """East, north of all tracks' nodes, as the map has them, m."""

    def node_plan(self, track: int) -> Array:
        """East, north of each node of a track, m."""
        return self.nodes[self.node_starts[track] : self.node_starts[track + 1]]

    def node_arc_m(self, track: int) -> Array:
        """Arc length of each node of a track."""
        return self.fit.node_arc_m[self.node_starts[track] : self.node_starts[track + 1]]


def lay(
    topology: Topology, plan: Mapping[int, tuple[float, float]], node_std_m: float | None = None
) -> Laid:
    """Fit curves to all tracks; see `track_fit.fit`.

    Parameters
    ----------
    topology : Topology
    plan : mapping
        East and north of each node, m.
    node_std_m : float, optional
    """
    points = [np.array([plan[node] for node in chain.nodes]) for chain in topology.chains]
    pieces, own, drawn = [], [], []
    for track, nodes in enumerate(points):
        inner, of_map = _with_corners(nodes)
        drawn.append(of_map)
        after = _beyond(topology, points, 2 * track)
        before = _beyond(topology, points, 2 * track + 1)[::-1]
        pieces.append(np.concatenate([before, inner, after]))
        own.append(np.repeat([False, True, False], [len(before), len(inner), len(after)]))
    starts = np.cumsum([0, *map(len, pieces)])
    fitted = fit(Curves(starts, np.concatenate(pieces), np.concatenate(own)), node_std_m)
    fitted = replace(fitted, node_arc_m=fitted.node_arc_m[np.concatenate(drawn)])
    node_starts = np.cumsum([0, *map(len, points)])
    return Laid(_doubted(topology, fitted), node_starts, np.concatenate(points))


def _with_corners(points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Put nodes on the chords that meet at a corner; gives all nodes, and which are the map's."""
    step = np.diff(points, axis=0)
    way = np.hypot(*step.T)
    turn = np.abs(np.angle(np.exp(1j * np.diff(np.arctan2(step[:, 1], step[:, 0])))))
    sharp = np.concatenate([[False], turn > CORNER_RAD, [False]])
    count = np.where(sharp[:-1] | sharp[1:], np.ceil(way / CORNER_STEP_M), 1).astype(np.int64)
    count = np.maximum(count, 1)
    chord = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(chord)) - np.repeat(np.cumsum(count) - count, count)
    found = points[chord] + step[chord] * (within / count[chord])[:, None]
    return np.concatenate([found, points[-1:]]), np.append(within == 0, True)


def _beyond(topology: Topology, points: list[Array], run: int) -> Array:
    """Nodes after the end of a run, the straightest way on, shape (n, 2)."""
    found: list[Array] = []
    left_m, seen = REACH_M, set()
    ahead = straightest(topology, run)
    while ahead >= 0 and left_m > 0 and ahead >> 1 not in seen:
        seen.add(ahead >> 1)
        chain = points[ahead >> 1][:: 1 if ahead % 2 == 0 else -1]
        gone = np.cumsum(np.hypot(*np.diff(chain, axis=0).T))
        count = min(int(np.searchsorted(gone, left_m)) + 1, len(gone))
        found.append(chain[1 : count + 1])
        left_m -= gone[count - 1]
        ahead = straightest(topology, ahead)
    return np.concatenate(found) if found else np.empty((0, 2))


class Steps(NamedTuple):
    """What curves of runs that follow each other differ by at their common node, shape (n,)."""

    before: Integers
    after: Integers
    """Runs."""
    across_m: Array
    """How far left of the end of the one the other begins."""
    turn_rad: Array


def steps(following: Sequence[Sequence[int]], fitted: Fit) -> Steps:
    """Compare curves where runs follow runs.

    Parameters
    ----------
    following : sequence
        Of each run, those that rails let follow.
    fitted : Fit
    """
    before = np.repeat(np.arange(len(following)), [len(each) for each in following])
    after = np.array([run for ahead in following for run in ahead], dtype=np.int64)
    end, begin = _sample_at_end(fitted, before), _sample_at_end(fitted, after ^ 1)
    yaw = fitted.yaw_rad[end] + np.pi * (before % 2)
    turn = fitted.yaw_rad[begin] + np.pi * (after % 2) - yaw
    east, north = (fitted.position[begin] - fitted.position[end]).T
    across = np.cos(yaw) * north - np.sin(yaw) * east
    return Steps(before, after, across, np.angle(np.exp(1j * turn)))


def _sample_at_end(fitted: Fit, run: Integers) -> Integers:
    """Sample where runs end."""
    first, last = fitted.starts[run >> 1], fitted.starts[(run >> 1) + 1] - 1
    sample: Integers = np.where(run % 2 == 0, last, first)
    return sample


def _doubted(topology: Topology, fitted: Fit) -> Fit:
    """Add to the deviations near the ends of curves what these disagree by with others."""
    found = steps(topology.following, fitted)
    across, yaw = np.zeros(2 * len(topology.chains)), np.zeros(2 * len(topology.chains))
    for run in (found.before, found.after ^ 1):
        np.maximum.at(across, run, np.abs(found.across_m) / 2)
        np.maximum.at(yaw, run, np.abs(found.turn_rad) / 2)
    counts = np.diff(fitted.starts)
    track = np.repeat(np.arange(len(counts)), counts)
    spacing = (fitted.length_m / (counts - 1))[track]
    from_begin = (np.arange(fitted.starts[-1]) - fitted.starts[track]) * spacing
    across_2, yaw_2 = fitted.across_std_m**2, fitted.yaw_std_rad**2
    for run, away in (2 * track, fitted.length_m[track] - from_begin), (2 * track + 1, from_begin):
        fading = np.exp(-((away / FADES_M) ** 2) / 2)
        across_2 = across_2 + (across[run] * fading) ** 2
        yaw_2 = yaw_2 + (yaw[run] * fading) ** 2
    return replace(fitted, across_std_m=np.sqrt(across_2), yaw_std_rad=np.sqrt(yaw_2))
