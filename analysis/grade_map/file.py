"""A grade map as a Parquet file: one row a cell, with what each ride said of it inside.

The rides' own figures lie in the column `by_ride`, a list of records a row: so a map can take one
more ride, or reject another, and be the same as one that is made at once. What is known of the
rides stands in the file's metadata, under `KEY`, as JSON. DuckDB, pandas and polars read the file
as it is. Needs the package pyarrow, which nothing else does.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from tramstream.analysis.grade_map.assemble import GradeMap, LinePart, RideEntry
from tramstream.errors import ConfigError, MissingPackageError

KEY = b"tramstream.grade_map"
FORMAT = 1
COLUMNS = {
    "track_number": "int32",
    "cell": "int32",
    "from_m": "float64",
    "to_m": "float64",
    "track_m": "float64",
    "from_latitude_deg": "float64",
    "from_longitude_deg": "float64",
    "to_latitude_deg": "float64",
    "to_longitude_deg": "float64",
    "osm_way": "int64",
    "grade_rad": "float64",
    "grade_std_rad": "float64",
    "height_ellipsoid_m": "float64",
    "height_std_m": "float64",
    "chi2": "float64",
    "passes": "int32",
    "rides": "int32",
    "forwards": "int32",
    "backwards": "int32",
    "left_out": "int32",
    "first_utc_ns": "int64",
    "last_utc_ns": "int64",
}
"""Beside `track` and `by_ride`; `track_m` is the length of the track. Along it as drawn; slopes are
uphill positive along it."""
PASSES = {
    "ride": "int32",
    "sign": "int8",
    "grade_rad": "float32",
    "std_rad": "float32",
    "height_m": "float32",
    "height_std_m": "float32",
}


class _About(msgspec.Struct, frozen=True, kw_only=True):
    """What stands in the metadata."""

    format: int
    network: str
    source: str
    cell_m: float
    rides: tuple[RideEntry, ...]
    lines: tuple[LinePart, ...]


def write(made: GradeMap, out: Path) -> None:
    """Write a map; an existing file is replaced at once or not at all.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    arrow, parquet = libraries()
    fields = [arrow.array(made.passes[name].astype(kind)) for name, kind in PASSES.items()]
    inside = arrow.ListArray.from_arrays(
        arrow.array(made.starts.astype(np.int32)),
        arrow.StructArray.from_arrays(fields, names=list(PASSES)),
    )
    columns: dict[str, Any] = {"track": arrow.array(made.track).dictionary_encode()}
    columns |= {name: made.columns[name].astype(kind) for name, kind in COLUMNS.items()}
    about = _About(
        format=FORMAT,
        network=made.network,
        source=made.source,
        cell_m=made.cell_m,
        rides=made.rides,
        lines=made.lines,
    )
    table = arrow.table(columns | {"by_ride": inside})
    table = table.replace_schema_metadata({KEY: msgspec.json.encode(about)})
    unfinished = out.with_name(out.name + ".part")
    try:
        parquet.write_table(
            table, unfinished, compression="zstd", compression_level=1, use_dictionary=["track"]
        )
        os.replace(unfinished, out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        unfinished.unlink(missing_ok=True)


def read(path: Path) -> GradeMap:
    """Read a map.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    arrow, parquet = libraries()
    try:
        with parquet.ParquetFile(path) as file:
            about = msgspec.json.decode((file.schema_arrow.metadata or {})[KEY], type=_About)
            if about.format != FORMAT:
                raise ConfigError(
                    f"{path}: was made by another version",
                    cure="make it anew with `tramstream grade-map build`",
                )
            table = file.read()
        found = _unpacked(table, about)
    except FileNotFoundError as error:
        raise ConfigError(
            f"{path}: cannot be read (no such file)", cure="check the name"
        ) from error
    except (OSError, KeyError, ValueError, arrow.ArrowException, msgspec.MsgspecError) as error:
        raise _no_map(path) from error
    doubt = _doubt_of(found)
    if doubt:
        raise _no_map(path) from ValueError(doubt)
    return found


def _unpacked(table: Any, about: _About) -> GradeMap:
    inside = table["by_ride"].combine_chunks()
    if hasattr(inside, "chunks"):
        inside = inside.chunk(0)
    offsets = inside.offsets.to_numpy()
    records = inside.values.slice(int(offsets[0]), int(offsets[-1] - offsets[0]))
    passes = {
        name: records.field(name).to_numpy(zero_copy_only=False).astype(kind)
        for name, kind in PASSES.items()
    }
    columns = {name: table[name].to_numpy().astype(kind) for name, kind in COLUMNS.items()}
    track = tuple(table["track"].to_pylist())
    starts = offsets.astype(np.int64) - int(offsets[0])
    return GradeMap(
        about.network,
        about.source,
        about.cell_m,
        about.rides,
        about.lines,
        columns,
        track,
        passes,
        starts,
    )


def _doubt_of(found: GradeMap) -> str:
    """What does not fit together; empty if all does."""
    rides, columns = found.passes["ride"], found.columns
    if len(rides) and not 0 <= rides.min() <= rides.max() < len(found.rides):
        return "figures of rides that are not there"
    if np.any(np.abs(found.passes["sign"]) != 1) or not np.all(found.passes["std_rad"] > 0):
        return "figures of rides that are none"
    if len(found) and min(columns["track_number"].min(), columns["cell"].min()) < 0:
        return "cells that are not there"
    if not all(isinstance(name, str) for name in found.track):
        return "tracks without a name"
    for name in ("from_m", "to_m", "from_latitude_deg", "from_longitude_deg"):
        if not np.all(np.isfinite(columns[name])):
            return f"{name} holds what is no number"
    return ""


def _no_map(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: is no grade map, or a damaged one",
        cure="`tramstream grade-map build` makes it anew",
    )


def libraries() -> tuple[Any, Any]:
    """The package and its part for Parquet; says how to get it where it is not there."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingPackageError(
            "pyarrow, which reads and writes grade maps, is not installed: "
            "`pip install 'tramstream[grade-map]'`"
        ) from error
    return pyarrow, pyarrow.parquet
