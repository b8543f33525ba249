"""Gaps in the fixes: which count, how far the tram went, where the estimate ended up."""

from __future__ import annotations

import numpy as np
import pytest
from circling import SPEED_MPS, fixes, motion, states, truth
from circling import along_across as turned

from tramstream.analysis.evaluate.errors import errors
from tramstream.analysis.evaluate.outages import distance_m, grouped, outages, start
from tramstream.clock import S
from tramstream.proto.estimate_pb2 import MotionState

TRUTH_S = np.arange(0.0, 200.0, 0.1)
STATE_S = np.arange(0.0, 199.9, 0.05)


def drifting(begins_s: list[float], ends_s: list[float]):
    """Errors that grow by 0.1 m/s along and 0.02 m/s across while there are no fixes."""
    since = np.zeros(len(STATE_S))
    for begin, end in zip(begins_s, ends_s, strict=True):
        inside = (begin <= STATE_S) & (end > STATE_S)
        since[inside] = STATE_S[inside] - begin
    _, yaw = motion(STATE_S)
    return errors(states(STATE_S, turned(yaw, 0.1 * since, 0.02 * since)), truth(TRUTH_S))


def fixes_but(begins_s: list[float], ends_s: list[float]):
    time_s = np.arange(0.0, 199.9, 1.0)
    for begin, end in zip(begins_s, ends_s, strict=True):
        time_s = time_s[(time_s <= begin) | (time_s >= end)]
    return fixes(time_s)


def test_error_at_the_end_of_a_gap_is_that_before_the_next_fix():
    found = outages(drifting([20], [40]), fixes_but([20], [40]), truth(TRUTH_S), 5.0)
    (gap,) = found
    assert gap.duration_s == 20.0
    assert gap.distance_m == pytest.approx(20 * SPEED_MPS)
    assert gap.along_m == pytest.approx(0.1 * 19.95, abs=1e-6)
    assert gap.across_m == pytest.approx(0.02 * 19.95, abs=1e-6)
    assert gap.horizontal_m == pytest.approx(np.hypot(gap.along_m, gap.across_m))


def test_invalid_fixes_are_a_gap_too():
    given = fixes_but([], [])
    given.valid[(given.stamp_ns > given.stamp_ns[20]) & (given.stamp_ns < given.stamp_ns[40])] = 0
    assert len(outages(drifting([20], [40]), given, truth(TRUTH_S), 5.0)) == 1


def test_gaps_are_grouped_by_duration():
    begins, ends = [20, 50, 100], [28, 70, 125]
    found = outages(drifting(begins, ends), fixes_but(begins, ends), truth(TRUTH_S), 5.0)
    short, long = grouped(found)
    assert (short.to_s, short.count, long.to_s, long.count) == (10.0, 1, 30.0, 2)
    expected = np.sqrt((1.995**2 + 2.495**2) / 2)
    assert long.along_rms_m == pytest.approx(expected, abs=1e-6)
    assert long.distance_m == pytest.approx(22.5 * SPEED_MPS)


def test_short_gaps_count_if_asked_for():
    args = drifting([20], [24]), fixes_but([20], [24]), truth(TRUTH_S)
    assert outages(*args, 5.0) == []
    assert len(outages(*args, 3.0)) == 1


def test_fixes_that_never_come_back_are_a_gap_to_the_end():
    (gap,) = outages(drifting([150], [300]), fixes_but([150], [300]), truth(TRUTH_S), 5.0)
    assert gap.duration_s == pytest.approx(49.85, abs=0.01)
    assert gap.along_m == pytest.approx(0.1 * 49.85, abs=1e-6)


def test_gap_whose_end_has_no_truth_is_left_out():
    known = truth(TRUTH_S[(TRUTH_S < 30) | (TRUTH_S > 45)])
    found = errors(states(STATE_S), known)
    assert outages(found, fixes_but([20], [40]), known, 5.0) == []


def test_gap_before_anything_is_judged_is_left_out():
    found = drifting([], [])
    late = found.take(found.stamp_ns > found.stamp_ns[0] + 100 * S)
    assert outages(late, fixes_but([20], [40]), truth(TRUTH_S), 5.0) == []


def test_distance_without_speed_is_the_length_of_the_polygon():
    known = truth(TRUTH_S)
    known.speed_mps[:] = np.nan
    first, last = int(known.stamp_ns[0]), int(known.stamp_ns[100])
    assert distance_m(known, first, last) == pytest.approx(10 * SPEED_MPS, rel=1e-4)
    assert np.isnan(distance_m(known, first, first))


def test_start_is_from_the_first_valid_fix():
    given = fixes(np.arange(0.0, 100.0, 1.0))
    given.valid[:5] = False
    series = states(STATE_S)
    series.mode[STATE_S < 7] = MotionState.STARTING
    series.mode[(STATE_S >= 7) & (STATE_S < 12)] = MotionState.HEADING_UNKNOWN
    found = start(series, given)
    assert found.to_state_s == pytest.approx(2.0)
    assert found.to_tracking_s == pytest.approx(7.0)
    series.mode[STATE_S >= 12] = MotionState.HEADING_UNKNOWN
    assert start(series, given).to_tracking_s is None
    given.valid[:] = False
    assert start(series, given) is None
