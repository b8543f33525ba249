"""`tramstream reproduce NAME`: the figures of a work beside ours, or ours of a study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from tramstream.cli.figures.options import Options

PUBLISHED = ("konecny2004", "kaspar2023", "chladek2023", "melenovsky2023", "pusman2017")
WORKS = (
    *PUBLISHED,
    *("drives", "matching", "receivers", "worlds", "day", "allan", "endurance", "grade"),
)


def reproduce(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(WORKS)}.")],
    seed: Annotated[
        int | None, typer.Option(help="Of the random numbers; of the first ride.", min=0)
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            help="Rides of each kind (kaspar2023, default 5), line (matching, default 10), world "
            "(worlds, grade, default 1) or profile's average (chladek2023, default 300 and 60); "
            "records (allan, default 20; melenovsky2023, default 20, and 100 mountings).",
            min=1,
        ),
    ] = None,
    line: Annotated[
        list[str] | None,
        typer.Option(
            help="kaspar2023: FILE.geojson, FILE.geojson#LINE/DIRECTION, or built-in (the "
            "default). chladek2023: FILE.geojson with lines 7 and 20; default "
            "../shared/data/maps/prague/lines_7_20.geojson. matching: LINE/DIRECTION or LINE; "
            "default all of the network. worlds: as matching with --net (default 7/0), else as "
            "kaspar2023. day: default 7/0 and 7/1. grade: as kaspar2023. May be given "
            "several times.",
            metavar="LINE",
        ),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            help="kaspar2023: two wheels, one wheel, slip, white, exact map, map nodes 0.2 m, "
            "allan (sensors at rest); default all. matching: plain (the default), slow or gyro. "
            "day: no map, map; default both. melenovsky2023: work, model (with the work's own), "
            "mountings, reference, cross-level, body; default all. May be given several times.",
        ),
    ] = None,
    duration_s: Annotated[
        float,
        typer.Option(
            "--duration-s",
            help="kaspar2023, matching, grade: end rides early; 0 is never. worlds: default 300.",
            min=0,
        ),
    ] = 0.0,
    data: Annotated[
        Path | None,
        typer.Option(
            help="drives, receivers, endurance: where they are; default ../shared/data/drives, "
            "../shared/data/ubx, ../shared/data.",
            metavar="DIR",
        ),
    ] = None,
    mappings: Annotated[
        Path | None, typer.Option(help="drives: of mapping files; default mappings.", metavar="DIR")
    ] = None,
    net: Annotated[
        Path | None,
        typer.Option(help="matching, worlds, day: file of the track network.", metavar="FILE"),
    ] = None,
    detours: Annotated[
        int | None, typer.Option(help="matching: detours of the lines; default 20.", min=0)
    ] = None,
    world: Annotated[
        list[str] | None,
        typer.Option(help="worlds, grade: which; default all. May be given several times."),
    ] = None,
    hours: Annotated[
        float | None,
        typer.Option(
            help="day, allan, endurance: of which length; default 8, 6, 24.", min=0.1, max=24.0
        ),
    ] = None,
    frame_hz: Annotated[
        float | None,
        typer.Option("--frame-hz", help="day: frames a second; default 100.", min=10, max=100),
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate-hz", help="allan: samples a second; default 2000.", min=1, max=2000),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(help="endurance: times real time; default 20.", min=1.0, max=100.0),
    ] = None,
    capture: Annotated[
        Path | None,
        typer.Option(help="endurance: of a receiver, instead of DATA's.", metavar="FILE"),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Reproduce the figures of a published work, ours on the real drives, of the map
    matcher, of captured receivers, of the localisation in many worlds or on a day of eight
    hours, of noise estimated from simulated standstill, of the slope, or whether a running
    vehicle grows or loses anything in a day."""
    from importlib import import_module

    from tramstream.errors import ConfigError

    if name not in WORKS:
        raise ConfigError(f"no work is called {name!r}; there are: {', '.join(WORKS)}")
    lines, kinds = tuple(line or ()), tuple(kind or ())
    options = Options(seed, seeds, lines, duration_s or None, json_, data, mappings, kinds)
    options = replace(options, network=net, detours=detours, worlds=tuple(world or ()), hours=hours)
    options = replace(options, frame_hz=frame_hz, rate_hz=rate_hz, pace=pace, capture=capture)
    module = f"works.{name}" if name in PUBLISHED else f"figures.reproduce_{name}"
    import_module(f"tramstream.cli.{module}").reproduce(options)
