"""`tramstream reproduce worlds`: the localisation in worlds that nobody has configured."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import matching
from tramstream.analysis.studies.kaspar2023 import BUILT_IN
from tramstream.analysis.worlds import study
from tramstream.analysis.worlds import sums as worlds_sums
from tramstream.analysis.worlds.study import Case, Figures
from tramstream.analysis.worlds.sums import Sum
from tramstream.analysis.worlds.table import TODAY, WORLDS, World
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError
from tramstream.machine import compilation

NAME = "worlds"
NETWORK_LINES = ("7/0",)
"""Of a network, unless others are named."""
WIDTH = 140
"""Of the tables: wider than a file is taken to be."""


def reproduce(options: Options) -> None:
    """Simulate, localise, judge; what is done when a signal comes is printed."""
    cases = _cases(options)
    compilation.ensure(say)  # once, and not in every process
    began_s = time.monotonic()
    rides: dict[Case, list[Figures]] = {}
    for job, result in pool.results([Job(study.study, (case,)) for case in cases]):
        (case,) = job.arguments
        rides[case] = result
        p90 = " and ".join(f"{each.p90_m:.2f}" for each in result)
        say(f"{len(rides)}/{len(cases)}: {case.world}, {case.line}, seed {case.seed}: P90 {p90} m")
    found = [each for case in cases if case in rides for each in rides[case]]
    elapsed_s = time.monotonic() - began_s
    missing = len(cases) - len(rides)
    if missing:
        say(f"stopped; {missing} rides are missing")
    if options.json:
        print(json.dumps(_plain(found, missing, elapsed_s)))
    elif found:
        _print(Console(width=max(Console().width, WIDTH)), found, elapsed_s)


def _cases(options: Options) -> list[Case]:
    """Every world on every line with every seed; today's world beside each, and first."""
    first = study.SEED if options.seed is None else options.seed
    seeds = range(first, first + (options.seeds or 1))
    network = None if options.network is None else str(options.network.absolute())
    lines: Sequence[str] = options.lines or (BUILT_IN,)
    if network is not None:
        lines = matching.lines(matching.load(network), options.lines or NETWORK_LINES)
    duration_s = options.duration_s or study.DURATION_S
    cases: dict[Case, None] = {}
    for line in lines:
        for world in _worlds(options.worlds):
            for seed in seeds:
                length_s = min(duration_s, world.duration_s or duration_s)
                case = Case(world.name, line, seed, length_s, network)
                cases[case.today] = cases[case] = None
    return sorted(cases, key=lambda case: case.world != TODAY)


def _worlds(names: Sequence[str]) -> list[World]:
    known = {world.name: world for world in WORLDS}
    for name in names:
        if name not in known:
            raise ConfigError(f"no world is called {name!r}; there are: {', '.join(known)}")
    return [known[name] for name in names] if names else list(WORLDS)


# JSON ---------------------------------------------------------------------------------------------
def _plain(figures: Sequence[Figures], missing: int, elapsed_s: float) -> dict[str, Any]:
    return {
        "work": NAME,
        "worlds": {world.name: world.what for world in WORLDS},
        "overall": [_finite(vars(total)) for total in worlds_sums.sums(figures)],
        "beyond_share": {
            "no map": worlds_sums.all_beyond_share(figures, False),
            "map": worlds_sums.all_beyond_share(figures, True),
        },
        "rides": [
            _finite({
                **each.case._asdict(),
                **{name: value for name, value in each._asdict().items() if name != "case"},
                "raised": [raised._asdict() for raised in each.raised],
            })
            for each in figures
        ],
        "missing_rides": missing,
        "elapsed_s": elapsed_s,
    }  # fmt: skip


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN and no infinity."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in fields.items()
    }


# Tables -------------------------------------------------------------------------------------------
def _print(console: Console, figures: Sequence[Figures], elapsed_s: float) -> None:
    totals = worlds_sums.sums(figures)
    for line in dict.fromkeys(total.line for total in totals):
        for with_map in (False, True):
            chosen = [each for each in totals if each.line == line and each.with_map == with_map]
            if chosen:
                console.print(_table(line, with_map, chosen), "")
    for with_map, word in ((False, "without a map"), (True, "with a map")):
        share = worlds_sums.all_beyond_share(figures, with_map)
        if share is not None:
            console.print(f"{word}: {_percent(share)} % of all time beyond the protection level")
    console.print(
        f"{len(figures)} rides of filters in {elapsed_s:.0f} s. moving: P90 since the first\n"
        "departure; over: that over the same rides' as today; bound: over that of the\n"
        "posterior Cramér-Rao bound, where it holds the world's noise. PL: time beyond the\n"
        "protection level (claimed: 0.1 %). said: after the fault, by which kind of\n"
        "event (-: never); the worst of all seeds. fails: what is wanted of it: over up\n"
        "to 1.5 or bound up to 1.15, NEES of 1 to 4, PL up to 1 %, right track 99.5 %,\n"
        "said in time.",
        soft_wrap=True,
    )


_COLUMNS = ("P50 m", "P90 m", "moving", "over", "max m", "NEES (2)", "PL %", "heading °")


def _table(line: str, with_map: bool, totals: Sequence[Sum]) -> Table:
    word = "with a map" if with_map else "no map"
    title = f"{NAME}: {line}, {word}, {totals[0].rides} rides each"
    table = Table(title=title, box=None, pad_edge=False, collapse_padding=True)
    table.add_column("world", no_wrap=True)
    for column in (*_COLUMNS, "track %" if with_map else "bound"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("said s", justify="right", no_wrap=True)
    table.add_column("by", no_wrap=True)
    table.add_column("fails", no_wrap=True)
    longest_s = max(total.asked_s for total in totals)
    for total in totals:
        shorter = total.asked_s < longest_s
        name = f"{total.world}, {total.asked_s:.0f} s" if shorter else total.world
        table.add_row(name, *_row(total))
    return table


def _row(total: Sum) -> list[str]:
    row = [
        f"{total.p50_m:.2f}",
        f"{total.p90_m:.2f}",
        f"{total.moving_p90_m:.2f}",
        f"{total.ratio:.2f}",
        f"{total.max_m:.1f}",
        f"{total.nees:.1f}",
        _percent(total.beyond_share),
        f"{total.heading_rms_deg:.2f}",
    ]
    if total.with_map:
        row.append(_percent(total.right_track_share))
    else:
        row.append("" if total.over_bound is None else f"{total.over_bound:.2f}")
    return [*row, _said(total.said_s), ", ".join(total.said_by), ", ".join(total.failed)]


def _said(said_s: tuple[float | None, ...] | None) -> str:
    if said_s is None:
        return ""
    return "-" if None in said_s else f"{max(each for each in said_s if each is not None):.1f}"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.2f}"
