"""Slopes with errors put in, on tracks where the body's pitch is another angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from circling import START_NS, stamps, states, truth

from tramstream.analysis.evaluate import grade
from tramstream.analysis.evaluate.errors import errors, summary
from tramstream.analysis.evaluate.evaluation import evaluated
from tramstream.analysis.evaluate.grade import flat_grade, grade_errors, judge_grade
from tramstream.analysis.evaluate.judgement import Terms
from tramstream.analysis.evaluate.source import Gathered
from tramstream.estimation.series import GradeSeries, TruthSeries

TRUTH_S, SAID_S = np.arange(0.0, 40.0, 0.1), np.arange(0.0, 39.9, 0.01)
SLOPE_RAD, NOD_RAD = 0.04, 0.006
TERMS = Terms(START_NS, 0.0, 5.0, (0.0, 0.0, 0.0), None)


def on_a_slope(time_s: np.ndarray = TRUTH_S) -> TruthSeries:
    """Uphill, and the body nods: its nose is down by `NOD_RAD` against the track."""
    known = truth(time_s)
    known.attitude_rad[:, 1] = -SLOPE_RAD + NOD_RAD
    return replace(known, grade_rad=np.full(len(known), SLOPE_RAD))


def said(off_rad: float = 0.0, std_rad: float = 1e-3, time_s: np.ndarray = SAID_S) -> GradeSeries:
    full = np.full(len(time_s), 1.0)
    return GradeSeries(
        stamps(time_s), (SLOPE_RAD + off_rad) * full, std_rad * full, NOD_RAD * full, 2e-3 * full
    )


def gathered(slope: GradeSeries | None, known: TruthSeries) -> Gathered:
    return Gathered(
        {"est/ekf/state": states(SAID_S)}, known, "truth", None, None, START_NS, "", "", slope
    )


def test_error_of_a_slope_is_in_per_cent_and_its_nees_of_the_angle() -> None:
    judged = judge_grade(said(2e-3), on_a_slope(), TERMS)
    assert judged is not None
    found = judged.summary["grade_pct"]
    assert found is not None
    assert found.mean == pytest.approx(100 * (np.tan(0.042) - np.tan(0.04)))
    assert judged.nees["grade"].mean == pytest.approx(4.0)
    assert judged.nees["body_pitch"].mean == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(judged.errors.grade_std_pct, 100 * 1e-3 / np.cos(0.042) ** 2)
    figures = flat_grade(judged)
    assert figures["grade_rms_pct"] == pytest.approx(found.rms)
    assert figures["grade_states"] == len(SAID_S)
    assert figures["body_pitch_max_deg"] == pytest.approx(0.0, abs=1e-9)


def test_pitch_of_a_body_that_nods_is_held_to_the_bodys_and_not_to_the_slope() -> None:
    known = on_a_slope()
    told = states(SAID_S)
    told.attitude_rad[:, 1] = -SLOPE_RAD + NOD_RAD
    found = summary(errors(told, known), START_NS)["pitch_deg"]
    assert found is not None
    assert found.max == pytest.approx(0.0, abs=1e-9)


def test_roll_is_judged_with_its_deviation() -> None:
    told = states(SAID_S, covariance=np.diag([1.0, 1.0, 1.0, 1.0, 1e-4, 1.0, 1.0]))
    told.attitude_rad[:, 0] = 0.03
    known = on_a_slope()
    judged = evaluated(replace(gathered(None, known), states={"est/ekf/state": told}), 0, 5, "x")
    assert judged["roll_rms_deg"] == pytest.approx(np.degrees(0.03))
    assert judged["nees_roll_mean"] == pytest.approx(9.0)
    assert judged["nees_pitch_mean"] == pytest.approx((SLOPE_RAD - NOD_RAD) ** 2)


def test_skipped_seconds_are_no_errors_of_the_slope() -> None:
    slope = said(0.01)
    slope.grade_rad[SAID_S >= 10.0] = SLOPE_RAD
    judged = judge_grade(slope, on_a_slope(), replace(TERMS, skip_s=10.0))
    assert judged is not None
    assert judged.skipped == np.count_nonzero(SAID_S < 10.0)
    assert flat_grade(judged)["grade_max_pct"] == pytest.approx(0.0, abs=1e-9)


def test_sparse_truth_draws_slopes_to_its_own_instants() -> None:
    sparse = on_a_slope(np.arange(0.0, 40.0, 1.003))
    slope = said(0.001)
    slope.grade_rad[:] += 1e-4 * SAID_S
    found = grade_errors(slope, sparse)
    assert set(found.stamp_ns) <= set(sparse.stamp_ns)
    time_s = (found.stamp_ns - START_NS) / 1e9
    np.testing.assert_allclose(found.grade_rad, 0.001 + 1e-4 * time_s, atol=1e-9)


def test_slope_without_a_deviation_has_no_nees() -> None:
    judged = judge_grade(said(0.001, std_rad=0.0), on_a_slope(), TERMS)
    assert judged is not None
    assert "grade" not in judged.nees
    assert flat_grade(judged)["nees_grade_mean"] is None


def test_record_without_a_slope_says_that_pitch_is_none() -> None:
    judged = evaluated(gathered(None, on_a_slope()), 0.0, 5.0, "x")
    assert judged.grade == grade.PITCH_IS_THE_BODYS
    assert judged.grade_errors is None
    assert judged["grade_states"] == judged["grade_count"] == 0
    assert judged["grade_rms_pct"] is None


def test_truth_without_a_slope_judges_none_and_says_so() -> None:
    unknown = replace(on_a_slope(), grade_rad=np.full(len(TRUTH_S), np.nan))
    judged = evaluated(gathered(said(), unknown), 0.0, 5.0, "x")
    assert judged.grade == grade.TRUTH_KNOWS_NO_SLOPE
    assert judged["grade_rms_pct"] is None


def test_slope_of_a_record_is_beside_its_states() -> None:
    judged = evaluated(gathered(said(1e-3), on_a_slope()), 0.0, 5.0, "x")
    assert judged["grade_mean_pct"] == pytest.approx(0.1, rel=0.01)
    assert judged.grade_errors is not None
    assert len(judged.grade_errors) == len(SAID_S)
