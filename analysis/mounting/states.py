"""States of the aligner's smoother, its noise, and the point at which it is linearised.

An error of attitude, θ, turns local components: C_lb(true) = Exp(θ) C_lb. An error of the mounting,
m, turns vehicle components: C_vb(true) = Exp(m) C_vb. Neither has a singularity anywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POSITION = 0
"""First of three slots, as those below where they are three."""
VELOCITY = 3
ATTITUDE = 6
ACCEL_BIAS = 9
GYRO_BIAS = 12
MOUNTING = 15
FIX_ERROR = 18
"""What neighbouring fixes share of their error, in `l`."""
CROSS_LEVEL = 21
"""Roll of the track under the vehicle."""
WHEEL_SCALE = 22
PIVOT = 23
"""How much farther behind the IMU the point is that does not slip sideways."""
DELAY = 24
"""How much later than its stamp a fix is true."""
SIZE = 25


class Noise(NamedTuple):
    """What drives the states, and what the constraints are good to."""

    accel: Array
    """(3,): N of each axis of the case, m/s²/√Hz."""
    gyro: Array
    """(3,): rad/s/√Hz."""
    accel_walk: float
    """K, m/s³/√Hz."""
    gyro_walk: float
    """rad/s²/√Hz."""
    fix_error_m: Array
    """(3,): stationary deviation of what neighbouring fixes share."""
    fix_error_tau_s: float
    cross_level_rad: float
    """Stationary deviation of the track's roll."""
    cross_level_m: float
    """Way after which 1/e of it is left."""
    side_mps: float
    """Deviation of the speed to the side at one node."""
    up_mps: float
    """Deviation of the speed upwards at one node."""
    roll_rad: float
    """Deviation of the body's roll against the track's at one node."""
    lean_rad_per_mps2: float
    """The same a lateral acceleration: springs, and cant that a curve has."""
    still_mps: float
    """Deviation of the speed at a node at which the vehicle stands."""


class Prior(NamedTuple):
    """Deviations at the first node; of what is not named here nothing is known."""

    accel_bias_mps2: float
    gyro_bias_radps: float
    wheel_scale: float
    pivot_m: float
    delay_s: float


class Arms(NamedTuple):
    """Where things are, from the IMU, in vehicle axes."""

    antenna_m: Array
    """(3,)."""
    pivot_m: Array
    """(3,): the point that does not slip sideways."""


class Point(NamedTuple):
    """Where the model is linearised; (n, …) a row a node."""

    p_l: Array
    vel_l: Array
    C_lb: Array
    accel_bias: Array
    gyro_bias: Array
    fix_error: Array
    cross_level: Array
    C_vb: Array
    """(3, 3)."""
    constants: Array
    """(3,): wheel scale, pivot, delay."""


def prior_covariance(prior: Prior, noise: Noise) -> Array:
    """P at the first node; what nothing is known of is as wide as makes no difference."""
    P = np.zeros((SIZE, SIZE))
    variances = {
        POSITION: np.full(3, 1e6),
        VELOCITY: np.full(3, 1e4),
        ATTITUDE: np.full(3, 1e2),
        ACCEL_BIAS: np.full(3, prior.accel_bias_mps2**2),
        GYRO_BIAS: np.full(3, prior.gyro_bias_radps**2),
        MOUNTING: np.full(3, 1e2),
        FIX_ERROR: noise.fix_error_m**2,
        CROSS_LEVEL: np.array([noise.cross_level_rad**2]),
        WHEEL_SCALE: np.array([prior.wheel_scale**2]),
        PIVOT: np.array([prior.pivot_m**2]),
        DELAY: np.array([prior.delay_s**2]),
    }
    for first, values in variances.items():
        for offset, value in enumerate(values):
            P[first + offset, first + offset] = value
    return P
