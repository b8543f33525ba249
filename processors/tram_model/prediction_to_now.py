"""From the fusion horizon to now, compiled: keeping readings, and what the filter makes of them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.records import Records, dtype_of
from tramstream.processors.tram_model.axes import TAKEN, fill_estimate, take_reading
from tramstream.processors.tram_model.map_shift import weigh_map
from tramstream.processors.tram_model.motion import add_noise, move, transition
from tramstream.processors.tram_model.records import (
    INERTIAL,
    MEMORY,
    PARAMETERS,
    READING,
    SITUATION,
    Memory,
    Parameters,
    Reading,
    Situation,
)
from tramstream.processors.tram_model.states import COLUMNS, ROWS, SIZE, Ix
from tramstream.processors.tram_model.update import columns_of

STRIDE = 5
"""Readings that are taken together: over 50 ms the midpoint rule is good to a tenth of a
millimetre."""
_LEADING = columns_of(*list(Ix)[: Ix.YAW + 1], Ix.GNSS_DELAY, Ix.PIVOT)
"""What is published, and what that is found with."""
_LEADING_ENTRIES = np.flatnonzero(ROWS <= Ix.YAW)
assert not np.isin(ROWS, [Ix.GNSS_DELAY, Ix.PIVOT]).any()


class Kept(Protocol):
    """A reading that the filter has not seen yet."""

    reading: Reading
    """What acts since the one before."""
    duration: float
    """For how long, s."""


KEPT = dtype_of(Kept)


@compiled
def keep(
    kept: Array,
    index: int,
    inertial: Array,
    C_vb: Array,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    dt: float,
) -> bool:
    """Read as `take_reading` does, and keep what acts since the reading before, and how long."""
    if take_reading(inertial, C_vb, gx, gy, gz, ax, ay, az, dt) != TAKEN:
        return False
    each = kept.view(KEPT)[index]
    each.reading = inertial.view(INERTIAL)[0].between
    each.duration = dt
    return True


@compiled
def estimate_ahead(
    memory: Array,
    ahead: Array,
    parameters: Array,
    situation: Array,
    kept: Array,
    begin: int,
    end: int,
    mean: Array,
    values: Array,
) -> None:
    """Fill the values of an estimate as `axes.estimate` does, after the readings kept.

    Parameters
    ----------
    ahead : record
        Another memory, for what is made of `memory` on the way.
    begin, end : int
        Which of `kept` the filter has not seen.
    mean : record
        One `Reading`, scratch.
    """
    f, c, s = ahead.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    unseen = kept.view(KEPT)[begin:end]
    _predict(memory.view(MEMORY)[0], f, c, s, unseen, mean.view(READING)[0])
    fill_estimate(f, c, True, values)
    weigh_map(memory.view(MEMORY)[0], c, values)


@compiled
def _predict(
    before: Memory, f: Memory, c: Parameters, s: Situation, kept: Records, u: Reading
) -> None:
    """Predict what `before` says of the motion through the readings `kept`, into `f`.

    The state goes step by step, the covariance in one step. `f` gets the state and, of the
    covariance, the rows and columns `_LEADING`; nothing else in it means anything.
    """
    x, P = f.x, f.P
    for k in range(SIZE):
        x[k] = before.x[k]
    f.acceleration, f.yaw_rate = before.acceleration, before.yaw_rate
    count = kept.shape[0]
    if count == 0:
        for i in _LEADING:
            for j in _LEADING:
                P[i, j] = before.P[i, j]
        return
    total = 0.0
    for first in range(0, count, STRIDE):
        dt = _mean(kept[first : first + STRIDE], u)
        if dt > 0.0:
            f.acceleration, f.yaw_rate = move(x, c, s, u, dt)
        total += dt
    newest = kept[count - 1].reading
    transition(before.x, c, s, newest, total, f.A)
    _lead_covariance(before.P, P, f.A, f.scratch)
    add_noise(x, P, c, s, newest, total)


@compiled
def _mean(kept: Records, u: Reading) -> float:
    """Give the time that readings act together, s, and in `u` their mean."""
    for i in range(3):
        u.angular_rate[i] = u.specific_force[i] = u.angular_acceleration[i] = 0.0
    u.accelerometer = dt = 0.0
    for j in range(kept.shape[0]):
        each, duration = kept[j].reading, kept[j].duration
        dt += duration
        for i in range(3):
            u.angular_rate[i] += each.angular_rate[i] * duration
            u.specific_force[i] += each.specific_force[i] * duration
            u.angular_acceleration[i] += each.angular_acceleration[i] * duration
        u.accelerometer += each.accelerometer * duration
    if dt > 0.0:
        for i in range(3):
            u.angular_rate[i] /= dt
            u.specific_force[i] /= dt
            u.angular_acceleration[i] /= dt
        u.accelerometer /= dt
    return dt


@compiled
def _lead_covariance(before: Array, P: Array, A: Array, work: Array) -> None:
    """Give `P`, in the rows and columns `_LEADING`, what `predict_covariance` makes of `before`."""
    count = _LEADING.shape[0]
    for r in range(count):
        for j in range(SIZE):
            work[r, j] = before[_LEADING[r], j]
    for k in _LEADING_ENTRIES:  # their rows are the first of those
        i, j = ROWS[k], COLUMNS[k]
        a = A[i, j]
        for n in range(SIZE):
            work[i, n] += a * before[j, n]
    for i in _LEADING:
        for r in range(count):
            P[i, _LEADING[r]] = work[r, i]
    for k in _LEADING_ENTRIES:
        i, j = ROWS[k], COLUMNS[k]
        a = A[i, j]
        for r in range(count):
            P[i, _LEADING[r]] += a * work[r, j]
    for r in range(count):
        for s in range(r):
            i, j = _LEADING[r], _LEADING[s]
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
