"""A map that may lie beside the rails as a whole: what the filter's two states for it are worth.

Nodes of a map come from aerial images, and a whole quarter of the city may be drawn a metre beside
its rails. Most are not. Two kinds of maps are therefore held side by side: nearly true ones, and
those that may be off by all that the operator allows. The filter is of the second kind: it keeps
the shift as two states that walk along the way. What it would have with the first is what a
measurement of no shift would make of its state, and how likely either kind is follows from the
shift that it has found (Savage and Dickey: the ratio of posterior and prior at the smaller value).
What is published is the mean of the two, weighed so, with their covariance about it. So a true map
costs little, and a false one is in the deviations until the fixes have told.

Equations: docs/theory.md, section 6.11.

References
----------
Dickey 1971: J. M. Dickey, "The weighted likelihood ratio, linear hypotheses on normal location
parameters", The Annals of Mathematical Statistics 42 (1971) 204-223.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.localiser import COVARIANCE
from tramstream.processors.tram_model.records import Memory, Parameters
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of

TRUE_SHARE = 0.9
"""Of maps that are nearly true; chosen by hand on `reproduce worlds`."""
TRUE = 0.1
"""Deviation of their shift over that of the others; chosen by hand on `reproduce worlds`."""
WALK = 1e-4
"""Of the shift's variance that is new after a metre: it lasts for 10 km; chosen by hand."""
_SHIFT = columns_of(Ix.MAP_EAST, Ix.MAP_NORTH)


@compiled
def true_odds(P: Array, x: Array, largest: float, A: Array) -> float:
    """Odds that a map is nearly true; fills A (2×2), by which a shift is taken back.

    Parameters
    ----------
    largest : float
        Variance of the shift before anything was measured.
    """
    small = TRUE * TRUE * largest
    R = small * largest / (largest - small)
    a, b = P[Ix.MAP_EAST, Ix.MAP_EAST] + R, P[Ix.MAP_EAST, Ix.MAP_NORTH]
    d = P[Ix.MAP_NORTH, Ix.MAP_NORTH] + R
    determinant = a * d - b * b
    A[0, 0], A[1, 1] = d / determinant, a / determinant
    A[0, 1] = A[1, 0] = -b / determinant
    east, north = x[Ix.MAP_EAST], x[Ix.MAP_NORTH]
    distance = A[0, 0] * east * east + 2.0 * A[0, 1] * east * north + A[1, 1] * north * north
    ratio = largest / small * R / math.sqrt(determinant) * math.exp(-0.5 * distance)
    odds: float = TRUE_SHARE / (1.0 - TRUE_SHARE) * ratio
    return odds


@compiled
def weigh_map(f: Memory, c: Parameters, values: Array) -> None:
    """Turn the values of an estimate into those of a map that may be nearly true.

    Parameters
    ----------
    f : Memory
        Of the filter that the estimate is of, or comes from a moment later.
    values : ndarray
        Of the vehicle's origin, which `axes.origin` has filled.
    """
    if c.map_variance == 0.0:
        return
    x, P = f.x, f.P
    A, gain, moved = np.empty((2, 2)), np.empty((7, 2)), np.empty(7)
    odds = true_odds(P, x, c.map_variance, A)
    share = odds / (1.0 + odds)
    C = _beside_shift(f, c)
    east, north = x[Ix.MAP_EAST], x[Ix.MAP_NORTH]
    covariance = values[COVARIANCE:].reshape((7, 7))
    for i in range(7):
        a = C[i, 0] * A[0, 0] + C[i, 1] * A[0, 1]
        b = C[i, 0] * A[0, 1] + C[i, 1] * A[1, 1]
        gain[i, 0], gain[i, 1], moved[i] = a, b, a * east + b * north
        values[i] -= share * moved[i]
    for i in range(7):
        for j in range(7):
            taken = gain[i, 0] * C[j, 0] + gain[i, 1] * C[j, 1]
            covariance[i, j] -= share * (taken - (1.0 - share) * moved[i] * moved[j])


@compiled
def _beside_shift(f: Memory, c: Parameters) -> Array:
    """Covariance of the origin's motion with the shift, shape (7, 2); see `axes.origin`."""
    x, P = f.x, f.P
    C = np.empty((7, 2))
    cos, sin, v = math.cos(x[Ix.YAW]), math.sin(x[Ix.YAW]), x[Ix.SPEED]
    early = c.clock_share * x[Ix.GNSS_DELAY]
    ahead = x[Ix.PIVOT] - early * v
    for k in range(2):
        shift = _SHIFT[k]
        for i in range(7):
            C[i, k] = P[i, shift]
        along = P[Ix.PIVOT, shift] - early * P[Ix.SPEED, shift]
        along -= c.clock_share * v * P[Ix.GNSS_DELAY, shift]
        turned = ahead * P[Ix.YAW, shift]
        C[Ix.EAST, k] += cos * along - sin * turned
        C[Ix.NORTH, k] += sin * along + cos * turned
    return C
