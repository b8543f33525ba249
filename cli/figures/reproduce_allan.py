"""`tramstream reproduce allan`: noise of simulated sensors estimated again, beside the bound."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from math import isfinite
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import allan as study
from tramstream.analysis.studies.allan import Case, Figures, Row
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say

NAME = "allan"


def reproduce(options: Options) -> None:
    """Simulate standstill, estimate, compare; what is done when a signal comes is printed."""
    first = 1 if options.seed is None else options.seed
    duration_s = options.duration_s or (options.hours or study.HOURS) * 3600
    seeds = range(first, first + (options.seeds or study.SEEDS))
    rate_hz = options.rate_hz or study.section_of(study.SCENARIO).rate_hz
    cases = [Case(seed=seed, duration_s=duration_s, rate_hz=rate_hz) for seed in seeds]
    began_s = time.monotonic()
    found: list[Figures] = []
    done = 0
    for job, result in pool.results([Job(study.study, (case,)) for case in cases]):
        done += 1
        found += result
        say(f"{done}/{len(cases)}: seed {job.arguments[0].seed}")
    rows = study.overall(found, cases[0])
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(rows, found, cases[0], done, elapsed_s)))
        return
    console = Console()
    console.print(table_of(rows))
    console.print(
        f"{done} records of {duration_s / 3600:g} h at {rate_hz:g} Hz, three axes each, in "
        f"{elapsed_s:.0f} s. "
        "bound: Whittle's, all four\ncoefficients unknown; RMS and bias: of the joint fit; seen: "
        "share of axes in which the\nrecord shows it; in 95 %: share of those whose interval holds "
        "the truth; tangent: RMS of\nthe work's readings off the curve, and share of axes that "
        "have one.",
        soft_wrap=True,
    )
    worse = study.beyond(rows)
    told = ", ".join(f"{each.sensor} {each.name} {each.rms / each.bound:.2f}" for each in worse)
    console.print(f"Above {study.LIMIT} times the bound: {told or 'none'}.")


def table_of(rows: Sequence[Row]) -> Table:
    """A coefficient a row."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for column in ("sensor", "", "truth"):
        table.add_column(column, no_wrap=True)
    for column in ("bound %", "RMS %", "RMS/bound", "bias %", "seen", "in 95 %", "tangent %", ""):
        table.add_column(column, justify="right", no_wrap=True)
    for each in rows:
        worth = each.bound < study.WORTH
        table.add_row(
            each.sensor,
            each.name,
            f"{each.truth:.5g}",
            _percent(each.bound),
            _percent(each.rms) if worth else "–",
            f"{each.rms / each.bound:.2f}" if worth else "–",
            _percent(each.bias) if worth else "–",
            f"{each.seen:.0%}",
            f"{each.inside:.0%}" if isfinite(each.inside) else "–",
            _percent(each.tangent_rms),
            f"{each.tangents:.0%}",
        )
    return table


def _percent(value: float) -> str:
    return f"{100 * value:.3g}" if isfinite(value) else "–"


def _plain(
    rows: list[Row], found: list[Figures], case: Case, done: int, elapsed_s: float
) -> dict[str, Any]:
    """Without NaN, which JSON does not have."""

    def clean(values: dict[str, Any]) -> dict[str, Any]:
        return {
            name: None if isinstance(value, float) and not isfinite(value) else value
            for name, value in values.items()
        }

    return {
        "work": NAME,
        "duration_s": case.duration_s,
        "rate_hz": case.rate_hz,
        "records": done,
        "overall": [clean(each._asdict()) for each in rows],
        "axes": [
            each._asdict() | {"tangents": clean(each.tangents), "limits": clean(each.limits)}
            for each in found
        ],
        "elapsed_s": elapsed_s,
    }
