"""The aligner against the truth of simulated rides: any turn of a case, and what is not told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mounted import drawn, ride
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tramstream.analysis.mounting.align import align_ride, answer
from tramstream.analysis.mounting.coarse import coarse, trajectory
from tramstream.analysis.mounting.combine import One, together
from tramstream.analysis.mounting.drive import NODE_S, Drive, Inertial, no_fixes
from tramstream.analysis.mounting.known import Settings, known_of, white_noise
from tramstream.analysis.mounting.solve import moved, solve
from tramstream.analysis.mounting.states import MOUNTING, SIZE
from tramstream.analysis.mounting.theses import theses
from tramstream.analysis.studies.mounting_rides import draw, off_rad
from tramstream.attitude import C_vl

Array = NDArray[np.float64]
EXACT = Settings(cross_level_deg=0.0)
TURNS = [
    C_vl(*np.radians([30.0, 60.0, 90.0])),
    C_vl(*np.radians([20.0, 90.0, -50.0])),
    C_vl(*np.radians([170.0, -90.0, 10.0])),
    C_vl(*np.radians([180.0, -6.8, 185.0])),
]


def told(drive: Drive) -> str:
    """The verdict on one ride."""
    found = answer([align_ride("ride", drive, ride()[1], EXACT)])
    if found.verdict:
        assert np.all(np.isnan(found.C_bv)), "a figure beside a verdict"
    return found.verdict


@pytest.mark.parametrize("C_bv", TURNS)
def test_coarse_alignment_is_good_to_degrees_for_any_turn(C_bv: Array) -> None:
    ride_ = drawn(C_bv)
    found = coarse(ride_.drive)
    assert np.degrees(np.linalg.norm(off_rad(found.C_vb, C_bv.T))) < 3.0
    assert found.size == pytest.approx(1.0, abs=0.1)
    assert found.rate_size == pytest.approx(1.0, abs=0.1)
    assert found.handed > 0.9


@pytest.mark.parametrize("C_bv", TURNS[:3])
def test_mounting_is_found_within_its_deviation_for_any_turn(C_bv: Array) -> None:
    ride_ = drawn(C_bv)
    found = align_ride("ride", ride_.drive, ride()[1], EXACT)
    solution = found.solution
    assert solution is not None
    assert solution.settled
    off = off_rad(solution.C_vb, C_bv.T)
    assert off @ np.linalg.solve(solution.covariance, off) < 16.3  # χ² of 3, one in a thousand
    assert math.degrees(np.sqrt(np.trace(solution.covariance))) < 0.3
    assert all(each.holds for each in found.theses)


def test_passes_end_at_one_mounting_wherever_they_begin() -> None:
    """The search's steps are those of its model: a wrong derivative ends elsewhere, or nowhere."""
    ride_ = drawn(TURNS[0])
    drive = ride_.drive.cut(0, 1200)
    known = known_of(ride()[1], drive, EXACT)._replace(adapt=False)
    start = trajectory(drive, coarse(drive))
    shifted = np.zeros((drive.length, SIZE))
    shifted[:, MOUNTING : MOUNTING + 3] = np.radians([4.0, -3.0, 5.0])
    one, other = solve(drive, start, known), solve(drive, moved(start, shifted), known)
    assert one.settled
    assert other.settled
    assert np.linalg.norm(off_rad(one.C_vb, other.C_vb)) < 1e-5


def test_ride_in_reverse_is_found_and_tells_the_same_mounting() -> None:
    """The same ride seen by a case that is turned by 180°, in a part of it."""
    ride_ = drawn(TURNS[0])
    of, about = ride()[0], np.diag([-1.0, -1.0, 1.0])
    halts = np.flatnonzero(np.diff(of.standing.astype(int)) > 0)
    half = int(halts[len(halts) // 2 - 1]) + 20
    inertial = ride_.drive.inertial
    C_bv = TURNS[0]
    flip = C_bv @ about @ C_bv.T
    f_b, omega_b = inertial.f_b.copy(), inertial.omega_b.copy()
    f_b[half:], omega_b[half:] = f_b[half:] @ flip.T, omega_b[half:] @ flip.T
    drive = ride_.drive._replace(inertial=Inertial(f_b, omega_b))
    found = coarse(drive)
    moving = found.kinematics.moving
    back, forth = found.reverse[half:][moving[half:]], found.reverse[:half][moving[:half]]
    assert (back.all() and not forth.any()) or (forth.all() and not back.any())
    first = C_bv.T if back.all() else (C_bv @ about).T
    assert np.degrees(np.linalg.norm(off_rad(found.C_vb, first))) < 3.0


def test_left_handed_frame_gets_no_figure() -> None:
    ride_ = drawn(TURNS[0])
    swap = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    inertial = Inertial(*(each @ swap for each in ride_.drive.inertial))
    assert "left-handed" in told(ride_.drive._replace(inertial=inertial))


def test_reversed_gyroscope_gets_no_figure() -> None:
    ride_ = drawn(np.eye(3))
    omega_b = ride_.drive.inertial.omega_b * [1.0, 1.0, -1.0]
    inertial = ride_.drive.inertial._replace(omega_b=omega_b)
    assert "gyroscopes read" in told(ride_.drive._replace(inertial=inertial))


def test_vehicle_that_stands_gets_no_figure() -> None:
    ride_ = drawn(TURNS[0])
    first = int(np.argmin(ride_.drive.standing))
    assert "does not move" in told(ride_.drive.cut(0, first))


def test_record_without_fixes_gets_no_figure() -> None:
    assert "no fixes" in told(drawn(TURNS[0]).drive._replace(fixes=no_fixes()))


@pytest.mark.parametrize("turn_deg", [[0.0, 4.0, 0.0], [0.0, 0.0, 25.0]])
def test_case_that_is_moved_half_way_is_dated(turn_deg: list[float]) -> None:
    ride_ = drawn(TURNS[0])
    half = ride_.drive.length // 2
    turn = C_vl(*np.radians(turn_deg))
    f_b, omega_b = (each.copy() for each in ride_.drive.inertial)
    f_b[half:], omega_b[half:] = f_b[half:] @ turn.T, omega_b[half:] @ turn.T
    drive = ride_.drive._replace(inertial=Inertial(f_b, omega_b))
    found = align_ride("ride", drive, ride()[1], EXACT)
    assert found.moved is not None
    assert found.moved.at_s == pytest.approx(half * NODE_S, abs=10.0)
    assert "sits otherwise" in answer([found]).verdict


def test_ride_that_is_as_it_should_be_is_not_called_moved() -> None:
    assert told(drawn(TURNS[1], seed=2).drive) == ""


@pytest.mark.parametrize("seed", range(3))
def test_straight_ride_is_not_called_moved(seed: int) -> None:
    """There no curve says where forward is, and the row that curves would fill is chance."""
    world, vehicle = ride("| 500 | 700 | 500 |")
    drive = draw(world, TURNS[0], np.random.default_rng(seed)).drive
    assert align_ride("ride", drive, vehicle, EXACT).moved is None


def test_rides_together_are_weighed_by_their_information() -> None:
    truth = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    rng = np.random.default_rng(3)
    rides, stds = [], np.array([[1e-3, 5e-3, 2e-3], [4e-3, 1e-3, 2e-3], [2e-3, 2e-3, 1e-2]])
    for std in stds:
        off = Rotation.from_rotvec(std * rng.standard_normal(3)).as_matrix()
        rides.append(One(off @ truth, np.diag(std**2)))
    found = together(rides)
    assert np.allclose(np.diag(found.covariance), 1 / np.sum(1 / stds**2, axis=0))
    off = off_rad(found.C_vb, truth)
    assert np.all(np.abs(off) < 4 * np.sqrt(np.diag(found.covariance)))
    assert found.chance > 1e-3
    other = Rotation.from_rotvec([0.0, 0.05, 0.0]).as_matrix() @ truth
    assert together([*rides, One(other, rides[0].covariance)]).chance < 1e-6


def test_theses_fail_for_a_wrong_mounting() -> None:
    ride_ = drawn(TURNS[0])
    found = align_ride("ride", ride_.drive, ride()[1], EXACT)
    assert found.solution is not None
    turned = C_vl(*np.radians([0.0, 0.0, 20.0])) @ found.solution.C_vb
    wrong = found.solution._replace(C_vb=turned)
    failed = [each.text for each in theses(ride_.drive, found.coarse, wrong) if not each.holds]
    assert "speeding up presses to no side" in failed


def test_white_noise_is_that_of_the_readings_where_it_is_more() -> None:
    readings = np.random.default_rng(0).standard_normal((5000, 3)) * [1.0, 2.0, 0.0]
    found = white_noise(readings, 0.1, NODE_S)
    assert found == pytest.approx([math.sqrt(NODE_S), 2 * math.sqrt(NODE_S), 0.1], rel=0.1)
