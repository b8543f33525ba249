"""Noise of one inertial axis: white noise, bias instability, random walk, and what of it shows.

The model is that of docs/theory.md, section 3.1. A quantity of a gyroscope is in rad/s, of an
accelerometer in m/s²; nothing here depends on which.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

NAMES = ("N", "B", "T_b", "K")
FLAT = math.sqrt(math.pi * 0.4365**2 / math.log(2))
"""B over the stationary deviation of the Gauss-Markov process, which follows from S_b."""
_SUMMED = 200_000
"""Frequencies of a record that are summed one by one; what lies above them is integrated."""


class Noise(NamedTuple):
    """Coefficients of one axis; zero where there is none of a kind."""

    white: float
    """N, of the quantity over √Hz."""
    instability: float = 0.0
    """B, of the quantity."""
    time_s: float = 100.0
    """T_b."""
    walk: float = 0.0
    """K, of the quantity times √Hz (over s · √Hz)."""

    @property
    def stationary_std(self) -> float:
        """Deviation of the Gauss-Markov process that B and T_b stand for."""
        return self.instability / FLAT

    @property
    def drive(self) -> float:
        """√S_b: what drives that process; it walks so for times well below T_b."""
        return self.stationary_std * math.sqrt(2 / self.time_s)

    def allan_variance(self, tau_s: ArrayLike) -> Array:
        """σ²(τ) that the model expects.

        References
        ----------
        IEEE Std 952-1997, annex C: white noise, first-order Gauss-Markov process, random walk.
        """
        tau = np.asarray(tau_s, dtype=float)
        found: Array = self.white**2 / tau + self.walk**2 * tau / 3
        if self.instability > 0:
            found = found + self.stationary_std**2 * gauss_markov(tau / self.time_s)
        return found

    def density(self, frequency_hz: ArrayLike) -> Array:
        """Two-sided power spectral density S(f)."""
        omega = 2 * math.pi * np.asarray(frequency_hz, dtype=float)
        drive = self.drive**2 if self.instability > 0 else 0.0
        found: Array = self.white**2 + self.walk**2 / omega**2
        return found + drive / (self.time_s**-2 + omega**2)


def gauss_markov(x: Array) -> Array:
    """Allan variance of a first-order Gauss-Markov process of variance 1 at τ = x T_b."""
    near = x < 1e-3
    safe = np.where(near, 1.0, x)
    full = (2 * safe - 3 + 4 * np.exp(-safe) - np.exp(-2 * safe)) / safe**2
    found: Array = np.where(near, 2 * x / 3 - x**2 / 2, full)
    return found


def whittle_bound(noise: Noise, duration_s: float, rate_hz: float) -> dict[str, float]:
    """Least relative deviation of each coefficient that a record of this length allows.

    Each frequency j/T of the periodogram adds ∂ln S/∂ln θ_i · ∂ln S/∂ln θ_j to the information on
    the logarithms of the coefficients: they are estimated together, each costs the others.
    Coefficients that are 0 are taken to be known to be 0.

    References
    ----------
    P. Whittle, Estimation and information in stationary time series, Arkiv för Matematik 2, 1953.
    """
    count = int(duration_s * rate_hz / 2)
    frequency = np.arange(1, min(count, _SUMMED) + 1) / duration_s
    weight = np.ones(len(frequency))
    if count > _SUMMED:
        edges = np.geomspace(_SUMMED + 0.5, count + 0.5, 4000)
        frequency = np.append(frequency, np.sqrt(edges[1:] * edges[:-1]) / duration_s)
        weight = np.append(weight, np.diff(edges))
    omega = 2 * math.pi * frequency
    whole = noise.density(frequency)
    slopes = {"N": 2 * noise.white**2 / whole}
    if noise.instability > 0:
        unstable = noise.drive**2 / (noise.time_s**-2 + omega**2)
        slopes["B"] = 2 * unstable / whole
        held = noise.time_s**-2 / (noise.time_s**-2 + omega**2)
        slopes["T_b"] = unstable * (2 * held - 1) / whole
    if noise.walk > 0:
        slopes["K"] = 2 * noise.walk**2 / omega**2 / whole
    rows = np.stack(list(slopes.values()))
    covariance = np.linalg.pinv(rows * weight @ rows.T, hermitian=True)
    std = np.sqrt(np.diag(covariance))
    return dict(zip(slopes, std.tolist(), strict=True))
