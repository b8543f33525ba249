"""The smoother's passes over a ride until the mounting stands still: batch maximum likelihood.

Each pass linearises the whole ride along the last pass's trajectory, filters forwards and smooths
backwards. The covariance of the mounting is the filter's at the last node: it is constant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from tramstream.analysis.mounting import kernels, measurements
from tramstream.analysis.mounting.drive import Drive
from tramstream.analysis.mounting.passes import Log, Model, State
from tramstream.analysis.mounting.states import (
    ACCEL_BIAS,
    ATTITUDE,
    CROSS_LEVEL,
    FIX_ERROR,
    GYRO_BIAS,
    MOUNTING,
    POSITION,
    SIZE,
    VELOCITY,
    WHEEL_SCALE,
    Arms,
    Noise,
    Point,
    Prior,
    prior_covariance,
)

Array = NDArray[np.float64]

MOST_PASSES = 15
SETTLED_RAD = 3e-6
"""A pass that turns the mounting by less is the last: a hundredth of an angular minute."""
ROBUST_FROM = 3
"""Passes before it see errors of the linearisation, which are no outliers."""
HUBER = 4.0
ADAPTED = (3, 4, 5)
"""Passes after which the constraints' deviations are set by their innovations."""
FORCE_STD_MPS2 = 0.1
"""Noise that the force may have that tells what an error of attitude does."""
LONGEST_MEAN_S = 3.0
"""Longest mean for that: a tram changes its acceleration within two seconds."""
_KIND_OF = {measurements.SIDE: "side_mps", measurements.UP: "up_mps"}


class Known(NamedTuple):
    """What is known before: from the configuration and the readings' scatter."""

    noise: Noise
    prior: Prior
    arms: Arms
    adapt: bool = True
    """Whether the constraints' deviations are found from the ride."""


class Solution(NamedTuple):
    """What the passes end with."""

    C_vb: Array
    """Case to vehicle, (3, 3)."""
    covariance: Array
    """(3, 3), of a turn about the vehicle's axes, rad²."""
    point: Point
    noise: Noise
    """With deviations as they were found."""
    drive: Drive
    """Likewise."""
    log: Log
    used: int
    passes: int
    settled: bool
    history: Array
    """(passes, 3, 3): C_vb after each pass."""

    def without_log(self) -> Solution:
        """The same without the last pass's covariances, 5 kB a node."""
        log = self.log
        return self._replace(
            used=0,
            log=Log(
                log.kind[:0].copy(), log.node[:0].copy(), log.innovation[:0].copy(),
                log.variance[:0].copy(), log.H[:0].copy(), log.K[:0].copy(), log.x[:0].copy(),
                log.P[:0].copy(),
            ),
        )  # fmt: skip


def room_for(drive: Drive) -> Log:
    """Memory of a pass."""
    count = drive.length
    most = count * 4 + 6 * len(drive.fixes.node) + 9 * int(drive.standing.sum()) + 16
    return Log(
        np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most), np.ones(most),
        np.zeros((most, SIZE)), np.zeros((most, SIZE)),
        np.zeros((count, SIZE)), np.zeros((count, SIZE, SIZE)),
    )  # fmt: skip


def solve(drive: Drive, start: Point, known: Known) -> Solution:
    """Search the most likely mounting from a trajectory that is good to some degrees."""
    log, point = room_for(drive), _packed(start)
    least = now = Adapted(known.noise, drive)
    history = []
    settled = False
    P, used, number = np.zeros((SIZE, SIZE)), 0, 0
    for number in range(1, MOST_PASSES + 1):
        limit = HUBER if number >= ROBUST_FROM else 0.0
        drive, noise = now.drive, now.noise
        model = Model(drive, noise, known.arms, force_of(drive, point, noise), limit)
        state = beginning(point, known.prior, noise)
        kernels.forward(model, point, state, log)
        P, used = state.P, int(state.used[0])
        if not np.all(np.isfinite(state.x)):
            break
        errors = kernels.backward(model, point, log, used)
        point = moved(point, errors)
        history.append(point.C_vb)
        step = float(np.linalg.norm(state.x[MOUNTING : MOUNTING + 3]))
        adapting = known.adapt and number <= max(ADAPTED)
        if adapting and number in ADAPTED:
            now = adapted(now, least, log, used)
            if number == max(ADAPTED):
                now = now._replace(noise=lasting(now.noise, log, used))
        if not adapting and number > ROBUST_FROM and step < SETTLED_RAD:
            settled = True
            break
    covariance = P[MOUNTING : MOUNTING + 3, MOUNTING : MOUNTING + 3]
    return Solution(
        point.C_vb,
        covariance,
        point,
        now.noise,
        now.drive,
        log,
        used,
        number,
        settled,
        np.array(history),
    )


def information(
    drive: Drive, point: Point, known: Known, log: Log | None = None, exact: bool = False
) -> Array:
    """Covariance of the mounting if the model is linearised at `point`.

    It is the bound where that is the truth, and `exact`.
    """
    log = log if log is not None else room_for(drive)
    point = _packed(point)
    state = beginning(point, known.prior, known.noise)
    force_l = force_of(drive, point, known.noise, exact)
    kernels.forward(Model(drive, known.noise, known.arms, force_l, 0.0), point, state, log)
    return state.P[MOUNTING : MOUNTING + 3, MOUNTING : MOUNTING + 3].copy()


def force_of(drive: Drive, point: Point, noise: Noise, exact: bool = False) -> Array:
    """Specific force in `l` that a trajectory has, averaged as far as its noise wants.

    A smoothed trajectory still has what the readings' noise did to it within a second.
    """
    gravity = drive.gravity_mps2 * drive.up_l
    gained = np.diff(point.vel_l, axis=0, append=point.vel_l[-1:]) / drive.dt_s
    wanted_s = min(float(np.mean(noise.accel**2)) / FORCE_STD_MPS2**2, LONGEST_MEAN_S)
    nodes = round(wanted_s / drive.dt_s)
    if exact or nodes < 2:
        return np.asarray(gained + gravity)
    return np.asarray(uniform_filter1d(gained, nodes, axis=0, mode="nearest") + gravity)


def _packed(point: Point) -> Point:
    """Rows behind each other in memory: a kernel is compiled for each layout."""
    return Point(*(np.ascontiguousarray(each) for each in point))


def beginning(point: Point, prior: Prior, noise: Noise) -> State:
    """Errors of a trajectory at the first node before anything is measured."""
    x = np.zeros(SIZE)
    x[ACCEL_BIAS : ACCEL_BIAS + 3] = -point.accel_bias[0]
    x[GYRO_BIAS : GYRO_BIAS + 3] = -point.gyro_bias[0]
    x[FIX_ERROR : FIX_ERROR + 3] = -point.fix_error[0]
    x[CROSS_LEVEL] = -point.cross_level[0]
    x[WHEEL_SCALE : WHEEL_SCALE + 3] = -point.constants
    return State(x, prior_covariance(prior, noise), np.zeros(SIZE), np.zeros(1, np.int64))


def moved(point: Point, errors: Array) -> Point:
    """The trajectory with its errors taken away."""
    turn = Rotation.from_rotvec(errors[:, ATTITUDE : ATTITUDE + 3]).as_matrix()
    mounting = Rotation.from_rotvec(errors[-1, MOUNTING : MOUNTING + 3]).as_matrix()
    return _packed(
        Point(
            p_l=point.p_l + errors[:, POSITION : POSITION + 3],
            vel_l=point.vel_l + errors[:, VELOCITY : VELOCITY + 3],
            C_lb=turn @ point.C_lb,
            accel_bias=point.accel_bias + errors[:, ACCEL_BIAS : ACCEL_BIAS + 3],
            gyro_bias=point.gyro_bias + errors[:, GYRO_BIAS : GYRO_BIAS + 3],
            fix_error=point.fix_error + errors[:, FIX_ERROR : FIX_ERROR + 3],
            cross_level=point.cross_level + errors[:, CROSS_LEVEL],
            C_vb=mounting @ point.C_vb,
            constants=point.constants + errors[-1, WHEEL_SCALE : WHEEL_SCALE + 3],
        )
    )


def _with(noise: Noise, kind: int, std_mps: float) -> Noise:
    """The same noise with another deviation of a constraint."""
    if kind == measurements.SIDE:
        return noise._replace(side_mps=std_mps)
    return noise._replace(up_mps=std_mps)


class Adapted(NamedTuple):
    """Deviations as a ride's innovations have them."""

    noise: Noise
    drive: Drive


def adapted(now: Adapted, least: Adapted, log: Log, used: int) -> Adapted:
    """Deviations for which innovations are as large as expected, by the median of their squares.

    The median knows no outliers. No deviation falls below what was stated (`least`).
    """
    noise, drive = now
    for kind, name in _KIND_OF.items():
        R = _fitting(log, used, kind, getattr(noise, name) ** 2)
        noise = _with(noise, kind, math.sqrt(max(R, getattr(least.noise, name) ** 2)))
    R = _fitting(log, used, measurements.WHEEL, drive.wheel_std_mps**2)
    wheel = math.sqrt(max(R, least.drive.wheel_std_mps**2))
    fixes, stated = drive.fixes, least.drive.fixes
    place = math.sqrt(max(_ratio(log, used, measurements.FIX_PLACE), 0.0))
    speed = math.sqrt(max(_ratio(log, used, measurements.FIX_VELOCITY), 0.0))
    shared = np.maximum(noise.fix_error_m * place, least.noise.fix_error_m)
    fixes = fixes._replace(
        p_std_m=np.maximum(fixes.p_std_m * place, stated.p_std_m),
        vel_std_mps=np.maximum(fixes.vel_std_mps * speed, stated.vel_std_mps),
    )
    return Adapted(
        noise._replace(fix_error_m=shared), drive._replace(fixes=fixes, wheel_std_mps=wheel)
    )


def lasting(noise: Noise, log: Log, used: int) -> Noise:
    """The constraints' deviations, larger for errors that last: a body nods for a second.

    White noise of the same density at low frequencies stands for them.
    """
    for kind, name in _KIND_OF.items():
        rows = np.flatnonzero(log.kind[:used] == kind)
        if len(rows) < FEWEST:
            continue
        y = log.innovation[rows] / np.sqrt(np.abs(log.variance[rows]))
        y = np.clip(y, -HUBER, HUBER)
        # The density at low frequencies: that of white innovations as large as expected is 1.
        sums = [float(np.mean(y[lag:] * y[:-lag])) for lag in range(1, LASTING_NODES + 1)]
        longer = max(float(np.mean(y * y)) + 2.0 * sum(sums), 1.0)
        noise = _with(noise, kind, getattr(noise, name) * math.sqrt(longer))
    return noise


def _ratio(log: Log, used: int, kind: int) -> float:
    """Squares of innovations over what is expected; 1 where there are few."""
    rows = np.flatnonzero(log.kind[:used] == kind)
    if len(rows) < FEWEST:
        return 1.0
    return float(np.median(_squares(log, rows)) / _MEDIAN_CHI2)


def _fitting(log: Log, used: int, kind: int, R: float) -> float:
    """Variance of a measurement that makes its innovations as large as expected."""
    rows = np.flatnonzero(log.kind[:used] == kind)
    if len(rows) < FEWEST:
        return R
    return R + (_ratio(log, used, kind) - 1) * float(np.median(np.abs(log.variance[rows])))


def _squares(log: Log, rows: NDArray[np.int64]) -> Array:
    found: Array = log.innovation[rows] ** 2 / np.abs(log.variance[rows])
    return found


LASTING_NODES = 20
"""Two seconds: springs of 1 Hz have swung out."""
FEWEST = 100
"""Innovations that tell a deviation."""
_MEDIAN_CHI2 = 0.4549
"""Median of χ² with one degree of freedom."""
