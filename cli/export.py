"""`tramstream export FILE`: a record for spreadsheets and maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tramstream.recorder.reader import Record


def export(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="A record, its parts, or a folder.")
    ],
    csv: Annotated[
        Path | None,
        typer.Option("--csv", help="A folder that gets a table a key, or with --key a .csv file."),
    ] = None,
    geojson: Annotated[
        Path | None, typer.Option("--geojson", help="A file that gets the track and its points.")
    ] = None,
    key: Annotated[
        str, typer.Option("--key", help="Keys for --csv, e.g. raw/gnss/fix or raw/**.")
    ] = "",
) -> None:
    """Write tables (--csv) or the track (--geojson)."""
    from tramstream.errors import DamagedRecordError, RecordError
    from tramstream.recorder.reader import open_record

    if csv is None and geojson is None:
        raise RecordError("export: nothing to write; add --csv OUT or --geojson OUT")
    with open_record(files) as record:
        if csv is not None:
            _csv(record, csv, key)
        if geojson is not None:
            _geojson(record, geojson)
        damaged, left_out = record.damaged, record.left_out
    if damaged:
        raise DamagedRecordError(f"{damaged}; what could be proved right was exported")
    if left_out:
        raise DamagedRecordError(left_out)


def _csv(record: Record, out: Path, key: str) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from tramstream.recorder.csv_tables import export_csv
    from tramstream.shown import shown

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("export", total=None)
        for path in export_csv(record, out, key, lambda n: progress.advance(task, n)):
            print(shown(str(path)))


def _geojson(record: Record, out: Path) -> None:
    import json

    from tramstream.cli.terminal.page_file import write
    from tramstream.recorder.geojson import geojson

    write(out, json.dumps(geojson(record)))
    print(out)
