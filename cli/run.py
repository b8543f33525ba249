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
    """Run bridges, processors and recorder until Ctrl-C.

    Killed, it comes back by itself and takes over its nodes, which go on meanwhile; it says then
    how to end it. Ends with status 3 if messages are missing in the records, or may be.
    """
    import os
    import sys

    from msgspec.structs import replace

    from tramstream.cli.terminal.session import say, stop_on_signals
    from tramstream.config_file import load
    from tramstream.errors import DamagedRecordError
    from tramstream.supervision import vehicle as fleet
    from tramstream.supervision.roster import REST
    from tramstream.supervision.supervisor import Plan

    vehicle = load(config)
    if separate:
        vehicle = replace(vehicle, separate=vehicle.processors)
    # -P: what lies in the folder where somebody stood is no part of the program.
    command = [sys.executable, "-P", "-m", "tramstream.cli.main", "run", str(config.absolute())]
    options = [*(["--separate"] if separate else []), "--duration-s", REST]
    plan = Plan(vehicle, config, successor=(*command, *options))
    stop = stop_on_signals()
    with fleet.running(plan, say, stop) as run_:
        names = ", ".join(child.name for child in run_.children)
        if run_.took_over:
            say(
                f"vehicle {vehicle.vehicle}: process {os.getpid()} has taken over {names}; "
                f"`kill {os.getpid()}` ends it"
            )
        else:
            say(
                f"vehicle {vehicle.vehicle}: {names}; records in {vehicle.recorder.directory}; "
                "look with `tramstream top`"
            )
        run_.until(stop, duration_s)
    if run_.lost or run_.unheard:
        known = f"{run_.lost} messages are missing in the records of this run" if run_.lost else ""
        unknown = str(run_.unheard or "")
        raise DamagedRecordError(
            f"{vehicle.recorder.directory}: {'; '.join(filter(None, (known, unknown)))}",
            cure="`tramstream info` says what is in them, `tramstream report` which are missing",
        )
