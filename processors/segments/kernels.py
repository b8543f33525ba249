"""The motion of a vehicle by its IMU, with or without wheels, compiled: eleven states.

States x (`Ix`): way and speed along the track, heading, pitch and roll of the body against level,
biases of three gyroscopes and two accelerometers, and how far x of the case is turned from x of the
vehicle about its vertical. Errors are additive, angles those of docs/theory.md, section 1.2.

Attitude is integrated direction, not guessed from the force: pitch is levelled while standing and
carried by the gyroscopes in between, so that uphill is no acceleration. The lateral force is that
of the curve, f_y = v ω_z + g cos θ sin φ, which tells the speed in every curve. A stop sets the
speed to zero and takes back what the way has drifted since the last one.

The mean goes on with every reading, its covariance and all measurements ten times a second
(`EPOCH_S`). Equations: docs/theory.md, section 20.
"""

from __future__ import annotations

import math
from enum import IntEnum

from tramstream.estimation.kalman import Array, compiled


class Ix(IntEnum):
    """Where each state stands."""

    WAY = 0
    SPEED = 1
    YAW = 2
    PITCH = 3
    ROLL = 4
    GYRO_X = 5
    GYRO_Y = 6
    GYRO_Z = 7
    FORCE_X = 8
    FORCE_Y = 9
    TURNED = 10


STATES = len(Ix)


class Sum(IntEnum):
    """What is summed up over an epoch: mean rates and forces, less their biases, and scatter."""

    TIME = 0
    COUNT = 1
    RATE_X = 2
    RATE_Y = 3
    RATE_Z = 4
    FORCE_X = 5
    FORCE_Y = 6
    FORCE_Z = 7
    SCATTER = 8


SUMS = len(Sum)


class Noise(IntEnum):
    """Densities of what drives the states, per root of a second; and what smears turns."""

    FORCE = 0
    GYRO = 1
    GYRO_WALK = 2
    FORCE_WALK = 3
    SMEAR_M2 = 4
    """See `turns.take_metre`."""


NOISES = len(Noise)

EPOCH_S = 0.1
GRAVITY = 9.81
SWAY_STD_MPS2 = 0.12
"""Lateral force of an epoch that is no curve: the body rides at 0.1 to 0.3 m/s² on worn rails."""
LEVEL_STD_MPS2 = 0.02
"""Horizontal force of an epoch while standing: fans, passengers."""
STANDING_STD_MPS = 0.005
STANDING_RATE_STD_RADPS = 0.0015
"""Angular rate of an epoch while standing: passengers shake the body."""
PITCH_STD_RAD_RTS = 2e-4
"""What the body's own shaking makes of integrated pitch and roll, beside the gyroscope's noise."""


@compiled
def advance(
    x: Array,
    sums: Array,
    standing: Array,
    mounting: Array,
    dt_s: float,
    rates: tuple[float, float, float],
    forces: tuple[float, float, float],
) -> float:
    """Go on by one reading of the IMU; how long the epoch has lasted, s.

    Parameters
    ----------
    x : ndarray, shape (STATES,)
        Changed in place.
    sums : ndarray, shape (SUMS,)
        Of the epoch; changed in place.
    standing : ndarray
        The first of them is 1 while the vehicle stands.
    mounting : ndarray, shape (4, 3)
        C_vb, from the case into the vehicle but for x[TURNED], and below it the case from the point
        that does not slip sideways, in the vehicle, m.
    rates, forces : tuple of float
        Of the case, rad/s and m/s².
    """
    C_vb, lever = mounting[:3], mounting[3]
    wx = C_vb[0, 0] * rates[0] + C_vb[0, 1] * rates[1] + C_vb[0, 2] * rates[2] - x[Ix.GYRO_X]
    wy = C_vb[1, 0] * rates[0] + C_vb[1, 1] * rates[1] + C_vb[1, 2] * rates[2] - x[Ix.GYRO_Y]
    wz = C_vb[2, 0] * rates[0] + C_vb[2, 1] * rates[1] + C_vb[2, 2] * rates[2] - x[Ix.GYRO_Z]
    cx = C_vb[0, 0] * forces[0] + C_vb[0, 1] * forces[1] + C_vb[0, 2] * forces[2]
    cy = C_vb[1, 0] * forces[0] + C_vb[1, 1] * forces[1] + C_vb[1, 2] * forces[2]
    cz = C_vb[2, 0] * forces[0] + C_vb[2, 1] * forces[1] + C_vb[2, 2] * forces[2]
    turned = x[Ix.TURNED]
    fx = cx - turned * cy - x[Ix.FORCE_X] + lever[0] * (wz * wz + wy * wy)
    fy = cy + turned * cx - x[Ix.FORCE_Y] + lever[1] * (wz * wz + wx * wx)
    sin_r, cos_r = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sin_p, cos_p = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    level = sin_r * wy + cos_r * wz
    lasted_s: float = sums[Sum.TIME] + dt_s
    sums[Sum.TIME] = lasted_s
    sums[Sum.COUNT] += 1.0
    sums[Sum.RATE_X] += wx
    sums[Sum.RATE_Y] += wy
    sums[Sum.RATE_Z] += wz
    sums[Sum.FORCE_X] += fx
    sums[Sum.FORCE_Y] += fy
    sums[Sum.FORCE_Z] += cz
    if standing[0] > 0.5:
        return lasted_s
    x[Ix.YAW] += dt_s * level / cos_p
    x[Ix.PITCH] += dt_s * (cos_r * wy - sin_r * wz)
    x[Ix.ROLL] += dt_s * (wx + sin_p / cos_p * level)
    change = fx + GRAVITY * sin_p
    x[Ix.WAY] += dt_s * (x[Ix.SPEED] + 0.5 * dt_s * change)
    x[Ix.SPEED] += dt_s * change
    return lasted_s


@compiled
def predict(x: Array, P: Array, mean: Array, noise: Array, standing: bool, work: Array) -> None:
    """P ← F P Fᵀ + Q over an epoch whose means are `mean` (rows of `Sum`; TIME is its length)."""
    n, T = x.shape[0], mean[Sum.TIME]
    wy, wz = mean[Sum.RATE_Y], mean[Sum.RATE_Z]
    fy = mean[Sum.FORCE_Y]
    if not standing:
        F = work[:n]
        F[:] = 0.0
        for i in range(n):
            F[i, i] = 1.0
        F[Ix.WAY, Ix.SPEED] = T
        F[Ix.SPEED, Ix.PITCH] = T * GRAVITY
        F[Ix.SPEED, Ix.FORCE_X] = -T
        F[Ix.SPEED, Ix.TURNED] = -T * fy
        F[Ix.YAW, Ix.GYRO_Z] = -T
        F[Ix.YAW, Ix.GYRO_Y] = -T * x[Ix.ROLL]
        F[Ix.YAW, Ix.ROLL] = T * wy
        F[Ix.PITCH, Ix.GYRO_Y] = -T
        F[Ix.PITCH, Ix.GYRO_Z] = T * x[Ix.ROLL]
        F[Ix.PITCH, Ix.ROLL] = -T * wz
        F[Ix.ROLL, Ix.GYRO_X] = -T
        F[Ix.ROLL, Ix.GYRO_Z] = -T * x[Ix.PITCH]
        F[Ix.ROLL, Ix.PITCH] = T * wz
        half = work[n : 2 * n]
        for i in range(n):
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += F[i, k] * P[k, j]
                half[i, j] = total
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    total += half[i, k] * F[j, k]
                P[i, j] = total
                P[j, i] = total
        force, gyro = noise[Noise.FORCE], noise[Noise.GYRO]
        tilt = gyro * gyro + PITCH_STD_RAD_RTS * PITCH_STD_RAD_RTS
        P[Ix.SPEED, Ix.SPEED] += T * force * force
        P[Ix.YAW, Ix.YAW] += T * gyro * gyro
        P[Ix.PITCH, Ix.PITCH] += T * tilt
        P[Ix.ROLL, Ix.ROLL] += T * tilt
    walk = T * noise[Noise.GYRO_WALK] * noise[Noise.GYRO_WALK]
    for i in range(Ix.GYRO_X, Ix.GYRO_Z + 1):
        P[i, i] += walk
    for i in range(Ix.FORCE_X, Ix.FORCE_Y + 1):
        P[i, i] += T * noise[Noise.FORCE_WALK] * noise[Noise.FORCE_WALK]


@compiled
def update(x: Array, P: Array, H: Array, y: float, R: float, gate: float) -> float:
    """Take a scalar measurement; the innovation's square by its variance, negative if refused."""
    n = x.shape[0]
    PH = H[1]
    S = R
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * H[0, j]
        PH[i] = total
    for i in range(n):
        S += H[0, i] * PH[i]
    distance = y * y / S
    if distance > gate * gate:
        return -distance
    for i in range(n):
        x[i] += PH[i] / S * y
        for j in range(n):
            P[i, j] -= PH[i] * PH[j] / S
    for i in range(n):
        for j in range(i):
            even = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = even
            P[j, i] = even
    return distance


@compiled
def take_curve(x: Array, P: Array, mean: Array, H: Array) -> None:
    """Take the lateral force of an epoch: f_y = v ω_z + g cos θ sin φ, and what turns x mixes in.

    Bodies sway with the speed, and one in its springs leans further than a curve says.
    """
    v, wz = x[Ix.SPEED], mean[Sum.RATE_Z]
    H[:] = 0.0
    H[0, Ix.SPEED] = wz
    H[0, Ix.GYRO_Z] = -v
    H[0, Ix.ROLL] = GRAVITY
    H[0, Ix.FORCE_Y] = 1.0
    H[0, Ix.TURNED] = -mean[Sum.FORCE_X]
    predicted = v * wz + GRAVITY * math.cos(x[Ix.PITCH]) * math.sin(x[Ix.ROLL])
    std = SWAY_STD_MPS2 * (1.0 + 0.1 * abs(v))
    update(x, P, H, mean[Sum.FORCE_Y] - predicted, std * std, 4.0)


@compiled
def take_stand(x: Array, P: Array, mean: Array, H: Array) -> None:
    """Take an epoch of standing: no speed, no rate, and the force is gravity's."""
    H[:] = 0.0
    H[0, Ix.SPEED] = 1.0
    update(x, P, H, -x[Ix.SPEED], STANDING_STD_MPS * STANDING_STD_MPS, 1e9)
    R = STANDING_RATE_STD_RADPS * STANDING_RATE_STD_RADPS
    for k in range(3):
        H[:] = 0.0
        H[0, Ix.GYRO_X + k] = 1.0
        update(x, P, H, mean[Sum.RATE_X + k], R, 6.0)
    R = LEVEL_STD_MPS2 * LEVEL_STD_MPS2
    H[:] = 0.0
    H[0, Ix.PITCH] = -GRAVITY
    H[0, Ix.FORCE_X] = 1.0
    update(x, P, H, mean[Sum.FORCE_X] + GRAVITY * math.sin(x[Ix.PITCH]), R, 1e9)
    H[:] = 0.0
    H[0, Ix.ROLL] = GRAVITY
    H[0, Ix.FORCE_Y] = 1.0
    predicted = GRAVITY * math.cos(x[Ix.PITCH]) * math.sin(x[Ix.ROLL])
    update(x, P, H, mean[Sum.FORCE_Y] - predicted, R, 1e9)


@compiled
def take_speed(x: Array, P: Array, H: Array, speed_mps: float, std_mps: float) -> float:
    """Take the wheels' speed at this instant; negative where it is refused."""
    H[:] = 0.0
    H[0, Ix.SPEED] = 1.0
    return update(x, P, H, speed_mps - x[Ix.SPEED], std_mps * std_mps, 5.0)
