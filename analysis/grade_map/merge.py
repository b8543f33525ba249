"""Many rides become one slope for each cell, in information form, whatever their order.

A ride r says of a cell c, on which its x axis points along the track as drawn (d = 1) or against it
(d = −1),

    y = g_c + d b_r + ε,        ε ~ N(0, σ²),   b_r ~ N(0, σ_b²) + (one of its vehicle) N(0, σ_v²)

σ is the smoother's; b is what is wrong all along the ride (mounting, accelerometer) and turns its
sign with the vehicle, so that rides both ways tell it apart from the slope. One least squares for
all of it: with w = 1/σ², W_c = Σ w, A_rc = Σ w d and z_c = Σ w y / W_c,

    (B⁻¹ + diag(Σ_c w) − A W⁻¹ Aᵀ) b = Σ_c w d y − A z,        B: covariance of the b
    g = z − Aᵀ b / W,        var g_c = 1/W_c + a_cᵀ S⁻¹ a_c / W_c²

with a_c the column of A and S the left side.

Rows are sorted by ride and cell before anything is summed: the same rides are the same numbers.

**Rejection** is a function of the set of rides, too. A ride is held against the medians of its
cells first, of which half of the rides may be wrong; then, until nothing changes, against the map
of all others that are in use. It is out if its bias or its scatter is beyond what either can be.
Where fewer than two others have been, nobody can tell who is wrong, and nobody is out. A single
pass of a cell that is far from all others there (a detour matched to the wrong track) is left out
alone. At last each ride's σ is scaled by its own scatter where that is larger (Birge ratio).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from tramstream.analysis.grade_map.cells import Integers
from tramstream.tracks.network import Array

Flags = NDArray[np.bool_]

RIDE_BIAS_STD_RAD = 5e-4
"""5 mm/s² of an accelerometer's bias that a filter has not found out in a ride."""
VEHICLE_BIAS_STD_RAD = 1e-3
"""0.06 deg of an IMU's mounting, which `align` leaves."""
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
ROUNDS = 8
MAD_TO_STD = 1.4826
"""Of a normal distribution's median absolute deviation."""
_CHUNK = 4096
"""Cells, or groups, that are taken together."""


class Rows(NamedTuple):
    """Passes of all rides, sorted by ride, cell and sign."""

    ride: Integers
    cell: Integers
    """Any numbers; equal for the same cell."""
    sign: Array
    grade_rad: Array
    std_rad: Array


@dataclass(frozen=True)
class Merged:
    """Cells ascending, and rides in their order."""

    cell: Integers
    grade_rad: Array
    std_rad: Array
    chi2: Array
    """Σ (y − d b − g)²/σ² of the passes in use, σ scaled; of as many degrees of freedom as there
    are passes, less one."""
    passes: Integers
    """In use, of each cell; 0 where only rides that are out have been."""
    bias_rad: Array
    """Of each ride, uphill positive along x of the vehicle; against the map without it."""
    scatter: Array
    """Of each ride: RMS of its residuals over σ, without the bias; NaN where nobody can tell."""
    out: tuple[str, ...]
    """Of each ride why it is rejected; empty where it is in use."""
    row_used: Flags
    scaled_std_rad: Array
    """Of each row: σ times the scale of its ride."""


class _Solution(NamedTuple):
    """Of all cells; NaN where nobody in use has been."""

    grade: Array
    variance: Array
    weight: Array
    """W."""
    bias: Array


def merge(rows: Rows, vehicles: Sequence[str]) -> Merged:
    """Merge passes; see the module.

    Parameters
    ----------
    rows : Rows
        Sorted.
    vehicles : sequence of str
        Of each ride the vehicle's name.
    """
    numbers = np.flatnonzero(np.bincount(rows.cell))
    rows = rows._replace(cell=np.searchsorted(numbers, rows.cell))
    count, rides = len(numbers), len(vehicles)
    prior = np.linalg.inv(_bias_covariance(vehicles))
    good = _good_passes(rows, count)
    reasons = _judged_by_medians(rows, good, count, rides)
    seen = {tuple(reasons)}
    for _ in range(ROUNDS):
        used = good & np.array([not each for each in reasons])[rows.ride]
        solution = _solve(rows, used, count, prior)
        reasons, bias, scatter = _judged(rows, good, used, solution, rides)
        if tuple(reasons) in seen:
            break
        seen.add(tuple(reasons))
    used = good & np.array([not each for each in reasons])[rows.ride]
    scale = np.maximum(np.nan_to_num(scatter, nan=1.0), 1.0)
    rows = rows._replace(std_rad=rows.std_rad * scale[rows.ride])
    solution = _solve(rows, used, count, prior, with_variance=True)
    left = rows.grade_rad - rows.sign * solution.bias[rows.ride] - solution.grade[rows.cell]
    chi2 = np.bincount(rows.cell[used], ((left / rows.std_rad) ** 2)[used], count)
    return Merged(
        numbers,
        solution.grade,
        np.sqrt(solution.variance),
        chi2,
        np.bincount(rows.cell[used], minlength=count),
        bias,
        scatter,
        tuple(reasons),
        used,
        rows.std_rad,
    )


def _bias_covariance(vehicles: Sequence[str]) -> Array:
    """B: rides of one vehicle have its mounting in common."""
    names = np.unique(np.array(vehicles), return_inverse=True)[1]
    same = names[:, None] == names[None, :]
    return RIDE_BIAS_STD_RAD**2 * np.eye(len(vehicles)) + VEHICLE_BIAS_STD_RAD**2 * same


def _solve(
    rows: Rows, used: Flags, count: int, prior: Array, with_variance: bool = False
) -> _Solution:
    """Least squares for slopes and biases; the variances of slopes take most of its time."""
    ride, cell, rides = rows.ride[used], rows.cell[used], len(prior)
    w, y = 1.0 / rows.std_rad[used] ** 2, rows.grade_rad[used]
    wd = w * rows.sign[used]
    weight = np.bincount(cell, w, count)
    known = weight > 0
    safe = np.where(known, weight, 1.0)
    z = np.bincount(cell, w * y, count) / safe
    S = prior + np.diag(np.bincount(ride, w, rides))
    told = np.bincount(ride, wd * y, rides)
    columns = _columns(ride, cell, wd, rides, count)
    for A, part in columns:
        S -= (A / safe[part]) @ A.T
        told -= A @ z[part]
    factor = cho_factor(S)
    bias = cho_solve(factor, told)
    grade, variance = z.copy(), 1.0 / safe
    for A, part in columns:
        grade[part] -= bias @ A / safe[part]
        if with_variance:
            half = solve_triangular(factor[0], A, trans="T", lower=factor[1])
            variance[part] += np.sum(half**2, axis=0) / safe[part] ** 2
    unknown = np.where(known, 0.0, np.nan)
    return _Solution(grade + unknown, variance + unknown, weight, bias)


def _columns(
    ride: Integers, cell: Integers, wd: Array, rides: int, count: int
) -> list[tuple[Array, slice]]:
    """A, some cells at a time, dense."""
    found = []
    for begin in range(0, count, _CHUNK):
        end = min(begin + _CHUNK, count)
        here = (cell >= begin) & (cell < end)
        flat = ride[here] * (end - begin) + cell[here] - begin
        A = np.bincount(flat, wd[here], rides * (end - begin)).reshape(rides, end - begin)
        found.append((A, slice(begin, end)))
    return found


# Who is wrong -------------------------------------------------------------------------------------
def medians(group: Integers, value: Array, count: int) -> Array:
    """Median of the values of each group; NaN of one without any."""
    order, starts = grouped(group, count)
    found = np.full(count, np.nan)
    for first in range(0, count, _CHUNK):
        last = min(first + _CHUNK, count)
        sizes = np.diff(starts[first : last + 1])
        row = np.repeat(np.arange(last - first), sizes)
        column = np.arange(starts[first], starts[last]) - starts[first:last][row]
        table = np.full((last - first, max(int(sizes.max(initial=0)), 1)), np.inf)
        table[row, column] = value[order[starts[first] : starts[last]]]
        table.sort(axis=1)
        every = np.arange(last - first)
        low, high = (
            table[every, np.maximum(sizes - 1, 0) // 2],
            table[every, sizes // 2 * (sizes > 0)],
        )
        found[first:last] = np.where(sizes > 0, (low + high) / 2, np.nan)
    return found


def grouped(group: Integers, count: int) -> tuple[Integers, Integers]:
    """Order of rows by group, each group's in the order that they have; first row of each group,
    and the number of all."""
    number = np.arange(len(group))
    table = sparse.csr_matrix((number, (group, number)), shape=(count, max(len(group), 1)))
    return table.data, table.indptr.astype(np.int64)


def _good_passes(rows: Rows, count: int) -> Flags:
    """Whether each pass is among those of its cell, its ride's bias taken out."""
    rides = int(rows.ride.max()) + 1 if len(rows.ride) else 0
    middle = medians(rows.cell, rows.grade_rad, count)
    off = (rows.grade_rad - middle[rows.cell]) * rows.sign
    own = medians(rows.ride, off, rides)
    left = np.abs(off - own[rows.ride])
    crowd = np.bincount(rows.cell, minlength=count)[rows.cell] > OTHERS
    # A ride that scatters as a whole is judged as a whole.
    usual = medians(rows.ride, left, rides)[rows.ride] * MAD_TO_STD
    limit = np.maximum(PASS_LIMIT_STDS * np.maximum(rows.std_rad, usual), PASS_LEAST_RAD)
    good: Flags = ~(crowd & (left > limit))
    return good


def _judged_by_medians(rows: Rows, good: Flags, count: int, rides: int) -> list[str]:
    middle = medians(rows.cell[good], rows.grade_rad[good], count)
    passes = np.bincount(rows.cell[good], minlength=count)
    at = good & (passes > OTHERS)[rows.cell]
    off = (rows.grade_rad - middle[rows.cell]) * rows.sign
    bias = medians(rows.ride[at], off[at], rides)
    left = np.abs(off - bias[rows.ride]) / rows.std_rad
    scatter = MAD_TO_STD * medians(rows.ride[at], left[at], rides)
    enough = _enough(rows, good, at, rides)
    usual = _usual(np.where(enough, scatter, np.nan))
    return [_reason(bias[r], scatter[r], usual) if enough[r] else "" for r in range(rides)]


def _judged(
    rows: Rows, good: Flags, used: Flags, solution: _Solution, rides: int
) -> tuple[list[str], Array, Array]:
    """Hold each ride against the map of the others; reason, bias and scatter of each."""
    w = 1.0 / rows.std_rad**2
    own = np.where(used, w, 0.0)
    # A ride's own part in the map is taken out, its bias as the map had it.
    rest = solution.weight[rows.cell] - own
    others = np.bincount(rows.cell[used], minlength=len(solution.grade))[rows.cell] - used
    at = good & (others >= OTHERS) & (rest > 0)
    safe = np.where(rest > 0, rest, 1.0)
    freed = rows.grade_rad - rows.sign * solution.bias[rows.ride]
    without = (np.nan_to_num(solution.grade)[rows.cell] * (rest + own) - own * freed) / safe
    left = (rows.grade_rad - without) * rows.sign
    weight = 1.0 / (rows.std_rad**2 + 1.0 / safe)
    total = np.bincount(rows.ride[at], weight[at], rides)
    number = np.bincount(rows.ride[at], minlength=rides)
    with np.errstate(invalid="ignore", divide="ignore"):
        bias = np.bincount(rows.ride[at], (weight * left)[at], rides) / total
        square = weight * (left - bias[rows.ride]) ** 2
        scatter = np.sqrt(np.bincount(rows.ride[at], square[at], rides) / (number - 1))
    enough = _enough(rows, good, at, rides)
    scatter = np.where(enough, scatter, np.nan)
    usual = _usual(scatter)
    reasons = [_reason(bias[r], scatter[r], usual) if enough[r] else "" for r in range(rides)]
    known = np.isfinite(bias)
    return reasons, np.where(known, bias, solution.bias), scatter


def _usual(scatter: Array) -> float:
    """Scatter of a ride as rides are; what they state where nobody can tell."""
    known = scatter[np.isfinite(scatter)]
    return max(float(np.median(known)), 1.0) if len(known) else 1.0


def _enough(rows: Rows, good: Flags, at: Flags, rides: int) -> Flags:
    """Whether enough of a ride lies where others have been, for it to be judged."""
    number = np.bincount(rows.ride[at], minlength=rides)
    whole = np.bincount(rows.ride[good], minlength=rides)
    enough: Flags = (number >= JUDGED_CELLS) & (number >= JUDGED_SHARE * whole)
    return enough


def _reason(bias: float, scatter: float, usual: float) -> str:
    """Why a ride is out; empty where it is not."""
    limit = LIMIT_STDS * float(np.hypot(RIDE_BIAS_STD_RAD, VEHICLE_BIAS_STD_RAD))
    if abs(bias) > limit:
        return (
            f"its slopes are {100 * bias:+.2f} % off those of the others all along "
            "(mounting of the IMU in pitch, or bias of its accelerometer)"
        )
    if scatter > SCATTER_LIMIT * usual:
        return f"its slopes scatter {scatter / usual:.1f} times as much as is usual around others'"
    return ""
