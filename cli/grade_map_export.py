"""`tramstream grade-map export MAP.parquet --geojson|--osm|--railml OUT`: grades for others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    grades: Annotated[Path, typer.Argument(metavar="MAP.parquet", help="Of `grade-map build`.")],
    geojson: Annotated[Path | None, typer.Option(help="One line a cell, in %.")] = None,
    osm: Annotated[
        Path | None, typer.Option(help="OSM XML: ways with `incline`, for an editor to merge.")
    ] = None,
    railml: Annotated[
        Path | None, typer.Option(help="railML 2.2: gradient changes of tracks, per mille.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the outputs.")] = False,
) -> None:
    """Write a grade map for maps and planning tools."""
    from tramstream.analysis.grade_map import export as formats
    from tramstream.analysis.grade_map import file
    from tramstream.cli.terminal.page_file import make_place, write
    from tramstream.errors import ConfigError
    from tramstream.shown import shown

    wanted = [
        (path, option, make)
        for path, option, make in (
            (geojson, "--geojson", formats.geojson),
            (osm, "--osm", formats.osm),
            (railml, "--railml", formats.railml),
        )
        if path is not None
    ]
    if not wanted:
        raise ConfigError("nothing to write", cure="name --geojson, --osm or --railml with a file")
    for path, option, _ in wanted:
        make_place(path, [grades], overwrite, option)
    made = file.read(grades)
    for path, _, make in wanted:
        write(path, make(made))
        print(shown(str(path)))
