"""Where the other direction of a line lies beside it, for who turns back and goes over to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tramstream.tracks.signature import STEP_M, Signature

Array = NDArray[np.float64]

BESIDE_M = 10.0
"""Between points of two directions that are compared; the headings tell the rest."""


def beside(line: Signature, other: Signature, at_m: Array) -> Array:
    """Chainages on another line of the points that are nearest to those of a line."""
    every = round(BESIDE_M / STEP_M)
    points = other.plan[::every]
    north = np.cos(points[0, 0])
    grid = np.arange(0, len(line.plan), every)
    here = line.plan[grid]
    away = (here[:, None, 0] - points[None, :, 0]) ** 2
    away += (north * (here[:, None, 1] - points[None, :, 1])) ** 2
    nearest = away.argmin(axis=1) * every * STEP_M
    found: Array = np.interp(at_m, grid * STEP_M, nearest)
    return found


def other_of(lines: Sequence[Signature], number: int) -> int:
    """Index of the other direction of a line whose plan is known; -1 if there is none."""
    line = lines[number]
    for k, other in enumerate(lines):
        apart = other.direction != line.direction
        if other.line == line.line and apart and len(other.plan) and len(line.plan):
            return k
    return -1
