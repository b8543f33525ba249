"""`tramstream reproduce kaspar2023`: simulated rides through the filter of the work and ours."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import allan
from tramstream.analysis.studies import kaspar2023 as study
from tramstream.analysis.studies.bound import Bound
from tramstream.analysis.studies.kaspar2023 import PUBLISHED, Case, Figures, Overall
from tramstream.cli.figures.options import Options
from tramstream.cli.figures.reproduce_allan import table_of
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError
from tramstream.processors.localisation.models import MODELS
from tramstream.processors.tram.localiser import TramLocaliser

NAME = study.WORK
SEEDS = 5
ALLAN = "allan"
"""Beside the kinds of rides: its sensors at rest, and what an Allan analysis finds of them."""


def reproduce(options: Options) -> None:
    """Simulate, filter, judge; what is done when a signal comes is printed."""
    first = 1 if options.seed is None else options.seed
    seeds = range(first, first + (options.seeds or SEEDS))
    lines = options.lines or (study.BUILT_IN,)
    known = (*study.KINDS, ALLAN)
    kinds = options.kinds or known
    if unknown := set(kinds) - set(known):
        raise ConfigError(f"no rides are called {min(unknown)!r}; there are: {', '.join(known)}")
    for line in lines:
        study.line_of(line)  # a line that cannot be used is told before the work begins
    cases = [
        Case(line, kind, seed, options.duration_s)
        for line in lines
        for kind in kinds
        if kind != ALLAN
        for seed in seeds
    ]
    still = [allan.Case(NAME, seed) for seed in seeds if ALLAN in kinds]
    axes: list[allan.Figures] = []
    began_s = time.monotonic()
    rides: dict[Case, list[Figures]] = {}
    bounds: dict[str, Bound] = {}
    for job, result in pool.results(_jobs(cases) + [Job(allan.study, (each,)) for each in still]):
        (case, *_) = job.arguments
        if job.function is allan.study:
            axes += result
            say(f"noise of the sensors at rest, seed {case.seed}")
        elif isinstance(result, Bound):
            bounds[_kind(case)] = result
        else:
            rides[case] = result
            say(f"{len(rides)}/{len(cases)}: {_kind(case)}, seed {case.seed}")
    if len(rides) < len(cases):
        say(f"stopped; {len(cases) - len(rides)} rides are missing")
    figures = [each for case in cases for each in rides.get(case, ())]
    elapsed_s = time.monotonic() - began_s
    if options.json:
        plain = _plain(figures, bounds, len(cases) - len(rides), elapsed_s)
        plain |= {ALLAN: [_clean(row._asdict()) for row in _rows(axes, still)]}
        print(json.dumps(plain))
        return
    console = Console()
    for kind in dict.fromkeys(_kind(each) for each in figures):
        of_kind = [each for each in figures if _kind(each) == kind]
        _print(console, kind, of_kind, bounds.get(kind))
    if cases:
        _explain(console, len(rides), elapsed_s)
    if axes:
        _print_noise(console, _rows(axes, still))


def _rows(axes: list[allan.Figures], still: list[allan.Case]) -> list[allan.Row]:
    return allan.overall(axes, still[0]) if axes else []


def _print_noise(console: Console, rows: list[allan.Row]) -> None:
    """The Allan part: what the joint fit and the work's tangents make of the same curves."""
    table = table_of(rows)
    table.title = f"{NAME}: sensors at rest, {allan.HOURS:g} h at 100 Hz"
    console.print(table)
    milli = {(each.sensor, each.name): f"{1e3 * each.truth:.4g}" for each in rows}
    accel, gyro = ([milli[sensor, name] for name in "NBK"] for sensor in ("accel", "gyro"))
    console.print(
        f"N, B, K in mm/s²: {', '.join(accel)}; in mrad/s: {', '.join(gyro)}. Section 3.2.1 of the "
        "work prints\nsuch figures of the F9R's sensors with m and rad: a thousandfold too large. "
        "bound: Whittle's;\ntangent: RMS of the work's readings off the curve, and share of axes "
        "that have one.",
        soft_wrap=True,
    )


def _jobs(cases: Sequence[Case]) -> list[Job]:
    """Bounds of all kinds of rides that have no map, and rides."""
    kinds = {_kind(case): case for case in reversed(cases)}
    bounds = [
        Job(study.bound_of, (case,)) for case in kinds.values() if case.kind in study.WITHOUT_MAP
    ]
    return bounds + [Job(study.study, (case, tuple(MODELS))) for case in cases]


def _kind(case: Case | Figures | Overall) -> str:
    return f"{Path(case.line).name}, {case.kind}"


def _plain(
    figures: list[Figures], bounds: dict[str, Bound], missing: int, elapsed_s: float
) -> dict[str, Any]:
    """Without NaN, which JSON does not have."""

    def ride(each: Figures) -> dict[str, Any]:
        fields = each._asdict()
        del fields["nees_series"]
        return fields

    totals = study.overall(figures)
    filtered = {_kind(each): each for each in totals if each.model == TramLocaliser.name}

    def overall(total: Overall) -> dict[str, Any]:
        plain, least = _clean(asdict(total)), bounds.get(_kind(total))
        if total.model == study.SMOOTHED:
            plain["over_filter"] = _clean(study.over_filter(total, filtered[_kind(total)]))
        elif least:
            plain["bound"] = _clean(asdict(least))
            plain["over_bound"] = _clean(study.over_bound(total, least))
        return plain

    return {
        "work": NAME,
        "published": PUBLISHED,
        "overall": [overall(each) for each in totals],
        "rides": [_clean(ride(each)) for each in figures],
        "missing_rides": missing,
        "elapsed_s": elapsed_s,
    }


def _clean(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not isfinite(value) else value
        for name, value in values.items()
    }


def _print(console: Console, kind: str, figures: list[Figures], least: Bound | None) -> None:
    table = Table(title=f"{NAME}: {kind}", box=None, pad_edge=False, collapse_padding=True)
    table.add_column("model", no_wrap=True)
    columns = ("seed", "P90 m", "along", "across", "speed σ", "yaw °", "NEES", "beyond PL %", "µs")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    totals = study.overall(figures)
    for total in totals:
        rides = [each for each in figures if each.model == total.model]
        if rides[0] is figures[0]:
            for ride in rides:
                table.add_row("raw GNSS", str(ride.seed), f"{ride.gnss_p90_m:.3f}")
            table.add_row("raw GNSS", "all", f"{total.gnss_p90_m:.3f}")
        for ride, consistent in zip(rides, total.consistent, strict=True):
            verdict = "ok" if consistent else "no"
            table.add_row(ride.model, str(ride.seed), *_numbers(ride, verdict))
        verdict = f"{sum(total.consistent)}/{total.rides}"
        table.add_row(total.model, "all", *_numbers(total, verdict))
        if total.model == study.SMOOTHED:
            (filtered,) = (each for each in totals if each.model == TramLocaliser.name)
            _add_ratios(table, "smoothed / filtered", study.over_filter(total, filtered))
        elif least is not None:
            _add_ratios(table, f"{total.model} / bound", study.over_bound(total, least))
    if least is not None:
        table.add_row("bound", "", *_errors(least))
    console.print(table, "")


def _add_ratios(table: Table, name: str, ratios: dict[str, float]) -> None:
    table.add_row(name, "", *(f"{ratio:.2f}" for ratio in ratios.values()))


def _errors(each: Figures | Overall | Bound) -> list[str]:
    return [
        f"{each.position_p90_m:.3f}",
        f"{each.along_rms_m:.3f}",
        f"{each.across_rms_m:.3f}",
        f"{each.speed_std_mps:.4f}",
        f"{each.yaw_rms_deg:.2f}",
    ]


def _numbers(each: Figures | Overall, verdict: str) -> list[str]:
    shares = (each.exceeded_along_share, each.exceeded_across_share)
    return [
        *_errors(each),
        f"{each.nees:.1f} {verdict}",
        " ".join("–" if share is None else f"{100 * share:.2f}" for share in shares),
        f"{each.step_us:.0f}" if isfinite(each.step_us) else "",
    ]


def _explain(console: Console, rides: int, elapsed_s: float) -> None:
    p90, mapped, speed, step = (
        PUBLISHED[name]
        for name in ("position_p90_m", "position_p90_map_m", "speed_std_mps", "step_us")
    )
    console.print(
        f"Published: P90 {p90} m without the map, {mapped} m with it; speed σ {speed} m/s; "
        f"{step:.0f} µs a\nstep (93 s for 400,000 steps). {rides} rides in {elapsed_s:.0f} s.\n"
        "P90: of the horizontal error; along, across, yaw: RMS; NEES of the position: 2 is\n"
        "right, ok: within 95 %; beyond PL: time that the error is beyond the protection level,\n"
        "along and across; µs: one step of the model, here. bound: posterior Cramér-Rao, what\n"
        "no filter can do better, all rides thrown together; where wheels slip, of the first\n"
        f"seed. slip: at {study.SKIDDING:.0%} of all stops and departures. Errors of fixes keep\n"
        "0.95 of themselves in a second; white: nothing, as the filter of the work expects.",
        soft_wrap=True,
    )
