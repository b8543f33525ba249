"""Which rides, and which passes of single cells, a grade map does without.

See `merge`: what is said here is a function of the set of rides, in whatever order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tramstream.analysis.grade_map.cells import Integers
from tramstream.tracks.network import Array

Flags = NDArray[np.bool_]

RIDE_BIAS_STD_RAD = 3e-4
"""3 mm/s² of an accelerometer's bias that a ride has beyond what its smoother states."""
VEHICLE_BIAS_STD_RAD = 5e-4
"""0.03 deg of mounting that rides of a vehicle share, beyond what their smoothers state."""
COMMON_QUANTILE = 0.1
OWN_SHARE = 0.3
"""Least share of a stated deviation that is taken to be a cell's own."""
LIMIT_STDS = 4.0
SCATTER_LIMIT = 4.0
"""So many times the scatter that is usual, or stated if that is more."""
PASS_LIMIT_STDS = 6.0
PASS_LEAST_RAD = 3e-3
"""No single pass is left out for less than 0.3 %."""
OTHERS = 2
"""So many others have to have been on a cell for a ride to be judged there."""
JUDGED_CELLS, JUDGED_SHARE = 10, 0.3
"""Least number of such cells, and least share of a ride's, for it to be judged at all."""
MAD_TO_STD = 1.4826
"""Of a normal distribution's median absolute deviation."""
_CHUNK = 4096
"""Groups that are taken together."""


class Rows(NamedTuple):
    """Passes of all rides, sorted by ride, cell and sign."""

    ride: Integers
    cell: Integers
    """Any numbers; equal for the same cell."""
    sign: Array
    grade_rad: Array
    std_rad: Array


class Solution(NamedTuple):
    """Of all cells; NaN where nobody in use has been."""

    grade: Array
    variance: Array
    weight: Array
    """W."""
    bias: Array


class Verdicts(NamedTuple):
    """Of each ride."""

    reasons: list[str]
    """Why it is out; empty where it is not."""
    bias: Array
    scatter: Array
    """RMS of its residuals over σ, without the bias; NaN where nobody can tell."""


def common_std(rows: Rows, rides: int) -> Array:
    """How much of the deviations that a ride states may be the same all along it."""
    bounds = np.searchsorted(rows.ride, np.arange(rides + 1))
    stated = [rows.std_rad[bounds[k] : bounds[k + 1]] for k in range(rides)]
    return np.array([np.quantile(each, COMMON_QUANTILE) if len(each) else 0.0 for each in stated])


def own_std(rows: Rows, common: Array) -> Array:
    """What is left of them for each cell."""
    left = rows.std_rad**2 - common[rows.ride] ** 2
    own: Array = np.sqrt(np.maximum(left, (OWN_SHARE * rows.std_rad) ** 2))
    return own


def by_medians(rows: Rows, count: int, limit: Array) -> tuple[Flags, list[str]]:
    """Hold each ride against the medians of its cells.

    Parameters
    ----------
    limit : ndarray, shape (rides,)
        Largest bias of each ride.

    Returns
    -------
    good : ndarray
        Of each row, whether it is among the others of its cell, its ride's bias taken out.
    reasons : list of str
        Of each ride.
    """
    rides = len(limit)
    crowd = (np.bincount(rows.cell, minlength=count) > OTHERS)[rows.cell]
    off = (rows.grade_rad - medians(rows.cell, rows.grade_rad, count)[rows.cell]) * rows.sign
    if not crowd.all():
        off[~crowd] = np.nan
    bias = medians(rows.ride, off, rides)
    left = np.abs(off - bias[rows.ride])
    scatter = MAD_TO_STD * medians(rows.ride, left / rows.std_rad, rides)
    # A ride that scatters as a whole is judged as a whole.
    usual = np.fmax(scatter, 1.0)[rows.ride] * rows.std_rad
    with np.errstate(invalid="ignore"):
        good = ~(left > np.maximum(PASS_LIMIT_STDS * usual, PASS_LEAST_RAD))
    return good, _reasons(rows, good, good & crowd, Verdicts([], bias, scatter), limit)


def by_the_others(
    rows: Rows, good: Flags, used: Flags, solution: Solution, limit: Array
) -> Verdicts:
    """Hold each ride against the map of all others that are in use."""
    rides = len(solution.bias)
    grade = np.nan_to_num(solution.grade)
    own = used / rows.std_rad**2
    # A ride's own part in the map is taken out, its bias as the map had it.
    whole = solution.weight[rows.cell]
    rest = whole - own
    others = np.bincount(rows.cell, used, len(grade))[rows.cell] - used
    at = good & (others >= OTHERS) & (rest > 0)
    safe = np.where(rest > 0, rest, 1.0)
    freed = rows.grade_rad - rows.sign * solution.bias[rows.ride]
    without = (grade[rows.cell] * whole - own * freed) / safe
    left = (rows.grade_rad - without) * rows.sign
    weight = at / (rows.std_rad**2 + 1.0 / safe)
    number = np.bincount(rows.ride, at, rides)
    with np.errstate(invalid="ignore", divide="ignore"):
        bias = np.bincount(rows.ride, weight * left, rides) / np.bincount(rows.ride, weight, rides)
        square = weight * (left - np.nan_to_num(bias)[rows.ride]) ** 2
        scatter = np.sqrt(np.bincount(rows.ride, square, rides) / (number - 1))
    found = Verdicts([], bias, np.where(_enough(rows, good, at, rides), scatter, np.nan))
    known = np.where(np.isfinite(bias), bias, solution.bias)
    return Verdicts(_reasons(rows, good, at, found, limit), known, found.scatter)


def _reasons(rows: Rows, good: Flags, at: Flags, found: Verdicts, limit: Array) -> list[str]:
    enough = _enough(rows, good, at, len(found.bias))
    scatter = found.scatter[enough & np.isfinite(found.scatter)]
    usual = max(float(np.median(scatter)), 1.0) if len(scatter) else 1.0
    return [
        _reason(float(bias), float(own) / usual, float(most)) if judged else ""
        for bias, own, most, judged in zip(found.bias, found.scatter, limit, enough, strict=True)
    ]


def _enough(rows: Rows, good: Flags, at: Flags, rides: int) -> Flags:
    """Whether enough of a ride lies where others have been, for it to be judged."""
    number = np.bincount(rows.ride, at, rides)
    whole = np.bincount(rows.ride, good, rides)
    enough: Flags = (number >= JUDGED_CELLS) & (number >= JUDGED_SHARE * whole)
    return enough


def _reason(bias: float, scatter: float, limit: float) -> str:
    """Why a ride is out; empty where it is not."""
    if abs(bias) > limit:
        return (
            f"its slopes are {100 * bias:+.2f} % off those of the others all along "
            "(mounting of the IMU in pitch, or bias of its accelerometer)"
        )
    if scatter > SCATTER_LIMIT:
        return f"its slopes scatter {scatter:.1f} times as much as is usual around others'"
    return ""


def sums(group: Integers, value: Array, count: int) -> Array:
    """Sum of the values of each group."""
    found: Array = np.bincount(group, value, count).astype(np.float64, copy=False)
    return found


# Medians ------------------------------------------------------------------------------------------
def medians(group: Integers, value: Array, count: int) -> Array:
    """Median of the values of each group, without those that are NaN; NaN of one without any."""
    order, starts = grouped(group, count)
    found = np.full(count, np.nan)
    for first in range(0, count, _CHUNK):
        last = min(first + _CHUNK, count)
        sizes = np.diff(starts[first : last + 1])
        row = np.repeat(np.arange(last - first), sizes)
        column = np.arange(starts[first], starts[last]) - starts[first:last][row]
        table = np.full((last - first, max(int(sizes.max(initial=0)), 1)), np.nan)
        table[row, column] = value[order][starts[first] : starts[last]]
        table.sort(axis=1)  # NaN come last
        every = np.arange(last - first)
        sizes = np.sum(~np.isnan(table), axis=1)
        low, high = (
            table[every, np.maximum(sizes - 1, 0) // 2],
            table[every, sizes // 2 % table.shape[1]],
        )
        found[first:last] = np.where(sizes > 0, (low + high) / 2, np.nan)
    return found


def grouped(group: Integers, count: int) -> tuple[Any, Integers]:
    """Order of rows by group, each group's in the order that they have; first row of each group,
    and the number of all."""
    number = np.arange(len(group))
    if np.all(group[1:] >= group[:-1]):
        return slice(None), np.searchsorted(group, np.arange(count + 1))
    table = sparse.csr_matrix((number, (group, number)), shape=(count, max(len(group), 1)))
    return table.data, table.indptr.astype(np.int64)
