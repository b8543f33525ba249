"""Kalman filter and fixed-interval smoother of plane curves, compiled.

A curve is two coordinates (east, north) that share one covariance: state position, direction and
second derivative against a parameter u (about arc length), driven by white noise of density q on
the third derivative, q one a step. Observed at each step is the position, with one variance.
Curves lie one after another in the arrays.

References
----------
H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic systems",
AIAA Journal 3 (1965) 1445-1450.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.kalman import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

DIRECTION_STD = 1.0
CURVATURE_STD_PER_M = 1 / 15.0
"""What is known of a curve before its first node; no tram turns tighter than 15 m."""


@compiled
def _noise(h: float, Q: Array) -> None:
    """Covariance of the noise of density 1 over a step h."""
    Q[0, 0] = h**5 / 20.0
    Q[0, 1] = Q[1, 0] = h**4 / 8.0
    Q[0, 2] = Q[2, 0] = h**3 / 6.0
    Q[1, 1] = h**3 / 3.0
    Q[1, 2] = Q[2, 1] = h**2 / 2.0
    Q[2, 2] = h


@compiled
def _predict_mean(h: float, x: Array, ahead: Array) -> None:
    for axis in range(2):
        ahead[axis, 0] = x[axis, 0] + h * x[axis, 1] + 0.5 * h * h * x[axis, 2]
        ahead[axis, 1] = x[axis, 1] + h * x[axis, 2]
        ahead[axis, 2] = x[axis, 2]


@compiled
def _transit(h: float, P: Array, out: Array) -> None:
    """out = F P Fᵀ; out may not be P."""
    half = 0.5 * h * h
    a = np.empty((3, 3))
    for j in range(3):
        a[0, j] = P[0, j] + h * P[1, j] + half * P[2, j]
        a[1, j] = P[1, j] + h * P[2, j]
        a[2, j] = P[2, j]
    for i in range(3):
        out[i, 0] = a[i, 0] + h * a[i, 1] + half * a[i, 2]
        out[i, 1] = a[i, 1] + h * a[i, 2]
        out[i, 2] = a[i, 2]
    for i in range(3):
        for j in range(i):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])


@compiled
def _invert(P: Array, out: Array) -> None:
    """Inverse of a positive definite 3 x 3, by Cholesky; scaled, so that units do not matter."""
    s0, s1, s2 = math.sqrt(P[0, 0]), math.sqrt(P[1, 1]), math.sqrt(P[2, 2])
    a, b, c = P[0, 1] / (s0 * s1), P[0, 2] / (s0 * s2), P[1, 2] / (s1 * s2)
    l11 = math.sqrt(max(1.0 - a * a, 1e-14))
    l21 = (c - a * b) / l11
    l22 = math.sqrt(max(1.0 - b * b - l21 * l21, 1e-14))
    # The inverse of the factor [[1, 0, 0], [a, l11, 0], [b, l21, l22]].
    m10, m11 = -a / l11, 1.0 / l11
    m20, m21, m22 = (a * l21 / l11 - b) / l22, -l21 / (l11 * l22), 1.0 / l22
    out[0, 0] = (1.0 + m10 * m10 + m20 * m20) / (s0 * s0)
    out[0, 1] = out[1, 0] = (m10 * m11 + m20 * m21) / (s0 * s1)
    out[0, 2] = out[2, 0] = m20 * m22 / (s0 * s2)
    out[1, 1] = (m11 * m11 + m21 * m21) / (s1 * s1)
    out[1, 2] = out[2, 1] = m21 * m22 / (s1 * s2)
    out[2, 2] = m22 * m22 / (s2 * s2)


@compiled
def _product(A: Array, B: Array, out: Array) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@compiled
def _transposed_step(h: float, P: Array, out: Array) -> None:
    """out = P Fᵀ."""
    half = 0.5 * h * h
    for i in range(3):
        out[i, 0] = P[i, 0] + h * P[i, 1] + half * P[i, 2]
        out[i, 1] = P[i, 1] + h * P[i, 2]
        out[i, 2] = P[i, 2]


@compiled
def _weigh(
    x: Array, gap: Array, inverse: Array, gained: Array, Q: Array, work: Array, out: Array
) -> None:
    """out = r Q r of the part across the curve and tr(Q N), for q = 1; see `smooth_curves`."""
    east, north = x[0, 1], x[1, 1]
    size = max(math.hypot(east, north), 1e-9)
    r0, r1, r2 = 0.0, 0.0, 0.0
    for j in range(3):
        across = (east * gap[1, j] - north * gap[0, j]) / size
        r0 += inverse[0, j] * across
        r1 += inverse[1, j] * across
        r2 += inverse[2, j] * across
    out[0] = Q[0, 0] * r0 * r0 + Q[1, 1] * r1 * r1 + Q[2, 2] * r2 * r2
    out[0] += 2.0 * (Q[0, 1] * r0 * r1 + Q[0, 2] * r0 * r2 + Q[1, 2] * r1 * r2)
    _product(inverse, gained, work)
    out[1] = 0.0
    for i in range(3):
        for j in range(3):
            for m in range(3):  # N = inverse gained inverse
                out[1] += Q[j, i] * work[i, m] * inverse[m, j]


@compiled
def _begin(z: Array, variance: float, x: Array, P: Array) -> None:
    """What is known before the first node of a curve: z holds the first two nodes."""
    chord = math.hypot(z[1, 0] - z[0, 0], z[1, 1] - z[0, 1])
    for i in range(3):
        for j in range(3):
            P[i, j] = 0.0
    P[0, 0] = 1e4 * variance
    P[1, 1] = DIRECTION_STD**2
    P[2, 2] = CURVATURE_STD_PER_M**2
    for axis in range(2):
        x[axis, 0] = z[0, axis]
        x[axis, 1] = (z[1, axis] - z[0, axis]) / chord if chord > 0.0 else 1.0 - axis
        x[axis, 2] = 0.0


@compiled
def _observe(z: Array, variance: float, S: float, x: Array, P: Array) -> None:
    """Take a position; S is the variance of its innovation."""
    g0, g1, g2 = P[0, 0] / S, P[1, 0] / S, P[2, 0] / S
    for axis in range(2):
        innovation = z[axis] - x[axis, 0]
        x[axis, 0] += g0 * innovation
        x[axis, 1] += g1 * innovation
        x[axis, 2] += g2 * innovation
    p1, p2 = P[0, 1], P[0, 2]
    P[0, 0] = g0 * variance  # = P - P²/S, without a difference
    P[0, 1] = P[1, 0] = g1 * variance
    P[0, 2] = P[2, 0] = g2 * variance
    P[1, 1] -= g1 * p1
    P[1, 2] -= g1 * p2
    P[2, 1] = P[1, 2]
    P[2, 2] -= g2 * p2


@compiled
def filter_curves(
    starts: Integers,
    u: Array,
    z: Array,
    q: Array,
    variance: float,
    x: Array,
    P: Array,
    ahead_x: Array,
    ahead_P: Array,
) -> float:
    """Filter all curves forwards.

    Parameters
    ----------
    starts : ndarray, shape (curves + 1,)
        First step of each curve.
    u : ndarray, shape (n,)
        Ascending within a curve.
    z : ndarray, shape (n, 2)
        East, north, m; two or more in each curve.
    q : ndarray, shape (n,)
        Density of the noise from a step to the next.
    variance : float
        Of an observed coordinate, m².
    x, ahead_x : ndarray, shape (n, 2, 3)
        Get what is known after and before a step's observation.
    P, ahead_P : ndarray, shape (n, 3, 3)

    Returns
    -------
    float
        Logarithm of the likelihood of the innovations across the curve; those along say nothing,
        since u is made of the same nodes.
    """
    total = 0.0
    Q = np.empty((3, 3))
    for curve in range(len(starts) - 1):
        begin, end = starts[curve], starts[curve + 1]
        for k in range(begin, end):
            if k == begin:
                _begin(z[k : k + 2], variance, ahead_x[k], ahead_P[k])
            else:
                h = u[k] - u[k - 1]
                _predict_mean(h, x[k - 1], ahead_x[k])
                _transit(h, P[k - 1], ahead_P[k])
                _noise(h, Q)
                for i in range(3):
                    for j in range(3):
                        ahead_P[k, i, j] += q[k - 1] * Q[i, j]
            x[k] = ahead_x[k]
            P[k] = ahead_P[k]
            S = ahead_P[k, 0, 0] + variance
            if k > begin:
                east, north = x[k, 0, 1], x[k, 1, 1]
                across = east * (z[k, 1] - x[k, 1, 0]) - north * (z[k, 0] - x[k, 0, 0])
                across /= max(math.hypot(east, north), 1e-9)
                total -= 0.5 * (across * across / S + math.log(S))
            _observe(z[k], variance, S, x[k], P[k])
    return total


@compiled
def smooth_curves(
    starts: Integers,
    u: Array,
    q: Array,
    x: Array,
    P: Array,
    ahead_x: Array,
    ahead_P: Array,
    cross: Array,
    evidence: Array,
) -> None:
    """Smooth all curves backwards, in place: x and P become those given all observations.

    Parameters
    ----------
    starts, u, q, x, P, ahead_x, ahead_P
        As `filter_curves` left them.
    cross : ndarray, shape (n, 3, 3)
        Gets the covariance of a step's state with the next one's.
    evidence : ndarray, shape (n, 2)
        Gets, for the noise from a step to the next, r Q r of the part across the curve and
        tr(Q N): the derivative of the logarithm of the likelihood against that of q is half their
        difference; the second is what the observations say of the step, 0 to 3.
    """
    Q, inverse, G = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    gained, work, gap = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    for curve in range(len(starts) - 1):
        begin, end = starts[curve], starts[curve + 1]
        evidence[end - 1] = 0.0
        cross[end - 1] = 0.0
        for k in range(end - 2, begin - 1, -1):
            h = u[k + 1] - u[k]
            _noise(h, Q)
            _invert(ahead_P[k + 1], inverse)
            for axis in range(2):
                for i in range(3):
                    gap[axis, i] = x[k + 1, axis, i] - ahead_x[k + 1, axis, i]
            for i in range(3):
                for j in range(3):
                    gained[i, j] = ahead_P[k + 1, i, j] - P[k + 1, i, j]
            _weigh(x[k + 1], gap, inverse, gained, Q, work, evidence[k])
            evidence[k] *= q[k]
            _transposed_step(h, P[k], work)
            _product(work, inverse, G)
            for axis in range(2):
                for i in range(3):
                    for j in range(3):
                        x[k, axis, i] += G[i, j] * gap[axis, j]
            _product(G, P[k + 1], cross[k])
            _product(G, gained, work)
            for i in range(3):
                for j in range(i + 1):
                    for m in range(3):
                        P[k, i, j] -= work[i, m] * G[j, m]
                    P[k, j, i] = P[k, i, j]


@compiled
def spread(starts: Integers, u: Array, values: Array, reach_m: float, out: Array) -> None:
    """Sum values over the steps around each, weighted by exp(-|distance| / reach_m).

    Parameters
    ----------
    u : ndarray, shape (n,)
        Where the values belong, ascending within a curve.
    values, out : ndarray, shape (n, m)
        `out` gets the sums; its own value counts with weight 1.
    """
    for curve in range(len(starts) - 1):
        begin, end = starts[curve], starts[curve + 1]
        for column in range(values.shape[1]):
            total = 0.0
            for k in range(begin, end):
                if k > begin:
                    total *= math.exp(-(u[k] - u[k - 1]) / reach_m)
                total += values[k, column]
                out[k, column] = total
            total = 0.0
            for k in range(end - 1, begin - 1, -1):
                if k < end - 1:
                    total *= math.exp(-(u[k + 1] - u[k]) / reach_m)
                out[k, column] += total
                total += values[k, column]
