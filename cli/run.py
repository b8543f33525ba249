"""`tramstream run CONFIG`: everything on the vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def run(
    config: Annotated[
        Path, typer.Argument(help="Vehicle configuration; `tramstream init` writes one.")
    ],
    separate: Annotated[
        bool, typer.Option("--separate", help="Give each processor a process of its own.")
    ] = False,
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="End after so many seconds; 0 is never.")
    ] = 0.0,
) -> None:
    """Run bridges, processors and recorder until Ctrl-C."""
    from tramstream.cli import fleet
    from tramstream.cli.session import say, stop_on_signals
    from tramstream.config import load

    vehicle = load(config)
    stop = stop_on_signals()
    with fleet.running(vehicle, config, say, separate) as run_:
        say(
            f"vehicle {vehicle.vehicle}: {', '.join(child.name for child in run_.children)}; "
            f"records in {vehicle.recorder.directory}; look with `tramstream top`"
        )
        run_.until(stop, duration_s)
