"""`tramstream reproduce grade`: the slope of simulated rides against the truth."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.slopes import worlds as study
from tramstream.analysis.slopes.worlds import WORLDS, Case, Errors, Figures
from tramstream.analysis.studies.kaspar2023 import BUILT_IN, line_of
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.machine import compilation

NAME = "grade"
WIDTH = 140
"""Of the table: wider than a file is taken to be."""


def reproduce(options: Options) -> None:
    """Simulate, estimate, judge; what is done when a signal comes is printed."""
    cases = _cases(options)
    compilation.ensure(say)
    began_s = time.monotonic()
    rides: dict[Case, Figures] = {}
    for job, result in pool.results([Job(study.study, (case,)) for case in cases]):
        (case,) = job.arguments
        rides[case] = result
        rms = result.settled.rms_percent
        say(f"{len(rides)}/{len(cases)}: {case.world}, {case.line}, seed {case.seed}: {rms:.3f} %")
    found = [rides[case] for case in cases if case in rides]
    missing = len(cases) - len(found)
    if missing:
        say(f"stopped; {missing} rides are missing")
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(found, missing, elapsed_s)))
    elif found:
        _print(Console(width=max(Console().width, WIDTH)), found, elapsed_s)


def _cases(options: Options) -> list[Case]:
    """Every world on every line with every seed."""
    first = study.SEED if options.seed is None else options.seed
    seeds = range(first, first + (options.seeds or 1))
    lines = options.lines or (BUILT_IN,)
    for line in lines:
        line_of(line)  # one that cannot be read is told before the rides begin
    worlds = [study.world_of(name) for name in options.worlds] or WORLDS
    return [
        Case(world.name, line, seed, options.duration_s)
        for line in lines
        for world in worlds
        for seed in seeds
    ]


def _plain(figures: Sequence[Figures], missing: int, elapsed_s: float) -> dict[str, Any]:
    return {
        "work": NAME,
        "worlds": {world.name: world.what for world in WORLDS},
        "rides": [_finite(_row(each)) for each in figures],
        "missing_rides": missing,
        "elapsed_s": elapsed_s,
    }


def _row(each: Figures) -> dict[str, Any]:
    fields = {**each.case._asdict(), **each._asdict()}
    del fields["case"]
    return {
        name: _finite(value._asdict()) if isinstance(value, Errors) else value
        for name, value in fields.items()
    }


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN and no infinity."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in fields.items()
    }


_COLUMNS = (
    "RMS %",
    "P95 %",
    "max %",
    "NEES (1)",
    "departed %",
    "standing %",
    "pitch %",
    "its NEES",
    "nod °/(m/s²)",
    "mass off %",
    "known s",
)


def _print(console: Console, figures: Sequence[Figures], elapsed_s: float) -> None:
    for line in dict.fromkeys(each.case.line for each in figures):
        chosen = [each for each in figures if each.case.line == line]
        table = Table(title=f"{NAME}: {line}", box=None, pad_edge=False, collapse_padding=True)
        table.add_column("world", no_wrap=True)
        table.add_column("seed", justify="right", no_wrap=True)
        for column in _COLUMNS:
            table.add_column(column, justify="right", no_wrap=True)
        table.add_column("said", no_wrap=True)
        for each in chosen:
            table.add_row(*_cells(each))
        console.print(table, "")
    console.print(
        f"{len(figures)} rides in {elapsed_s:.0f} s. Error of the slope in % (100 tan), from "
        f"{study.SETTLED_S:.0f} s on; departed: RMS\nfrom the first departure on; standing: RMS at "
        "the stops after it; pitch: RMS of the localiser's\npitch taken for the slope, and its "
        "NEES; nod: of the springs, as learned; mass: at the end of the\nride; known: seconds "
        "after the first departure until it is told within 2 % of itself; said:\nkinds of events "
        "of `grade`.",
        soft_wrap=True,
    )


def _cells(each: Figures) -> list[str]:
    settled = each.settled
    return [
        each.case.world,
        str(each.case.seed),
        _number(settled.rms_percent, 3),
        _number(settled.p95_percent, 3),
        _number(settled.max_percent, 2),
        _number(settled.nees, 2),
        _number(each.departed.rms_percent, 3),
        _number(each.standing.rms_percent, 3),
        _number(each.pitch.rms_percent, 3),
        _number(each.pitch.nees, 2),
        f"{_number(each.pitch_deg_per_mps2, 3)} ± {_number(each.pitch_std_deg_per_mps2, 3)}",
        _number(100.0 * each.mass_error, 1),
        _number(each.mass_known_s, 0),
        ", ".join(kind.removeprefix("grade.") for kind in each.events),
    ]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
