"""What goes into the model `tram` and what comes out, compiled: axes of the case, the origin.

Inside, positions are the pivot's and inertial readings lie in the vehicle's axes.

Equations: docs/theory.md, sections 5.2 and 5.5.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.estimation import localiser
from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.localiser import ACCELERATION, YAW_RATE
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.motion import COVARIANCE, STATE, slots
from tramstream.processors.tram.states import SIZE, Ix, Pm
from tramstream.proto.sync_pb2 import ImuMean

FASTEST_RADPS = 4.0
HARDEST_MPS2 = 60.0
"""No vehicle turns faster or is pushed harder; a reading beyond is none."""
SMOOTHING_S = 0.1
"""Of the angular rates, for their derivative."""
STEADY_S = 0.5
"""Of the rates that a row of H is made of."""
SHAKING_S = 0.3
"""Of what neighbouring rates differ by: a pothole is over after so long."""
_OF_MOTION = localiser.COVARIANCE
_MOVED = slots(Ix.SPEED, Ix.YAW, Ix.GNSS_DELAY, Ix.PIVOT)


def reading(mean: ImuMean) -> tuple[float, float, float, float, float, float]:
    """Give the numbers of a mean in the order in which `read` takes them."""
    return (
        mean.gyro_x_radps,
        mean.gyro_y_radps,
        mean.gyro_z_radps,
        mean.accel_x_mps2,
        mean.accel_y_mps2,
        mean.accel_z_mps2,
    )


@compiled
def read(
    inputs: Array,
    C_vb: Array,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    dt: float,
) -> bool:
    """Turn a reading of the case into the vehicle's axes, and remember the one before.

    One that cannot be changes nothing: then False.

    Parameters
    ----------
    inputs : ndarray, shape (4, 10)
        Rows for `move`: the reading before, this one, and their mean: what acts between them; then
        the smoothed rates that angular acceleration is told from, the variance of a rate that the
        difference of neighbouring ones shows, and the steady rates up to the reading before.
    C_vb : ndarray, shape (3, 3)
    dt : float
        Between the two readings, s; 0 if there is none before.
    """
    # Comparisons with what is no number are false.
    turns = abs(gx) + abs(gy) + abs(gz) < FASTEST_RADPS
    if not (turns and abs(ax) + abs(ay) + abs(az) < HARDEST_MPS2):
        return False
    for k in range(10):
        inputs[0, k] = inputs[1, k]
    for i in range(3):
        inputs[1, i] = C_vb[i, 0] * gx + C_vb[i, 1] * gy + C_vb[i, 2] * gz
        inputs[1, 3 + i] = C_vb[i, 0] * ax + C_vb[i, 1] * ay + C_vb[i, 2] * az
        inputs[1, 6 + i] = 0.0
    inputs[1, 9] = 1.0
    if dt <= 0.0:
        for k in range(10):
            inputs[0, k] = inputs[3, k] = inputs[1, k]
        for k in range(3):
            inputs[3, 3 + k], inputs[3, 6 + k] = 0.0, inputs[1, k]
    for k in range(6):
        inputs[2, k] = 0.5 * (inputs[0, k] + inputs[1, k])
    for k in range(3):
        # The difference of two readings would be mostly noise, ten times a lever's worth.
        rising = (inputs[2, k] - inputs[3, k]) / SMOOTHING_S
        inputs[3, k] += dt * rising
        inputs[1, 6 + k] = inputs[2, 6 + k] = rising
        apart = inputs[1, k] - inputs[0, k]
        inputs[3, 6 + k] += min(1.0, dt / STEADY_S) * (inputs[0, k] - inputs[3, 6 + k])
        inputs[3, 3 + k] += min(1.0, dt / SHAKING_S) * (0.5 * apart * apart - inputs[3, 3 + k])
    inputs[2, 9] = 1.0
    return True


@compiled
def origin(m: Array, share: float, motion: Array, covariance: Array) -> None:
    """Give motion and covariance of the vehicle's origin at the true time of the stamp.

    The filter's own position is the pivot's, at the time that the inertial stamps mean: `share` of
    the fixes' delay is theirs.

    Parameters
    ----------
    motion : ndarray, shape (7,)
        Gets the states EAST to YAW.
    covariance : ndarray, shape (7, 7)
    """
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    for i in range(7):
        motion[i] = x[i]
        for j in range(7):
            covariance[i, j] = P[i, j]
    pivot, early = x[Ix.PIVOT], share * x[Ix.GNSS_DELAY]
    if pivot == 0.0 and share == 0.0:
        return
    cos, sin = math.cos(x[Ix.YAW]), math.sin(x[Ix.YAW])
    v = x[Ix.SPEED]
    ahead = pivot - early * v
    motion[0] += ahead * cos
    motion[1] += ahead * sin
    # Rows of T beside the unit: of east and north, by speed, yaw, delay and pivot.
    T = np.zeros((2, 4))
    T[0, 0], T[0, 1], T[0, 2], T[0, 3] = -early * cos, -ahead * sin, -share * v * cos, cos
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = -early * sin, ahead * cos, -share * v * sin, sin
    for a in range(2):
        for j in range(7):
            moved = 0.0
            for k in range(4):
                moved += T[a, k] * P[_MOVED[k], j]
            covariance[a, j] += moved
            if j > 1:
                covariance[j, a] += moved
    for a in range(2):
        for b in range(2):
            moved = 0.0
            for k in range(4):
                moved += P[a, _MOVED[k]] * T[b, k]
                for j in range(4):
                    moved += T[a, k] * P[_MOVED[k], _MOVED[j]] * T[b, j]
            covariance[a, b] += moved


@compiled
def say(m: Array, c: Array, facing: bool, values: Array) -> None:
    """Fill the values of an estimate (`estimation.localiser`) out of the filter's memory.

    Parameters
    ----------
    facing : bool
        Whether the heading is known; the stamp's true time says nothing of the place without one.
    """
    share = c[Pm.CLOCK_SHARE] if facing else 0.0
    origin(m, share, values[:ACCELERATION], values[_OF_MOTION:].reshape((7, 7)))
    values[ACCELERATION], values[YAW_RATE] = m[kernels.ACCELERATION], m[kernels.YAW_RATE]
