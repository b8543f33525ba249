"""Where a place is beside the rails: geometry of a `Network`, compiled.

A run's chainage counts from where the run begins. Left is positive across, as everywhere.

Equations: docs/theory.md, section 10.3.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tramstream.estimation.kalman import Array, compiled
from tramstream.tracks.network import Network

SEARCH_M = 8.0
"""Between the samples among which tracks are looked for."""
_NEWTON_STEPS = 6
_SETTLED_M = 1e-4
_LONGEST_STEP_M = 20.0
_SHARPEST = 0.2
"""Of 1 − curvature times distance: what is farther inside a curve than that has no one place."""


class Rails(NamedTuple):
    """What kernels read of a network."""

    starts: NDArray[np.int32]
    length_m: Array
    spacing_m: Array
    rules: NDArray[np.int8]
    following_starts: NDArray[np.int32]
    following: NDArray[np.int32]
    east: Array
    north: Array
    yaw: Array
    curvature: Array
    across_std_m: NDArray[np.float32]
    yaw_std: NDArray[np.float32]
    grade: NDArray[np.float32]
    grade_std: NDArray[np.float32]


def rails_of(network: Network) -> Rails:
    """Take out of a network what kernels read; all read-only, so that they are compiled once."""
    return Rails(
        *(
            _read_only(each)
            for each in (
                network.starts,
                network.length_m,
                network.spacing_m,
                network.rules,
                network.following_starts,
                network.following,
                network.east,
                network.north,
                network.yaw_rad,
                network.curvature_per_m,
                network.across_std_m,
                network.yaw_std_rad,
                network.grade_rad,
                network.grade_std_rad,
            )
        )
    )


def views_of(rails: Rails) -> Rails:
    """Give the same for Python code: one number takes a third of the time that numpy takes."""
    views: list[Any] = [each.data for each in rails]
    return Rails(*views)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def nearest_sample(rails: Rails, run: int, s: float) -> int:
    """Give the sample nearest to chainage `s` of a run."""
    track = run >> 1
    at = s if run & 1 == 0 else rails.length_m[track] - s
    first, end = rails.starts[track], rails.starts[track + 1]
    index = first + int(max(at, 0.0) / rails.spacing_m[track] + 0.5)
    return int(min(index, end - 1))


sample_at = compiled(nearest_sample)
"""The same for kernels: Python hands fourteen arrays over in ten times what is computed here."""


@compiled
def place(rails: Rails, run: int, s: float) -> tuple[float, float, float, float]:
    """East, north, yaw along the run and its curvature at chainage `s`; straight beyond the ends.

    Between samples curvature runs linearly; position is good to 0.2 mm in the tightest curve.
    """
    track = run >> 1
    length = rails.length_m[track]
    at = s if run & 1 == 0 else length - s
    first, end = rails.starts[track], rails.starts[track + 1]
    spacing = rails.spacing_m[track]
    j = min(first + int(max(at, 0.0) / spacing + 0.5), end - 1)
    d = at - (j - first) * spacing
    k, change = rails.curvature[j], 0.0
    if at < 0.0 or at > length:
        k = 0.0
    else:
        other = min(j + 1, end - 1) if d >= 0.0 else max(j - 1, first)
        if other != j:
            change = (rails.curvature[other] - k) / ((other - j) * spacing)
    yaw = rails.yaw[j]
    middle = yaw + (k / 2.0 + change * d / 6.0) * d
    east, north = rails.east[j] + d * math.cos(middle), rails.north[j] + d * math.sin(middle)
    yaw += (k + change * d / 2.0) * d
    k += change * d
    if run & 1 == 0:
        return east, north, yaw, k
    return east, north, yaw + math.pi, -k


@compiled
def beside(
    rails: Rails, run: int, s: float, east: float, north: float
) -> tuple[float, float, float, float]:
    """Find where a place is beside a run, near chainage `s`.

    Returns
    -------
    chainage, across, yaw, curvature : float
        Of the foot of the perpendicular, and how far left of it the place is, m. The chainage may
        lie beyond either end, where the run goes on straight.
    """
    across = yaw = k = 0.0
    for _ in range(_NEWTON_STEPS):
        e, n, yaw, k = place(rails, run, s)
        cos, sin = math.cos(yaw), math.sin(yaw)
        along = cos * (east - e) + sin * (north - n)
        across = cos * (north - n) - sin * (east - e)
        step = along / max(1.0 - k * across, _SHARPEST)
        s += min(max(step, -_LONGEST_STEP_M), _LONGEST_STEP_M)
        if abs(step) < _SETTLED_M:
            break
    return s, across, yaw, k


class Near(NamedTuple):
    """A track near a place: the foot of the perpendicular on it as drawn."""

    track: int
    chainage_m: float
    across_m: float
    """How far left of the track the place is."""
    yaw_rad: float


class Search:
    """Finds the tracks near a place."""

    def __init__(self, network: Network) -> None:
        self._rails = rails_of(network)
        starts = network.starts
        count = np.diff(starts)
        track = np.repeat(np.arange(len(count)), count)
        sample = np.arange(starts[-1]) - starts[track]
        every = np.maximum((SEARCH_M / network.spacing_m).astype(int), 1)
        chosen = np.flatnonzero((sample % every[track] == 0) | (sample == count[track] - 1))
        self._track = track[chosen]
        self._chainage_m = sample[chosen] * network.spacing_m[self._track]
        points = np.stack([network.east[chosen], network.north[chosen]], axis=1)
        self._tree = cKDTree(points)
        self._points = points

    def near(self, east: float, north: float, radius_m: float) -> list[Near]:
        """All tracks within a radius, nearest first; each once, at its nearest place."""
        rows = np.array(self._tree.query_ball_point((east, north), radius_m + SEARCH_M), dtype=int)
        if not len(rows):
            return []
        away = np.hypot(*(self._points[rows] - (east, north)).T)
        order = rows[np.argsort(away, kind="stable")]
        _, first = np.unique(self._track[order], return_index=True)
        found: list[tuple[float, Near]] = []
        for row in order[np.sort(first)].tolist():
            track = int(self._track[row])
            s, across, yaw, _ = beside(
                self._rails, 2 * track, float(self._chainage_m[row]), east, north
            )
            length = float(self._rails.length_m[track])
            over = max(-s, s - length, 0.0)
            distance = math.hypot(over, across)
            if distance <= radius_m:
                found.append((distance, Near(track, min(max(s, 0.0), length), across, yaw)))
        return [each for _, each in sorted(found)]

    def away_m(self, east: float, north: float) -> float:
        """How far a place is from the nearest sample of a track; good to half of `SEARCH_M`."""
        return float(self._tree.query((east, north))[0])
