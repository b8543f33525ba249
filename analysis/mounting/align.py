"""The mounting of an IMU out of rides: checks, coarse alignment, smoother, theses, verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tramstream.analysis.mounting import checks
from tramstream.analysis.mounting.checks import Moved
from tramstream.analysis.mounting.coarse import Coarse, coarse, trajectory
from tramstream.analysis.mounting.combine import One, Together, together
from tramstream.analysis.mounting.drive import Array, Drive
from tramstream.analysis.mounting.known import Settings, known_of
from tramstream.analysis.mounting.solve import Known, Solution, information, solve
from tramstream.analysis.mounting.theses import Thesis, theses
from tramstream.config import Vehicle

NO_FIGURE_DEG = 5.0
"""An angle whose deviation is larger is not told."""
GOAL_DEG = 0.5
"""What the localisation filter can be given without a thought."""
UNLIKELY = 1e-4
"""Chance below which rides do not speak of one mounting."""
MISFIT_MPS = 0.5
"""Speed to the side at the pivot that no vehicle on rails or tyres has."""
AXES = ("roll", "pitch", "yaw")
MISSING = (
    "straight track at some speed: only that tells what is upright",
    "curves to both sides, and grades or a level stand: they part a pitch from the accelerometers' "
    "bias",
    "hard braking, speeding up, and curves",
)
"""Which manoeuvre an angle wants."""


class Ride(NamedTuple):
    """One ride and what it says."""

    name: str
    drive: Drive
    known: Known
    coarse: Coarse
    solution: Solution | None
    trouble: str
    """Why there is no figure; empty if there is one."""
    moved: Moved | None
    theses: list[Thesis]
    upright: Array
    """(3,): the cross-level's part of the deviations, rad."""
    motion: Motion


class Motion(NamedTuple):
    """What the vehicle did."""

    duration_s: float
    way_m: float
    straight_m: float
    halts: int
    braked_mps2: float
    """RMS of the acceleration while it moves."""
    curved_mps2: float
    """RMS of v·ω_z while it moves."""
    reverse_s: float
    fixes: int
    wheels: bool


class Answer(NamedTuple):
    """All rides together."""

    rides: list[Ride]
    C_bv: Array
    """(3, 3), NaN without an answer."""
    std_rad: Array
    """(3,), about the vehicle's axes."""
    upright_rad: Array
    """(3,): what of it the cross-level of the track makes."""
    chance: float
    """Of rides that differ so much; see `combine.Together`."""
    verdict: str
    """Why there is no figure; empty if there is one."""
    notes: list[str]


def align_ride(name: str, drive: Drive, vehicle: Vehicle, settings: Settings) -> Ride:
    """Find the mounting out of one ride."""
    known = known_of(vehicle, drive, settings)
    found = coarse(drive)
    motion = motion_of(drive, found)
    trouble = checks.ride_trouble(drive, found)
    moved = None if trouble else checks.moved(drive, found)
    if moved is not None:
        trouble = (
            f"the case sits otherwise from {moved.at_s:.0f} s on, by "
            f"{math.degrees(moved.angle_rad):.1f}°: align what lies before and after by itself"
        )
    if trouble:
        return Ride(name, drive, known, found, None, trouble, moved, [], np.full(3, np.nan), motion)
    solution = solve(drive, trajectory(drive, found), known)
    trouble = _misfit(solution)
    without = known._replace(noise=solution.noise._replace(cross_level_rad=1e-7))
    told = np.diag(information(solution.drive, solution.point, without, solution.log))
    upright = np.sqrt(np.maximum(np.diag(solution.covariance) - told, 0.0))
    said = theses(drive, found, solution)
    solution = solution.without_log()
    return Ride(name, drive, known, found, solution, trouble, None, said, upright, motion)


def _misfit(solution: Solution) -> str:
    if not solution.settled:
        return "the passes do not come to rest: the ride does not fit the model of a vehicle"
    if max(solution.noise.side_mps, solution.noise.up_mps) > MISFIT_MPS:
        return (
            f"the vehicle slips sideways by {solution.noise.side_mps:.1f} m/s and rises by "
            f"{solution.noise.up_mps:.1f}: no one mounting makes a vehicle of these readings"
        )
    return ""


def motion_of(drive: Drive, found: Coarse) -> Motion:
    """Sum up a ride."""
    kin = found.kinematics
    moving = kin.moving
    turning = np.zeros(drive.length)
    if np.all(np.isfinite(found.C_vb)):
        turning = kin.omega_b @ found.C_vb[2]
        if drive.standing.sum() > 50:
            turning = turning - turning[drive.standing].mean()
    curve = kin.speed_mps * turning
    starts = np.flatnonzero(np.diff(moving.astype(np.int8)) > 0)
    straight = moving & (np.abs(turning) < 0.002 * kin.speed_mps)
    some = bool(moving.any())
    return Motion(
        duration_s=drive.duration_s,
        way_m=float(kin.speed_mps[moving].sum()) * drive.dt_s,
        straight_m=float(kin.speed_mps[straight].sum()) * drive.dt_s,
        halts=len(starts),
        braked_mps2=float(np.sqrt(np.mean(kin.acceleration_mps2[moving] ** 2))) if some else 0.0,
        curved_mps2=float(np.sqrt(np.mean(curve[moving] ** 2))) if some else 0.0,
        reverse_s=float(np.sum(found.reverse & moving)) * drive.dt_s,
        fixes=len(drive.fixes.node),
        wheels=bool(np.isfinite(drive.wheel_mps).any()),
    )


def answer(rides: Sequence[Ride], troubles: Sequence[str] = ()) -> Answer:
    """Put rides together, and judge.

    Parameters
    ----------
    rides : sequence of Ride
    troubles : sequence of str
        Of the sensors: with any there is no figure.
    """
    useful = [each for each in rides if each.solution is not None and not each.trouble]
    nothing = np.full(3, np.nan)
    verdict = "; ".join(troubles)
    if not verdict and any(each.moved for each in rides):
        verdict = "; ".join(f"{each.name}: {each.trouble}" for each in rides if each.moved)
    if not verdict and not useful:
        verdict = "; ".join(dict.fromkeys(each.trouble for each in rides)) or "there is no ride"
    notes = [f"{each.name}: left out: {each.trouble}" for each in rides if each.trouble]
    if verdict:
        return Answer(list(rides), np.full((3, 3), np.nan), nothing, nothing, 1.0, verdict, notes)
    found = _together(useful)
    if found.chance < UNLIKELY:
        off = np.degrees(np.abs(found.off_rad).max())
        verdict = (
            f"the rides do not speak of one mounting (they differ by up to {off:.2f}°, chance "
            f"{found.chance:.1g}): the case was moved between them; align them one by one"
        )
    std = np.sqrt(np.diag(found.covariance))
    weak = [k for k in range(3) if math.degrees(std[k]) > NO_FIGURE_DEG]
    if weak and not verdict:
        verdict = "; ".join(
            f"{AXES[k]} is not told (σ {math.degrees(std[k]):.0f}°): it wants {MISSING[k]}"
            for k in weak
        )
    notes += _enough(useful, std) + _failed(useful)
    upright = np.sqrt(1 / np.sum([1 / np.maximum(r.upright, 1e-9) ** 2 for r in useful], axis=0))
    C_bv = np.full((3, 3), np.nan) if verdict else found.C_vb.T
    return Answer(list(rides), C_bv, std, upright, found.chance, verdict, notes)


def _together(useful: Sequence[Ride]) -> Together:
    ones = [
        One(each.solution.C_vb, each.solution.covariance)
        for each in useful
        if each.solution is not None
    ]
    return together(ones)


def _enough(rides: Sequence[Ride], std_rad: Array) -> list[str]:
    """For which angle the rides are too short, and what it wants."""
    duration_s = sum(each.motion.duration_s for each in rides)
    notes = []
    for name, missing, std in zip(AXES, MISSING, np.degrees(std_rad).tolist(), strict=True):
        if std > GOAL_DEG:
            more_min = duration_s * ((std / GOAL_DEG) ** 2 - 1) / 60
            notes.append(
                f"{name}: too short for ±{GOAL_DEG}°: about {more_min:.0f} minutes more of such a "
                f"ride, or {missing}"
            )
    return notes


def _failed(rides: Sequence[Ride]) -> list[str]:
    return [
        f"{ride.name}: does not hold: {each.text} ({each.value:.3g}{each.unit})"
        for ride in rides
        for each in ride.theses
        if not each.holds
    ]
