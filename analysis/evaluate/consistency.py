"""Whether errors are as large as the filter claims: NEES, NIS, protection levels.

NEES is eᵀ P⁻¹ e, of d dimensions: χ² with d degrees of freedom, d in the mean, if the covariance is
right. One ride gives one series of it, and its samples are far from independent: errors live for
seconds, states come a hundred times a second. So the mean of n samples has the variance 2d·τ/n
instead of 2d/n, where τ = 1 + 2 Σ ρ(k) is the integrated autocorrelation time of the NEES series in
samples, and n/τ is the effective number of independent samples (Bartlett 1946; Sokal, section 3).
The sum of n/τ independent χ² is χ² with d·n/τ degrees of freedom: the bounds of the mean are the
two quantiles of that, divided by n/τ.

τ is summed up to the first lag M ≥ `WINDOW`·τ(M) (Sokal's automatic window), with ρ from the sample
mean and variance, so that a covariance wrong by a factor does not change it. Subtracting the
sample mean takes about τ/n from every ρ(k); Wolff's factor 1 + (2M + 1)/n gives that back. τ is an
estimate: its relative variance is 4 (M + ½ − τ/2)/n, about 8τ/n with this window, that of a
variance from ν = (n/τ)/4 degrees of freedom. So the quantiles are taken where Student's t with ν
degrees of freedom has the tail asked for, and short rides get the wide bounds that they deserve.
Where there are several rides of a kind, τ is that of all of them together, about the mean of all.

No bound is wider than that of one sample worth. However samples hang together, their mean is
smaller in convex order than a single χ², so it exceeds the expected shortfall of that χ² no more
often than the shortfall's own tail; the same from below. An error that lasts the whole ride is
judged by that. A series that has hardly changed (its variance is well below the 2/d of its squared
mean that χ² of any scale has) is one sample, whatever its ripple says of τ. For τ the samples
beyond the limit of one in a thousand count as lying on it: a filter that is right has none to speak
of, in one that is wrong they would make its interval as wide as its error (NEES 16.7 within
[0, 74]). Where the interval still reaches twice what is right, a mean inside says nothing: the ride
is too short to tell.

Equations: docs/theory.md, sections 13 and 14.

References
----------
Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation,
Wiley 2001, section 5.4.
A. D. Sokal, Monte Carlo methods in statistical mechanics, Cargèse 1996, section 3.
U. Wolff, Monte Carlo errors with less errors, Comput. Phys. Commun. 156 (2004), eqs. 42 and 49.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv, ndtr, stdtrit

from tramstream.analysis.evaluate.errors import Errors
from tramstream.estimation.series import Array, Flags, Innovations, Slot

CONFIDENCE = 0.95
WINDOW = 2.5
"""Of the autocorrelation, in times of τ: Sokal's constant 5, since his τ is half of this one. What
an exponential has left there is e⁻⁵; more lags would only add noise."""
CAP = 0.999
"""Quantile of χ² at which samples are capped before τ is estimated of them; see above."""
EXPLORED = 0.5
"""Of the variance that χ² has for its mean: with less, a series has not been through its values."""
TELLING = 2.0
"""Times what is right: bounds that reach so far tell nothing of a mean inside."""
TINY_M = 1e-9
"""A protection level of nothing is taken for this, to divide by."""

NEES_SLOTS: dict[str, tuple[Slot, ...]] = {
    "position": (Slot.EAST, Slot.NORTH),
    "speed": (Slot.SPEED,),
    "roll": (Slot.ROLL,),
    "pitch": (Slot.PITCH,),
    "yaw": (Slot.YAW,),
    "joint": (Slot.EAST, Slot.NORTH, Slot.SPEED, Slot.YAW),
}
"""What is judged together."""


class Interval(NamedTuple):
    """Two-sided, of `CONFIDENCE`."""

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        return isinstance(value, float) and self.low <= value <= self.high


class Verdict(StrEnum):
    """What a mean says of the deviations that a filter claims."""

    CONSISTENT = "consistent"
    CONFIDENT = "too confident"
    CAUTIOUS = "too cautious"
    SHORT = "too short to tell"


def verdict_of(mean: float, ideal: float, bounds: Interval) -> Verdict:
    """Judge a mean whose value is `ideal` and which lies within `bounds` if the filter is right."""
    if mean > bounds.high:
        return Verdict.CONFIDENT
    if mean < bounds.low:
        return Verdict.CAUTIOUS
    return Verdict.SHORT if bounds.high >= TELLING * ideal else Verdict.CONSISTENT


def _consistent(verdict: Verdict) -> bool | None:
    return None if verdict is Verdict.SHORT else verdict is Verdict.CONSISTENT


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared over a ride."""

    dimensions: int
    count: int
    undefined: int
    """States whose covariance is absent, singular or not positive."""
    mean: float
    bounds: Interval
    """Of the mean, if the filter is consistent."""
    effective: float
    """Number of independent samples that the series is worth: what a verdict is worth."""
    inside_share: float
    """Of single samples within the two-sided interval of χ²."""

    @property
    def verdict(self) -> Verdict:
        return verdict_of(self.mean, float(self.dimensions), self.bounds)

    @property
    def consistent(self) -> bool | None:
        """None where the ride is too short to tell."""
        return _consistent(self.verdict)


@dataclass(frozen=True)
class Nis:
    """Normalised innovations squared of one scalar measurement; 1 in the mean if consistent."""

    count: int
    accepted_share: float
    mean: float
    """Of the accepted ones."""
    mean_all: float
    bounds: Interval
    """Of `mean`, if S is right."""
    effective: float
    """Number of independent innovations that the accepted ones are worth."""
    lag1: float
    """Correlation of an accepted y/√S with the next one; 0 if white. NaN for less than three."""

    @property
    def verdict(self) -> Verdict | None:
        """None where nothing was accepted."""
        return verdict_of(self.mean, 1.0, self.bounds) if self.accepted_share else None

    @property
    def consistent(self) -> bool | None:
        """None where nothing was accepted, or too little to tell."""
        return None if self.verdict is None else _consistent(self.verdict)


@dataclass(frozen=True)
class Protection:
    """Protection level against the true error, along and across."""

    count: int
    exceeded_share: tuple[float, float]
    mean_m: tuple[float, float]
    exceeded_any_share: float
    """Along or across."""
    stretches: int
    """Independent stretches of time beyond: those closer than the autocorrelation time are one, and
    there are no more than independent samples of the NEES of the place."""

    def chance(self, risk: float) -> float:
        """How often a filter whose levels are exceeded for `risk` of the time would look so bad.

        Stretches beyond come as a Poisson process, each as long as they are here in the mean. One
        stretch alone has the chance that Markov's inequality gives for any correlation, risk over
        share.
        """
        if not self.stretches or risk >= self.exceeded_any_share:
            return 1.0
        expected = risk * self.stretches / self.exceeded_any_share
        return float(gammainc(self.stretches, expected))


def chi_square_interval(degrees: float, tail: float = (1.0 - CONFIDENCE) / 2.0) -> Interval:
    """Interval of χ², its degrees of freedom whole or not, with `tail` of it on each side."""
    low, high = gammaincinv(degrees / 2.0, tail), gammainccinv(degrees / 2.0, tail)
    return Interval(2.0 * float(low), 2.0 * float(high))


def autocorrelation_time(*series: Array) -> float:
    """Integrated autocorrelation time of one process, in samples; see the top of the module.

    At least 1 (alternating series are treated as white) and at most the length of the shortest
    series, which is also the answer for those that never change.
    """
    n = min(len(each) for each in series)
    size = 1 << (2 * max(len(each) for each in series) - 1).bit_length()
    total = sum(len(each) for each in series)
    mean = sum(float(each.sum()) for each in series) / total
    spectrum = np.sum([np.abs(np.fft.rfft(each - mean, size)) ** 2 for each in series], axis=0)
    covariance = np.fft.irfft(spectrum, size)[:n]
    if covariance[0] <= 0.0 or n < 3:
        return float(n)
    tau = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    far = np.arange(n) >= WINDOW * tau
    window = int(far.argmax()) if far.any() else n - 1
    corrected = float(tau[window]) * (1.0 + (2 * window + 1) / total)
    return min(max(corrected, 1.0), float(n))


def quadratic_form(P: Array, error: Array) -> Array:
    """eᵀ P⁻¹ e of many rows by LDLᵀ; NaN where P is not positive definite.

    Parameters
    ----------
    P : ndarray, shape (n, d, d)
    error : ndarray, shape (n, d)

    Returns
    -------
    nees : ndarray, shape (n,)
    """
    P, error = P.copy(), error.copy()
    total = np.zeros(len(error))
    for k in range(error.shape[1]):
        pivot = np.where(P[:, k, k] > 0.0, P[:, k, k], np.nan)
        gain = P[:, k + 1 :, k] / pivot[:, None]
        total += error[:, k] ** 2 / pivot
        error[:, k + 1 :] -= gain * error[:, k, None]
        P[:, k + 1 :, k + 1 :] -= gain[:, :, None] * P[:, None, k, k + 1 :]
    return total


def nees_series(errors: Errors, slots: Sequence[Slot]) -> Array:
    """NEES of the quantities in `slots` at every instant; NaN where an error is not known."""
    columns = {
        Slot.EAST: errors.p_l[:, 0],
        Slot.NORTH: errors.p_l[:, 1],
        Slot.UP: errors.up_m,
        Slot.SPEED: errors.speed_mps,
        Slot.ROLL: errors.attitude_rad[:, 0],
        Slot.PITCH: errors.attitude_rad[:, 1],
        Slot.YAW: errors.yaw_rad,
    }
    error = np.stack([columns[slot] for slot in slots], axis=1)
    return quadratic_form(errors.covariance[:, slots][:, :, slots], error)


def nees(errors: Errors, slots: Sequence[Slot]) -> Nees | None:
    """Judge the quantities in `slots` together; None where that is never possible."""
    return nees_of(nees_series(errors, slots), len(slots))


def nees_of(series: Array, dimensions: int) -> Nees | None:
    """Judge a series of NEES, NaN where it is not known; None where that is everywhere."""
    known = series[np.isfinite(series)]
    if not len(known):
        return None
    effective = effective_samples(known, dimensions)
    single = chi_square_interval(dimensions)
    inside = (known >= single.low) & (known <= single.high)
    return Nees(
        dimensions=dimensions,
        count=len(known),
        undefined=len(series) - len(known),
        mean=float(known.mean()),
        bounds=mean_bounds(dimensions, effective),
        effective=effective,
        inside_share=float(inside.mean()),
    )


def effective_samples(squares: Array, dimensions: int) -> float:
    """Number of independent samples that a series of χ² of so many dimensions is worth."""
    cap = 2.0 * float(gammaincinv(dimensions / 2.0, CAP))
    effective = len(squares) / autocorrelation_time(np.minimum(squares, cap))
    mean = float(squares.mean())
    seen = float(squares.var()) * dimensions / (2.0 * mean * mean) if mean > 0.0 else 0.0
    return 1.0 + (effective - 1.0) * min(seen / EXPLORED, 1.0)


def mean_bounds(
    dimensions: int, effective: float, series: int = 1, confidence: float = CONFIDENCE
) -> Interval:
    """Interval of the mean of χ² samples worth `effective` independent ones.

    That is an estimate itself, made from so many series of such a length.
    """
    tail = (1.0 - confidence) / 2.0
    student = stdtrit(max(series * effective / 4.0, 1.0), tail)
    low, high = chi_square_interval(dimensions * effective, float(ndtr(student)))
    least, most = shortfalls(dimensions, tail)
    return Interval(max(low / effective, least), min(high / effective, most))


def shortfalls(dimensions: float, tail: float) -> Interval:
    """Means of χ² below its quantile of `tail`, and above that of 1 − `tail`.

    The mean of samples that hang together in any way lies beyond with a probability of at most
    `tail` on each side: E[X; X > q] = d P(χ²(d+2) > q).
    """
    low, high = chi_square_interval(dimensions, tail)
    above = float(gammaincc(dimensions / 2.0 + 1.0, high / 2.0))
    below = float(gammainc(dimensions / 2.0 + 1.0, low / 2.0))
    return Interval(dimensions * below / tail, dimensions * above / tail)


def nis(innovations: Innovations) -> dict[str, Nis]:
    """Judge each measurement by name.

    Each innovation is one scalar of a sequential update, so y²/S has one degree of freedom. The
    bounds know of their autocorrelation as those of the NEES do. What a gate refused is in
    `mean_all` alone.
    """
    found: dict[str, Nis] = {}
    usable = (innovations.variance > 0.0) & np.isfinite(innovations.value)
    for number, name in enumerate(innovations.names):
        of_name = usable & (innovations.which == number)
        if of_name.any():
            scale = np.sqrt(innovations.variance[of_name])
            found[name] = _nis(innovations.value[of_name] / scale, innovations.accepted[of_name])
    return found


def _nis(normal: Array, accepted: Flags) -> Nis:
    """Of normalised innovations y/√S."""
    kept = normal[accepted]
    squares = kept**2
    effective = effective_samples(squares, 1) if len(kept) else 0.0
    lag1 = np.nan
    if len(kept) >= 3 and squares.any():
        lag1 = float((kept[1:] * kept[:-1]).mean() / squares.mean())
    return Nis(
        count=len(normal),
        accepted_share=float(accepted.mean()),
        mean=float(squares.mean()) if len(kept) else np.nan,
        mean_all=float(np.mean(normal**2)),
        bounds=mean_bounds(1, effective) if len(kept) else Interval(np.nan, np.nan),
        effective=effective,
        lag1=lag1,
    )


def protection(errors: Errors) -> Protection | None:
    """Compare protection levels with the true errors; None if there are no levels."""
    error = np.abs(np.stack([errors.along_m, errors.across_m], axis=1))
    known: Flags = np.asarray(np.isfinite(error + errors.protection_m).all(axis=1))
    if not known.any():
        return None
    level = errors.protection_m[known]
    exceeded = error[known] > level
    any_exceeded: Flags = np.asarray(exceeded.any(axis=1))
    used = np.minimum((error[known] / np.maximum(level, TINY_M)).max(axis=1), 1.0)
    apart = stretches(any_exceeded, autocorrelation_time(used))
    place = nees(errors.take(known), NEES_SLOTS["position"])
    return Protection(
        count=int(known.sum()),
        exceeded_share=_pair(exceeded.mean(axis=0)),
        mean_m=_pair(level.mean(axis=0)),
        exceeded_any_share=float(any_exceeded.mean()),
        stretches=min(apart, max(int(place.effective), 1)) if place is not None else min(apart, 1),
    )


def stretches(beyond: Flags, apart: float) -> int:
    """Count stretches of time beyond that lie more than `apart` samples from each other."""
    at = np.flatnonzero(beyond)
    return int(np.count_nonzero(np.diff(at) > apart)) + 1 if len(at) else 0


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])
