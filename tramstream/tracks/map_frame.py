"""From a filter's frame `l` into the plan of a network and to geodetic places, and how they turn.

A filter's tangent plane touches the Earth where its ride began, the network's where its origin is,
and a plan knows no heights. Near a place both go over into each other by a linear map; it is laid
anew when the vehicle has left that place. So no height and no distance from either origin adds an
error: what is left after `MOVED_M` is a millimetre.

Equations: docs/theory.md, section 2.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.tracks.network import Network

Array = NDArray[np.float64]

MOVED_M = 100.0
"""The linear map is laid anew after so much."""
_STEP_M = 1.0
_STEPS_M = np.vstack([np.zeros(3), np.eye(3) * _STEP_M])


@dataclass
class FrameMemory:
    """Where a map was laid, and how."""

    at: Array = field(default_factory=lambda: np.full(3, math.inf))
    """In `l`, m."""
    numbers: Array = field(default_factory=lambda: np.zeros(12))
    """Of plan = A (l − l₀) + plan₀, where the plumb line through l₀ is no normal of the plan: A
    (2, 3) row by row, l₀ (3), plan₀ (2), the angle that A turns by, rad."""
    geodetic: Array = field(default_factory=lambda: np.zeros((3, 2)))
    """Latitude and longitude of l₀, and what they change by along east and north, rad and rad/m."""


class MapFrame:
    """Between `level` and a network's plan.

    Attributes
    ----------
    numbers : ndarray, shape (12,)
        As in its memory.
    """

    def __init__(
        self, network: Network, level: LocalLevel, memory: FrameMemory | None = None
    ) -> None:
        self._network = network
        self.level = level
        self.memory = FrameMemory() if memory is None else memory
        self.numbers = self.memory.numbers

    def follow(self, east: float, north: float, up: float) -> None:
        """Lay the map anew if a place in `l` is far from where it was laid."""
        at = self.memory.at
        if max(abs(east - at[0]), abs(north - at[1]), abs(up - at[2])) < MOVED_M:
            return
        at[:] = east, north, up
        geodetic = self.level.to_geodetic(at + _STEPS_M)
        plan = self._network.plan_of(geodetic)
        A = ((plan[1:] - plan[0]) / _STEP_M).T
        turn = math.atan2(A[1, 0] - A[0, 1], A[0, 0] + A[1, 1])
        self.numbers[:] = (*A.ravel(), east, north, up, *plan[0], turn)
        inverse = np.linalg.inv(A[:, :2])
        to_geodetic = ((geodetic[1:3, :2] - geodetic[0, :2]) / _STEP_M).T @ inverse
        self.memory.geodetic[0], self.memory.geodetic[1:] = geodetic[0, :2], to_geodetic

    def geodetic_deg(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude of a place in the plan, near the vehicle; degrees."""
        de, dn = east - self.numbers[9], north - self.numbers[10]
        (latitude, longitude), (a, b), (c, d) = self.memory.geodetic.tolist()
        return (
            math.degrees(latitude + a * de + b * dn),
            math.degrees(longitude + c * de + d * dn),
        )
