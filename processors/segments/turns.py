"""Turns by the way: where curvature keeps beyond 1/300 m with one sign.

Heading is sampled each metre of way gone, so that a vehicle which stands in a curve sees the same
curve. Curvature is that over `WINDOW_M` of way, at its middle. A turn begins and ends where it
passes the limit, in between two samples by a straight line; less than `GAP_M` below the limit ends
no turn. Its angle is the heading's change between the two, its radius the way by the angle.

The window, and a body that lies along the chord between its bogies, smear a curve's ends: seen so,
it begins too early and ends too late, and all the more the tighter it is. Where curvature is half
of the turn's largest a ramp is smeared to neither side; from there its foot is counted back by as
much less as variances say, r² = r_seen² − smear².
"""

from __future__ import annotations

import math
from enum import IntEnum

from tramstream.estimation.kalman import Array, compiled

LIMIT_PER_M = 1.0 / 300.0
WINDOW_M = 2
"""Shorter than the tightest curves' transitions; over it a body's sway is gone."""
GAP_M = 3.0
HALF = WINDOW_M // 2
COLUMNS = 3
"""Of a sample: heading, variance that it has gathered, time."""


class Tn(IntEnum):
    """What is remembered of turns, one row of numbers."""

    SAMPLES = 0
    SIGN = 1
    """Of the turn that goes on; 0: there is none."""
    BEGIN_M = 2
    BEGIN_RAD = 3
    BEGIN_S = 4
    END_M = 5
    """Where the limit was passed last, downwards."""
    END_RAD = 6
    END_S = 7
    OUT = 8
    """Whether the curvature is below the limit now."""
    CURVATURE = 9
    """At the sample before."""
    HELD = 10
    """Curvatures that are held of the turn, and"""
    FIRST_M = 11
    """where the first of them is."""
    RING = 12


HELD = Tn.RING + COLUMNS * (WINDOW_M + 1)
MOST = 400
"""Metres of a turn that are held; one that goes on is a ring, and its end is as it is seen."""
ROWS = HELD + MOST


class Turn(IntEnum):
    """A finished turn, one row of numbers."""

    BEGIN_M = 0
    END_M = 1
    BEGIN_S = 2
    END_S = 3
    ANGLE = 4


TURN = len(Turn)


@compiled
def take_metre(
    t: Array, way_m: float, yaw_rad: float, time_s: float, smear_m2: float, out: Array
) -> int:
    """Take the heading after another metre of way: 1 if a turn has ended, which is then in `out`.

    Parameters
    ----------
    t : ndarray, shape (ROWS,)
        Changed in place.
    way_m : float
        Gone; a metre more than at the sample before.
    smear_m2 : float
        Square of the distance between the body's bogies, and of `WINDOW_M`.
    out : ndarray, shape (TURN,)
    """
    samples = int(t[Tn.SAMPLES])
    size = WINDOW_M + 1
    for j in range(size - 1):
        for k in range(COLUMNS):
            t[Tn.RING + COLUMNS * j + k] = t[Tn.RING + COLUMNS * (j + 1) + k]
    last = Tn.RING + COLUMNS * (size - 1)
    t[last] = yaw_rad
    t[last + 1] = 0.0
    t[last + 2] = time_s
    t[Tn.SAMPLES] = samples + 1
    if samples < WINDOW_M:
        return 0
    curvature = (yaw_rad - t[Tn.RING]) / WINDOW_M
    before = t[Tn.CURVATURE] if samples > WINDOW_M else 0.0
    t[Tn.CURVATURE] = curvature
    middle_m = way_m - HALF
    ended = 0
    if t[Tn.SIGN] != 0.0:
        signed = curvature * t[Tn.SIGN]
        if t[Tn.OUT] < 0.5 and signed < LIMIT_PER_M:
            share = crossing(before * t[Tn.SIGN], signed)
            t[Tn.END_M] = middle_m - 1.0 + share
            t[Tn.END_RAD] = between(t, 0, share)
            t[Tn.END_S] = between(t, 2, share)
            t[Tn.OUT] = 1.0
        elif t[Tn.OUT] > 0.5 and signed >= LIMIT_PER_M:
            t[Tn.OUT] = 0.0
        opposite = signed <= -LIMIT_PER_M
        if t[Tn.OUT] > 0.5 and (opposite or middle_m - t[Tn.END_M] > GAP_M):
            out[Turn.BEGIN_M] = t[Tn.BEGIN_M]
            out[Turn.END_M] = t[Tn.END_M]
            out[Turn.BEGIN_S] = t[Tn.BEGIN_S]
            out[Turn.END_S] = t[Tn.END_S]
            out[Turn.ANGLE] = t[Tn.END_RAD] - t[Tn.BEGIN_RAD]
            sharpen(t, smear_m2, out)
            t[Tn.SIGN] = 0.0
            ended = 1
    if t[Tn.SIGN] == 0.0 and abs(curvature) >= LIMIT_PER_M:
        sign = 1.0 if curvature > 0.0 else -1.0
        share = crossing(before * sign, curvature * sign)
        t[Tn.SIGN] = sign
        t[Tn.BEGIN_M] = middle_m - 1.0 + share
        t[Tn.BEGIN_RAD] = between(t, 0, share)
        t[Tn.BEGIN_S] = between(t, 2, share)
        t[Tn.OUT] = 0.0
        t[Tn.HELD] = 0.0
        t[Tn.FIRST_M] = middle_m
    if t[Tn.SIGN] != 0.0 and t[Tn.HELD] < MOST:
        t[HELD + int(t[Tn.HELD])] = curvature * t[Tn.SIGN]
        t[Tn.HELD] += 1.0
    return ended


@compiled
def sharpen(t: Array, smear_m2: float, out: Array) -> None:
    """Move a turn's ends inwards by what they are smeared."""
    held = int(t[Tn.HELD])
    peak = 0.0
    for k in range(held):
        peak = max(peak, t[HELD + k])
    half = 0.5 * peak
    foot = 0.5 - LIMIT_PER_M / peak
    if foot <= 0.1:
        return
    for k in range(held):
        if t[HELD + k] >= half:
            at = t[Tn.FIRST_M] + k
            if k > 0:
                before = t[HELD + k - 1]
                at -= (t[HELD + k] - half) / (t[HELD + k] - before)
            out[Turn.BEGIN_M] += smeared(at - out[Turn.BEGIN_M], foot, smear_m2)
            break
    if held >= MOST:
        return
    for k in range(held - 1, -1, -1):
        if t[HELD + k] >= half:
            at = t[Tn.FIRST_M] + k
            if k < held - 1:
                after = t[HELD + k + 1]
                at += (t[HELD + k] - half) / (t[HELD + k] - after)
            out[Turn.END_M] -= smeared(out[Turn.END_M] - at, foot, smear_m2)
            break


@compiled
def smeared(seen_m: float, foot: float, smear_m2: float) -> float:
    """By how much a ramp's foot is too far from its middle; `foot` is its share of the ramp."""
    if seen_m <= 0.0:
        return 0.0
    ramp = seen_m / foot
    return seen_m * (1.0 - math.sqrt(max(1.0 - smear_m2 / (ramp * ramp), 0.0)))


@compiled
def crossing(before: float, now: float) -> float:
    """Share of the last metre at which the limit was passed, up or down."""
    if before == now:
        return 1.0
    return min(max((LIMIT_PER_M - before) / (now - before), 0.0), 1.0)


@compiled
def between(t: Array, column: int, share: float) -> float:
    """A column of the samples, that far from the one before the window's middle to the middle."""
    middle = Tn.RING + COLUMNS * HALF + column
    value: float = t[middle - COLUMNS] + share * (t[middle] - t[middle - COLUMNS])
    return value
