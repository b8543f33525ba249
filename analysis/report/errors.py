"""Summary and errors of a report: against the truth where there is one, else as stated.

The figures are those of `tramstream evaluate`, by the same functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate import errors as evaluation
from tramstream.analysis.evaluate.errors import Errors, MotionErrors
from tramstream.analysis.evaluate.grade import GradeJudgement, judge_grade
from tramstream.analysis.evaluate.judgement import MAIN, Judgement, Summary, judge
from tramstream.analysis.report.charts import BAD, FILTER, GNSS, SMOOTHED, TRUTH, Timeline, Trace
from tramstream.analysis.report.material import Material, Runs, std_of
from tramstream.analysis.report.page import Page, figure
from tramstream.clock import S
from tramstream.estimation.series import Array, Slot

QUANTITIES = {
    "horizontal_m": "horizontal, m",
    "along_m": "along, m",
    "across_m": "across, m",
    "up_m": "up, m",
    "speed_mps": "speed, m/s",
    "roll_deg": "roll, °",
    "pitch_deg": "pitch of the body, °",
    "yaw_deg": "heading, °",
    "grade_pct": "grade of the track, %",
    "body_pitch_deg": "pitch of the body against the track, °",
}
ANGLES = {"roll_deg": Slot.ROLL, "pitch_deg": Slot.PITCH, "yaw_deg": Slot.YAW}
GRADE = "grade"


@dataclass(frozen=True)
class Judged:
    """Errors against the truth; empty without one."""

    of: dict[str, Judgement]
    """`filter`, `smoothed`."""
    gnss: MotionErrors | None
    summaries: dict[str, Summary]
    """Of the same and of `GNSS`."""
    grade: GradeJudgement | None = None

    def __bool__(self) -> bool:
        return bool(self.summaries)


def judge_ride(material: Material) -> Judged:
    """Hold filter, smoother and receiver to the truth."""
    truth, fixes, terms = material.ride.truth, material.ride.fixes, material.terms
    if truth is None:
        return Judged({}, None, {})
    of = {
        name: judge(states, truth, fixes, terms)
        for name, states in (("filter", material.states), ("smoothed", material.smoothed))
        if states is not None
    }
    of = {name: each for name, each in of.items() if len(each.errors)}
    summaries = {name: each.summary for name, each in of.items()}
    gnss = None
    if fixes is not None:
        gnss = evaluation.fix_errors(fixes, truth, terms.lever_arm_m)
        if len(gnss):
            summaries["GNSS"] = evaluation.summary(gnss, terms.origin_ns)
    slope = judge_grade(material.grade, truth, terms) if material.grade is not None else None
    return Judged(of, gnss, summaries, slope)


def add_summary(page: Page, material: Material, judged: Judged) -> None:
    """The ride at a glance, then how good the estimate is."""
    page.section("Summary")
    page.tiles(_tiles(material))
    for text in _absent(material, judged):
        page.absent(text)
    if judged:
        _add_figures(page, judged)
        _add_grade(page, judged)
        _add_protection(page, material, judged)
        _add_outages(page, material, judged)
        _add_all(page, judged)
    elif material.states is not None:
        _add_stated(page, material)


def add_errors(page: Page, material: Material, judged: Judged, timeline: Timeline) -> None:
    """Errors over time within ± 2σ and the protection level."""
    page.section("Errors against the truth")
    if not judged:
        page.absent(
            "Errors need a truth and an estimate of the same time. Whether the filter agrees with "
            "what it was told stands under Measurements."
        )
        return
    page.note(
        "Estimate minus truth. Between the thin lines (± 2σ as the filter states it) lie 95 % of "
        "the errors if it is honest; the dashed lines are the protection level. Fixes far off may "
        "lie outside the picture."
    )
    stated = judged.of["filter"].errors if "filter" in judged.of else None
    figures = []
    for title, name, unit in (
        ("Along", "along_m", "error, m"),
        ("Across", "across_m", "error, m"),
        ("Up", "up_m", "error, m"),
        ("Speed", "speed_mps", "error, m/s"),
        ("Roll", "roll_deg", "error, °"),
        ("Pitch of the body", "pitch_deg", "error, °"),
        ("Heading", "yaw_deg", "error, °"),
    ):
        traces = []
        if judged.gnss is not None and len(judged.gnss):
            error = _column(judged.gnss, name)
            traces.append(Trace("GNSS", judged.gnss.stamp_ns, error, GNSS, dots=True))
        for of, colour in (("smoothed", SMOOTHED), ("filter", FILTER)):
            if of in judged.of:
                each = judged.of[of].errors
                traces.append(Trace(of, each.stamp_ns, _column(each, name), colour))
        if stated is not None:
            traces += _bounds(stated, name)
        if known := [each for each in traces if each.known]:
            figures.append(timeline.figure(title, unit, known))
    if judged.grade is not None:
        figures.append(_grade_figure(judged.grade, timeline))
    page.figures(figures)


def _grade_figure(judgement: GradeJudgement, timeline: Timeline) -> Any:
    """Error of the track's slope within its ± 2σ."""
    errors = judgement.errors
    half = 2 * errors.grade_std_pct
    traces = [
        Trace(GRADE, errors.stamp_ns, errors.grade_pct, FILTER),
        Trace("± 2σ", errors.stamp_ns, None, TRUTH, (-half, half), 1.0, "solid", edges=True),
    ]
    return timeline.figure("Grade of the track", "error, %", traces)


def _bounds(errors: Errors, name: str) -> list[Trace]:
    """What the filter itself says of its error: ± 2σ and protection level."""
    # Where an error is not judged (a heading that is not known yet) nor is what is stated of it.
    std = np.where(np.isfinite(_column(errors, name)), _stated(errors, name), np.nan)
    level = None
    if name in ("along_m", "across_m"):
        level = errors.protection_m[:, 0 if name == "along_m" else 1]
    found = []
    for text, half, colour, dash in (
        ("± 2σ", 2 * std, TRUTH, "solid"),
        ("protection", level, BAD, "dashed"),
    ):
        if half is not None and np.isfinite(half).any():
            edges = (-half, half)
            trace = Trace(text, errors.stamp_ns, None, colour, edges, 1.0, dash, edges=True)
            found.append(trace)
    return found


def _stated(errors: Errors, name: str) -> Array:
    """The deviation that belongs to a column of errors."""
    P = errors.covariance
    yaw = np.where(np.isfinite(errors.truth.yaw_rad), errors.truth.yaw_rad, 0.0)
    c, s = np.cos(yaw), np.sin(yaw)
    if name == "across_m":
        c, s = -s, c
    with np.errstate(invalid="ignore"):
        if name in ("along_m", "across_m"):
            variance = c * c * P[:, 0, 0] + 2 * c * s * P[:, 0, 1] + s * s * P[:, 1, 1]
            along: Array = np.sqrt(variance)
            return along
        slot = {"up_m": Slot.UP, "speed_mps": Slot.SPEED, **ANGLES}[name]
        std: Array = np.sqrt(P[:, slot, slot])
    return np.degrees(std) if name in ANGLES else std


def _column(errors: MotionErrors, name: str) -> Array:
    if name in ANGLES:
        angle: Array = np.degrees(errors.attitude_rad[:, ANGLES[name] - Slot.ROLL])
        return angle
    column: Array = getattr(errors, name)
    return column


def _tiles(material: Material) -> list[tuple[str, str]]:
    """What the ride was."""
    duration_s = (material.end_ns - material.start_ns) / S
    tiles = []
    if material.speed is not None:
        name, stamp_ns, speed = material.speed
        step_s = np.minimum(np.diff(stamp_ns) / S, 5.0)
        travelled_m = float(np.nansum(np.abs(speed[1:]) * step_s))
        tiles.append((f"{travelled_m / 1000:.2f} km", f"travelled, by {name}"))
        tiles.append((f"{np.nanmax(np.abs(speed), initial=0):.1f} m/s", "highest speed"))
        count, stood_s = len(material.standing.start_ns), _seconds(material.standing)
        tiles.append((f"{count}", f"standstills, {stood_s:.0f} s in all"))
    if material.receiver:
        share = 1 - _seconds(material.outages) / max(duration_s, 1e-9)
        count = len(material.outages.start_ns)
        plural = "outage" if count == 1 else "outages"
        tiles.append((f"{100 * share:.1f} %", f"of the time with GNSS, {count} {plural}"))
    lost = sum(loss.count for loss in material.health.losses)
    tiles.append((f"{lost}", "messages reported lost"))
    return tiles


def _absent(material: Material, judged: Judged) -> list[str]:
    """What a whole record would have and this one has not."""
    lacking = []
    if material.states is None:
        lacking.append(
            f"No {material.estimate} in the record: `tramstream reprocess` makes it where the "
            "record holds GNSS, IMU and wheels."
        )
    if material.ride.fixes is None:
        lacking.append(f"No {keys.GNSS_FIX.path} in the record.")
    if material.ride.truth is None:
        lacking.append(
            "No truth: errors are not known, only what is stated of them. A record that holds it "
            "can be named with --truth."
        )
    elif material.states is not None and "filter" not in judged.of:
        lacking.append("The truth is of another time than the filter's states.")
    return lacking


def _add_figures(page: Page, judged: Judged) -> None:
    """One row an estimate: what people ask first."""
    rows = []
    for of, summary in judged.summaries.items():
        horizontal, speed, yaw = (
            summary[name] for name in ("horizontal_m", "speed_mps", "yaw_deg")
        )
        along, across = summary["along_m"], summary["across_m"]
        judgement = judged.of.get(of)
        main = judgement.main if judgement is not None else None
        if horizontal is None:
            continue
        rows.append(
            (
                of,
                *(horizontal.p50, horizontal.p90, horizontal.p95, horizontal.max),
                along.rms if along is not None else None,
                across.rms if across is not None else None,
                speed.std if speed is not None else None,
                yaw.rms if yaw is not None else None,
                main.mean / main.dimensions if main is not None else None,
                str(main.verdict) if main is not None else "",
            )
        )
    percentiles = ("P50, m", "P90, m", "P95, m", "max, m")
    others = ("along RMS, m", "across RMS, m", "speed σ, m/s", "heading RMS, °")
    page.table(("error of", *percentiles, *others, "NEES / ideal", "stated σ"), rows)
    page.note(f"Percentiles are of the horizontal error. NEES: {MAIN} in position, speed, heading.")


def _add_grade(page: Page, judged: Judged) -> None:
    if judged.grade is None:
        return
    page.heading("Grade of the track")
    rows: list[tuple[object, ...]] = []
    for name, each in judged.grade.summary.items():
        found = judged.grade.nees.get(name.rsplit("_", 1)[0])
        if each is not None:
            told = (found.mean, str(found.verdict)) if found is not None else (None, "")
            rows.append((QUANTITIES[name], each.rms, each.p95, each.max, *told))
    page.table(("error of", "RMS", "P95", "max", "NEES", "stated σ"), rows)


def _add_protection(page: Page, material: Material, judged: Judged) -> None:
    rows = []
    for of, judgement in judged.of.items():
        found = judgement.protection
        if found is not None:
            for k, side in enumerate(("along", "across")):
                rows.append((of, side, found.mean_m[k], 100 * found.exceeded_share[k]))
    if rows:
        page.heading("Protection levels")
        page.table(("of", "side", "mean, m", "exceeded, % of the time"), rows)
        if material.terms.integrity_risk is not None:
            page.note(f"Claimed risk: {100 * material.terms.integrity_risk:.3g} %.")


def _add_outages(page: Page, material: Material, judged: Judged) -> None:
    judgement = judged.of.get("filter")
    if judgement is None or not judgement.outages:
        return
    page.heading("At the end of each GNSS outage")
    rows = [
        (
            (each.start_ns - material.terms.origin_ns) / S,
            each.duration_s,
            each.distance_m,
            each.horizontal_m,
            each.along_m,
            each.across_m,
        )
        for each in judgement.outages
    ]
    head = ("from, s", "lasted, s", "way, m", "horizontal, m", "along, m", "across, m")
    page.table(head, rows, fold="" if len(rows) <= 8 else f"All {len(rows)} outages")


def _add_all(page: Page, judged: Judged) -> None:
    """Every statistic, folded."""
    rows: list[tuple[object, ...]] = []
    summaries, nees = dict(judged.summaries), {of: each.nees for of, each in judged.of.items()}
    if judged.grade is not None:
        summaries[GRADE], nees[GRADE] = judged.grade.summary, judged.grade.nees
    for of, summary in summaries.items():
        for quantity, each in summary.items():
            if each is not None:
                percentiles = (each.p50, each.p90, each.p95, each.p99, each.max)
                moments = (each.mean, each.std, each.rms)
                label = QUANTITIES[quantity]
                rows.append((of, label, *moments, *percentiles, each.max_at_s, each.count))
    figures = ("mean", "σ", "RMS", "P50", "P90", "P95", "P99", "max", "max at, s", "count")
    page.table(("of", "error", *figures), rows, fold="All statistics of the errors")
    rows = [
        (
            of,
            what.replace("_", " "),
            each.dimensions,
            each.mean,
            f"{figure(each.bounds.low)} … {figure(each.bounds.high)}",
            each.effective,
            100 * each.inside_share,
            str(each.verdict),
        )
        for of, found in nees.items()
        for what, each in found.items()
    ]
    bounds = ("95 % of means", "worth samples", "inside 95 %, %", "stated σ")
    fold = "NEES: is the stated σ honest?"
    page.table(("of", "NEES", "ideal", "mean", *bounds), rows, fold=fold)


def _add_stated(page: Page, material: Material) -> None:
    """Without a truth: what filter and smoother say of themselves."""
    page.heading("Stated standard deviations")
    rows = []
    for of, states in (("filter", material.states), ("smoothed", material.smoothed)):
        if states is None:
            continue
        horizontal = np.hypot(std_of(states, Slot.EAST), std_of(states, Slot.NORTH))
        for what, std in (
            ("horizontal, m", horizontal),
            ("up, m", std_of(states, Slot.UP)),
            ("speed, m/s", std_of(states, Slot.SPEED)),
            *((QUANTITIES[name], np.degrees(std_of(states, of_))) for name, of_ in ANGLES.items()),
        ):
            known = std[np.isfinite(std)]
            if len(known):
                p50, p90, p95 = np.percentile(known, (50, 90, 95)).tolist()
                rows.append((of, what, p50, p90, p95, float(known.max())))
    page.table(("of", "σ", "P50", "P90", "P95", "max"), rows)


def _seconds(runs: Runs) -> float:
    return float((runs.end_ns - runs.start_ns).sum()) / S
