"""Interpolation of the truth: what lies between its instants, and what is not known there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from circling import RADIUS_M, SPEED_MPS, motion, stamps, truth

from tramstream.clock import S
from tramstream.estimation.series import MAX_GAP_S, interpolate_truth, is_dense, wrapped_rad

UM = 1e-6
DENSE_S = np.arange(0.0, 40.0, 0.1)
BETWEEN_S = np.arange(0.0, 39.8, 0.01) + 0.003


def test_truth_between_its_instants_is_on_the_circle():
    at = interpolate_truth(truth(DENSE_S), stamps(BETWEEN_S))
    p_l, yaw = motion(BETWEEN_S)
    # The remainder of a cubic Hermite is h⁴/384 of the fourth derivative, v⁴/R³.
    bound_m = 0.1**4 / 384 * SPEED_MPS**4 / RADIUS_M**3
    np.testing.assert_allclose(at.p_l, p_l, atol=1.1 * bound_m)
    np.testing.assert_allclose(wrapped_rad(at.yaw_rad - yaw), 0.0, atol=1e-12)
    np.testing.assert_allclose(at.speed_mps, SPEED_MPS)


def test_truth_going_backwards_uphill_is_a_cubic():
    """The cubic is exact for p = t³; speed backwards and pitch nose down are both negative z."""
    time_s = np.arange(0.0, 2.0, 0.25)
    p_l = np.stack([-(time_s**3), 0 * time_s, time_s**3], axis=1) * np.sqrt(0.5)
    attitude = np.tile([0.0, np.pi / 4, 0.0], (len(time_s), 1))
    series = replace(truth(time_s), p_l=p_l, speed_mps=-3 * time_s**2, attitude_rad=attitude)
    between_s = np.arange(0.0, 1.75, 0.01)
    at = interpolate_truth(series, stamps(between_s))
    np.testing.assert_allclose(at.p_l[:, 0], -(between_s**3) * np.sqrt(0.5), atol=UM)
    np.testing.assert_allclose(at.p_l[:, 2], between_s**3 * np.sqrt(0.5), atol=UM)


def test_truth_is_itself_at_its_own_instants_whatever_is_unknown():
    series = truth(np.arange(0.0, 9.0, 1.0))
    series.attitude_rad[:] = np.nan
    series.speed_mps[::2] = np.nan
    at = interpolate_truth(series, series.stamp_ns)
    np.testing.assert_array_equal(at.p_l, series.p_l)
    np.testing.assert_array_equal(at.speed_mps, series.speed_mps)
    assert np.isnan(at.yaw_rad).all()


def test_truth_is_not_extrapolated_nor_carried_over_a_gap():
    time_s = DENSE_S[(DENSE_S < 10) | (DENSE_S > 10 + MAX_GAP_S + 0.05)]
    at = interpolate_truth(truth(time_s), stamps([-0.001, 0.0, 9.95, 10.2, 10.61, 39.9, 39.91]))
    known = np.isfinite(at.p_l).all(axis=1)
    np.testing.assert_array_equal(known, [False, True, False, False, True, True, False])


def test_truth_without_yaw_is_known_at_its_instants_alone_unless_straight_lines_will_do():
    series = truth(DENSE_S)
    series.attitude_rad[:, 2] = np.nan
    between = stamps([5.05, 5.1])
    np.testing.assert_array_equal(
        np.isfinite(interpolate_truth(series, between).p_l[:, 0]), [False, True]
    )
    straight = interpolate_truth(series, between, straight=True)
    # A chord's height over its middle, h² v² / 8R.
    sagitta_m = 0.1**2 * SPEED_MPS**2 / 8 / RADIUS_M
    away_m = np.linalg.norm(straight.p_l - motion(np.array([5.05, 5.1]))[0], axis=1)
    np.testing.assert_allclose(away_m, [sagitta_m, 0.0], rtol=1e-3, atol=UM)


def test_yaw_turns_the_short_way_over_the_seam():
    series = truth(np.array([0.0, 0.1]))
    series.attitude_rad[:, 2] = np.radians([179.0, -179.0])
    at = interpolate_truth(series, stamps([0.025, 0.05, 0.075]))
    np.testing.assert_allclose(
        wrapped_rad(at.yaw_rad - np.radians([179.5, 180.0, 180.5])), 0.0, atol=1e-9
    )


def test_deviation_of_the_truth_is_the_larger_of_the_ends_and_absent_where_exact():
    series = replace(truth(np.array([0.0, 0.1, 0.2])), position_std_m=np.array([0.1, 0.3, np.nan]))
    at = interpolate_truth(series, stamps([0.05, 0.15]))
    np.testing.assert_array_equal(at.position_std_m, [0.3, 0.3])
    assert np.isnan(interpolate_truth(truth(DENSE_S), stamps([1.05])).position_std_m[0])


@pytest.mark.parametrize(
    ("step_s", "yaw_known", "dense"),
    [(0.1, True, True), (0.25, False, False), (1.0, True, False), (0.5, True, True)],
)
def test_truth_is_dense_if_it_is_often_and_knows_its_direction(step_s, yaw_known, dense):
    series = truth(np.arange(0.0, 10.0, step_s))
    if not yaw_known:
        series.attitude_rad[:, 2] = np.nan
    assert is_dense(series) is dense


def test_one_instant_is_a_truth_but_not_dense():
    one = truth(np.array([3.0]))
    assert not is_dense(one)
    at = interpolate_truth(one, one.stamp_ns + np.array([-S, 0, S]))
    np.testing.assert_array_equal(np.isfinite(at.p_l[:, 0]), [False, True, False])


def test_rows_are_taken_from_every_column():
    chosen = truth(DENSE_S).take(np.array([3, 5]))
    assert len(chosen) == 2
    np.testing.assert_array_equal(chosen.p_l, truth(DENSE_S).p_l[[3, 5]])
