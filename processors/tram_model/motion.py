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

Functions with a `memory` are what Python calls: they take arrays of one record (`records.py`), for
a fraction of a microsecond. Equations are those of docs/theory.md, section 5.2, with the up
direction of the place, u = [E/r, N/r, 1] in the tangent plane of the origin (r: Earth's radius).
In the code x is the state, c the parameters, s the situation, u the inertial reading.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled, predict_covariance
from tramstream.processors.tram_model.records import (
    LEFT,
    MEMORY,
    PARAMETERS,
    READING,
    RIGHT,
    SITUATION,
    Memory,
    Parameters,
    Reading,
    Situation,
    X,
    Y,
    Z,
)
from tramstream.processors.tram_model.states import (
    COLUMNS,
    ENTRY_COUNT,
    PATTERN,
    ROWS,
    WITHOUT_HEAVE,
    Ix,
)

DRIFTING_MPS = 1.0
"""Slower, the angular acceleration is mostly noise against what the rail does; chosen by hand."""
STEERING_S = 0.05
"""Time constant of a bogie's angle in the body, for noise is no steering; chosen by hand."""


@compiled
def rates(x: Array, angular_rate: Array) -> tuple[float, float, float]:
    """Angular rate of the vehicle out of what the gyroscopes read, resolved in v, rad/s."""
    a, b = angular_rate[X] - x[Ix.GYRO_X], angular_rate[Y] - x[Ix.GYRO_Y]
    c = (angular_rate[Z] - x[Ix.GYRO_Z]) * (1.0 - x[Ix.GYRO_SCALE])
    roll, pitch, yaw = x[Ix.MOUNT_ROLL], x[Ix.MOUNT_PITCH], x[Ix.MOUNT_YAW]
    return a + pitch * c - yaw * b, b + yaw * a - roll * c, c + roll * b - pitch * a


@compiled
def acceleration(x: Array, c: Parameters, u: Reading, wx: float, wy: float, wz: float) -> float:
    """v̇ out of the specific force along x, without gravity and the lever of the case, m/s²."""
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    tilt = x[Ix.EAST] * math.cos(x[Ix.YAW]) + x[Ix.NORTH] * math.sin(x[Ix.YAW])
    gravity = c.gravity * (cp * tilt * c.earth_curvature - sp)
    rx, ry, rz = c.imu_lever[X] + x[Ix.PIVOT], c.imu_lever[Y], c.imu_lever[Z]
    turn = u.angular_acceleration
    lever = -(wy * wy + wz * wz) * rx + wx * wy * ry + wx * wz * rz + turn[Y] * rz - turn[Z] * ry
    change: float = force_along(x, u) - gravity - lever
    return change


@compiled
def force_along(x: Array, u: Reading) -> float:
    """Specific force along x of the vehicle, turned by the mounting's small angles, m/s²."""
    read = u.specific_force
    force: float = read[X] + x[Ix.MOUNT_PITCH] * read[Z] - x[Ix.MOUNT_YAW] * read[Y] - x[Ix.ACCEL_X]
    return force


@compiled
def heaving(x: Array, c: Parameters, u: Reading, wx: float, wy: float, wz: float) -> float:
    """ẇ along z, m/s²; what the mounting's small angles add is left out."""
    gravity = c.gravity * math.cos(x[Ix.PITCH]) * math.cos(x[Ix.ROLL])
    rx, ry, rz = c.imu_lever[X] + x[Ix.PIVOT], c.imu_lever[Y], c.imu_lever[Z]
    turn = u.angular_acceleration
    lever = wx * wz * rx + wy * wz * ry - (wx * wx + wy * wy) * rz + turn[X] * ry - turn[Y] * rx
    change: float = u.specific_force[Z] - x[Ix.ACCEL_Z] - gravity - lever + x[Ix.SPEED] * wy
    return change


@compiled
def drift(c: Parameters, speed: float, turning_up: float) -> float:
    """Speed to the left, m/s, of the point midway between two bogies, where the curve tightens.

    On a rail whose curvature changes evenly the chord turns before the rail midway does
    (docs/theory.md, section 5.2); `turning_up` is the smoothed angular acceleration about z.
    """
    if abs(speed) < DRIFTING_MPS:
        return 0.0
    return turning_up * c.half_base * c.half_base / (3.0 * speed)


@compiled
def bogie_speed(c: Parameters, speed: float, yaw_rate: float) -> float:
    """Speed of a bogie along its rail, m/s: the body between the two takes the shorter way."""
    swing = yaw_rate * c.half_base
    along = math.sqrt(speed * speed + swing * swing)
    return along if speed >= 0.0 else -along


@compiled
def move(x: Array, c: Parameters, s: Situation, u: Reading, dt: float) -> tuple[float, float]:
    """Move x on by `dt` s with the reading `u`; midpoint rule.

    Returns
    -------
    acceleration, yaw_rate : float
        Of the vehicle, m/s², rad/s.
    """
    wx, wy, wz = rates(x, u.angular_rate)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
    turning = sr * wy + cr * wz
    yaw_rate, pitch_rate = turning / cp, cr * wy - sr * wz
    accel = u.accelerometer * acceleration(x, c, u, wx, wy, wz)
    sideways = drift(c, x[Ix.SPEED], u.angular_acceleration[Z])
    accel += u.accelerometer * sideways * wz
    speed = x[Ix.SPEED] + 0.5 * dt * accel
    pitch = x[Ix.PITCH] + 0.5 * dt * pitch_rate
    yaw = x[Ix.YAW] + 0.5 * dt * yaw_rate
    level, left = speed * math.cos(pitch) * dt, sideways * dt
    x[Ix.EAST] += level * math.cos(yaw) - left * math.sin(yaw)
    x[Ix.NORTH] += level * math.sin(yaw) + left * math.cos(yaw)
    x[Ix.UP] -= speed * math.sin(pitch) * dt
    if c.vertical_density > 0.0:
        rising = u.accelerometer * heaving(x, c, u, wx, wy, wz)
        x[Ix.UP] += (x[Ix.HEAVE] + 0.5 * dt * rising) * cp * cr * dt
        x[Ix.HEAVE] += dt * rising
    x[Ix.SPEED] += dt * accel
    x[Ix.ROLL] += dt * (wx + tp * turning)
    x[Ix.PITCH] += dt * pitch_rate
    x[Ix.YAW] += dt * yaw_rate
    rolling = bogie_speed(c, speed, wz)
    for wheel in range(2):
        sign, offset = s.wheel_sign[wheel], s.wheel_offset[wheel]
        x[Ix.PATH_A + wheel] += dt * sign * (rolling - offset * wz) * (1.0 + x[Ix.SCALE_A + wheel])
    keep = math.exp(-s.fix_decay * dt)
    x[Ix.GNSS_EAST] *= keep
    x[Ix.GNSS_NORTH] *= keep
    x[Ix.GNSS_UP] *= keep
    keep = 1.0 - s.slow_decay * dt  # of minutes: e^-x to a hundred-millionth
    x[Ix.GNSS_SLOW_EAST] *= keep
    x[Ix.GNSS_SLOW_NORTH] *= keep
    return accel, yaw_rate


@compiled
def transition(x: Array, c: Parameters, s: Situation, u: Reading, dt: float, A: Array) -> None:
    """Fill A of F = I + A at the places of `states.ENTRIES`: derivatives of `move`, order dt.

    Terms with dt² and products of a small mounting angle and a bias are left out.
    """
    wx, wy, wz = rates(x, u.angular_rate)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    tp = sp / cp
    turning, dipping = sr * wy + cr * wz, cr * wy - sr * wz
    along, driven = x[Ix.SPEED] * dt, u.accelerometer
    A[Ix.EAST, Ix.SPEED] = cp * cy * dt
    A[Ix.EAST, Ix.PITCH] = -sp * cy * along
    A[Ix.EAST, Ix.YAW] = -cp * sy * along
    A[Ix.NORTH, Ix.SPEED] = cp * sy * dt
    A[Ix.NORTH, Ix.PITCH] = -sp * sy * along
    A[Ix.NORTH, Ix.YAW] = cp * cy * along
    A[Ix.UP, Ix.SPEED] = -sp * dt
    A[Ix.UP, Ix.PITCH] = -cp * along
    A[Ix.SPEED, Ix.PITCH] = c.gravity * cp * dt * driven
    A[Ix.SPEED, Ix.ACCEL_X] = -dt * driven
    # By gravity, as `level_force` has it, and not by the force that is read: its bias would pass
    # for knowledge of the mounting, and so of the pitch (docs/theory.md, section 5.3).
    A[Ix.SPEED, Ix.MOUNT_YAW] = -c.gravity * cp * sr * dt * driven
    A[Ix.SPEED, Ix.MOUNT_PITCH] = c.gravity * cp * cr * dt * driven
    A[Ix.SPEED, Ix.PIVOT] = (wy * wy + wz * wz) * dt * driven
    A[Ix.ROLL, Ix.ROLL] = tp * dipping * dt
    A[Ix.ROLL, Ix.PITCH] = turning / (cp * cp) * dt
    A[Ix.PITCH, Ix.ROLL] = -turning * dt
    A[Ix.YAW, Ix.ROLL] = dipping / cp * dt
    A[Ix.YAW, Ix.PITCH] = turning * sp / (cp * cp) * dt
    A[Ix.ROLL, Ix.GYRO_X] = -dt
    scale, rate_z = 1.0 - x[Ix.GYRO_SCALE], u.angular_rate[Z] - x[Ix.GYRO_Z]
    for angle in range(3):  # how the angle follows each rate of the vehicle
        gx, gy, gz = 1.0, tp * sr, tp * cr
        if angle == 1:
            gx, gy, gz = 0.0, cr, -sr
        elif angle == 2:
            gx, gy, gz = 0.0, sr / cp, cr / cp
        row = A[Ix.ROLL + angle]
        row[Ix.GYRO_Y], row[Ix.GYRO_Z] = -gy * dt, -gz * scale * dt
        row[Ix.MOUNT_ROLL] = (gz * wy - gy * wz) * dt
        row[Ix.MOUNT_YAW] = (gy * wx - gx * wy) * dt
        row[Ix.MOUNT_PITCH] = (gx * wz - gz * wx) * dt
        row[Ix.GYRO_SCALE] = -gz * rate_z * dt
    _transition_of_wheels(x, s, u, dt, A)
    decay = math.exp(-s.fix_decay * dt) - 1.0
    for error in range(Ix.GNSS_EAST, Ix.GNSS_UP + 1):
        A[error, error] = decay
    decay = -s.slow_decay * dt
    A[Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_EAST] = A[Ix.GNSS_SLOW_NORTH, Ix.GNSS_SLOW_NORTH] = decay
    used = 1.0 if c.vertical_density > 0.0 else 0.0
    # How w follows v is left out: a rate that shakes, times what it has shaken w by, has a
    # mean, which would turn into a speed that shrinks.
    A[Ix.UP, Ix.HEAVE] = used * (cp * cr * dt)
    A[Ix.HEAVE, Ix.ROLL] = used * (c.gravity * cp * sr * dt * driven)
    A[Ix.HEAVE, Ix.PITCH] = used * (c.gravity * sp * cr * dt * driven)
    A[Ix.HEAVE, Ix.GYRO_Y] = used * (-along * driven)
    A[Ix.HEAVE, Ix.ACCEL_Z] = used * (-dt * driven)


@compiled
def _transition_of_wheels(x: Array, s: Situation, u: Reading, dt: float, A: Array) -> None:
    """Fill the rows of the wheels' paths; see `transition`."""
    wx, wy, wz = rates(x, u.angular_rate)
    scale, rate_z = 1.0 - x[Ix.GYRO_SCALE], u.angular_rate[Z] - x[Ix.GYRO_Z]
    for wheel in range(2):
        offset, sign = s.wheel_offset[wheel], s.wheel_sign[wheel]
        counted = 1.0 + x[Ix.SCALE_A + wheel]
        row = A[Ix.PATH_A + wheel]
        row[Ix.SPEED] = sign * counted * dt
        row[Ix.SCALE_A + wheel] = sign * (x[Ix.SPEED] - offset * wz) * dt
        row[Ix.GYRO_Z] = sign * offset * scale * counted * dt
        row[Ix.GYRO_SCALE] = sign * offset * rate_z * counted * dt
        row[Ix.MOUNT_ROLL] = -sign * offset * wy * counted * dt
        row[Ix.MOUNT_PITCH] = sign * offset * wx * counted * dt


@compiled
def add_noise(x: Array, P: Array, c: Parameters, s: Situation, u: Reading, dt: float) -> None:
    """P += Q: noise of the readings with all that it moves together, walks, creep of the wheels."""
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
    # Per axis of the gyroscopes: how roll, pitch, yaw and the paths of the wheels follow it.
    # Shaking that the readings do not resolve is white noise to what they drive, axis by axis.
    P[Ix.ROLL, Ix.ROLL] += (s.rate_density[X] + c.gyro_aliasing * u.rate_scatter[X]) * dt
    q = (s.rate_density[Y] + c.gyro_aliasing * u.rate_scatter[Y]) * dt
    a, b, d = tp * sr, cr, sr / cp
    P[Ix.ROLL, Ix.ROLL] += q * a * a
    P[Ix.PITCH, Ix.PITCH] += q * b * b
    P[Ix.YAW, Ix.YAW] += q * d * d
    _couple(P, Ix.ROLL, Ix.PITCH, q * a * b)
    _couple(P, Ix.ROLL, Ix.YAW, q * a * d)
    _couple(P, Ix.PITCH, Ix.YAW, q * b * d)
    if c.vertical_density > 0.0:
        v = x[Ix.SPEED]
        P[Ix.HEAVE, Ix.HEAVE] += q * v * v + c.vertical_density * dt
        P[Ix.ACCEL_Z, Ix.ACCEL_Z] += c.accel_walk * dt
        _couple(P, Ix.HEAVE, Ix.ROLL, q * v * a)
        _couple(P, Ix.HEAVE, Ix.PITCH, q * v * b)
        _couple(P, Ix.HEAVE, Ix.YAW, q * v * d)
    else:
        P[Ix.UP, Ix.UP] += c.heave_density * dt
    q = (s.rate_density[Z] + c.gyro_aliasing * u.rate_scatter[Z]) * dt
    a, b, d = tp * cr, -sr, cr / cp
    left = -s.wheel_sign[LEFT] * s.wheel_offset[LEFT] * (1.0 + x[Ix.SCALE_A])
    right = -s.wheel_sign[RIGHT] * s.wheel_offset[RIGHT] * (1.0 + x[Ix.SCALE_B])
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
    P[Ix.PATH_A, Ix.PATH_A] += q * left * left + c.creep_density * way
    P[Ix.PATH_B, Ix.PATH_B] += q * right * right + c.creep_density * way
    P[Ix.SCALE_A, Ix.SCALE_A] += c.scale_walk * way
    P[Ix.SCALE_B, Ix.SCALE_B] += c.scale_walk * way
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    side = c.side_density * dt
    P[Ix.EAST, Ix.EAST] += side * sy * sy
    P[Ix.NORTH, Ix.NORTH] += side * cy * cy
    _couple(P, Ix.EAST, Ix.NORTH, -side * sy * cy)
    P[Ix.SPEED, Ix.SPEED] += (s.accel_density + c.accel_aliasing * u.force_scatter[X]) * dt
    P[Ix.GYRO_X, Ix.GYRO_X] += c.gyro_walk * dt
    P[Ix.GYRO_Y, Ix.GYRO_Y] += c.gyro_walk * dt
    P[Ix.GYRO_Z, Ix.GYRO_Z] += c.gyro_walk * dt
    P[Ix.ACCEL_X, Ix.ACCEL_X] += c.accel_walk * dt
    P[Ix.ACCEL_Y, Ix.ACCEL_Y] += c.accel_walk * dt
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] += s.fix_density * dt
    P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] += s.fix_density * dt
    P[Ix.GNSS_UP, Ix.GNSS_UP] += s.fix_up_density * dt
    P[Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_EAST] += s.slow_density * dt
    P[Ix.GNSS_SLOW_NORTH, Ix.GNSS_SLOW_NORTH] += s.slow_density * dt


@compiled
def _couple(P: Array, i: int, j: int, value: float) -> None:
    P[i, j] += value
    P[j, i] += value


@compiled
def steer(f: Memory, c: Parameters, s: Situation, dt: float) -> None:
    """Let the wheels turn with their bogie in the body, as the curve has it."""
    v = f.x[Ix.SPEED]
    if c.wheel_bogie == 0.0 or abs(v) < DRIFTING_MPS:
        return
    turned = min(1.0, dt / STEERING_S) * (c.wheel_bogie * f.yaw_rate / v - f.bogie_angle)
    f.bogie_angle += turned
    for wheel in range(2):
        counted = s.wheel_sign[wheel] * (1.0 + f.x[Ix.SCALE_A + wheel])
        f.x[Ix.PATH_A + wheel] -= counted * s.wheel_offset[wheel] * turned


@compiled
def predict_state(f: Memory, c: Parameters, s: Situation, u: Reading, dt: float) -> None:
    """Move state and covariance on by `dt` s with the reading `u`."""
    predict_along(f, c, s, u, dt)
    f.acceleration, f.yaw_rate = move(f.x, c, s, u, dt)
    steer(f, c, s, dt)


@compiled
def predict_along(f: Memory, c: Parameters, s: Situation, u: Reading, dt: float) -> None:
    """P ← F P Fᵀ + Q for `dt` s from the state on, which does not move."""
    transition(f.x, c, s, u, dt, f.A)
    for k in range(ENTRY_COUNT):
        f.entries[k] = f.A[ROWS[k], COLUMNS[k]]
    count = ENTRY_COUNT if c.vertical_density > 0.0 else WITHOUT_HEAVE
    predict_covariance(f.P, PATTERN, f.entries, count, f.scratch)
    add_noise(f.x, f.P, c, s, u, dt)


@compiled
def predict(memory: Array, parameters: Array, situation: Array, u: Array, dt: float) -> None:
    """Predict as `predict_state` does."""
    predict_state(
        memory.view(MEMORY)[0],
        parameters.view(PARAMETERS)[0],
        situation.view(SITUATION)[0],
        u.view(READING)[0],
        dt,
    )


@compiled
def rest_state(f: Memory, c: Parameters, s: Situation, dt: float) -> None:
    """Let `dt` s pass for a vehicle that stands: only the sensors' errors go on."""
    P = f.P
    for gyro in range(Ix.GYRO_X, Ix.GYRO_Z + 1):
        P[gyro, gyro] += c.gyro_walk * dt
    P[Ix.ACCEL_X, Ix.ACCEL_X] += c.accel_walk * dt
    P[Ix.ACCEL_Y, Ix.ACCEL_Y] += c.accel_walk * dt
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] += s.fix_density * dt
    P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] += s.fix_density * dt
    P[Ix.GNSS_UP, Ix.GNSS_UP] += s.fix_up_density * dt
    f.acceleration = f.yaw_rate = 0.0


@compiled
def rest(memory: Array, parameters: Array, situation: Array, dt: float) -> None:
    """Let time pass as `rest_state` does."""
    rest_state(
        memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0], dt
    )
