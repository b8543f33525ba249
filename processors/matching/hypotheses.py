"""Hypotheses of the map matcher, compiled: which run the vehicle is on, and where.

The filter's estimate is off the true place by an error that changes slowly; a hypothesis says on
which rails the vehicle runs, and with that where the truth is: q = (east, north) in the plan and
h, the heading's error, with a covariance. q moves as the filter says that the vehicle moves, not as
its estimate jumps; it is drawn back to that as fast as its errors forget themselves (first-order
Gauss-Markov about the estimate, with the filter's own covariance). Where the filter itself has been
put onto these rails and is there, q is the filter's estimate (`SYNCED`). That the truth is on the
rails, and heads along them, is measured once a metre:

    across(q) = 0 ± σ_map,        ψ + h − ψ_run(s(q)) = 0 ± σ_ψ

The second depends on q through the curvature: curves tell where along the track the vehicle is.
Errors of a map are the same for `correlation_m`; white noise that gives as much information a
metre stands for them. Both innovations weigh the hypothesis against the others.

A run here has the direction of the vehicle's x axis, so speed may be negative; where trams are
meant to go is asked of the direction of motion. A hypothesis knows the run before and those ahead;
before the rails branch it is divided, so that each part follows its own curve all the way.

One block of memory holds a header and a row for each hypothesis.

Equations: docs/theory.md, section 11.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.localiser import COVARIANCE, YAW_RATE
from tramstream.tracks.rails import Rails, beside, place, sample_at

MOST = 48
"""Hypotheses at a time."""
AHEAD = 4
"""Runs that a hypothesis knows ahead."""
NONE, END = -1.0, -2.0
"""No run known; no rails."""

COUNT, WAY, OFF, SYNCED, LINEAGE, EVENTS, DIRECTION, KNOWN, BACK, FACED = range(10)
"""Header: hypotheses; way since the last weighing, m; logarithmic weight of being off the map; run
on which the filter was put onto the rails, or NONE; last number of a lineage; events since they
were read; sign of the motion along x; whether the filter's last covariance is there; way against
that direction, m; heading of the filter at the last step;"""
FILTER_P = 10
"""covariance of the filter's last place and heading: ee, en, nn, heading;"""
FLOOR = 14
"""below which the logarithmic weight of being off the map does not fall."""
HEAD = 15
RUN, CHAINAGE, BEFORE, NEXT = 0, 1, 2, 3
Q_EAST = NEXT + AHEAD
Q_NORTH, OFFSET = Q_EAST + 1, Q_EAST + 2
"""q, and h."""
P = OFFSET + 1
"""Covariance of these three, row by row."""
WEIGHT = P + 9
"""Logarithmic."""
OWN = WEIGHT + 1
"""Number of its lineage."""
ROW = OWN + 1
EVENT_COUNT, EVENT = 256, 4
"""Events: lineage, the one that it came from, run, chainage of entry."""
ROWS = HEAD
LOG = ROWS + MOST * ROW
MEMORY = LOG + EVENT_COUNT * EVENT

EAST, NORTH, YAW, SPEED, TURN, STEP, STANDING, HEADED, P_EE, P_EN, P_NN, P_YAW = range(12)
MOTION = 12
"""Of the filter, in the plan: place of the point that follows the rails; level speed along x; turn
and duration of this step; flags; covariance of place and heading."""
(
    A_EE, A_EN, A_EU, A_NE, A_NN, A_NU, L_EAST, L_NORTH, L_UP, PLAN_EAST, PLAN_NORTH, ROTATION,
) = range(12)  # fmt: skip
"""plan = A (l − l₀) + plan₀, and the angle that A turns by: `tramstream.tracks.map_frame`."""
FORGET_S, STD_M, CORRELATION_M, PIVOT_M, LEVER_M = range(5)
"""Time in which the filter's error forgets itself; σ_map; length over which the map's error is the
same; the vehicle's origin before the point that follows the rails; how far the antenna is from the
origin, which the covariance holds in all directions while the heading is not known."""

REVERSED_M = 0.5
"""A vehicle that has gone so far against its direction of travel has changed it."""
HEADING_SHARE = 1.2
"""Deviation of a heading over that of the place across by its correlation length: between 1 and
2.5, as that length is ℓ of exp(−d²/2ℓ²) or its integral."""
HEADING_LENGTH = 0.15
"""Correlation length of a heading, over that of the place across: a derivative forgets faster."""
DOUBT = 3.0
"""Variances of a filter that is not on the rails are taken for so much more: errors of fixes in
streets have heavy tails and last, and no filter knows by itself that all its fixes are wrong."""
WEIGHED_M = 1.0
"""Between two weighings."""
SLACK_M = 0.25
"""A hypothesis changes its run so far beyond the end: tracks meet with small steps."""
OFF_GATE = 9.0
"""Squared distance per correlation length and kind of measurement beyond which it is likelier that
the map is left."""
OFF_PRIOR = 0.02
OFF_RADIUS_M = 30.0
"""Off the map, a place is anywhere within so far of a track."""
OFF_FLOOR = math.log(1e-6)
UNMAPPED, UNMAPPED_LEFT = 5e-4, 0.05
"""Of vehicles beside a track, those on one that the map lacks; of those that have left the map."""
REFUSED = 16.0
"""Squared distance at which a measurement weighs but does not move a hypothesis any more,"""
WEIGHS_MOST = 30.0
"""and the most that one weighs."""
PRUNED = math.log(1e-5)
MERGED_M = 2.0


@compiled
def row(M: Array, k: int) -> Array:
    """Hypothesis number `k`."""
    return M[ROWS + k * ROW : ROWS + (k + 1) * ROW]


@compiled
def read_motion(values: Array, frame: Array, c: Array, z: Array) -> None:
    """Fill `z` from the values of an estimate, but for STEP and the flags."""
    V = values[COVARIANCE:].reshape((7, 7))
    yaw, v = values[6], values[3] * math.cos(values[5])
    e = values[0] - c[PIVOT_M] * math.cos(yaw) - frame[L_EAST]
    n = values[1] - c[PIVOT_M] * math.sin(yaw) - frame[L_NORTH]
    u = values[2] - frame[L_UP]
    z[EAST] = frame[PLAN_EAST] + frame[A_EE] * e + frame[A_EN] * n + frame[A_EU] * u
    z[NORTH] = frame[PLAN_NORTH] + frame[A_NE] * e + frame[A_NN] * n + frame[A_NU] * u
    z[YAW], z[SPEED], z[TURN] = yaw + frame[ROTATION], v, values[YAW_RATE]
    cos, sin = math.cos(frame[ROTATION]), math.sin(frame[ROTATION])
    ee, en, nn = V[0, 0], V[0, 1], V[1, 1]
    z[P_EE] = cos * cos * ee - 2.0 * cos * sin * en + sin * sin * nn
    z[P_NN] = sin * sin * ee + 2.0 * cos * sin * en + cos * cos * nn
    z[P_EN] = cos * sin * (ee - nn) + (cos * cos - sin * sin) * en
    z[P_YAW] = V[6, 6]


@compiled
def wrapped(angle: float) -> float:
    """Angle within ±π."""
    turned: float = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
    return turned


@compiled
def _note(M: Array, h: Array, parent: float) -> None:
    """Leave an event: a lineage has come to another run, or has just begun."""
    count = int(M[EVENTS])
    if count < EVENT_COUNT:
        at = LOG + count * EVENT
        M[at], M[at + 1], M[at + 2], M[at + 3] = h[OWN], parent, h[RUN], h[CHAINAGE]
    M[EVENTS] += 1.0


@compiled
def renew(M: Array, h: Array, parent: float) -> None:
    """Give a hypothesis a lineage of its own."""
    M[LINEAGE] += 1.0
    h[OWN] = M[LINEAGE]
    _note(M, h, parent)


# Motion ------------------------------------------------------------------------------------------
@compiled
def _cross(M: Array, rails: Rails, h: Array) -> None:
    """Go over to the next run, or back to the one before, where the place lies there."""
    length = rails.length_m[int(h[RUN]) >> 1]
    if h[CHAINAGE] > length + SLACK_M and h[NEXT] >= 0.0:
        h[BEFORE], h[RUN] = h[RUN], h[NEXT]
        for i in range(NEXT, NEXT + AHEAD - 1):
            h[i] = h[i + 1]
        h[NEXT + AHEAD - 1] = NONE
        h[CHAINAGE] -= length
    elif h[CHAINAGE] < -SLACK_M and h[BEFORE] >= 0.0:
        for i in range(NEXT + AHEAD - 1, NEXT, -1):
            h[i] = h[i - 1]
        h[NEXT], h[RUN], h[BEFORE] = h[RUN], h[BEFORE], NONE
        h[CHAINAGE] += rails.length_m[int(h[RUN]) >> 1]
    else:
        return
    renew(M, h, h[OWN])
    s, _, _, _ = beside(rails, int(h[RUN]), h[CHAINAGE], h[Q_EAST], h[Q_NORTH])
    h[CHAINAGE] = s


@compiled
def carry(M: Array, rails: Rails, z: Array, c: Array) -> None:
    """Move all hypotheses as the vehicle has moved."""
    step = z[STEP]
    way = z[SPEED] * step
    moving = z[STANDING] == 0.0
    keep = math.exp(-step / c[FORGET_S]) if moving else 1.0
    fresh = 1.0 - keep * keep
    # What the filter's heading has jumped by is no turn of the vehicle; neither h nor q goes along.
    jumped = 0.0
    if M[KNOWN] != 0.0:
        jumped = wrapped(z[YAW] - M[FACED] - z[TURN] * step)
    M[FACED] = z[YAW]
    grown_e = grown_n = grown_h = 0.0
    if M[KNOWN] != 0.0:
        grown_e = max(z[P_EE] - M[FILTER_P], 0.0)
        grown_n = max(z[P_NN] - M[FILTER_P + 2], 0.0)
        grown_h = max(z[P_YAW] - M[FILTER_P + 3], 0.0)
    M[KNOWN], M[FILTER_P], M[FILTER_P + 1] = 1.0, z[P_EE], z[P_EN]
    M[FILTER_P + 2], M[FILTER_P + 3] = z[P_NN], z[P_YAW]
    for k in range(int(M[COUNT])):
        h = row(M, k)
        C = h[P : P + 9].reshape((3, 3))
        if h[RUN] == M[SYNCED]:
            h[Q_EAST], h[Q_NORTH], h[OFFSET] = z[EAST], z[NORTH], 0.0
            C[:] = 0.0
            C[0, 0], C[0, 1], C[1, 0], C[1, 1] = z[P_EE], z[P_EN], z[P_EN], z[P_NN]
            C[2, 2] = z[P_YAW]
        elif moving:
            yaw = z[YAW] - jumped + h[OFFSET] - 0.5 * z[TURN] * step
            de, dn = way * math.cos(yaw), way * math.sin(yaw)
            h[Q_EAST] = z[EAST] + keep * (h[Q_EAST] + de - z[EAST])
            h[Q_NORTH] = z[NORTH] + keep * (h[Q_NORTH] + dn - z[NORTH])
            h[OFFSET] = keep * (h[OFFSET] - jumped)
            for i in range(3):  # P ← F P Fᵀ: a false heading moves q sideways
                C[0, i] -= dn * C[2, i]
                C[1, i] += de * C[2, i]
            for i in range(3):
                C[i, 0] -= dn * C[i, 2]
                C[i, 1] += de * C[i, 2]
            C *= keep * keep
            C[0, 0] += fresh * DOUBT * z[P_EE] + grown_e
            C[0, 1] += fresh * DOUBT * z[P_EN]
            C[1, 0] += fresh * DOUBT * z[P_EN]
            C[1, 1] += fresh * DOUBT * z[P_NN] + grown_n
            C[2, 2] += fresh * DOUBT * z[P_YAW] + grown_h
        guess = h[CHAINAGE] + way
        s, _, _, _ = beside(rails, int(h[RUN]), guess, h[Q_EAST], h[Q_NORTH])
        h[CHAINAGE] = s
        _cross(M, rails, h)
    M[SYNCED] = NONE
    if moving:
        M[WAY] += abs(way)
        M[BACK] = 0.0 if way * M[DIRECTION] > 0.0 else M[BACK] + abs(way)
        if M[BACK] > REVERSED_M:
            M[BACK], M[DIRECTION] = 0.0, -M[DIRECTION]


# Weights -----------------------------------------------------------------------------------------
@compiled
def _scalar(h: Array, H0: float, H1: float, H2: float, y: float, R: float) -> tuple[float, float]:
    """Take a scalar; gives squared distance and S."""
    C = h[P : P + 9].reshape((3, 3))
    g0 = C[0, 0] * H0 + C[0, 1] * H1 + C[0, 2] * H2
    g1 = C[1, 0] * H0 + C[1, 1] * H1 + C[1, 2] * H2
    g2 = C[2, 0] * H0 + C[2, 1] * H1 + C[2, 2] * H2
    S = H0 * g0 + H1 * g1 + H2 * g2 + R
    distance = y * y / S
    if distance < REFUSED:
        h[Q_EAST] += g0 * y / S
        h[Q_NORTH] += g1 * y / S
        h[OFFSET] += g2 * y / S
        g = (g0, g1, g2)
        for i in range(3):
            for j in range(3):
                C[i, j] -= g[i] * g[j] / S
    return distance, S


@compiled
def variances(rails: Rails, c: Array, run: int, s: float) -> tuple[float, float]:
    """Of the rails about the map: across, m², and of the heading, rad²."""
    j = sample_at(rails, run, s)
    across = c[STD_M] ** 2 + rails.across_std_m[j] ** 2
    heading = (HEADING_SHARE * c[STD_M] / c[CORRELATION_M]) ** 2 + rails.yaw_std[j] ** 2
    return across, heading


@compiled
def heading_noise(share: float) -> float:
    """By how much the variance of a heading is that of one measurement; see `on_rails`."""
    return 1.0 / min(share / HEADING_LENGTH, 1.0)


@compiled
def on_rails(h: Array, rails: Rails, z: Array, c: Array, share: float) -> tuple[float, float]:
    """Take that a hypothesis is on its rails; gives −2 ln of the likelihood, but for constants.

    Of that, the normalising part comes apart as well. Noise of the map that is the same over a
    correlation length counts once in it, however many measurements share it.

    Parameters
    ----------
    share : float
        How much of a correlation length's information this is.
    """
    run = int(h[RUN])
    s, across, yaw, k = beside(rails, run, h[CHAINAGE], h[Q_EAST], h[Q_NORTH])
    var_across, var_yaw = variances(rails, c, run, s)
    noise = var_across / share
    cos, sin = math.cos(yaw), math.sin(yaw)
    distance, S = _scalar(h, -sin, cos, 0.0, -across, noise)
    norm = math.log(S / noise) + share * math.log(var_across)
    cost = min(distance, WEIGHS_MOST)
    if z[HEADED] != 0.0:
        s, across, yaw, k = beside(rails, run, s, h[Q_EAST], h[Q_NORTH])
        bend = k / max(1.0 - k * across, 0.2)
        y = wrapped(yaw - z[YAW] - h[OFFSET])
        noise = var_yaw * heading_noise(share)
        distance, S = _scalar(h, -bend * math.cos(yaw), -bend * math.sin(yaw), 1.0, y, noise)
        norm += math.log(S / noise) + math.log(var_yaw) / heading_noise(share)
        cost += min(distance, WEIGHS_MOST)
        s, across, yaw, k = beside(rails, run, s, h[Q_EAST], h[Q_NORTH])
    h[CHAINAGE] = s
    length = rails.length_m[run >> 1]
    # Beyond the end of all rails: a metre each way is the map's, the rest is the hypothesis' own.
    over = max(s - length if h[NEXT] < 0.0 else 0.0, -s if h[BEFORE] < 0.0 else 0.0)
    if over > SLACK_M:
        C = h[P : P + 9].reshape((3, 3))
        cost += over * over * share / (1.0 + min(C[0, 0] + C[1, 1], 25.0) / 4.0)
    return cost + norm, norm


@compiled
def weigh(M: Array, rails: Rails, z: Array, c: Array) -> None:
    """Hold all hypotheses to the rails and weigh them."""
    share = min(M[WAY] / c[CORRELATION_M], 1.0)
    M[WAY] = 0.0
    best, off = -math.inf, 0.0
    kinds = 2.0 if z[HEADED] != 0.0 else 1.0
    for k in range(int(M[COUNT])):
        h = row(M, k)
        cost, norm = on_rails(h, rails, z, c, share)
        if h[WEIGHT] > best:
            best = h[WEIGHT]
            off = -0.5 * (kinds * OFF_GATE * share + norm)
        h[WEIGHT] -= 0.5 * cost
    M[OFF] += off


@compiled
def tidy(M: Array) -> None:
    """Join hypotheses that say the same, leave out the unlikely, make weights add up to 1."""
    count = int(M[COUNT])
    for k in range(count):
        h = row(M, k)
        for n in range(k):
            g = row(M, n)
            same = g[RUN] == h[RUN] and abs(g[CHAINAGE] - h[CHAINAGE]) < MERGED_M
            for i in range(NEXT, NEXT + AHEAD):
                same = same and g[i] == h[i]
            if same and g[WEIGHT] > -math.inf and h[WEIGHT] > -math.inf:
                high, low = max(g[WEIGHT], h[WEIGHT]), min(g[WEIGHT], h[WEIGHT])
                if h[WEIGHT] > g[WEIGHT]:
                    g[:] = h
                g[WEIGHT] = high + math.log1p(math.exp(low - high))
                h[WEIGHT] = -math.inf
    best = M[OFF]
    for k in range(count):
        best = max(best, row(M, k)[WEIGHT])
    total = math.exp(M[OFF] - best)
    kept = 0
    for k in range(count):
        h = row(M, k)
        if h[WEIGHT] - best > PRUNED:
            total += math.exp(h[WEIGHT] - best)
            if kept != k:
                row(M, kept)[:] = h
            kept += 1
    M[COUNT] = kept
    norm = best + math.log(total)
    off = max(M[OFF] - norm, M[FLOOR])
    norm += math.log1p(-math.exp(M[OFF] - norm)) - math.log1p(-math.exp(off)) if kept else 0.0
    for k in range(kept):
        row(M, k)[WEIGHT] -= norm
    M[OFF] = off


@compiled
def seed(M: Array, rails: Rails, z: Array, c: Array, run: int, s: float, prior: float) -> None:
    """Add a hypothesis: the vehicle is beside chainage `s` of a run."""
    k = int(M[COUNT])
    if k >= MOST:
        return
    h = row(M, k)
    h[:] = 0.0
    h[RUN], h[CHAINAGE], h[BEFORE] = run, s, NONE
    for i in range(NEXT, NEXT + AHEAD):
        h[i] = NONE
    h[Q_EAST], h[Q_NORTH] = z[EAST], z[NORTH]
    C = h[P : P + 9].reshape((3, 3))
    C[0, 0], C[0, 1], C[1, 0], C[1, 1] = z[P_EE], z[P_EN], z[P_EN], z[P_NN]
    C[2, 2] = z[P_YAW]
    if z[HEADED] == 0.0:  # the antenna is on a circle about the vehicle: put it along the track
        yaw, half = place(rails, run, s)[2], 0.5 * c[LEVER_M] ** 2
        e, n = math.cos(yaw), math.sin(yaw)
        if C[0, 0] * n * n - 2.0 * C[0, 1] * e * n + C[1, 1] * e * e > half:  # the circle is in C
            C[0, 0], C[1, 1] = C[0, 0] + half * (e * e - n * n), C[1, 1] - half * (e * e - n * n)
            C[0, 1] = C[1, 0] = C[0, 1] + 2.0 * half * e * n
    C *= DOUBT
    cost, _ = on_rails(h, rails, z, c, 1.0)
    kinds = 2.0 if z[HEADED] != 0.0 else 1.0
    h[WEIGHT] = math.log(prior) - 0.5 * (cost + kinds * math.log(2.0 * math.pi))
    M[COUNT] = k + 1
    renew(M, h, -1.0)
