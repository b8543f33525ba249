"""Options that several verbs share; light, because verbs' modules are all imported for `--help`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Format(StrEnum):
    """How figures are printed."""

    text = "text"
    json = "json"


KeyArgument = Annotated[
    str,
    typer.Argument(
        metavar="KEY", help="Path (raw/gnss/fix), expression ('raw/gnss/*', 'raw/**') or full key."
    ),
]
FileOption = Annotated[
    Path | None,
    typer.Option("--file", help="Look into this record, or folder of one, instead of the bus."),
]
VehicleOption = Annotated[
    str, typer.Option("--vehicle", help="Where several are on the bus, or in a folder.")
]
FormatOption = Annotated[Format, typer.Option("--format", help="What to print.")]
JsonOption = Annotated[bool, typer.Option("--json", help="The same as --format json.")]
WindowOption = Annotated[
    float,
    typer.Option("--window-s", help="Live figures are of the last so many seconds.", min=1.0),
]
