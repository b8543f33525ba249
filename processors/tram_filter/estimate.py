"""What the model `tram` says: an `Estimate` out of its memory, with or without a heading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import (
    ACCELERATION,
    COVARIANCE,
    HEADING_UNKNOWN,
    VALUES,
    YAW_RATE,
    Estimate,
    Learned,
    Verdict,
)
from tramstream.processors.tram_model import axes
from tramstream.processors.tram_model.states import UNITS, Ix
from tramstream.processors.tram_model.zero_velocity import STANDING_STD_MPS

EAST_VARIANCE, NORTH_VARIANCE, SPEED_VARIANCE = (
    COVARIANCE + int(state) * 8 for state in (Ix.EAST, Ix.NORTH, Ix.SPEED)
)
"""In the values of an estimate, whose covariance has seven columns."""
STEEPEST = 0.09
"""Grade of the steepest tramways, by which heights change on a way that is not known; by hand."""
NO_HEADING_STD_RAD = math.pi / math.sqrt(3.0)
"""Of an angle that may be any."""


def estimate_of(
    memory: Array,
    parameters: Array,
    stamp_ns: int,
    mode: int,
    standing: bool,
    verdicts: list[Verdict],
) -> Estimate:
    """Give the motion of the vehicle's origin out of the filter's memory."""
    values = np.empty(VALUES)
    axes.estimate(memory, parameters, mode != HEADING_UNKNOWN, values)
    return of_values(values, stamp_ns, mode, standing, verdicts)


def of_values(
    values: Array, stamp_ns: int, mode: int, standing: bool, verdicts: list[Verdict]
) -> Estimate:
    """Say so of a vehicle that stands that it may have begun to move, and nobody has seen it yet.

    The filter itself takes a thousand readings of no speed for as many proofs.
    """
    if standing:
        values[SPEED_VARIANCE] += STANDING_STD_MPS**2
    return Estimate(stamp_ns, mode, values, standing, verdicts)


def doubt(values: Array, way_m: float, speed_mps: float) -> None:
    """Say of a vehicle that stands by its wheels, and moves by GNSS, that either may be true."""
    values[EAST_VARIANCE] += way_m * way_m
    values[NORTH_VARIANCE] += way_m * way_m
    values[SPEED_VARIANCE] += speed_mps * speed_mps


def without_heading(
    estimate: Estimate, lever_arm_m: Sequence[float], of_antenna: bool = True
) -> Estimate:
    """Say of a vehicle that its heading is not known, and so not where it is about its antenna.

    Parameters
    ----------
    lever_arm_m : sequence of 3 float
        From the vehicle's origin to the antenna, frame v.
    of_antenna : bool
        Whether the estimate's position is the antenna's.
    """
    said = replace(estimate, values=estimate.values.copy())
    motion, covariance = said.motion, said.covariance
    x, y, z = lever_arm_m
    covariance[:2, :2] += np.eye(2) * (0.5 * (x * x + y * y))  # anywhere on a circle
    if of_antenna:
        motion[Ix.UP] -= z
    motion[Ix.YAW] = said.values[ACCELERATION] = said.values[YAW_RATE] = 0.0
    covariance[Ix.YAW, :] = covariance[:, Ix.YAW] = 0.0
    covariance[Ix.YAW, Ix.YAW] = NO_HEADING_STD_RAD**2
    return said


def at_fix(
    estimate: Estimate,
    p_l: tuple[float, float, float],
    stds_m: tuple[float, float],
    speed_mps: float,
    lever_arm_m: Sequence[float],
) -> Estimate:
    """Say of a vehicle that moves, with its heading unknown: where its antenna is by the last fix.

    `stds_m` are the deviations of that, of each horizontal axis and of the height.
    """
    moved = without_heading(estimate, lever_arm_m)
    covariance = moved.covariance
    x, y, z = lever_arm_m
    moved.motion[:4] = (p_l[0], p_l[1], p_l[2] - z, speed_mps)
    covariance[:4, :] = covariance[:, :4] = 0.0
    level = stds_m[0] ** 2 + 0.5 * (x * x + y * y)
    covariance[:4, :4] = np.diag([level, level, stds_m[1] ** 2, max(1.0, speed_mps) ** 2])
    return moved


def on_way(
    estimate: Estimate,
    way: complex,
    variance_m2: float,
    velocity: complex,
    lever_arm_m: Sequence[float],
) -> Estimate:
    """Say of a vehicle that moves, with its heading unknown: how far it is from where it stood.

    Parameters
    ----------
    estimate : Estimate
        Of the stand.
    way, velocity : complex
        To the east and, imaginary, to the north, m and m/s.
    variance_m2 : float
        Of the way, either axis.
    """
    moved = without_heading(estimate, lever_arm_m)
    covariance, speed_mps = moved.covariance, abs(velocity)
    moved.motion[Ix.EAST] += way.real
    moved.motion[Ix.NORTH] += way.imag
    moved.motion[Ix.SPEED] = speed_mps
    covariance[:2, :2] += np.eye(2) * variance_m2
    covariance[2, 2] += (STEEPEST * abs(way)) ** 2
    covariance[Ix.SPEED, :] = covariance[:, Ix.SPEED] = 0.0
    covariance[Ix.SPEED, Ix.SPEED] = max(1.0, speed_mps) ** 2
    return moved


def learned(state: Sequence[float], variances: Sequence[float]) -> list[Learned]:
    """Give what a filter has learned, out of its state and the diagonal of its covariance."""
    return [
        Learned(slot.name.lower(), state[slot], math.sqrt(max(variances[slot], 0.0)), unit)
        for slot, unit in UNITS.items()
    ]
