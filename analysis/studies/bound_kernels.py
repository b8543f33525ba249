"""The recursion of the bound, compiled: covariance along the truth out of the kernels of `tram`.

The state is set to the truth before each function that linearises at it, so that the innovations
of the kernels do nothing; what they change is the covariance alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.records import Records
from tramstream.processors.tram_model import (
    axes,
    gnss_position,
    gnss_velocity,
    wheel_path,
    zero_velocity,
)
from tramstream.processors.tram_model.lateral_force import take_reading as take_lateral_force
from tramstream.processors.tram_model.level_force import take_reading as take_level_force
from tramstream.processors.tram_model.motion import predict_along, rest_state
from tramstream.processors.tram_model.records import (
    LEFT,
    MEMORY,
    PARAMETERS,
    RIGHT,
    SITUATION,
    Memory,
    Parameters,
    Reading,
    Situation,
    Z,
)
from tramstream.processors.tram_model.states import MOTION, SIZE, Ix
from tramstream.processors.tram_model.vertical_constraint import take_constraint
from tramstream.processors.tram_model.zero_angular_rate import take_reading as take_zero_rate

STEP_S = 0.01
"""One step of the fusion horizon; measurements fall on the nearest."""
EVERY = 5
"""Steps from one row of a series to the next."""
NOT_READ, READ, SLIPPED = 0, 1, 2
"""What a step brings of a wheel."""


class Steps(NamedTuple):
    """The truth and what is measured; instants are the even rows of what has halves."""

    states: Array
    """(2n − 1, 7): the motion of `states.MOTION`, without the place."""
    inputs: Records
    """(2n − 1,): see `records.Reading`."""
    change: Array
    """(n, 2): v̇, ψ̇."""
    standing: NDArray[np.bool_]
    """(n,): all through the step that ends here."""
    fix: NDArray[np.int64]
    """(n,): row of `antenna`, or −1."""
    antenna: Array
    """(fixes, 6): from the origin, and its velocity, both in l."""
    wheels: NDArray[np.int64]
    """(n, wheels): `NOT_READ`, `READ`, or `SLIPPED` since the last reading."""


class Variances(NamedTuple):
    """Of what is measured."""

    pulse: float
    """Of a path, m²."""
    wheel_stamp: float
    """s²."""
    fix: float
    """White, each horizontal axis, m²."""
    fix_up: float
    fix_stamp: float
    velocity: float
    """(m/s)²; negative if there is none."""
    standing: float
    """Of the speed of a vehicle that stands, (m/s)²."""
    still_rate: float
    """Of a rate reading of a vehicle that stands, (rad/s)²."""
    still_force: float
    """Of a specific force of a vehicle that stands, (m/s²)²."""


@compiled
def recursion(
    memory: Array,
    parameters: Array,
    situation: Array,
    steps: Steps,
    variances: Variances,
    first: int,
    rows: Array,
) -> None:
    """Covariance from the first fix on; `rows` get ee, en, nn of the place, and all variances."""
    f, c, s = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    x = f.x
    truth = x.copy()
    work = np.zeros((1 + MOTION.stop, MOTION.stop))
    for k in range(first, len(steps.fix)):
        if k > first:
            if steps.standing[k]:
                _rest(f, c, s)
            else:
                truth[: MOTION.stop] = steps.states[2 * k - 1]
                x[:] = truth
                predict_along(f, c, s, steps.inputs[2 * k - 1], STEP_S)
        truth[: MOTION.stop] = steps.states[2 * k]
        u = steps.inputs[2 * k]
        f.acceleration, f.yaw_rate = steps.change[k, 0], steps.change[k, 1]
        x[:] = truth
        if steps.standing[k]:
            zero_velocity.take(memory, variances.standing, math.inf)
            rate = variances.still_rate
            take_zero_rate(f, u, rate, rate, rate)
            take_level_force(f, c, u, variances.still_force, math.inf)
            x[:] = truth
        _lateral(f, c, s, u, steps.standing[k])
        _roll(memory, situation, steps.wheels[k], variances, truth)
        if steps.fix[k] >= 0:
            antenna = steps.antenna[steps.fix[k]]
            _fix(memory, parameters, situation, antenna, variances, truth)
            if variances.velocity > 0.0 and not steps.standing[k]:
                _velocity(memory, parameters, situation, antenna, variances, truth)
        if (k - first) % EVERY == 0:
            _publish(f, c, work, rows[(k - first) // EVERY])


@compiled
def _roll(
    memory: Array, situation: Array, wheels: Array, variances: Variances, truth: Array
) -> None:
    """Take the paths of the wheels; one that has slipped is counted anew."""
    x = memory.view(MEMORY)[0].x
    variance = variances.pulse + variances.wheel_stamp * truth[Ix.SPEED] ** 2
    for wheel in range(len(wheels)):
        if wheels[wheel] == READ:
            wheel_path.take(memory, situation, wheel, 0.0, variance, math.inf)
        elif wheels[wheel] == SLIPPED:
            wheel_path.begin(memory, situation, wheel, variance)
        x[:] = truth


@compiled
def _fix(
    memory: Array,
    parameters: Array,
    situation: Array,
    antenna: Array,
    variances: Variances,
    truth: Array,
) -> None:
    variance = variances.fix + variances.fix_stamp * truth[Ix.SPEED] ** 2
    east, north, up, gate = antenna[0], antenna[1], antenna[2], math.inf
    gnss_position.take(memory, parameters, situation, east, north, variance, 0.0, gate, gate)
    gnss_position.take_height(memory, parameters, situation, up, variances.fix_up, gate)
    memory.view(MEMORY)[0].x[:] = truth


@compiled
def _velocity(
    memory: Array,
    parameters: Array,
    situation: Array,
    antenna: Array,
    variances: Variances,
    truth: Array,
) -> None:
    east, north, gate = antenna[3], antenna[4], math.inf
    gnss_velocity.take(memory, parameters, situation, east, north, variances.velocity, gate, gate)
    memory.view(MEMORY)[0].x[:] = truth


@compiled
def _rest(f: Memory, c: Parameters, s: Situation) -> None:
    """Let time pass as `motion.rest_state` does, with errors of fixes that go on decaying."""
    keep = math.exp(-s.fix_decay * STEP_S)
    for error in range(Ix.GNSS_EAST, Ix.GNSS_UP + 1):
        for other in range(SIZE):
            f.P[error, other] *= keep
        for other in range(SIZE):
            f.P[other, error] *= keep
    rest_state(f, c, s, STEP_S)


@compiled
def _lateral(f: Memory, c: Parameters, s: Situation, u: Reading, standing: bool) -> None:
    """Take the lateral specific force; its noise is that of the last step's turning as well.

    y = Hδ + n_f + v n_ω, and n_ω has turned heading, roll and paths in the step: M = E[δ v n_ω].
    Then S = HPHᵀ + 2HM + R and K = (PHᵀ + M)/S. H is that of `lateral_force`, which with a gate
    that lets nothing pass only tells it.

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, Wiley 2001, section 8.3.
    """
    x, P, K = f.x, f.P, f.K[0]
    take_lateral_force(f, c, u, u.angular_rate, -1.0)
    h, columns, count = f.values[0].copy(), f.columns[0].copy(), f.counts[0]
    take_constraint(f, c)
    variance = c.lateral_variance
    K[:] = 0.0
    if not standing:
        sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
        cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
        turned = x[Ix.SPEED] * s.rate_density[Z]
        variance += x[Ix.SPEED] * turned / STEP_S
        K[Ix.ROLL], K[Ix.PITCH], K[Ix.YAW] = turned * tp * cr, -turned * sr, turned * cr / cp
        for wheel in (LEFT, RIGHT):
            offset, counted = s.wheel_offset[wheel], 1.0 + x[Ix.SCALE_A + wheel]
            K[Ix.PATH_A + wheel] = -turned * s.wheel_sign[wheel] * offset * counted
    for k in range(count):
        variance += h[k] * K[columns[k]]  # HM; the other one comes with HK below
    for k in range(count):
        K += h[k] * P[columns[k]]
    for k in range(count):
        variance += h[k] * K[columns[k]]
    for i in range(SIZE):
        for j in range(i + 1):
            P[i, j] -= K[i] * K[j] / variance
            P[j, i] = P[i, j]


@compiled
def _publish(f: Memory, c: Parameters, work: Array, row: Array) -> None:
    """Give what the filter would say of its place, and the variances of its states."""
    axes.origin(f, c.clock_share, True, work[0], work[1:])
    row[0], row[1], row[2] = work[1, 0], work[1, 1], work[2, 1]
    for i in range(SIZE):
        row[3 + i] = f.P[i, i]
