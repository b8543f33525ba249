"""`tramstream map`: the track network; its verbs are one per file, like all others."""

from __future__ import annotations

import typer

from tramstream.cli.map_build import build
from tramstream.cli.map_info import info
from tramstream.cli.map_match import match

app = typer.Typer(no_args_is_help=True, help="Build, look at and use a network of tracks.")
app.command("build")(build)
app.command("info")(info)
app.command("match")(match)
