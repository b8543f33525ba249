"""What no estimator of these rides can do better: a posterior Cramér-Rao bound of the slope.

It is non-causal: a slope is estimated from what is measured before and behind. Given are

- the profile's own statistics: the covariance of slopes σ² exp(−d²/(4 s²)) of a ground whose
  slope is white and which a Gaussian of deviation s has smoothed, with the σ of this profile's
  slopes, and the s that their change along the way has: σ²/(2 s²) is its mean square;
- the true speed of every ride, which an estimator must find as well.

The measurements are those of `fusion`: heights with white noise (whose level, the same for all, is
unknown) and the slope of each cell with the noise of the speed's walk. All is linear and Gaussian
then: J = K⁻¹ + Σ of the rides' information, and the bound is the root of the mean of diag J⁻¹. It
is Wiener's non-causal filter for these spectra, with the ends of the route taken into account.

Equations: docs/chladek2023.md.

References
----------
H. L. Van Trees, Detection, Estimation, and Modulation Theory, part I, Wiley 1968, section 2.4.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from tramstream.analysis.chladek2023.ride import (
    CELL_M,
    GRAVITY_MPS2,
    HEIGHT_STD_M,
    SPEED_WALK_MPS,
    Array,
    Profile,
    Rides,
)

CELLS = 4
"""Cells that are one here: 10 m of a profile whose detail is some 100 m."""
JITTER = 1e-9
"""Of the covariance's diagonal: smooth kernels are singular to the machine."""


class Ground(NamedTuple):
    """Statistics of a profile's slopes."""

    std_rad: float
    smooth_m: float
    """Deviation of the Gaussian that has smoothed it."""

    def covariance(self, apart_m: Array) -> Array:
        shared: Array = self.std_rad**2 * np.exp(-(apart_m**2) / (4.0 * self.smooth_m**2))
        return shared


def ground_of(profile: Profile) -> Ground:
    """What a profile itself shows."""
    std = float(np.sqrt(np.mean(profile.grade_rad**2)))
    change = np.diff(profile.grade_rad) / np.diff(profile.way_m)
    return Ground(std, std / float(np.sqrt(2.0 * np.mean(change**2))))


def bound_rad(ground: Ground, rides: Rides) -> float:
    """Least root mean square error of the slope that these rides together allow."""
    cells = rides.force_n.shape[1] // CELLS
    middle_m = (np.arange(cells) + 0.5) * CELLS * CELL_M
    K = ground.covariance(middle_m[:, None] - middle_m[None, :])
    J = of_heights(cells, len(rides.force_n)) + np.diag(of_speeds(rides, cells))
    L = cholesky(K + JITTER * ground.std_rad**2 * np.eye(cells), lower=True)
    inner = cholesky(np.eye(cells) + L.T @ J @ L, lower=True)
    root = solve_triangular(inner, L.T, lower=True)
    return float(np.sqrt(np.mean(np.sum(root**2, axis=0))))


def of_heights(cells: int, rides: int) -> Array:
    """Information on the slopes from heights at the cells' edges, their level being free."""
    below = np.tril(np.ones((cells + 1, cells)), -1) * CELLS * CELL_M
    below -= below.mean(axis=0)
    information: Array = below.T @ below * (rides * CELLS / HEIGHT_STD_M**2)
    return information


def of_speeds(rides: Rides, cells: int) -> Array:
    """Information on the slope of each cell from the steps of the measured speeds, (cells,)."""
    speed = (rides.speed_mps[:, 1:] + rides.speed_mps[:, :-1]) / 2
    std = speed * SPEED_WALK_MPS / (GRAVITY_MPS2 * CELL_M)
    single = np.sum(1.0 / std**2, axis=0)[: cells * CELLS]
    information: Array = single.reshape(cells, CELLS).sum(axis=1)
    return information


def wiener_rad(ground: Ground, speed_mps: float, rides: int) -> float:
    """The same of a route without ends at one speed: Wiener's integral over all wavelengths."""
    density = ground.std_rad**2 * np.sqrt(4.0 * np.pi) * ground.smooth_m
    per_m = np.linspace(0.0, 8.0 / ground.smooth_m, 20_001)[1:]
    prior = density * np.exp(-((per_m * ground.smooth_m) ** 2))
    of_height = 1.0 / (HEIGHT_STD_M**2 * CELL_M * per_m**2)
    of_speed = CELL_M / (speed_mps * SPEED_WALK_MPS / GRAVITY_MPS2) ** 2
    left = 1.0 / (1.0 / prior + rides * (of_height + of_speed))
    return float(np.sqrt(np.sum(left) * (per_m[1] - per_m[0]) / np.pi))
