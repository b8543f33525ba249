"""The IMU: truth against numeric differentiation of position and attitude, errors against their
own statistics and an Allan deviation reckoned from its definition."""

from __future__ import annotations

import math
from functools import cache

import msgspec
import numpy as np
import pytest
from motions import motion_of
from numpy.typing import NDArray

from tramstream.attitude import C_vl
from tramstream.lines.line import built_in_line
from tramstream.simulation.imu import (
    STANDARD_GRAVITY_MPS2,
    Imu,
    ImuErrors,
    ImuScales,
    inertial,
    instability_density,
)
from tramstream.simulation.ride import Limits, Ride

Array = NDArray[np.float64]

GRAVITY = 9.81  # m/s²
NO_BIAS = (0.0, 0.0, 0.0)
STILL = ImuErrors(
    gyro_bias_radps=NO_BIAS,
    gyro_noise_radps_rthz=0.0,
    gyro_instability_radps=0.0,
    gyro_walk_radps2_rthz=0.0,
    accel_bias_mps2=NO_BIAS,
    accel_noise_mps2_rthz=0.0,
    accel_instability_mps2=0.0,
    accel_walk_mps3_rthz=0.0,
)
"""A sensor that only rounds."""
FINE = ImuScales(gyro_radps=1e-8, accel_mps2=1e-8, gyro_range_radps=10.0, accel_range_mps2=1e3)
CHI2_SIGMA = 4.0
"""Bound on a sample variance in deviations of its own: one failure in 16,000 for a fair one."""
BRISK = Limits(speed_mps=14.0, acceleration_mps2=1.2, jerk_mps3=0.8, lateral_mps2=0.8)


@cache
def ride(reverse: bool = False) -> Ride:
    return Ride(built_in_line(), BRISK, reverse)


def assert_variance(values: Array, variance: float) -> None:
    """Hold a sample variance of white noise to χ² with n − 1 degrees of freedom."""
    ratio = np.var(values, axis=0, ddof=1) / variance
    assert np.all(np.abs(ratio - 1) < CHI2_SIGMA * math.sqrt(2 / len(values)))


# Truth --------------------------------------------------------------------------------------------
def flat_position_l(of: Ride, time_s: Array) -> Array:
    """Position with the heights laid out flat: what a vehicle on a flat Earth would do."""
    p_l = of.position_l(time_s)
    p_l[:, 2] += np.sum(p_l[:, :2] ** 2, axis=1) / (2 * 6378137.0)
    return p_l


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (4.0, -0.7, 1.5)])
def test_specific_force_is_the_second_derivative_of_position_and_gravity(
    reverse: bool, lever: tuple[float, float, float]
) -> None:
    step_s = 1e-3
    time_s = np.arange(20.0, ride().duration_s, 0.37)

    def point_l(at: Array) -> Array:
        motion = ride(reverse).motion(at)
        turn = C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
        return flat_position_l(ride(reverse), at) + np.einsum("nvl,v->nl", turn, np.array(lever))

    motion = ride(reverse).motion(time_s)
    acceleration_l = (point_l(time_s + step_s) - 2 * point_l(time_s) + point_l(time_s - step_s)) / (
        step_s**2
    )
    turn = C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    expected = np.einsum("nvl,nl->nv", turn, acceleration_l + np.array([0.0, 0.0, GRAVITY]))
    f_v, _ = inertial(motion, GRAVITY, lever)
    # Positions are good to nanometres, over step² a few 1e-3; curvature, jerk and the bends of
    # grade and cant have corners, where the difference sees a mean of both sides.
    error = np.abs(f_v - expected)
    assert np.percentile(error, 98) < 5e-3
    assert np.max(error) < 0.05


@pytest.mark.parametrize("reverse", [False, True])
def test_angular_rate_is_the_turn_of_the_attitude(reverse: bool) -> None:
    step_s = 1e-3
    time_s = np.arange(20.0, ride().duration_s, 0.37)
    before, middle, after = (
        C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
        for motion in (ride(reverse).motion(time_s + shift) for shift in (-step_s, 0.0, step_s))
    )
    skew = -np.einsum("nij,nkj->nik", (after - before) / (2 * step_s), middle)
    _, omega_v = inertial(ride(reverse).motion(time_s), GRAVITY)
    turned = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    # Half of what the rate changes by within the step at the sharpest corners.
    np.testing.assert_allclose(omega_v, turned, atol=2e-4)
    assert np.max(np.abs(omega_v), axis=0).min() > 0.005


def test_specific_force_in_a_canted_curve_on_a_slope_is_theorys() -> None:
    # docs/theory.md, section 1.4: f_x = v̇ − g sinθ, f_y = v ω_z + g cosθ sinφ
    pitch, roll, speed, yaw_rate = -0.05, -0.03, 6.0, 0.08
    motion = motion_of(
        acceleration_mps2=0.4,
        speed_mps=speed,
        yaw_rate_radps=yaw_rate,
        pitch_rad=pitch,
        roll_rad=roll,
    )
    f_v, omega_v = inertial(motion, GRAVITY)
    assert f_v[0, 0] == pytest.approx(0.4 - GRAVITY * math.sin(pitch))
    assert f_v[0, 1] == pytest.approx(
        speed * omega_v[0, 2] + GRAVITY * math.cos(pitch) * math.sin(roll)
    )
    assert f_v[0, 0] > 0.4  # uphill the seat pushes forward
    assert f_v[0, 1] < speed * yaw_rate  # cant takes part of the sideways push


def test_reversed_vehicle_feels_forward_and_left_the_other_way_round() -> None:
    time_s = np.arange(0.0, 300.0, 0.5)
    forward = inertial(ride(False).motion(time_s), GRAVITY)
    backward = inertial(ride(True).motion(time_s), GRAVITY)
    turned = np.array([-1.0, -1.0, 1.0])
    for one, other in zip(forward, backward, strict=True):
        np.testing.assert_allclose(other, one * turned, atol=1e-12)


# Errors -------------------------------------------------------------------------------------------
def test_imu_without_noise_shows_the_truth_to_half_a_count() -> None:
    errors = ImuErrors(**{**_fields(STILL), "temperature_degc": 25.0})
    imu = Imu(np.random.default_rng(0), 2000.0, errors)
    f_b = np.array([[0.5, -0.3, GRAVITY], [-0.5, 0.0, -GRAVITY]])
    omega_b = np.array([[0.1, -0.2, 0.3], [0.0, 1.0, -1.0]])
    counts = imu.measure(f_b, omega_b)
    accel_unit = 0.25e-3 * STANDARD_GRAVITY_MPS2
    gyro_unit = math.radians(0.00625)
    np.testing.assert_allclose(counts.accel * accel_unit, f_b, atol=accel_unit / 2 * (1 + 1e-9))
    np.testing.assert_allclose(counts.gyro * gyro_unit, omega_b, atol=gyro_unit / 2 * (1 + 1e-9))
    np.testing.assert_array_equal(counts.temperature, [250, 250])


def _fields(errors: ImuErrors) -> dict[str, object]:
    return {name: getattr(errors, name) for name in errors.__struct_fields__}


def test_imu_saturates_at_sixteen_bits_or_at_its_range() -> None:
    measured = Imu(np.random.default_rng(0), 2000.0).measure([[1e3, -1e3, 0.0]], [[1e2, -1e2, 0.0]])
    np.testing.assert_array_equal(measured.accel[0, :2], [32767, -32768])
    np.testing.assert_array_equal(measured.gyro[0, :2], [32767, -32768])
    # kaspar2023: range 100 m/s² in steps of 100/2^16, 2.181661 rad/s in steps of 3.3289e-5
    scales = ImuScales(
        gyro_radps=3.3289e-5,
        accel_mps2=100 / 2**16,
        gyro_range_radps=2.181661,
        accel_range_mps2=100.0,
    )
    wide = Imu(np.random.default_rng(0), 100.0, STILL, scales)
    measured = wide.measure([[1e3, -1e3, 0.0]], [[1e2, -1e2, 0.0]])
    np.testing.assert_allclose(measured.accel[0] * scales.accel_mps2, [100.0, -100.0, 0.0])
    np.testing.assert_allclose(measured.gyro[0] * scales.gyro_radps, [2.18163, -2.18163, 0], 1e-5)


def test_scale_and_cross_axis_and_bias_are_those_of_the_errors() -> None:
    errors = ImuErrors(
        **{
            **_fields(STILL),
            "gyro_scale": (0.01, -0.02, 0.0),
            "gyro_cross_axis": 0.003,
            "accel_bias_mps2": (0.1, -0.2, 0.3),
            "accel_scale": (0.0, 0.0, -0.005),
        }
    )
    imu = Imu(np.random.default_rng(0), 100.0, errors, FINE)
    counts = imu.measure([[1.0, 2.0, 10.0]], [[0.1, 0.2, -0.3]])
    accel = [1.1, 1.8, 10 * 0.995 + 0.3]
    gyro = [0.101 + 0.003 * (0.2 - 0.3), 0.196 + 0.003 * (0.1 - 0.3), -0.3 + 0.003 * 0.3]
    np.testing.assert_allclose(counts.accel[0] * 1e-8, accel, atol=1e-8)
    np.testing.assert_allclose(counts.gyro[0] * 1e-8, gyro, atol=1e-8)


def test_temperature_changes_scale_and_bias_by_the_coefficients() -> None:
    errors = ImuErrors(
        **{
            **_fields(STILL),
            "accel_scale_per_degc": 1e-4,
            "accel_bias_mps2_per_degc": 2e-4,
            "temperature_start_degc": 15.0,
            "temperature_degc": 45.0,
            "temperature_time_s": 100.0,
        }
    )
    imu = Imu(np.random.default_rng(0), 1.0, errors, FINE)
    counts = imu.measure(np.full((301, 3), 10.0), np.zeros((301, 3)))
    warmer = 45.0 - 30.0 * np.exp(-np.arange(301) / 100.0) - 25.0
    expected = 10.0 * (1 + 1e-4 * warmer) + 2e-4 * warmer
    np.testing.assert_allclose(counts.accel[:, 0] * 1e-8, expected, atol=1e-8)
    np.testing.assert_array_equal(counts.temperature[[0, 300]], [150, 435])


def test_imu_noise_has_the_variance_of_its_density_and_the_mean_of_its_bias() -> None:
    count, rate_hz = 40_000, 2000.0
    errors = ImuErrors(
        **{
            **_fields(ImuErrors()),
            "gyro_instability_radps": 0.0,
            "gyro_walk_radps2_rthz": 0.0,
            "accel_instability_mps2": 0.0,
            "accel_walk_mps3_rthz": 0.0,
        }
    )
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


def test_means_of_a_second_are_as_noisy_at_any_rate() -> None:
    """So a ride at 100 Hz means what one at 2 kHz does; rounding adds little to either."""
    seconds = 400
    for rate_hz in (100.0, 2000.0):
        errors = ImuErrors(**{**_fields(STILL), "gyro_noise_radps_rthz": 0.00011344})
        imu = Imu(np.random.default_rng(3), rate_hz, errors)
        counts = imu.measure(*np.zeros((2, int(seconds * rate_hz), 3)))
        means = np.mean(counts.gyro.reshape(seconds, -1, 3), axis=1) * imu.scales.gyro_radps
        assert_variance(means, 0.00011344**2 + imu.scales.gyro_radps**2 / (12 * rate_hz))


def allan_deviation(rate: Array, period_s: float, tau_s: float) -> Array:
    """docs/theory.md, section 3.1, from integrated readings; over the columns of `rate`."""
    m = round(tau_s / period_s)
    angle = np.vstack([np.zeros((1, rate.shape[1])), np.cumsum(rate, axis=0)]) * period_s
    second = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    deviation: Array = np.sqrt(np.mean(second**2, axis=0) / (2 * tau_s**2))
    return deviation


def test_allan_deviation_shows_noise_instability_and_walk_where_they_belong() -> None:
    rate_hz, time_s = 10.0, 40_000.0
    count = int(rate_hz * time_s)
    zero = np.zeros((count, 3))
    noise, walk, flat, flat_s = 1e-3, 2e-5, 3e-4, 20.0

    def readings(**changes: float) -> Array:
        imu = Imu(
            np.random.default_rng(5), rate_hz, ImuErrors(**{**_fields(STILL), **changes}), FINE
        )
        return np.asarray(imu.measure(zero, zero).gyro * FINE.gyro_radps, dtype=float)

    # N: σ at 1 s on the slope −1/2. About 20,000 independent pairs at 1 s: 0.5 % of deviation.
    white = readings(gyro_noise_radps_rthz=noise)
    np.testing.assert_allclose(allan_deviation(white, 0.1, 1.0), noise, rtol=0.03)
    np.testing.assert_allclose(allan_deviation(white, 0.1, 4.0), noise / 2, rtol=0.05)
    # K: σ at 3 s on the slope +1/2.
    walked = readings(gyro_walk_radps2_rthz=walk)
    np.testing.assert_allclose(allan_deviation(walked, 0.1, 3.0), walk, rtol=0.05)
    np.testing.assert_allclose(allan_deviation(walked, 0.1, 12.0), 2 * walk, rtol=0.1)
    # B: the flat part is at 1.89 T_b, 0.664 B high; 1,000 pairs: 3 %.
    unstable = readings(gyro_instability_radps=flat, gyro_instability_time_s=flat_s)
    top = allan_deviation(unstable, 0.1, 1.89 * flat_s)
    np.testing.assert_allclose(top, 0.664 * flat, rtol=0.12)
    for tau_s in (flat_s / 8, 15 * flat_s):
        assert np.all(allan_deviation(unstable, 0.1, tau_s) < top)
    # Stationary variance S_b T_b / 2; 1,000 independent stretches.
    stationary = instability_density(flat, flat_s) * flat_s / 2
    np.testing.assert_allclose(np.var(unstable, axis=0), stationary, rtol=0.2)


def test_drift_between_its_drawn_points_does_not_depend_on_the_rate() -> None:
    errors = ImuErrors(**{**_fields(STILL), "gyro_walk_radps2_rthz": 1e-4})
    slow = Imu(np.random.default_rng(2), 10.0, errors, FINE)
    fast = Imu(np.random.default_rng(2), 200.0, errors, FINE)
    at_ten = slow.measure(np.zeros((100, 3)), np.zeros((100, 3))).gyro
    at_many = fast.measure(np.zeros((2000, 3)), np.zeros((2000, 3))).gyro
    np.testing.assert_array_equal(at_many[::20], at_ten)


def test_imu_counts_do_not_depend_on_the_cut_into_blocks() -> None:
    f_v, omega_v = inertial(ride().motion(np.arange(0.0, 5.0, 0.01)), GRAVITY)
    whole = Imu(np.random.default_rng(3), 100.0).measure(f_v, omega_v)
    imu = Imu(np.random.default_rng(3), 100.0)
    pieces = [imu.measure(f_v[a:b], omega_v[a:b]) for a, b in ((0, 1), (1, 200), (200, 500))]
    for column in (0, 1, 2):
        np.testing.assert_array_equal(whole[column], np.concatenate([p[column] for p in pieces]))


def test_same_seed_gives_the_same_counts_and_another_seed_others() -> None:
    zero = np.zeros((50, 3))
    first, again, other = (
        Imu(np.random.default_rng(seed), 2000.0).measure(zero, zero).gyro for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_gyroscope_reads_its_share_of_the_force() -> None:
    errors = msgspec.structs.replace(STILL, gyro_radps_per_mps2=(1e-4, 0.0, -2e-4))
    force = np.array([[1.0, 2.0, 9.8], [-3.0, 0.5, 9.7]])
    counts = Imu(np.random.default_rng(1), 100.0, errors, FINE).measure(force, np.zeros((2, 3)))
    expected = force * (1e-4, 0.0, -2e-4)
    np.testing.assert_allclose(counts.gyro * FINE.gyro_radps, expected, atol=FINE.gyro_radps)


def test_temperature_follows_its_course_whatever_the_cut_into_blocks() -> None:
    errors = msgspec.structs.replace(
        STILL, temperature_course=((0.0, -10.0), (2.0, 30.0), (3.0, 30.0)), gyro_scale_per_degc=0.0
    )
    fine = msgspec.structs.replace(FINE, temperature_degc=0.001)
    sensor = Imu(np.random.default_rng(1), 10.0, errors, fine)
    still = np.zeros((1, 3))
    read = [sensor.measure(still, still).temperature[0] * 0.001 for _ in range(40)]
    np.testing.assert_allclose(
        read, np.minimum(-10.0 + 20.0 * np.arange(40) / 10.0, 30.0), atol=0.001
    )
