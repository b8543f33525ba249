"""Does the vehicle stand? Wheels say so, doors make it sure, quiet alone tells it without them.

Quiet means that the horizontal force and the yaw rate do not change over `WINDOW` epochs, that the
force is gravity's at the pitch that the gyroscopes have carried, and that the integrated speed may
be zero. A vehicle at a steady speed on straight and smooth track is quiet as well: there only the
speed tells, and how much the case shakes, once it is known what it does standing and running.
"""

from __future__ import annotations

import math
from enum import IntEnum

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.segments.kernels import EPOCH_S, GRAVITY, Ix, Sum


class St(IntEnum):
    """What is remembered of it, one row of numbers."""

    STANDING = 0
    SINCE_S = 1
    """Of the stand, or of the last departure."""
    EPOCHS = 2
    """Seen in a row without a pause."""
    REFERENCE = 3
    """Force along the track while standing,"""
    QUIET_LEVEL = 4
    """logarithm of the scatter then, 0 while it is not known, and"""
    RUNNING_LEVEL = 5
    """when running."""
    LEVEL = 6
    """Now."""
    RING = 7
    """From here on, three numbers an epoch."""


WINDOW = 8
"""Epochs over which it must be quiet."""
ROWS = St.RING + 3 * WINDOW
QUIET_MPS2 = 0.045
"""Deviation of the force within the window. A driver who lets the brakes go at 0.6 m/s³ is quiet
after 0.4 s of standing; one at 0.2 m/s³, half a second before."""
QUIET_RADPS = 0.006
STEADY_RADPS = 0.01
FORCE_OFF_MPS2 = 0.15
"""Force along the track beside gravity's that may still be standing."""
SLOW_MPS = 0.4
SPEED_STDS = 3.0
PUSH_MPS2 = 0.12
"""Change of the force along the track that is a departure."""
LEARNING = 0.02
SETTLING = 0.05
SEPARATION = 0.7
"""The scatter must differ by that much (a factor of two) between running and standing."""
RUNNING_MPS = 3.0
WHEELS_STILL_S = 0.6
LATE_S = 0.45
"""Quiet is seen so long after a stand has begun; chosen by hand, guarded by the tests."""


@compiled
def stands(
    d: Array, x: Array, P: Array, mean: Array, now_s: float, wheels_s: float, doors: bool
) -> bool:
    """Take an epoch: whether the vehicle stands now; d[SINCE_S] is since when.

    Parameters
    ----------
    d : ndarray, shape (ROWS,)
        Changed in place.
    wheels_s : float
        For how long the wheels have not turned; NaN where nobody reads them.
    doors : bool
        Whether they are said to be open.
    """
    number = int(d[St.EPOCHS]) % WINDOW
    at = St.RING + 3 * number
    d[at] = mean[Sum.FORCE_X]
    d[at + 1] = mean[Sum.FORCE_Y]
    d[at + 2] = mean[Sum.RATE_Z]
    d[St.EPOCHS] += 1.0
    level = math.log(mean[Sum.SCATTER] + 1e-4)
    d[St.LEVEL] = level
    standing = d[St.STANDING] > 0.5
    speed, std = abs(x[Ix.SPEED]), math.sqrt(max(P[Ix.SPEED, Ix.SPEED], 0.0))
    if standing:
        d[St.QUIET_LEVEL] = blend(d[St.QUIET_LEVEL], level)
    elif speed - std > RUNNING_MPS:
        d[St.RUNNING_LEVEL] = blend(d[St.RUNNING_LEVEL], level)
    if not math.isnan(wheels_s):
        locked = speed > 0.5 + 4.0 * std
        still = (wheels_s > WHEELS_STILL_S and not locked) or (doors and wheels_s > EPOCH_S)
        if still and not standing:
            enter(d, now_s - wheels_s, mean[Sum.FORCE_X])
        elif standing and not still:
            leave(d, now_s - EPOCH_S)
    elif standing:
        push = abs(mean[Sum.FORCE_X] - d[St.REFERENCE])
        d[St.REFERENCE] += SETTLING * (mean[Sum.FORCE_X] - d[St.REFERENCE])
        if not doors and (push > PUSH_MPS2 or abs(mean[Sum.RATE_Z]) > STEADY_RADPS):
            leave(d, now_s - 2.0 * EPOCH_S)
    elif d[St.EPOCHS] >= WINDOW and (doors or quiet(d, x, P, mean, speed, std)):
        enter(d, now_s - LATE_S, mean[Sum.FORCE_X])
    return bool(d[St.STANDING] > 0.5)


@compiled
def enter(d: Array, since_s: float, force: float) -> None:
    """Begin a stand."""
    d[St.STANDING] = 1.0
    d[St.SINCE_S] = max(since_s, d[St.SINCE_S])
    d[St.REFERENCE] = force


@compiled
def leave(d: Array, since_s: float) -> None:
    """End a stand; what was quiet then says nothing of the next one."""
    d[St.STANDING] = 0.0
    d[St.SINCE_S] = max(since_s, d[St.SINCE_S])
    d[St.EPOCHS] = 0.0


@compiled
def quiet(d: Array, x: Array, P: Array, mean: Array, speed: float, std: float) -> bool:
    """Whether inertial data alone say that the vehicle stands."""
    if speed > SLOW_MPS + SPEED_STDS * std or abs(mean[Sum.RATE_Z]) > STEADY_RADPS:
        return False
    off = abs(mean[Sum.FORCE_X] + GRAVITY * math.sin(x[Ix.PITCH]))
    if off > FORCE_OFF_MPS2 + SPEED_STDS * GRAVITY * math.sqrt(max(P[Ix.PITCH, Ix.PITCH], 0.0)):
        return False
    for k in range(3):
        total, squares = 0.0, 0.0
        for j in range(WINDOW):
            value = d[St.RING + 3 * j + k]
            total += value
            squares += value * value
        variance = squares / WINDOW - (total / WINDOW) ** 2
        limit = QUIET_RADPS if k == 2 else QUIET_MPS2
        if variance > limit * limit:
            return False
    still, running = d[St.QUIET_LEVEL], d[St.RUNNING_LEVEL]
    if still != 0.0 and running != 0.0 and running - still > SEPARATION:
        return bool(d[St.LEVEL] < 0.5 * (still + running))
    return True


@compiled
def blend(before: float, value: float) -> float:
    """Follow a level slowly."""
    return value if before == 0.0 else before + LEARNING * (value - before)
