"""Distance and speed with a filterpy Kalman filter: the model of konecny2004.

State x = (s, ṡ): arc length in m, speed in m/s. F = [[1, T], [0, 1]] with the true interval T of
each step; a position measurement has H = [1 0] (konecny2004), a speed measurement H = [0 1].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

Array = NDArray[np.float64]

POSITION: Array = np.array([[1.0, 0.0]])
SPEED: Array = np.array([[0.0, 1.0]])


class Verdict(NamedTuple):
    """Innovation of one update, its variance, and whether the gate let it pass."""

    innovation: float
    variance: float
    accepted: bool


def distance_filter(x: Array, P: Array) -> KalmanFilter:
    """A filterpy filter for (s, ṡ) at `x`, shape (2,), with covariance `P`, shape (2, 2)."""
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.x = np.array(x, dtype=float).reshape(2, 1)
    kalman.P = np.array(P, dtype=float)
    return kalman


def transition(dt_s: float) -> Array:
    """F of a step of `dt_s` seconds."""
    return np.array([[1.0, dt_s], [0.0, 1.0]])


def acceleration_noise(dt_s: float, std_mps2: float) -> Array:
    """Q of a white acceleration that is constant within the step (piecewise Wiener process).

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 6.3.2.
    """
    gain = np.array([[0.5 * dt_s * dt_s], [dt_s]])
    noise: Array = gain @ gain.T * std_mps2**2
    return noise


def update(kalman: KalmanFilter, z: float, H: Array, R: float, gate_sigma: float) -> Verdict:
    """Update with a scalar unless its innovation is beyond `gate_sigma` standard deviations."""
    innovation = z - (H @ kalman.x).item()
    variance = (H @ kalman.P @ H.T).item() + R
    accepted = innovation * innovation <= gate_sigma * gate_sigma * variance
    if accepted:
        kalman.update(z, R=R, H=H)
    return Verdict(innovation, variance, accepted)
