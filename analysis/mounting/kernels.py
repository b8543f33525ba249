"""Forward filter and backward smoother over the nodes of a ride: a step of a Gauss-Newton search.

The model is linearised along a whole trajectory (`Point`); the filter's states are its errors. The
trajectory need not obey the equations of motion: what it misses from node to node drives the
errors' mean. The smoother is Bryson's and Frazier's, which inverts no covariance.
docs/theory.md, section 19.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.mounting.drive import Drive
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
    Arms,
    Noise,
    Point,
)
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]

SIDE, UP, ROLL, FIX_VELOCITY, FIX_PLACE, WHEEL, STILL, STILL_FORCE, STILL_RATE = range(9)
"""Kinds of measurement."""
KINDS = 9


class Log(NamedTuple):
    """All scalar measurements in the order of their use, and the prediction at each node."""

    kind: NDArray[np.int64]
    node: NDArray[np.int64]
    innovation: Array
    variance: Array
    """Of the innovation."""
    H: Array
    K: Array
    x: Array
    """(n, SIZE), before the measurements of the node."""
    P: Array
    """(n, SIZE, SIZE)."""


class State(NamedTuple):
    """What a pass carries along; its arrays are written to."""

    x: Array
    P: Array
    H: Array
    """One row, used again and again."""
    used: NDArray[np.int64]
    """(1,): measurements so far."""


@compiled
def rotation(vector: Array) -> Array:
    """Exp of a rotation vector."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle > 1e-8:
        a, b = math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2
    else:
        a, b = 1.0, 0.5
    x, y, z = vector[0], vector[1], vector[2]
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    C[1, 0], C[1, 1], C[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    C[2, 0], C[2, 1], C[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    return C


@compiled
def _times(C: Array, v: Array) -> Array:
    out = np.empty(3)
    for i in range(3):
        out[i] = C[i, 0] * v[0] + C[i, 1] * v[1] + C[i, 2] * v[2]
    return out


@compiled
def _product(A: Array, B: Array) -> Array:
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return out


@compiled
def _against(A: Array, B: Array) -> Array:
    """A Bᵀ."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
    return out


@compiled
def _cross_row(row: Array, v: Array, out: Array) -> None:
    """row · [v]×, into `out`: what a turn by θ does to row · v is −row·[v]×·θ."""
    out[0] = row[1] * v[2] - row[2] * v[1]
    out[1] = row[2] * v[0] - row[0] * v[2]
    out[2] = row[0] * v[1] - row[1] * v[0]


class Model(NamedTuple):
    """What is measured, and what is known of it."""

    drive: Drive
    noise: Noise
    arms: Arms
    force_l: Array
    """(n, 3): specific force in `l` from each node to the next, as the trajectory has it. What an
    error of attitude does to velocity is told by this and not by the reading: noise of a reading
    would count as motion, and motion is what tells yaw."""
    limit: float
    """Deviations beyond which fixes and wheels count as Huber says; 0: all count alike."""


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
def _step(k: int, model: Model, point: Point) -> Step:
    drive, noise = model.drive, model.noise
    dt = drive.dt_s
    A, B, G = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    qv, qa = np.zeros((3, 3)), np.zeros((3, 3))
    still = drive.standing[k] and drive.standing[k + 1]
    speed = 0.0
    if not still:
        omega = drive.inertial.omega_b[k] - point.gyro_bias[k]
        C = _product(point.C_lb[k], rotation(omega * (dt / 2)))
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
    return Step(A, B, G, _product(A, G) * 0.5, qv, qa, keep_fix, keep_cross, still)


@compiled
def _drift(k: int, drive: Drive, point: Point, step: Step, out: Array) -> None:
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
        C = _product(point.C_lb[k], rotation(omega * (dt / 2)))
        f = _times(C, drive.inertial.f_b[k] - point.accel_bias[k])
        for i in range(3):
            gained = (f[i] - drive.gravity_mps2 * drive.up_l[k, i]) * dt
            way = (point.vel_l[k, i] + gained / 2) * dt
            out[POSITION + i] = point.p_l[k, i] + way - point.p_l[k + 1, i]
            out[VELOCITY + i] = point.vel_l[k, i] + gained - point.vel_l[k + 1, i]
        turned = _product(C, rotation(omega * (dt / 2)))
    R = _against(turned, point.C_lb[k + 1])
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
def _rows(P: Array, step: Step, dt: float) -> None:
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
def _predict(state: State, step: Step, noise: Noise, dt: float, drift: Array) -> None:
    P = state.P
    _rows(P, step, dt)
    across = np.ascontiguousarray(P.T)
    _rows(across, step, dt)
    P[:] = across
    _rows(state.x.reshape(SIZE, 1), step, dt)
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
def _update(
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
def _constraints(k: int, model: Model, point: Point, state: State, log: Log) -> None:
    """No speed to the side or upwards at the pivot; upright but for the track's cross-level."""
    drive, noise, arms, H = model.drive, model.noise, model.arms, state.H
    C_vb = point.C_vb
    C_vl = _against(C_vb, point.C_lb[k])
    v = point.vel_l[k]
    u = _times(C_vl, v)
    before = k - 1 if k > 0 else 0
    after = k if k < len(drive.standing) - 1 else k - 1
    mean = (drive.inertial.omega_b[before] + drive.inertial.omega_b[after]) / 2
    omega = _times(C_vb, mean - point.gyro_bias[k])
    x = arms.pivot_m[0] - point.constants[1]
    y, z = arms.pivot_m[1], arms.pivot_m[2]
    if not drive.standing[k]:
        left = u[1] + omega[2] * x - omega[0] * z
        H[VELOCITY : VELOCITY + 3] = C_vl[1]
        _cross_row(C_vl[1], v, H[ATTITUDE : ATTITUDE + 3])
        H[MOUNTING], H[MOUNTING + 2] = -u[2], u[0]
        H[PIVOT] = -omega[2]
        for i in range(3):
            H[GYRO_BIAS + i] = C_vb[0, i] * z - C_vb[2, i] * x
        _update(state, log, (SIDE, k), -left, noise.side_mps**2, 0.0)
        up = u[2] + omega[0] * y - omega[1] * x
        H[VELOCITY : VELOCITY + 3] = C_vl[2]
        _cross_row(C_vl[2], v, H[ATTITUDE : ATTITUDE + 3])
        H[MOUNTING], H[MOUNTING + 1] = u[1], -u[0]
        H[PIVOT] = omega[1]
        for i in range(3):
            H[GYRO_BIAS + i] = C_vb[1, i] * x - C_vb[0, i] * y
        _update(state, log, (UP, k), -up, noise.up_mps**2, 0.0)
        wheel = drive.wheel_mps[k]
        if not math.isnan(wheel):
            scale = 1 + point.constants[0]
            along = u[0] + omega[1] * z - omega[2] * y
            for i in range(3):
                H[VELOCITY + i] = C_vl[0, i] * scale
            _cross_row(C_vl[0], v, H[ATTITUDE : ATTITUDE + 3])
            H[WHEEL_SCALE] = along
            _update(
                state, log, (WHEEL, k), wheel - scale * along, drive.wheel_std_mps**2, model.limit
            )
    g = _times(C_vl, drive.up_l[k])
    _cross_row(C_vl[1], drive.up_l[k], H[ATTITUDE : ATTITUDE + 3])
    H[MOUNTING], H[MOUNTING + 2] = -g[2], g[0]
    H[CROSS_LEVEL] = -1.0
    lean = noise.lean_rad_per_mps2 * u[0] * omega[2]
    R = noise.roll_rad**2 + lean**2
    _update(state, log, (ROLL, k), point.cross_level[k] - g[1], R, 0.0)


@compiled
def _still(k: int, model: Model, point: Point, state: State, log: Log) -> None:
    """At a stand: no speed, and what the sensors read is bias and gravity."""
    drive, noise, H = model.drive, model.noise, state.H
    for i in range(3):
        H[VELOCITY + i] = 1.0
        _update(state, log, (STILL, k), -point.vel_l[k, i], noise.still_mps**2, 0.0)
    if k == len(drive.standing) - 1 or not drive.standing[k + 1]:
        return
    C, up, g = point.C_lb[k], drive.up_l[k], drive.gravity_mps2
    for i in range(3):
        H[GYRO_BIAS + i] = 1.0
        residual = drive.inertial.omega_b[k, i] - point.gyro_bias[k, i]
        _update(state, log, (STILL_RATE, k), residual, noise.gyro[i] ** 2 / drive.dt_s, 0.0)
        # f_b = C_blg up: Exp(−θ) up = up + up × θ
        column = np.array([C[0, i], C[1, i], C[2, i]]) * g
        _cross_row(column, up, H[ATTITUDE : ATTITUDE + 3])
        H[ACCEL_BIAS + i] = 1.0
        felt = column[0] * up[0] + column[1] * up[1] + column[2] * up[2]
        residual = drive.inertial.f_b[k, i] - point.accel_bias[k, i] - felt
        _update(state, log, (STILL_FORCE, k), residual, noise.accel[i] ** 2 / drive.dt_s, 0.0)


@compiled
def _fix(row: int, model: Model, point: Point, state: State, log: Log) -> None:
    """Position and velocity of the antenna, a little later than the node."""
    drive, arms, limit, H = model.drive, model.arms, model.limit, state.H
    fixes = drive.fixes
    k = fixes.node[row]
    late = fixes.late_s[row] + point.constants[2]
    C_lb = point.C_lb[k]
    C_lv = _against(C_lb, point.C_vb)
    arm = _times(C_lv, arms.antenna_m)
    step = k if k < len(drive.standing) - 1 else k - 1
    omega = drive.inertial.omega_b[step] - point.gyro_bias[k]
    omega_l = _times(C_lb, omega)
    swing = np.empty(3)
    _cross_row(omega_l, arm, swing)  # ω × arm
    acc = np.zeros(3)
    if not (drive.standing[step] and drive.standing[step + 1]):
        acc = _times(C_lb, drive.inertial.f_b[step] - point.accel_bias[k])
        for i in range(3):
            acc[i] -= drive.gravity_mps2 * drive.up_l[k, i]
    v = point.vel_l[k]
    for i in range(3):
        if not math.isnan(fixes.vel_l[row, i]):
            H[VELOCITY + i] = 1.0
            H[DELAY] = acc[i]
            residual = fixes.vel_l[row, i] - v[i] - swing[i] - late * acc[i]
            _update(state, log, (FIX_VELOCITY, k), residual, fixes.vel_std_mps[row, i] ** 2, limit)
    unit = np.zeros(3)
    for i in range(3):
        if not math.isnan(fixes.p_l[row, i]):
            unit[:] = 0.0
            unit[i] = 1.0
            H[POSITION + i] = 1.0
            H[VELOCITY + i] = late
            H[FIX_ERROR + i] = 1.0
            H[DELAY] = v[i] + swing[i]
            _cross_row(unit, arm, H[ATTITUDE : ATTITUDE + 3])
            _cross_row(C_lv[i], arms.antenna_m, H[MOUNTING : MOUNTING + 3])
            for a in range(3):
                H[ATTITUDE + a] = -H[ATTITUDE + a]
            residual = fixes.p_l[row, i] - point.p_l[k, i] - arm[i] - point.fix_error[k, i]
            residual -= late * (v[i] + swing[i] + late * acc[i] / 2)
            _update(state, log, (FIX_PLACE, k), residual, fixes.p_std_m[row, i] ** 2, limit)


@compiled
def forward(model: Model, point: Point, state: State, log: Log) -> None:
    """Filter the errors of a trajectory; `state` ends at the last node, `log` is filled."""
    drive, noise = model.drive, model.noise
    drift = np.zeros(SIZE)
    fix, fixes = 0, len(drive.fixes.node)
    last = len(drive.standing) - 1
    for k in range(last + 1):
        log.x[k] = state.x
        log.P[k] = state.P
        _constraints(k, model, point, state, log)
        if drive.standing[k]:
            _still(k, model, point, state, log)
        while fix < fixes and drive.fixes.node[fix] == k:
            _fix(fix, model, point, state, log)
            fix += 1
        if k < last:
            step = _step(k, model, point)
            _drift(k, drive, point, step, drift)
            _predict(state, step, noise, drive.dt_s, drift)


@compiled
def backward(model: Model, point: Point, log: Log, used: int) -> Array:
    """Smooth the errors of a trajectory; (n, SIZE)."""
    drive = model.drive
    count = len(drive.standing)
    smoothed = np.empty((count, SIZE))
    costate = np.zeros(SIZE)
    at = used
    for k in range(count - 1, -1, -1):
        while at > 0 and log.node[at - 1] == k:
            at -= 1
            pull = log.innovation[at] / abs(log.variance[at])
            for i in range(SIZE):
                pull += log.K[at, i] * costate[i]
            for i in range(SIZE):
                costate[i] -= log.H[at, i] * pull
        for i in range(SIZE):
            total = log.x[k, i]
            for j in range(SIZE):
                total -= log.P[k, i, j] * costate[j]
            smoothed[k, i] = total
        if k > 0:
            _transposed(costate, _step(k - 1, model, point), drive.dt_s)
    return smoothed


@compiled
def _transposed(costate: Array, step: Step, dt: float) -> None:
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
