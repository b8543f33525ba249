"""`tramstream record [CONFIG]`: only the recorder, beside a running vehicle or a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def record(
    config: Annotated[
        Path | None,
        typer.Argument(help="Vehicle configuration; without one, the bus of this user."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the records; default as configured.")
    ] = None,
    vehicle: Annotated[str, typer.Option(help="Vehicle to record, if several are there.")] = "",
    keys: Annotated[str, typer.Option("--keys", help="Only keys in this expression.")] = "**",
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="End after so many seconds; 0 is never.", min=0.0)
    ] = 0.0,
) -> None:
    """Record what is on the bus until Ctrl-C."""
    import threading

    import msgspec

    from tramstream.cli.terminal.session import client, say, stop_on_signals, vehicle_on
    from tramstream.config import Recorder
    from tramstream.config_file import RECORD_ENTRY, load, to_json
    from tramstream.recorder.node import RecorderNode
    from tramstream.tracks.grades import GRADES_ENTRY, held_to

    loaded = load(config) if config is not None else None
    settings = loaded.recorder if loaded is not None else Recorder()
    if out is not None:
        settings = msgspec.structs.replace(settings, directory=str(out))
    stop = stop_on_signals()
    with client(vehicle, loaded.runtime_dir if loaded is not None else None) as bus:
        name = vehicle or (loaded.vehicle if loaded is not None else vehicle_on(bus))
        metadata: dict[str, str] = {}
        if loaded is not None:
            metadata = {RECORD_ENTRY: to_json(loaded), GRADES_ENTRY: held_to(loaded)}
        if duration_s:
            threading.Timer(duration_s, stop.set).start()
        node = RecorderNode(name, bus, stop, settings, metadata, keys)
        say(f"recording {name} into {settings.directory}; Ctrl-C ends")
        node.run()
        ledger = node.ledgers()[0]
        say(f"{ledger.delivered} messages recorded, {ledger.dropped} not; {node.losses.total} lost")
