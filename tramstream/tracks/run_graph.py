"""Shortest ways through the network on runs where trams are meant to go."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import rustworkx

from tramstream.tracks.network import Array, Network

APART_M = 1.0
"""A way is longer than this: who is asked to go from a place to itself goes round."""


class Place(NamedTuple):
    """A point of a run."""

    run: int
    at_m: float
    """Along the run."""


class Leg(NamedTuple):
    """The way from one place to another."""

    length_m: float
    runs: tuple[int, ...]
    """Those of both places and what lies between; one if the way stays on its run."""


class RunGraph:
    """Runs of a network and which may follow which; lengths once found are kept.

    Parameters
    ----------
    network : Network
    """

    def __init__(self, network: Network) -> None:
        self._length_m = np.repeat(network.length_m, 2)
        count = len(self._length_m)
        self._legal = np.zeros(count, dtype=bool)
        self._legal[network.edges] = True
        self._after: list[list[int]] = [
            [int(each) for each in network.following_of(run) if self._legal[each]]
            if self._legal[run]
            else []
            for run in range(count)
        ]
        self._before: list[list[int]] = [[] for _ in range(count)]
        self._graph: rustworkx.PyDiGraph[int, float] = rustworkx.PyDiGraph()
        self._graph.add_nodes_from(range(count))  # the begin of each run
        for run, afters in enumerate(self._after):
            for after in afters:
                self._before[after].append(run)
                self._graph.add_edge(run, after, float(self._length_m[run]))
        self._from: dict[int, Array] = {}

    def legal(self, run: int) -> bool:
        """Whether trams are meant to go there."""
        return bool(self._legal[run])

    def after(self, run: int) -> list[int]:
        """Runs that may be gone next."""
        return self._after[run]

    def before(self, run: int) -> list[int]:
        """Runs that may have been gone before."""
        return self._before[run]

    def length_m(self, run: int) -> float:
        return float(self._length_m[run])

    def between_m(self, begin: Place, end: Place) -> float:
        """Length of the shortest way; inf if there is none."""
        ahead_m = end.at_m - begin.at_m
        if begin.run == end.run and ahead_m > APART_M:
            return ahead_m
        rest_m = self.length_m(begin.run) - begin.at_m + end.at_m
        ways = [rest_m + float(self._from_begin(k)[end.run]) for k in self.after(begin.run)]
        return min((way for way in ways if way > APART_M), default=math.inf)

    def leg(self, begin: Place, end: Place) -> Leg:
        """The shortest way, which must exist."""
        length_m = self.between_m(begin, end)
        if begin.run == end.run and end.at_m - begin.at_m > APART_M:
            return Leg(length_m, (begin.run,))
        after = min(self.after(begin.run), key=lambda run: float(self._from_begin(run)[end.run]))
        if after == end.run:
            return Leg(length_m, (begin.run, after))
        paths = rustworkx.dijkstra_shortest_paths(self._graph, after, end.run, weight_fn=float)
        return Leg(length_m, (begin.run, *paths[end.run]))

    def _from_begin(self, run: int) -> Array:
        """Length of the way from the begin of a run to the begin of every other; inf: none."""
        if run not in self._from:
            found = rustworkx.dijkstra_shortest_path_lengths(self._graph, run, float)
            lengths = np.full(len(self._length_m), np.inf)
            lengths[list(found.keys())] = list(found.values())
            lengths[run] = 0.0
            self._from[run] = lengths
        return self._from[run]
