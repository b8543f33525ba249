"""What a line is known by where nobody knows a place: its headings along the way, its stops.

A `Signature` is one direction of an operator's line: the heading of the track each metre, where
curves, stops and switches are, and how far headings and stops scatter. It comes from a network's
line, from an exact line, or from rides that went along it (`analysis/segments/learning.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.lines.line import Line
from tramstream.tracks.network import Network, RouteLine

Array = NDArray[np.float64]

STEP_M = 1.0
"""Between headings."""
LIMIT_PER_M = 1.0 / 300.0
"""Curvature of a curve; less is straight."""
GAP_M = 3.0
"""A curve that is interrupted for less is one."""
MAP_HEADING_STD_RAD = 0.012
"""How far headings of a map are off those of the rails: 0.4 m within 30 m."""
STOP_STD_M = 6.0
"""How far from where a map has a stop vehicles stand."""
SAME_PLACE_M = 15.0
"""Two directions of a line are so near each other at most."""


class Piece(NamedTuple):
    """A straight or a curve between two points of a line."""

    begin_m: float
    end_m: float
    angle_rad: float
    """Left positive; of a straight what it bends by."""
    curve: bool

    @property
    def length_m(self) -> float:
        return self.end_m - self.begin_m

    @property
    def radius_m(self) -> float:
        """Way over angle; infinite where there is none."""
        return self.length_m / abs(self.angle_rad) if self.angle_rad else math.inf


@dataclass(frozen=True)
class Signature:
    """One direction of a line; see the module."""

    line: str
    direction: str
    yaw_rad: Array
    """Each `STEP_M` from chainage 0 on, counter-clockwise, continuous; any heading is the first."""
    stops_m: Array
    """Chainages, ascending."""
    stop_names: tuple[str, ...] = ()
    switches_m: Array = field(default_factory=lambda: np.zeros(0))
    plan: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """Latitude and longitude, rad, of the same points; no rows where they are not known."""
    yaw_std_rad: float = MAP_HEADING_STD_RAD
    stop_std_m: float = STOP_STD_M
    rides: int = 0
    """That it was learned of; 0: it comes from a map."""

    @property
    def name(self) -> str:
        return f"{self.line}/{self.direction}"

    @property
    def length_m(self) -> float:
        return (len(self.yaw_rad) - 1) * STEP_M

    def yaw_at(self, chainage_m: ArrayLike) -> Array:
        """Heading at chainages; beyond the ends the track goes straight on."""
        at = np.asarray(chainage_m, dtype=float) / STEP_M
        yaw: Array = np.interp(at, np.arange(len(self.yaw_rad)), self.yaw_rad)
        return yaw

    def seen_by(self, pivot_m: float, bogies_m: float) -> Array:
        """Headings of a body whose origin is at each point, each `STEP_M`.

        The body lies along the chord between its bogies, `pivot_m` behind its origin: its heading
        is the mean of the track's between them, within 0.1° in curves of 20 m.
        """
        at = np.arange(len(self.yaw_rad)) * STEP_M - pivot_m
        if bogies_m == 0.0:
            return self.yaw_at(at)
        steps = np.linspace(-bogies_m / 2, bogies_m / 2, 2 * math.ceil(bogies_m) + 1)
        weights = np.ones(len(steps))
        weights[0] = weights[-1] = 0.5
        rows = np.stack([self.yaw_at(at + step) for step in steps])
        seen: Array = weights @ rows / weights.sum()
        return seen

    def pieces(self) -> list[Piece]:
        """Straights and curves in order, from the line's begin to its end.

        A curve keeps beyond `LIMIT_PER_M` with one sign over `WINDOW_M` of way, as the processor
        `segments` sees it; an S-curve is two.
        """
        curves = curves_of(self.yaw_rad)
        pieces, at = [], 0.0
        for curve in curves:
            if curve.begin_m > at:
                pieces.append(self._straight(at, curve.begin_m))
            pieces.append(curve)
            at = curve.end_m
        if at < self.length_m:
            pieces.append(self._straight(at, self.length_m))
        return pieces

    def _straight(self, begin_m: float, end_m: float) -> Piece:
        begin, end = self.yaw_at([begin_m, end_m]).tolist()
        return Piece(begin_m, end_m, end - begin, curve=False)


WINDOW_M = 2
"""Of way, over which curvature is taken; as of the processor."""


def curves_of(yaw_rad: Array, window: int = WINDOW_M) -> list[Piece]:
    """Curves of headings each metre: see `Signature.pieces`."""
    half = window // 2
    curvature = np.zeros(len(yaw_rad))
    curvature[half:-half] = (yaw_rad[window:] - yaw_rad[:-window]) / (window * STEP_M)
    return _curves(yaw_rad, curvature, STEP_M)


def curves_of_line(line: Line) -> list[Piece]:
    """Curves of an exact line, by its curvature itself."""
    at = np.arange(0.0, line.length_m, 0.1)
    return _curves(line.yaw_rad(at), line.curvature_per_m(at), 0.1)


def _curves(yaw_rad: Array, curvature: Array, step_m: float) -> list[Piece]:
    """Where curvature keeps beyond the limit with one sign."""
    found: list[Piece] = []
    for sign in (1.0, -1.0):
        excess = sign * curvature - LIMIT_PER_M
        inside = excess >= 0.0
        edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
        spans: list[list[float]] = []
        for edge in edges.tolist():
            at = (edge + excess[edge] / (excess[edge] - excess[edge + 1])) * step_m
            if inside[edge + 1]:
                if spans and at - spans[-1][-1] < GAP_M:
                    between = curvature[int(spans[-1][-1] / step_m) : int(at / step_m) + 2]
                    if bool(np.all(sign * between > -LIMIT_PER_M)):
                        spans[-1].pop()
                        continue
                spans.append([at])
            elif spans:
                spans[-1].append(at)
        for span in spans:
            if len(span) == 2:
                ends = np.array(span) / step_m
                begin, end = np.interp(ends, np.arange(len(yaw_rad)), yaw_rad)
                found.append(Piece(span[0], span[1], float(end - begin), curve=True))
    return sorted(found)


# Where they come from -----------------------------------------------------------------------------
def of_line(line: Line, name: str = "line", direction: str = "0") -> Signature:
    """The signature of an exact line, its headings without error."""
    at = np.arange(math.floor(line.length_m / STEP_M) + 1) * STEP_M
    geodetic = line.level.to_geodetic(line.position_l(at))[:, :2]
    return Signature(
        name,
        direction,
        line.yaw_rad(at),
        np.array(line.stops_m, dtype=float),
        tuple(f"stop {k + 1}" for k in range(len(line.stops_m))),
        plan=geodetic,
    )


def of_network(network: Network, chosen: Sequence[str] = ()) -> list[Signature]:
    """Signatures of a network's lines; `chosen` as "7" or "7/0", empty for all of them."""
    return [
        _of_route(network, line)
        for line in network.lines
        if not chosen or line.line in chosen or f"{line.line}/{line.direction}" in chosen
    ]


def _of_route(network: Network, line: RouteLine) -> Signature:
    chainage: list[Array] = []
    yaw: list[Array] = []
    plan: list[Array] = []
    switches: list[float] = []
    offset = -line.begin_m
    for run in line.runs:
        track, backwards = run >> 1, run & 1
        rows = network.samples_of(track)
        heading = network.yaw_rad[rows]
        places = np.column_stack([network.east[rows], network.north[rows]])
        length = float(network.length_m[track])
        along = np.linspace(0.0, length, len(heading))
        if backwards:
            heading, places = heading[::-1] + math.pi, places[::-1]
        if yaw:
            turns = np.rint((heading[0] - yaw[-1][-1]) / math.tau)
            heading = heading - turns * math.tau
        chainage.append(along + offset)
        yaw.append(heading)
        plan.append(places)
        offset += length
        end = int((network.from_node if backwards else network.to_node)[track])
        if network.node_switch[end]:
            switches.append(offset)
    at = np.arange(math.floor(line.length_m / STEP_M) + 1) * STEP_M
    known = np.concatenate(chainage)
    places = np.concatenate(plan)
    points = np.column_stack([np.interp(at, known, places[:, k]) for k in range(2)])
    return Signature(
        line.line,
        line.direction,
        np.interp(at, known, np.concatenate(yaw)),
        np.array([stop.chainage_m for stop in line.stops], dtype=float),
        tuple(stop.name for stop in line.stops),
        np.array([each for each in switches if 0.0 <= each <= line.length_m], dtype=float),
        network.geodetic_of(points),
    )
