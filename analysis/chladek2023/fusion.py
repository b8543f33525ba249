"""Rides as information on a route's heights, their sum, and the smooth profile that it gives.

What one ride tells of a cell does not depend on other cells or rides, once its true speed is known:

- its height at an edge, with the deviation of the sensor;
- the slope of a cell, from the kinetic energy that force and resistance do not explain:
  sin α = (F̄/m − c_d v² − g c_r)/g − v̄ Δv/(g Δs), whose error is that of Δv, one step of the
  measured speed's walk. Nothing is divided by the speed: a ride may stand.

The true speed is the first measured one carried on by the energy of force, resistance and climbed
height (that of the heights alone); the walk of the measured speed is no part of it. So a ride is a
band matrix and a vector over the route's knots, rides are added in any order, and each is counted
once. What is known of slopes beforehand enters once, for all rides together: the curvature of the
profile is an integrated random walk (fourth differences of height are white). Its density is the
most likely one. The profile is the minimum of a sum of squares: forward and backward in one
solution.

Equations: docs/chladek2023.md.
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from tramstream.analysis.chladek2023.ride import (
    CELL_M,
    GRAVITY_MPS2,
    HEIGHT_STD_M,
    SPEED_WALK_MPS,
    VEHICLE,
    Array,
    Rides,
)

KNOT_CELLS = 4
"""Cells from knot to knot: 10 m, between which a profile is straight within millimetres."""
KNOT_M = KNOT_CELLS * CELL_M
LOG10_DENSITY = (-18.0, -7.0)
"""Where the density of the walk, 1/m⁵, is sought: from curvatures that are straight lines for a
kilometre to those that are others at every knot."""
BLOCK = 500
"""Columns of the inverse that are held at once."""
STILL_MPS = 1e-3
"""A speed below counts as this where the error of a slope is divided by it."""


class Information(NamedTuple):
    """What rides know of the heights of the knots: information matrix and vector."""

    diagonal: Array
    """(knots,), 1/m²."""
    beside: Array
    """(knots − 1,): of neighbours."""
    vector: Array
    """(knots,), 1/m."""

    def __add__(self, other: object) -> Information:
        if not isinstance(other, Information):
            return NotImplemented
        return Information(*(a + b for a, b in zip(self, other, strict=True)))


class Smooth(NamedTuple):
    """A profile with its deviation."""

    height_m: Array
    """Of the knots."""
    rise: Array
    """sin α from knot to knot."""
    rise_std: Array
    density: float
    """Of the walk of the curvature's change, 1/m⁵."""


def of_ride(rides: Rides, number: int) -> Information:
    """What one ride knows, by itself."""
    speed, force = rides.measured_speed_mps[number], rides.force_n[number]
    heights = of_heights(rides.measured_height_m[number])
    lying = at_edges(smooth(heights, deviations=False).height_m, len(speed))
    true = true_speed_mps(float(speed[0]), force, lying)
    middle = (true[1:] + true[:-1]) / 2
    pushed = VEHICLE.acceleration_mps2(force, middle, np.zeros(len(force))) / GRAVITY_MPS2
    lever = middle / (GRAVITY_MPS2 * CELL_M)
    std = np.maximum(middle, STILL_MPS) / (GRAVITY_MPS2 * CELL_M) * SPEED_WALK_MPS
    return heights + of_rises(pushed - lever * np.diff(speed), std)


def of_heights(height_m: Array) -> Information:
    """What heights at the edges of all cells know; between knots they lie on a straight line."""
    knots = _knots(len(height_m))
    cell = np.arange(len(height_m))
    left = np.minimum(cell // KNOT_CELLS, knots - 2)
    ahead = cell / KNOT_CELLS - left
    weight = HEIGHT_STD_M**-2
    return Information(
        _summed(left, (1 - ahead) ** 2 * weight, knots)
        + _summed(left + 1, ahead**2 * weight, knots),
        _summed(left, (1 - ahead) * ahead * weight, knots - 1),
        _summed(left, (1 - ahead) * weight * height_m, knots)
        + _summed(left + 1, ahead * weight * height_m, knots),
    )


def of_rises(rise: Array, std: Array) -> Information:
    """What sin α of all cells, each with its deviation, knows."""
    knots = _knots(len(rise) + 1)
    left = np.arange(len(rise)) // KNOT_CELLS
    weight = std**-2 / KNOT_M**2
    both, told = _summed(left, weight, knots), _summed(left, weight * rise * KNOT_M, knots)
    behind, told_behind = (np.concatenate([[0.0], each[:-1]]) for each in (both, told))
    return Information(both + behind, -both[:-1], told_behind - told)


def together(rides: Rides) -> Information:
    """What all rides know, each counted once."""
    return reduce(add, (of_ride(rides, each) for each in range(len(rides.force_n))))


def true_speed_mps(first_mps: float, force_n: Array, height_m: Array) -> Array:
    """Speed at the edges from its first value, the energy put in, and the height climbed.

    v² obeys a linear equation in the way: drag is a share of it, all else is given.
    """
    rolling = GRAVITY_MPS2 * VEHICLE.rolling * CELL_M
    given = 2 * (CELL_M * force_n / VEHICLE.mass_kg - rolling - GRAVITY_MPS2 * np.diff(height_m))
    drag = VEHICLE.drag_per_m * CELL_M
    kept = (1 - drag) / (1 + drag)
    squares, _ = lfilter([1.0], [1.0, -kept], given / (1 + drag), zi=[kept * first_mps**2])
    speed: Array = np.sqrt(np.maximum(np.concatenate([[first_mps**2], squares]), 0.0))
    return speed


def smooth(known: Information, deviations: bool = True) -> Smooth:
    """The profile that information and the prior make most likely."""
    found = minimize_scalar(
        lambda log10: -_log_likelihood(known, 10.0**log10),
        bounds=LOG10_DENSITY,
        method="bounded",
        options={"xatol": 0.05},
    )
    density = 10.0 ** float(found.x)
    factor, height = _solved(known, density)
    rise = np.diff(height) / KNOT_M
    rise_std = _rise_std(factor) if deviations else np.full(len(rise), np.nan)
    return Smooth(height, rise, rise_std, density)


def at_edges(of_knots: Array, edges: int) -> Array:
    """What the knots have, at the edges of the cells."""
    cells = np.arange(edges) / KNOT_CELLS
    found: Array = np.interp(cells, np.arange(len(of_knots)), of_knots)
    return found


def knots_of(of_edges: Array) -> Array:
    """What the edges of the cells have, at those that are knots."""
    return of_edges[::KNOT_CELLS]


def grade_rad(profile: Smooth, edges: int) -> Array:
    """Slope at the edges of the cells."""
    return at_edges(np.arcsin(np.gradient(profile.height_m, KNOT_M)), edges)


# Least squares in a band --------------------------------------------------------------------------
FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
"""Fourth difference."""
ORDER = len(FOURTH) - 1
"""Diagonals beside the main one; and dimensions of the cubics on which the prior says nothing."""


def _knots(edges: int) -> int:
    return -(-(edges - 1) // KNOT_CELLS) + 1


def _summed(at: NDArray[np.int64], values: Array, count: int) -> Array:
    return np.bincount(at, values, count)[:count].astype(np.float64)


def _solved(known: Information, density: float) -> tuple[Array, Array]:
    """Factor of the information matrix, upper band as scipy has it, and heights."""
    knots = len(known.diagonal)
    band = np.zeros((ORDER + 1, knots))
    band[ORDER], band[ORDER - 1, 1:] = known.diagonal, known.beside
    stiff = 1.0 / (density * KNOT_M ** (2 * ORDER - 1))
    for row in range(ORDER + 1):
        for column in range(row, ORDER + 1):
            part = slice(column, knots - ORDER + column)
            band[ORDER - column + row, part] += stiff * FOURTH[row] * FOURTH[column]
    factor: Array = cholesky_banded(band)
    height: Array = cho_solve_banded((factor, False), known.vector)
    return factor, height


def _log_likelihood(known: Information, density: float) -> float:
    """Of the measurements, but for a constant; the prior has four dimensions less than knots."""
    factor, height = _solved(known, density)
    fit = 0.5 * float(height @ known.vector) - float(np.log(factor[ORDER]).sum())
    return fit - 0.5 * (len(height) - ORDER) * float(np.log(density))


def _rise_std(factor: Array) -> Array:
    """Deviation of sin α from knot to knot: of the difference of neighbouring heights."""
    knots = factor.shape[1]
    variance = np.empty(knots - 1)
    for begin in range(0, knots - 1, BLOCK):
        left = np.arange(begin, min(begin + BLOCK, knots - 1))
        columns = np.arange(len(left))
        difference = np.zeros((knots, len(left)))
        difference[left, columns], difference[left + 1, columns] = -1.0, 1.0
        solved = cho_solve_banded((factor, False), difference)
        variance[left] = solved[left + 1, columns] - solved[left, columns]
    std: Array = np.sqrt(variance) / KNOT_M
    return std
