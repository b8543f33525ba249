"""`tramstream node NAME CONFIG`: one node in this process, as the service units start it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def node(
    name: Annotated[str, typer.Argument(help="recorder, processors, gnss, imu, odometer, router …")],
    config: Annotated[Path, typer.Argument(help="Vehicle configuration.")],
    supervised: Annotated[
        bool, typer.Option("--supervised", hidden=True, help="End when standard input ends.")
    ] = False,
) -> None:
    """Run one node."""
    import os
    import threading

    from tramstream import registry
    from tramstream.bus import ZenohBus
    from tramstream.cli.session import stop_on_signals
    from tramstream.clock import VehicleClock
    from tramstream.config import load
    from tramstream.supervisor import RouterNode

    vehicle = load(config)
    stop = stop_on_signals()
    if supervised:

        def watch_parent() -> None:
            while os.read(0, 1024):  # not sys.stdin: its lock would outlive the main thread
                pass
            stop.set()

        threading.Thread(target=watch_parent, name="parent", daemon=True).start()
    clock = VehicleClock.shared(vehicle.runtime_dir)
    if name == "router":
        bus = ZenohBus.route(vehicle.runtime_dir, clock)
    else:
        bus = ZenohBus.connect(vehicle.runtime_dir, clock, stop)
    try:
        if name == "router":
            RouterNode(vehicle.vehicle, bus, stop).run()
        else:
            registry.make_node(name, vehicle, bus, stop).run()
    finally:
        bus.close()
