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
from typing import NamedTuple

import numpy as np
from scipy.special import gammainccinv, gammaincinv, ndtr, stdtrit

from tramstream.analysis.evaluate.errors import Errors
from tramstream.estimation.series import Array, Flags, Innovations, Slot

CONFIDENCE = 0.95
WINDOW = 2.5
"""Of the autocorrelation, in times of τ: Sokal's constant 5, since his τ is half of this one. What
an exponential has left there is e⁻⁵; more lags would only add noise."""

NEES_SLOTS: dict[str, tuple[Slot, ...]] = {
    "position": (Slot.EAST, Slot.NORTH),
    "speed": (Slot.SPEED,),
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
    def consistent(self) -> bool:
        return self.mean in self.bounds


@dataclass(frozen=True)
class Nis:
    """Normalised innovations squared of one scalar measurement; 1 in the mean if consistent."""

    count: int
    accepted_share: float
    mean: float
    """Of the accepted ones."""
    mean_all: float
    bounds: Interval
    """Of `mean`, if innovations are white."""
    lag1: float
    """Correlation of an accepted y/√S with the next one; 0 if white. NaN for less than three."""

    @property
    def consistent(self) -> bool:
        return self.mean in self.bounds


@dataclass(frozen=True)
class Protection:
    """Protection level against the true error, along and across."""

    count: int
    exceeded_share: tuple[float, float]
    mean_m: tuple[float, float]
    exceeded_any_share: float
    """Along or across."""


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
    series = nees_series(errors, slots)
    known = series[np.isfinite(series)]
    if not len(known):
        return None
    tau = autocorrelation_time(known)
    single = chi_square_interval(len(slots))
    inside = (known >= single.low) & (known <= single.high)
    return Nees(
        dimensions=len(slots),
        count=len(known),
        undefined=len(series) - len(known),
        mean=float(known.mean()),
        bounds=mean_bounds(len(slots), len(known) / tau),
        effective=len(known) / tau,
        inside_share=float(inside.mean()),
    )


def mean_bounds(dimensions: int, effective: float, series: int = 1) -> Interval:
    """Interval of the mean of χ² samples worth `effective` independent ones.

    That is an estimate itself, made from so many series of such a length.
    """
    student = stdtrit(max(series * effective / 4.0, 1.0), (1.0 - CONFIDENCE) / 2.0)
    low, high = chi_square_interval(dimensions * effective, float(ndtr(student)))
    return Interval(low / effective, high / effective)


def nis(innovations: Innovations) -> dict[str, Nis]:
    """Judge each measurement by name.

    Each innovation is one scalar of a sequential update, so y²/S has one degree of freedom, and the
    bounds are those of the mean of as many independent ones. What a gate refused is in `mean_all`
    alone.
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
    low, high = chi_square_interval(len(kept)) if len(kept) else (np.nan, np.nan)
    lag1 = np.nan
    if len(kept) >= 3 and squares.any():
        lag1 = float((kept[1:] * kept[:-1]).mean() / squares.mean())
    count = max(len(kept), 1)
    return Nis(
        count=len(normal),
        accepted_share=float(accepted.mean()),
        mean=float(squares.mean()) if len(kept) else np.nan,
        mean_all=float(np.mean(normal**2)),
        bounds=Interval(low / count, high / count),
        lag1=lag1,
    )


def protection(errors: Errors) -> Protection | None:
    """Compare protection levels with the true errors; None if there are no levels."""
    error = np.abs(np.stack([errors.along_m, errors.across_m], axis=1))
    known = np.isfinite(error + errors.protection_m).all(axis=1)
    if not known.any():
        return None
    level = errors.protection_m[known]
    exceeded = error[known] > level
    return Protection(
        count=int(known.sum()),
        exceeded_share=_pair(exceeded.mean(axis=0)),
        mean_m=_pair(level.mean(axis=0)),
        exceeded_any_share=float(exceeded.any(axis=1).mean()),
    )


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])
