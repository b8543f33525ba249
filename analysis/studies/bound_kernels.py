"""The recursion of the bound, compiled: covariance along the truth out of the kernels of `tram`.

The state is set to the truth before each function that linearises at it, so that the innovations
of the kernels do nothing; what they change is the covariance alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.kalman import Array, compiled, predict_covariance
from tramstream.processors.tram import axes as frames
from tramstream.processors.tram import measurements
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.states import COLUMNS, MOTION, ROWS, SIZE, Ix, Pm

STEP_S = 0.01
"""One step of the fusion horizon; measurements fall on the nearest."""
EVERY = 5
"""Steps from one row of a series to the next."""
NOT_READ, READ, SLIPPED = 0, 1, 2
"""What a step brings of a wheel."""


class Steps(NamedTuple):
    """The truth and what is measured; instants are the even rows of what has halves."""

    states: Array
    """(2n − 1, 7): the motion of `tram_states.MOTION`, without the place."""
    inputs: Array
    """(2n − 1, 10): see `tram_kernels.move`."""
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


@compiled
def recursion(
    m: Array, c: Array, steps: Steps, variances: Variances, first: int, rows: Array
) -> None:
    """Covariance from the first fix on; `rows` get ee, en, nn of the place, and all variances."""
    x, P = m[kernels.STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    truth = x.copy()
    work = np.zeros((1 + MOTION.stop, MOTION.stop))
    for k in range(first, len(steps.fix)):
        if k > first:
            if steps.standing[k]:
                _rest(m, c)
            else:
                truth[: MOTION.stop] = steps.states[2 * k - 1]
                x[:] = truth
                values = m[kernels.ENTRY_VALUES]
                kernels.transition(x, c, steps.inputs[2 * k - 1], STEP_S, values)
                scratch = m[kernels.SCRATCH].reshape((SIZE, SIZE))
                predict_covariance(P, ROWS, COLUMNS, values, kernels.ENTRY_COUNT, scratch)
                kernels.add_noise(x, P, c, STEP_S)
        truth[: MOTION.stop] = steps.states[2 * k]
        u = steps.inputs[2 * k]
        m[kernels.ACCELERATION], m[kernels.YAW_RATE] = steps.change[k]
        x[:] = truth
        if steps.standing[k]:
            measurements.standing(m, c, u)
            x[:] = truth
        _lateral(m, c, u, steps.standing[k])
        _roll(m, c, steps.wheels[k], variances, truth)
        if steps.fix[k] >= 0:
            _fix(m, c, steps.antenna[steps.fix[k]], variances, truth)
            if variances.velocity > 0.0 and not steps.standing[k]:
                _velocity(m, c, steps.antenna[steps.fix[k]], variances, truth)
        if (k - first) % EVERY == 0:
            _publish(m, c, work, rows[(k - first) // EVERY])


@compiled
def _roll(m: Array, c: Array, wheels: Array, variances: Variances, truth: Array) -> None:
    """Take the paths of the wheels; one that has slipped is counted anew."""
    x = m[kernels.STATE]
    variance = variances.pulse + variances.wheel_stamp * truth[Ix.SPEED] ** 2
    for wheel in range(len(wheels)):
        if wheels[wheel] == READ:
            measurements.path(m, c, wheel, 0.0, variance, math.inf)
        elif wheels[wheel] == SLIPPED:
            measurements.tie(m, c, wheel, variance)
        x[:] = truth


@compiled
def _fix(m: Array, c: Array, antenna: Array, variances: Variances, truth: Array) -> None:
    R, out = np.zeros(3), np.zeros((3, 2))
    R[0] = variances.fix + variances.fix_stamp * truth[Ix.SPEED] ** 2
    R[1] = variances.fix_up
    measurements.position(m, c, antenna[:3], R, math.inf, math.inf, out)
    m[kernels.STATE][:] = truth


@compiled
def _velocity(m: Array, c: Array, antenna: Array, variances: Variances, truth: Array) -> None:
    out = np.zeros((3, 2))
    measurements.velocity(m, c, antenna[3:], variances.velocity, math.inf, math.inf, out)
    m[kernels.STATE][:] = truth


@compiled
def _rest(m: Array, c: Array) -> None:
    """`tram_kernels.rest`, with errors of fixes that go on decaying."""
    P = m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    keep = math.exp(-c[Pm.GNSS_DECAY] * STEP_S)
    for slot in range(Ix.GNSS_EAST, Ix.GNSS_UP + 1):
        for other in range(SIZE):
            P[slot, other] *= keep
        for other in range(SIZE):
            P[other, slot] *= keep
    kernels.rest(m, c, STEP_S)


@compiled
def _lateral(m: Array, c: Array, u: Array, standing: bool) -> None:
    """Take the lateral specific force; its noise is that of the last step's turning as well.

    y = Hδ + n_f + v n_ω, and n_ω has turned heading, roll and paths in the step: M = E[δ v n_ω].
    Then S = HPHᵀ + 2HM + R and K = (PHᵀ + M)/S. H is that of
    `tram_measurements.inertial`, which with a gate that lets nothing pass only tells it.

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, Wiley 2001, section 8.3.
    """
    x, P, K = m[kernels.STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE)), m[kernels.GAIN]
    measurements.inertial(m, c, u, u, -1.0)
    h, columns, count = kernels.row(m, 0), m[kernels.H_COLUMNS], int(m[kernels.SEEN][2])
    variance = c[Pm.LATERAL_VARIANCE]
    K[:] = 0.0
    if not standing:
        sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
        cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
        turned = x[Ix.SPEED] * c[Pm.YAW_DENSITY]
        variance += x[Ix.SPEED] * turned / STEP_S
        K[Ix.ROLL], K[Ix.PITCH], K[Ix.YAW] = turned * tp * cr, -turned * sr, turned * cr / cp
        K[Ix.PATH_A] = -turned * c[Pm.SIGN_A] * c[Pm.OFFSET_A] * (1.0 + x[Ix.SCALE_A])
        K[Ix.PATH_B] = -turned * c[Pm.SIGN_B] * c[Pm.OFFSET_B] * (1.0 + x[Ix.SCALE_B])
    for k in range(count):
        variance += h[k] * K[int(columns[k])]  # HM; the other one comes with HK below
    for k in range(count):
        K += h[k] * P[int(columns[k])]
    for k in range(count):
        variance += h[k] * K[int(columns[k])]
    for i in range(SIZE):
        for j in range(i + 1):
            P[i, j] -= K[i] * K[j] / variance
            P[j, i] = P[i, j]


@compiled
def _publish(m: Array, c: Array, work: Array, row: Array) -> None:
    """What the filter would say of its place, and of its states."""
    P = m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    frames.origin(m, c[Pm.CLOCK_SHARE], work[0], work[1:])
    row[0], row[1], row[2] = work[1, 0], work[1, 1], work[2, 1]
    for i in range(SIZE):
        row[3 + i] = P[i, i]
