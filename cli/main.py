"""`tramstream`: finds its verbs by entry point, one verb per file; a group of verbs is a typer app.

A verb's module imports nothing heavy; what it needs it imports inside. Errors of
`tramstream.errors` become one sentence on standard error and the exit status of the type:
0 done, 1 the check does not hold, 2 bad usage or configuration, 3 data lost or damaged.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from importlib.metadata import entry_points
from typing import Any, NoReturn

import typer

from tramstream import __version__
from tramstream.cli.ending import Ending, until_ended
from tramstream.errors import TramstreamError
from tramstream.shown import shown
from tramstream.transport import zenoh_threads

LEAVE_S = 1.0
CTRL_C = 130
"""What typer ends with after a KeyboardInterrupt, whatever signal that was."""

PANELS = {
    "On the vehicle": ("demo", "init", "doctor", "run", "node", "record"),
    "Looking": ("top", "live", "list", "echo", "hz", "bw", "info", "config"),
    "Records": ("replay", "reprocess", "import", "export", "recover", "simulate"),
    "Map": ("map", "grade-map", "learn-line"),
    "Figures": ("evaluate", "segments", "report", "reproduce", "bench"),
}


def _version(wanted: bool) -> None:
    if wanted:
        print(f"tramstream {__version__}")
        raise typer.Exit


def _callback(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Localisation stack of a tram's onboard computer.

    GNSS, IMU and wheels in; position, keys to watch and a replayable record out.
    Start with `tramstream demo`.
    """


def make_app(only: str = "") -> typer.Typer:
    """The program with every verb that is installed, or with verb `only` if there is one."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode="rich",
    )
    app.callback()(_callback)
    verbs: dict[str, Any] = {point.name: point for point in entry_points(group="tramstream.verbs")}
    if only in verbs:  # a node that starts again need not load the other twenty
        verbs = {only: verbs[only]}
    panel_of = {verb: panel for panel, names in PANELS.items() for verb in names}
    order = [*panel_of, *sorted(set(verbs) - set(panel_of))]
    for name in order:
        if name not in verbs:
            continue
        verb = verbs[name].load()
        if isinstance(verb, typer.Typer):
            app.add_typer(verb, name=name, rich_help_panel=panel_of.get(name))
        else:
            app.command(name, rich_help_panel=panel_of.get(name))(verb)
    return app


def main(ending: Ending | None = None) -> NoReturn:
    """Run what the command line says, and end the program.

    Parameters
    ----------
    ending : Ending or None
        Which signal has ended the program; None where nobody listens to any but Ctrl-C.
    """
    interrupted = ending or Ending()
    try:
        make_app(sys.argv[1] if len(sys.argv) > 1 else "")()
    except TramstreamError as error:
        print(shown(f"tramstream: {error}"), file=sys.stderr)
        leave(error.exit_status)
    except KeyboardInterrupt:
        leave(interrupted.status)
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            leave(0)  # the reader of our output has gone: `tramstream echo … | head`
        if end.code == CTRL_C:
            leave(interrupted.status)
        if end.code is None or isinstance(end.code, int):
            leave(end.code or 0)
        raise
    leave(0)


def leave(status: int) -> NoReturn:
    """End the program once the bus' threads have ended; without taking it down if one stays.

    Raises
    ------
    SystemExit
        With `status`.
    """
    if not zenoh_threads.ended(LEAVE_S):
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    until_ended(main)
