"""`tramstream reproduce chladek2023`: its grade estimators beside ours, in degrees and radians."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import chladek2023 as study
from tramstream.analysis.studies.chladek2023 import Check, Estimator, Figures
from tramstream.cli.figures.evaluate_tables import console
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError

NAME = study.WORK
SEED = 2023
FILE = Path("../shared/data/maps/prague/lines_7_20.geojson")


def reproduce(options: Options) -> None:
    """Simulate, estimate, judge; two profiles of one file."""
    if len(options.lines) > 1:
        raise ConfigError(f"{NAME} takes one --line: a GeoJSON file with lines 7 and 20")
    source = options.lines[0] if options.lines else str(FILE)
    if "#" in source:
        raise ConfigError(f"--line {source}: give the file alone; {NAME} takes lines 7/0 and 20/0")
    if options.seeds is not None and options.seeds < study.TELLING_RIDES:
        raise ConfigError(f"--seeds {options.seeds}: {NAME} needs {study.TELLING_RIDES} at least")
    for which in range(len(study.LINES)):
        study.profile_for(source, which)  # a line that is not there is told before the work begins
    seed = SEED if options.seed is None else options.seed
    began_s = time.monotonic()
    figures = []
    for which, (line, _, _) in enumerate(study.LINES):
        say(f"{which + 1}/{len(study.LINES)}: line {line}")
        try:
            figures.append(study.study(source, which, seed, options.seeds))
        except KeyboardInterrupt:
            say(f"stopped; line {line} and what follows is missing")
            break
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(figures, seed, elapsed_s)))
        return
    out = console()
    for each in figures:
        _print(out, each)
    _explain(out, elapsed_s)


def _plain(figures: list[Figures], seed: int, elapsed_s: float) -> dict[str, Any]:
    def profile(each: Figures) -> dict[str, Any]:
        plain = asdict(each)
        plain["means"] = [mean._asdict() for mean in each.means]
        plain["checks"] = [{**one._asdict(), "passed": one.passed} for one in study.checks(each)]
        return plain

    return {
        "work": NAME,
        "seed": seed,
        "profiles": [profile(each) for each in figures],
        "elapsed_s": elapsed_s,
    }


def _print(out: Console, figures: Figures) -> None:
    title = (
        f"{NAME}: line {figures.profile}, {figures.length_m:.0f} m, slopes of "
        f"{_degrees(figures.slope_rms_rad)}° RMS"
    )
    out.print(_estimators(figures, title), "")
    out.print(_means(figures), "")
    checks = study.checks(figures)
    for each in checks:
        out.print(_said(each))
    if not checks:
        out.print("Not judged: profile 2 of the work is not to be had.")
    out.print("")


def _table(title: str, first: str, *columns: str) -> Table:
    table = Table(title=title, box=None, pad_edge=False, collapse_padding=True)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _estimators(figures: Figures, title: str) -> Table:
    columns = ("work °", "work rad", "here °", "here rad", "no noise rad", "late m")
    table = _table(title, "estimator", *columns)
    for each in (*figures.estimators, *figures.baselines):
        table.add_row(each.name, *_cells(each))
    return table


def _cells(each: Estimator) -> list[str]:
    work, clean = each.published_rad, each.clean_rad
    return [
        "" if work is None else _degrees(work),
        "" if work is None else f"{work:.4f}",
        _degrees(each.rmse_rad),
        f"{each.rmse_rad:.4f}",
        "" if clean is None else f"{clean:.4f}",
        "" if each.lag_m is None else f"{each.lag_m:.0f}",
    ]


def _degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.3f}"


def _means(figures: Figures) -> Table:
    columns = ("averaged EKF rad", "ours rad", "bound rad", "ours / bound", "NEES")
    table = _table("RMSE over the number of rides (fig. 4.8)", "rides", *columns)
    for each in figures.means:
        table.add_row(
            str(each.rides),
            f"{each.averaged_rad:.4f}",
            f"{each.fused_rad:.5f}",
            f"{each.bound_rad:.5f}",
            f"{each.fused_rad / each.bound_rad:.2f}",
            f"{each.nees:.2f}",
        )
    return table


def _said(each: Check) -> str:
    limits = f"at most {each.high:.4g}" if not each.low else f"{each.low:.4g} to {each.high:.4g}"
    return f"{'pass' if each.passed else 'FAIL'}  {each.name}: {each.value:.4g}, {limits}"


def _explain(out: Console, elapsed_s: float) -> None:
    out.print(
        f"Root mean square errors of the slope angle over the whole profile; {elapsed_s:.0f} s. "
        "no noise: the same\nwith exact measurements, so what is left is the estimator's own; "
        "late: the shift that takes most of it away.\nAveraging rides cannot: that is where the "
        "averaged EKF stays. ours: rides smoothed and added as information,\nthe prior counted "
        "once. bound: posterior Cramér-Rao of the same rides, not causal (docs/chladek2023.md).",
        soft_wrap=True,
    )
