"""Distance and speed with a filterpy Kalman filter: the model of konecny2004.

State x = (s, ṡ): arc length in m, speed in m/s. F = [[1, T], [0, 1]] with the true interval T of
each step; a position measurement has H = [1 0] (konecny2004), a speed measurement H = [0 1].

filterpy's dense algebra costs 25 µs for a step of this size, nearly all of it in calls; here the
same sums are written out for two states and a scalar measurement (`TwoStateFilter`), and numbers
become arrays only when somebody asks for the attribute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.filterpy_base import KalmanFilter

Array = NDArray[np.float64]

POSITION: Array = np.array([[1.0, 0.0]])
SPEED: Array = np.array([[0.0, 1.0]])


class Verdict(NamedTuple):
    """Innovation of one update, its variance, and whether the gate let it pass."""

    innovation: float
    variance: float
    accepted: bool


class _Matrix:
    """An attribute that is kept as numbers, row by row, and given as an array of its own.

    The array may not be written to: it is not what the filter goes on with. Assign a whole one.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self._shape = rows, columns

    def __set_name__(self, owner: type, name: str) -> None:
        self._place = f"_{name}_numbers"

    def __get__(self, owner: Any, type_: type | None = None) -> Any:
        if owner is None:
            return self
        array: Array = np.array(getattr(owner, self._place)).reshape(self._shape)
        array.flags.writeable = False
        return array

    def __set__(self, owner: Any, value: Any) -> None:
        numbers = np.broadcast_to(np.asarray(value), self._shape)
        setattr(owner, self._place, tuple(numbers.ravel().tolist()))


class _Remembered(_Matrix):
    """One that is kept in the filter's memory."""

    def __get__(self, owner: Any, type_: type | None = None) -> Any:
        return self if owner is None else super().__get__(owner.memory)

    def __set__(self, owner: Any, value: Any) -> None:
        super().__set__(owner.memory, value)

    def __set_name__(self, owner: type, name: str) -> None:
        self._place = name


@dataclass
class Belief:
    """What a `TwoStateFilter` remembers: mean and covariance as numbers, row by row."""

    x: tuple[float, float] = (0.0, 0.0)
    P: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class TwoStateFilter(KalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter of two states and one measurement, written out; same attributes.

    P is symmetric. What is rare (control input, fading memory, no measurement) goes to filterpy.
    """

    x, P = _Remembered(2, 1), _Remembered(2, 2)
    x_prior, P_prior = _Matrix(2, 1), _Matrix(2, 2)
    x_post, P_post = _Matrix(2, 1), _Matrix(2, 2)
    K = _Matrix(2, 1)
    z, y, S, SI = _Matrix(1, 1), _Matrix(1, 1), _Matrix(1, 1), _Matrix(1, 1)

    def __init__(self, memory: Belief | None = None) -> None:
        self.memory = Belief()
        super().__init__(dim_x=2, dim_z=1)
        self.memory = memory or self.memory

    @property
    def state(self) -> tuple[float, float]:
        """x as numbers."""
        return self.memory.x

    @property
    def covariance(self) -> tuple[float, float, float, float]:
        """P as numbers, row by row."""
        return self.memory.P

    def predict(self, u: Any = None, B: Any = None, F: Any = None, Q: Any = None) -> None:
        """x = Fx, P = FPFᵀ + Q."""
        if u is not None or self._alpha_sq != 1.0 or isinstance(Q, (int, float)):
            super().predict(u, B, F, Q)
            return
        (f00, f01), (f10, f11) = (self.F if F is None else F).tolist()
        (q00, q01), (_, q11) = (self.Q if Q is None else Q).tolist()
        s, v = self.memory.x
        p00, p01, _, p11 = self.memory.P
        a, b = f00 * p00 + f01 * p01, f00 * p01 + f01 * p11  # FP, row by row
        c, d = f10 * p00 + f11 * p01, f10 * p01 + f11 * p11
        cross = a * f10 + b * f11 + q01
        x = (f00 * s + f01 * v, f10 * s + f11 * v)
        P = (a * f00 + b * f01 + q00, cross, cross, c * f10 + d * f11 + q11)
        self.memory.x = self._x_prior_numbers = x
        self.memory.P = self._P_prior_numbers = P

    def move(self, dt_s: float, acceleration_std_mps2: float) -> None:
        """Predict with `transition` and `acceleration_noise`, to the same bits."""
        s, v = self.memory.x
        p00, p01, _, p11 = self.memory.P
        q_s, q_v = _noise_gain(dt_s, acceleration_std_mps2)
        b = p01 + dt_s * p11
        cross = b + q_s * q_v
        self.memory.x = self._x_prior_numbers = (s + dt_s * v, v)
        self.memory.P = self._P_prior_numbers = (
            p00 + dt_s * p01 + b * dt_s + q_s * q_s,
            cross,
            cross,
            p11 + q_v * q_v,
        )

    def update(
        self, z: Any, R: Any = None, H: Any = None, gate_sigma: float = math.inf
    ) -> Verdict | None:
        """K = PHᵀ/S, x = x + Ky, P = (I − KH)P(I − KH)ᵀ + KRKᵀ.

        With `gate_sigma`, a measurement whose innovation is beyond so many standard deviations
        changes nothing.
        """
        if z is None:
            super().update(z, R, H)
            return None
        z, R = _scalar(z), _scalar(self.R if R is None else R)
        ((h0, h1),) = (self.H if H is None else H).tolist()
        s, v = self.memory.x
        p00, p01, _, p11 = self.memory.P
        g0, g1 = p00 * h0 + p01 * h1, p01 * h0 + p11 * h1  # PHᵀ
        y, S = z - (h0 * s + h1 * v), h0 * g0 + h1 * g1 + R
        if not y * y <= gate_sigma * gate_sigma * S:  # refuses what is not a number, too
            return Verdict(y, S, accepted=False)
        k0, k1 = g0 / S, g1 / S
        i00, i01, i10, i11 = 1.0 - k0 * h0, -k0 * h1, -k1 * h0, 1.0 - k1 * h1  # I − KH
        a, b = i00 * p00 + i01 * p01, i00 * p01 + i01 * p11  # (I − KH)P, row by row
        c, d = i10 * p00 + i11 * p01, i10 * p01 + i11 * p11
        cross = a * i10 + b * i11 + k0 * R * k1
        self.memory.x = self._x_post_numbers = (s + k0 * y, v + k1 * y)
        self.memory.P = self._P_post_numbers = (
            a * i00 + b * i01 + k0 * R * k0,
            cross,
            cross,
            c * i10 + d * i11 + k1 * R * k1,
        )
        self._K_numbers = (k0, k1)
        self._z_numbers, self._y_numbers = (z,), (y,)
        self._S_numbers, self._SI_numbers = (S,), (1.0 / S,)
        self._log_likelihood = self._likelihood = self._mahalanobis = None  # when asked for
        return Verdict(y, S, accepted=True)


def _scalar(value: Any) -> float:
    """A float out of what filterpy takes for one: number, (1,) or (1, 1)."""
    return value if isinstance(value, float) else float(np.asarray(value).item())


def distance_filter(x: Array, P: Array, memory: Belief | None = None) -> TwoStateFilter:
    """A filterpy filter for (s, ṡ) at `x`, shape (2,), with covariance `P`, shape (2, 2)."""
    kalman = TwoStateFilter(memory)
    kalman.x = np.array(x, dtype=float).reshape(2, 1)
    kalman.P = np.array(P, dtype=float)
    return kalman


def transition(dt_s: float) -> Array:
    """F of a step of `dt_s` seconds."""
    return np.array(((1.0, dt_s), (0.0, 1.0)))


def acceleration_noise(dt_s: float, std_mps2: float) -> Array:
    """Q of a white acceleration that is constant within the step (piecewise Wiener process).

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 6.3.2.
    """
    s, v = _noise_gain(dt_s, std_mps2)
    return np.array(((s * s, s * v), (v * s, v * v)))


def _noise_gain(dt_s: float, std_mps2: float) -> tuple[float, float]:
    """What an acceleration of 1 σ does to distance and speed in the step."""
    return 0.5 * dt_s * dt_s * std_mps2, dt_s * std_mps2
