"""`tramstream top`: one screen for ssh, every key, node and device of a vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from tramstream.cli.terminal.options import JsonOption, VehicleOption

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from tramstream.monitor.board import Board
    from tramstream.monitor.watch import Watch
    from tramstream.transport.bus import Bus

LISTEN_S = 2.5
"""Two heartbeats of each node: its processor share is told by their difference."""
REFRESH_S = 0.25
POLL_S = 0.05


def top(
    vehicle: VehicleOption = "",
    once: Annotated[
        bool, typer.Option("--once", help="Print one screen and end: for scripts and logs.")
    ] = False,
    json_: JsonOption = False,
    listen_s: Annotated[
        float, typer.Option("--listen-s", help="With --once: how long to listen first.", min=0.1)
    ] = LISTEN_S,
) -> None:
    """Show every key with rate, age, losses and last value, and the health of nodes and devices.

    What is yellow is late, slow or lossy; what is red is gone. The key q or Ctrl-C ends it.
    """
    import sys

    from tramstream.cli.terminal import session
    from tramstream.cli.terminal.keyboard import Keyboard
    from tramstream.monitor.watch import Watch

    stop = session.stop_on_signals()
    with session.client(vehicle) as bus:
        chosen = session.vehicle_on(bus, vehicle)
        if once or json_ or not sys.stdout.isatty():
            _once(Watch(bus, chosen), stop.wait, listen_s, json_)
            return
        with live_screen(bus, chosen) as refresh, Keyboard() as keyboard:
            while not stop.is_set() and keyboard.pressed() != "q":
                refresh()
                stop.wait(POLL_S)


def render(board: Board, title: str = "", height: int = 0) -> RenderableType:
    """The screen of a vehicle; with a `height` no more lines than that."""
    from tramstream.cli.monitor.screen import Screen

    return Screen(board, title, height)


@contextmanager
def live_screen(
    bus: Bus, vehicle: str, title: str = "", console: Console | None = None
) -> Iterator[Callable[[], None]]:
    """The terminal's alternate screen; call what it gives often, it refreshes at 4 Hz."""
    import time

    from rich import get_console
    from rich.live import Live

    from tramstream.monitor.watch import Watch

    watch = Watch(bus, vehicle)
    console = console or get_console()
    due_s = 0.0
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def refresh() -> None:
            nonlocal due_s
            if time.monotonic() < due_s:
                return
            due_s = time.monotonic() + REFRESH_S
            live.update(render(watch.board(), title, console.size.height), refresh=True)

        try:
            yield refresh
        finally:
            watch.close()


def _once(watch: Watch, wait: Callable[[float], object], listen_s: float, as_json: bool) -> None:
    """Listen, then print one screen, or one object with the same."""
    import io
    import shutil
    import sys

    from rich.console import Console

    from tramstream.cli.monitor.source import line

    wait(listen_s)
    found = watch.board()
    if as_json:
        print(line(found.as_dict()))
        return
    colour = sys.stdout.isatty()
    text = io.StringIO()
    width = shutil.get_terminal_size((160, 50)).columns
    console = Console(file=text, width=width, force_terminal=colour, highlight=False)
    console.print(render(found), end="")
    print(text.getvalue(), end="")
