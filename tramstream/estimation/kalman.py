"""Covariance algebra of the filters, compiled: sparse prediction and scalar measurements.

Every model hands in its transition as F = I + A with the few entries of A, and its measurements one
scalar at a time with the few entries of its row of H; a vector with a diagonal R gives the same
result taken row by row (Bar-Shalom et al., section 7.4). All functions work in place on arrays
that the caller owns, keep P symmetric bit by bit, and are held to filterpy's dense `predict` and
`update` by a test.

Each is compiled once a machine and kept (`tramstream/machine/kernels.py`).

Equations: docs/theory.md, section 4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tramstream.machine.kernels import compiled as compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@compiled
def predict_covariance(
    P: Array, rows: Indices, columns: Indices, values: Array, count: int, work: Array
) -> None:
    """P ← (I + A) P (I + A)ᵀ for A with `count` entries (row, column, value).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Symmetric; changed in place.
    rows, columns : ndarray, shape (≥ count,)
        Entries of A; several in one place add up.
    values : ndarray, shape (≥ count,)
    work : ndarray, shape (n, n)
        Scratch.
    """
    n = P.shape[0]
    for i in range(n):
        for j in range(n):
            work[i, j] = P[i, j]
    for k in range(count):
        i, j, a = rows[k], columns[k], values[k]
        for m in range(n):
            work[i, m] += a * P[j, m]
    # work = (I + A) P; now its columns, into P's rows: the result is symmetric.
    for i in range(n):
        for j in range(n):
            P[i, j] = work[j, i]
    for k in range(count):
        i, j, a = rows[k], columns[k], values[k]
        for m in range(n):
            P[i, m] += a * work[m, j]
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@compiled
def update_scalar(
    x: Array,
    P: Array,
    columns: Indices,
    values: Array,
    count: int,
    innovation: float,
    variance: float,
    gate: float,
    K: Array,
) -> float:
    """Take one scalar measurement: K = PHᵀ/S, x += Ky, P −= KSKᵀ.

    Parameters
    ----------
    x : ndarray, shape (n,)
    P : ndarray, shape (n, n)
    columns, values : ndarray, shape (≥ count,)
        Entries of the row of H.
    innovation : float
        y = z − h(x).
    variance : float
        R.
    gate : float
        Greatest y²/S that is accepted.
    K : ndarray, shape (n,)
        Gets the gain, zeros when refused.

    Returns
    -------
    float
        S; negative when the measurement was refused and nothing has changed.
    """
    n = x.shape[0]
    for i in range(n):
        K[i] = 0.0
    for k in range(count):
        j, h = columns[k], values[k]
        for i in range(n):
            K[i] += P[j, i] * h
    S = variance
    for k in range(count):
        S += values[k] * K[columns[k]]
    if not (innovation * innovation <= gate * S):  # refuses what is not a number, too
        for i in range(n):
            K[i] = 0.0
        return -S
    inverse = 1.0 / S
    for i in range(n):
        gain = K[i] * inverse
        x[i] += gain * innovation
        for j in range(i + 1):
            P[i, j] -= gain * K[j]
            P[j, i] = P[i, j]
    for i in range(n):
        K[i] *= inverse
    return S


@compiled
def _distance(a: float, b: float, first: float, cross: float, second: float) -> float:
    return (a * a * second - 2.0 * a * b * cross + b * b * first) / (first * second - cross * cross)


@compiled
def update_pair(
    x: Array,
    P: Array,
    columns: Indices,
    values: Array,
    count: int,
    columns2: Indices,
    values2: Array,
    count2: int,
    variance: float,
    doubt: float,
    gate: float,
    knee: float,
    K: Array,
    K2: Array,
    out: Array,
) -> None:
    """Take two scalars that belong together: both or none, gated by their joint y S⁻¹ yᵀ.

    Between `knee` and `gate` the pair is weighted down: R grows until the distance is what a Huber
    loss would make of it (√knee · distance instead of distance²).

    Parameters
    ----------
    columns, values, count, columns2, values2, count2
        The two rows of H; see `update_scalar`.
    variance : float
        R of each, without correlation.
    doubt : float
        Variance that is added to both for the gate alone: what is off by less is no outlier, but
        a model that is not as good as it claims.
    knee, gate : float
        Squared Mahalanobis distances.
    K, K2 : ndarray, shape (n,)
        Get the gains, of the second given the first; see `update_scalar`.
    out : ndarray, shape (≥ 2, 2)
        Holds the innovations in its first column; gets, for the second given the first, the
        innovation, and the variances in the second column; those are negative when refused.

    References
    ----------
    C. D. Karlgaard, H. Schaub, "Huber-based divided difference filtering", Journal of Guidance,
    Control, and Dynamics 30 (2007) 885-891: the weight.
    """
    n = x.shape[0]
    for i in range(n):
        K[i] = 0.0
    for k in range(count):
        for i in range(n):
            K[i] += P[columns[k], i] * values[k]
    first, cross, second = variance, 0.0, variance
    for k in range(count):
        first += values[k] * K[columns[k]]
    for k in range(count2):
        cross += values2[k] * K[columns2[k]]
    for k in range(count2):
        for j in range(count2):
            second += values2[k] * P[columns2[k], columns2[j]] * values2[j]
    a, b = out[0, 0], out[1, 0]
    if not _distance(a, b, first + doubt, cross, second + doubt) <= gate:
        out[0, 1], out[1, 1] = -first, -second
        return
    distance = _distance(a, b, first, cross, second)
    if distance > knee:
        variance += (math.sqrt(distance / knee) - 1.0) * 0.5 * (first + second)
    out[0, 1] = update_scalar(x, P, columns, values, count, a, variance, math.inf, K)
    # The second row sees what the first one has moved, to first order.
    moved = 0.0
    for k in range(count2):
        moved += values2[k] * K[columns2[k]]
    out[1, 0] = b - moved * a
    out[1, 1] = update_scalar(x, P, columns2, values2, count2, out[1, 0], variance, math.inf, K2)


@compiled
def sound(x: Array, P: Array) -> bool:
    """Whether x and P hold numbers only, and no variance is negative."""
    total = 0.0
    for i in range(x.shape[0]):
        total += abs(x[i])
        if P[i, i] < 0.0:
            return False
        for j in range(x.shape[0]):
            total += abs(P[i, j])
    return math.isfinite(total)
