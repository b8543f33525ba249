"""`tramstream grade-map`: slopes of tracks from many rides; its verbs are one per file."""

from __future__ import annotations

import typer

from tramstream.cli.grade_map_build import build
from tramstream.cli.grade_map_export import export
from tramstream.cli.grade_map_show import show

app = typer.Typer(no_args_is_help=True, help="Make and look at a map of the tracks' grades.")
app.command("build")(build)
app.command("show")(show)
app.command("export")(export)
