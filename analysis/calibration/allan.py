"""The Allan deviation of an axis, all overlapping terms used, and the tangents that are read off.

σ²(τ) = Σ (Θ_{k+2m} − 2 Θ_{k+m} + Θ_k)² / (2 τ² (M − 2m)) over every k, τ = m t₀, Θ the integrated
reading. The second difference is carried on from one k to the next in whole counts, so that the
integral is never formed: nothing is rounded however long the record is, and an axis is all that is
held in memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]
Counts = NDArray[Any]
"""Readings of one axis in whole counts: int16 or int32."""

FEWEST = 9
"""Averages that fit into a stretch at the largest τ: with fewer the deviation is mostly chance."""


class Run(NamedTuple):
    """Samples that follow each other without a gap."""

    start: int
    end: int
    """The first that does not belong to it."""


class Curve(NamedTuple):
    """An Allan deviation, one row a τ."""

    tau_s: Array
    deviation: Array
    low: Array
    high: Array
    """Where the true deviation is in 95 % of all records."""
    terms: NDArray[np.int64]


@compiled
def second_differences(counts: Counts, start: int, end: int, m: int) -> tuple[float, int]:
    """Sum of the squares of Θ_{k+2m} − 2 Θ_{k+m} + Θ_k over a run, and how many there are.

    Four parts of the run are gone through side by side, for each step of one waits for its last.
    """
    terms = end - start + 1 - 2 * m
    if terms < 1:
        return 0.0, 0
    part = (terms - 1) // 4  # the last term is always left for the end: nothing follows it
    first = np.empty(4, np.int64)
    for lane in range(4):
        begin = start + lane * part
        difference = np.int64(0)
        for i in range(begin, begin + m):
            difference += np.int64(counts[i + m]) - np.int64(counts[i])
        first[lane] = difference
    d0, d1, d2, d3 = first[0], first[1], first[2], first[3]
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    p1, p2, p3 = part, 2 * part, 3 * part
    for k in range(start, start + part):
        s0 += float(d0) * float(d0)
        s1 += float(d1) * float(d1)
        s2 += float(d2) * float(d2)
        s3 += float(d3) * float(d3)
        far = k + 2 * m
        mid = k + m
        d0 += np.int64(counts[far]) - 2 * np.int64(counts[mid]) + np.int64(counts[k])
        d1 += np.int64(counts[far + p1]) - 2 * np.int64(counts[mid + p1]) + np.int64(counts[k + p1])
        d2 += np.int64(counts[far + p2]) - 2 * np.int64(counts[mid + p2]) + np.int64(counts[k + p2])
        d3 += np.int64(counts[far + p3]) - 2 * np.int64(counts[mid + p3]) + np.int64(counts[k + p3])
    total = s0 + s1 + s2 + s3
    for k in range(start + 4 * part, start + terms):
        total += float(d3) * float(d3)
        if k + 1 < start + terms:
            d3 += np.int64(counts[k + 2 * m]) - 2 * np.int64(counts[k + m]) + np.int64(counts[k])
    return total, terms


def octaves(runs: Sequence[Run]) -> list[int]:
    """Numbers of samples averaged, each twice the one before, as far as the longest run tells."""
    longest = max((run.end - run.start for run in runs), default=0)
    return [1 << power for power in range(62) if (1 << power) * FEWEST <= longest]


def overlapping(
    counts: Counts, runs: Sequence[Run], rate_hz: float, averaged: Sequence[int]
) -> Curve:
    """The overlapping Allan deviation of an axis, in counts; several runs are taken together.

    Parameters
    ----------
    counts : ndarray, shape (n,)
        Whole counts.
    runs : sequence of Run
        No difference reaches from one into another.
    rate_hz : float
    averaged : sequence of int
        m of each τ; see `octaves`.
    """
    rows = []
    for m in averaged:
        sums = [second_differences(counts, run.start, run.end, m) for run in runs]
        total, terms = sum(each[0] for each in sums), sum(each[1] for each in sums)
        if terms:
            freedom = sum(_freedom(run, m) for run in runs)
            rows.append((m / rate_hz, math.sqrt(total / (2.0 * m**2 * terms)), freedom, terms))
    tau_s, deviation, freedom_of, terms_of = np.array(rows, dtype=float).reshape(-1, 4).T
    low = deviation * np.sqrt(freedom_of / stats.chi2.ppf(0.975, freedom_of))
    high = deviation * np.sqrt(freedom_of / stats.chi2.ppf(0.025, freedom_of))
    return Curve(tau_s, deviation, low, high, terms_of.astype(np.int64))


def _freedom(run: Run, m: int) -> float:
    """Degrees of freedom of the overlapping estimate for white noise of the reading.

    References
    ----------
    W. J. Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, section 5.4.1.
    """
    count = run.end - run.start + 1
    if count < 2 * m + 1:
        return 0.0
    found = (3 * (count - 1) / (2 * m) - 2 * (count - 2) / count) * 4 * m**2 / (4 * m**2 + 5)
    return max(found, 1.0)


class Tangents(NamedTuple):
    """What `kaspar2023` reads off a curve (docs/theory.md, section 3.1); NaN where nothing fits."""

    white: float
    """N: the line of slope −1/2 where the curve comes nearest to it, at τ = 1 s."""
    instability: float
    """B: the flattest part over 0.664."""
    time_s: float
    """T_b: τ there over 1.89."""
    walk: float
    """K: the line of slope +1/2 where the curve comes nearest to it, at τ = 3 s."""


def tangents(curve: Curve) -> Tangents:
    """Read N, B, T_b and K off a curve as the work does, each by itself."""
    if len(curve.tau_s) < 3 or not np.all(curve.deviation > 0):
        return Tangents(*[math.nan] * 4)
    log_tau, log_deviation = np.log(curve.tau_s), np.log(curve.deviation)
    slope = np.diff(log_deviation) / np.diff(log_tau)
    middle = (log_tau[1:] + log_tau[:-1]) / 2
    height = (log_deviation[1:] + log_deviation[:-1]) / 2

    def near(wanted: float) -> int | None:
        found = int(np.argmin(np.abs(slope - wanted)))
        return found if abs(slope[found] - wanted) < 0.25 else None

    falling, flat, rising = near(-0.5), near(0.0), near(0.5)
    white = walk = instability = time_s = math.nan
    if falling is not None:
        white = math.exp(height[falling] + 0.5 * middle[falling])
    if flat is not None:
        instability = math.exp(height[flat]) / 0.664
        time_s = math.exp(middle[flat]) / 1.89
    if rising is not None:
        walk = math.exp(height[rising] + 0.5 * (math.log(3) - middle[rising]))
    return Tangents(white, instability, time_s, walk)
