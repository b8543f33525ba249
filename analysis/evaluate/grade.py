"""Errors of the track's slope, and of the body's pitch against it, beside what is claimed of them.

A localiser's pitch is that of the body in which its IMU is. On springs that nods when the tram
brakes, and between its bogies it is a chord: minus the pitch is no slope of the track. So the
slope is judged of what a grade estimator says (`est/grade/state`) by the truth's own slope, and a
localiser's pitch by the truth's pitch.

Slopes are compared in per cent (100 tan): what people ask for; NEES is that of the angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.consistency import Nees
from tramstream.analysis.evaluate.errors import Statistics, statistics
from tramstream.analysis.evaluate.judgement import (
    Summary,
    Terms,
    flat_nees,
    flat_summary,
    plain,
)
from tramstream.clock import S
from tramstream.estimation.series import (
    Array,
    GradeSeries,
    Instants,
    Table,
    TruthSeries,
    interpolate_truth,
    is_dense,
    linear,
)

KINDS = ("grade", "body_pitch")
"""What has a deviation, and so a NEES."""
COLUMNS = ("grade_pct", "body_pitch_deg")
PITCH_IS_THE_BODYS = (
    "pitch is the body's, and no slope of the track where the body nods; the track's slope is "
    "judged of est/grade/state"
)
"""What is said where nothing tells the slope."""
TRUTH_KNOWS_NO_SLOPE = "the truth does not know the track's slope; est/grade/state is not judged"


@dataclass(frozen=True)
class GradeErrors(Table):
    """Estimate minus truth; one row an instant that both know."""

    stamp_ns: Instants
    grade_rad: Array
    grade_pct: Array
    """The same as a slope."""
    grade_std_rad: Array
    grade_std_pct: Array
    body_pitch_rad: Array
    body_pitch_std_rad: Array


@dataclass(frozen=True)
class GradeJudgement:
    """Everything said of one grade estimator."""

    states: int
    errors: GradeErrors
    skipped: int
    summary: Summary
    nees: dict[str, Nees]


def slope_pct(grade_rad: Array) -> Array:
    """An angle as a slope."""
    slope: Array = 100.0 * np.tan(grade_rad)
    return slope


def grade_errors(said: GradeSeries, truth: TruthSeries) -> GradeErrors:
    """Subtract the truth; whichever of both is dense is brought to the stamps of the other."""
    if is_dense(truth):
        truth = interpolate_truth(truth, said.stamp_ns)
    else:
        stamp_ns = truth.stamp_ns
        columns = (said.grade_rad, said.grade_std_rad, said.body_pitch_rad, said.body_pitch_std_rad)
        said = GradeSeries(stamp_ns, *(linear(said.stamp_ns, each, stamp_ns) for each in columns))
    known = np.isfinite(said.grade_rad) & np.isfinite(truth.grade_rad)
    said, truth = said.take(known), truth.take(known)
    # dα of a slope 100 tan α: 100 (1 + tan²α)
    steep = 100.0 * (1.0 + np.tan(said.grade_rad) ** 2)
    return GradeErrors(
        stamp_ns=said.stamp_ns,
        grade_rad=said.grade_rad - truth.grade_rad,
        grade_pct=slope_pct(said.grade_rad) - slope_pct(truth.grade_rad),
        grade_std_rad=said.grade_std_rad,
        grade_std_pct=steep * said.grade_std_rad,
        body_pitch_rad=said.body_pitch_rad - truth.body_pitch_rad,
        body_pitch_std_rad=said.body_pitch_std_rad,
    )


def judge_grade(said: GradeSeries, truth: TruthSeries, terms: Terms) -> GradeJudgement | None:
    """Judge one grade estimator; None where the truth knows no slope, or is of another time."""
    errors = grade_errors(said, truth)
    kept = errors.stamp_ns >= said.stamp_ns[0] + round(terms.skip_s * S)
    skipped = int((~kept).sum())
    errors = errors.take(kept)
    if not len(errors):
        return None
    nees = {
        kind: judged
        for kind in KINDS
        if (judged := consistency.nees_of(_squares(errors, kind), 1)) is not None
    }
    return GradeJudgement(len(said), errors, skipped, _summary(errors, terms.origin_ns), nees)


def flat_grade(judgement: GradeJudgement | None) -> dict[str, Any]:
    """One judgement as keys and numbers: `grade_rms_pct`, `nees_grade_mean` and so on."""
    nothing: dict[str, Statistics | None] = dict.fromkeys(COLUMNS)
    figures: dict[str, Any] = {
        "grade_states": judgement.states if judgement else 0,
        **flat_summary(judgement.summary if judgement else nothing),
    }
    for kind in KINDS:
        figures |= flat_nees(f"nees_{kind}", judgement.nees.get(kind) if judgement else None)
    return {name: plain(value) for name, value in figures.items()}


def lacking(said: GradeSeries | None, judgement: GradeJudgement | None) -> str:
    """Why no slope was judged; empty where one was."""
    if judgement is not None:
        return ""
    return PITCH_IS_THE_BODYS if said is None else TRUTH_KNOWS_NO_SLOPE


def _summary(errors: GradeErrors, origin_ns: int) -> Summary:
    columns = (errors.grade_pct, np.degrees(errors.body_pitch_rad))
    return {
        name: statistics(column, errors.stamp_ns, origin_ns)
        for name, column in zip(COLUMNS, columns, strict=True)
    }


def _squares(errors: GradeErrors, kind: str) -> Array:
    """e²/σ²; NaN where no deviation is stated."""
    error, std = getattr(errors, f"{kind}_rad"), getattr(errors, f"{kind}_std_rad")
    with np.errstate(divide="ignore", invalid="ignore"):
        squares: Array = np.where(std > 0.0, (error / std) ** 2, np.nan)
    return squares
