"""From the fusion horizon to now, compiled: keeping readings, and what the filter makes of them."""

from __future__ import annotations

import numpy as np

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram.axes import read, say
from tramstream.processors.tram.motion import (
    ACCELERATION,
    COVARIANCE,
    ENTRY_VALUES,
    GAIN,
    SCRATCH,
    STATE,
    YAW_RATE,
    add_noise,
    move,
    slots,
    transition,
)
from tramstream.processors.tram.states import COLUMNS, ROWS, SIZE, Ix

READING = 11
"""Numbers that are kept of a reading: what acts since the one before, see `move`; for how long."""
STRIDE = 5
"""Readings that are taken together."""
_LEADING = slots(*list(Ix)[: Ix.YAW + 1], Ix.GNSS_DELAY, Ix.PIVOT)
"""What is published, and what that is found with."""
_LEADING_ENTRIES = np.flatnonzero(ROWS <= Ix.YAW)
assert not np.isin(ROWS, [Ix.GNSS_DELAY, Ix.PIVOT]).any()


@compiled
def keep(
    readings: Array,
    index: int,
    inputs: Array,
    C_vb: Array,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    dt: float,
) -> bool:
    """Read as `read` does, and put what acts since the reading before, and how long, in a row."""
    if not read(inputs, C_vb, gx, gy, gz, ax, ay, az, dt):
        return False
    for k in range(10):
        readings[index, k] = inputs[2, k]
    readings[index, READING - 1] = dt
    return True


@compiled
def say_ahead(
    m: Array, to: Array, c: Array, readings: Array, begin: int, end: int, values: Array
) -> None:
    """Fill the values of an estimate as `say` does, after the readings from `begin` to `end`.

    Parameters
    ----------
    to : ndarray
        Another memory, for what is made of `m` on the way.
    """
    _predict(m, to, c, readings, begin, end)
    say(to, c, True, values)


@compiled
def _predict(m: Array, to: Array, c: Array, readings: Array, begin: int, end: int) -> None:
    """Predict what `m` says of the motion through the readings from `begin` to `end`.

    The state goes step by step, the covariance in one step.

    Parameters
    ----------
    to : ndarray
        Another memory: gets the state and, of the covariance, the rows and columns `_LEADING`;
        nothing else in it means anything.
    readings : ndarray, shape (≥ end, READING)
        See `READING`.
    """
    x, P = to[STATE], to[COVARIANCE].reshape((SIZE, SIZE))
    for k in range(SIZE):
        x[k] = m[k]
    to[ACCELERATION], to[YAW_RATE] = m[ACCELERATION], m[YAW_RATE]
    before = m[COVARIANCE].reshape((SIZE, SIZE))
    if end <= begin:
        for i in _LEADING:
            for j in _LEADING:
                P[i, j] = before[i, j]
        return
    u = to[GAIN][:10]
    total = 0.0
    k = begin
    while k < end:
        # Five readings at a time: over 50 ms the midpoint rule is good to a tenth of a millimetre.
        last = min(k + STRIDE, end)
        for i in range(10):
            u[i] = 0.0
        dt = 0.0
        for j in range(k, last):
            duration = readings[j, READING - 1]
            dt += duration
            for i in range(10):
                u[i] += readings[j, i] * duration
        if dt > 0.0:
            for i in range(10):
                u[i] /= dt
            to[ACCELERATION], to[YAW_RATE] = move(x, c, u, dt)
        total += dt
        k = last
    transition(m[STATE], c, readings[end - 1], total, to[ENTRY_VALUES])
    _lead_covariance(before, P, to[ENTRY_VALUES], to[SCRATCH].reshape((SIZE, SIZE)))
    add_noise(x, P, c, total)


@compiled
def _lead_covariance(before: Array, P: Array, values: Array, work: Array) -> None:
    """What `predict_covariance` makes of `before`, in the rows and columns `_LEADING` of `P`."""
    count = _LEADING.shape[0]
    for r in range(count):
        for j in range(SIZE):
            work[r, j] = before[_LEADING[r], j]
    for k in _LEADING_ENTRIES:  # their rows are the first of those
        i, j, a = ROWS[k], COLUMNS[k], values[k]
        for n in range(SIZE):
            work[i, n] += a * before[j, n]
    for i in _LEADING:
        for r in range(count):
            P[i, _LEADING[r]] = work[r, i]
    for k in _LEADING_ENTRIES:
        i, j, a = ROWS[k], COLUMNS[k], values[k]
        for r in range(count):
            P[i, _LEADING[r]] += a * work[r, j]
    for r in range(count):
        for s in range(r):
            i, j = _LEADING[r], _LEADING[s]
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
