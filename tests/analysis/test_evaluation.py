"""Errors put into a known truth come out of the evaluation, digit by digit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from circling import (
    SPEED_MPS,
    START_NS,
    along_across,
    fixes,
    motion,
    stamps,
    states,
    truth,
)

from tramstream.analysis.evaluate.errors import errors, fix_errors, statistics, summary
from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.estimation.series import Slot
from tramstream.proto.estimate_pb2 import MotionState

UM = 1e-6
TENTH_MM = 1e-4
"""An error put in along a curve turns with it, and its speed is not in the state's."""
TRUTH_S = np.arange(0.0, 40.0, 0.1)
STATE_S = np.arange(0.0, 39.9, 0.01)
RTK_S = np.arange(0.0, 40.0, 0.25) + 0.004


def shifted(time_s: np.ndarray, along_m: float, across_m: float, up_m: float) -> np.ndarray:
    _, yaw = motion(time_s)
    return along_across(yaw, along_m + 0 * yaw, across_m + 0 * yaw) + np.array([0.0, 0.0, up_m])


def test_errors_put_in_come_out():
    off = states(STATE_S, shifted(STATE_S, 0.3, -0.2, 1.5), speed_mps=0.05, yaw_rad=-0.01)
    found = errors(off, truth(TRUTH_S))
    assert len(found) == len(STATE_S)
    assert not found.at_truth
    for column, value in (
        (found.along_m, 0.3),
        (found.across_m, -0.2),
        (found.up_m, 1.5),
        (found.horizontal_m, np.hypot(0.3, 0.2)),
        (found.speed_mps, 0.05),
        (found.yaw_rad, -0.01),
    ):
        np.testing.assert_allclose(column, value, atol=UM)


def test_figures_of_known_errors_are_exact():
    """Errors 1, 2 … 100 cm, every other one negative."""
    size_m = np.arange(1, 101) / 100
    found = statistics(np.where(np.arange(100) % 2, -size_m, size_m), stamps(np.arange(100)), 0)
    assert found.count == 100
    assert found.mean == pytest.approx(-0.005)
    assert found.rms == pytest.approx(np.sqrt(100 * 101 * 201 / 6 / 100) / 100)
    assert found.std**2 == pytest.approx(found.rms**2 - found.mean**2)
    assert found.p50 == pytest.approx(0.505)
    assert found.p90 == pytest.approx(0.901)
    assert found.max == 1.0
    assert found.max_at_s == pytest.approx(START_NS / S + 99)


def test_figures_of_one_sample_and_of_none():
    found = statistics(np.array([-2.0, np.nan]), stamps([7.0, 8.0]), START_NS)
    assert (found.count, found.mean, found.std, found.p99, found.max) == (1, -2.0, 0.0, 2.0, 2.0)
    assert found.max_at_s == 7.0
    assert statistics(np.array([np.nan]), stamps([7.0]), START_NS) is None
    assert statistics(np.empty(0), stamps([]), START_NS) is None


def test_heading_error_over_the_seam_is_small():
    """On the circle the yaw passes ±180°; so does the estimate, elsewhere."""
    found = errors(states(STATE_S, yaw_rad=0.02), truth(TRUTH_S))
    assert summary(found, START_NS)["yaw_deg"].max == pytest.approx(np.degrees(0.02))


def test_truth_without_yaw_is_resolved_along_the_estimate():
    known = truth(RTK_S)
    known.attitude_rad[:] = np.nan
    found = errors(states(STATE_S, shifted(STATE_S, 0.3, -0.2, 0.0)), known)
    assert found.at_truth
    np.testing.assert_allclose(found.along_m, 0.3, atol=TENTH_MM)
    np.testing.assert_allclose(found.across_m, -0.2, atol=TENTH_MM)
    assert np.isnan(found.yaw_rad).all()
    assert summary(found, 0)["yaw_deg"] is None


def test_sparse_truth_draws_the_states_to_its_own_instants():
    known = truth(RTK_S)
    known.attitude_rad[:] = np.nan
    found = errors(states(STATE_S, [0.4, 0.0, 0.0]), known)
    np.testing.assert_array_equal(found.stamp_ns, known.stamp_ns)
    np.testing.assert_allclose(found.horizontal_m, 0.4, atol=UM)
    late = states(STATE_S[STATE_S > 20.0])
    assert errors(late, known).left_out["without_truth"] == np.count_nonzero(RTK_S < 20.01)


def test_states_in_a_gap_of_the_truth_are_left_out_and_counted():
    gap = (TRUTH_S <= 10.0) | (TRUTH_S >= 20.0)
    found = errors(states(STATE_S), truth(TRUTH_S[gap]))
    inside = (STATE_S > 10.0) & (STATE_S < 20.0)
    assert found.left_out["without_truth"] == np.count_nonzero(inside)
    assert len(found) == len(STATE_S) - np.count_nonzero(inside)


def test_a_state_alone_at_a_truth_alone_is_judged():
    found = errors(states(np.array([5.0]), [0.0, 3.0, 0.0]), truth(np.array([5.0])))
    assert len(found) == 1
    assert found.horizontal_m[0] == pytest.approx(3.0)


def test_truth_of_another_time_judges_nothing():
    found = errors(states(STATE_S + 100.0), truth(TRUTH_S))
    assert len(found) == 0
    assert found.left_out["without_truth"] == len(STATE_S)
    assert summary(found, 0)["horizontal_m"] is None


def test_modes_decide_what_is_judged():
    series = states(STATE_S, [1.0, 0.0, 0.0], speed_mps=5.0, yaw_rad=1.0)
    series.mode[:100] = MotionState.STARTING
    series.mode[100:300] = MotionState.HEADING_UNKNOWN
    series.mode[-100:] = MotionState.DEAD_RECKONING
    found = errors(series, truth(TRUTH_S))
    assert found.left_out == {"without_truth": 0, "starting": 100, "heading_unknown": 200}
    figures = summary(found, START_NS)
    assert figures["horizontal_m"].count == len(STATE_S) - 100
    assert figures["speed_mps"].count == figures["yaw_deg"].count == len(STATE_S) - 300


def test_variance_of_the_truth_adds_to_the_estimates():
    known = truth(TRUTH_S, std_m=0.5)
    found = errors(states(STATE_S), known)
    diagonal = found.covariance[50].diagonal()
    assert diagonal[Slot.EAST] == diagonal[Slot.NORTH] == 1.25
    assert diagonal[Slot.UP] == diagonal[Slot.SPEED] == 1.0


def test_inputs_stay_as_they_were():
    series, known = states(STATE_S), truth(TRUTH_S, std_m=0.5)
    before = series.covariance.copy()
    errors(series, known)
    np.testing.assert_array_equal(series.covariance, before)


# Raw GNSS -----------------------------------------------------------------------------------------
def test_fixes_are_held_to_the_antenna():
    time_s = np.arange(0.0, 39.0, 0.2)
    lever_arm = np.array([3.0, -1.0, 2.5])
    _, yaw = motion(time_s)
    antenna = lever_arm @ C_vl(0.0, 0.0, yaw)
    given = fixes(time_s, antenna + np.array([0.0, 0.0, 0.7]))
    found = fix_errors(given, truth(TRUTH_S), lever_arm)
    np.testing.assert_allclose(found.horizontal_m, 0.0, atol=UM)
    np.testing.assert_allclose(found.up_m, 0.7, atol=UM)
    np.testing.assert_allclose(found.yaw_rad, 0.0, atol=UM)
    np.testing.assert_allclose(found.speed_mps, 0.0, atol=UM)


def test_invalid_fixes_are_not_judged():
    given = fixes(np.arange(0.0, 39.0, 0.2))
    given.valid[10:20] = False
    assert len(fix_errors(given, truth(TRUTH_S), (0, 0, 0))) == len(given) - 10


def test_course_of_a_tram_that_backs_is_behind_it():
    known = truth(TRUTH_S)
    backing = replace(known, speed_mps=-known.speed_mps)
    backing.attitude_rad[:, 2] += np.pi
    found = fix_errors(fixes(TRUTH_S[:-1]), backing, (0, 0, 0))
    np.testing.assert_allclose(found.yaw_rad, 0.0, atol=UM)
    np.testing.assert_allclose(found.speed_mps, 0.0, atol=UM)


def test_course_of_a_standing_tram_is_not_judged():
    known = replace(truth(TRUTH_S), speed_mps=np.zeros(len(TRUTH_S)))
    found = fix_errors(fixes(TRUTH_S), known, (0, 0, 0))
    assert np.isnan(found.yaw_rad).all()
    np.testing.assert_allclose(found.speed_mps, SPEED_MPS)


def test_fixes_without_the_true_yaw_are_judged_only_where_the_antenna_is_the_origin():
    known = truth(RTK_S)
    known.attitude_rad[:] = np.nan
    given = fixes(RTK_S, shifted(RTK_S, 1.0, 0.0, 0.0))
    found = fix_errors(given, known, (0, 0, 0))
    np.testing.assert_allclose(found.along_m, 1.0, atol=UM)
    assert len(fix_errors(given, known, (1.0, 0, 0))) == 0
