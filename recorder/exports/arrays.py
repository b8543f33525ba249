"""Keys of a record as columns: Parquet for pandas, DuckDB and MATLAB, GeoParquet for QGIS, .mat.

The columns are those of `tramstream.open_record(FILE)[KEY]`, names with their units; a batch of
inertial samples becomes one row a sample, in SI units.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.exports.inertial import spread
from tramstream.recorder.exports.places import positions
from tramstream.recorder.exports.window import Window
from tramstream.recorder.message_columns import Columns, Span, read_columns
from tramstream.recorder.reader import Record

MAT_NAME = 63
"""Longest name of a variable or field in MATLAB."""
WGS84_3D = "EPSG:4979"

Table = dict[str, NDArray[Any]]


def tables(record: Record, window: Window) -> dict[str, Table]:
    """Columns by key; lists of different lengths are left out, they have no place in a table.

    Raises
    ------
    RecordError
        If no key is meant, or none has messages.
    """
    topics = [t for t, info in record.channels.items() if info.count and window.means(t)]
    if not topics:
        raise RecordError(
            f"{record.paths[0]}: has no key {window.key or 'at all'}; see `tramstream info`"
        )
    span = Span(*window.span(record))
    read = read_columns(record, dict.fromkeys(topics, ()), span)
    found = {}
    for topic, columns in read.items():
        table = spread(columns) if columns.type == ImuBatch.DESCRIPTOR.full_name else _flat(columns)
        rows = _thinned(table, window)
        if rows is not None:
            table = {name: column[rows] for name, column in table.items()}
        found[keys.split(topic)[1] or topic] = table
    return found


def _thinned(table: Table, window: Window) -> NDArray[np.intp] | None:
    """Rows of a grid of `rate_hz`; None: all."""
    arrival = table.get("log_ns")
    if not window.rate_hz or arrival is None or not len(arrival):
        return None
    cell = np.floor((arrival - arrival[0]) * (window.rate_hz / 1e9)).astype(np.int64)
    return np.flatnonzero(np.diff(cell, prepend=-1) > 0)


def _flat(columns: Columns) -> Table:
    """One-dimensional columns; of an array column one for each element, enumerations by name."""
    found: Table = {}
    for name in columns:
        values = columns[name]
        if values.ndim > 1:
            found |= {f"{name}.{index}": each for index, each in enumerate(values.T)}
        elif values.dtype != object or isinstance(next(iter(values), ""), str | bytes | None):
            found[name] = _named(columns, name, values)
    return found


def _named(columns: Columns, name: str, values: NDArray[Any]) -> NDArray[Any]:
    try:
        return columns.names(name)
    except LookupError:
        return values


# Parquet ------------------------------------------------------------------------------------------
def write_parquet(record: Record, out: Path, window: Window) -> list[Path]:
    """A file a key in folder `out`; or with one key, `out` itself."""
    pa, parquet = _pyarrow()
    found = tables(record, window)
    single = out.suffix == ".parquet"
    if single and len(found) > 1:
        raise RecordError(f"{out}: one file holds one key, {len(found)} are meant; add --key")
    if not single:
        out.mkdir(parents=True, exist_ok=True)
    written = []
    for key, table in found.items():
        path = out if single else out / f"{key.replace('/', '_')}.parquet"
        arrays = {name: pa.array(_plain(column)) for name, column in table.items()}
        _put(parquet, pa.table(arrays), path)
        written.append(path)
    return written


def write_columns(columns: Mapping[str, Any], out: Path) -> None:
    """One table that is there already."""
    pa, parquet = _pyarrow()
    _put(parquet, pa.table(dict(columns)), out)


def write_geoparquet(record: Record, out: Path, window: Window) -> None:
    """All positions as points (GeoParquet 1.1), with key, time and deviations."""
    pa, parquet = _pyarrow()
    rows = [
        (topic, place) for topic, places in positions(record, window).items() for place in places
    ]
    heights = all(math.isfinite(place.height_m) for _, place in rows)
    points = [
        struct.pack("<BIddd", 1, 1001, place.longitude_deg, place.latitude_deg, place.height_m)
        if heights
        else struct.pack("<BIdd", 1, 1, place.longitude_deg, place.latitude_deg)
        for _, place in rows
    ]
    columns = {
        "key": [topic for topic, _ in rows],
        "stamp_ns": [place.stamp_ns for _, place in rows],
        "horizontal_std_m": [place.horizontal_std_m for _, place in rows],
        "vertical_std_m": [place.vertical_std_m for _, place in rows],
        "geometry": points,
    }
    geometry: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": ["Point Z" if heights else "Point"],
    }
    if heights:
        geometry["crs"] = _crs(WGS84_3D)  # absent means longitude and latitude alone
    told = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}
    table = pa.table(columns).replace_schema_metadata({"geo": json.dumps(told)})
    _put(parquet, table, out)


def _crs(name: str) -> dict[str, Any]:
    """A coordinate system as PROJJSON, as short as it may be: WGS 84, longitude first."""
    authority, code = name.split(":")
    axes = [
        {
            "name": "Geodetic longitude",
            "abbreviation": "Lon",
            "direction": "east",
            "unit": "degree",
        },
        {
            "name": "Geodetic latitude",
            "abbreviation": "Lat",
            "direction": "north",
            "unit": "degree",
        },
        {"name": "Ellipsoidal height", "abbreviation": "h", "direction": "up", "unit": "metre"},
    ]
    return {
        "$schema": "https://proj.org/schemas/v0.7/projjson.schema.json",
        "type": "GeographicCRS",
        "name": "WGS 84 (3D)",
        "datum": {
            "type": "GeodeticReferenceFrame",
            "name": "World Geodetic System 1984",
            "ellipsoid": {
                "name": "WGS 84",
                "semi_major_axis": 6378137,
                "inverse_flattening": 298.257223563,
            },
        },
        "coordinate_system": {"subtype": "ellipsoidal", "axis": axes},
        "id": {"authority": authority, "code": int(code)},
    }


def _plain(column: NDArray[Any]) -> Any:
    """A column as pyarrow takes it; masked values are missing ones."""
    return (
        column.tolist()
        if isinstance(column, np.ma.MaskedArray) or column.dtype == object
        else column
    )


def _put(parquet: Any, table: Any, path: Path) -> None:
    """Write a file that appears when it is whole."""
    unfinished = path.with_name(path.name + ".part")
    try:
        parquet.write_table(table, unfinished, compression="zstd")
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise RecordError(
            "pyarrow, which writes Parquet, is not installed",
            cure="pip install 'tramstream[parquet]'",
        ) from error
    return pyarrow, pyarrow.parquet


# MATLAB -------------------------------------------------------------------------------------------
def write_mat(record: Record, out: Path, window: Window) -> None:
    """A struct a key, a field a column, for `load` of MATLAB and Octave."""
    from scipy.io import savemat

    found: dict[str, dict[str, Any]] = {}
    for key, table in tables(record, window).items():
        fields: dict[str, Any] = {}
        for name, column in table.items():
            values = column.filled() if isinstance(column, np.ma.MaskedArray) else column
            fields[_mat_name(name, fields)] = values.reshape(-1, 1)
        found[_mat_name(key, found)] = fields
    unfinished = out.with_name(out.name + ".part")
    try:
        with unfinished.open("wb") as file:
            savemat(file, found, long_field_names=True, do_compression=True)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)


def _mat_name(name: str, taken: dict[str, Any]) -> str:
    """A name as MATLAB takes it, each but once."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    plain = (plain if plain[:1].isalpha() else f"x{plain}")[:MAT_NAME]
    number = 1
    found = plain
    while found in taken:
        number += 1
        found = f"{plain[: MAT_NAME - 4]}_{number}"
    return found
