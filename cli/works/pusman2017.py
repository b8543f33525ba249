"""`tramstream reproduce pusman2017`: stops, turns and places of simulated rides without GNSS."""

from __future__ import annotations

import json
import math
import time
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tramstream.analysis.segments import study
from tramstream.analysis.segments.rides import BUILT_IN
from tramstream.analysis.segments.study import WORLDS, Judged
from tramstream.cli.figures.options import Options
from tramstream.cli.terminal import pool
from tramstream.cli.terminal.pool import Job
from tramstream.cli.terminal.session import say
from tramstream.errors import ConfigError
from tramstream.machine import compilation
from tramstream.tracks import network as networks

NAME = "pusman2017"
WIDTH = 150
ANGLES_DEG = (15.0, 30.0, 60.0, 90.0, 180.0)
"""Borders of the table over the angle."""


def reproduce(options: Options) -> None:
    """Simulate, find, judge; what is done when a signal comes is printed."""
    jobs = _jobs(options)
    compilation.ensure(say)
    began_s = time.monotonic()
    found: list[Judged] = []
    for _, result in pool.results(jobs):
        for judged in result:
            say(study.line_of(judged))
            found.append(judged)
    found.sort(key=lambda each: (each.world, each.line, each.seed))
    if options.json:
        plain = {"rides": [_plain(each) for each in found], "worlds": _summaries(found)}
        print(json.dumps(plain | {"elapsed_s": time.monotonic() - began_s}))
    elif found:
        _print(Console(width=max(Console().width, WIDTH)), found)


def ride(world: str, line: str, seed: int, net: str, duration_s: float | None) -> list[Judged]:
    """One ride, in a process of the pool."""
    network = networks.load(Path(net)) if net else None
    return list(study.study([world], [line], [seed], network, duration_s))


def _jobs(options: Options) -> list[Job]:
    worlds = options.worlds or tuple(WORLDS)
    for world in worlds:
        if world not in WORLDS:
            raise ConfigError(f"no world is called {world!r}; there are: {', '.join(WORLDS)}")
    network = networks.load(options.network) if options.network is not None else None
    known = [BUILT_IN]
    if network is not None:
        known += [f"{each.line}/{each.direction}" for each in network.lines]
    for line in options.lines:
        if line not in known:
            raise ConfigError(f"no line is called {line!r}; there are: {', '.join(known)}")
    first = 1 if options.seed is None else options.seed
    net = str(options.network) if options.network is not None else ""
    return [
        Job(ride, (world, line, seed, net, options.duration_s))
        for world in worlds
        for line in options.lines or tuple(known)
        for seed in range(first, first + (options.seeds or 1))
    ]


def _plain(judged: Judged) -> dict[str, Any]:
    stops, turns, found = judged.stops, judged.turns, judged.found
    plain: dict[str, Any] = {
        "world": judged.world,
        "line": judged.line,
        "seed": judged.seed,
        "stops": {"hits": stops.hits, "missed": stops.missed, "false": stops.false},
        "turns": {"hits": turns.hits, "missed": turns.missed, "false": turns.false},
        "angle_error_deg": np.degrees(turns.angle_rad).tolist(),
        "radius_error": turns.all_radius.tolist(),
        "true_angle_deg": np.degrees(turns.true_angle_rad).tolist(),
        "true_radius_m": turns.true_radius_m.tolist(),
        "events": sorted(set(judged.events)),
    }
    if found is not None:
        plain["place"] = {
            name: (None if isinstance(value, float) and not math.isfinite(value) else value)
            for name, value in found._asdict().items()
            if name != "error_m"
        }
    return plain


def _summaries(found: Sequence[Judged]) -> dict[str, dict[str, Any]]:
    by_world: dict[str, list[Judged]] = defaultdict(list)
    for each in found:
        by_world[each.world].append(each)
    return {world: summary(rides) for world, rides in by_world.items()}


def summary(rides: Sequence[Judged]) -> dict[str, Any]:
    """Figures of all rides of a world together."""
    stops = [each.stops for each in rides]
    turns = [each.turns for each in rides]
    hits, missed = sum(s.hits for s in stops), sum(s.missed for s in stops)
    invented = sum(s.false for s in stops)
    seen, unseen = sum(t.hits for t in turns), sum(t.missed for t in turns)
    angle = np.degrees(np.concatenate([t.angle_rad for t in turns]))
    radius = np.concatenate([t.radius for t in turns])
    true = np.degrees(np.abs(np.concatenate([t.true_angle_rad for t in turns])))
    every = np.concatenate([t.all_radius for t in turns])
    made: dict[str, Any] = {
        "rides": len(rides),
        "stops_f1": 2 * hits / max(2 * hits + missed + invented, 1),
        "turn_recall": seen / max(seen + unseen, 1),
        "turns_invented": sum(t.false for t in turns),
        "angle_rms_deg": float(np.sqrt(np.mean(angle**2))) if len(angle) else 0.0,
        "radius_within_5_percent": float(np.mean(np.abs(radius) <= 0.05)) if len(radius) else None,
        "radius_rms": float(np.sqrt(np.mean(radius**2))) if len(radius) else 0.0,
        "over_angle": [
            {
                "from_deg": low,
                "to_deg": high,
                "turns": int(np.sum(inside)),
                "angle_rms_deg": _rms(angle[inside]),
                "radius_rms": _rms(every[inside]),
            }
            for low, high in pairwise(ANGLES_DEG)
            for inside in [(true >= low) & (true < high)]
        ],
    }
    places = [each.found for each in rides if each.found is not None]
    if places:
        made |= {
            "within_3_m": float(np.mean([p.share_3_m for p in places])),
            "within_10_m": float(np.mean([p.share_10_m for p in places])),
            "within_30_m": float(np.mean([p.share_30_m for p in places])),
            "first_right": float(np.mean([p.first_right for p in places])),
            "first_in_1_km": float(np.mean([p.first_right and p.first_m <= 1000 for p in places])),
            "right_line_from_half": float(np.mean([p.half_right for p in places])),
            "within_3_sigma": float(np.mean([p.near for p in places])),
        }
    return made


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _print(console: Console, found: Sequence[Judged]) -> None:
    table = Table(title="tramstream reproduce pusman2017", box=None, header_style="bold")
    heads = ("world", "rides", "stops F1", "turns", "angle", "radius 5 %", "3 m", "10 m", "30 m")
    for head in (*heads, "first right", "in 1 km", "line", "3 σ"):
        table.add_column(head, justify="left" if head == "world" else "right", no_wrap=True)
    for world, made in _summaries(found).items():
        row = [world, f"{made['rides']}", f"{made['stops_f1']:.3f}", f"{made['turn_recall']:.3f}"]
        within = made["radius_within_5_percent"]
        row += [f"{made['angle_rms_deg']:.2f}°", "" if within is None else f"{within:.3f}"]
        for name in ("within_3_m", "within_10_m", "within_30_m", "first_right", "first_in_1_km"):
            row.append(f"{made[name]:.3f}" if name in made else "")
        for name in ("right_line_from_half", "within_3_sigma"):
            row.append(f"{made[name]:.3f}" if name in made else "")
        table.add_row(*row)
    console.print(table)
