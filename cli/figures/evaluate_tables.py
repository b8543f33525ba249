"""`tramstream evaluate` for people: a few tables that are read at a glance."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from tramstream.analysis.evaluate.consistency import Nees
from tramstream.analysis.evaluate.evaluation import Evaluation
from tramstream.analysis.evaluate.judgement import Judgement, Summary, Terms, group_name
from tramstream.analysis.evaluate.outages import distance_m
from tramstream.events.wording import lasting
from tramstream.shown import shown

UNITS = {"m": "m", "mps": "m/s", "deg": "°", "pct": "%"}
GRADE = "grade"
"""What the track's slope is called beside the estimates."""


def console() -> Console:
    """Of standard output; as wide as needed where that is no terminal."""
    return Console(width=None if sys.stdout.isatty() else 120, highlight=False)


def print_judgements(judged: Evaluation, title: str) -> None:
    """Everything, the main estimate first."""
    out, of, terms, grade = console(), judged.of, judged.terms, judged.grade
    name, main = next(iter(of.items()))
    out.print(shown(title), style="bold", markup=False, soft_wrap=True)
    for line in _facts(main):
        out.print(shown(line), markup=False, soft_wrap=True)
    summaries = {each: judgement.summary for each, judgement in of.items()}
    if judged.gnss is not None:
        summaries["raw GNSS"] = judged.gnss
    if not isinstance(grade, str):
        summaries[GRADE] = grade.summary
    out.print(_errors(summaries))
    if isinstance(grade, str) and grade:
        out.print(shown(grade), markup=False, soft_wrap=True)
    for each, judgement in of.items():
        if judgement.nees:
            out.print(_nees(judgement.nees, each))
    if not isinstance(grade, str) and grade.nees:
        out.print(_nees(grade.nees, GRADE))
    if main.nis:
        out.print(_nis(main, name))
    for each, judgement in of.items():
        for line in _protection(judgement, terms, each):
            out.print(shown(line), markup=False, soft_wrap=True)
    if main.groups:
        out.print(_outages(main, name))
        for line in _worst(main, terms):
            out.print(shown(line), markup=False, soft_wrap=True)


def _table(first: str, *columns: str) -> Table:
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column(first, no_wrap=True)
    for column in columns:
        left = column in ("of", "verdict")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    return table


def _facts(main: Judgement) -> list[str]:
    """What was judged, what was not, and how the ride began."""
    errors = main.errors
    stamps = errors.stamp_ns
    duration_s = float(stamps[-1] - stamps[0]) / 1e9
    way_m = distance_m(errors.truth, int(stamps[0]), int(stamps[-1]))
    way = f", {way_m / 1000:.2f} km" if math.isfinite(way_m) else ""
    reasons = {
        "without truth": errors.left_out["without_truth"],
        "starting": errors.left_out["starting"],
        "skipped": main.skipped,
    }
    left_out = ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
    at = "instants of the truth" if errors.at_truth else "states"
    lines = [
        f"{lasting(duration_s)}{way}; {len(errors)} {at} judged"
        + (f", left out: {left_out}" if left_out else "")
    ]
    if unknown := errors.left_out["heading_unknown"]:
        lines.append(f"{unknown} with heading unknown: judged by position alone")
    if main.start is not None:
        state, tracking = lasting(main.start.to_state_s), lasting(main.start.to_tracking_s)
        lines.append(f"from the first fix to the first state {state}, to tracking {tracking}")
    return lines


def _errors(summaries: dict[str, Summary]) -> Table:
    table = _table("error", "of", "mean", "std", "RMS", "P50", "P90", "P95", "P99", "max", "at s")
    for column in dict.fromkeys(name for summary in summaries.values() for name in summary):
        name, unit = column.rsplit("_", 1)
        label = f"{name.replace('_', ' ')} {UNITS[unit]}"
        for of, summary in summaries.items():
            each = summary.get(column)
            if each is None:
                continue
            figures = (each.mean, each.std, each.rms, each.p50, each.p90, each.p95, each.p99)
            cells = [_figure(figure) for figure in (*figures, each.max)]
            table.add_row(label, of, *cells, f"{each.max_at_s:.1f}")
            label = ""
    return table


def _figure(value: float) -> str:
    """Millimetres below ten metres, then as many digits as fit the column."""
    size = abs(value)
    return f"{value:.3f}" if size < 10 else f"{value:.2f}" if size < 100 else f"{value:.1f}"


def _nees(nees: Mapping[str, Nees], name: str) -> Table:
    table = _table(
        f"NEES of {name}", "mean", "ideal", "95 % of means", "worth", "inside 95 %", "verdict"
    )
    for kind, each in nees.items():
        table.add_row(
            kind.replace("_", " "),
            f"{each.mean:.2f}",
            f"{each.dimensions}",
            f"{each.bounds.low:.2f} … {each.bounds.high:.2f}",
            f"{each.effective:.0f}",
            f"{100 * each.inside_share:.1f} %",
            each.verdict,
        )
    return table


def _nis(judgement: Judgement, name: str) -> Table:
    table = _table(
        f"NIS of {name}", "count", "accepted", "mean", "95 % of means", "lag 1", "verdict"
    )
    for measurement, each in judgement.nis.items():
        table.add_row(
            measurement,
            f"{each.count}",
            f"{100 * each.accepted_share:.1f} %",
            f"{each.mean:.2f}",
            f"{each.bounds.low:.2f} … {each.bounds.high:.2f}",
            f"{each.lag1:.2f}" if math.isfinite(each.lag1) else "",
            each.verdict or "",
        )
    return table


def _protection(judgement: Judgement, terms: Terms, name: str) -> list[str]:
    protection = judgement.protection
    if protection is None:
        return []
    risk = "" if terms.integrity_risk is None else f" (claimed risk {terms.integrity_risk:.3g})"
    levels = zip(("along", "across"), protection.exceeded_share, protection.mean_m, strict=True)
    parts = [f"{side} {mean:.2f} m, exceeded {share:.3g}" for side, share, mean in levels]
    lines = [f"protection level of {name}, mean and share of time: {'; '.join(parts)}{risk}"]
    if terms.integrity_risk is not None and protection.stretches:
        lines.append(
            f"beyond it in {protection.stretches} stretches, chance of that if it were right: "
            f"{protection.chance(terms.integrity_risk):.2g}"
        )
    return lines


def _outages(judgement: Judgement, name: str) -> Table:
    table = _table(
        f"without GNSS, {name}", "gaps", "way m", "horizontal RMS m", "along RMS m", "across RMS m"
    )
    for group in judgement.groups:
        figures = (
            group.distance_m,
            group.horizontal_rms_m,
            group.along_rms_m,
            group.across_rms_m,
        )
        cells = [f"{each:.2f}" if math.isfinite(each) else "" for each in figures]
        label = group_name(group.to_s).replace("_", " ")
        table.add_row(label, f"{group.count}", *cells)
    return table


def _worst(judgement: Judgement, terms: Terms) -> list[str]:
    worst = max(judgement.outages, key=lambda each: each.horizontal_m)
    at_s = (worst.start_ns - terms.origin_ns) / 1e9
    return [
        f"worst: {worst.horizontal_m:.2f} m after {lasting(worst.duration_s)} without, from "
        f"{at_s:.1f} s on"
    ]
