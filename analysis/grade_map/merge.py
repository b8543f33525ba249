"""Many rides become one slope for each cell, in information form, whatever their order.

A ride r says of a cell c, on which its x axis points along the track as drawn (d = 1) or against it
(d = −1),

    y = g_c + d b_r + ε,        ε ~ N(0, σ²),   b_r ~ N(0, σ_b²) + (one of its vehicle) N(0, σ_v²)

b is what is wrong all along the ride (accelerometer, mounting) and turns its sign with the vehicle,
so that rides both ways tell it apart from the slope. A smoother states the deviation s_c of both
together. Most of its error is the accelerometer's bias, which heights tell to some tenths of a per
cent in a ride of minutes: so all of it that can be the same all along the ride is taken to be,
σ_b = the least s_c (tenth of the cells), and the rest is σ² = s_c² − σ_b². Cells that took σ_b for
independent would be sure of what no ride knows. One least squares for all of it: with w = 1/σ²,
W_c = Σ w, A_rc = Σ w d and z_c = Σ w y / W_c,

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

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from tramstream.analysis.grade_map.cells import Integers
from tramstream.analysis.grade_map.verdicts import (
    LIMIT_STDS,
    RIDE_BIAS_STD_RAD,
    VEHICLE_BIAS_STD_RAD,
    Rows,
    Solution,
    by_medians,
    by_the_others,
    common_std,
    own_std,
    sums,
)
from tramstream.tracks.network import Array

Flags = NDArray[np.bool_]

ROUNDS = 8
CHUNK = 4096
"""Cells that are taken together, so that a city needs no more memory than a line."""


@dataclass(frozen=True)
class Merged:
    """Cells ascending, and rides in their order."""

    cell: Integers
    row_cell: Integers
    """Of each row, which of these it is of."""
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
    common = common_std(rows, rides)
    rows = rows._replace(std_rad=own_std(rows, common))
    common = np.hypot(common, RIDE_BIAS_STD_RAD)
    prior = _bias_information(vehicles, common)
    limit = LIMIT_STDS * np.hypot(common, VEHICLE_BIAS_STD_RAD)
    good, reasons = by_medians(rows, count, limit)
    seen = {tuple(reasons)}
    for _ in range(ROUNDS):
        used = good & np.array([not each for each in reasons])[rows.ride]
        solution = _solve(rows, used, count, prior)
        verdicts = by_the_others(rows, good, used, solution, limit)
        reasons = verdicts.reasons
        if tuple(reasons) in seen:
            break
        seen.add(tuple(reasons))
    used = good & np.array([not each for each in reasons])[rows.ride]
    scale = np.maximum(np.nan_to_num(verdicts.scatter, nan=1.0), 1.0)
    rows = rows._replace(std_rad=rows.std_rad * scale[rows.ride])
    solution = _solve(rows, used, count, prior, with_variance=True)
    left = rows.grade_rad - rows.sign * solution.bias[rows.ride] - solution.grade[rows.cell]
    chi2 = sums(rows.cell, np.where(used, (left / rows.std_rad) ** 2, 0.0), count)
    return Merged(
        numbers,
        rows.cell,
        solution.grade,
        np.sqrt(solution.variance),
        chi2,
        np.bincount(rows.cell, used, count).astype(np.int64),
        verdicts.bias,
        verdicts.scatter,
        tuple(reasons),
        used,
    )


def _bias_information(vehicles: Sequence[str], std: Array) -> Array:
    """B⁻¹: rides of one vehicle have its mounting in common (Sherman and Morrison's formula)."""
    names = np.unique(np.array(vehicles), return_inverse=True)[1]
    own, shared = std**-2.0, VEHICLE_BIAS_STD_RAD**2
    factor = shared / (1.0 + shared * np.bincount(names, own))[names]
    same = names[:, None] == names[None, :]
    information: Array = np.diag(own) - same * np.outer(own * factor, own)
    return information


def _solve(
    rows: Rows, used: Flags, count: int, prior: Array, with_variance: bool = False
) -> Solution:
    """Least squares for slopes and biases; the variances of slopes take most of its time."""
    ride, cell, y, rides = rows.ride, rows.cell, rows.grade_rad, len(prior)
    w = used / rows.std_rad**2
    wd = w * rows.sign
    weight = sums(cell, w, count)
    known = weight > 0
    safe = np.where(known, weight, 1.0)
    z = sums(cell, w * y, count) / safe
    S = prior + np.diag(sums(ride, w, rides))
    told = sums(ride, wd * y, rides)
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
    return Solution(grade + unknown, variance + unknown, weight, bias)


def _columns(
    ride: Integers, cell: Integers, wd: Array, rides: int, count: int
) -> list[tuple[Array, slice]]:
    """A, some cells at a time, dense."""
    found = []
    for begin in range(0, count, CHUNK):
        end = min(begin + CHUNK, count)
        if count > CHUNK:
            here = (cell >= begin) & (cell < end)
            flat, w = ride[here] * (end - begin) + cell[here] - begin, wd[here]
        else:
            flat, w = ride * count + cell, wd
        A = sums(flat, w, rides * (end - begin)).reshape(rides, end - begin)
        found.append((A, slice(begin, end)))
    return found
