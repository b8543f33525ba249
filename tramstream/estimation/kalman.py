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
