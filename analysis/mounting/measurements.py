"""What is measured at a node: constraints of a vehicle, stands, fixes; each with its row.

docs/theory.md, section 19.2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.mounting.passes import Log, Model, State
from tramstream.analysis.mounting.states import (
    ACCEL_BIAS,
    ATTITUDE,
    CROSS_LEVEL,
    DELAY,
    FIX_ERROR,
    GYRO_BIAS,
    MOUNTING,
    PIVOT,
    POSITION,
    SIZE,
    VELOCITY,
    WHEEL_SCALE,
    Point,
)
from tramstream.analysis.mounting.turns import against, cross_row, times
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]

SIDE, UP, ROLL, FIX_VELOCITY, FIX_PLACE, WHEEL, STILL, STILL_FORCE, STILL_RATE = range(9)
"""Kinds of measurement."""
KINDS = 9


@compiled
def update(
    state: State, log: Log, of: tuple[int, int], residual: float, R: float, limit: float
) -> None:
    """Use one scalar (its kind and node), whose row stands in `state.H`, and clear that row."""
    x, P, H = state.x, state.P, state.H
    at = state.used[0]
    state.used[0] = at + 1
    PH = log.K[at]
    PH[:] = 0.0
    y, S = residual, R
    for j in range(SIZE):
        if H[j] != 0.0:
            y -= H[j] * x[j]
            for i in range(SIZE):
                PH[i] += P[j, i] * H[j]
    for j in range(SIZE):
        log.H[at, j] = H[j]
        S += H[j] * PH[j]
        H[j] = 0.0
    log.kind[at], log.node[at], log.innovation[at] = of[0], of[1], y
    log.variance[at] = S
    if limit > 0.0 and y * y > limit * limit * S:
        S = abs(y) * math.sqrt(S) / limit
        log.variance[at] = -S  # the sign tells that it was held back
    for i in range(SIZE):
        gain = PH[i] / S
        x[i] += gain * y
        for j in range(SIZE):
            P[i, j] -= gain * PH[j]
    for i in range(SIZE):
        PH[i] /= S


@compiled
def use_constraints(k: int, model: Model, point: Point, state: State, log: Log) -> None:
    """No speed to the side or upwards at the pivot; upright but for the track's cross-level."""
    drive, noise, arms, H = model.drive, model.noise, model.arms, state.H
    C_vb = point.C_vb
    C_vl = against(C_vb, point.C_lb[k])
    v = point.vel_l[k]
    u = times(C_vl, v)
    before = k - 1 if k > 0 else 0
    after = k if k < len(drive.standing) - 1 else k - 1
    mean = (drive.inertial.omega_b[before] + drive.inertial.omega_b[after]) / 2
    omega = times(C_vb, mean - point.gyro_bias[k])
    x = arms.pivot_m[0] - point.constants[1]
    y, z = arms.pivot_m[1], arms.pivot_m[2]
    if not drive.standing[k]:
        left = u[1] + omega[2] * x - omega[0] * z
        H[VELOCITY : VELOCITY + 3] = C_vl[1]
        cross_row(C_vl[1], v, H[ATTITUDE : ATTITUDE + 3])
        H[MOUNTING], H[MOUNTING + 2] = -u[2], u[0]
        H[PIVOT] = -omega[2]
        for i in range(3):
            H[GYRO_BIAS + i] = C_vb[0, i] * z - C_vb[2, i] * x
        update(state, log, (SIDE, k), -left, noise.side_mps**2, 0.0)
        up = u[2] + omega[0] * y - omega[1] * x
        H[VELOCITY : VELOCITY + 3] = C_vl[2]
        cross_row(C_vl[2], v, H[ATTITUDE : ATTITUDE + 3])
        H[MOUNTING], H[MOUNTING + 1] = u[1], -u[0]
        H[PIVOT] = omega[1]
        for i in range(3):
            H[GYRO_BIAS + i] = C_vb[1, i] * x - C_vb[0, i] * y
        update(state, log, (UP, k), -up, noise.up_mps**2, 0.0)
        wheel = drive.wheel_mps[k]
        if not math.isnan(wheel):
            scale = 1 + point.constants[0]
            along = u[0] + omega[1] * z - omega[2] * y
            for i in range(3):
                H[VELOCITY + i] = C_vl[0, i] * scale
            cross_row(C_vl[0], v, H[ATTITUDE : ATTITUDE + 3])
            H[WHEEL_SCALE] = along
            update(
                state, log, (WHEEL, k), wheel - scale * along, drive.wheel_std_mps**2, model.limit
            )
    g = times(C_vl, drive.up_l[k])
    cross_row(C_vl[1], drive.up_l[k], H[ATTITUDE : ATTITUDE + 3])
    H[MOUNTING], H[MOUNTING + 2] = -g[2], g[0]
    H[CROSS_LEVEL] = -1.0
    lean = noise.lean_rad_per_mps2 * u[0] * omega[2]
    R = noise.roll_rad**2 + lean**2
    update(state, log, (ROLL, k), point.cross_level[k] - g[1], R, 0.0)


@compiled
def use_stand(k: int, model: Model, point: Point, state: State, log: Log) -> None:
    """At a stand: no speed, and what the sensors read is bias and gravity."""
    drive, noise, H = model.drive, model.noise, state.H
    for i in range(3):
        H[VELOCITY + i] = 1.0
        update(state, log, (STILL, k), -point.vel_l[k, i], noise.still_mps**2, 0.0)
    if k == len(drive.standing) - 1 or not drive.standing[k + 1]:
        return
    C, up, g = point.C_lb[k], drive.up_l[k], drive.gravity_mps2
    for i in range(3):
        H[GYRO_BIAS + i] = 1.0
        residual = drive.inertial.omega_b[k, i] - point.gyro_bias[k, i]
        update(state, log, (STILL_RATE, k), residual, noise.gyro[i] ** 2 / drive.dt_s, 0.0)
        # f_b = C_blg up: Exp(−θ) up = up + up × θ
        column = np.array([C[0, i], C[1, i], C[2, i]]) * g
        cross_row(column, up, H[ATTITUDE : ATTITUDE + 3])
        H[ACCEL_BIAS + i] = 1.0
        felt = column[0] * up[0] + column[1] * up[1] + column[2] * up[2]
        residual = drive.inertial.f_b[k, i] - point.accel_bias[k, i] - felt
        update(state, log, (STILL_FORCE, k), residual, noise.accel[i] ** 2 / drive.dt_s, 0.0)


@compiled
def use_fix(row: int, model: Model, point: Point, state: State, log: Log) -> None:
    """Position and velocity of the antenna, a little later than the node."""
    drive, arms, limit, H = model.drive, model.arms, model.limit, state.H
    fixes = drive.fixes
    k = fixes.node[row]
    late = fixes.late_s[row] + point.constants[2]
    C_lb = point.C_lb[k]
    C_lv = against(C_lb, point.C_vb)
    arm = times(C_lv, arms.antenna_m)
    step = k if k < len(drive.standing) - 1 else k - 1
    omega = drive.inertial.omega_b[step] - point.gyro_bias[k]
    omega_l = times(C_lb, omega)
    swing = np.empty(3)
    cross_row(omega_l, arm, swing)  # ω × arm
    acc = np.zeros(3)
    if not (drive.standing[step] and drive.standing[step + 1]):
        acc = times(C_lb, drive.inertial.f_b[step] - point.accel_bias[k])
        for i in range(3):
            acc[i] -= drive.gravity_mps2 * drive.up_l[k, i]
    v = point.vel_l[k]
    for i in range(3):
        if not math.isnan(fixes.vel_l[row, i]):
            H[VELOCITY + i] = 1.0
            H[DELAY] = acc[i]
            residual = fixes.vel_l[row, i] - v[i] - swing[i] - late * acc[i]
            update(state, log, (FIX_VELOCITY, k), residual, fixes.vel_std_mps[row, i] ** 2, limit)
    unit = np.zeros(3)
    for i in range(3):
        if not math.isnan(fixes.p_l[row, i]):
            unit[:] = 0.0
            unit[i] = 1.0
            H[POSITION + i] = 1.0
            H[VELOCITY + i] = late
            H[FIX_ERROR + i] = 1.0
            H[DELAY] = v[i] + swing[i]
            cross_row(unit, arm, H[ATTITUDE : ATTITUDE + 3])
            cross_row(C_lv[i], arms.antenna_m, H[MOUNTING : MOUNTING + 3])
            for a in range(3):
                H[ATTITUDE + a] = -H[ATTITUDE + a]
            residual = fixes.p_l[row, i] - point.p_l[k, i] - arm[i] - point.fix_error[k, i]
            residual -= late * (v[i] + swing[i] + late * acc[i] / 2)
            update(state, log, (FIX_PLACE, k), residual, fixes.p_std_m[row, i] ** 2, limit)
