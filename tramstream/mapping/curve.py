"""Curves between smoothed states: what lies between two nodes, how long it is, how uncertain.

A state is position, direction and second derivative of both coordinates against a parameter u,
shape (n, 2, 3). Between two states the mean of a process that is driven by white noise on the
third derivative is the quintic that meets both; what it strays from that has variances in closed
form (`bridge_variances`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(5)
_GAUSS_X, _GAUSS_W = (_GAUSS_X + 1) / 2, _GAUSS_W / 2
_NEWTON_STEPS = 3
_CUBIC_M = 1e-4
_BASIS = np.array(
    [
        [1, 0, 0, -10, 15, -6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 10, -15, 6],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)
"""Coefficients of the six quintics, ascending: of the first state's three numbers, then of the
second's, for a step of length 1."""


def _weights(share: Array, derivative: int) -> Array:
    """Value of the six quintics or of a derivative of theirs, shape (n, 6)."""
    coefficients = _BASIS.T
    for _ in range(derivative):
        coefficients = coefficients[1:] * np.arange(1, len(coefficients))[:, None]
    weights = np.broadcast_to(coefficients[-1], (len(share), 6))
    for row in coefficients[-2::-1]:  # Horner; `**` takes ten times as long
        weights = weights * share[:, None] + row
    return weights


def _scales(h: Array) -> Array:
    """What a step's length makes of the six numbers, shape (n, 6)."""
    one = np.ones_like(h)
    return np.stack([one, h, h * h, one, h, h * h], axis=1)


def between(begin: Array, end: Array, h: Array, share: ArrayLike, derivative: int = 0) -> Array:
    """Position, or a derivative of it, between states.

    Parameters
    ----------
    begin, end : ndarray, shape (n, 2, 3)
    h : ndarray, shape (n,)
        Distance of the two in u.
    share : array_like, shape (n,) or float
        Of h, 0 to 1.

    Returns
    -------
    ndarray, shape (n, 2)
    """
    at = np.broadcast_to(np.asarray(share, dtype=float), h.shape)
    weights = _weights(at, derivative) * _scales(h) / h[:, None] ** derivative
    # Differences from the first position: coordinates of a city are large.
    states = np.concatenate([begin, end], axis=2)
    first = begin[:, :, 0].copy()
    states[:, :, [0, 3]] -= first[:, :, None]
    value: Array = np.stack([np.sum(weights * states[:, axis], axis=1) for axis in (0, 1)], axis=1)
    return value + first if derivative == 0 else value


def lengths_m(begin: Array, end: Array, h: Array, share: ArrayLike = 1.0) -> Array:
    """Lengths of the curves between states up to a share of the step, shape (n,)."""
    upto = np.broadcast_to(np.asarray(share, dtype=float), h.shape)
    total = np.zeros(len(h))
    for x, weight in zip(_GAUSS_X, _GAUSS_W, strict=True):
        total += weight * np.hypot(*between(begin, end, h, upto * x, 1).T)
    lengths: Array = total * h * upto
    return lengths


def share_at(x: Array, h: Array, length_m: Array, step: Integers, arc_m: Array) -> Array:
    """Share of steps at which curves have gone an arc length, shape (n,).

    The way along a step is all but a cubic, with its length and the speed at its ends; where it is
    not to `_CUBIC_M`, the quadrature is asked.

    Parameters
    ----------
    x : ndarray, shape (m, 2, 3)
        States; between neighbours lie the steps.
    h, length_m : ndarray, shape (m - 1,)
        Of each step, in u and along the curve; where a curve ends, any.
    step : ndarray of int, shape (n,)
    arc_m : ndarray, shape (n,)
        From the begin of the step.
    """
    speed = np.hypot(x[:, 0, 1], x[:, 1, 1])
    length_m = np.maximum(length_m, 1e-9)
    first, last = speed[:-1] * h / length_m, speed[1:] * h / length_m
    half_m = lengths_m(x[:-1], x[1:], h, 0.5)
    rough = np.abs(half_m / length_m - 0.5 - (first - last) / 8) * length_m > _CUBIC_M
    wanted = np.clip(arc_m / length_m[step], 0.0, 1.0)
    first, last = first[step], last[step]
    cubic, square = first + last - 2, 3 - 2 * first - last
    share = wanted
    for _ in range(_NEWTON_STEPS):
        gone = share * (first + share * (square + share * cubic))
        slope = first + share * (2 * square + share * 3 * cubic)
        share = np.clip(share + (wanted - gone) / np.maximum(slope, 0.1), 0.0, 1.0)
    again = np.flatnonzero(rough[step])
    begin, end, span = x[step[again]], x[step[again] + 1], h[step[again]]
    for _ in range(_NEWTON_STEPS):
        slope = np.hypot(*between(begin, end, span, share[again], 1).T)
        left_m = arc_m[again] - lengths_m(begin, end, span, share[again])
        moved = left_m / np.maximum(slope * span, 1e-9)
        share[again] = np.clip(share[again] + moved, 0.0, 1.0)
    return share


def curvature_per_m(direction: Array, bend: Array) -> Array:
    """Curvature, left positive, from first and second derivatives, shape (n, 2) each."""
    turning = direction[:, 0] * bend[:, 1] - direction[:, 1] * bend[:, 0]
    curvature: Array = turning / np.hypot(*direction.T) ** 3
    return curvature


def variances(
    joint: tuple[Array, Array, Array], h: Array, share: Array, q: Array
) -> tuple[Array, Array]:
    """Variances of position and direction of a coordinate between states.

    Parameters
    ----------
    joint : tuple of ndarray, shape (n, 3, 3) each
        Covariance of the first state, of the first with the second, of the second.
    h, share, q : ndarray, shape (n,)
        Step, part of it, density of the noise.
    """
    first, cross, second = joint
    of_bridge = bridge_variances(h, share, q)
    scales = _scales(h)
    found = []
    for derivative in (0, 1):
        w = _weights(share, derivative) * scales / h[:, None] ** derivative
        a, b = w[:, :3], w[:, 3:]
        value = np.einsum("ni,nij,nj->n", a, first, a) + np.einsum("ni,nij,nj->n", b, second, b)
        value += 2 * np.einsum("ni,nij,nj->n", a, cross, b)
        found.append(np.maximum(value, 0.0) + of_bridge[derivative])
    return found[0], found[1]


def bridge_variances(h: Array, share: Array, q: Array) -> tuple[Array, Array]:
    """Variances of position and direction between two states that are known.

    By condensing the process on both ends: with v = w (1 - w), of position q h⁵ v⁵/20, of
    direction q h³ v³ (1/3 - 5 v/4).
    """
    v = share * (1 - share)
    return q * h**5 * v**5 / 20, q * h**3 * v**3 * (1 / 3 - 1.25 * v)
