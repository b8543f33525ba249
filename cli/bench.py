"""`tramstream bench`: how fast this machine runs each stage, and what margin it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def bench(
    live_s: Annotated[
        float, typer.Option("--live-s", help="Length of the live run; 0 leaves it out.", min=0.0)
    ] = 20.0,
    ubx: Annotated[
        Path | None, typer.Option(help="Receiver capture to frame and decode, not simulated bytes.")
    ] = None,
    net: Annotated[
        Path | None, typer.Option(help="Track network with lines: measure matching on it.")
    ] = None,
    only: Annotated[str, typer.Option(help="Run only stages whose name contains this.")] = "",
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Measure every stage on this machine, and the whole pipeline live on simulated devices.

    Rates are medians over repeated runs of one process. The live run is the demo's: 2 kHz IMU,
    50 Hz odometry, 5 Hz GNSS.
    """
    import json

    from tramstream.cli.figures import bench_filter, bench_stages
    from tramstream.cli.figures.bench_live import bus_round_trip, live_pipeline
    from tramstream.cli.figures.bench_stages import Figure
    from tramstream.cli.terminal.session import say

    figures: list[Figure] = []
    for name, measure in (bench_stages.STAGES | bench_filter.STAGES).items():
        if only in name:
            say(f"{name} …")
            figures += bench_stages.ubx(ubx) if name == "ubx" else measure()
    if net is not None and only in "map":
        from tramstream.cli.figures import bench_map

        say("map …")
        figures += bench_map.measure(net)
    if only == "grade-map":  # half a minute, and nothing of the vehicle's
        from tramstream.cli.figures import bench_grade_map

        say("grade-map …")
        figures += bench_grade_map.measure()
    if only == "page":  # over a minute, and a hundred browsers
        from tramstream.cli.figures import bench_page

        say("page …")
        figures += bench_page.measure()
    if only in "bus":
        say("bus …")
        figures += bus_round_trip()
    if live_s > 0 and only in "live reprocess":
        say(f"live pipeline, {live_s:g} s …")
        figures += live_pipeline(live_s)
    if json_:
        print(json.dumps({figure.name: figure.value for figure in figures}))
        return

    from rich.console import Console
    from rich.table import Table

    table = Table(title="tramstream bench")
    for column in ("figure", "value", "goal", ""):
        table.add_column(column, justify="right" if column in ("value", "goal") else "left")
    for figure in figures:
        verdict = "" if figure.goal is None else ("met" if figure.met else "[red]missed[/red]")
        sign = "≥" if figure.more_is_better else "≤"
        goal = "" if figure.goal is None else f"{sign} {figure.goal:g}"
        table.add_row(figure.name, f"{figure.value:,.4g}", goal, verdict)
    Console().print(table)
