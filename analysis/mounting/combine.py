"""Several rides of one mounting: their information added, and whether they say the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


class One(NamedTuple):
    """What one ride says."""

    C_vb: Array
    covariance: Array
    """(3, 3), of a turn about the vehicle's axes."""


class Together(NamedTuple):
    """What all say."""

    C_vb: Array
    covariance: Array
    off_rad: Array
    """(rides, 3): from the common mounting to that of each."""
    chance: float
    """Of rides that differ as much or more if the mounting is one; 1 of a single ride."""


def turn_between(C_vb: Array, other: Array) -> Array:
    """The turn from one mounting to another, about the vehicle's axes."""
    found: Array = Rotation.from_matrix(other @ C_vb.T).as_rotvec()
    return found


def together(rides: Sequence[One]) -> Together:
    """Add information; a turn's mean is taken where all are small."""
    weights = [np.linalg.inv(each.covariance) for each in rides]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    best = min(rides, key=lambda each: float(np.trace(each.covariance)))
    C_vb = best.C_vb
    for _ in range(5):
        pulls = [
            weight @ turn_between(C_vb, each.C_vb)
            for weight, each in zip(weights, rides, strict=True)
        ]
        C_vb = Rotation.from_rotvec(covariance @ np.sum(pulls, axis=0)).as_matrix() @ C_vb
    off = np.array([turn_between(C_vb, each.C_vb) for each in rides])
    chi2 = sum(float(o @ weight @ o) for o, weight in zip(off, weights, strict=True))
    freedom = 3 * (len(rides) - 1)
    chance = float(stats.chi2.sf(chi2, freedom)) if freedom else 1.0
    return Together(C_vb, covariance, off, chance)
