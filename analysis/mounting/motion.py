"""From node to node: strapdown navigation of the case, its errors and their noise.

docs/theory.md, section 19.2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.mounting.drive import Drive
from tramstream.analysis.mounting.passes import Model, State
from tramstream.analysis.mounting.states import (
    ACCEL_BIAS,
    ATTITUDE,
    CROSS_LEVEL,
    FIX_ERROR,
    GYRO_BIAS,
    POSITION,
    SIZE,
    VELOCITY,
    Noise,
    Point,
)
from tramstream.analysis.mounting.turns import against, product, rotation, times
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]


class Step(NamedTuple):
    """From a node to the next: blocks of the transition, and noise."""

    from_attitude: Array
    """Velocity out of attitude, (3, 3)."""
    from_accel_bias: Array
    """Velocity out of the accelerometers' bias."""
    from_gyro_bias: Array
    """Attitude out of the gyroscopes' bias."""
    through_attitude: Array
    """Velocity out of the gyroscopes' bias: what it turns until the middle of the step."""
    velocity_noise: Array
    attitude_noise: Array
    keep_fix: float
    keep_cross: float
    still: bool


@compiled
def step_from(k: int, model: Model, point: Point) -> Step:
    drive, noise = model.drive, model.noise
    dt = drive.dt_s
    A, B, G = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    qv, qa = np.zeros((3, 3)), np.zeros((3, 3))
    still = drive.standing[k] and drive.standing[k + 1]
    speed = 0.0
    if not still:
        omega = drive.inertial.omega_b[k] - point.gyro_bias[k]
        C = product(point.C_lb[k], rotation(omega * (dt / 2)))
        f = model.force_l[k] * dt
        A[0, 1], A[0, 2], A[1, 2] = f[2], -f[1], f[0]
        A[1, 0], A[2, 0], A[2, 1] = -f[2], f[1], -f[0]
        for i in range(3):
            for j in range(3):
                B[i, j] = -C[i, j] * dt
                G[i, j] = -C[i, j] * dt
                for a in range(3):
                    qv[i, j] += C[i, a] * C[j, a] * noise.accel[a] ** 2 * dt
                    qa[i, j] += C[i, a] * C[j, a] * noise.gyro[a] ** 2 * dt
        v = point.vel_l[k]
        speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    keep_fix = math.exp(-dt / noise.fix_error_tau_s)
    keep_cross = math.exp(-speed * dt / noise.cross_level_m)
    return Step(A, B, G, product(A, G) * 0.5, qv, qa, keep_fix, keep_cross, still)


@compiled
def drift_from(k: int, drive: Drive, point: Point, step: Step, out: Array) -> None:
    """By how much the trajectory misses the equations of motion from node k on."""
    dt = drive.dt_s
    out[:] = 0.0
    if step.still:
        for i in range(3):
            out[POSITION + i] = point.p_l[k, i] - point.p_l[k + 1, i]
            out[VELOCITY + i] = point.vel_l[k, i] - point.vel_l[k + 1, i]
        turned = point.C_lb[k]
    else:
        omega = drive.inertial.omega_b[k] - point.gyro_bias[k]
        C = product(point.C_lb[k], rotation(omega * (dt / 2)))
        f = times(C, drive.inertial.f_b[k] - point.accel_bias[k])
        for i in range(3):
            gained = (f[i] - drive.gravity_mps2 * drive.up_l[k, i]) * dt
            way = (point.vel_l[k, i] + gained / 2) * dt
            out[POSITION + i] = point.p_l[k, i] + way - point.p_l[k + 1, i]
            out[VELOCITY + i] = point.vel_l[k, i] + gained - point.vel_l[k + 1, i]
        turned = product(C, rotation(omega * (dt / 2)))
    R = against(turned, point.C_lb[k + 1])
    # Of a small turn; a large one is brought nearer by each pass.
    cosine = min(max((R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2, -1.0), 1.0)
    sine = max(math.sqrt(1 - cosine * cosine), 1e-12)
    scale = math.acos(cosine) / (2 * sine) if sine > 1e-6 else 0.5
    out[ATTITUDE] = (R[2, 1] - R[1, 2]) * scale
    out[ATTITUDE + 1] = (R[0, 2] - R[2, 0]) * scale
    out[ATTITUDE + 2] = (R[1, 0] - R[0, 1]) * scale
    for i in range(3):
        out[ACCEL_BIAS + i] = point.accel_bias[k, i] - point.accel_bias[k + 1, i]
        out[GYRO_BIAS + i] = point.gyro_bias[k, i] - point.gyro_bias[k + 1, i]
        kept = step.keep_fix * point.fix_error[k, i]
        out[FIX_ERROR + i] = kept - point.fix_error[k + 1, i]
    out[CROSS_LEVEL] = step.keep_cross * point.cross_level[k] - point.cross_level[k + 1]


@compiled
def rows_forward(P: Array, step: Step, dt: float) -> None:
    """F P, in place."""
    for j in range(P.shape[1]):
        for i in range(3):
            gained = 0.0
            for a in range(3):
                gained += step.from_attitude[i, a] * P[ATTITUDE + a, j]
                gained += step.from_accel_bias[i, a] * P[ACCEL_BIAS + a, j]
                gained += step.through_attitude[i, a] * P[GYRO_BIAS + a, j]
            if not step.still:
                P[POSITION + i, j] += dt * (P[VELOCITY + i, j] + gained / 2)
                P[VELOCITY + i, j] += gained
            P[FIX_ERROR + i, j] *= step.keep_fix
        for i in range(3):
            turned = P[ATTITUDE + i, j]
            for a in range(3):
                turned += step.from_gyro_bias[i, a] * P[GYRO_BIAS + a, j]
            P[ATTITUDE + i, j] = turned
        P[CROSS_LEVEL, j] *= step.keep_cross


@compiled
def predict(state: State, step: Step, noise: Noise, dt: float, drift: Array) -> None:
    P = state.P
    rows_forward(P, step, dt)
    across = np.ascontiguousarray(P.T)
    rows_forward(across, step, dt)
    P[:] = across
    rows_forward(state.x.reshape(SIZE, 1), step, dt)
    for i in range(SIZE):
        state.x[i] += drift[i]
    for i in range(3):
        for j in range(3):
            P[VELOCITY + i, VELOCITY + j] += step.velocity_noise[i, j]
            P[ATTITUDE + i, ATTITUDE + j] += step.attitude_noise[i, j]
        P[ACCEL_BIAS + i, ACCEL_BIAS + i] += noise.accel_walk**2 * dt
        P[GYRO_BIAS + i, GYRO_BIAS + i] += noise.gyro_walk**2 * dt
        fresh = (1 - step.keep_fix**2) * noise.fix_error_m[i] ** 2
        P[FIX_ERROR + i, FIX_ERROR + i] += fresh
    P[CROSS_LEVEL, CROSS_LEVEL] += (1 - step.keep_cross**2) * noise.cross_level_rad**2
    for i in range(SIZE):
        for j in range(i):
            P[i, j] = P[j, i]


@compiled
def transposed(costate: Array, step: Step, dt: float) -> None:
    """Fᵀ λ, in place."""
    turned = np.empty(3)
    if not step.still:
        for i in range(3):
            costate[VELOCITY + i] += dt * costate[POSITION + i]
        for a in range(3):
            attitude, accel, gyro = 0.0, 0.0, 0.0
            for i in range(3):
                # The way of a step has half of what the step gains in speed.
                gained = costate[VELOCITY + i] - dt / 2 * costate[POSITION + i]
                attitude += step.from_attitude[i, a] * gained
                accel += step.from_accel_bias[i, a] * gained
                gyro += step.through_attitude[i, a] * gained
                gyro += step.from_gyro_bias[i, a] * costate[ATTITUDE + i]
            costate[ACCEL_BIAS + a] += accel
            costate[GYRO_BIAS + a] += gyro
            turned[a] = attitude
        for a in range(3):
            costate[ATTITUDE + a] += turned[a]
    for i in range(3):
        costate[FIX_ERROR + i] *= step.keep_fix
    costate[CROSS_LEVEL] *= step.keep_cross
