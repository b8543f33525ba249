"""`tramstream reproduce drives`: real drives through our filter, beside other systems' figures."""

from __future__ import annotations

import json
import math
import multiprocessing
import time
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import drives as study
from tramstream.analysis.studies.drives import CUTS_S, DRIVES, OTHERS, Cut
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError

NAME = "drives"
DATA = Path("../shared/data/drives")
MAPPINGS = Path("mappings")
WORKERS = 2


def reproduce(options: Options) -> None:
    """Import, filter and judge; what was done when a signal came is printed."""
    data, mappings = options.data or DATA, options.mappings or MAPPINGS
    for drive in DRIVES:
        for place in (data / drive.folder, mappings / drive.mapping):
            if not place.exists():
                raise ConfigError(f"{place}: is not there; give its folder with --data, --mappings")
    began_s = time.monotonic()
    figures, cuts = _study(data, mappings)
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(figures, cuts, elapsed_s)))
        return
    _print(Console(), figures, cuts)


def _study(data: Path, mappings: Path) -> tuple[dict[str, dict[str, Any]], list[Cut]]:
    """Every drive as a whole, and the outages of the first, on two cores."""
    figures: dict[str, dict[str, Any]] = {}
    cuts: list[Cut] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(WORKERS, context) as pool:
        whole: dict[Future[Any], str] = {
            pool.submit(study.whole, data / each.folder, mappings / each.mapping, say): each.name
            for each in DRIVES
        }
        first = DRIVES[0]
        parts: list[Future[Any]] = [
            pool.submit(study.outages, data / first.folder, mappings / first.mapping, part, WORKERS)
            for part in range(WORKERS)
        ]
        try:
            for count, done in enumerate(as_completed([*whole, *parts]), 1):
                if done in whole:
                    figures[whole[done]] = done.result()
                else:
                    cuts += done.result()
                say(f"{count}/{len(whole) + len(parts)}")
        except (KeyboardInterrupt, BrokenProcessPool):
            say("stopped; what is missing below was not done")
            pool.shutdown(wait=False, cancel_futures=True)
    return figures, sorted(cuts, key=lambda cut: (cut.duration_s, cut.start_s))


def rms_m(cuts: list[Cut], duration_s: float) -> float:
    """Of the horizontal errors at the ends of the outages of one length; NaN without one."""
    ends = [cut.horizontal_m for cut in cuts if cut.duration_s == duration_s]
    return math.sqrt(sum(end * end for end in ends) / len(ends)) if ends else math.nan


def _plain(figures: dict[str, Any], cuts: list[Cut], elapsed_s: float) -> dict[str, Any]:
    outages = {
        f"{duration_s:g}": {
            "places": sum(cut.duration_s == duration_s for cut in cuts),
            "horizontal_rms_m": rms_m(cuts, duration_s),
        }
        for duration_s in CUTS_S
        if any(cut.duration_s == duration_s for cut in cuts)
    }
    return {
        "work": NAME,
        "drives": figures,
        "outages": outages,
        "cuts": [asdict(cut) for cut in cuts],
        "others": [asdict(each) for each in OTHERS],
        "elapsed_s": elapsed_s,
    }


def _print(console: Console, figures: dict[str, Any], cuts: list[Cut]) -> None:
    for drive in DRIVES:
        if drive.name not in figures:
            continue
        found = figures[drive.name]
        table = _table(f"{drive.name}: {drive.what}", ("system", "RMS m", "P90 m", "up m", "NEES"))
        for name, prefix in (("tramstream", ""), ("tramstream, smoothed", "smoothed_")):
            table.add_row(name, *_errors(found, prefix))
        for each in OTHERS:
            if each.drive == drive.name and each.rms_m is not None:
                table.add_row(each.system, *map(_number, (each.rms_m, each.p90_m, each.up_m)), "")
        console.print(table, "")
    if not cuts:
        return
    columns = ("system", *(f"{duration_s:g} s" for duration_s in CUTS_S))
    table = _table("rtkx: GNSS cut, no odometer; horizontal RMS at the end, m", columns)
    table.add_row("tramstream", *(_number(rms_m(cuts, each)) for each in CUTS_S))
    for other in OTHERS:
        if other.cuts_m:
            table.add_row(other.system, *map(_number, other.cuts_m))
    console.print(table, "")
    table = _table("rtkx: error at the end of each cut, m: along, across ± stated", columns[1:], 0)
    table.columns[0].justify = "right"
    for start_s in sorted({cut.start_s for cut in cuts}):
        ends = {cut.duration_s: cut for cut in cuts if cut.start_s == start_s}
        table.add_row(
            *(_end(ends.get(duration_s)) for duration_s in CUTS_S),
        )
    console.print(table, "")
    console.print(
        "NEES of the position: 2 is right, less is caution. Other systems: shared/data/README.md.\n"
        "Cuts: every 10 s of the drive, from 20 s after the heading is known to where they still\n"
        "end within it.",
        soft_wrap=True,
    )


def _table(title: str, columns: tuple[str, ...], left: int = 1) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index < left else "right", no_wrap=True)
    return table


def _errors(found: dict[str, Any], prefix: str) -> list[str]:
    names = ("horizontal_rms_m", "horizontal_p90_m", "up_rms_m", "nees_position_mean")
    return [_number(found.get(prefix + name)) for name in names]


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.3f}" if abs(value) < 1.0 else f"{value:.1f}"


def _end(cut: Cut | None) -> str:
    if cut is None:
        return ""
    return f"{cut.start_s:.0f} s: {cut.along_m:.1f}, {cut.across_m:.1f} ± {cut.std_m:.0f}"
