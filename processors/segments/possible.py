"""A place that is possible: what particles that are near each other say together."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processors.segments.particles import Pt

Array = NDArray[np.float64]


class Place(NamedTuple):
    """One place that is possible."""

    line: int
    """Index of the signatures."""
    at_m: float
    std_m: float
    probability: float
    scale: float
    scale_std: float
    way: float
    """1: along the line's direction of use, as x of the vehicle points; -1: against."""


def place_of(line: int, rows: Array, weights: Array) -> Place:
    """Give the place of particles of one line."""
    total = float(weights.sum())
    share = weights / total
    at = float(share @ rows[:, Pt.AT_M])
    scale = float(share @ rows[:, Pt.SCALE])
    way = float(share @ rows[:, Pt.WAY])
    return Place(
        line,
        at,
        math.sqrt(float(share @ (rows[:, Pt.AT_M] - at) ** 2)),
        total,
        scale,
        math.sqrt(float(share @ (rows[:, Pt.SCALE] - scale) ** 2)),
        1.0 if way >= 0.0 else -1.0,
    )
