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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.machine.kernels import compiled as compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Pattern(NamedTuple):
    """Where A of a transition F = I + A has entries."""

    moving: Indices
    """Rows that have any, in order."""
    places: Indices
    """Of each entry: which of those rows."""
    columns: Indices
    """Of each entry."""

    @classmethod
    def of(cls, rows: Indices, columns: Indices) -> Pattern:
        """Make the pattern of entries in these rows and columns."""
        moving, places = np.unique(rows, return_inverse=True)
        return cls(moving, places.astype(np.int64), columns)


@compiled
def predict_covariance(P: Array, pattern: Pattern, values: Array, count: int, work: Array) -> None:
    """P ← F P Fᵀ for F = I + A, where A has `count` entries.

    Only what moves is touched: rows and columns of states that A has a row for.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Symmetric; changed in place.
    pattern : Pattern
        Where the entries are; several in one place add up.
    values : ndarray, shape (≥ count,)
        The entries.
    work : ndarray, shape (≥ m, n)
        Scratch, for the m rows that have entries.
    """
    moving, count_moving = pattern.moving, pattern.moving.shape[0]
    _multiply(P, pattern, values, count, work)
    for r in range(count_moving):  # P Fᵀ, which is (F P)ᵀ
        i = moving[r]
        for j in range(P.shape[0]):
            P[j, i] = work[r, j]
    _multiply(P, pattern, values, count, work)
    for r in range(count_moving):
        i = moving[r]
        for j in range(P.shape[0]):
            P[i, j] = work[r, j]
        for j in range(P.shape[0]):
            P[j, i] = work[r, j]
    for r in range(count_moving):  # the two halves differ by rounding
        i = moving[r]
        for s in range(r):
            j = moving[s]
            P[i, j] = P[j, i] = 0.5 * (work[r, j] + work[s, i])


@compiled
def _multiply(P: Array, pattern: Pattern, values: Array, count: int, product: Array) -> None:
    """Fill `product` with the moving rows of F P."""
    n = P.shape[0]
    for r in range(pattern.moving.shape[0]):
        i = pattern.moving[r]
        for j in range(n):
            product[r, j] = P[i, j]
    for k in range(count):
        r, i, a = pattern.places[k], pattern.columns[k], values[k]
        for j in range(n):
            product[r, j] += a * P[i, j]


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
