"""Rides on a track network whose truth is known: a route, a line along it, and what is where.

A `Route` is a way over rails: an operator's line, or a *detour* that leaves it at switches. The
`Line` that the simulated tram runs on is laid beside the network's curve and not on it: a map is
wrong. The curve is shifted to the left and right by a smooth random error (`MapError`) and a new
line is fitted to what comes out, so that truth and network differ in position, heading and
curvature as a rail and a map of it do. Laid through the map's own nodes, the truth would contain
every error of the map, and the matcher would be tested on a map that is nearly exact.

Where the tram truly is follows from this construction: points of the route become points of the
shifted chain, the fit says which arc length lies beside which of these, and all of it is monotone.
Nothing is searched for by distance, so that no neighbour can be mistaken for the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream.errors import ConfigError
from tramstream.lines import geojson
from tramstream.lines.line import Line
from tramstream.tracks.network import Array, Network, RouteLine

Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

POINT_M = 1.0
"""Between points of a route: those of the network are as dense."""
ERROR_STD_M = 0.4
ERROR_LENGTH_M = 30.0
MOVING_M = 40.0
"""Over which rails that were laid anew leave where they lay: 5 m need curves of 65 m then."""
LOST_SHARE = 0.01
"""Of a route's length that a line along it may lack before it is no line along it."""


class Route(NamedTuple):
    """A way over rails."""

    name: str
    runs: tuple[int, ...]
    """In the order in which they are gone; each may follow the one before."""
    begin_m: float
    """Where the route begins on its first run, along that run."""
    length_m: float
    stops_m: tuple[float, ...]
    """Along the route, ascending."""


class MapError(NamedTuple):
    """How far the network is to the side of the rails: a smooth random function of the way.

    OpenStreetMap's nodes come from aerial images, on which a rail is seen to a few decimetres;
    neighbouring nodes, 10 to 30 m apart, are wrong by much the same.
    """

    std_m: float = ERROR_STD_M
    length_m: float = ERROR_LENGTH_M
    """Correlation exp(−d²/2 length²)."""
    beside_m: float = 0.0
    """The rails are so much to the left of the map, all along,"""
    east_m: float = 0.0
    north_m: float = 0.0
    """or so far to the east and north: a map in another datum,"""
    turned_rad: float = 0.0
    """or turned to the left about the middle of the route."""
    moved_m: float = 0.0
    """Rails that were laid anew are so much to the left of where the map has them,"""
    moved_from_m: float = 0.0
    moved_to_m: float = 0.0
    """between these places of the route; they leave and come back over `MOVING_M`."""


class Spots(NamedTuple):
    """Points on runs, one row each."""

    run: Integers
    chainage_m: Array
    """Along the run."""


class Choice(NamedTuple):
    """A place of a route where rails part."""

    route_m: float
    node: int
    run: int
    """That ends here."""
    taken: int
    others: tuple[int, ...]


@dataclass(frozen=True)
class NetworkRide:
    """A line beside a route of a network, and what is beside what."""

    network: Network
    route: Route
    line: Line
    arc_length_m: Array
    """Of points of the line, ascending, and"""
    route_m: Array
    """how far along the route these are."""

    def route_at(self, arc_length_m: ArrayLike) -> Array:
        """How far along the route the tram is at arc lengths of the line, m."""
        along: Array = np.interp(
            np.asarray(arc_length_m, dtype=float), self.arc_length_m, self.route_m
        )
        return along

    def arc_length_at(self, route_m: ArrayLike) -> Array:
        """The inverse of `route_at`."""
        arc_length: Array = np.interp(
            np.asarray(route_m, dtype=float), self.route_m, self.arc_length_m
        )
        return arc_length

    def spots_at(self, route_m: ArrayLike) -> Spots:
        """Runs and chainages of points of the route."""
        return spots(self.network, self.route, route_m)

    @cached_property
    def choices(self) -> list[Choice]:
        """Where on the route rails part, in order."""
        ends = _ends(self.network, self.route)[:-1]
        network, found = self.network, []
        for (run, taken), at in zip(pairwise(self.route.runs), ends.tolist(), strict=True):
            others = tuple(each for each in network.following_of(run).tolist() if each != taken)
            if others and 0.0 < at < self.route.length_m:
                found.append(Choice(at, end_node(network, run), run, taken, others))
        return found


# Points -------------------------------------------------------------------------------------------
def end_node(network: Network, run: int) -> int:
    """The node that a run leads to."""
    return int((network.from_node if run % 2 else network.to_node)[run >> 1])


def plan_at(network: Network, at: Spots) -> Array:
    """East and north of points on runs, m, shape (n, 2); beyond a run's end its end."""
    track = at.run >> 1
    length = network.length_m[track]
    drawn = np.where(at.run % 2 == 0, at.chainage_m, length - at.chainage_m)
    sample = np.clip(drawn, 0.0, length) / network.spacing_m[track]
    first = np.minimum(sample.astype(np.int64), np.diff(network.starts)[track] - 2)
    past = sample - first
    first = first + network.starts[track]
    return np.stack(
        [
            values[first] * (1.0 - past) + values[first + 1] * past
            for values in (network.east, network.north)
        ],
        axis=1,
    )


def sampled(network: Network, values: NDArray[Any], at: Spots) -> NDArray[Any]:
    """Values of the network's samples nearest to points on runs, of tracks as drawn."""
    track = at.run >> 1
    length = network.length_m[track]
    drawn = np.where(at.run % 2 == 0, at.chainage_m, length - at.chainage_m)
    nearest = np.rint(np.clip(drawn, 0.0, length) / network.spacing_m[track]).astype(np.int64)
    found: NDArray[Any] = values[network.starts[track] + nearest]
    return found


def spots(network: Network, route: Route, route_m: ArrayLike) -> Spots:
    """Runs and chainages of points of a route."""
    ends = _ends(network, route)
    along = np.clip(np.asarray(route_m, dtype=float), 0.0, route.length_m)
    index = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    starts = np.concatenate([[-route.begin_m], ends[:-1]])
    return Spots(np.array(route.runs, dtype=np.int64)[index], along - starts[index])


def _ends(network: Network, route: Route) -> Array:
    """How far along the route each of its runs ends."""
    lengths = network.length_m[np.array(route.runs) >> 1]
    ends: Array = np.cumsum(lengths) - route.begin_m
    return ends


# Laying -------------------------------------------------------------------------------------------
def route_of(line: RouteLine) -> Route:
    """Give an operator's line as a route."""
    stops = tuple(stop.chainage_m for stop in line.stops)
    return Route(f"{line.line}/{line.direction}", line.runs, line.begin_m, line.length_m, stops)


def lay(
    network: Network, route: Route, rng: Generator, error: MapError | None = None
) -> NetworkRide:
    """Lay a line beside a route.

    Parameters
    ----------
    network : Network
    route : Route
    rng : Generator
        Of the map's error.
    error : MapError, optional

    Raises
    ------
    ConfigError
        If no tram can follow the route: it is too tight somewhere, or doubles back.
    """
    count = math.ceil(route.length_m / POINT_M) + 1
    route_m = np.linspace(0.0, route.length_m, count)
    at = spots(network, route, route_m)
    points = plan_at(network, at)
    direction = np.gradient(points, axis=0)
    direction /= np.hypot(*direction.T)[:, None]
    left = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    error = error or MapError()
    across_m = error.beside_m + _across_m(route_m, rng, error) + _anew_m(route_m, error)
    points = _moved(points + left * across_m[:, None], error)
    chain_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    geodetic = np.column_stack([network.geodetic_of(points), _heights(network, at)])
    stops_m = np.interp(route.stops_m, route_m, chain_m).tolist()
    mapped = geojson.Track(route.name, geodetic, stops_m, float(chain_m[-1]))
    laid = geojson.lay_beside(mapped)
    if laid.line.length_m < (1.0 - LOST_SHARE) * chain_m[-1]:
        raise ConfigError(f"route {route.name}: doubles back; no tram can follow it in one go")
    beside_m = np.interp(laid.chainage_m, chain_m, route_m)
    return NetworkRide(network, route, laid.line, laid.arc_length_m, beside_m)


def _moved(points: Array, error: MapError) -> Array:
    """Turn and shift the rails against the map."""
    if not (error.turned_rad or error.east_m or error.north_m):
        return points
    cos, sin = math.cos(error.turned_rad), math.sin(error.turned_rad)
    middle = points.mean(axis=0)
    shift = middle + np.array([error.east_m, error.north_m])
    moved: Array = shift + (points - middle) @ np.array([[cos, sin], [-sin, cos]])
    return moved


def _anew_m(route_m: Array, error: MapError) -> Array:
    """How far to the left rails were laid anew; the curves there begin and end without a step."""
    way = np.minimum(route_m - error.moved_from_m, error.moved_to_m - route_m) / MOVING_M
    share = np.clip(way, 0.0, 1.0)
    anew: Array = error.moved_m * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return anew


def _across_m(route_m: Array, rng: Generator, error: MapError) -> Array:
    """The map's error to the left, by a Gaussian filter of white noise."""
    step_m = error.length_m / 8.0
    std_steps = error.length_m / math.sqrt(2.0) / step_m
    reach = math.ceil(4.0 * std_steps)
    weights = np.exp(-((np.arange(-reach, reach + 1) / std_steps) ** 2) / 2.0)
    weights *= error.std_m / math.sqrt(float(np.sum(weights**2)))
    count = math.ceil(route_m[-1] / step_m) + 1
    white = rng.standard_normal(count + 2 * reach)
    across: Array = np.interp(
        route_m, np.arange(count) * step_m, np.convolve(white, weights, "valid")
    )
    return across


def _heights(network: Network, at: Spots) -> Array:
    """Height above the ellipsoid, m; where the map has none, that of the nearest that has one."""
    heights = sampled(network, network.height, at).astype(float)
    known = np.isfinite(heights)
    if not np.any(known):
        return np.full(len(heights), network.height_m)
    number = np.arange(len(heights))
    filled: Array = np.interp(number, number[known], heights[known])
    return filled
