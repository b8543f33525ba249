"""Stops and lines of an operator on the network, and which lines go where.

A line is asked for as the names of its stops in order. A name may be that of several stops, and a
stop may be passed on several runs; the path taken is the one that is shortest in total over all of
these choices, on runs where trams are meant to go.
"""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from tramstream.errors import ConfigError
from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.osm import Extract
from tramstream.tracks.network import Array, LineStop, Network, RouteLine, Stop
from tramstream.tracks.run_graph import Place, RunGraph

STOP_NEAR_M = 15.0
"""A stop that the map draws beside the rails lies on the nearest track within this."""
ON_WAY_M = 2.5
"""A stop that is a node of a way is as near to its track: the curve is smooth, the way is not. On a
way that the network left out it is farther from all others."""
DETOUR, DETOUR_M = 3.0, 1500.0
"""Longest way between neighbouring stops: so many times the straight distance, and so much more for
a terminal loop. A longer one means that a piece of the network is missing there."""
_REFS = ("ref:PID", "ref:IFOPT", "local_ref", "ref")
"""Tags with an operator's number of a stop, the most particular first."""
_JOINT_M = 0.5
"""A stop as close to the end of a run also lies at the begin of those that follow."""
_SAME_STOP_M = 30.0
"""A stop of a line that is given with its place is one of its name within this."""


class _Choice(NamedTuple):
    """Where a line may make one of its stops."""

    name: str
    places: tuple[Place, ...]
    names: tuple[str, ...]
    """Of each place, the network's own."""
    plan: Array
    """Of each place, shape (n, 2)."""


# Stops --------------------------------------------------------------------------------------------
def place_stops(network: Network, extract: Extract) -> Network:
    """Put the stops of an extract on their tracks.

    A stop that is a node of a way lies on that way, or is left out with it; any other lies on the
    nearest track within `STOP_NEAR_M`, or is left out where there is none.

    Returns
    -------
    network : Network
        With these stops and no others, in order of tracks and chainage.
    """
    parts: dict[int, list[tuple[int, float, float]]] = {}
    for track, from_m, to_m, osm_id, _ in network.ways:
        parts.setdefault(osm_id, []).append((track, from_m, to_m))
    holding: dict[int, list[tuple[int, float, float]]] = {}
    for way in extract.ways.values():
        for node in way.nodes:
            holding.setdefault(node, []).extend(parts.get(way.osm_id, []))
    drawn = [shapely.LineString(_drawn(network, k)[0]) for k in range(network.track_count)]
    tree = shapely.STRtree(drawn)
    stops = []
    for node, tags in extract.stops.items():
        point = shapely.Point(network.plan_of(extract.places[node]))
        tracks = tree.query(point, predicate="dwithin", distance=STOP_NEAR_M)
        whole = [(int(k), 0.0, float(network.length_m[k])) for k in tracks]
        found = []
        for track, from_m, to_m in holding.get(node) or whole:
            share = drawn[track].project(point, normalized=True)
            chainage_m = min(max(share * float(network.length_m[track]), from_m), to_m)
            share = chainage_m / float(network.length_m[track])
            away_m = point.distance(drawn[track].interpolate(share, normalized=True))
            found.append((away_m, track, chainage_m))
        away_m, track, chainage_m = min(found, default=(np.inf, 0, 0.0))
        if away_m <= (ON_WAY_M if node in holding else STOP_NEAR_M):
            ref = next((tags[key] for key in _REFS if tags.get(key)), "")
            stops.append(Stop(tags.get("name") or ref or f"stop {node}", track, chainage_m, ref))
    stops.sort(key=lambda stop: (stop.track, stop.chainage_m))
    return replace(network, stops=tuple(stops))


def _drawn(network: Network, track: int) -> tuple[Array, Array]:
    """Samples of a track in the plan, and their chainages."""
    part = network.samples_of(track)
    points = np.stack([network.east[part], network.north[part]], axis=1)
    return points, np.linspace(0.0, float(network.length_m[track]), len(points))


# Lines --------------------------------------------------------------------------------------------
def lay_lines(network: Network, requests: Sequence[LineRequest]) -> tuple[Network, tuple[str, ...]]:
    """Find the path of each line.

    Parameters
    ----------
    network : Network
        With its stops.
    requests : sequence of LineRequest
        Lines that the network has already are laid anew.

    Returns
    -------
    network : Network
        With the lines added.
    findings : tuple of str
        One sentence for each line that was left out, with line, direction, stop and cure.
    """
    graph, stops = RunGraph(network), _Stops(network)
    laid, findings = [], []
    for request in requests:
        try:
            laid.append(_lay(graph, request, stops.choices(request, graph)))
        except ConfigError as error:
            findings.append(f"{request.name}: {error}")
    names = {(each.line, each.direction) for each in requests}
    kept = [each for each in network.lines if (each.line, each.direction) not in names]
    return replace(network, lines=(*kept, *laid)), tuple(findings)


def path_of(network: Network, runs: Sequence[int], begin_m: float, length_m: float) -> Array:
    """Give the samples along a path.

    Parameters
    ----------
    network : Network
    runs : sequence of int
        In the order in which they are gone.
    begin_m : float
        Where the path begins on the first of them.
    length_m : float
        Of the path.

    Returns
    -------
    path : ndarray, shape (n, 3)
        Distance along the path, east and north, m; no two rows have the same distance.
    """
    parts, done_m = [], -begin_m
    for run in runs:
        points, chainage = _drawn(network, run >> 1)
        parts.append(np.column_stack([chainage + done_m, points if run % 2 == 0 else points[::-1]]))
        done_m += float(chainage[-1])
    rows = np.concatenate(parts)
    ends = np.array([0.0, length_m])
    edges = np.stack([ends, *(np.interp(ends, rows[:, 0], rows[:, k]) for k in (1, 2))], axis=1)
    inside = rows[(rows[:, 0] > 0.0) & (rows[:, 0] < length_m)]
    path = np.concatenate([edges[:1], inside, edges[1:]])
    moved: Array = path[np.concatenate([[True], np.diff(path[:, 0]) > 0.0])]
    return moved


def _lay(graph: RunGraph, request: LineRequest, choices: list[_Choice]) -> RouteLine:
    """One line; see `lay_lines`."""
    best = _shortest(graph, choices)
    chosen = [choice.places[k] for choice, k in zip(choices, best, strict=True)]
    names = [choice.names[k] for choice, k in zip(choices, best, strict=True)]
    runs, chainage_m = [chosen[0].run], [0.0]
    for begin, end in pairwise(chosen):
        leg = graph.leg(begin, end)
        runs += leg.runs[1:]
        chainage_m.append(chainage_m[-1] + leg.length_m)
    begin_m = chosen[0].at_m
    if begin_m >= graph.length_m(runs[0]):
        begin_m = 0.0
        runs.pop(0)
    if chosen[-1].at_m <= 0.0:
        runs.pop()
    stops = tuple(LineStop(*each) for each in zip(names, chainage_m, strict=True))
    return RouteLine(
        request.line,
        request.direction,
        stops[0].name,
        stops[-1].name,
        tuple(runs),
        begin_m,
        chainage_m[-1],
        stops,
    )


def _shortest(graph: RunGraph, choices: list[_Choice]) -> list[int]:
    """Which of its places each stop is at, so that the whole way is shortest."""
    total = np.zeros(len(choices[0].places))
    came_from = []
    for begin, end in pairwise(choices):
        ways = np.array([[graph.between_m(a, b) for b in end.places] for a in begin.places])
        straight = np.hypot(*np.moveaxis(begin.plan[:, None] - end.plan[None], -1, 0))
        usual = np.where(ways <= DETOUR * straight + DETOUR_M, ways, np.inf)
        sums = total[:, None] + usual
        if not np.isfinite(sums).any():
            raise ConfigError(_gap(begin, end, ways, straight))
        came_from.append(np.argmin(sums, axis=0))
        total = np.min(sums, axis=0)
    best = int(np.argmin(total))
    chosen = [best]
    for each in reversed(came_from):
        best = int(each[best])
        chosen.append(best)
    return chosen[::-1]


def _gap(begin: _Choice, end: _Choice, ways: Array, straight: Array) -> str:
    """The sentence for two stops between which no tram would go."""
    shortest_m = float(np.min(ways))
    if np.isfinite(shortest_m):
        apart_m = float(straight.ravel()[np.argmin(ways)])
        fact = f"goes {shortest_m / 1000:.1f} km round, for {apart_m / 1000:.1f} km"
    else:
        fact = "leaves the network"
    return (
        f"between stops {begin.name!r} and {end.name!r} it {fact}; mend the track, switch or "
        "one-way rule that is missing or wrong there in the map, or name the stop between them"
    )


class _Stops:
    """The network's stops by name."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._exact: dict[str, list[int]] = {}
        self._loose: dict[str, list[int]] = {}
        for index, stop in enumerate(network.stops):
            self._exact.setdefault(stop.name, []).append(index)
            self._loose.setdefault(_loosened(stop.name), []).append(index)

    def choices(self, request: LineRequest, graph: RunGraph) -> list[_Choice]:
        """All places where a line may make its stops."""
        choices = []
        for index, name in enumerate(request.stops):
            found = self._called(name)
            plan = np.array([self._plan(stop) for stop in found])
            if request.places:
                away = np.hypot(*(plan - self._network.plan_of(request.places[index])).T)
                near = away < _SAME_STOP_M
                found = [
                    stop for stop, is_near in zip(found, near, strict=True) if is_near
                ] or found
            places = [(place, stop) for stop in found for place in self._places(graph, stop)]
            if not places:
                raise ConfigError(
                    f"stop {name!r} lies on a track where no tram is meant to go; correct its rule "
                    "in the map"
                )
            choices.append(
                _Choice(
                    name,
                    tuple(place for place, _ in places),
                    tuple(self._network.stops[stop].name for _, stop in places),
                    np.array([self._plan(stop) for _, stop in places]),
                )
            )
        return choices

    def _called(self, name: str) -> list[int]:
        """Stops of that very name, or else those that differ in case, accents and dashes alone."""
        found = self._exact.get(name) or self._loose.get(_loosened(name))
        if found:
            return found
        near = difflib.get_close_matches(name, list(self._exact), n=3, cutoff=0.7)
        hint = f"; near: {', '.join(near)}" if near else ""
        raise ConfigError(
            f"stop {name!r} is not on the network{hint}; correct the name, or build from an "
            "extract that holds the stop"
        )

    def _plan(self, stop: int) -> Array:
        _, track, chainage_m, _ = self._network.stops[stop]
        points, chainage = _drawn(self._network, track)
        return np.array([np.interp(chainage_m, chainage, points[:, k]) for k in (0, 1)])

    def _places(self, graph: RunGraph, stop: int) -> list[Place]:
        """On each run that passes a stop; at a joint of tracks on those of both sides."""
        _, track, chainage_m, _ = self._network.stops[stop]
        length_m = graph.length_m(2 * track)
        places = []
        for run, at_m in ((2 * track, chainage_m), (2 * track + 1, length_m - chainage_m)):
            if graph.legal(run):
                places.append(Place(run, at_m))
                if at_m > length_m - _JOINT_M:
                    places += [Place(each, 0.0) for each in graph.after(run)]
                if at_m < _JOINT_M:
                    places += [Place(each, graph.length_m(each)) for each in graph.before(run)]
        return places


def _loosened(name: str) -> str:
    """A name without case, accents, kinds of dashes and of blanks."""
    letters = unicodedata.normalize("NFKD", name.casefold())
    plain = "".join(each for each in letters if not unicodedata.combining(each))
    return " ".join(plain.replace("–", "-").replace("—", "-").split())
