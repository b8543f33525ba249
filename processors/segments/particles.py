"""Where on which line: particles that go along all lines at once, compiled.

A particle is a place (chainage), a line in a direction, how much longer the true way is than the
counted one, and which way it goes along the line. Each few metres it moves by what was gone, and is
weighed by how well the vehicle's heading runs as the line's does. No compass is needed: what the
two differ by is one more unknown of each particle, with a filter of its own, and the rest of their
difference is taken for an error of the map that fades over `FADING_M`. Beside the particles stands
the hypothesis that the vehicle is on none of the lines: headings as tracks in general have them.

Equations: docs/theory.md, section 20.
"""

from __future__ import annotations

import math
from enum import IntEnum

from tramstream.estimation.kalman import Array, Indices, compiled


class Pt(IntEnum):
    """Columns of a particle."""

    AT_M = 0
    SCALE = 1
    LINE = 2
    WAY = 3
    """1: it goes along the line's direction; -1: against."""
    LOG_WEIGHT = 4
    OFFSET = 5
    """Heading of the vehicle less that of the line, rad,"""
    VARIANCE = 6
    """and its variance; negative before the first heading."""
    DIFFERENCE = 7
    """At the step before."""


COLUMNS = len(Pt)


class Step(IntEnum):
    """What a step of the vehicle tells, one row of numbers."""

    WAY_M = 0
    """Gone along x of the vehicle."""
    YAW = 1
    """Its heading now, counter-clockwise from anywhere."""
    TURNED = 2
    """What that has changed by."""
    WAY_STD = 3
    """Of the way, m,"""
    SCALE_STD = 4
    """of what the scale has changed by,"""
    DRIFT_STD = 5
    """of what the heading has drifted by, and"""
    LINE_STD = 6
    """of the headings of lines, rad."""
    BEFORE = 7
    """What the heading has changed by in the step before."""


STEP = len(Step)

FADING_M = 30.0
"""Over which the heading error of a map, or of a learned line, is forgotten."""
SWAY_STD_RAD = 0.004
"""Of the heading at each step: the body sways."""
ANGLE_PART = 0.2
"""Of a change of heading, the vehicle's or the line's: how a curve is drawn. Rails laid beside
lines 7 and 20 by `simulation/track_rides.py` turn by a third more or less than the map within 4 m
of curves below 50 m, by 3.5 mrad elsewhere."""
OUTLIER = 0.01
OUTLIER_STD_RAD = 0.25
"""A map has a curve elsewhere now and then."""
GOES_ON, GOES_ON_PART = 0.7, 0.3
"""Share of steps in which a track in general turns as in the step before, within that part of it
and what a line that fits is off by: a straight that goes on speaks for no line;"""
STRAIGHT = 0.1
"""in which it is straight,"""
CURVED_STD_RAD = 0.09
"""and how much it turns in the others; lines 7 and 20, steps of 4 m."""
TEMPER = 0.8
"""What a step tells, by this part: models are not the world."""
BEYOND_M = 30.0
"""A line's last stop may lie so far before the end of its track."""
BEYOND_COST = 3.0


@compiled
def density(value: float, std: float) -> float:
    """Of a normal distribution."""
    return math.exp(-0.5 * (value / std) ** 2) / (std * 2.5066282746310002)


@compiled
def move(
    particles: Array,
    noise: Array,
    step: Array,
    yaw: Array,
    starts: Indices,
) -> float:
    """Let the particles go on and weigh them; the log-likelihood of being on none of the lines.

    Parameters
    ----------
    particles : ndarray, shape (n, COLUMNS)
        Changed in place.
    noise : ndarray, shape (n, 2)
        Of the unit normal distribution, for place and scale.
    step : ndarray, shape (STEP,)
        A row of `Step`.
    yaw : ndarray
        Headings of all lines, each metre, one line after another.
    starts : ndarray of int64
        Where each line begins in them, and the number of all.
    """
    way, turned = step[Step.WAY_M], step[Step.TURNED]
    keep = math.exp(-abs(way) / FADING_M)
    fresh = step[Step.LINE_STD] * math.sqrt(max(1.0 - keep * keep, 1e-6))
    white = fresh * fresh + SWAY_STD_RAD * SWAY_STD_RAD
    drift = step[Step.DRIFT_STD] * step[Step.DRIFT_STD]
    none = general(turned, step[Step.BEFORE], white)
    for i in range(particles.shape[0]):
        p = particles[i]
        line = int(p[Pt.LINE])
        first = starts[line]
        length = float(starts[line + 1] - first - 1)
        p[Pt.SCALE] += step[Step.SCALE_STD] * noise[i, 1]
        p[Pt.AT_M] += p[Pt.WAY] * way * (1.0 + p[Pt.SCALE]) + step[Step.WAY_STD] * noise[i, 0]
        if p[Pt.AT_M] < -BEYOND_M or p[Pt.AT_M] > length + BEYOND_M:
            p[Pt.LOG_WEIGHT] -= BEYOND_COST
            p[Pt.VARIANCE] = -1.0
            continue
        difference = step[Step.YAW] - heading(yaw, first, length, p[Pt.AT_M])
        if p[Pt.VARIANCE] < 0.0:
            p[Pt.OFFSET] = difference
            p[Pt.VARIANCE] = step[Step.LINE_STD] * step[Step.LINE_STD]
            p[Pt.DIFFERENCE] = difference
            p[Pt.LOG_WEIGHT] += TEMPER * math.log(none)
            continue
        p[Pt.VARIANCE] += drift
        drawn = turned - difference + p[Pt.DIFFERENCE]
        R = white + (ANGLE_PART * max(abs(turned), abs(drawn))) ** 2
        H = 1.0 - keep
        y = difference - keep * p[Pt.DIFFERENCE] - H * p[Pt.OFFSET]
        S = H * H * p[Pt.VARIANCE] + R
        fits = (1.0 - OUTLIER) * density(y, math.sqrt(S))
        wide = OUTLIER * density(y, OUTLIER_STD_RAD)
        gain = p[Pt.VARIANCE] * H / S * fits / (fits + wide)
        p[Pt.OFFSET] += gain * y
        p[Pt.VARIANCE] *= 1.0 - gain * H
        p[Pt.DIFFERENCE] = difference
        p[Pt.LOG_WEIGHT] += TEMPER * math.log(fits + wide)
    return TEMPER * math.log(none)


@compiled
def general(turned: float, before: float, white: float) -> float:
    """Density of what a track in general turns by within a step after another."""
    std = math.sqrt(white)
    return (
        GOES_ON * density(turned - before, math.hypot(std, GOES_ON_PART * before))
        + STRAIGHT * density(turned, std)
        + (1.0 - GOES_ON - STRAIGHT) * density(turned, CURVED_STD_RAD)
    )


@compiled
def heading(yaw: Array, first: int, length: float, at_m: float) -> float:
    """Heading of a line, straight on beyond its ends."""
    at = min(max(at_m, 0.0), length)
    cell = min(int(at), int(length) - 1)
    share = at - cell
    found: float = yaw[first + cell] * (1.0 - share) + yaw[first + cell + 1] * share
    return found


@compiled
def near_stops(
    particles: Array, stops: Array, starts: Indices, std_m: float, share: float, apart_m: float
) -> None:
    """Weigh particles by a stand, of which a share is at stops that are `apart_m` from each other.

    Parameters
    ----------
    stops : ndarray
        Chainages of all lines, ascending, one line after another.
    starts : ndarray of int64
        Where each line begins in them, and the number of all.
    """
    for i in range(particles.shape[0]):
        line = int(particles[i, Pt.LINE])
        nearest = 1e9
        for k in range(starts[line], starts[line + 1]):
            nearest = min(nearest, abs(stops[k] - particles[i, Pt.AT_M]))
        fits = 1.0 - share + share * apart_m * density(nearest, std_m)
        particles[i, Pt.LOG_WEIGHT] += math.log(fits)


@compiled
def resample(particles: Array, weights: Array, offset: float, out: Array, origin: Indices) -> None:
    """Draw systematically: `out` has particles in proportion to weights that add up to one.

    `origin` says which particle each of them was.
    """
    count = out.shape[0]
    total, i = weights[0], 0
    for k in range(count):
        at = (k + offset) / count
        while total < at and i < particles.shape[0] - 1:
            i += 1
            total += weights[i]
        for j in range(particles.shape[1]):
            out[k, j] = particles[i, j]
        out[k, Pt.LOG_WEIGHT] = 0.0
        origin[k] = i
