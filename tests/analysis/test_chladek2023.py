"""chladek2023: Newton's law, filterpy beside the batch, least squares in full, and the bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tramstream.analysis.chladek2023 import baselines, bound, distance_filter, fusion, observer
from tramstream.analysis.chladek2023.bound import Ground, bound_rad, ground_of, wiener_rad
from tramstream.analysis.chladek2023.fusion import KNOT_M, Information
from tramstream.analysis.chladek2023.ride import (
    CELL_M,
    FORCE_N,
    GRAVITY_MPS2,
    REFERENCE_MPS,
    STEP_S,
    VEHICLE,
    Array,
    Profile,
    Rides,
    Waves,
    drawn_waves,
    drive,
    in_cells,
    one_wave,
    profile_of,
    rmse,
)
from tramstream.analysis.studies import chladek2023 as study

HILLS = Ground(std_rad=0.016, smooth_m=75.0)
"""Much like line 7."""


def hills(length_m: float, seed: int, ground: Ground = HILLS) -> Profile:
    """A profile drawn from its covariance, at knots and straight between."""
    knots = np.arange(0.0, length_m + KNOT_M, KNOT_M)
    K = ground.covariance(knots[:, None] - knots[None, :])
    root = np.linalg.cholesky(K + 1e-9 * ground.std_rad**2 * np.eye(len(knots)))
    slope = root @ np.random.default_rng(seed).normal(size=len(knots))
    way = np.arange(0.0, length_m + CELL_M / 2, CELL_M)
    return profile_of("hills", way, np.interp(way, knots, slope))


def even(slope_rad: float, length_m: float = 1000.0) -> Profile:
    way = np.arange(0.0, length_m + CELL_M / 2, CELL_M)
    return profile_of("even", way, np.full(len(way), slope_rad))


# Rides --------------------------------------------------------------------------------------------
def test_work_of_the_motor_is_kinetic_energy_height_and_resistance() -> None:
    profile = hills(1500.0, seed=1)
    rides = in_cells(profile, drive(profile, one_wave()), None)
    speed, force = rides.speed_mps[0], rides.force_n[0]
    mass = VEHICLE.mass_kg
    drag_n = mass * VEHICLE.drag_per_m * (speed[1:] ** 2 + speed[:-1] ** 2) / 2
    rolling_n = mass * GRAVITY_MPS2 * VEHICLE.rolling
    lost = np.sum((drag_n + rolling_n) * CELL_M)
    kinetic = 0.5 * mass * (speed[-1] ** 2 - speed[0] ** 2)
    climbed = mass * GRAVITY_MPS2 * (profile.height_m[-1] - profile.height_m[0])
    # The driver's brake and motor do some 1e8 J on the way.
    assert np.sum(force * CELL_M) == pytest.approx(kinetic + climbed + lost, abs=3e5)
    assert np.sum(np.abs(force) * CELL_M) > 1e8


def test_force_stays_within_what_brakes_and_motors_can() -> None:
    driven = drive(even(0.03), drawn_waves(4, np.random.default_rng(1)))
    assert driven.force_n.min() == FORCE_N[0]
    assert driven.force_n.max() == FORCE_N[1]


def test_driver_without_a_wave_keeps_the_reference_on_a_slope() -> None:
    driven = drive(even(0.03), Waves(np.zeros(1), np.full(1, 10.0)))
    np.testing.assert_allclose(driven.speed_mps, REFERENCE_MPS, atol=0.05)
    climbing = VEHICLE.mass_kg * GRAVITY_MPS2 * (np.sin(0.03) + VEHICLE.rolling)
    drag = VEHICLE.mass_kg * VEHICLE.drag_per_m * REFERENCE_MPS**2
    assert driven.force_n[-2, 0] == pytest.approx(climbing + drag, rel=0.01)


def test_rolling_resistance_and_drag_act_against_the_motion() -> None:
    speed, nothing = np.array([-10.0, 0.0, 10.0]), np.zeros(3)
    change = VEHICLE.acceleration_mps2(nothing, speed, nothing)
    slowing = VEHICLE.drag_per_m * 100.0 + GRAVITY_MPS2 * VEHICLE.rolling
    np.testing.assert_allclose(change, [slowing, 0.0, -slowing])


# Estimators of the work ---------------------------------------------------------------------------
def test_observer_has_the_gain_and_the_poles_of_the_work() -> None:
    L = observer.gain()
    np.testing.assert_allclose(L, [1.3, -0.0428], atol=1e-4)
    A = np.array([[-L[0], -GRAVITY_MPS2], [-L[1], 0.0]])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(A)), [-0.7, -0.6], atol=1e-9)


def test_observer_settles_at_an_even_slope() -> None:
    driven = drive(even(-0.02), one_wave())
    said = observer.observe(driven.speed_mps[:, 0], driven.force_n[:, 0])
    assert said[0] == 0.0
    np.testing.assert_allclose(said[-200:], -0.02, atol=1e-4)


def test_jacobian_of_the_distance_filter_is_the_difference_of_its_model() -> None:
    step = 1e-6
    ekf = distance_filter.DistanceFilter(22.0, 3.0, distance_filter.SINGLE_R)
    ekf.x = np.array([[22.0], [3.0], [0.03]])
    columns = []
    for row in range(3):
        ends = []
        for side in (step, -step):
            moved = distance_filter.DistanceFilter(22.0, 3.0, distance_filter.SINGLE_R)
            moved.x = ekf.x.copy()
            moved.x[row] += side
            moved.predict(60_000.0)
            ends.append(moved.x.ravel())
        columns.append((ends[0] - ends[1]) / (2 * step))
    ekf.predict(60_000.0)
    np.testing.assert_allclose(ekf.F, np.stack(columns, axis=1), atol=1e-7)


@pytest.mark.parametrize("R", [distance_filter.SINGLE_R, distance_filter.SEVERAL_R])
def test_filters_side_by_side_are_filterpys(R: tuple[float, float]) -> None:
    profile, rng = hills(400.0, seed=2), np.random.default_rng(3)
    rides = in_cells(profile, drive(profile, drawn_waves(3, rng)), rng)
    together = distance_filter.filtered_together(rides, R)
    for ride in range(3):
        alone = distance_filter.filtered(rides.take(slice(ride, ride + 1)), R)
        np.testing.assert_allclose(together[ride], alone, atol=1e-12)


def test_mean_of_many_rides_is_as_late_as_each_of_them_without_noise() -> None:
    profile, rng = hills(2000.0, seed=4), np.random.default_rng(5)
    driven = drive(profile, drawn_waves(40, rng))
    R = distance_filter.SEVERAL_R
    clean = distance_filter.filtered_together(in_cells(profile, driven, None), R).mean(axis=0)
    noisy = distance_filter.filtered_together(in_cells(profile, driven, rng), R).mean(axis=0)
    plateau = rmse(clean, profile.grade_rad)
    assert rmse(noisy, profile.grade_rad) < 1.6 * plateau
    late_m = 15.0
    shifted = np.interp(profile.way_m - late_m, profile.way_m, profile.grade_rad)
    assert rmse(clean, shifted) < 0.5 * plateau


# Ours ---------------------------------------------------------------------------------------------
def dense(known: Information, density: float) -> tuple[Array, Array]:
    """Heights and deviation of sin α of the knots by least squares with full matrices."""
    knots = len(known.diagonal)
    J = np.diag(known.diagonal) + np.diag(known.beside, 1) + np.diag(known.beside, -1)
    D = np.diff(np.eye(knots), n=4, axis=0)
    covariance = np.linalg.inv(J + D.T @ D / (density * KNOT_M**7))
    rise = np.diff(np.eye(knots), axis=0) / KNOT_M
    return covariance @ known.vector, np.sqrt(np.diag(rise @ covariance @ rise.T))


def measured(profile: Profile, count: int, seed: int) -> Rides:
    rng = np.random.default_rng(seed)
    return in_cells(profile, drive(profile, drawn_waves(count, rng)), rng)


def test_band_is_least_squares_in_full() -> None:
    known = fusion.together(measured(hills(600.0, seed=6), 2, seed=7))
    found = fusion.smooth(known)
    height, std = dense(known, found.density)
    np.testing.assert_allclose(found.height_m, height, atol=1e-5)
    np.testing.assert_allclose(found.rise_std, std, rtol=1e-4)


def test_information_of_heights_and_slopes_is_that_of_their_rows() -> None:
    rng = np.random.default_rng(8)
    edges = 23  # the last knot lies beyond
    height, rise, std = rng.normal(size=edges), rng.normal(size=edges - 1), np.full(edges - 1, 0.1)
    known = fusion.of_heights(height) + fusion.of_rises(rise, std)
    knots = len(known.diagonal)
    at = np.arange(edges) / fusion.KNOT_CELLS
    straight = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(knots)))
    cell = np.arange(edges - 1) // fusion.KNOT_CELLS
    steps = (np.eye(knots)[cell + 1] - np.eye(knots)[cell]) / KNOT_M
    H = np.concatenate([straight, steps / 0.1])
    z = np.concatenate([height, rise / 0.1])
    J = H.T @ H
    np.testing.assert_allclose(known.diagonal, np.diag(J), atol=1e-12)
    np.testing.assert_allclose(known.beside, np.diag(J, 1), atol=1e-12)
    np.testing.assert_allclose(known.vector, H.T @ z, atol=1e-12)


def test_rides_add_up_in_any_order() -> None:
    rides = measured(hills(500.0, seed=9), 3, seed=10)
    one, two, three = (fusion.of_ride(rides, number) for number in range(3))
    for left, right in zip((one + two) + three, three + (two + one), strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-12)


def test_energy_knows_the_speed_that_the_wheels_lose() -> None:
    profile = hills(8000.0, seed=11)
    rides = measured(profile, 1, seed=12)
    lost = np.abs(rides.measured_speed_mps - rides.speed_mps).max()
    assert lost > 2.0, "the measured speed walks away"
    found = fusion.true_speed_mps(REFERENCE_MPS, rides.force_n[0], profile.height_m)
    np.testing.assert_allclose(found, rides.speed_mps[0], atol=0.05)


def test_standing_is_no_singularity() -> None:
    profile = even(0.0, 200.0)
    cells = len(profile.way_m) - 1
    braking = np.full(cells, -VEHICLE.mass_kg * 100.0 / (2 * 50.0 * 1.0))  # 10 m/s to 0 within 50 m
    still = np.where(np.arange(cells) * CELL_M < 50.0, braking, 0.0)
    speed = fusion.true_speed_mps(10.0, still, profile.height_m)
    assert speed[-1] == 0.0
    rides = Rides(speed[None], still[None], speed[None], profile.height_m[None])
    found = fusion.smooth(fusion.of_ride(rides, 0))
    assert np.isfinite(found.rise_std).all()
    np.testing.assert_allclose(found.rise, 0.0, atol=3e-3)


# The bound ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("rides", [1, 10])
def test_bound_of_a_long_route_is_wieners_integral(rides: int) -> None:
    profile = even(0.0, 8000.0)
    speed = np.full((rides, len(profile.way_m)), REFERENCE_MPS)
    steady = Rides(speed, speed[:, 1:], speed, speed)
    whole = wiener_rad(HILLS, REFERENCE_MPS, rides)
    # Ends know less than the middle: some 100 m of each see only one side.
    assert whole < bound_rad(HILLS, steady) < 1.06 * whole


def test_ground_of_profiles_drawn_from_one_is_that_one() -> None:
    found = [ground_of(hills(6_000.0, seed=40 + seed)) for seed in range(8)]
    # 48 km are worth some 180 independent slopes: 5 %.
    std = np.sqrt(np.mean([each.std_rad**2 for each in found]))
    assert std == pytest.approx(HILLS.std_rad, rel=0.15)
    smooth = np.mean([each.smooth_m for each in found])
    assert smooth == pytest.approx(HILLS.smooth_m, rel=0.1)


def test_our_fusion_is_near_the_bound_and_not_below_it() -> None:
    ratios, nees = [], []
    for seed in range(4):
        profile = hills(3400.0, seed=20 + seed)
        rides = measured(profile, 10, seed=30 + seed)
        found = fusion.smooth(fusion.together(rides))
        error = rmse(fusion.grade_rad(found, len(profile.way_m)), profile.grade_rad)
        ratios.append(error / bound_rad(HILLS, rides))
        off = found.rise - np.diff(fusion.knots_of(profile.height_m)) / KNOT_M
        nees.append(np.mean((off / found.rise_std) ** 2))
    assert 0.9 < np.mean(ratios) < study.OVER_BOUND
    assert 0.5 < np.mean(nees) < 2.0


def test_bound_sinks_with_rides_and_with_what_they_know() -> None:
    rides = measured(hills(800.0, seed=14), 4, seed=15)
    first = bound_rad(HILLS, rides.take(slice(0, 1)))
    assert bound_rad(HILLS, rides) < first < HILLS.std_rad
    assert bound.of_heights(5, 2) == pytest.approx(2 * bound.of_heights(5, 1))


# Baselines and the study --------------------------------------------------------------------------
def test_receivers_velocity_errs_by_its_noise_over_the_speed() -> None:
    profile = even(0.02, 20_000.0)
    driven = drive(profile, Waves(np.zeros(1), np.full(1, 10.0)))
    found, truth = baselines.velocity_ratio(profile, driven, np.random.default_rng(16))
    assert rmse(found, truth) == pytest.approx(0.1 / REFERENCE_MPS, rel=0.05)


def test_complementary_filter_takes_a_bias_for_a_slope() -> None:
    profile = even(0.0, 6000.0)
    driven = drive(profile, Waves(np.zeros(1), np.full(1, 10.0)))
    both = [
        baselines.complementary(profile, driven, np.random.default_rng(17), biased)[0]
        for biased in (True, False)
    ]
    settled = round(6 * baselines.SETTLING_S / STEP_S)
    difference = (both[0] - both[1])[settled:]
    np.testing.assert_allclose(difference, 0.1 / GRAVITY_MPS2, rtol=0.01)


@pytest.mark.realdata
def test_profile_1_passes_what_it_is_judged_by(data_dir: Path) -> None:
    """Of 60 rides instead of 300; `tramstream reproduce chladek2023` has them all."""
    figures = study.study(
        str(data_dir / "maps" / "prague" / "lines_7_20.geojson"), 0, seed=2023, rides=60
    )
    failed = [each for each in study.checks(figures) if not each.passed]
    assert not failed
    averaged = figures.of("averaged EKF")
    assert averaged.clean_rad is not None
    assert averaged.rmse_rad < 1.3 * averaged.clean_rad, "what is left is the lag"
