"""The aligner on simulated rides: errors of many seeds and mountings beside the Cramér-Rao bound.

Each ride is aligned by ours, and by the work's estimator where that is asked for. The bound is the
covariance of the smoother's own model, linearised at the truth; that with the motion known takes
specific force and rate of the vehicle as given, and leaves mounting and biases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from tramstream.analysis.melenovsky2023 import iekf
from tramstream.analysis.melenovsky2023.initial import initial
from tramstream.analysis.melenovsky2023.records import AFTER_INITIAL_RAD
from tramstream.analysis.mounting.coarse import coarse, trajectory
from tramstream.analysis.mounting.combine import One, together
from tramstream.analysis.mounting.drive import Array
from tramstream.analysis.mounting.known import Settings, known_of
from tramstream.analysis.mounting.solve import Known, information, solve
from tramstream.analysis.studies.mounting_rides import (
    CrossLevel,
    Drawn,
    World,
    draw,
    off_rad,
    world,
)
from tramstream.attitude import C_vl
from tramstream.config import Vehicle
from tramstream.machine.kernels import compiled
from tramstream.simulation import scenario as scenarios
from tramstream.simulation.body import Body
from tramstream.simulation.vehicle import configuration

WORK = "melenovsky2023"
PSI_DEG = (30.0, 60.0, 90.0)
DURATIONS_S = (300.0, 900.0, 2195.0)
SEEDS = 20
MOUNTINGS = 100
MOUNTING_S = 600.0
REFERENCE_S = 4020.0
TOGETHER = 4
"""Rides that are put together."""
PUBLISHED_ARCMIN = {"initial": 138.0, "IEKF": 53.0}
"""The work's single ride, each as one rotation."""


class Case(NamedTuple):
    """One ride."""

    kind: str = "work"
    """work, model (the same, and the work's estimator beside), mountings, reference, cross-level or
    body."""
    seed: int = 1
    durations_s: tuple[float, ...] = DURATIONS_S


class Figures(NamedTuple):
    """One ride, aligned."""

    kind: str
    seed: int
    duration_s: float
    first_rad: Array
    """(3,): error of the coarse alignment, a turn about the vehicle's axes."""
    last_rad: Array
    """(3,): of the smoother's."""
    C_vb: Array
    covariance: Array
    bound: Array
    """(3, 3): of the model at the truth."""
    known_motion: Array
    """(3, 3): with the motion known."""
    settled: bool
    passes: int
    initial_rad: Array
    """(3,): error of the work's initial estimate; NaN where it was not run."""
    iekf_rad: Array
    """(3,): of its filter from there."""

    @property
    def nees(self) -> float:
        """Of three degrees of freedom."""
        return float(self.last_rad @ np.linalg.solve(self.covariance, self.last_rad))


class Row(NamedTuple):
    """Rides of a kind and a length together; angular minutes as one rotation."""

    kind: str
    duration_s: float
    rides: int
    first: float
    last: float
    bound: float
    known_motion: float
    axes: tuple[float, float, float]
    """RMS about x, y, z."""
    axes_bound: tuple[float, float, float]
    worst: float
    """Largest error over its own bound."""
    nees: float
    """Mean over three degrees of freedom: 1."""
    nees_low: float
    nees_high: float
    """Bounds of 95 % for that mean."""
    initial: float
    iekf: float
    settled: int


@lru_cache(maxsize=4)
def world_of(kind: str, seed: int = 0) -> tuple[World, Vehicle]:
    """The ride of a kind, and its vehicle's configuration."""
    if kind in ("work", "model", "mountings"):
        chosen = scenarios.load(WORK)
        duration_s = MOUNTING_S if kind == "mountings" else DURATIONS_S[-1]
        return world(chosen, duration_s), configuration(chosen)
    chosen = scenarios.load("kaspar2023")
    cross = CrossLevel(math.radians(0.3), 50.0) if kind == "cross-level" else CrossLevel()
    vehicle = configuration(chosen)
    if kind == "body":
        chosen = _with_body(chosen)
        vehicle = _with_pivot(vehicle)
    return world(chosen, REFERENCE_S, cross, seed), vehicle


def _with_body(chosen: scenarios.Scenario) -> scenarios.Scenario:
    import msgspec

    return msgspec.structs.replace(chosen, body=Body())


def _with_pivot(vehicle: Vehicle) -> Vehicle:
    import msgspec

    ekf = msgspec.structs.replace(vehicle.ekf, pivot_m=3.2, bogie_distance_m=6.4)
    return msgspec.structs.replace(vehicle, ekf=ekf)


def mounting_of(case: Case) -> Array:
    """C_bv of a case: the work's, or the seed's own out of all of SO(3)."""
    if case.kind != "mountings":
        found: Array = C_vl(*np.radians(PSI_DEG))
        return found
    rng = np.random.default_rng([case.seed, 14])
    if case.seed % 10 == 0:
        roll, yaw = rng.uniform(-np.pi, np.pi, 2)
        pitch = math.pi / 2 if case.seed % 20 else -math.pi / 2
        return np.asarray(C_vl(roll, pitch, yaw))
    return np.asarray(Rotation.random(random_state=rng).as_matrix())


def study(case: Case) -> list[Figures]:
    """Align one ride, at each of its lengths."""
    varied = case.seed if case.kind == "cross-level" else 0
    of, vehicle = world_of(case.kind, varied)
    C_bv = mounting_of(case)
    drawn = draw(of, C_bv, np.random.default_rng(case.seed), bias=case.kind == "mountings")
    return [_one(case, drawn, duration_s, of, vehicle) for duration_s in case.durations_s]


def _one(case: Case, drawn: Drawn, duration_s: float, of: World, vehicle: Vehicle) -> Figures:
    end = min(round(duration_s / drawn.drive.dt_s) + 1, drawn.drive.length)
    drive = drawn.drive.cut(0, end)
    truth = drawn.truth._replace(**{name: getattr(drawn.truth, name)[:end] for name in _ALONG})
    cross = 0.3 if case.kind == "cross-level" else 0.0
    known = known_of(vehicle, drive, Settings(cross_level_deg=cross))
    found = coarse(drive)
    solution = solve(drive, trajectory(drive, found), known)
    judged, stated = known, drive
    if case.kind == "body":  # what its springs do to the constraints was found
        judged, stated = known._replace(noise=solution.noise), solution.drive
    nothing = np.full(3, np.nan)
    first, filtered = nothing, nothing
    if case.kind == "model":
        begun = initial(drive)
        first = off_rad(begun.C_vb, truth.C_vb)
        sensors = iekf.Sensors(*_densities(of), known.noise.accel_walk, known.noise.gyro_walk)
        psi = np.array([begun.roll_rad, begun.pitch_rad, begun.yaw_rad])
        tuning = iekf.Tuning(mounting_rad=AFTER_INITIAL_RAD)
        filtered = off_rad(iekf.run(drive, psi, sensors, tuning).C_vb, truth.C_vb)
    return Figures(
        kind=case.kind,
        seed=case.seed,
        duration_s=duration_s,
        first_rad=off_rad(found.C_vb, truth.C_vb),
        last_rad=off_rad(solution.C_vb, truth.C_vb),
        C_vb=solution.C_vb,
        covariance=solution.covariance,
        bound=information(stated, truth, judged, solution.log, exact=True),
        known_motion=known_motion_bound(of, end, known),
        settled=solution.settled,
        passes=solution.passes,
        initial_rad=first,
        iekf_rad=filtered,
    )


_ALONG = ("p_l", "vel_l", "C_lb", "accel_bias", "gyro_bias", "fix_error", "cross_level")


def _densities(of: World) -> tuple[float, float]:
    assert of.scenario.imu is not None
    errors = of.scenario.imu.errors
    return errors.accel_noise_mps2_rthz, errors.gyro_noise_radps_rthz


def known_motion_bound(of: World, end: int, known: Known) -> Array:
    """Covariance of the mounting if force and rate of the vehicle are given, (3, 3)."""
    P = np.diag(
        [100.0] * 3 + [known.prior.accel_bias_mps2**2] * 3 + [known.prior.gyro_bias_radps**2] * 3
    )
    noise = known.noise
    density = np.array([float(noise.accel.min()), float(noise.gyro.min())])
    walk = np.array([noise.accel_walk, noise.gyro_walk])
    _known(of.f_v[:end], of.omega_v[:end], P, density, walk, 0.1)
    return P[:3, :3].copy()


@compiled
def _known(f_v: Array, omega_v: Array, P: Array, density: Array, walk: Array, T: float) -> None:
    """f = f_v × m + bias + noise, likewise the rate; biases walk. P is updated in place."""
    H, K = np.zeros(9), np.zeros(9)
    for k in range(len(f_v)):
        for which in range(2):
            felt = f_v[k] if which == 0 else omega_v[k]
            for i in range(3):
                H[:] = 0.0
                a, b = (i + 1) % 3, (i + 2) % 3
                H[b], H[a] = felt[a], -felt[b]
                H[3 + 3 * which + i] = 1.0
                S = density[which] ** 2 / T
                for r in range(9):
                    K[r] = 0.0
                    for c in range(9):
                        K[r] += P[r, c] * H[c]
                for r in range(9):
                    S += H[r] * K[r]
                for r in range(9):
                    for c in range(9):
                        P[r, c] -= K[r] * K[c] / S
        for i in range(3):
            P[3 + i, 3 + i] += walk[0] ** 2 * T
            P[6 + i, 6 + i] += walk[1] ** 2 * T


# Sums ---------------------------------------------------------------------------------------------
def arcmin(angle_rad: float) -> float:
    """Angular minutes."""
    return math.degrees(angle_rad) * 60


def overall(found: Sequence[Figures]) -> list[Row]:
    """A row for each kind and length."""
    rows = []
    for kind, duration_s in dict.fromkeys((each.kind, each.duration_s) for each in found):
        these = [each for each in found if (each.kind, each.duration_s) == (kind, duration_s)]
        last = np.array([each.last_rad for each in these])
        bound = np.mean([np.diag(each.bound) for each in these], axis=0)
        freedom = 3 * len(these)
        low, high = stats.chi2.ppf([0.025, 0.975], freedom) / freedom
        worst = max(
            float(np.linalg.norm(each.last_rad) / math.sqrt(np.trace(each.bound))) for each in these
        )
        x, y, z = (arcmin(v) for v in np.sqrt(np.mean(last**2, axis=0)).tolist())
        bx, by, bz = (arcmin(v) for v in np.sqrt(bound).tolist())
        rows.append(
            Row(
                kind, duration_s, len(these),
                first=_rms([each.first_rad for each in these]),
                last=_rms([each.last_rad for each in these]),
                bound=arcmin(math.sqrt(float(bound.sum()))),
                known_motion=arcmin(
                    math.sqrt(float(np.mean([np.trace(each.known_motion) for each in these])))
                ),
                axes=(x, y, z),
                axes_bound=(bx, by, bz),
                worst=worst,
                nees=float(np.mean([each.nees for each in these])) / 3,
                nees_low=float(low),
                nees_high=float(high),
                initial=_rms([each.initial_rad for each in these]),
                iekf=_rms([each.iekf_rad for each in these]),
                settled=sum(each.settled for each in these),
            )
        )  # fmt: skip
    return rows


def _rms(errors: Sequence[Array]) -> float:
    """RMS of turns, angular minutes; NaN where none was made."""
    squares = [float(each @ each) for each in errors if np.all(np.isfinite(each))]
    return arcmin(math.sqrt(float(np.mean(squares)))) if squares else math.nan


class Several(NamedTuple):
    """Rides put together."""

    rides: int
    groups: int
    rms: float
    """Angular minutes."""
    expected: float
    """By the covariance."""


def several(found: Sequence[Figures], rides: int = TOGETHER) -> Several | None:
    """Put the longest rides of the work's scenario together, so many at a time."""
    longest = max((each.duration_s for each in found if each.kind == "work"), default=0.0)
    these = [each for each in found if each.kind == "work" and each.duration_s == longest]
    groups = [these[i : i + rides] for i in range(0, len(these) - rides + 1, rides)]
    if not groups:
        return None
    truth = C_vl(*np.radians(PSI_DEG)).T
    sums = [together([One(each.C_vb, each.covariance) for each in group]) for group in groups]
    return Several(
        rides,
        len(groups),
        _rms([off_rad(each.C_vb, truth) for each in sums]),
        arcmin(math.sqrt(float(np.mean([np.trace(each.covariance) for each in sums])))),
    )
