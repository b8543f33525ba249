"""`tramstream reproduce day`: eight hours of service, part by part: does anything grow?"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from tramstream.analysis.worlds import day as study
from tramstream.analysis.worlds.day import Case, Growth, Part
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal.session import say, stop_on_signals
from tramstream.errors import ConfigError
from tramstream.machine import compilation

NAME = "day"
WIDTH = 140
"""Of the tables: wider than a file is taken to be."""
MB = 1e6
KB = 1e3


def reproduce(options: Options) -> None:
    """Simulate, localise, judge; every part of the day is said as soon as it is over."""
    case = _case(options)
    compilation.ensure(say)
    began_s = time.monotonic()
    parts: list[Part] = []
    stop = stop_on_signals()
    for part in study.study(case, stop.is_set):
        parts.append(part)
        say(_sentence(part))
    if stop.is_set():
        say(f"stopped; part {parts[-1].number} of {study.PARTS} is judged as far as it came")
    elapsed_s = time.monotonic() - began_s
    found = [study.growth(parts, with_map) for with_map in (False, True)]
    grown = [each for each in found if each is not None]
    if options.json:
        print(json.dumps(_plain(case, parts, grown, elapsed_s)))
    elif parts:
        _print(Console(width=max(Console().width, WIDTH)), case, parts, grown, elapsed_s)


def _case(options: Options) -> Case:
    if options.network is None:
        raise ConfigError("a day is gone on a track network; name its file with --net")
    case = Case(str(options.network.absolute()))
    if options.seed is not None:
        case = case._replace(seed=options.seed)
    if options.lines:
        case = case._replace(lines=options.lines)
    if options.hours is not None:
        case = case._replace(hours=options.hours)
    if options.frame_hz is not None:
        case = case._replace(frame_hz=options.frame_hz)
    for kind in options.kinds:
        if kind not in case.filters:
            raise ConfigError(f"no filter is called {kind!r}; there are: {', '.join(case.filters)}")
    return case._replace(filters=options.kinds) if options.kinds else case


def _sentence(part: Part) -> str:
    word = "with a map" if part.with_map else "no map"
    return (
        f"part {part.number} of {study.PARTS}, {word}: P90 {part.p90_m:.2f} m, "
        f"{part.step_us:.0f} µs a frame, {part.process_bytes / MB:.0f} MB"
    )


# JSON ---------------------------------------------------------------------------------------------
def _plain(
    case: Case, parts: Sequence[Part], grown: Sequence[Growth], elapsed_s: float
) -> dict[str, Any]:
    return {
        "work": NAME,
        **case._asdict(),
        "parts": [_finite(part._asdict()) for part in parts],
        "growth": [_finite(each._asdict()) for each in grown],
        "elapsed_s": elapsed_s,
    }


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN and no infinity."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in fields.items()
    }


# Tables -------------------------------------------------------------------------------------------
_COLUMNS = (
    "km", "stands %", "P50 m", "P90 m", "max m", "NEES (2)", "PL m", "beyond %", "track %",
    "µs a frame", "memory kB", "process MB", "events",
)  # fmt: skip


def _print(
    console: Console, case: Case, parts: Sequence[Part], grown: Sequence[Growth], elapsed_s: float
) -> None:
    for with_map, word in ((False, "no map"), (True, "with a map")):
        if not any(part.with_map == with_map for part in parts):
            continue
        ride = f"{', '.join(case.lines)}, {case.hours:g} h at {case.frame_hz:g} Hz"
        title = f"{NAME}: {ride}, seed {case.seed}, {word}"
        table = Table(title=title, box=None, pad_edge=False, collapse_padding=True)
        table.add_column("part")
        for column in _COLUMNS:
            table.add_column(column, justify="right", no_wrap=True)
        for part in parts:
            if part.with_map == with_map:
                table.add_row(str(part.number), *_row(part))
        console.print(table, "")
    for each in grown:
        word = "with a map" if each.with_map else "no map"
        console.print(
            f"{word}: last part over first: core time {each.step:.2f}, memory of the processors "
            f"{each.memory:.2f}; process, last over second: {each.process:.2f}"
        )
    console.print(
        f"{elapsed_s:.0f} s. NEES: 2 is right. beyond: time beyond the protection level (claimed:\n"
        "0.1 %). memory: what the processors keep for a restart; process: resident, with the\n"
        "simulator and both filters. events: warnings and worse.",
        soft_wrap=True,
    )


def _row(part: Part) -> list[str]:
    return [
        f"{part.way_m / 1000:.1f}",
        f"{100 * part.standing_share:.0f}",
        f"{part.p50_m:.2f}",
        f"{part.p90_m:.2f}",
        f"{part.max_m:.1f}",
        f"{part.nees:.1f}",
        "" if part.protection_m is None else f"{part.protection_m:.1f}",
        _percent(part.beyond_share),
        _percent(part.right_track_share),
        f"{part.step_us:.0f}",
        f"{part.memory_bytes / KB:.0f}",
        f"{part.process_bytes / MB:.0f}",
        str(sum(part.raised.values())),
    ]


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.2f}"
