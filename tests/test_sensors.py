"""Sensors against the truth they are fed, and their noise against its own statistics."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.line import Line, Segment, built_in_line
from tramstream.ride import Motion, Ride
from tramstream.sensors import (
    STANDARD_GRAVITY_MPS2,
    Axle,
    Gnss,
    GnssErrors,
    Imu,
    ImuErrors,
    Wheels,
    antenna_motion,
    inertial,
    motor_force_n,
)

GRAVITY = 9.81  # m/s²
NO_BIAS = (0.0, 0.0, 0.0)
CHI2_SIGMA = 4.0
"""Bound on a sample variance in deviations of its own: one failure in 16,000 for a fair one."""


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def standing(count: int) -> Motion:
    zero = np.zeros(count)
    return Motion(zero, zero, zero, zero, zero, np.ones(count, dtype=bool))


def assert_variance(values: NDArray[np.float64], variance: float) -> None:
    """Hold a sample variance of white noise to χ² with n − 1 degrees of freedom."""
    count = len(values)
    ratio = np.var(values, axis=0, ddof=1) / variance
    assert np.all(np.abs(ratio - 1) < CHI2_SIGMA * math.sqrt(2 / (count - 1)))


def test_specific_force_is_motion_plus_gravity() -> None:
    motion = ride().motion(np.arange(0.0, 60.0, 0.1))
    f_v, omega_v = inertial(motion, GRAVITY)
    np.testing.assert_array_equal(f_v[:, 0], motion.acceleration_mps2)
    curvature = ride().line.curvature_per_m(motion.arc_length_m)
    np.testing.assert_allclose(f_v[:, 1], motion.speed_mps**2 * curvature, atol=1e-12)
    assert np.all(f_v[:, 2] == GRAVITY)
    assert not np.any(omega_v[:, :2])
    turned = np.sum((omega_v[1:, 2] + omega_v[:-1, 2]) / 2 * 0.1)
    assert turned == pytest.approx(motion.yaw_rad[-1] - motion.yaw_rad[0], abs=1e-4)


def test_imu_without_noise_shows_the_truth_to_half_a_count() -> None:
    errors = ImuErrors(NO_BIAS, 0.0, NO_BIAS, 0.0, temperature_degc=31.4)
    imu = Imu(np.random.default_rng(0), 2000.0, errors)
    f_b = np.array([[0.5, -0.3, GRAVITY], [-0.5, 0.0, -GRAVITY]])
    omega_b = np.array([[0.1, -0.2, 0.3], [0.0, 1.0, -1.0]])
    counts = imu.measure(f_b, omega_b)
    accel_unit = 0.25e-3 * STANDARD_GRAVITY_MPS2
    gyro_unit = math.radians(0.00625)
    np.testing.assert_allclose(counts.accel * accel_unit, f_b, atol=accel_unit / 2 * (1 + 1e-9))
    np.testing.assert_allclose(counts.gyro * gyro_unit, omega_b, atol=gyro_unit / 2 * (1 + 1e-9))
    np.testing.assert_array_equal(counts.temperature, [314, 314])


def test_imu_saturates_at_sixteen_bits() -> None:
    imu = Imu(np.random.default_rng(0), 2000.0)
    counts = imu.measure([[1000.0, -1000.0, 0.0]], [[100.0, -100.0, 0.0]])
    np.testing.assert_array_equal(counts.accel[0, :2], [32767, -32768])
    np.testing.assert_array_equal(counts.gyro[0, :2], [32767, -32768])


def test_imu_noise_has_the_variance_of_its_density_and_the_mean_of_its_bias() -> None:
    count, rate_hz = 40_000, 2000.0
    errors = ImuErrors()
    imu = Imu(np.random.default_rng(7), rate_hz, errors)
    counts = imu.measure(np.zeros((count, 3)), np.zeros((count, 3)))
    for values, unit, density, bias in (
        (counts.gyro, imu.scales.gyro_radps, errors.gyro_noise_radps_rthz, 0.0052359),
        (counts.accel, imu.scales.accel_mps2, errors.accel_noise_mps2_rthz, 0.1),
    ):
        variance = density**2 * rate_hz + unit**2 / 12  # rounding adds a twelfth of a count²
        assert_variance(np.asarray(values * unit, dtype=float), variance)
        mean = np.mean(values * unit, axis=0)
        np.testing.assert_allclose(mean, bias, atol=CHI2_SIGMA * math.sqrt(variance / count))


def test_imu_counts_do_not_depend_on_the_cut_into_blocks() -> None:
    f_v, omega_v = inertial(ride().motion(np.arange(0.0, 5.0, 0.01)), GRAVITY)
    whole = Imu(np.random.default_rng(3), 100.0).measure(f_v, omega_v)
    imu = Imu(np.random.default_rng(3), 100.0)
    pieces = [imu.measure(f_v[a:b], omega_v[a:b]) for a, b in ((0, 1), (1, 200), (200, 500))]
    for column in (0, 1, 2):
        np.testing.assert_array_equal(whole[column], np.concatenate([p[column] for p in pieces]))


@pytest.mark.parametrize("radius_error_m", [(0.0, 0.0), (0.012, 0.016)])
def test_pulses_add_up_to_the_way_of_each_wheel(radius_error_m: tuple[float, float]) -> None:
    axle = Axle(radius_error_m=radius_error_m)
    motion = ride().motion(np.arange(0.0, ride().duration_s + 1, 0.02))
    pulses = Wheels(axle).measure(motion)
    assert np.min(pulses) >= 0
    assert np.max(pulses) < 65536
    yaw = motion.yaw_rad - motion.yaw_rad[0]
    for column, side in ((0, -1.0), (1, 1.0)):
        way = motion.arc_length_m + side * yaw * axle.track_m / 2
        scale = axle.m_per_pulse * (1 + radius_error_m[column] / axle.radius_m)
        behind = way - np.cumsum(pulses[:, column]) * scale
        assert np.min(behind) > -1e-8
        assert np.max(behind) < scale + 1e-8


def test_mean_of_both_wheels_is_the_arc_length_to_one_pulse() -> None:
    motion = ride().motion(np.arange(0.0, ride().duration_s + 1, 0.02))
    pulses = Wheels().measure(motion)
    travelled = np.cumsum(pulses.mean(axis=1)) * Axle().m_per_pulse
    np.testing.assert_allclose(travelled, motion.arc_length_m, atol=Axle().m_per_pulse)


def test_pulses_of_a_turning_wheel_follow_the_speed_difference() -> None:
    # theory.md section 2: c = (v ∓ ω_z l/2) k, here per 0.02 s on a circle of 20 m at 1.4 m/s
    speed, radius, step_s = 1.4, 20.0, 0.02
    time = np.arange(0.0, 10.0, step_s)
    one = np.ones_like(time)
    motion = Motion(
        speed * time, speed * one, 0 * one, speed / radius * time, speed / radius * one, one < 0
    )
    pulses = Wheels().measure(motion)[1:]
    for column, side in ((0, -1.0), (1, 1.0)):
        expected = speed * (1 + side * 1.435 / 2 / radius) * step_s / Axle().m_per_pulse
        assert np.mean(pulses[:, column]) == pytest.approx(expected, abs=1 / len(pulses))


def test_pulses_do_not_depend_on_the_cut_into_blocks() -> None:
    time = np.arange(0.0, 40.0, 0.02)
    whole = Wheels().measure(ride().motion(time))
    wheels = Wheels()
    pieces = [wheels.measure(ride().motion(part)) for part in np.split(time, [1, 7, 900])]
    np.testing.assert_array_equal(whole, np.concatenate(pieces))


def test_motor_force_is_newtons_law_with_chladeks_resistance() -> None:
    one = np.ones(1)
    motion = Motion(one, 10 * one, 0.5 * one, one, 0 * one, one < 0)
    expected = 150_000 * 0.5 + 0.5 * 1.05 * 14.484 * 1.201 * 100 + 150_000 * 9.80665 * 0.00005
    assert motor_force_n(motion) == pytest.approx(expected)
    assert not np.any(motor_force_n(standing(3)))


def test_motor_force_stays_within_chladeks_motor() -> None:
    motion = ride().motion(np.arange(0.0, ride().duration_s, 0.1))
    force = motor_force_n(motion)
    assert np.min(force) > -1.2966e5
    assert np.max(force) < 1.4314e5


def test_gnss_error_is_stationary_with_its_deviation_and_decay() -> None:
    count, rate_hz = 200_000, 1.0
    gnss = Gnss(np.random.default_rng(11), rate_hz)
    p_l = gnss.measure(np.zeros((count, 3)), standing(count)).p_l
    std = np.array([0.5, 0.5, 1.0])
    # Correlated samples: 1 of (1 + φ²)/(1 − φ²) counts for the variance.
    effective = count * (1 - 0.95**2) / (1 + 0.95**2)
    ratio = np.var(p_l, axis=0) / std**2
    assert np.all(np.abs(ratio - 1) < CHI2_SIGMA * math.sqrt(2 / effective))
    drive = p_l[1:] - 0.95 * p_l[:-1]
    assert_variance(np.asarray(drive / std), 1 - 0.95**2)


def test_gnss_decay_is_per_second_at_any_rate() -> None:
    count = 200_000
    gnss = Gnss(np.random.default_rng(12), 5.0)
    p_l = gnss.measure(np.zeros((count, 3)), standing(count)).p_l
    later = np.mean(p_l[5:] * p_l[:-5], axis=0) / np.mean(p_l**2, axis=0)
    np.testing.assert_allclose(later, 0.95, atol=0.01)  # its own deviation is about 0.001


def test_gnss_velocity_is_the_truth_with_white_noise() -> None:
    time = np.arange(0.0, 2000.0, 0.2)
    motion = ride().motion(time)
    fixes = Gnss(np.random.default_rng(13), 5.0).measure(ride().position_l(time), motion)
    truth = np.stack(
        [
            motion.speed_mps * np.cos(motion.yaw_rad),
            motion.speed_mps * np.sin(motion.yaw_rad),
            np.zeros(len(time)),
        ],
        axis=1,
    )
    assert_variance(fixes.vel_l - truth, 0.05**2)


def test_gnss_fixes_do_not_depend_on_the_cut_into_blocks() -> None:
    time = np.arange(0.0, 60.0, 0.2)
    p_l, motion = ride().position_l(time), ride().motion(time)
    whole = Gnss(np.random.default_rng(5), 5.0).measure(p_l, motion)
    gnss = Gnss(np.random.default_rng(5), 5.0)
    pieces = [
        gnss.measure(p_l[part], ride().motion(time[part]))
        for part in (slice(0, 1), slice(1, 100), slice(100, 300))
    ]
    np.testing.assert_array_equal(whole.p_l, np.concatenate([piece.p_l for piece in pieces]))
    np.testing.assert_array_equal(whole.vel_l, np.concatenate([piece.vel_l for piece in pieces]))


def test_antenna_velocity_is_the_derivative_of_its_position() -> None:
    lever = np.array([3.0, -0.5, 2.8])
    time, step_s = np.arange(5.0, 45.0, 0.1), 1e-4
    _, velocity = antenna_motion(ride().position_l(time), ride().motion(time), lever)
    ends = [
        antenna_motion(ride().position_l(t), ride().motion(t), lever)[0]
        for t in (time - step_s, time + step_s)
    ]
    derivative = (ends[1] - ends[0]) / (2 * step_s)
    np.testing.assert_allclose(velocity[:, :2], derivative[:, :2], atol=1e-6)


def test_antenna_is_its_lever_arm_away_from_the_origin() -> None:
    level = LocalLevel.at_deg(50.0, 14.0, 0.0)
    north = Ride(Line([Segment(100.0)], [0.0, 100.0], level, yaw_start_rad=math.pi / 2))
    errors = GnssErrors(0.0, 0.0, velocity_std_mps=0.0)
    gnss = Gnss(np.random.default_rng(0), 1.0, errors, p_va_v=(2.0, 1.0, 3.0))
    fix = gnss.measure(north.position_l([0.0]), north.motion([0.0]))
    np.testing.assert_allclose(fix.p_l, [[-1.0, 2.0, 3.0]], atol=1e-12)


def test_same_seed_gives_the_same_counts_and_another_seed_others() -> None:
    zero = np.zeros((50, 3))
    first, again, other = (
        Imu(np.random.default_rng(seed), 2000.0).measure(zero, zero).gyro for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)
