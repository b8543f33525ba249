"""The update of the model `tram`, compiled: scalars one by one, or two that belong together.

A measurement leaves innovations and rows of H in the memory and comes here, once for each scalar or
pair. What is left of it (y, S, R, K and H, scalar by scalar) is what the filter reports, what a
filterpy user reads and what a smoother goes back over.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.estimation.kalman import Array, Indices, compiled, update_scalar
from tramstream.processors.tram_model.records import Memory
from tramstream.processors.tram_model.states import Ix


def columns_of(*states: Ix) -> Indices:
    """Name the states that a row of H depends on."""
    return np.array([int(state) for state in states], dtype=np.int64)


@compiled
def _gather(f: Memory, k: int, columns: Indices) -> None:
    """Put the entries of row `k` side by side, with their columns."""
    h, values, kept = f.H[k], f.values[k], f.columns[k]
    for i in range(columns.shape[0]):
        kept[i] = columns[i]
        values[i] = h[columns[i]]
    f.counts[k] = columns.shape[0]
    f.rows = k + 1


@compiled
def update_row(f: Memory, k: int, columns: Indices, variance: float, gate: float) -> None:
    """Take scalar `k`, whose innovation `f.y[k]` and row `f.H[k]` are in place.

    Parameters
    ----------
    columns : ndarray of int
        States that the row depends on.
    variance : float
        R.
    gate : float
        Greatest y²/S that is accepted.
    """
    _gather(f, k, columns)
    f.R[k] = variance
    f.S[k] = update_scalar(
        f.x, f.P, columns, f.values[k], columns.shape[0], f.y[k], variance, gate, f.K[k]
    )


@compiled
def _distance(a: float, b: float, first: float, cross: float, second: float) -> float:
    return (a * a * second - 2.0 * a * b * cross + b * b * first) / (first * second - cross * cross)


@compiled
def update_pair(
    f: Memory,
    columns: Indices,
    columns2: Indices,
    variance: float,
    doubt: float,
    gate: float,
    knee: float,
) -> None:
    """Take scalars 0 and 1: both or none, gated by their joint y S⁻¹ yᵀ.

    Between `knee` and `gate` the pair is weighted down: R grows until the distance is what a Huber
    loss would make of it (√knee · distance instead of distance²).

    Parameters
    ----------
    columns, columns2 : ndarray of int
        States that the two rows depend on.
    variance : float
        R of each, without correlation.
    doubt : float
        Variance that is added to both for the gate alone: what is off by less is no outlier, but
        a model that is not as good as it claims.
    gate, knee : float
        Squared Mahalanobis distances.

    References
    ----------
    C. D. Karlgaard, H. Schaub, "Huber-based divided difference filtering", Journal of Guidance,
    Control, and Dynamics 30 (2007) 885-891: the weight.
    """
    _gather(f, 0, columns)
    _gather(f, 1, columns2)
    values, values2 = f.values[0], f.values[1]
    first, cross, second = _innovation_covariance(f, columns, columns2, variance)
    a, b = f.y[0], f.y[1]
    f.cross = cross
    if not _distance(a, b, first + doubt, cross, second + doubt) <= gate:
        f.S[0], f.S[1] = -first, -second
        f.R[0] = f.R[1] = variance
        f.K[0][:] = 0.0
        f.K[1][:] = 0.0
        return
    distance = _distance(a, b, first, cross, second)
    if distance > knee:
        variance += (math.sqrt(distance / knee) - 1.0) * 0.5 * (first + second)
    f.R[0] = f.R[1] = variance
    count, count2 = columns.shape[0], columns2.shape[0]
    f.S[0] = update_scalar(f.x, f.P, columns, values, count, a, variance, math.inf, f.K[0])
    # The second row sees what the first one has moved, to first order.
    moved = 0.0
    for k in range(count2):
        moved += values2[k] * f.K[0, columns2[k]]
    f.y[1] = b - moved * a
    f.S[1] = update_scalar(f.x, f.P, columns2, values2, count2, f.y[1], variance, math.inf, f.K[1])


@compiled
def _innovation_covariance(
    f: Memory, columns: Indices, columns2: Indices, variance: float
) -> tuple[float, float, float]:
    """H P Hᵀ + R of scalars 0 and 1: first variance, covariance, second variance."""
    P, PH, values, values2 = f.P, f.K[0], f.values[0], f.values[1]
    for i in range(PH.shape[0]):
        PH[i] = 0.0
    for k in range(columns.shape[0]):
        for i in range(PH.shape[0]):
            PH[i] += P[columns[k], i] * values[k]
    first, cross, second = variance, 0.0, variance
    for k in range(columns.shape[0]):
        first += values[k] * PH[columns[k]]
    for k in range(columns2.shape[0]):
        cross += values2[k] * PH[columns2[k]]
    for k in range(columns2.shape[0]):
        for j in range(columns2.shape[0]):
            second += values2[k] * P[columns2[k], columns2[j]] * values2[j]
    return first, cross, second


@compiled
def make_anew(P: Array, state: int, variance: float) -> None:
    """Make a state independent of all others, with a variance of its own."""
    for i in range(P.shape[0]):
        P[state, i] = P[i, state] = 0.0
    P[state, state] = variance
