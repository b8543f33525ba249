"""Errors of fixes as a first-order Gauss-Markov process makes them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def drawn(seed: int, std_m: float, tau_s: float, duration_s: float, rate_hz: float = 1.0) -> Array:
    """Errors to the east and the north, (n, 2)."""
    rng = np.random.default_rng(seed)
    keep = math.exp(-1.0 / (rate_hz * tau_s))
    error, errors = rng.normal(0.0, std_m, 2), []
    for _ in range(round(duration_s * rate_hz)):
        error = keep * error + rng.normal(0.0, std_m * math.sqrt(1.0 - keep**2), 2)
        errors.append(error)
    return np.array(errors)
