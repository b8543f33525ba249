"""Geometry of a line: arc length to position, yaw, curvature, grade and cant, and its stops.

Arc length runs along the rail, uphill and downhill: it is the way that a wheel rolls. A line is a
chain of segments whose curvature (turn of the direction per arc length) runs linearly: straights,
arcs and the clothoids between them; grade and cant are smooth profiles. Curvature and yaw are
closed forms; position is the quadrature of the direction from the nearest of dense nodes, good to
nanometres. Motion along the line is `tramstream.simulation.ride`.

The plan lies in the tangent plane of the line's origin. Heights follow the Earth's curvature, so
that track without a grade is level everywhere, and attitude is against the vertical where the
vehicle is. Over the few kilometres of a line the plan is 1e-6 of its length too short, and north
turns against the origin's by a milliradian; both are left out.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream import geodesy
from tramstream.geodesy import LocalLevel
from tramstream.lines.profile import Profile, Shape

Array = NDArray[np.float64]

NODE_SPACING_M = 1.0
"""With four Gauss points between nodes: 1e-12 m for curves of 20 m."""
TRANSITION_M = 20.0
"""Longest clothoid at the ends of an arc; tight curves have shorter ones."""

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(4)
_GAUSS_X, _GAUSS_W = (_GAUSS_X + 1) / 2, _GAUSS_W / 2


@dataclass(frozen=True, slots=True)
class Segment:
    """A piece of track whose curvature (left positive) runs linearly from one end to the other."""

    length_m: float
    curvature_start_per_m: float = 0.0
    curvature_end_per_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Relief:
    """Grade and cant along the rail; level where nothing is said."""

    grade: Profile = field(default_factory=Profile.level)
    """Slope angle against arc length, rad, positive uphill."""
    cant: Profile = field(default_factory=Profile.level)
    """Roll of whoever travels along the line, rad: positive right side down."""


class Line:
    """One track from its first stop to its last.

    Arc lengths outside the line are taken to its ends.

    Parameters
    ----------
    segments : sequence of Segment
        Neighbours share their curvature where they meet, if the line is to be smooth.
    stops_m : sequence of float
        Arc length of each stop, ascending.
    level : LocalLevel
        Frame `l`; its origin is `start_l` away from the line's start.
    yaw_start_rad : float
        Direction at arc length 0, counter-clockwise from east.
    start_l : array_like, shape (3,)
        East, north and height above the origin of arc length 0, m.
    relief : Relief, optional
        Level and without cant by default.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        stops_m: Sequence[float],
        level: LocalLevel,
        yaw_start_rad: float = 0.0,
        start_l: tuple[float, float, float] = (0.0, 0.0, 0.0),
        relief: Relief | None = None,
    ) -> None:
        lengths = np.array([segment.length_m for segment in segments])
        first = np.array([segment.curvature_start_per_m for segment in segments])
        last = np.array([segment.curvature_end_per_m for segment in segments])
        self.segments = tuple(segments)
        self.level = level
        self.starts_m = np.concatenate([[0.0], np.cumsum(lengths)])
        """Arc length at which each segment starts, and the line's end."""
        self.stops_m = np.asarray(stops_m, dtype=float)
        relief = relief or Relief()
        self.grade, self.cant = relief.grade, relief.cant
        self._curvature = first
        self._slope = (last - first) / lengths
        turned = np.concatenate([[0.0], np.cumsum((first + last) / 2 * lengths)])
        self._yaw = yaw_start_rad + turned
        self._nodes, self._node_l = self._integrate(start_l)

    @property
    def length_m(self) -> float:
        return float(self.starts_m[-1])

    def curvature_per_m(self, arc_length_m: ArrayLike) -> Array:
        """Curvature, left positive, 1/m."""
        index, past = self._locate(arc_length_m)
        curvature: Array = self._curvature[index] + self._slope[index] * past
        return curvature

    def yaw_rad(self, arc_length_m: ArrayLike) -> Array:
        """Direction of travel, counter-clockwise from east, continuous (not wrapped)."""
        return self._yaw_in(*self._locate(arc_length_m))

    def yaw_shape(self, arc_length_m: ArrayLike) -> Shape:
        """Yaw in rad, curvature in 1/m and its slope in 1/m²."""
        index, past = self._locate(arc_length_m)
        slope = self._slope[index]
        curvature = self._curvature[index] + slope * past
        return Shape(
            self._yaw[index] + (self._curvature[index] + curvature) / 2 * past, curvature, slope
        )

    def position_l(self, arc_length_m: ArrayLike) -> Array:
        """Position of the track in `l`, m; shape (n, 3) for n arc lengths, (3,) for one."""
        s = np.clip(np.asarray(arc_length_m, dtype=float), 0.0, self.length_m)
        node = np.clip(np.searchsorted(self._nodes, s, side="right") - 1, 0, len(self._nodes) - 2)
        position: Array = self._node_l[node] + self._run(self._nodes[node], s - self._nodes[node])
        sunk = np.sum(position[..., :2] ** 2, axis=-1) / (2 * geodesy.SEMI_MAJOR_M)
        position[..., 2] -= sunk  # stays level: follows the Earth
        return position

    def without_cant(self) -> Line:
        """Give the same track with level sleepers."""
        line = copy.copy(self)
        line.cant = Profile.level()
        return line

    def _locate(self, arc_length_m: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Segment of each arc length, and the way into it."""
        s = np.clip(np.asarray(arc_length_m, dtype=float), 0.0, self.length_m)
        index = np.searchsorted(self.starts_m, s, side="right") - 1
        index = np.minimum(index, len(self.segments) - 1)
        return index, s - self.starts_m[index]

    def _yaw_in(self, index: NDArray[np.intp], past: Array) -> Array:
        slope = self._slope[index]
        yaw: Array = self._yaw[index] + (self._curvature[index] + slope * past / 2) * past
        return yaw

    def _run(self, start: Array, length: Array) -> Array:
        """Way over `length` from `start` in `l`, (…, 3); none of them spans two segments."""
        index = np.searchsorted(self.starts_m, start, side="right") - 1
        index = np.minimum(index, len(self.segments) - 1)[..., None]
        points = start[..., None] + length[..., None] * _GAUSS_X
        yaw, grade = self._yaw_in(index, points - self.starts_m[index]), self.grade(points)
        level = np.cos(grade)
        direction = np.stack([level * np.cos(yaw), level * np.sin(yaw), np.sin(grade)], axis=-1)
        way: Array = length[..., None] * np.einsum("...gi,g->...i", direction, _GAUSS_W)
        return way

    def _integrate(self, start_l: tuple[float, float, float]) -> tuple[Array, Array]:
        pieces = [
            np.linspace(a, b, math.ceil((b - a) / NODE_SPACING_M), endpoint=False)
            for a, b in zip(self.starts_m[:-1], self.starts_m[1:], strict=True)
        ]
        nodes = np.concatenate([*pieces, self.starts_m[-1:]])
        way = self._run(nodes[:-1], np.diff(nodes))
        return nodes, np.concatenate([[start_l], start_l + np.cumsum(way, axis=0)])


def curve(radius_m: float, angle_rad: float) -> list[Segment]:
    """Make an arc that turns by `angle_rad` (left positive), with a clothoid at either end.

    A clothoid of length T takes half of T from the arc, so the three are T longer than the plain
    arc. T is half the radius or half the plain arc if that is less than `TRANSITION_M`.
    """
    arc_m = radius_m * abs(angle_rad)
    transition_m = min(TRANSITION_M, radius_m / 2, arc_m / 2)
    curvature = math.copysign(1 / radius_m, angle_rad)
    return [
        Segment(transition_m, 0.0, curvature),
        Segment(arc_m - transition_m, curvature, curvature),
        Segment(transition_m, curvature, 0.0),
    ]


def parse_plan(plan: str) -> tuple[list[Segment], list[float]]:
    """Read a plan: segments and the arc length of each stop.

    Words: `|` a stop; `120` a straight of 120 m; `L50/90` a curve to the left with a radius of
    50 m that turns by 90°; `R` to the right.

    Raises
    ------
    ValueError
        For a word that is none of these.
    """
    segments: list[Segment] = []
    stops_m: list[float] = []
    end_m = 0.0  # summed in the order of `Line.starts_m`, so that stops fall exactly on its cuts
    for word in plan.split():
        if word == "|":
            stops_m.append(end_m)
            continue
        if word[0] in "LR":
            radius, angle = (float(part) for part in word[1:].split("/"))
            pieces = curve(radius, math.radians(angle if word[0] == "L" else -angle))
        else:
            pieces = [Segment(float(word))]
        for piece in pieces:
            segments.append(piece)
            end_m += piece.length_m
    return segments, stops_m


BUILT_IN_PLAN = """
| 30 L120/22 35
| 25 R100/30 160 L200/20 60
| 30 L150/45 R150/45 120
| 100 R50/85 40 L90/65 R90/65 L600/8 20
| 70 R90/65 L90/65 60 L300/15 40
| 60 L25/88 40 R70/70 L70/70 40 L150/30 30
| 50 R140/55 L140/55 80
| 50 L180/45 R180/45 R400/18 40
| 90 R20/92 35 L30/60 40 L90/55 30
| 60 R110/80 L110/80 L800/10 30
| 70 L60/45 30 R60/80 L60/80 30 L80/40 60
| 40 L110/70 R110/70 60
| 60 R250/25 20 L60/75 R60/75 L1000/9 40
| 50 L40/75 40 L90/45 30 R22/70 60
| 560
| 50 R70/75 L70/75 L350/40 40
| 80 R35/90 40 R100/55 L100/55 L90/35 40
| 50 L120/75 R120/75 R500/12 40
| 70 L20/85 30 R55/85 40 L45/50 80
| 60 R120/80 L120/80 50
| 70 L180/40 40 R100/40 R220/35 40
| 50 L85/75 R85/75 60
| 50 R28/80 40 R110/45 40 L70/30 60
| 50 L130/60 R130/60 L700/11 40
| 100 R130/45 40 L75/50 60
| 50 R24/90 40 L90/45 40 L55/65 60
|
"""
"""A line of the reference's kind (Prague line 7; docs/theory.md, section 3.9), invented: 27 stops,
about 12 km, curves of 20 to 1000 m. Departure, curve and second stop fall into the first minute."""
BUILT_IN_GRADES_PCT = (
    *(0.0, 0.8, 1.5, -0.6, 2.4, 4.0, 7.0, 1.2, -2.8, -5.5, -1.0, 0.4, 3.3),
    *(-4.2, -1.8, 0.0, 5.2, 2.1, -3.6, -6.4, -0.9, 1.7, 4.8, -2.3, -4.4, 0.6),
)
"""Between a stop and the next, invented as well."""
_STOP_SHARE = 0.25
"""Of the mean grade on either side: stops lie on the gentler parts."""
_STOP_HALF_M, _GRADE_CHANGE_M = 20.0, 60.0
"""So far around a stop its grade holds; over so long it goes to the next (radius 500 m or more)."""
CANT_MAX_RAD = 0.06
"""90 mm over 1.5 m; streets have less than railways."""
_CANT_M = 1.2
"""Cant times radius: balances 3.4 m/s."""


def built_in_line() -> Line:
    """Lay the invented line of the demo in Prague, its origin in the middle."""
    segments, stops_m = parse_plan(BUILT_IN_PLAN)
    level = LocalLevel.at_deg(50.0755, 14.4700, 300.0)
    relief = Relief(_stepped_grade(stops_m, BUILT_IN_GRADES_PCT), usual_cant(segments))
    return Line(segments, stops_m, level, math.radians(170.0), (600.0, 430.0, 0.0), relief)


def usual_cant(segments: Sequence[Segment]) -> Profile:
    """Cant in proportion to curvature, down on the curve's inside, at most `CANT_MAX_RAD`."""
    edges = np.concatenate([[0.0], np.cumsum([segment.length_m for segment in segments])])
    bent = np.array([segment.curvature_start_per_m for segment in segments])
    bent = np.append(bent, segments[-1].curvature_end_per_m)
    return Profile.through(edges, -np.clip(_CANT_M * bent, -CANT_MAX_RAD, CANT_MAX_RAD))


def _stepped_grade(stops_m: Sequence[float], grades_pct: Sequence[float]) -> Profile:
    """Slope angle of a line with one grade between each two stops."""
    angles = np.arctan(np.array(grades_pct) / 100)
    beside = np.concatenate([[0.0], angles, [0.0]])
    at_stops = _STOP_SHARE * (beside[:-1] + beside[1:]) / 2
    knots: list[float] = []
    values: list[float] = []
    inset = _STOP_HALF_M + _GRADE_CHANGE_M
    for number, (start, end) in enumerate(pairwise(stops_m)):
        knots += [start + _STOP_HALF_M, end - _STOP_HALF_M]
        values += [at_stops[number], at_stops[number + 1]]
        if end - start > 2 * inset:
            knots[-1:-1] = [start + inset, end - inset]
            values[-1:-1] = [angles[number]] * 2
    return Profile(knots, values)
