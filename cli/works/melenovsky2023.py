"""`tramstream reproduce melenovsky2023`: mountings of many rides beside the bound and the work."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import melenovsky2023 as study
from tramstream.analysis.studies.melenovsky2023 import Case, Figures, Row
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError

NAME = study.WORK
WIDTH = 160
"""Columns, where the output is no terminal."""
SEEDS = {"work": 20, "model": 4, "mountings": 100, "reference": 5, "cross-level": 5, "body": 2}
"""Rides of each kind unless the command line says otherwise."""


def reproduce(options: Options) -> None:
    """Simulate, align, compare; what is done when a signal comes is printed."""
    for kind in options.kinds:
        if kind not in SEEDS:
            raise ConfigError(f"--kind {kind}: there are {', '.join(SEEDS)}")
    cases = [case for kind in options.kinds or SEEDS for case in _cases(kind, options)]
    began_s = time.monotonic()
    found: list[Figures] = []
    done = 0
    for job, result in pool.results([Job(study.study, (case,)) for case in cases]):
        done += 1
        found += result
        case = job.arguments[0]
        say(f"{done}/{len(cases)}: {case.kind}, seed {case.seed}")
    rows, several = study.overall(found), study.several(found)
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(rows, found) | {"elapsed_s": elapsed_s}))
        return
    out = Console(width=None if sys.stdout.isatty() else WIDTH)
    out.print(table_of(rows))
    if several is not None:
        out.print(
            f"{several.rides} rides put together, {several.groups} times: RMS {several.rms:.1f}′, "
            f"by their σ {several.expected:.1f}′."
        )
    told = ", ".join(f"{name} {value:.0f}′" for name, value in study.PUBLISHED_ARCMIN.items())
    out.print(
        f"The work's single ride of 2195 s: {told}. {done} rides in {elapsed_s:.0f} s.\n"
        "RMS errors in angular minutes, as one rotation and about x y z of the vehicle. first: "
        "coarse alignment;\nlast: the smoother; bound: Cramér-Rao of the same model at the truth, "
        "and with the motion known; worst:\nlargest error over the bound; NEES: over three degrees "
        "of freedom, with its 95 % bounds; initial, IEKF:\nthe work's two stages.",
        soft_wrap=True,
    )


def _cases(kind: str, options: Options) -> list[Case]:
    first = 1 if options.seed is None else options.seed
    seeds = range(first, first + (options.seeds or SEEDS[kind]))
    lengths: dict[str, tuple[float, ...]] = {
        "work": study.DURATIONS_S,
        "model": study.DURATIONS_S[-1:],
        "mountings": (study.MOUNTING_S,),
    }
    durations = lengths.get(kind, (study.REFERENCE_S,))
    if options.duration_s is not None:
        durations = (options.duration_s,)
    return [Case(kind, seed, durations) for seed in seeds]


def table_of(rows: list[Row]) -> Table:
    """A kind and length a row."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    table.add_column("rides", no_wrap=True)
    columns = ("s", "n", "first ′", "last ′", "bound ′", "/ bound", "motion known ′", "x y z ′")
    worked = any(np.isfinite(each.iekf) for each in rows)
    last = ("initial ′", "IEKF ′") if worked else ()
    for column in (*columns, "bound x y z ′", "worst", "NEES", "95 %", *last):
        table.add_column(column, justify="right", no_wrap=True)
    for each in rows:
        table.add_row(
            each.kind,
            f"{each.duration_s:.0f}",
            str(each.rides),
            _number(each.first),
            _number(each.last),
            _number(each.bound),
            f"{each.last / each.bound:.2f}",
            _number(each.known_motion),
            " ".join(map(_number, each.axes)),
            " ".join(map(_number, each.axes_bound)),
            f"{each.worst:.1f}",
            f"{each.nees:.2f}",
            f"{each.nees_low:.2f} to {each.nees_high:.2f}",
            *((_number(each.initial), _number(each.iekf)) if worked else ()),
        )
    return table


def _number(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"


def _plain(rows: list[Row], found: list[Figures]) -> dict[str, Any]:
    def clean(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.where(np.isfinite(value), value, 0.0).tolist() if value.size else []
        if isinstance(value, float) and not np.isfinite(value):
            return None
        return value

    several = study.several(found)
    return {
        "work": NAME,
        "rows": [{name: clean(value) for name, value in each._asdict().items()} for each in rows],
        "together": several._asdict() if several is not None else None,
        "rides": [
            {
                "kind": each.kind,
                "seed": each.seed,
                "duration_s": each.duration_s,
                "first_rad": each.first_rad.tolist(),
                "last_rad": each.last_rad.tolist(),
                "std_rad": np.sqrt(np.diag(each.covariance)).tolist(),
                "bound_rad": np.sqrt(np.diag(each.bound)).tolist(),
                "nees": each.nees,
                "settled": each.settled,
                "passes": each.passes,
            }
            for each in found
        ],
    }
