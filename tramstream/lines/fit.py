"""A smooth line along a polyline of a map.

Maps give a track as a chain of straight edges; a vehicle on it would turn on the spot. The line
laid here has a curvature that runs linearly from knot to knot, no tighter than `RADIUS_MIN_M`. It
is found window by window: least squares for the curvatures of `WINDOW_M` ahead, of which half are
kept, so that each window starts where the last one really ended and no error adds up. What is
minimised is the distance to the polyline against the change of curvature (`_OFF_M`,
`_SHARPNESS_PER_M2`): features shorter than about 30 m are taken for noise of the map.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.lines.line import Segment
from tramstream.lines.profile import Profile

Array = NDArray[np.float64]

KNOT_M = 5.0
WINDOW_M = 400.0
RADIUS_MIN_M = 18.0
_KEPT = 40
"""Knots of a window that stay."""
_FINE_M = 0.5
"""Step of the quadrature within the fit, and of points along the polyline."""
_EACH = round(KNOT_M / _FINE_M)
_SEEN = 5
"""Every so many fine points is held to the polyline."""
_NEAR = 60
"""Points of the polyline to either side of the expected one among which the nearest is sought."""
_OFF_M = 0.6
"""Deviation that costs as much as a change of curvature of `_SHARPNESS_PER_M2`."""
_SHARPNESS_PER_M2 = 0.0015
_TIGHT_PER_M = 1e-4
"""Excess of curvature over the tightest that costs as much as `_OFF_M`."""
_STEPS = 12
_SETTLED_M = 1e-3
_HEADING_M = 8.0
"""Length over which the polyline's first direction and first guesses of curvature are taken."""
_LEAST_ADVANCE = 0.5
"""Chainage that a window must gain over its length; less, and it has lost the polyline."""
_SPARE_M = WINDOW_M + 20.0
"""The polyline goes on straight beyond its end, so that the last window is like the others."""


class Course(NamedTuple):
    """A fitted line, not yet laid anywhere: what `Line` wants."""

    segments: list[Segment]
    yaw_start_rad: float
    start: tuple[float, float]
    """East and north, m."""
    arc_length_m: Array
    """At points of the fit, and"""
    chainage_m: Array
    """the chainage of the polyline beside them."""


class _Polyline:
    """Points every `_FINE_M` along a polyline, and the direction at each."""

    def __init__(self, points: Array) -> None:
        self.length_m = float(np.sum(np.hypot(*np.diff(points, axis=0).T)))
        last = (points[-1] - points[-2]) / np.hypot(*(points[-1] - points[-2]))
        points = np.vstack([points, points[-1] + last * _SPARE_M])
        edges = np.diff(points, axis=0)
        lengths = np.hypot(*edges.T)
        chainage = np.concatenate([[0.0], np.cumsum(lengths)])
        self.chainage_m = np.arange(0.0, chainage[-1], _FINE_M)
        edge = np.clip(
            np.searchsorted(chainage, self.chainage_m, side="right") - 1, 0, len(edges) - 1
        )
        direction = edges / lengths[:, None]
        past = (self.chainage_m - chainage[edge])[:, None]
        self.points = points[edge] + direction[edge] * past
        self.normal = np.stack([-direction[edge, 1], direction[edge, 0]], axis=1)
        self._along = direction[edge]
        yaw = np.unwrap(np.arctan2(direction[edge, 1], direction[edge, 0]))
        width = round(_HEADING_M / _FINE_M)
        kernel = np.hanning(2 * width + 3)
        smooth = np.convolve(np.pad(yaw, width + 1, mode="edge"), kernel / kernel.sum(), "valid")
        self.yaw = smooth
        self.curvature = np.gradient(smooth, _FINE_M)

    def beside(self, positions: Array, expected_m: Array) -> tuple[Array, Array, Array]:
        """Signed distance, normal and chainage at the nearest point near the expected chainage."""
        centre = np.rint(expected_m / _FINE_M).astype(int)
        index = centre[:, None] + np.arange(-_NEAR, _NEAR + 1)
        index = np.clip(index, 0, len(self.points) - 1)
        offset = positions[:, None, :] - self.points[index]
        best = np.argmin(np.sum(offset**2, axis=2), axis=1)
        rows = np.arange(len(positions))
        nearest, offset = index[rows, best], offset[rows, best]
        normal = self.normal[nearest]
        along = np.sum(offset * self._along[nearest], axis=1)
        return np.sum(offset * normal, axis=1), normal, self.chainage_m[nearest] + along


class _Start(NamedTuple):
    """Where a window begins."""

    position: Array
    yaw: float
    curvature: float
    arc_length_m: float
    chainage_m: float


def fit(points: Array, grade: Profile) -> Course:
    """Lay a smooth line along a polyline.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        East and north of the polyline's nodes, m; neighbours differ.
    grade : Profile
        Slope angle against the line's arc length: on a slope the plan is shorter.

    Raises
    ------
    ConfigError
        If no line of `RADIUS_MIN_M` and more can follow the polyline.
    """
    polyline = _Polyline(points)
    start = _Start(points[0], float(polyline.yaw[0]), float(polyline.curvature[0]), 0.0, 0.0)
    curvatures: list[Array] = []
    begin: _Start | None = None
    arc_lengths: list[Array] = [np.zeros(1)]
    chainages: list[Array] = [np.zeros(1)]
    while start.chainage_m < polyline.length_m:
        window = _Window(polyline, start, grade, free=begin is None)
        knots = window.solve()
        begin = begin or window.start
        curvatures.append(knots[:_KEPT])
        fine = slice(1, _KEPT * _EACH + 1)
        arc_lengths.append(window.arc_length_m[fine])
        chainages.append(window.chainages_m()[1:])
        advanced_m = float(chainages[-1][-1]) - start.chainage_m
        if advanced_m < _LEAST_ADVANCE * _KEPT * KNOT_M:
            raise ConfigError(
                f"no track of radius {RADIUS_MIN_M:g} m and more follows the map's line beyond "
                f"chainage {start.chainage_m:.0f} m; look for a corner or a loop in it there"
            )
        start = window.end_of_kept(float(chainages[-1][-1]))
    assert begin is not None
    arc_length, chainage = np.concatenate(arc_lengths), np.concatenate(chainages)
    chainage = np.maximum.accumulate(chainage)
    length_m = float(np.interp(polyline.length_m, chainage, arc_length))
    at_knots = np.append(np.concatenate(curvatures), start.curvature)
    return Course(
        _segments(at_knots, length_m),
        begin.yaw,
        (float(begin.position[0]), float(begin.position[1])),
        arc_length,
        chainage,
    )


def _segments(curvatures: Array, length_m: float) -> list[Segment]:
    """Segments between knots, the last one cut at the line's end."""
    segments = []
    for index, (first, last) in enumerate(pairwise(curvatures.tolist())):
        left_m = length_m - index * KNOT_M
        if left_m <= 1e-6:
            break
        part_m = min(KNOT_M, left_m)
        end = first + (last - first) * part_m / KNOT_M
        segments.append(Segment(part_m, first, end))
    return segments


_COUNT = round(WINDOW_M / KNOT_M)
_FINE: Array = np.arange(_COUNT * _EACH + 1, dtype=np.float64) * _FINE_M
_SEEN_POINTS = slice(_SEEN, None, _SEEN)


def deviation_m(points: Array, positions: Array) -> float:
    """Largest distance of positions from a polyline that they follow.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Nodes of the polyline, m.
    positions : ndarray, shape (m, 2)
        In order along it, the first at its start, m.
    """
    polyline = _Polyline(points)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    largest, ahead = 0.0, 0.0
    for first in range(0, len(positions), 100):
        part = slice(first, first + 100)
        off, _, chainage = polyline.beside(positions[part], way[part] + ahead)
        largest = max(largest, float(np.max(np.abs(off))))
        ahead = float(chainage[-1] - way[part][-1])
    return largest


def _yaw_per_curvature() -> Array:
    """Turn until each fine point for unit curvature at each knot: integrals of hat functions."""
    hats = np.maximum(1 - np.abs(_FINE[:, None] / KNOT_M - np.arange(_COUNT + 1)), 0)
    steps = (hats[:-1] + hats[1:]) / 2 * _FINE_M  # hats are straight between fine points
    return np.vstack([np.zeros(_COUNT + 1), np.cumsum(steps, axis=0)])


_TURN = _yaw_per_curvature()


class _Window:
    """Least squares for the curvatures at the knots ahead of a start."""

    def __init__(self, polyline: _Polyline, start: _Start, grade: Profile, free: bool) -> None:
        self.start = start
        self._polyline = polyline
        self._free = free
        self.arc_length_m: Array = start.arc_length_m + _FINE
        self._level = np.cos(grade(self.arc_length_m))
        knots_m = start.chainage_m + np.arange(_COUNT + 1) * KNOT_M
        guess = np.interp(knots_m, polyline.chainage_m, polyline.curvature)
        self._knots: Array = np.clip(guess, -1 / RADIUS_MIN_M, 1 / RADIUS_MIN_M)
        self._knots[0] = start.curvature
        self._yaw_start = start.yaw
        self._expected_m: Array = start.chainage_m + _FINE[_SEEN_POINTS]  # of what is seen

    def solve(self) -> Array:
        """Curvature at each knot, 1/m."""
        for _ in range(_STEPS):
            step = self._step()
            if step < _SETTLED_M:
                break
        tightest = 1 / RADIUS_MIN_M
        self._knots = np.clip(self._knots, -tightest, tightest)
        self.start = self.start._replace(yaw=self._yaw_start, curvature=float(self._knots[0]))
        knots: Array = self._knots
        return knots

    def chainages_m(self) -> Array:
        """Chainage of the polyline beside the fine points that are kept, and one before."""
        kept = slice(0, _KEPT * _EACH + 1)
        expected: Array = np.interp(_FINE[kept], _FINE[_SEEN_POINTS], self._expected_m)
        return self._polyline.beside(self._positions()[0][kept], expected)[2]

    def end_of_kept(self, chainage_m: float) -> _Start:
        index = _KEPT * _EACH
        positions, yaw = self._positions()
        return _Start(
            positions[index],
            float(yaw[index]),
            float(self._knots[_KEPT]),
            float(self.arc_length_m[index]),
            chainage_m,
        )

    def _positions(self) -> tuple[Array, Array]:
        yaw = self._yaw_start + _TURN @ self._knots
        direction = self._level[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        return self.start.position + _cumulated(direction), yaw

    def _step(self) -> float:
        """One Gauss-Newton step; tells how far it moves the far end of what is kept."""
        positions, yaw = self._positions()
        seen = _SEEN_POINTS
        off, normal, self._expected_m = self._polyline.beside(positions[seen], self._expected_m)
        across = self._level[:, None] * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
        columns = np.hstack([np.ones((len(_TURN), 1)), _TURN])  # of first yaw, then of each knot
        moved = [_cumulated(across[:, axis, None] * columns)[seen] for axis in (0, 1)]
        jacobian = normal[:, :1] * moved[0] + normal[:, 1:] * moved[1]
        change = np.zeros((_COUNT, _COUNT + 2))
        rows = np.arange(_COUNT)
        change[rows, rows + 1], change[rows, rows + 2] = -1 / KNOT_M, 1 / KNOT_M
        excess = np.abs(self._knots) - 1 / RADIUS_MIN_M
        tight = np.diag((excess > 0) * np.sign(self._knots))
        tight = np.hstack([np.zeros((_COUNT + 1, 1)), tight])
        matrix = np.vstack([jacobian / _OFF_M, change / _SHARPNESS_PER_M2, tight / _TIGHT_PER_M])
        wanted = -np.concatenate(
            [
                off / _OFF_M,
                np.diff(self._knots) / KNOT_M / _SHARPNESS_PER_M2,
                np.maximum(excess, 0) / _TIGHT_PER_M,
            ]
        )
        free = slice(0 if self._free else 2, None)
        correction = np.zeros(_COUNT + 2)
        matrix = matrix[:, free]
        correction[free] = np.linalg.solve(matrix.T @ matrix, matrix.T @ wanted)
        self._yaw_start += float(correction[0])
        self._knots = self._knots + correction[1:]
        return float(np.max(np.abs(jacobian[: _KEPT * _EACH // _SEEN] @ correction)))


def _cumulated(rate: Array) -> Array:
    """Integral along fine points by the trapezoid, zero at the first."""
    steps = (rate[:-1] + rate[1:]) / 2 * _FINE_M
    return np.vstack([np.zeros((1, rate.shape[1])), np.cumsum(steps, axis=0)])
