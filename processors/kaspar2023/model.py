"""The 25 states of kaspar2023: how they move, what each sensor would measure, and the derivatives.

State vectors are columns, shape (25, 1), as filterpy has them; angles are those of
docs/theory.md, section 1.2 and their errors add: x_true = x + δx. Every function stands beside its
derivative and is compiled; equation numbers are those of the work. Its slips are corrected:

- Euler rates (3.37) are those of docs/theory.md, section 1.3, not R·ω;
- the right wheel of (3.26) has its own constant b_r;
- the third gyroscope of (4.10) has its own z_b and z_k.

Kept as published: the roll angle does not move (it is 0 in the work), and of process noise (4.16)
the second term lacks its factor T, since all other figures of the work were tuned around it.

References
----------
J. Kašpar, onboard estimation of motion states by multisensor fusion, BSc thesis, CTU Prague, 2023.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from tramstream.estimation.kalman import Array, Pattern, compiled
from tramstream.simulation.imu import ImuErrors, instability_density

STEP_S = 0.01
"""T: process noise and the filter's steps are those of the work's 100 Hz."""


class Ix(IntEnum):
    """Slots of the state vector."""

    EAST = 0  # of the vehicle's origin in l, m
    NORTH = 1
    UP = 2
    SPEED = 3  # along x, m/s
    ACCELERATION = 4  # v̇, m/s²
    ROLL = 5  # rad
    PITCH = 6
    YAW = 7
    RATE_X = 8  # angular rate in v, rad/s
    RATE_Y = 9
    RATE_Z = 10
    ACCEL_SCALE = 11
    GYRO_SCALE_X = 12
    GYRO_SCALE_Y = 13
    GYRO_SCALE_Z = 14
    ACCEL_INSTABILITY = 15  # z_b of the accelerometer along x, m/s²
    ACCEL_WALK = 16  # its z_k, and the constant bias
    GYRO_INSTABILITY_X = 17  # rad/s
    GYRO_INSTABILITY_Y = 18
    GYRO_INSTABILITY_Z = 19
    GYRO_WALK_X = 20
    GYRO_WALK_Y = 21
    GYRO_WALK_Z = 22
    WHEEL_LEFT = 23  # b_l, pulses a message for 1 m/s beyond what the nominal radius gives
    WHEEL_RIGHT = 24


SIZE = len(Ix)

# Prediction ---------------------------------------------------------------------------------------

_ADIS16465 = ImuErrors()
"""With B of docs/theory.md, section 3.9."""
INSTABILITY_S = _ADIS16465.gyro_instability_time_s
"""T_b of z_b; the work gives none, and z_b never left 0."""
INSTABILITIES = (
    Ix.ACCEL_INSTABILITY,
    Ix.GYRO_INSTABILITY_X,
    Ix.GYRO_INSTABILITY_Y,
    Ix.GYRO_INSTABILITY_Z,
)
ENTRIES: tuple[tuple[Ix, Ix], ...] = (
    (Ix.EAST, Ix.SPEED),
    (Ix.EAST, Ix.ACCELERATION),
    (Ix.EAST, Ix.PITCH),
    (Ix.EAST, Ix.YAW),
    (Ix.NORTH, Ix.SPEED),
    (Ix.NORTH, Ix.ACCELERATION),
    (Ix.NORTH, Ix.PITCH),
    (Ix.NORTH, Ix.YAW),
    (Ix.UP, Ix.SPEED),
    (Ix.UP, Ix.ACCELERATION),
    (Ix.UP, Ix.PITCH),
    (Ix.SPEED, Ix.ACCELERATION),
    (Ix.PITCH, Ix.ROLL),
    (Ix.PITCH, Ix.RATE_Y),
    (Ix.PITCH, Ix.RATE_Z),
    (Ix.YAW, Ix.ROLL),
    (Ix.YAW, Ix.PITCH),
    (Ix.YAW, Ix.RATE_Y),
    (Ix.YAW, Ix.RATE_Z),
    *((slot, slot) for slot in INSTABILITIES),
)
"""Where A of the transition F = I + A has entries, in the order of `transition`."""

ROWS = np.array([int(row) for row, _ in ENTRIES])
COLUMNS = np.array([int(column) for _, column in ENTRIES])
PATTERN = Pattern.of(ROWS, COLUMNS)


@compiled
def move(x: Array, dt_s: float) -> None:
    """Move the state on by `dt_s`, in place: p += T C_lv [v + aT/2, 0, 0]ᵀ, v += T a, Θ += T Θ̇."""
    sin_r, cos_r = math.sin(x[Ix.ROLL, 0]), math.cos(x[Ix.ROLL, 0])
    sin_p, cos_p = math.sin(x[Ix.PITCH, 0]), math.cos(x[Ix.PITCH, 0])
    rate_y, rate_z = x[Ix.RATE_Y, 0], x[Ix.RATE_Z, 0]
    way = dt_s * (x[Ix.SPEED, 0] + 0.5 * dt_s * x[Ix.ACCELERATION, 0])
    x[Ix.EAST, 0] += way * cos_p * math.cos(x[Ix.YAW, 0])
    x[Ix.NORTH, 0] += way * cos_p * math.sin(x[Ix.YAW, 0])
    x[Ix.UP, 0] -= way * sin_p
    x[Ix.SPEED, 0] += dt_s * x[Ix.ACCELERATION, 0]
    x[Ix.PITCH, 0] += dt_s * (cos_r * rate_y - sin_r * rate_z)
    x[Ix.YAW, 0] += dt_s * (sin_r * rate_y + cos_r * rate_z) / cos_p
    keep = math.exp(-dt_s / INSTABILITY_S)
    for slot in INSTABILITIES:
        x[slot, 0] *= keep


@compiled
def transition(x: Array, dt_s: float, values: Array) -> None:
    """Fill `values` with the entries of A at `ENTRIES`: what `move` does to small deviations."""
    sin_r, cos_r = math.sin(x[Ix.ROLL, 0]), math.cos(x[Ix.ROLL, 0])
    sin_p, cos_p = math.sin(x[Ix.PITCH, 0]), math.cos(x[Ix.PITCH, 0])
    sin_y, cos_y = math.sin(x[Ix.YAW, 0]), math.cos(x[Ix.YAW, 0])
    rate_y, rate_z = x[Ix.RATE_Y, 0], x[Ix.RATE_Z, 0]
    turning, nodding = sin_r * rate_y + cos_r * rate_z, cos_r * rate_y - sin_r * rate_z
    way = dt_s * (x[Ix.SPEED, 0] + 0.5 * dt_s * x[Ix.ACCELERATION, 0])
    half = 0.5 * dt_s * dt_s
    values[0], values[1] = dt_s * cos_p * cos_y, half * cos_p * cos_y
    values[2], values[3] = -way * sin_p * cos_y, -way * cos_p * sin_y
    values[4], values[5] = dt_s * cos_p * sin_y, half * cos_p * sin_y
    values[6], values[7] = -way * sin_p * sin_y, way * cos_p * cos_y
    values[8], values[9], values[10] = -dt_s * sin_p, -half * sin_p, -way * cos_p
    values[11] = dt_s
    values[12], values[13], values[14] = -dt_s * turning, dt_s * cos_r, -dt_s * sin_r
    values[15], values[16] = dt_s * nodding / cos_p, dt_s * turning * sin_p / cos_p**2
    values[17], values[18] = dt_s * sin_r / cos_p, dt_s * cos_r / cos_p
    values[19:23] = math.expm1(-dt_s / INSTABILITY_S)


# Measurements -------------------------------------------------------------------------------------


@compiled
def antenna(x: Array, p_va_v: Array, age_s: float) -> Array:
    """Position of the antenna in `l` so long before the state's instant, shape (3, 1).

    p + C_lv (p_va − [v·age, 0, 0]ᵀ); in the work lever arm and age are 0.

    Parameters
    ----------
    x : ndarray, shape (25, 1)
    p_va_v : ndarray, shape (3,)
        Lever arm, m.
    age_s : float
        At most a step: acceleration and turning on the way are left out.
    """
    sin_r, cos_r = math.sin(x[Ix.ROLL, 0]), math.cos(x[Ix.ROLL, 0])
    sin_p, cos_p = math.sin(x[Ix.PITCH, 0]), math.cos(x[Ix.PITCH, 0])
    sin_y, cos_y = math.sin(x[Ix.YAW, 0]), math.cos(x[Ix.YAW, 0])
    a, b, c = p_va_v[0] - x[Ix.SPEED, 0] * age_s, p_va_v[1], p_va_v[2]
    # Level components along and to the left of the yaw direction.
    along = cos_p * a + sin_p * (sin_r * b + cos_r * c)
    left = cos_r * b - sin_r * c
    h = np.empty((3, 1))
    h[0, 0] = x[Ix.EAST, 0] + cos_y * along - sin_y * left
    h[1, 0] = x[Ix.NORTH, 0] + sin_y * along + cos_y * left
    h[2, 0] = x[Ix.UP, 0] - sin_p * a + cos_p * (sin_r * b + cos_r * c)
    return h


@compiled
def antenna_jacobian(x: Array, p_va_v: Array, age_s: float) -> Array:
    """H of `antenna`, shape (3, 25)."""
    sin_r, cos_r = math.sin(x[Ix.ROLL, 0]), math.cos(x[Ix.ROLL, 0])
    sin_p, cos_p = math.sin(x[Ix.PITCH, 0]), math.cos(x[Ix.PITCH, 0])
    sin_y, cos_y = math.sin(x[Ix.YAW, 0]), math.cos(x[Ix.YAW, 0])
    a, b, c = p_va_v[0] - x[Ix.SPEED, 0] * age_s, p_va_v[1], p_va_v[2]
    raised, left = sin_r * b + cos_r * c, cos_r * b - sin_r * c
    along, up = cos_p * a + sin_p * raised, cos_p * raised - sin_p * a
    H = np.zeros((3, SIZE))
    H[0, Ix.EAST] = H[1, Ix.NORTH] = H[2, Ix.UP] = 1.0
    H[0, Ix.SPEED], H[1, Ix.SPEED] = -age_s * cos_p * cos_y, -age_s * cos_p * sin_y
    H[2, Ix.SPEED] = age_s * sin_p
    H[0, Ix.ROLL] = cos_y * sin_p * left + sin_y * raised
    H[1, Ix.ROLL] = sin_y * sin_p * left - cos_y * raised
    H[2, Ix.ROLL] = cos_p * left
    H[0, Ix.PITCH], H[1, Ix.PITCH] = cos_y * up, sin_y * up
    H[2, Ix.PITCH] = -along
    H[0, Ix.YAW], H[1, Ix.YAW] = -sin_y * along - cos_y * left, cos_y * along - sin_y * left
    return H


INERTIAL = ("accel_x", "gyro_x", "gyro_y", "gyro_z")
"""Rows of `inertial`."""


@compiled
def inertial(x: Array, gravity_mps2: float) -> Array:
    """Accelerometer along x (3.22) and the three gyroscopes (4.10), shape (4, 1); m/s², rad/s.

    f_x = (1 + s) v̇ + z_b + z_k − g sinθ; ω = (1 + s) ω_v + z_b + z_k on each axis.
    """
    h = np.empty((4, 1))
    h[0, 0] = (
        (1.0 + x[Ix.ACCEL_SCALE, 0]) * x[Ix.ACCELERATION, 0]
        + x[Ix.ACCEL_INSTABILITY, 0]
        + x[Ix.ACCEL_WALK, 0]
        - gravity_mps2 * math.sin(x[Ix.PITCH, 0])
    )
    for axis in range(3):
        h[1 + axis, 0] = (
            (1.0 + x[Ix.GYRO_SCALE_X + axis, 0]) * x[Ix.RATE_X + axis, 0]
            + x[Ix.GYRO_INSTABILITY_X + axis, 0]
            + x[Ix.GYRO_WALK_X + axis, 0]
        )
    return h


@compiled
def inertial_jacobian(x: Array, gravity_mps2: float) -> Array:
    """H of `inertial`, shape (4, 25)."""
    H = np.zeros((4, SIZE))
    H[0, Ix.ACCELERATION] = 1.0 + x[Ix.ACCEL_SCALE, 0]
    H[0, Ix.ACCEL_SCALE] = x[Ix.ACCELERATION, 0]
    H[0, Ix.ACCEL_INSTABILITY] = H[0, Ix.ACCEL_WALK] = 1.0
    H[0, Ix.PITCH] = -gravity_mps2 * math.cos(x[Ix.PITCH, 0])
    for axis in range(3):
        H[1 + axis, Ix.RATE_X + axis] = 1.0 + x[Ix.GYRO_SCALE_X + axis, 0]
        H[1 + axis, Ix.GYRO_SCALE_X + axis] = x[Ix.RATE_X + axis, 0]
        H[1 + axis, Ix.GYRO_INSTABILITY_X + axis] = H[1 + axis, Ix.GYRO_WALK_X + axis] = 1.0
    return H


@compiled
def take_reading(x: Array, z: Array, gravity_mps2: float) -> None:
    """Set acceleration and rates, in place, so that `inertial` gives `z`, shape (4,)."""
    error = x[Ix.ACCEL_INSTABILITY, 0] + x[Ix.ACCEL_WALK, 0]
    error -= gravity_mps2 * math.sin(x[Ix.PITCH, 0])
    x[Ix.ACCELERATION, 0] = (z[0] - error) / (1.0 + x[Ix.ACCEL_SCALE, 0])
    for axis in range(3):
        error = x[Ix.GYRO_INSTABILITY_X + axis, 0] + x[Ix.GYRO_WALK_X + axis, 0]
        rate = (z[1 + axis] - error) / (1.0 + x[Ix.GYRO_SCALE_X + axis, 0])
        x[Ix.RATE_X + axis, 0] = rate


@compiled
def wheels(x: Array, k: float, half_track_m: float) -> Array:
    """Pulses a message of both wheels (3.25) and (3.26), shape (2, 1).

    c_l = (v − ω_z l/2)(k + b_l), c_r = (v + ω_z l/2)(k + b_r): speed and rate of the instant.

    Parameters
    ----------
    x : ndarray, shape (25, 1)
    k : float
        Pulses a message for 1 m/s with the nominal radius.
    half_track_m : float
        l/2.
    """
    speed, turning = x[Ix.SPEED, 0], x[Ix.RATE_Z, 0] * half_track_m
    h = np.empty((2, 1))
    h[0, 0] = (speed - turning) * (k + x[Ix.WHEEL_LEFT, 0])
    h[1, 0] = (speed + turning) * (k + x[Ix.WHEEL_RIGHT, 0])
    return h


@compiled
def wheels_jacobian(x: Array, k: float, half_track_m: float) -> Array:
    """H of `wheels`, shape (2, 25)."""
    speed, turning = x[Ix.SPEED, 0], x[Ix.RATE_Z, 0] * half_track_m
    left, right = k + x[Ix.WHEEL_LEFT, 0], k + x[Ix.WHEEL_RIGHT, 0]
    H = np.zeros((2, SIZE))
    H[0, Ix.SPEED], H[0, Ix.RATE_Z] = left, -half_track_m * left
    H[1, Ix.SPEED], H[1, Ix.RATE_Z] = right, half_track_m * right
    H[0, Ix.WHEEL_LEFT], H[1, Ix.WHEEL_RIGHT] = speed - turning, speed + turning
    return H


@compiled
def one_wheel(x: Array, k: float) -> Array:
    """Pulses a message of a single wheel, shape (1, 1): without the turning term, with b_l."""
    h = np.empty((1, 1))
    h[0, 0] = x[Ix.SPEED, 0] * (k + x[Ix.WHEEL_LEFT, 0])
    return h


@compiled
def one_wheel_jacobian(x: Array, k: float) -> Array:
    """H of `one_wheel`, shape (1, 25)."""
    H = np.zeros((1, SIZE))
    H[0, Ix.SPEED] = k + x[Ix.WHEEL_LEFT, 0]
    H[0, Ix.WHEEL_LEFT] = x[Ix.SPEED, 0]
    return H


# Noise --------------------------------------------------------------------------------------------

JERK_MPS3 = 4.0
"""j_max."""
CURVE_SPEED_MPS = 4.2
"""v_max in a curve of R_min = 20 m; together they turn by 0.21 rad/s."""
TURN_RADPS = 0.21
LARGE_ACCELERATION_MPS2 = 1.0
"""Acceleration and rates may be anything at the next step: the work calls their noise large, for
they are measured each step."""
LARGE_RATE_RADPS = 1.0
NEARLY_NOTHING = 1e-8
"""Deviation that a constant gains in a step, in its own unit: the work's near zero."""


def process_noise(accel_walk_mps3_rthz: float, gyro_walk_radps2_rthz: float) -> Array:
    """Q of one step of `STEP_S`, shape (25, 25); docs/theory.md, section 8.4.

    Parameters
    ----------
    accel_walk_mps3_rthz, gyro_walk_radps2_rthz : float
        K of the random walks z_k.
    """
    T = STEP_S
    std = np.full(SIZE, NEARLY_NOTHING)
    reach = JERK_MPS3 * T**3 / 6.0 + CURVE_SPEED_MPS * math.sin(TURN_RADPS * T)
    std[[Ix.EAST, Ix.NORTH, Ix.UP]] = reach / 2.0
    std[Ix.SPEED] = JERK_MPS3 * T**2 / 2.0 / 2.0
    std[Ix.ACCELERATION] = LARGE_ACCELERATION_MPS2
    std[Ix.ROLL] = 0.0
    std[Ix.YAW] = TURN_RADPS * T / 2.0
    std[[Ix.RATE_X, Ix.RATE_Y, Ix.RATE_Z]] = LARGE_RATE_RADPS
    accel, gyro = (
        instability_density(B, INSTABILITY_S)
        for B in (_ADIS16465.accel_instability_mps2, _ADIS16465.gyro_instability_radps)
    )
    std[Ix.ACCEL_INSTABILITY] = math.sqrt(accel * T)
    std[Ix.GYRO_INSTABILITY_X : Ix.GYRO_INSTABILITY_Z + 1] = math.sqrt(gyro * T)
    std[Ix.ACCEL_WALK] = accel_walk_mps3_rthz * math.sqrt(T)
    std[Ix.GYRO_WALK_X : Ix.GYRO_WALK_Z + 1] = gyro_walk_radps2_rthz * math.sqrt(T)
    return np.diag(std**2)
