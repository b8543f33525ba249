"""What sensors and standstill show in the model `tram`, compiled: innovation, H, update.

The motion is that of `tram_kernels`; memory and parameters are laid out there. Each function
returns what the filter reports: innovations, their variances, and the gate's verdict in the sign of
the variance (negative: refused, nothing has changed).

Equations: docs/theory.md, section 6.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled, update_pair
from tramstream.processors.tram.motion import (
    ACCELERATION,
    COVARIANCE,
    STATE,
    YAW_RATE,
    gain,
    note,
    rates,
    row,
    slots,
    take,
)
from tramstream.processors.tram.states import SIZE, Ix, Pm

_LATERAL = slots(
    Ix.SPEED,
    Ix.ROLL,
    Ix.PITCH,
    Ix.GYRO_Z,
    Ix.ACCEL_Y,
    Ix.MOUNT_ROLL,
    Ix.MOUNT_YAW,
    Ix.GYRO_SCALE,
    Ix.MOUNT_PITCH,
)
_HEAVE = slots(Ix.HEAVE)
_ACROSS = slots(Ix.EAST, Ix.NORTH)
_ALONG = slots(Ix.EAST, Ix.NORTH, Ix.YAW)
_GRADE = slots(Ix.PITCH)
_STANDING = slots(Ix.SPEED)
_LEVEL = slots(Ix.PITCH, Ix.ACCEL_X, Ix.MOUNT_YAW, Ix.MOUNT_PITCH)
_STILL = (slots(Ix.GYRO_X), slots(Ix.GYRO_Y), slots(Ix.GYRO_Z))
_EAST = slots(Ix.EAST, Ix.GNSS_EAST, Ix.GNSS_DELAY, Ix.SPEED, Ix.YAW, Ix.PITCH, Ix.ROLL, Ix.PIVOT)
_NORTH = slots(
    Ix.NORTH, Ix.GNSS_NORTH, Ix.GNSS_DELAY, Ix.SPEED, Ix.YAW, Ix.PITCH, Ix.ROLL, Ix.PIVOT
)
_UP = slots(Ix.UP, Ix.GNSS_UP, Ix.GNSS_DELAY, Ix.SPEED, Ix.PITCH, Ix.ROLL)
_VELOCITY = slots(Ix.SPEED, Ix.YAW, Ix.GNSS_DELAY, Ix.GYRO_Z, Ix.ROLL, Ix.PITCH, Ix.PIVOT)
_WHEEL_A = slots(Ix.PATH_A, Ix.WHEEL_DELAY, Ix.SPEED, Ix.SCALE_A)
_WHEEL_B = slots(Ix.PATH_B, Ix.WHEEL_DELAY, Ix.SPEED, Ix.SCALE_B)
_RIM_A = slots(Ix.SPEED, Ix.SCALE_A, Ix.GYRO_Z, Ix.WHEEL_DELAY)
_RIM_B = slots(Ix.SPEED, Ix.SCALE_B, Ix.GYRO_Z, Ix.WHEEL_DELAY)


@compiled
def _lever(x: Array, c: Array) -> tuple[float, float, float, float, float]:
    """C_lv p_va (east, north, up), and the lever resolved along and across the level heading."""
    ax, ay, az = c[Pm.ANTENNA_X] + x[Ix.PIVOT], c[Pm.ANTENNA_Y], c[Pm.ANTENNA_Z]
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    along = cp * ax + sp * (sr * ay + cr * az)
    across = cr * ay - sr * az
    up = -sp * ax + cp * (sr * ay + cr * az)
    return cy * along - sy * across, sy * along + cy * across, up, along, across


@compiled
def position(m: Array, c: Array, z: Array, R: Array, gate: float, knee: float, out: Array) -> None:
    """Take a fix: p + C_lv p_va + its correlated error, of the instant before its delay.

    Parameters
    ----------
    z : ndarray, shape (3,)
        Antenna in l, m.
    R : ndarray, shape (3,)
        White variance, horizontal and vertical, and what the gate adds to it, m².
    gate : float
        Greatest squared Mahalanobis distance that is accepted.
    knee : float
        Beyond this distance squared a fix is weighted down (Huber).
    out : ndarray, shape (3, 2)
        Gets innovations and variances of east, north and up.
    """
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    K, K2, h, h2 = gain(m, 0), gain(m, 1), row(m, 0), row(m, 1)
    east, north, up, along, across = _lever(x, c)
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    az, v, delay = c[Pm.ANTENNA_Z], x[Ix.SPEED], x[Ix.GNSS_DELAY]
    # An antenna before or behind the pivot swings sideways with the yaw rate.
    ahead, aside = v * cp - m[YAW_RATE] * across, m[YAW_RATE] * along
    ve, vn, vu = cy * ahead - sy * aside, sy * ahead + cy * aside, -v * sp
    h[0], h[1], h[2], h[3] = 1.0, 1.0, -ve, -cy * cp * delay
    h[4], h[5], h[6] = -north + vn * delay, cy * az, sy * az
    h2[0], h2[1], h2[2], h2[3] = 1.0, 1.0, -vn, -sy * cp * delay
    h2[4], h2[5], h2[6] = east - ve * delay, sy * az, -cy * az
    h[7], h2[7] = cy * cp, sy * cp
    out[0, 0] = z[0] - (x[Ix.EAST] + east + x[Ix.GNSS_EAST] - ve * delay)
    out[1, 0] = z[1] - (x[Ix.NORTH] + north + x[Ix.GNSS_NORTH] - vn * delay)
    update_pair(x, P, _EAST, h, 8, _NORTH, h2, 8, R[0], R[2], gate, knee, K, K2, out)
    note(m, 0, _EAST, 8, out[0, 0], out[0, 1])
    note(m, 1, _NORTH, 8, out[1, 0], out[1, 1])
    _, _, up, along, across = _lever(x, c)
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    vu, delay = -x[Ix.SPEED] * sp, x[Ix.GNSS_DELAY]
    h = row(m, 2)
    h[0], h[1], h[2], h[3] = 1.0, 1.0, -vu, sp * delay
    h[4], h[5] = -along + x[Ix.SPEED] * cp * delay, across
    y = z[2] - (x[Ix.UP] + up + x[Ix.GNSS_UP] - vu * delay)
    out[2, 0], out[2, 1] = y, take(m, 2, _UP, 6, y, R[1], gate)


@compiled
def velocity(m: Array, c: Array, z: Array, R: float, gate: float, knee: float, out: Array) -> None:
    """Take an antenna's velocity over ground (east, north), m/s; see `position`."""
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    K, K2, h, h2 = gain(m, 0), gain(m, 1), row(m, 0), row(m, 1)
    _, _, _, along, across = _lever(x, c)
    cp = math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    a, w, delay = m[ACCELERATION], m[YAW_RATE], x[Ix.GNSS_DELAY]
    v = x[Ix.SPEED]
    ahead, aside = v * cp - w * across, w * along
    ve, vn = cy * ahead - sy * aside, sy * ahead + cy * aside
    ae, an = cy * a - w * vn, sy * a + w * ve
    h[0], h[1], h[2] = cy * cp, an * delay - vn, -ae
    h[3] = cy * across + sy * along
    h2[0], h2[1], h2[2] = sy * cp, ve - ae * delay, -an
    h2[3] = sy * across - cy * along
    # A high antenna leans with roll and pitch.
    swing, sinking = w * c[Pm.ANTENNA_Z], v * math.sin(x[Ix.PITCH])
    h[4], h[5] = cy * swing, -cy * sinking - sy * swing
    h2[4], h2[5] = sy * swing, -sy * sinking + cy * swing
    h[6], h2[6] = -sy * w, cy * w
    out[0, 0] = z[0] - (ve - ae * delay)
    out[1, 0] = z[1] - (vn - an * delay)
    update_pair(x, P, _VELOCITY, h, 7, _VELOCITY, h2, 7, R, 0.0, gate, knee, K, K2, out)
    note(m, 0, _VELOCITY, 7, out[0, 0], out[0, 1])
    note(m, 1, _VELOCITY, 7, out[1, 0], out[1, 1])


@compiled
def path(m: Array, c: Array, wheel: int, way: float, R: float, gate: float) -> tuple[float, float]:
    """Take a wheel's path since its last reading, m, and count from here on.

    Returns
    -------
    innovation, variance : float
    """
    x, h = m[STATE], row(m, 0)
    slot, sign, scale, columns = Ix.PATH_A + 0, c[Pm.SIGN_A], x[Ix.SCALE_A], _WHEEL_A
    if wheel == 1:
        slot, sign, scale, columns = Ix.PATH_B + 0, c[Pm.SIGN_B], x[Ix.SCALE_B], _WHEEL_B
    v, delay, counted = sign * x[Ix.SPEED], x[Ix.WHEEL_DELAY], 1.0 + scale
    h[0], h[1], h[2], h[3] = 1.0, -v * counted, -sign * delay * counted, -v * delay
    y = way - (x[slot] - v * delay * counted)
    S = take(m, 0, columns, 4, y, R, gate)
    x[slot] -= way
    return y, S


@compiled
def tie(m: Array, c: Array, wheel: int, variance: float) -> None:
    """Count a wheel's path from here on, whatever came before: a slip, a pause, a new counter.

    What the wheel has gone and its late counter does not show yet, belongs to it.
    """
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    slot, sign, scale = Ix.PATH_A + 0, c[Pm.SIGN_A], x[Ix.SCALE_A]
    if wheel == 1:
        slot, sign, scale = Ix.PATH_B + 0, c[Pm.SIGN_B], x[Ix.SCALE_B]
    v, delay = x[Ix.SPEED], x[Ix.WHEEL_DELAY]
    for i in range(SIZE):
        P[slot, i] = P[i, slot] = 0.0
    x[slot] = sign * v * delay * (1.0 + scale)
    P[slot, slot] = (
        variance + v * v * P[Ix.WHEEL_DELAY, Ix.WHEEL_DELAY] + delay**2 * P[Ix.SPEED, Ix.SPEED]
    )


@compiled
def counted(m: Array, c: Array, wheel: int) -> float:
    """Give the path since its last reading that a wheel's counter should show now."""
    x = m[STATE]
    path, sign, scale = x[Ix.PATH_A], c[Pm.SIGN_A], x[Ix.SCALE_A]
    if wheel == 1:
        path, sign, scale = x[Ix.PATH_B], c[Pm.SIGN_B], x[Ix.SCALE_B]
    shown: float = path - sign * x[Ix.SPEED] * x[Ix.WHEEL_DELAY] * (1.0 + scale)
    return shown


@compiled
def rim(m: Array, c: Array, wheel: int, speed: float, R: float, gate: float) -> tuple[float, float]:
    """Take a wheel's speed, m/s, where the bus gives one; see `path`."""
    x, h = m[STATE], row(m, 0)
    offset, sign, scale, columns = c[Pm.OFFSET_A], c[Pm.SIGN_A], x[Ix.SCALE_A], _RIM_A
    if wheel == 1:
        offset, sign, scale, columns = c[Pm.OFFSET_B], c[Pm.SIGN_B], x[Ix.SCALE_B], _RIM_B
    a, delay = m[ACCELERATION], x[Ix.WHEEL_DELAY]
    true = sign * (x[Ix.SPEED] - a * delay - offset * m[YAW_RATE])
    counted = 1.0 + scale
    h[0], h[1], h[2], h[3] = sign * counted, true, sign * offset * counted, -sign * a * counted
    y = speed - true * counted
    return y, take(m, 0, columns, 4, y, R, gate)


@compiled
def track(m: Array, z: Array, gate: float, out: Array) -> None:
    """Take that the vehicle is on a track and heads along it, with the track's grade.

    The first is the distance in normal form, n (p − p_track) = 0. The heading that the track has
    depends on how far along it the vehicle is: in a curve its row reads the place along the track.

    Parameters
    ----------
    z : ndarray, shape (9,)
        Fields of `tramstream.estimation.localiser.OnTrack`: of the state as it is.
    out : ndarray, shape (3, 2)
        Gets innovations and variances; zeros where the map knows no grade.
    """
    x, h = m[STATE], row(m, 0)
    ne, nn, across = z[0], z[1], z[2]
    east, north, yaw = x[Ix.EAST], x[Ix.NORTH], x[Ix.YAW]
    h[0], h[1] = ne, nn
    out[0, 0], out[0, 1] = -across, take(m, 0, _ACROSS, 2, -across, z[5], gate)
    # The first scalar has moved place and heading: z is of the state before it.
    along = nn * (x[Ix.EAST] - east) - ne * (x[Ix.NORTH] - north)
    h = row(m, 1)
    h[0], h[1], h[2] = -z[4] * nn, z[4] * ne, 1.0
    y = z[4] * along - (z[3] + x[Ix.YAW] - yaw)
    out[1, 0], out[1, 1] = y, take(m, 1, _ALONG, 3, y, z[6], gate)
    out[2, 0] = out[2, 1] = 0.0
    if not math.isnan(z[7]):
        row(m, 2)[0] = 1.0
        y = -z[7] - x[Ix.PITCH]
        out[2, 0], out[2, 1] = y, take(m, 2, _GRADE, 1, y, z[8], gate)


@compiled
def stop(m: Array, c: Array, gate: float) -> bool:
    """Take that the vehicle has no speed; one that cannot be is forgotten: then False."""
    x, P = m[STATE], m[COVARIANCE].reshape((SIZE, SIZE))
    row(m, 0)[0] = 1.0
    if take(m, 0, _STANDING, 1, -x[Ix.SPEED], c[Pm.STANDING_VARIANCE], gate) > 0.0:
        return True
    x[Ix.SPEED] = 0.0
    for i in range(SIZE):
        P[Ix.SPEED, i] = P[i, Ix.SPEED] = 0.0
    P[Ix.SPEED, Ix.SPEED] = c[Pm.STANDING_VARIANCE]
    return False


@compiled
def standing(m: Array, c: Array, u: Array, gate: float = math.inf) -> bool:
    """Take what a vehicle that stands shows: no speed, biases as rates, gravity along x.

    Gives what `stop` does.
    """
    x = m[STATE]
    stopped = stop(m, c, gate)
    for axis in range(3):
        variance = c[Pm.STILL_ROLL_VARIANCE + axis]
        row(m, 1 + axis)[0] = 1.0
        take(m, 1 + axis, _STILL[axis], 1, u[axis] - x[Ix.GYRO_X + axis], variance, math.inf)
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    tilt = x[Ix.EAST] * math.cos(x[Ix.YAW]) + x[Ix.NORTH] * math.sin(x[Ix.YAW])
    gravity = c[Pm.GRAVITY] * (cp * tilt * c[Pm.CURVATURE] - sp)
    h = row(m, 4)
    # Of the other axes what gravity has there: their readings shake with this one, and the product
    # of shaking and innovation has a mean that would turn into a false mounting.
    across, upright = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    h[0], h[1] = -c[Pm.GRAVITY] * cp, 1.0
    h[2], h[3] = c[Pm.GRAVITY] * cp * across, -c[Pm.GRAVITY] * cp * upright
    force = u[3] + x[Ix.MOUNT_PITCH] * u[5] - x[Ix.MOUNT_YAW] * u[4] - x[Ix.ACCEL_X]
    # Braking with locked wheels that was taken for standing is no slope.
    take(m, 4, _LEVEL, 4, force - gravity, c[Pm.STILL_FORCE_VARIANCE], gate)
    return stopped


@compiled
def inertial(m: Array, c: Array, u: Array, steady: Array, gate: float) -> float:
    """Take the lateral specific force, f_y = v ω_z + g cosθ sinφ, and that nothing flies: w = 0.

    The row of H is that of the `steady` rates before the reading: its own would carry the noise of
    the gyroscope that the innovation carries too, and their product has a mean that turns into a
    false scale, or, without wheels, into a speed that shrinks. Vibration shares even the reading
    before.

    Returns y²/S, negative when it was refused.
    """
    x, h = m[STATE], row(m, 0)
    wx, wy, wz = rates(x, u)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    g, v = c[Pm.GRAVITY], x[Ix.SPEED]
    rx, ry, rz = c[Pm.IMU_X] + x[Ix.PIVOT], c[Pm.IMU_Y], c[Pm.IMU_Z]
    lever = wx * wy * rx - (wx * wx + wz * wz) * ry + wy * wz * rz + u[8] * rx - u[6] * rz
    tilt = x[Ix.NORTH] * math.cos(x[Ix.YAW]) - x[Ix.EAST] * math.sin(x[Ix.YAW])
    expected = v * wz + g * (cp * sr + tilt * c[Pm.CURVATURE]) + lever
    read = u[4] + x[Ix.MOUNT_YAW] * u[3] - x[Ix.MOUNT_ROLL] * u[5] - x[Ix.ACCEL_Y]
    scale = 1.0 - x[Ix.GYRO_SCALE]
    wx, wy, wz = rates(x, steady)
    h[0], h[1], h[2] = wz, g * cp * cr, -g * sp * sr
    h[3], h[4] = -v * scale, 1.0
    # Forces as the motion has them: read ones shake with the innovation's own.
    h[5], h[6] = g * cp * cr, g * sp - m[ACCELERATION]
    h[7], h[8] = -v * (steady[2] - x[Ix.GYRO_Z]), -v * wx
    y = read - expected
    variance = c[Pm.LATERAL_VARIANCE] + v * v * c[Pm.READING_VARIANCE]
    S = take(m, 0, _LATERAL, 9, y, variance, gate)
    if c[Pm.VERTICAL_DENSITY] > 0.0:
        row(m, 1)[0] = 1.0
        take(m, 1, _HEAVE, 1, -x[Ix.HEAVE], c[Pm.HEAVE_VARIANCE], math.inf)
    distance: float = y * y / S
    return distance
