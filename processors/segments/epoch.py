"""A tenth of a second: prediction, stand or motion, measurements, and what the way has shown."""

from __future__ import annotations

import math
from enum import IntEnum

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.segments.kernels import (
    SUMS,
    Ix,
    Noise,
    Sum,
    predict,
    take_curve,
    take_speed,
    take_stand,
)
from tramstream.processors.segments.standing import St, stands
from tramstream.processors.segments.turns import take_metre


class Wh(IntEnum):
    """What wheels and doors say of an epoch, one row of numbers."""

    SPEED = 0
    """NaN: nothing."""
    STD = 1
    STILL_S = 2
    """For how long they have not turned; NaN where nobody reads them."""
    DOORS = 3
    REFUSED_S = 4
    """For how long they have been refused without a pause."""
    TAKEN = 5
    """Epochs in which they were taken."""
    DEAD = 6
    """1: they have stood still for so long while the vehicle ran; until they turn again."""


WHEELS = len(Wh)
REFUSED_S = 5.0
"""Wheels that do not fit for so long while they turn have been right all along."""
REGAINED_STD_MPS = 3.0


class Go(IntEnum):
    """How far it has gone, one row of numbers."""

    GONE_M = 0
    """Whichever way."""
    SAMPLED_M = 1
    WAY_M = 2
    """At the epoch before, as YAW and TIME."""
    YAW_RAD = 3
    TIME_S = 4
    DIRECTION = 5
    """Of the last motion along x."""
    TURN_STAMP = 6


GOING = len(Go)
TURNED = 1
"""Bits of what an epoch gives: a turn has ended,"""
STANDS = 2
"""it stands,"""
SLIPS = 4
"""the wheels' speed was refused."""
DIRECTION_MPS = 0.3


@compiled
def epoch(
    x: Array,
    P: Array,
    sums: Array,
    d: Array,
    t: Array,
    g: Array,
    wheels: Array,
    noise: Array,
    now_s: float,
    turn: Array,
    work: Array,
) -> int:
    """Close an epoch whose readings have been summed up; see `TURNED` for what it gives.

    Parameters
    ----------
    x, P, sums : ndarray
        See `kernels`; the sums are begun anew.
    d, t, g, wheels, noise : ndarray
        Rows of `St`, `Tn`, `Go`, `Wh` and `Noise`.
    turn : ndarray, shape (TURN,)
        Where a turn goes that has ended.
    work : ndarray, shape (2 STATES + 3, STATES)
        Scratch.
    """
    count = sums[Sum.COUNT]
    for k in range(Sum.RATE_X, SUMS):
        sums[k] /= count
    standing = d[St.STANDING] > 0.5
    predict(x, P, sums, noise, standing, work)
    H = work[x.shape[0] * 2 : x.shape[0] * 2 + 2]
    still_s = wheels[Wh.STILL_S]
    if still_s < sums[Sum.TIME]:
        wheels[Wh.DEAD] = 0.0
    elif wheels[Wh.REFUSED_S] > REFUSED_S:
        wheels[Wh.DEAD] = 1.0
    alive = wheels[Wh.DEAD] < 0.5
    seen_s = still_s if alive else math.nan
    standing = stands(d, x, P, sums, now_s, seen_s, wheels[Wh.DOORS] > 0.5)
    found = 0
    if standing:
        found |= STANDS
        take_stand(x, P, sums, H)
        x[Ix.SPEED] = 0.0
        wheels[Wh.REFUSED_S] = 0.0
    else:
        take_curve(x, P, sums, H)
        told = alive and not math.isnan(wheels[Wh.SPEED])
        if told and not take_wheels(x, P, H, wheels, sums[Sum.TIME]):
            found |= SLIPS
    if go_on(x, t, g, now_s, noise[Noise.SMEAR_M2], turn):
        found |= TURNED
    sums[:] = 0.0
    return found


@compiled
def take_wheels(x: Array, P: Array, H: Array, wheels: Array, epoch_s: float) -> bool:
    """Take the wheels' speed, unless they slip; whether it was."""
    speed = wheels[Wh.SPEED]
    if take_speed(x, P, H, speed, wheels[Wh.STD]) >= 0.0:
        wheels[Wh.REFUSED_S] = 0.0
        wheels[Wh.TAKEN] += 1.0
        return True
    wheels[Wh.REFUSED_S] += epoch_s
    if wheels[Wh.REFUSED_S] > REFUSED_S and wheels[Wh.STILL_S] < epoch_s:
        P[Ix.SPEED, Ix.SPEED] += REGAINED_STD_MPS * REGAINED_STD_MPS
    return False


@compiled
def go_on(x: Array, t: Array, g: Array, now_s: float, smear_m2: float, turn: Array) -> bool:
    """Sample the heading at each metre gone; whether a turn has ended."""
    if abs(x[Ix.SPEED]) > DIRECTION_MPS:
        g[Go.DIRECTION] = 1.0 if x[Ix.SPEED] > 0.0 else -1.0
    begin_m = g[Go.GONE_M]
    step_m = g[Go.DIRECTION] * (x[Ix.WAY] - g[Go.WAY_M])
    end_m = begin_m + step_m
    ended = False
    while end_m >= g[Go.SAMPLED_M] + 1.0:
        g[Go.SAMPLED_M] += 1.0
        share = min(max((g[Go.SAMPLED_M] - begin_m) / step_m, 0.0), 1.0) if step_m > 0.0 else 1.0
        yaw = g[Go.YAW_RAD] + share * (x[Ix.YAW] - g[Go.YAW_RAD])
        time_s = g[Go.TIME_S] + share * (now_s - g[Go.TIME_S])
        if take_metre(t, g[Go.SAMPLED_M], yaw, time_s, smear_m2, turn) == 1:
            ended = True
    g[Go.GONE_M] = end_m
    g[Go.WAY_M] = x[Ix.WAY]
    g[Go.YAW_RAD] = x[Ix.YAW]
    g[Go.TIME_S] = now_s
    return ended
