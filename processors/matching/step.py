"""A step of the map matcher, compiled: hypotheses move, are weighed, and divide where rails branch.

What comes out is put together here too: the likeliest run with its probability, others beside it,
and, where no doubt is left, by how much the filter's estimate is off the rails.

Equations: docs/theory.md, sections 11.5 and 11.6.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.matching.hypotheses import (
    AHEAD,
    BEFORE,
    CHAINAGE,
    CORRELATION_M,
    COUNT,
    DIRECTION,
    EAST,
    END,
    HEADED,
    MOST,
    NEXT,
    NONE,
    NORTH,
    OFF,
    OWN,
    ROTATION,
    RUN,
    STANDING,
    SYNCED,
    WAY,
    WEIGHED_M,
    WEIGHT,
    YAW,
    P,
    carry,
    read_motion,
    renew,
    row,
    tidy,
    variances,
    weigh,
    wrapped,
)
from tramstream.tracks.rails import Rails, beside, place, sample_at

HORIZON_M, HORIZON_MOST_M = 8.0, 60.0
HORIZON_STDS = 3.0
"""So far ahead of where the vehicle may be a hypothesis is divided."""
CERTAIN = 0.995
"""A filter is put onto rails that are so likely."""
ALTERNATIVES = 4
CURVES = 3.0
"""Variances of a map's headings are so much larger to a filter: curves are where maps are wrong the
most, and what one of them tells of the place along the track is believed for long."""
GRADE_CORRELATION_M = 100.0
"""A pixel of the terrain model."""

BEST, PROBABILITY, OFF_PROBABILITY, OTHERS = range(4)
"""Of what comes out: number of the likeliest hypothesis, probability of its run and of being off
the map, number of other runs;"""
OTHER = 4
"""run, chainage, probability of each of those;"""
(
    EDGE,
    EDGE_CHAINAGE,
    ALONG_STD,
    MATCHED_EAST,
    MATCHED_NORTH,
    CERTAINLY,
    NORMAL_EAST,
    NORMAL_NORTH,
    ACROSS,
    YAW_OFF,
    BEND,
    ACROSS_VARIANCE,
    YAW_VARIANCE,
    GRADE,
    GRADE_VARIANCE,
) = range(OTHER + 3 * ALTERNATIVES, OTHER + 3 * ALTERNATIVES + 15)
"""the run in the direction of motion, chainage along it, deviation; matched place in the plan; 1 if
what follows is there, see `tramstream.estimation.localiser.OnTrack`."""
OUT = GRADE_VARIANCE + 1


# Where rails branch ------------------------------------------------------------------------------
@compiled
def allowed(rails: Rails, run: int, direction: float) -> bool:
    """Whether trams are meant to go along a run (direction > 0) or against it."""
    moving = run if direction > 0.0 else run ^ 1
    return bool(rails.rules[moving >> 1] & (1 if moving & 1 == 0 else 2))


@compiled
def _divide(M: Array, rails: Rails, k: int, last: int, slot: int, backwards: bool) -> bool:
    """Let hypothesis `k` know what follows `last`; one part for each way. False: no room."""
    leaving = last ^ 1 if backwards else last
    first, end = rails.following_starts[leaving], rails.following_starts[leaving + 1]
    direction = M[DIRECTION]
    legal = 0
    for i in range(first, end):
        run = rails.following[i] ^ 1 if backwards else rails.following[i]
        legal += allowed(rails, run, direction)
    h = row(M, k)
    if first == end:
        h[slot] = END
        return True
    ways = legal if legal else end - first
    if int(M[COUNT]) + ways - 1 > MOST:
        return False
    h[WEIGHT] -= math.log(ways)
    parent, used = h[OWN], 0
    for i in range(first, end):
        run = rails.following[i] ^ 1 if backwards else rails.following[i]
        if legal and not allowed(rails, run, direction):
            continue
        part = h
        if used:
            n = int(M[COUNT])
            part = row(M, n)
            part[:] = h
            M[COUNT] = n + 1
        part[slot] = run
        used += 1
    if ways > 1:
        for n in range(int(M[COUNT]) - ways + 1, int(M[COUNT])):
            renew(M, row(M, n), parent)
        renew(M, h, parent)
    return True


@compiled
def _branch(M: Array, rails: Rails, z: Array) -> None:
    """Divide hypotheses whose known rails end before the horizon."""
    k = 0
    while k < int(M[COUNT]):
        h = row(M, k)
        k += 1
        C = h[P : P + 9].reshape((3, 3))
        cos, sin = math.cos(z[YAW]), math.sin(z[YAW])
        along = cos * cos * C[0, 0] + 2.0 * cos * sin * C[0, 1] + sin * sin * C[1, 1]
        horizon = HORIZON_M + HORIZON_STDS * math.sqrt(max(along, 0.0))
        horizon = min(horizon, HORIZON_MOST_M)
        if M[DIRECTION] < 0.0:
            if h[CHAINAGE] < horizon and h[BEFORE] == NONE:
                _divide(M, rails, k - 1, int(h[RUN]), BEFORE, True)
            continue
        known, last, slot = rails.length_m[int(h[RUN]) >> 1] - h[CHAINAGE], int(h[RUN]), NEXT
        while slot < NEXT + AHEAD and h[slot] >= 0.0:
            last = int(h[slot])
            known += rails.length_m[last >> 1]
            slot += 1
        short = known < horizon and slot < NEXT + AHEAD and h[slot] == NONE
        if short and _divide(M, rails, k - 1, last, slot, False):
            k -= 1  # what follows may be short as well


# What comes out ----------------------------------------------------------------------------------
@compiled
def _share(M: Array, run: float, following: float) -> float:
    """Probability of a run, or of a run with what follows it if that is not NONE."""
    total = 0.0
    for k in range(int(M[COUNT])):
        h = row(M, k)
        if h[RUN] == run and (following == NONE or h[NEXT] == following):
            total += math.exp(h[WEIGHT])
    return total


@compiled
def _rank(M: Array, out: Array) -> None:
    """Runs in order of probability, each with its likeliest hypothesis."""
    count = int(M[COUNT])
    runs = 0
    taken = out[OTHER : OTHER + 3 * ALTERNATIVES]
    out[BEST], out[PROBABILITY] = NONE, 0.0
    for place_ in range(ALTERNATIVES + 1):
        best, chosen, first = 0.0, -1, 0.0
        for k in range(count):
            h = row(M, k)
            known = h[RUN] == row(M, int(out[BEST]))[RUN] if out[BEST] >= 0.0 else False
            for i in range(runs):
                known = known or taken[3 * i] == h[RUN]
            if known:
                continue
            total = _share(M, h[RUN], NONE)
            if total > best or (
                chosen >= 0 and h[RUN] == first and h[WEIGHT] > row(M, chosen)[WEIGHT]
            ):
                best, chosen, first = total, k, h[RUN]
        if chosen < 0:
            break
        h = row(M, chosen)
        if place_ == 0:
            out[BEST], out[PROBABILITY] = chosen, best
        else:
            taken[3 * runs], taken[3 * runs + 1], taken[3 * runs + 2] = h[RUN], h[CHAINAGE], best
            runs += 1
    out[OTHERS] = runs
    out[OFF_PROBABILITY] = math.exp(M[OFF])


@compiled
def summary(
    M: Array, rails: Rails, z: Array, c: Array, frame: Array, weighed: bool, out: Array
) -> None:
    """Fill `out`."""
    _rank(M, out)
    out[CERTAINLY] = 0.0
    if out[BEST] < 0.0:
        return
    h = row(M, int(out[BEST]))
    run, s = int(h[RUN]), h[CHAINAGE]
    length = rails.length_m[run >> 1]
    C = h[P : P + 9].reshape((3, 3))
    e, n, yaw, _ = place(rails, run, s)
    cos, sin = math.cos(yaw), math.sin(yaw)
    along = cos * cos * C[0, 0] + 2.0 * cos * sin * C[0, 1] + sin * sin * C[1, 1]
    out[ALONG_STD] = math.sqrt(max(along, 0.0))
    out[MATCHED_EAST], out[MATCHED_NORTH] = e, n
    inside = min(max(s, 0.0), length)
    forwards = M[DIRECTION] >= 0.0
    out[EDGE] = run if forwards else run ^ 1
    out[EDGE_CHAINAGE] = inside if forwards else length - inside
    if weighed and z[HEADED] != 0.0 and z[STANDING] == 0.0 and out[PROBABILITY] >= CERTAIN:
        _certainly(M, rails, z, c, frame, h, out)


@compiled
def _certainly(
    M: Array, rails: Rails, z: Array, c: Array, frame: Array, h: Array, out: Array
) -> None:
    """How far the filter's own estimate is off the rails of a hypothesis."""
    run = int(h[RUN])
    s, across, yaw, k = beside(rails, run, h[CHAINAGE], z[EAST], z[NORTH])
    length = rails.length_m[run >> 1]
    if s > length:
        if h[NEXT] < 0.0 or _share(M, h[RUN], h[NEXT]) < CERTAIN:
            return
        run = int(h[NEXT])
        s, across, yaw, k = beside(rails, run, s - length, z[EAST], z[NORTH])
    elif s < 0.0 and h[BEFORE] < 0.0:
        return
    elif s < 0.0:
        run = int(h[BEFORE])
        s, across, yaw, k = beside(rails, run, s + rails.length_m[run >> 1], z[EAST], z[NORTH])
    yaw_l = yaw - frame[ROTATION]
    out[CERTAINLY] = 1.0
    out[NORMAL_EAST], out[NORMAL_NORTH] = -math.sin(yaw_l), math.cos(yaw_l)
    out[ACROSS], out[YAW_OFF] = across, wrapped(z[YAW] - yaw)
    out[BEND] = k / max(1.0 - k * across, 0.2)
    var_across, var_yaw = variances(rails, c, run, s)
    share = WEIGHED_M / c[CORRELATION_M]
    out[ACROSS_VARIANCE], out[YAW_VARIANCE] = var_across / share, CURVES * var_yaw / share
    j = sample_at(rails, run, s)
    grade = float(rails.grade[j])
    out[GRADE] = grade if run & 1 == 0 else -grade
    out[GRADE_VARIANCE] = float(rails.grade_std[j]) ** 2 * GRADE_CORRELATION_M / WEIGHED_M
    # A filter that is still on its way onto the rails would be held against them again.
    if across * across < var_across and out[YAW_OFF] ** 2 < var_yaw:
        M[SYNCED] = h[RUN]


@compiled
def advance(
    M: Array, rails: Rails, values: Array, frame: Array, c: Array, z: Array, out: Array
) -> None:
    """Take a step; STEP and flags of `z` are in place. `out` is filled."""
    read_motion(values, frame, c, z)
    carry(M, rails, z, c)
    weighed = M[WAY] >= WEIGHED_M
    if weighed:
        weigh(M, rails, z, c)
    _branch(M, rails, z)
    if weighed:
        tidy(M)
    summary(M, rails, z, c, frame, weighed, out)
