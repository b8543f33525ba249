"""The work's estimator: its signs over all of SO(3), its model's derivatives, its scenario."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tramstream.analysis.melenovsky2023 import iekf
from tramstream.analysis.melenovsky2023.initial import (
    acceleration,
    circular_mean,
    heading,
    level,
    without_outliers,
)
from tramstream.analysis.studies import melenovsky2023 as study
from tramstream.analysis.studies.melenovsky2023 import Case
from tramstream.attitude import C_vl

Array = NDArray[np.float64]


@pytest.mark.parametrize("seed", range(20))
def test_both_algorithms_tell_any_mounting(seed: int) -> None:
    C_bv = Rotation.random(random_state=seed).as_matrix()
    standing = np.tile(C_bv @ [0.0, 0.0, 9.81], (20, 1))
    roll, pitch = level(standing)
    pressed = np.array([[1.0, 0.0, 9.81], [-0.8, 0.0, 9.81]] * 10) @ C_bv.T
    yaw = heading(pressed, np.array([True, False] * 10), roll, pitch)
    assert np.allclose(C_vl(roll, pitch, yaw), C_bv, atol=1e-9)


def test_outliers_at_180_degrees_are_those_of_the_residuals() -> None:
    good = np.radians([179.0, -179.0, 178.5, -178.5, 179.5, -179.5] * 5)
    kept = without_outliers(np.append(good, 0.3))
    assert len(kept) == len(good)
    assert abs(abs(circular_mean(kept)) - np.pi) < np.radians(0.1)


def test_acceleration_is_of_the_fourth_order() -> None:
    time_s = np.arange(0, 3, 0.1)
    found = acceleration(time_s**4, 0.1)
    assert np.allclose(found[2:-2], 4 * time_s[2:-2] ** 3, atol=1e-9)


def test_derivatives_of_the_model_are_those_of_finite_differences() -> None:
    x = np.random.default_rng(1).standard_normal(iekf.SIZE) * 0.3
    x[iekf.V] = 8.0
    step = np.random.default_rng(2).standard_normal(iekf.SIZE) * 1e-5
    moved = iekf.predicted(x + step, 0.1) - iekf.predicted(x, 0.1)
    assert np.allclose(iekf.transition(x, 0.1) @ step, moved, atol=1e-8)
    changed = iekf.measured(x + step, 9.81) - iekf.measured(x, 9.81)
    assert np.allclose(iekf.sensitivity(x, 9.81) @ step, changed, atol=1e-7)


def test_vehicle_at_a_stand_measures_gravity_in_the_case() -> None:
    x = np.zeros(iekf.SIZE)
    x[iekf.PSI : iekf.PSI + 3] = np.radians([30.0, 60.0, 90.0])
    force = iekf.measured(x, 9.81)[5:8]
    assert np.allclose(force, C_vl(*np.radians([30.0, 60.0, 90.0])) @ [0, 0, 9.81])


def test_process_noise_is_the_wiener_model_of_acceleration() -> None:
    tuning = iekf.Tuning(share_j=0.5)
    Q = iekf.process_noise(0.1, tuning, iekf.Sensors(0.2, 2e-3, 9e-4, 5e-5))
    block = Q[iekf.V : iekf.A + 1, iekf.V : iekf.A + 1]
    assert np.allclose(block, 0.05 * np.array([[0.01, 0.1], [0.1, 1.0]]))
    assert np.allclose(Q, Q.T)
    assert np.all(np.diag(Q)[iekf.PSI : iekf.PSI + 3] == 0)
    assert Q[iekf.Z_F, iekf.Z_F] == pytest.approx(9e-4**2 * 0.1)


@pytest.mark.study
def test_twenty_seeds_of_the_work_s_ride_are_at_the_bound() -> None:
    """Ten minutes; `tramstream reproduce melenovsky2023 --kind work` prints the same."""
    found = [each for seed in range(1, 21) for each in study.study(Case("work", seed))]
    last = study.overall(found)[-1]
    assert last.last < 1.2 * last.bound
    assert last.nees_low < last.nees < last.nees_high
    together = study.several(found)
    assert together is not None
    assert together.rms < 15.0


@pytest.mark.study
def test_hundred_mountings_over_all_turns_are_at_the_bound() -> None:
    cases = [Case("mountings", seed, (study.MOUNTING_S,)) for seed in range(1, 101)]
    (row,) = study.overall([each for case in cases for each in study.study(case)])
    assert row.worst < 4.0
    assert row.last < 1.3 * row.bound
    assert row.nees_low < row.nees < row.nees_high
