"""Smooth curves through the noisy nodes of mapped tracks, with the deviation that they have.

Either coordinate is a Gaussian process whose third derivative against arc length is white noise
(the curvature is a random walk), seen at the nodes with deviation σ: `track_smoother` gives mean
and covariance. Nothing but the error across the track is looked at, since how far a node lies
along it says nothing. Two things are learnt from the whole map (`_learn`):

- The density q of the noise. Straights are straight and curves are tight, so it differs from place
  to place, by six decades. Whoever drew the map put nodes where the track bends: q is expected to
  be a power of the distance h of nodes, and each place deviates from that as far as its own nodes
  tell (fixed-point steps to the maximum of the likelihood of the evidence within `REACH_M`, with
  the law worth `DOUBT` observations). The law itself is the median of places.
- σ, such that the squares of the residuals are as large as expected.

Scaling σ² and q alike changes no mean and scales all covariances. So at last both are scaled until
the errors of curves at nodes that they were fitted without are as large as stated (`Fit.left_out`).
What is common to all nodes around, such as a shift of the aerial image they were drawn from, is not
in it: no curve through them could show it.

Equations: docs/theory.md, sections 10.1 and 10.2.

References
----------
G. Wahba, "Improper priors, spline smoothing and the problem of guarding against model errors in
regression", Journal of the Royal Statistical Society B 40 (1978) 364-372: the spline is such a
process. D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4 (1992) 415-447: the
fixed-point steps of σ² and q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.mapping.curve import between, curvature_per_m, lengths_m, share_at, variances
from tramstream.mapping.smoother import filter_curves, smooth_curves, spread
from tramstream.tracks.network import SAMPLE_M

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

REACH_M = 10.0
"""Clothoids of a city are about that long: so far the evidence of a place counts."""
DOUBT = 0.3
"""How little the power law of q is worth, as a number of observations. Three times as much, or
twice the reach, make left-out nodes of Prague no likelier."""
FIRST_NODE_STD_M = 0.1
FIRST_Q, FIRST_POWER = 1e-6, -2.8
"""Rad²/m³ at `USUAL_SPACING_M`, and power of the distance: what Prague's map has. Rounds begin
there; small maps keep it."""
Q_MIN = 1e-12
"""Straight for a kilometre to a hundredth of a millimetre; keeps covariances from vanishing."""
USUAL_SPACING_M = 10.0
ROUNDS = 8
"""Twice as many, then σ moves by less than 1 % a round."""
NODES_TO_LEARN = 200
"""With fewer of them the law stays."""
BINS, RANGE_TO_LEARN = 8, 0.5
"""Bins of distance that the law is fitted to, and how far their logarithms must range."""
LEAVES_OUT = 10
NODES_TO_SCALE = 20
BLUNDER = 4.0
"""What lies off by more deviations is a blunder of the map, and counts as that."""
_SIGMA_MIN_M = 1e-3
_SPACING_MIN_M = 0.01
"""Nodes in one place keep their order."""


class Curves(NamedTuple):
    """Chains of nodes, one after another; each with neighbours' nodes before and after its own."""

    starts: Integers
    """First node of each chain, and the number of all: shape (curves + 1,)."""
    points: Array
    """East, north, m; shape (n, 2)."""
    own: Flags
    """Nodes of the chain itself: one stretch of two or more in each chain."""


class LeftOut(NamedTuple):
    """Errors of curves at nodes that they were fitted without: across, for every `LEAVES_OUT`th
    own node but the ends of chains."""

    error_m: Array
    std_m: Array
    """Stated: of the curve and of the node together."""
    curvature_per_m: Array
    """Of the curve there."""


@dataclass(frozen=True)
class Fit:
    """Smooth curves along the own nodes of chains, sampled evenly in arc length."""

    starts: Integers
    length_m: Array
    position: Array
    """East, north, m; shape (n, 2)."""
    yaw_rad: Array
    """Continuous along each curve."""
    curvature_per_m: Array
    across_std_m: Array
    yaw_std_rad: Array
    node_arc_m: Array
    """Arc length of each own node; shape (own nodes,)."""
    node_std_m: float
    left_out: LeftOut


class _Learnt(NamedTuple):
    """What a map says of its curves and nodes."""

    law: Array
    """Power of the distance of nodes, and logarithm of q at `USUAL_SPACING_M`."""
    sigma: float
    """Deviation of nodes per axis, m."""


class _Steps(NamedTuple):
    """What `filter_curves` and `smooth_curves` run over and leave; one a node."""

    u: Array
    q: Array
    x: Array
    P: Array
    cross: Array
    evidence: Array


def fit(curves: Curves, node_std_m: float | None = None) -> Fit:
    """Lay smooth curves; see the module.

    Parameters
    ----------
    curves : Curves
    node_std_m : float, optional
        Deviation σ of the nodes per axis, where it is known: it is then neither learnt nor scaled.
    """
    found = _Learnt(np.array([FIRST_POWER, np.log(FIRST_Q)]), node_std_m or FIRST_NODE_STD_M)
    learns = True, node_std_m is None
    steps, found = _learn(curves, _chords(curves), found, learns)
    steps, found = _learn(curves, _arc_lengths(curves, steps), found, learns)
    left_out, sigma = _left_out(curves, steps.u, found), found.sigma
    if node_std_m is None and len(left_out.error_m) >= NODES_TO_SCALE:
        share = np.minimum(np.abs(left_out.error_m) / left_out.std_m, BLUNDER)
        scale = float(np.sqrt(np.mean(share**2)))
        scale = max(scale, _SIGMA_MIN_M / sigma)  # nodes that a computer has drawn
        left_out = left_out._replace(std_m=left_out.std_m * scale)
        sigma *= scale
        steps = _run(curves, steps.u, steps.q * scale**2, sigma)
    return _sampled(curves, steps, sigma, left_out)


# Parameter ----------------------------------------------------------------------------------------
def _chords(curves: Curves) -> Array:
    """Length of the chain of nodes up to each."""
    step = np.hypot(*np.diff(curves.points, axis=0, prepend=curves.points[:1]).T)
    return _accumulated(curves.starts, step)


def _accumulated(starts: Integers, step: Array) -> Array:
    """Sums within curves; a curve begins at 0, and at every step something is added."""
    step = np.maximum(step, _SPACING_MIN_M)
    total = np.cumsum(step)
    first = starts[:-1]
    return total - np.repeat(total[first], np.diff(starts))


def _arc_lengths(curves: Curves, steps: _Steps) -> Array:
    """Arc length of the smooth curve up to each node."""
    inner = np.ones(len(steps.u), dtype=bool)
    inner[curves.starts[1:] - 1] = False
    at = np.flatnonzero(inner)
    length = np.zeros(len(steps.u))
    length[at + 1] = lengths_m(steps.x[at], steps.x[at + 1], steps.u[at + 1] - steps.u[at])
    return _accumulated(curves.starts, length)


# Learning -----------------------------------------------------------------------------------------
def _run(curves: Curves, u: Array, q: Array, sigma: float) -> _Steps:
    n = len(u)
    x, ahead_x = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    P, ahead_P, cross = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3))
    evidence = np.empty((n, 2))
    filter_curves(curves.starts, u, curves.points, q, sigma**2, x, P, ahead_x, ahead_P)
    smooth_curves(curves.starts, u, q, x, P, ahead_x, ahead_P, cross, evidence)
    return _Steps(u, q, x, P, cross, evidence)


def _learn(
    curves: Curves, u: Array, found: _Learnt, learns: tuple[bool, bool]
) -> tuple[_Steps, _Learnt]:
    """Estimate q of each step, and where wanted its law and σ; see the module."""
    middle, spacing = _spacing(curves, u)
    chosen = curves.own.copy()
    chosen[curves.starts[1:] - 1] = False
    law, sigma = found
    q = expected = _power_law(law, spacing)
    around = np.empty((len(u), 2))
    for _ in range(ROUNDS):
        steps = _run(curves, u, q, sigma)
        spread(curves.starts, middle, steps.evidence, REACH_M, around)
        q = (around[:, 0] * q + DOUBT * expected) / (around[:, 1] + DOUBT)
        q = np.maximum(q, Q_MIN)
        if learns[1]:
            told = 1 - steps.P[curves.own, 0, 0] / sigma**2
            residual = _across(curves, steps)[curves.own]
            sigma = max(float(np.sqrt(np.sum(residual**2) / np.sum(told))), _SIGMA_MIN_M)
        if learns[0]:
            law = _learnt_law(law, spacing[chosen], q[chosen])
            expected = _power_law(law, spacing)
    return _run(curves, u, q, sigma), _Learnt(law, sigma)


def _spacing(curves: Curves, u: Array) -> tuple[Array, Array]:
    """Where each step to the next node lies, and the distance of nodes around, by length."""
    step = np.diff(u, append=u[-1:])
    step[curves.starts[1:] - 1] = 0.0
    sums = np.empty((len(u), 2))
    middle = u + step / 2
    spread(curves.starts, middle, np.column_stack([step**2, step]), REACH_M, sums)
    return middle, np.maximum(sums[:, 0] / np.maximum(sums[:, 1], 1e-9), _SPACING_MIN_M)


def _power_law(law: Array, spacing: Array) -> Array:
    q: Array = np.exp(law[1] + law[0] * np.log(spacing / USUAL_SPACING_M))
    return np.maximum(q, Q_MIN)


def _learnt_law(law: Array, spacing: Array, q: Array) -> Array:
    """Fit the law of q: a straight line through the median logarithms of equally full bins.

    The median, since places differ by decades to both sides: a mean of 1/q, which the maximum of
    the likelihood asks for, follows the straightest ones to zero.
    """
    if len(q) < NODES_TO_LEARN:
        return law
    distance, level = np.log(spacing / USUAL_SPACING_M), np.log(q)
    bins = np.array_split(np.argsort(distance), BINS)
    middle = np.array([np.mean(distance[each]) for each in bins])
    median = np.array([np.median(level[each]) for each in bins])
    if np.ptp(middle) < RANGE_TO_LEARN:
        return np.array([law[0], np.mean(median - law[0] * middle)])
    fitted: Array = np.polyfit(middle, median, 1)
    return fitted


def _across(curves: Curves, steps: _Steps) -> Array:
    """How far left of the curve nodes lie, m."""
    away, along = curves.points - steps.x[:, :, 0], steps.x[:, :, 1]
    left: Array = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
    left /= np.hypot(*along.T)
    return left


def _left_out(curves: Curves, u: Array, found: _Learnt) -> LeftOut:
    """Fit anew without every `LEAVES_OUT`th node and see how far off the curves are there.

    The law of q and σ stay; what is learnt from place to place is learnt without these nodes.
    """
    chosen = np.arange(len(u)) % LEAVES_OUT == LEAVES_OUT // 2
    for ends in (curves.starts[:-1], curves.starts[1:] - 1):
        chosen[ends] = False
    out = np.flatnonzero(chosen & curves.own)
    kept = np.ones(len(u), dtype=bool)
    kept[out] = False
    starts = np.concatenate([[0], np.cumsum(kept)])[curves.starts]
    rest = Curves(starts, curves.points[kept], curves.own[kept])
    steps, _ = _learn(rest, u[kept], found, (False, False))
    before = np.cumsum(kept)[out] - 1
    begin, end = steps.x[before], steps.x[before + 1]
    h = steps.u[before + 1] - steps.u[before]
    share = (u[out] - steps.u[before]) / h
    direction, bend = (between(begin, end, h, share, derivative) for derivative in (1, 2))
    away = curves.points[out] - between(begin, end, h, share)
    left = direction[:, 0] * away[:, 1] - direction[:, 1] * away[:, 0]
    joint = (steps.P[before], steps.cross[before], steps.P[before + 1])
    variance = variances(joint, h, share, steps.q[before])[0] + found.sigma**2
    return LeftOut(
        left / np.hypot(*direction.T), np.sqrt(variance), curvature_per_m(direction, bend)
    )


# Sampling -----------------------------------------------------------------------------------------
def _sampled(curves: Curves, steps: _Steps, sigma: float, left_out: LeftOut) -> Fit:
    """Evaluate curves at even arc lengths from the first own node to the last."""
    arc = _arc_lengths(curves, steps)
    own_count = np.add.reduceat(curves.own.astype(np.int64), curves.starts[:-1])
    first = _first_own(curves)
    last = first + own_count - 1
    length_m = arc[last] - arc[first]
    counts = np.maximum(np.ceil(length_m / SAMPLE_M - 1e-9).astype(np.int64), 1) + 1
    starts = np.concatenate([[0], np.cumsum(counts)])
    curve = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(starts[-1]) - starts[curve]
    target = arc[first][curve] + within * (length_m / (counts - 1))[curve]
    node = _nodes_before(curves, arc, curve, target)
    node = np.clip(node, first[curve], last[curve] - 1)
    begin, end = steps.x[node], steps.x[node + 1]
    h = steps.u[node + 1] - steps.u[node]
    share = share_at(steps.x, np.diff(steps.u), np.diff(arc), node, target - arc[node])
    direction = between(begin, end, h, share, 1)
    joint = (steps.P[node], steps.cross[node], steps.P[node + 1])
    across, turning = variances(joint, h, share, steps.q[node])
    return Fit(
        starts=starts,
        length_m=length_m,
        position=between(begin, end, h, share),
        yaw_rad=_unwrapped(np.arctan2(direction[:, 1], direction[:, 0]), starts),
        curvature_per_m=curvature_per_m(direction, between(begin, end, h, share, 2)),
        across_std_m=np.sqrt(across),
        yaw_std_rad=np.sqrt(turning) / np.hypot(*direction.T),
        node_arc_m=arc[curves.own] - np.repeat(arc[first], own_count),
        node_std_m=sigma,
        left_out=left_out,
    )


def _first_own(curves: Curves) -> Integers:
    before = np.concatenate([[False], curves.own[:-1]])
    before[curves.starts[:-1]] = False
    return np.flatnonzero(curves.own & ~before)


def _nodes_before(curves: Curves, arc: Array, curve: Integers, target: Array) -> Integers:
    """Last node of its curve that each arc length has passed: all curves on one axis."""
    ends = arc[curves.starts[1:] - 1]
    shift = np.concatenate([[0.0], np.cumsum(ends + 1.0)])
    axis = arc + np.repeat(shift[:-1], np.diff(curves.starts))
    passed: Integers = np.searchsorted(axis, target + shift[curve], side="right") - 1
    return passed


def _unwrapped(yaw: Array, starts: Integers) -> Array:
    """Yaw without steps of a turn within a curve; each begins between -π and π."""
    turns = -np.round(np.diff(yaw, prepend=yaw[:1]) / (2 * np.pi))
    turns[starts[:-1]] = 0.0
    total = np.cumsum(turns)
    total -= np.repeat(total[starts[:-1]], np.diff(starts))
    out: Array = yaw + 2 * np.pi * total
    return out
