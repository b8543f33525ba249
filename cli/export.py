"""`tramstream export FILE`: a record for spreadsheets, maps, notebooks and other people's tools."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.recorder.exports.window import Window
    from tramstream.recorder.reader import Record


def export(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="A record, its parts, or a folder.")
    ],
    csv: Annotated[
        Path | None,
        typer.Option("--csv", help="A folder that gets a table a key, or with --key a .csv file."),
    ] = None,
    parquet: Annotated[
        Path | None,
        typer.Option("--parquet", help="The same as Parquet: a folder, or a .parquet file."),
    ] = None,
    mat: Annotated[
        Path | None, typer.Option("--mat", help="A .mat file: a struct a key, a field a column.")
    ] = None,
    geojson: Annotated[
        Path | None, typer.Option("--geojson", help="A file that gets the track and its points.")
    ] = None,
    geoparquet: Annotated[
        Path | None, typer.Option("--geoparquet", help="A file that gets the points, for QGIS.")
    ] = None,
    gpx: Annotated[
        Path | None, typer.Option("--gpx", help="A file that gets the track, with times.")
    ] = None,
    kml: Annotated[
        Path | None, typer.Option("--kml", help="A file that gets the track, for Google Earth.")
    ] = None,
    tum: Annotated[
        Path | None,
        typer.Option("--tum", help="A folder that gets the poses of a key, or with --key a file."),
    ] = None,
    key: Annotated[
        str, typer.Option("--key", help="Only these keys, e.g. raw/gnss/fix or raw/**.")
    ] = "",
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", help="Of each key at most so many a second.", min=0.0)
    ] = 0.0,
    start_s: Annotated[float, typer.Option("--start-s", help="Seconds to skip.", min=0.0)] = 0.0,
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="Seconds to export; 0 is all.", min=0.0)
    ] = 0.0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that are there.")
    ] = False,
) -> None:
    """Write tables (CSV, Parquet, .mat), tracks (GeoJSON, GeoParquet, GPX, KML) or poses (TUM).

    Columns carry their units in their names. Inertial batches become one row a sample, in SI units.
    """
    from tramstream.errors import DamagedRecordError, RecordError
    from tramstream.recorder.exports.window import Window
    from tramstream.recorder.reader import open_record

    wanted: dict[Callable[[Record, Path, Window], list[Path]], Path | None] = {
        _csv: csv, _parquet: parquet, _mat: mat, _geojson: geojson, _geoparquet: geoparquet,
        _gpx: gpx, _kml: kml, _tum: tum,
    }  # fmt: skip
    chosen = {write: out for write, out in wanted.items() if out is not None}
    if not chosen:
        raise RecordError(
            "export: nothing to write; add one of --csv, --parquet, --mat, --geojson, "
            "--geoparquet, --gpx, --kml, --tum with a name"
        )
    window = Window(key, start_s, duration_s, rate_hz)
    with open_record(files) as record:
        for out in chosen.values():
            _make_room(out, files, overwrite)
        for write, out in chosen.items():
            for path in write(record, out, window):
                print(_shown(path))
        damaged, left_out = record.damaged, record.left_out
    if damaged:
        raise DamagedRecordError(f"{damaged}; what could be proved right was exported")
    if left_out:
        raise DamagedRecordError(left_out)


def _make_room(out: Path, sources: list[Path], overwrite: bool) -> None:
    """Nothing is written over what is there, unless somebody says so, and never over a source."""
    from tramstream.cli.terminal.session import make_room
    from tramstream.errors import ConfigError

    if out.is_dir():
        if any(out.iterdir()) and not overwrite:
            raise ConfigError(f"{out}: is a folder with files in it", cure="add --overwrite")
        return
    make_room(out, sources, overwrite)
    if out.exists():
        raise ConfigError(f"{out}: exists already", cure="choose another name or add --overwrite")
    out.parent.mkdir(parents=True, exist_ok=True)


def _shown(path: Path) -> str:
    from tramstream.shown import shown

    return shown(str(path))


def _csv(record: Record, out: Path, window: Window) -> list[Path]:
    from rich.console import Console
    from rich.progress import Progress

    from tramstream.recorder.exports.csv_tables import export_csv

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("export", total=None)
        return export_csv(record, out, window, lambda n: progress.advance(task, n))


def _parquet(record: Record, out: Path, window: Window) -> list[Path]:
    from tramstream.recorder.exports.arrays import write_parquet

    return write_parquet(record, out, window)


def _mat(record: Record, out: Path, window: Window) -> list[Path]:
    from tramstream.recorder.exports.arrays import write_mat

    write_mat(record, out, window)
    return [out]


def _geoparquet(record: Record, out: Path, window: Window) -> list[Path]:
    from tramstream.recorder.exports.arrays import write_geoparquet

    write_geoparquet(record, out, window)
    return [out]


def _geojson(record: Record, out: Path, window: Window) -> list[Path]:
    import json

    from tramstream.recorder.exports.geojson import geojson

    return _text(out, json.dumps(geojson(record, window)))


def _gpx(record: Record, out: Path, window: Window) -> list[Path]:
    from tramstream.recorder.exports.tracks import gpx

    return _text(out, gpx(record, window))


def _kml(record: Record, out: Path, window: Window) -> list[Path]:
    from tramstream.recorder.exports.tracks import kml

    return _text(out, kml(record, window))


def _tum(record: Record, out: Path, window: Window) -> list[Path]:
    """A file for each key; one file where one key is meant."""
    from tramstream.recorder.exports.poses import tum

    found = tum(record, window)
    if len(found) == 1 and out.suffix:
        return _text(out, *found.values())
    out.mkdir(parents=True, exist_ok=True)
    return [
        path
        for name, text in found.items()
        for path in _text(out / f"{name.replace('/', '_')}.tum", text)
    ]


def _text(out: Path, text: Any) -> list[Path]:
    from tramstream.cli.terminal.page_file import write

    write(out, text)
    return [out]
