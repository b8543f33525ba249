"""A step of the map matcher, compiled: hypotheses move, are weighed, and divide where rails branch.

What comes out is put together here too: the likeliest run with its probability, others beside it,
and once a metre the track near the vehicle as a circle, for a localisation filter.

Equations: docs/theory.md, sections 11.5 and 11.6.
"""

from __future__ import annotations

import math

from tramstream.estimation import track
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
    HEADING_LENGTH,
    MOST,
    NEXT,
    NONE,
    NORTH,
    OFF,
    OWN,
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

CERTAIN = track.CERTAIN
HORIZON_M, HORIZON_MOST_M = 8.0, 60.0
HORIZON_STDS = 3.0
"""So far ahead of where the vehicle may be a hypothesis is divided."""
LIKELY = 0.5
"""The track is told from this probability on; from what it is believed on, who is told knows."""
DEPARTS_M, STEP_M, FARTHEST_M, NEAREST_M = 0.1, 2.0, 50.0, 1.0
"""A circle stands for the track until that departs from it by so much, looked at in such steps, no
farther, and a metre at least, by which tracks that meet may miss each other."""
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
    TOLD,
    TOLD_RUN,
    TOLD_CHAINAGE,
    TOLD_PROBABILITY,
    TOLD_EAST,
    TOLD_NORTH,
    TOLD_YAW,
    CURVATURE,
    ACROSS_VARIANCE,
    YAW_VARIANCE,
    CURVATURE_VARIANCE,
    GRADE,
    GRADE_VARIANCE,
    AHEAD_M,
    BEHIND_M,
) = range(OTHER + 3 * ALTERNATIVES, OTHER + 3 * ALTERNATIVES + 20)
"""the run in the direction of motion, chainage along it, deviation; matched place in the plan; 1 if
what follows is there, see `matcher.Circle`."""
OUT = BEHIND_M + 1


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
def summary(M: Array, rails: Rails, z: Array, c: Array, weighed: bool, out: Array) -> None:
    """Fill `out`."""
    _rank(M, out)
    out[TOLD] = 0.0
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
    if weighed and z[HEADED] != 0.0 and z[STANDING] == 0.0 and out[PROBABILITY] >= LIKELY:
        _tell(M, rails, z, c, h, out)


@compiled
def _tell(M: Array, rails: Rails, z: Array, c: Array, h: Array, out: Array) -> None:
    """Describe the rails of a hypothesis beside the estimate."""
    run, probability = int(h[RUN]), out[PROBABILITY]
    s, _, _, _ = beside(rails, run, h[CHAINAGE], z[EAST], z[NORTH])
    length = rails.length_m[run >> 1]
    if s > length:
        if h[NEXT] < 0.0:
            return
        probability = _share(M, h[RUN], h[NEXT])
        run = int(h[NEXT])
        s, _, _, _ = beside(rails, run, s - length, z[EAST], z[NORTH])
    elif s < 0.0 and h[BEFORE] < 0.0:
        return
    elif s < 0.0:
        run = int(h[BEFORE])
        s, _, _, _ = beside(rails, run, s + rails.length_m[run >> 1], z[EAST], z[NORTH])
    e, n, yaw, k = place(rails, run, s)
    out[TOLD] = 1.0
    out[TOLD_RUN], out[TOLD_CHAINAGE], out[TOLD_PROBABILITY] = run, s, probability
    out[TOLD_EAST], out[TOLD_NORTH], out[TOLD_YAW], out[CURVATURE] = e, n, yaw, k
    var_across, var_yaw = variances(rails, c, run, s)
    share = WEIGHED_M / c[CORRELATION_M]
    out[ACROSS_VARIANCE], out[YAW_VARIANCE] = var_across / share, CURVES * var_yaw / share
    out[CURVATURE_VARIANCE] = var_yaw / (HEADING_LENGTH * c[CORRELATION_M]) ** 2
    j = sample_at(rails, run, s)
    grade = float(rails.grade[j])
    out[GRADE] = grade if run & 1 == 0 else -grade
    out[GRADE_VARIANCE] = float(rails.grade_std[j]) ** 2 * GRADE_CORRELATION_M / WEIGHED_M
    out[AHEAD_M] = _reach(rails, run, s, 1.0)
    out[BEHIND_M] = _reach(rails, run, s, -1.0)
    # A filter that is still on its way onto the rails would be held against them again.
    across = math.cos(yaw) * (z[NORTH] - n) - math.sin(yaw) * (z[EAST] - e)
    off = wrapped(z[YAW] - yaw)
    if probability >= CERTAIN and across * across < var_across and off * off < var_yaw:
        M[SYNCED] = h[RUN]


@compiled
def _reach(rails: Rails, run: int, s: float, sign: float) -> float:
    """How far the circle through a place stands for the rails, ahead (sign 1) or behind (−1)."""
    e, n, yaw, k = place(rails, run, s)
    cos, sin = math.cos(yaw), math.sin(yaw)
    farthest = min(rails.length_m[run >> 1] - s if sign > 0.0 else s, FARTHEST_M)
    reach, way = NEAREST_M, STEP_M
    while way <= farthest:
        d = sign * way
        along, left = d, 0.0
        if abs(k * d) > 1e-9:
            along, left = math.sin(k * d) / k, (1.0 - math.cos(k * d)) / k
        there_e, there_n, _, _ = place(rails, run, s + d)
        de = there_e - (e + cos * along - sin * left)
        dn = there_n - (n + sin * along + cos * left)
        if de * de + dn * dn > DEPARTS_M * DEPARTS_M:
            break
        reach = way
        way += STEP_M
    return reach


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
    summary(M, rails, z, c, weighed, out)
