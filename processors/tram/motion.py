"""The model `tram`, compiled: motion of the vehicle and what each sensor would measure.

The vehicle moves along its own x axis: ṗ = C_lv [v 0 0]ᵀ (no side slip, no jumping). Specific
force along x drives v, the angular rates drive the attitude, and both are inputs, not states: a
step costs one prediction. Correlations that this brings are kept: the noise of the vertical
gyroscope turns
the heading and the paths of the two wheels together, which is how the wheels hold the heading.

Where the vertical specific force is used (a car's, whose gyroscopes err at every jolt), the speed
along z is a state: ẇ = f_z − g cosθ cosφ + v ω_y, and zero in the mean, for springs only bounce. A
false step of the pitch shows in it within a second, long before its gravity does in v. An error of
the pitch gyroscope goes into both together, as that of the vertical one into heading and paths.

All functions work on one block of memory, so that a call from Python costs a fraction of a
microsecond: x, P, two scratch areas (`views`). Equations are those of docs/theory.md, sections 1.3,
1.4 and 5.2, with the up direction of the place, u = [E/r, N/r, 1] in the tangent plane of the
origin (r: Earth's radius).
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.estimation.kalman import Array, Indices, compiled, predict_covariance, update_scalar
from tramstream.processors.tram.states import COLUMNS, ENTRIES, ROWS, SIZE, Ix, Pm

ENTRY_COUNT = len(ENTRIES)
WITHOUT_HEAVE = ENTRY_COUNT - 5
"""Entries of A that are not always 0 where the vertical force is not used."""
ROW_LENGTH = 10
"""Most entries of a row of H."""
MOST_SCALARS = 5
"""That one call takes: of a vehicle that stands."""
_W = SIZE + SIZE * SIZE
_K = _W + SIZE * SIZE
_A = _K + MOST_SCALARS * SIZE
_H = _A + ENTRY_COUNT
_COLUMNS = _H + MOST_SCALARS * ROW_LENGTH
_SEEN = _COLUMNS + MOST_SCALARS * ROW_LENGTH
TAKEN = _SEEN + MOST_SCALARS * 3
"""How many scalars the last call took or refused; the rest of it is for a smoother (`note`)."""
ACCELERATION = TAKEN + 1
"""Where `predict` leaves v̇, m/s²."""
YAW_RATE = ACCELERATION + 1
"""Where it leaves ψ̇, rad/s."""
MEMORY = YAW_RATE + 1
STATE = slice(0, SIZE)
COVARIANCE = slice(SIZE, _W)
SCRATCH = slice(_W, _K)
GAIN = slice(_K, _K + SIZE)
ENTRY_VALUES = slice(_A, _H)
H_COLUMNS = slice(_COLUMNS, _SEEN)
SEEN = slice(_SEEN, TAKEN)
"""Innovation, S (negative: refused) and the number of entries of H, scalar by scalar."""


def slots(*names: Ix) -> Indices:
    """Columns of a row of H."""
    return np.array([int(slot) for slot in names], dtype=np.int64)


@compiled
def row(m: Array, k: int) -> Array:
    """Where a call puts the row of H of its scalar number `k`."""
    return m[_H + k * ROW_LENGTH : _H + (k + 1) * ROW_LENGTH]


@compiled
def gain(m: Array, k: int) -> Array:
    """Where its gain lies."""
    return m[_K + k * SIZE : _K + (k + 1) * SIZE]


@compiled
def note(m: Array, k: int, columns: Indices, count: int, y: float, S: float) -> None:
    """Leave in memory what a smoother wants to know of scalar number `k`."""
    m[_SEEN + 3 * k], m[_SEEN + 3 * k + 1], m[_SEEN + 3 * k + 2] = y, S, count
    for i in range(count):
        m[_COLUMNS + k * ROW_LENGTH + i] = columns[i]
    m[TAKEN] = k + 1


@compiled
def take(
    m: Array, k: int, columns: Indices, count: int, y: float, variance: float, gate: float
) -> float:
    """Take scalar number `k` of a call, its row of H being in place; see `update_scalar`."""
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    S = update_scalar(x, P, columns, row(m, k), count, y, variance, gate, gain(m, k))
    note(m, k, columns, count, y, S)
    return S


@compiled
def rates(x: Array, u: Array) -> tuple[float, float, float]:
    """Angular rate of the vehicle out of the gyroscopes' reading, resolved in v, rad/s."""
    a, b = u[0] - x[Ix.GYRO_X], u[1] - x[Ix.GYRO_Y]
    c = (u[2] - x[Ix.GYRO_Z]) * (1.0 - x[Ix.GYRO_SCALE])
    roll, pitch, yaw = x[Ix.MOUNT_ROLL], x[Ix.MOUNT_PITCH], x[Ix.MOUNT_YAW]
    return a + pitch * c - yaw * b, b + yaw * a - roll * c, c + roll * b - pitch * a


@compiled
def acceleration(x: Array, c: Array, u: Array, wx: float, wy: float, wz: float) -> float:
    """v̇ out of the specific force along x, without gravity and the lever of the case, m/s²."""
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    tilt = x[Ix.EAST] * math.cos(x[Ix.YAW]) + x[Ix.NORTH] * math.sin(x[Ix.YAW])
    gravity = c[Pm.GRAVITY] * (cp * tilt * c[Pm.CURVATURE] - sp)
    rx, ry, rz = c[Pm.IMU_X] + x[Ix.PIVOT], c[Pm.IMU_Y], c[Pm.IMU_Z]
    lever = -(wy * wy + wz * wz) * rx + wx * wy * ry + wx * wz * rz + u[7] * rz - u[8] * ry
    force = u[3] + x[Ix.MOUNT_PITCH] * u[5] - x[Ix.MOUNT_YAW] * u[4] - x[Ix.ACCEL_X]
    change: float = force - gravity - lever
    return change


@compiled
def heaving(x: Array, c: Array, u: Array, wx: float, wy: float, wz: float) -> float:
    """ẇ along z, m/s²; what the mounting's small angles add is left out."""
    gravity = c[Pm.GRAVITY] * math.cos(x[Ix.PITCH]) * math.cos(x[Ix.ROLL])
    rx, ry, rz = c[Pm.IMU_X] + x[Ix.PIVOT], c[Pm.IMU_Y], c[Pm.IMU_Z]
    lever = wx * wz * rx + wy * wz * ry - (wx * wx + wy * wy) * rz + u[6] * ry - u[7] * rx
    change: float = u[5] - x[Ix.ACCEL_Z] - gravity - lever + x[Ix.SPEED] * wy
    return change


@compiled
def move(x: Array, c: Array, u: Array, dt: float) -> tuple[float, float]:
    """Move x on by `dt` with the reading `u`; midpoint rule.

    Parameters
    ----------
    x : ndarray, shape (SIZE,)
    c : ndarray, shape (PARAMETERS,)
    u : ndarray, shape (10,)
        Angular rate (3), specific force (3), angular acceleration (3), resolved in v by the
        configured mounting; 1 if there is an accelerometer, 0 if v is left to itself.

    Returns
    -------
    acceleration, yaw_rate : float
        Of the vehicle, m/s², rad/s.
    """
    wx, wy, wz = rates(x, u)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
    turning = sr * wy + cr * wz
    yaw_rate, pitch_rate = turning / cp, cr * wy - sr * wz
    accel = u[9] * acceleration(x, c, u, wx, wy, wz)
    speed = x[Ix.SPEED] + 0.5 * dt * accel
    pitch = x[Ix.PITCH] + 0.5 * dt * pitch_rate
    yaw = x[Ix.YAW] + 0.5 * dt * yaw_rate
    level = speed * math.cos(pitch) * dt
    x[Ix.EAST] += level * math.cos(yaw)
    x[Ix.NORTH] += level * math.sin(yaw)
    x[Ix.UP] -= speed * math.sin(pitch) * dt
    if c[Pm.VERTICAL_DENSITY] > 0.0:
        rising = u[9] * heaving(x, c, u, wx, wy, wz)
        x[Ix.UP] += (x[Ix.HEAVE] + 0.5 * dt * rising) * cp * cr * dt
        x[Ix.HEAVE] += dt * rising
    x[Ix.SPEED] += dt * accel
    x[Ix.ROLL] += dt * (wx + tp * turning)
    x[Ix.PITCH] += dt * pitch_rate
    x[Ix.YAW] += dt * yaw_rate
    x[Ix.PATH_A] += dt * c[Pm.SIGN_A] * (speed - c[Pm.OFFSET_A] * wz) * (1.0 + x[Ix.SCALE_A])
    x[Ix.PATH_B] += dt * c[Pm.SIGN_B] * (speed - c[Pm.OFFSET_B] * wz) * (1.0 + x[Ix.SCALE_B])
    keep = math.exp(-c[Pm.GNSS_DECAY] * dt)
    x[Ix.GNSS_EAST] *= keep
    x[Ix.GNSS_NORTH] *= keep
    x[Ix.GNSS_UP] *= keep
    return accel, yaw_rate


@compiled
def transition(x: Array, c: Array, u: Array, dt: float, values: Array) -> None:
    """Fill `values` with the entries of A (`tram_states.ENTRIES`): derivatives of `move`, order dt.

    Terms with dt² and products of a small mounting angle and a bias are left out.
    """
    wx, wy, wz = rates(x, u)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    tp = sp / cp
    turning, dipping = sr * wy + cr * wz, cr * wy - sr * wz
    along = x[Ix.SPEED] * dt
    scale = 1.0 - x[Ix.GYRO_SCALE]
    rate_z = u[2] - x[Ix.GYRO_Z]
    values[0], values[1], values[2] = cp * cy * dt, -sp * cy * along, -cp * sy * along
    values[3], values[4], values[5] = cp * sy * dt, -sp * sy * along, cp * cy * along
    values[6], values[7] = -sp * dt, -cp * along
    values[8] = c[Pm.GRAVITY] * cp * dt * u[9]
    values[9], values[10], values[11] = -dt * u[9], -u[4] * dt * u[9], u[5] * dt * u[9]
    values[12], values[13] = tp * dipping * dt, turning / (cp * cp) * dt
    values[14] = -turning * dt
    values[15], values[16] = dipping / cp * dt, turning * sp / (cp * cp) * dt
    k = 17
    for angle in range(3):  # how the angle follows each rate of the vehicle
        gx, gy, gz = 1.0, tp * sr, tp * cr
        if angle == 1:
            gx, gy, gz = 0.0, cr, -sr
        elif angle == 2:
            gx, gy, gz = 0.0, sr / cp, cr / cp
        if angle == 0:
            values[k] = -gx * dt
            k += 1
        values[k], values[k + 1] = -gy * dt, -gz * scale * dt
        values[k + 2] = (gz * wy - gy * wz) * dt
        values[k + 3] = (gy * wx - gx * wy) * dt
        values[k + 4] = (gx * wz - gz * wx) * dt
        values[k + 5] = -gz * rate_z * dt
        k += 6
    for wheel in range(2):
        offset, sign, counted = c[Pm.OFFSET_A], c[Pm.SIGN_A], 1.0 + x[Ix.SCALE_A]
        if wheel == 1:
            offset, sign, counted = c[Pm.OFFSET_B], c[Pm.SIGN_B], 1.0 + x[Ix.SCALE_B]
        values[k] = sign * counted * dt
        values[k + 1] = sign * (x[Ix.SPEED] - offset * wz) * dt
        values[k + 2] = sign * offset * scale * counted * dt
        values[k + 3] = sign * offset * rate_z * counted * dt
        values[k + 4] = -sign * offset * wy * counted * dt
        values[k + 5] = sign * offset * wx * counted * dt
        k += 6
    decay = math.exp(-c[Pm.GNSS_DECAY] * dt) - 1.0
    values[k] = values[k + 1] = values[k + 2] = decay
    k += 3
    for j in range(k, k + 5):
        values[j] = 0.0
    if c[Pm.VERTICAL_DENSITY] > 0.0:
        # How w follows v is left out: a rate that shakes, times what it has shaken w by, has a
        # mean, which would turn into a speed that shrinks.
        values[k] = cp * cr * dt
        values[k + 1] = c[Pm.GRAVITY] * cp * sr * dt * u[9]
        values[k + 2] = c[Pm.GRAVITY] * sp * cr * dt * u[9]
        values[k + 3], values[k + 4] = -along * u[9], -dt * u[9]


@compiled
def add_noise(x: Array, P: Array, c: Array, dt: float) -> None:
    """P += Q: noise of the readings with all that it moves together, walks, creep of the wheels."""
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
    # Per axis of the gyroscopes: how roll, pitch, yaw and the paths of the wheels follow it.
    P[Ix.ROLL, Ix.ROLL] += c[Pm.ROLL_DENSITY] * dt
    q = c[Pm.PITCH_DENSITY] * dt
    a, b, d = tp * sr, cr, sr / cp
    P[Ix.ROLL, Ix.ROLL] += q * a * a
    P[Ix.PITCH, Ix.PITCH] += q * b * b
    P[Ix.YAW, Ix.YAW] += q * d * d
    _couple(P, Ix.ROLL, Ix.PITCH, q * a * b)
    _couple(P, Ix.ROLL, Ix.YAW, q * a * d)
    _couple(P, Ix.PITCH, Ix.YAW, q * b * d)
    if c[Pm.VERTICAL_DENSITY] > 0.0:
        v = x[Ix.SPEED]
        P[Ix.HEAVE, Ix.HEAVE] += q * v * v + c[Pm.VERTICAL_DENSITY] * dt
        P[Ix.ACCEL_Z, Ix.ACCEL_Z] += c[Pm.ACCEL_WALK] * dt
        _couple(P, Ix.HEAVE, Ix.ROLL, q * v * a)
        _couple(P, Ix.HEAVE, Ix.PITCH, q * v * b)
        _couple(P, Ix.HEAVE, Ix.YAW, q * v * d)
    else:
        P[Ix.UP, Ix.UP] += c[Pm.HEAVE_DENSITY] * dt
    q = c[Pm.YAW_DENSITY] * dt
    a, b, d = tp * cr, -sr, cr / cp
    left = -c[Pm.SIGN_A] * c[Pm.OFFSET_A] * (1.0 + x[Ix.SCALE_A])
    right = -c[Pm.SIGN_B] * c[Pm.OFFSET_B] * (1.0 + x[Ix.SCALE_B])
    P[Ix.ROLL, Ix.ROLL] += q * a * a
    P[Ix.PITCH, Ix.PITCH] += q * b * b
    P[Ix.YAW, Ix.YAW] += q * d * d
    _couple(P, Ix.ROLL, Ix.PITCH, q * a * b)
    _couple(P, Ix.ROLL, Ix.YAW, q * a * d)
    _couple(P, Ix.PITCH, Ix.YAW, q * b * d)
    _couple(P, Ix.ROLL, Ix.PATH_A, q * a * left)
    _couple(P, Ix.ROLL, Ix.PATH_B, q * a * right)
    _couple(P, Ix.PITCH, Ix.PATH_A, q * b * left)
    _couple(P, Ix.PITCH, Ix.PATH_B, q * b * right)
    _couple(P, Ix.YAW, Ix.PATH_A, q * d * left)
    _couple(P, Ix.YAW, Ix.PATH_B, q * d * right)
    _couple(P, Ix.PATH_A, Ix.PATH_B, q * left * right)
    way = abs(x[Ix.SPEED]) * dt
    P[Ix.PATH_A, Ix.PATH_A] += q * left * left + c[Pm.SLIP_DENSITY] * way
    P[Ix.PATH_B, Ix.PATH_B] += q * right * right + c[Pm.SLIP_DENSITY] * way
    P[Ix.SCALE_A, Ix.SCALE_A] += c[Pm.SCALE_WALK] * way
    P[Ix.SCALE_B, Ix.SCALE_B] += c[Pm.SCALE_WALK] * way
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    side = c[Pm.SIDE_DENSITY] * dt
    P[Ix.EAST, Ix.EAST] += side * sy * sy
    P[Ix.NORTH, Ix.NORTH] += side * cy * cy
    _couple(P, Ix.EAST, Ix.NORTH, -side * sy * cy)
    P[Ix.SPEED, Ix.SPEED] += c[Pm.ACCEL_DENSITY] * dt
    P[Ix.GYRO_X, Ix.GYRO_X] += c[Pm.GYRO_WALK] * dt
    P[Ix.GYRO_Y, Ix.GYRO_Y] += c[Pm.GYRO_WALK] * dt
    P[Ix.GYRO_Z, Ix.GYRO_Z] += c[Pm.GYRO_WALK] * dt
    P[Ix.ACCEL_X, Ix.ACCEL_X] += c[Pm.ACCEL_WALK] * dt
    P[Ix.ACCEL_Y, Ix.ACCEL_Y] += c[Pm.ACCEL_WALK] * dt
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] += c[Pm.GNSS_DENSITY] * dt
    P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] += c[Pm.GNSS_DENSITY] * dt
    P[Ix.GNSS_UP, Ix.GNSS_UP] += c[Pm.GNSS_UP_DENSITY] * dt


@compiled
def _couple(P: Array, i: int, j: int, value: float) -> None:
    P[i, j] += value
    P[j, i] += value


@compiled
def predict(m: Array, c: Array, u: Array, dt: float) -> None:
    """Move state and covariance on by `dt` s; see `move` for `u`."""
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    values = m[ENTRY_VALUES]
    transition(x, c, u, dt, values)
    count = ENTRY_COUNT if c[Pm.VERTICAL_DENSITY] > 0.0 else WITHOUT_HEAVE
    predict_covariance(P, ROWS, COLUMNS, values, count, m[SCRATCH].reshape((SIZE, SIZE)))
    add_noise(x, P, c, dt)
    m[ACCELERATION], m[YAW_RATE] = move(x, c, u, dt)


@compiled
def rest(m: Array, c: Array, dt: float) -> None:
    """Let `dt` s pass for a vehicle that stands: only the sensors' errors go on."""
    P = m[COVARIANCE].reshape((SIZE, SIZE))
    for axis in range(3):
        P[Ix.GYRO_X + axis, Ix.GYRO_X + axis] += c[Pm.GYRO_WALK] * dt
    P[Ix.ACCEL_X, Ix.ACCEL_X] += c[Pm.ACCEL_WALK] * dt
    P[Ix.ACCEL_Y, Ix.ACCEL_Y] += c[Pm.ACCEL_WALK] * dt
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] += c[Pm.GNSS_DENSITY] * dt
    P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] += c[Pm.GNSS_DENSITY] * dt
    P[Ix.GNSS_UP, Ix.GNSS_UP] += c[Pm.GNSS_UP_DENSITY] * dt
    m[ACCELERATION] = m[YAW_RATE] = 0.0
