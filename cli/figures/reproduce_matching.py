"""`tramstream reproduce matching`: simulated rides on a track network, which track they are on."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import matching as study
from tramstream.analysis.studies import matching_figures as figures_of
from tramstream.analysis.studies.matching import Case
from tramstream.analysis.studies.matching_figures import (
    BESIDE,
    MOVING,
    NEAREST_FIX,
    NEAREST_STATE,
    PERCENTILES,
    STANDING,
    STRICT,
    SWITCHES,
    TRACK,
    TWO_SIGMA,
    WANTED,
    WANTED_OF_90,
    Bin,
    Figures,
    Mistake,
    Total,
)
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError
from tramstream.machine import compilation

NAME = "matching"
SEEDS = 10
DETOURS = 20
MISTAKES_SHOWN = 12
_TRACKS = {
    "right track": TRACK,
    "standing": STANDING,
    "moving": MOVING,
    "parallel": BESIDE,
    "strict": STRICT,
    "nearest": NEAREST_FIX,
    "no map": NEAREST_STATE,
}
"""Columns of the first table."""


def reproduce(options: Options) -> None:
    """Simulate, match, judge; what is done when a signal comes is printed."""
    if options.network is None:
        raise ConfigError("matching needs a track network; give its file with --net")
    network = str(options.network.absolute())
    lines = study.lines(study.load(network), options.lines)
    cases = _cases(network, lines, options)
    compilation.ensure(say)  # once, and not in every process
    began_s = time.monotonic()
    rides: dict[Case, Figures] = {}
    for job, result in pool.results([Job(study.study, (case,)) for case in cases]):
        (case,) = job.arguments
        rides[case] = result
        say(f"{len(rides)}/{len(cases)}: {case.route}, seed {case.seed}")
    if len(rides) < len(cases):
        say(f"stopped; {len(cases) - len(rides)} rides are missing")
    found = [rides[case] for case in cases if case in rides]
    elapsed_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_plain(network, found, len(cases) - len(found), elapsed_s)))
        return
    if found:
        _print(Console(), found, elapsed_s)


def _cases(network: str, lines: Sequence[str], options: Options) -> list[Case]:
    """Every line with every seed, and detours of the lines in turn."""
    first = 1 if options.seed is None else options.seed
    seeds = range(first, first + (options.seeds or SEEDS))
    detours = DETOURS if options.detours is None else options.detours
    kinds = options.kinds or (study.PLAIN,)
    if unknown := set(kinds) - set(study.KINDS):
        raise ConfigError(
            f"no rides are called {min(unknown)!r}; there are: {', '.join(study.KINDS)}"
        )
    rides = [(line, seed, False, seed == first) for line in lines for seed in seeds]
    rides += [
        (lines[number % len(lines)], first + number, True, number < len(lines))
        for number in range(detours)
    ]
    return [
        Case(network, line, seed, detour, options.duration_s, free, kind)
        for kind in kinds
        for line, seed, detour, free in rides
    ]


# JSON ---------------------------------------------------------------------------------------------
def _plain(
    network: str, figures: Sequence[Figures], missing: int, elapsed_s: float
) -> dict[str, Any]:
    totals = figures_of.totals(figures) if figures else []
    return {
        "work": NAME,
        "network": network,
        "wanted": {**WANTED, "of_90": WANTED_OF_90},
        "overall": [_plain_total(total) for total in totals],
        "rides": [_plain_ride(each) for each in figures],
        "missing_rides": missing,
        "elapsed_s": elapsed_s,
    }


def _plain_total(total: Total) -> dict[str, Any]:
    return {
        "name": total.name,
        "rides": total.rides,
        "length_m": total.length_m,
        "duration_s": total.duration_s,
        "starting_s": total.starting_s,
        "step_us": _number(total.step_us),
        **_plain_tallies(total),
        "along_m": dict(zip(map(str, PERCENTILES), map(_number, total.along_m), strict=True)),
        "reliability": {
            "most_probable": [each._asdict() for each in figures_of.bins(total.best)],
            "all_candidates": [each._asdict() for each in figures_of.bins(total.candidates)],
        },
    }


def _plain_ride(ride: Figures) -> dict[str, Any]:
    return {
        "route": ride.route,
        "seed": ride.seed,
        "length_m": ride.length_m,
        "duration_s": ride.duration_s,
        "starting_s": ride.starting_s,
        **_plain_tallies(ride),
        "mistakes": [each._asdict() for each in ride.mistakes],
    }


def _plain_tallies(each: Total | Figures) -> dict[str, Any]:
    return {
        name: {"right": tally.right, "total": tally.total, "share": tally.share}
        for name, tally in each.tallies.items()
    }


def _number(value: float) -> float | None:
    """JSON has no NaN and no infinity."""
    return value if math.isfinite(value) else None


# Tables -------------------------------------------------------------------------------------------
def _print(console: Console, figures: Sequence[Figures], elapsed_s: float) -> None:
    totals = figures_of.totals(figures)
    console.print(_tracks(totals), "")
    console.print(_switches(totals), "")
    last = totals[-1]
    console.print(_reliability("most probable run", figures_of.bins(last.best)), "")
    console.print(_reliability("all candidates", figures_of.bins(last.candidates)), "")
    _print_mistakes(console, figures)
    hours = last.duration_s / 3600
    console.print(
        f"{last.rides} rides, {last.length_m / 1000:.0f} km, {hours:.1f} h, in {elapsed_s:.0f} s. "
        f"Wanted: right track {100 * WANTED[TRACK]:.1f} %, right way\n"
        f"{100 * WANTED[SWITCHES[0]]:.0f} % at 30 m, of what is called 90 % between "
        f"{100 * WANTED_OF_90[0]:.0f} and {100 * WANTED_OF_90[1]:.0f} %.\n"
        "right track: of all points since the first answer, every 0.1 s, standing ones too; right\n"
        "too where rails have not parted yet (less than 1 m), which strict does not allow.\n"
        "parallel: where the true track has a neighbour. nearest: nearest track of each fix; no\n"
        "map: of the position of a filter without the map, on the first ride of each line and\n"
        "its first detour. way: facing switches, asked so far beyond; parted: at 30 m, or farther\n"
        "where the rails part there. along: distance from the truth along the track, and how\n"
        "often it is within 2 σ (95.4 is right). start: from the filter's first position to the\n"
        "first answer. episodes: stretches of one candidate in one bin; ± is of the share right\n"
        "if each were one throw.",
        soft_wrap=True,
    )


def _table(title: str, first: str, columns: Sequence[str]) -> Table:
    table = Table(title=title, box=None, pad_edge=False, collapse_padding=True)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _tracks(totals: Sequence[Total]) -> Table:
    columns = ("rides", "km", *_TRACKS)
    table = _table(f"{NAME}: points on the right track, %", "route", columns)
    for total in totals:
        shares = (_percent(total, name) for name in _TRACKS.values())
        table.add_row(total.name, str(total.rides), f"{total.length_m / 1000:.1f}", *shares)
    return table


def _switches(totals: Sequence[Total]) -> Table:
    percentiles = (f"P{each}" for each in PERCENTILES)
    columns = (
        "switches",
        "way 30 m",
        "15 m",
        "parted",
        "along",
        *percentiles,
        "2 σ",
        "start s",
        "µs",
    )
    table = _table(f"{NAME}: right ways at switches, %, and along the track, m", "route", columns)
    for total in totals:
        table.add_row(
            total.name,
            str(total.tallies[SWITCHES[0]].total),
            *(_percent(total, name) for name in SWITCHES),
            "",
            *(f"{each:.1f}" for each in total.along_m),
            _percent(total, TWO_SIGMA),
            f"{total.starting_s:.0f}",
            f"{total.step_us:.0f}",
        )
    return table


def _reliability(title: str, bins: Sequence[Bin]) -> Table:
    columns = ("points", "episodes", "stated %", "right %", "±")
    table = _table(f"{NAME}: {title}", "called %", columns)
    for each in bins:
        table.add_row(
            f"{100 * each.low:g} to {100 * each.high:g}",
            str(each.points),
            str(each.episodes),
            f"{100 * each.stated:.2f}",
            f"{100 * each.right:.2f}",
            f"{100 * each.std:.1f}",
        )
    return table


def _print_mistakes(console: Console, figures: Sequence[Figures]) -> None:
    """The longest stretches, then switches."""
    found = [(ride, mistake) for ride in figures for mistake in ride.mistakes]
    if not found:
        return
    found.sort(key=lambda each: each[1].start_s - each[1].end_s)
    shown = found[:MISTAKES_SHOWN]
    columns = ("seed", "at s", "for s", "at m", "", "run", "said", "called %")
    title = f"{NAME}: mistakes, {len(shown)} of {len(found)}, longest first; names by --json"
    table = _table(title, "route", columns)
    for ride, mistake in shown:
        table.add_row(ride.route, str(ride.seed), *_mistake(mistake))
    console.print(table, "")


def _mistake(mistake: Mistake) -> list[str]:
    lasted_s = mistake.end_s - mistake.start_s
    return [
        f"{mistake.start_s:.0f}",
        f"{lasted_s:.1f}" if mistake.kind == "track" else mistake.kind,
        f"{mistake.route_m:.0f}",
        "standing" if mistake.standing else "",
        str(mistake.true_run),
        str(mistake.said_run) if mistake.said else "–",
        f"{100 * mistake.probability:.1f}",
    ]


def _percent(total: Total, name: str) -> str:
    share = total.tallies[name].share
    return "–" if share is None else f"{100 * share:.2f}"
