"""What goes into the model `tram` and what comes out, compiled: axes of the case, the origin.

Inside, positions are the pivot's and inertial readings lie in the vehicle's axes.
"""

from __future__ import annotations

import math

import numpy as np

from tramstream.estimation import localiser
from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.localiser import ACCELERATION, LEVEL_ERROR, LEVEL_STD, YAW_RATE
from tramstream.processors.tram_model.map_shift import weigh_map
from tramstream.processors.tram_model.records import (
    INERTIAL,
    MEMORY,
    PARAMETERS,
    Inertial,
    Memory,
    Parameters,
    Z,
)
from tramstream.processors.tram_model.states import SIZE, Ix
from tramstream.processors.tram_model.update import columns_of
from tramstream.proto.sync_pb2 import ImuMean

FASTEST_RADPS = 4.0
"""No vehicle turns faster; a reading beyond is none."""
FASTEST_YAW_RADPS = 2.0
"""No vehicle turns faster about its vertical axis, which a jolt does not turn; chosen by hand."""
HARDEST_MPS2 = 60.0
"""No vehicle is pushed harder; a reading beyond is none."""
SMOOTHING_S = 0.1
"""Time constant of the angular rates whose slope is the angular acceleration; chosen by hand."""
STEADY_S = 0.5
"""Time constant of the rates that a row of H is made of; chosen by hand."""
SHAKING_S = 0.3
"""Time constant of what neighbouring rates differ by: a pothole is over after so long."""
STRAIGHT_READINGS = 8.0
"""So many readings in a row on one straight line were not measured: a logger has drawn them through
a gap. The noise of a sensor leaves the line with the first; chosen by hand, guarded by
`tests/processors/tram/test_tram_gaps.py`."""
_BEND, _RATE_BEND_RADPS, _FORCE_BEND_MPS2 = 0.02, 2e-5, 3e-3
_LEAST_STEPS = 5.0
IMPOSSIBLE, TAKEN, STUCK = range(3)
"""What becomes of a reading."""
STUCK_READINGS = 25
"""An axis that gives the same number so often in a row does not live. Chosen by hand: a mean of
twenty samples of the ADIS16465 repeats itself once in a hundred, an axis that gives one of two
numbers so often once in 3e7; guarded by `tests/processors/tram/test_liveness.py`."""
COARSE, COARSE_READINGS = 4.0, 300.0
"""A coarse sensor repeats itself by nature: it may so many times as long as it has and lived, and
no longer than this; chosen by hand."""
ALIVE_READINGS = 100
"""It lives again when for so many readings no axis has repeated itself for long; chosen by hand."""
_OF_MOTION = localiser.COVARIANCE
_MOVED = columns_of(Ix.SPEED, Ix.YAW, Ix.GNSS_DELAY, Ix.PIVOT)


def scalars_of(mean: ImuMean) -> tuple[float, float, float, float, float, float]:
    """Give the numbers of a mean in the order in which `take_reading` wants them."""
    return (
        mean.gyro_x_radps,
        mean.gyro_y_radps,
        mean.gyro_z_radps,
        mean.accel_x_mps2,
        mean.accel_y_mps2,
        mean.accel_z_mps2,
    )


@compiled
def take_reading(
    inertial: Array,
    C_vb: Array,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    dt: float,
) -> int:
    """Turn a reading of the case into the vehicle's axes, and remember the one before.

    One that cannot be, or is of a sensor that does not live, moves nothing; gives `IMPOSSIBLE`,
    `STUCK` or `TAKEN`.

    Parameters
    ----------
    inertial : record
        One `Inertial`.
    C_vb : ndarray, shape (3, 3)
    gx, gy, gz, ax, ay, az : float
        Angular rate, rad/s, and specific force, m/s², of the case.
    dt : float
        Between the two readings, s; 0 if there is none before.
    """
    i = inertial.view(INERTIAL)[0]
    rate, force = np.empty(3), np.empty(3)
    for k in range(3):
        rate[k] = C_vb[k, 0] * gx + C_vb[k, 1] * gy + C_vb[k, 2] * gz
        force[k] = C_vb[k, 0] * ax + C_vb[k, 1] * ay + C_vb[k, 2] * az
    i.straight = i.straight + 1.0 if _goes_straight_on(i, rate, force) else 0.0
    # A line may be level in an axis, which does not make that axis stuck.
    if i.straight < STRAIGHT_READINGS and _repeats(i, gx, gy, gz, ax, ay, az):
        return STUCK
    # Comparisons with what is no number are false.
    turns = abs(gx) + abs(gy) + abs(gz) < FASTEST_RADPS
    turning = abs(C_vb[Z, 0] * gx + C_vb[Z, 1] * gy + C_vb[Z, 2] * gz) < FASTEST_YAW_RADPS
    if not (turns and turning and abs(ax) + abs(ay) + abs(az) < HARDEST_MPS2):
        return IMPOSSIBLE
    i.before = i.now
    now = i.now
    for k in range(3):
        now.angular_rate[k], now.specific_force[k] = rate[k], force[k]
        now.angular_acceleration[k] = 0.0
    now.accelerometer = 1.0
    if dt <= 0.0:
        i.before = i.now
        for k in range(3):
            i.smoothed_rate[k] = i.steady_rate[k] = now.angular_rate[k]
            now.rate_scatter[k] = now.force_scatter[k] = 0.0
    _smooth(i, dt)
    return TAKEN


@compiled
def _repeats(i: Inertial, gx: float, gy: float, gz: float, ax: float, ay: float, az: float) -> bool:
    """Take note of which axes give the same number again; whether the sensor does not live.

    The noise of a sensor that lives changes its last digits. An axis that has never given another
    number is not measured, rather than stuck, unless all are like that.
    """
    lives, stuck, all_stuck = True, False, True
    for k, value in enumerate((gx, gy, gz, ax, ay, az)):
        if value == i.read[k]:
            i.repeats[k] += 1.0
        else:
            i.read[k] = value
            i.varied[k] += 1.0
            i.longest[k] = max(i.longest[k], i.repeats[k])
            i.repeats[k] = 0.0
        limit = min(max(STUCK_READINGS, COARSE * i.longest[k]), COARSE_READINGS)
        over = i.repeats[k] >= limit
        lives = lives and (i.varied[k] == 0.0 or COARSE * i.repeats[k] < limit)
        all_stuck = all_stuck and over
        stuck = stuck or (over and i.varied[k] > STUCK_READINGS)
    if stuck or all_stuck or i.stuck > 0.0:
        i.lived = i.lived + 1.0 if lives else 0.0
        i.stuck = 1.0 if i.lived < ALIVE_READINGS else 0.0
    return bool(i.stuck > 0.0)


@compiled
def _goes_straight_on(i: Inertial, rate: Array, force: Array) -> bool:
    """Whether a new reading lies on the line through the two before it.

    All six axes do but for rounding, and one of them changes: what gives the same number again and
    again is no line.
    """
    changes = False
    for k in range(3):
        new, now = rate[k], i.now.angular_rate[k]
        step = abs(new - now)
        if not abs(new - 2.0 * now + i.before.angular_rate[k]) <= _BEND * step + _RATE_BEND_RADPS:
            return False
        changes = changes or step > _LEAST_STEPS * _RATE_BEND_RADPS
        new, now = force[k], i.now.specific_force[k]
        step = abs(new - now)
        if not abs(new - 2.0 * now + i.before.specific_force[k]) <= _BEND * step + _FORCE_BEND_MPS2:
            return False
        changes = changes or step > _LEAST_STEPS * _FORCE_BEND_MPS2
    return changes


@compiled
def _smooth(i: Inertial, dt: float) -> None:
    """Find what acts between the two readings, and what is smoothed over all."""
    before, now, between = i.before, i.now, i.between
    shaking = min(1.0, dt / SHAKING_S)
    for k in range(3):
        between.angular_rate[k] = 0.5 * (before.angular_rate[k] + now.angular_rate[k])
        between.specific_force[k] = 0.5 * (before.specific_force[k] + now.specific_force[k])
    for k in range(3):
        # The difference of two readings would be mostly noise, ten times a lever's worth.
        rising = (between.angular_rate[k] - i.smoothed_rate[k]) / SMOOTHING_S
        i.smoothed_rate[k] += dt * rising
        now.angular_acceleration[k] = between.angular_acceleration[k] = rising
        i.steady_rate[k] += min(1.0, dt / STEADY_S) * (before.angular_rate[k] - i.steady_rate[k])
        turned = now.angular_rate[k] - before.angular_rate[k]
        pushed = now.specific_force[k] - before.specific_force[k]
        now.rate_scatter[k] += shaking * (0.5 * turned * turned - now.rate_scatter[k])
        now.force_scatter[k] += shaking * (0.5 * pushed * pushed - now.force_scatter[k])
        between.rate_scatter[k] = now.rate_scatter[k]
        between.force_scatter[k] = now.force_scatter[k]
    between.accelerometer = 1.0


@compiled
def origin(f: Memory, share: float, facing: bool, motion: Array, covariance: Array) -> None:
    """Give motion and covariance of the vehicle's origin at the true time of the stamp.

    The filter's own position is the pivot's, at the time that the inertial stamps mean: `share` of
    the fixes' delay is theirs. While the heading is not known (`facing`), the position is the
    antenna's, and the true time says nothing of it: it is given as it is.

    Parameters
    ----------
    motion : ndarray, shape (7,)
        Gets the states EAST to YAW.
    covariance : ndarray, shape (7, 7)
    """
    x, P = f.x, f.P
    for i in range(7):
        motion[i] = x[i]
        for j in range(7):
            covariance[i, j] = P[i, j]
    pivot, early = x[Ix.PIVOT], share * x[Ix.GNSS_DELAY]
    if not facing or (pivot == 0.0 and share == 0.0 and P[Ix.PIVOT, Ix.PIVOT] == 0.0):
        return
    cos, sin = math.cos(x[Ix.YAW]), math.sin(x[Ix.YAW])
    v = x[Ix.SPEED]
    ahead = pivot - early * v
    motion[Ix.EAST] += ahead * cos
    motion[Ix.NORTH] += ahead * sin
    # Rows of T beside the unit: how east and north of the origin follow the states.
    T = np.zeros((2, SIZE))
    T[Ix.EAST, Ix.SPEED], T[Ix.EAST, Ix.YAW] = -early * cos, -ahead * sin
    T[Ix.EAST, Ix.GNSS_DELAY], T[Ix.EAST, Ix.PIVOT] = -share * v * cos, cos
    T[Ix.NORTH, Ix.SPEED], T[Ix.NORTH, Ix.YAW] = -early * sin, ahead * cos
    T[Ix.NORTH, Ix.GNSS_DELAY], T[Ix.NORTH, Ix.PIVOT] = -share * v * sin, sin
    for a in range(2):
        for j in range(7):
            moved = 0.0
            for k in _MOVED:
                moved += T[a, k] * P[k, j]
            covariance[a, j] += moved
            if j > 1:
                covariance[j, a] += moved
    for a in range(2):
        for b in range(2):
            moved = 0.0
            for k in _MOVED:
                moved += P[a, k] * T[b, k]
                for j in _MOVED:
                    moved += T[a, k] * P[k, j] * T[b, j]
            covariance[a, b] += moved


@compiled
def fill_estimate(f: Memory, c: Parameters, facing: bool, values: Array) -> None:
    """Fill the values of an estimate (`estimation.localiser`) with the motion of the origin."""
    origin(f, c.clock_share, facing, values[:ACCELERATION], values[_OF_MOTION:].reshape((7, 7)))
    values[ACCELERATION], values[YAW_RATE] = f.acceleration, f.yaw_rate
    values[LEVEL_ERROR] = values[LEVEL_STD] = math.nan


@compiled
def fill_level(f: Memory, c: Parameters, values: Array) -> None:
    """Fill in what the accelerometer shows: θ + ℓ = −f_x/g standing, ℓ = m_θ − b_x/g.

    Fixes and a map move θ and ℓ against each other; the force ties their sum.
    """
    P, per_g = f.P, 1.0 / c.gravity
    if P[Ix.ACCEL_X, Ix.ACCEL_X] <= 0.0:  # without an accelerometer
        return
    values[LEVEL_ERROR] = f.x[Ix.MOUNT_PITCH] - per_g * f.x[Ix.ACCEL_X]
    tilted = P[Ix.PITCH, Ix.PITCH] + P[Ix.MOUNT_PITCH, Ix.MOUNT_PITCH]
    tilted += 2.0 * P[Ix.PITCH, Ix.MOUNT_PITCH]
    biased = P[Ix.PITCH, Ix.ACCEL_X] + P[Ix.MOUNT_PITCH, Ix.ACCEL_X]
    variance = tilted + per_g * (per_g * P[Ix.ACCEL_X, Ix.ACCEL_X] - 2.0 * biased)
    values[LEVEL_STD] = math.sqrt(max(variance, 0.0))


@compiled
def estimate(memory: Array, parameters: Array, facing: bool, values: Array) -> None:
    """Fill the values of an estimate out of the filter's memory; see `origin`."""
    f, c = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0]
    fill_estimate(f, c, facing, values)
    fill_level(f, c, values)
    if facing:
        weigh_map(f, c, values)
