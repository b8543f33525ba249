"""`tramstream config FILE`: the configuration that a record was made with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def config(
    file: Annotated[
        Path,
        typer.Argument(help="Record, a folder with the parts of one, or a configuration (.toml)."),
    ],
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print the configuration in a record, as `reprocess --config` and `run` take it.

    Every setting is written out, with the value that it had.
    """
    from tramstream import config_file
    from tramstream.recorder.reader import open_record
    from tramstream.recorder.reprocess.run import vehicle_of

    if file.suffix == ".toml":
        vehicle = config_file.load(file)
    else:
        with open_record(file, any_schema=True) as record:
            vehicle = vehicle_of(record, file)
    print(config_file.to_json(vehicle) if json_ else config_file.to_toml(vehicle), end="")
    if json_:
        print()
