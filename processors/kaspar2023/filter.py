"""filterpy's extended Kalman filter with the transition of kaspar2023, its algebra compiled.

Attributes and calls are filterpy's: `predict`, `predict_x`, `update(z, HJacobian, Hx, R)`; the rest
of it (log-likelihood, Mahalanobis distance, printing) works on what they leave. F is mostly the
identity, and rows of H are mostly zeros: the kernels only touch what is not. A measurement with a
diagonal R is taken row by row, with h and H at the prior for all of its rows, which gives the same
result as taking it at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tramstream.estimation.filterpy_base import ExtendedKalmanFilter
from tramstream.estimation.kalman import Array, compiled, predict_covariance, update_scalar
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.model import COLUMNS, ENTRIES, PATTERN, ROWS, SIZE, STEP_S

ENTRY_COUNT = len(ENTRIES)
NO_GATE = math.inf
"""The work takes every measurement."""


@compiled
def _predict(x: Array, P: Array, F: Array, Q: Array, dt_s: float) -> None:
    """x ← f(x), P ← FPFᵀ + Q, all in place."""
    values = np.empty(ENTRY_COUNT)
    model.transition(x, dt_s, values)
    model.move(x, dt_s)
    predict_covariance(P, PATTERN, values, ENTRY_COUNT, np.empty((SIZE, SIZE)))
    P += Q
    for k in range(ENTRY_COUNT):
        i, j = ROWS[k], COLUMNS[k]
        F[i, j] = values[k] + (1.0 if i == j else 0.0)


@compiled
def _update(
    x: Array, P: Array, H: Array, y: Array, R: Array, K: Array, S: Array, SI: Array, taken: Array
) -> None:
    """Take a measurement of m rows with a diagonal R.

    With the rows taken one after the other, row i sees the innovation y'_i = y_i − H_i D y, where
    column j of D is what a unit of y_j has moved the state by so far. So y' = L y with a triangular
    L, and since the y' are uncorrelated, S⁻¹ = Lᵀ diag(1/S') L; at the end D is the gain.

    Parameters
    ----------
    x, P : ndarray
        Changed in place.
    H : ndarray, shape (m, n)
        Mostly zeros.
    y : ndarray, shape (m, 1)
        Innovation at the prior.
    R : ndarray, shape (m, m)
        Only its diagonal is read.
    K, S, SI : ndarray
        Zeros; get the gain (n, m), the innovation's covariance (m, m) and its inverse.
    taken : ndarray, shape (m, 2)
        Gets y'_i and S'_i.
    """
    m, n = H.shape
    counts = np.zeros(m, dtype=np.int64)
    columns = np.empty((m, n), dtype=np.int64)
    values = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            if H[i, j] != 0.0:
                columns[i, counts[i]], values[i, counts[i]] = j, H[i, j]
                counts[i] += 1
    for i in range(m):
        for j in range(i + 1):
            for a in range(counts[i]):
                for b in range(counts[j]):
                    S[i, j] += values[i, a] * P[columns[i, a], columns[j, b]] * values[j, b]
            S[j, i] = S[i, j]
        S[i, i] += R[i, i]
    gain, L = np.empty(n), np.eye(m)
    for i in range(m):
        for j in range(i):
            for a in range(counts[i]):
                L[i, j] -= values[i, a] * K[columns[i, a], j]
        innovation = 0.0
        for j in range(i + 1):
            innovation += L[i, j] * y[j, 0]
        variance = update_scalar(
            x[:, 0], P, columns[i], values[i], counts[i], innovation, R[i, i], NO_GATE, gain
        )
        taken[i, 0], taken[i, 1] = innovation, variance
        for j in range(i + 1):
            for a in range(n):
                K[a, j] += gain[a] * L[i, j]
    for k in range(m):
        for i in range(k + 1):
            for j in range(k + 1):
                SI[i, j] += L[k, i] * L[k, j] / taken[k, 1]


class Kaspar2023Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """The 25 states of the work (`kaspar2023_model.Ix`) behind filterpy's attributes.

    P is symmetric. What is rare (an R that is not diagonal, no measurement) goes to filterpy. R is
    given with each measurement, for there are several kinds.

    Parameters
    ----------
    Q : ndarray, shape (25, 25)
        Process noise of one step of 0.01 s.
    """

    x: Array
    P: Array
    F: Array
    Q: Array

    def __init__(self, Q: Array) -> None:
        super().__init__(dim_x=SIZE, dim_z=len(model.INERTIAL))
        self.Q = Q.copy()
        self.taken: Array = np.zeros((0, 2))
        """Rows of the last measurement: innovation given the rows before it, and its variance."""

    def predict_x(self, u: Any = 0, dt_s: float = STEP_S) -> None:
        """Move the state on; the model has no input `u`."""
        x = self.x.copy()
        model.move(x, dt_s)
        self.x = x

    def predict(self, u: Any = 0, dt_s: float = STEP_S) -> None:
        """x = f(x), P = FPFᵀ + Q; F is kept. Q is that of a step, whatever `dt_s`."""
        x, P = self.x.copy(), self.P.copy()
        _predict(x, P, self.F, self.Q, dt_s)
        self.x, self.P = x, P
        self.x_prior, self.P_prior = x.copy(), P.copy()

    def update(
        self,
        z: Array | None,
        HJacobian: Callable[..., Array],
        Hx: Callable[..., Array],
        R: Array | float | None = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Array, Array], Array] = np.subtract,
    ) -> None:
        """K = PHᵀS⁻¹, x = x + Ky, P = P − KSKᵀ; as filterpy's, with z of shape (m, 1)."""
        R = self.R if R is None else R
        if z is None or not isinstance(R, np.ndarray) or not _is_diagonal(R):
            super().update(z, HJacobian, Hx, R, args, hx_args, residual)
            self.taken = np.zeros((0, 2))
            return
        H = HJacobian(self.x, *_as_tuple(args))
        y = residual(z, Hx(self.x, *_as_tuple(hx_args)))
        m = len(H)
        x, P = self.x.copy(), self.P.copy()
        K, S, SI, taken = np.zeros((SIZE, m)), np.zeros((m, m)), np.zeros((m, m)), np.empty((m, 2))
        _update(x, P, H, y, R, K, S, SI, taken)
        self.x, self.P, self.y, self.K, self.S, self.SI = x, P, y, K, S, SI
        self.taken = taken
        self.z = z.copy()
        self.x_post, self.P_post = x.copy(), P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None  # when asked for


def _as_tuple(args: Any) -> tuple[Any, ...]:
    """What filterpy takes for arguments: a tuple, or one that is none."""
    return args if isinstance(args, tuple) else (args,)


@compiled
def _is_diagonal(R: Array) -> bool:
    for i in range(R.shape[0]):
        for j in range(R.shape[1]):
            if i != j and R[i, j] != 0.0:
                return False
    return True


def warm_up(Q: Array) -> None:
    """Call every kernel once, so that no step on the vehicle waits for the compiler."""
    kalman = Kaspar2023Filter(Q)
    kalman.predict()
    lever: tuple[Any, ...] = (np.zeros(3), 0.0)
    kinds: tuple[tuple[Any, Any, int, tuple[Any, ...]], ...] = (
        (model.inertial_jacobian, model.inertial, len(model.INERTIAL), (0.0,)),
        (model.antenna_jacobian, model.antenna, 3, lever),
        (model.wheels_jacobian, model.wheels, 2, (1.0, 1.0)),
        (model.one_wheel_jacobian, model.one_wheel, 1, (1.0,)),
    )
    for jacobian, function, rows, arguments in kinds:
        kalman.update(np.zeros((rows, 1)), jacobian, function, np.eye(rows), arguments, arguments)
