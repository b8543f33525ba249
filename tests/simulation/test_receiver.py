"""GNSS fixes against the truth, and their errors against their own statistics."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from motions import motion_of, standing
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Segment, built_in_line
from tramstream.simulation.receiver import Correlated, Gnss, GnssErrors, antenna_motion
from tramstream.simulation.ride import Ride

CHI2_SIGMA = 4.0
"""Bound on a sample variance in deviations of its own: one failure in 16,000 for a fair one."""
NO_ERROR = GnssErrors(horizontal_std_m=0.0, vertical_std_m=0.0, velocity_std_mps=0.0)


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def assert_variance(values: NDArray[np.float64], variance: float) -> None:
    """Hold a sample variance of white noise to χ² with n − 1 degrees of freedom."""
    ratio = np.var(values, axis=0, ddof=1) / variance
    assert np.all(np.abs(ratio - 1) < CHI2_SIGMA * math.sqrt(2 / len(values)))


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
    level = motion.speed_mps * np.cos(motion.pitch_rad)
    truth = np.stack(
        [
            level * np.cos(motion.yaw_rad),
            level * np.sin(motion.yaw_rad),
            -motion.speed_mps * np.sin(motion.pitch_rad),
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
    time, step_s = np.arange(5.0, 900.0, 0.7), 1e-4
    _, velocity = antenna_motion(ride().position_l(time), ride().motion(time), lever)
    ends = [
        antenna_motion(ride().position_l(t), ride().motion(t), lever)[0]
        for t in (time - step_s, time + step_s)
    ]
    derivative = (ends[1] - ends[0]) / (2 * step_s)
    np.testing.assert_allclose(velocity[:, :2], derivative[:, :2], atol=1e-5)
    # Heights follow the Earth: 5 m/s at 3 km from the origin sink with 2 mm/s.
    np.testing.assert_allclose(velocity[:, 2], derivative[:, 2], atol=8e-3)


def test_antenna_is_its_lever_arm_away_from_the_origin() -> None:
    level = LocalLevel.at_deg(50.0, 14.0, 0.0)
    north = Ride(Line([Segment(100.0)], [0.0, 100.0], level, yaw_start_rad=math.pi / 2))
    errors = GnssErrors(horizontal_std_m=0.0, vertical_std_m=0.0, velocity_std_mps=0.0)
    gnss = Gnss(np.random.default_rng(0), 1.0, errors, p_va_v=(2.0, 1.0, 3.0))
    fix = gnss.measure(north.position_l([0.0]), north.motion([0.0]))
    np.testing.assert_allclose(fix.p_l, [[-1.0, 2.0, 3.0]], atol=1e-12)


def test_white_noise_comes_on_top_of_the_correlated_error() -> None:
    errors = GnssErrors(
        horizontal_std_m=0.0,
        vertical_std_m=0.0,
        white_horizontal_std_m=0.3,
        white_vertical_std_m=0.6,
    )
    p_l = Gnss(np.random.default_rng(4), 5.0, errors).measure(
        np.zeros((20_000, 3)), standing(20_000)
    )
    assert_variance(p_l.p_l / [0.3, 0.3, 0.6], 1.0)


def test_fixes_wander_off_while_standing_and_come_back_on_the_way() -> None:
    errors = GnssErrors(
        horizontal_std_m=0.0, vertical_std_m=0.0, standing_drift_mps=0.05, decay=0.9
    )
    count, rate_hz = 400, 2.0
    stands = np.arange(count) < 200
    gnss = Gnss(np.random.default_rng(6), rate_hz, errors)
    p_l = gnss.measure(np.zeros((count, 3)), motion_of(count, standing=stands)).p_l
    steps = np.diff(p_l[:200], axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-12)
    assert 0.0 < np.hypot(*steps[0, :2]) * rate_hz < 5 * 0.05
    assert not np.any(p_l[:, 2])
    away = np.hypot(*p_l[200:, :2].T)
    np.testing.assert_allclose(away[1:], away[:-1] * 0.9**0.5, rtol=1e-9)


# Several correlation times, heavy tails -----------------------------------------------------------
def test_parts_of_the_error_last_their_own_times() -> None:
    parts = (
        Correlated(horizontal_std_m=2.0, vertical_std_m=3.0, time_s=50.0),
        Correlated(horizontal_std_m=1.0, time_s=2.0),
    )
    errors = GnssErrors(horizontal_std_m=0.0, vertical_std_m=0.0, correlated=parts)
    receiver = Gnss(np.random.default_rng(4), 2.0, errors)
    still, stands = np.zeros((20_000, 3)), np.ones(20_000, dtype=bool)
    fixes = np.concatenate([receiver.measured(still, still, stands).p_l for _ in range(3)])
    east, up = fixes[:, 0], fixes[:, 2]
    assert np.std(east) == pytest.approx(math.sqrt(5.0), rel=0.1)
    assert np.std(up) == pytest.approx(3.0, rel=0.1)
    for lag_s, expected in (
        (2.0, 4 * math.exp(-2 / 50) + math.exp(-1)),
        (20.0, 4 * math.exp(-0.4)),
    ):
        lag = round(2.0 * lag_s)
        assert np.mean(east[lag:] * east[:-lag]) == pytest.approx(expected, rel=0.15)


def test_heavy_tails_keep_the_deviation_and_have_ten_times_the_outliers() -> None:
    shared = {"horizontal_std_m": 0.0, "vertical_std_m": 0.0, "white_horizontal_std_m": 1.0}
    still, stands = np.zeros((40_000, 3)), np.ones(40_000, dtype=bool)
    normal, tailed = (
        Gnss(np.random.default_rng(4), 2.0, GnssErrors(**shared, white_dof=dof))  # type: ignore[arg-type]
        .measured(still, still, stands)
        .p_l[:, 0]
        for dof in (None, 4.0)
    )
    assert np.std(normal) == pytest.approx(1.0, rel=0.02)
    assert np.std(tailed) == pytest.approx(1.0, rel=0.1)
    assert np.mean(np.abs(tailed) > 4.0) > 10 * max(np.mean(np.abs(normal) > 4.0), 1e-4)
