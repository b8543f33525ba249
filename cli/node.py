"""`tramstream node NAME CONFIG`: one node in this process, as the service units start it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def node(
    name: Annotated[
        str, typer.Argument(help="recorder, processors, gnss, imu, odometer, router …")
    ],
    config: Annotated[Path, typer.Argument(help="Vehicle configuration.")],
) -> None:
    """Run one node."""
    from tramstream import plugins
    from tramstream.cli.terminal.session import say, stop_on_signals
    from tramstream.live import registry
    from tramstream.machine import compilation
    from tramstream.supervision.process import run_node

    stop = stop_on_signals()
    if name in (registry.PROCESSORS, *plugins.names("processors")):
        compilation.ensure(say, stop=stop)
    run_node(name, config, stop)
