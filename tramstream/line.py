"""Geometry of a line: arc length to position, yaw and curvature, and where the stops are.

A line is a chain of segments whose curvature runs linearly: straights, arcs and the clothoids
between them. Curvature and yaw are closed forms; position is the quadrature of cos and sin of yaw
from the nearest of dense nodes, good to nanometres. Motion along the line is `tramstream.ride`.

The plan lies in the tangent plane of the line's origin. The track follows the Earth's curvature, so
that it is level everywhere: grade and cant are to come, as further properties of arc length. Over
the few kilometres of a line the plan is 1e-6 of its length too short, and north turns against the
origin's by a milliradian; both are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream import geodesy
from tramstream.geodesy import LocalLevel

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
    start_l : array_like, shape (2,)
        East and north of arc length 0, m.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        stops_m: Sequence[float],
        level: LocalLevel,
        yaw_start_rad: float = 0.0,
        start_l: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        lengths = np.array([segment.length_m for segment in segments])
        first = np.array([segment.curvature_start_per_m for segment in segments])
        last = np.array([segment.curvature_end_per_m for segment in segments])
        self.segments = tuple(segments)
        self.level = level
        self.starts_m = np.concatenate([[0.0], np.cumsum(lengths)])
        """Arc length at which each segment starts, and the line's end."""
        self.stops_m = np.asarray(stops_m, dtype=float)
        self._curvature = first
        self._slope = (last - first) / lengths
        turned = np.concatenate([[0.0], np.cumsum((first + last) / 2 * lengths)])
        self._yaw = yaw_start_rad + turned
        self._nodes, self._node_east, self._node_north = self._integrate(start_l)

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
        index, past = self._locate(arc_length_m)
        return self._yaw_in(index, past)

    def position_l(self, arc_length_m: ArrayLike) -> Array:
        """Position of the track in `l`, m; shape (n, 3) for n arc lengths, (3,) for one."""
        s = np.clip(np.asarray(arc_length_m, dtype=float), 0.0, self.length_m)
        node = np.clip(np.searchsorted(self._nodes, s, side="right") - 1, 0, len(self._nodes) - 2)
        east, north = self._run(self._nodes[node], s - self._nodes[node])
        east, north = self._node_east[node] + east, self._node_north[node] + north
        up = -(east**2 + north**2) / (2 * geodesy.SEMI_MAJOR_M)  # stays level: follows the Earth
        return np.stack([east, north, up], axis=-1)

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

    def _run(self, start: Array, length: Array) -> tuple[Array, Array]:
        """East and north gained over `length` from `start`, none of which spans two segments."""
        index = np.searchsorted(self.starts_m, start, side="right") - 1
        index = np.minimum(index, len(self.segments) - 1)[..., None]
        points = (start[..., None] - self.starts_m[index]) + length[..., None] * _GAUSS_X
        yaw = self._yaw_in(index, points)
        return length * (np.cos(yaw) @ _GAUSS_W), length * (np.sin(yaw) @ _GAUSS_W)

    def _integrate(self, start_l: tuple[float, float]) -> tuple[Array, Array, Array]:
        pieces = [
            np.linspace(a, b, math.ceil((b - a) / NODE_SPACING_M), endpoint=False)
            for a, b in zip(self.starts_m[:-1], self.starts_m[1:], strict=True)
        ]
        nodes = np.concatenate([*pieces, self.starts_m[-1:]])
        east, north = self._run(nodes[:-1], np.diff(nodes))
        return (
            nodes,
            np.concatenate([[0.0], np.cumsum(east)]) + start_l[0],
            np.concatenate([[0.0], np.cumsum(north)]) + start_l[1],
        )


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
| 420
| 120 R50/85 210 L600/8 90
| 310 L300/15 150
| 60 L25/88 240 L150/30 40
| 400
| 140 R400/18 260
| 90 R20/92 35 L30/60 180
| 400 L800/10 110
| 70 L60/45 190 L80/40 60
| 390
| 110 R250/25 120 L1000/9 120
| 50 L40/75 150 R22/70 60
| 540
| 200 L350/40 130
| 80 R35/90 220 L90/35 40
| 410 R500/12 60
| 150 L20/85 30 L45/50 90
| 450
| 90 L180/40 200 R220/35 50
| 330
| 60 R28/80 140 L70/30 130
| 380 L700/11 90
| 120 R130/45 180
| 60 R24/90 90 L55/65 70
|
"""
"""A line of the reference's kind (Prague line 7, theory.md section 3), invented: 27 stops, about
12 km, curves of 20 to 1000 m. Departure, curve and second stop fall into the first minute."""


def built_in_line() -> Line:
    """Lay the invented line of the demo in Prague, its origin in the middle."""
    segments, stops_m = parse_plan(BUILT_IN_PLAN)
    level = LocalLevel.at_deg(50.0755, 14.4700, 300.0)
    return Line(segments, stops_m, level, math.radians(170.0), start_l=(2000.0, 1500.0))
