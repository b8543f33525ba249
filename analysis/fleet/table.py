"""The fleet's table: one row a figure of a ride, as Parquet; the same bits in whatever order.

A table grows: rides that are in it already (by their digest) are replaced, others are added. So
what has changed since last time is in the file itself. Nothing in it depends on when or by how many
processes it was made.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from tramstream.analysis.fleet.outcome import Outcome
from tramstream.analysis.grade_map.file import libraries
from tramstream.errors import ConfigError

KEY = b"tramstream.fleet"
FORMAT = b"1"


class Row(msgspec.Struct, frozen=True, kw_only=True, order=True):
    """One figure of one ride; a ride without figures has one row with its verdict."""

    vehicle: str
    verb: str
    start_ns: int
    digest: str
    field: str
    record: str
    duration_s: float
    value: float
    std: float
    unit: str
    verdict: str


KINDS = {
    "vehicle": "string",
    "verb": "string",
    "start_ns": "int64",
    "digest": "string",
    "field": "string",
    "record": "string",
    "duration_s": "float64",
    "value": "float64",
    "std": "float64",
    "unit": "string",
    "verdict": "string",
}


def rows_of(verb: str, outcomes: Iterable[Outcome]) -> list[Row]:
    """Rows of what came of rides; records that could not be read are in none."""
    rows: list[Row] = []
    for place, finding, *_ in outcomes:
        if finding is None:
            continue
        about: dict[str, Any] = {
            "vehicle": finding.vehicle,
            "verb": verb,
            "start_ns": finding.start_ns,
            "digest": finding.digest,
            "record": Path(place.name).name,
            "duration_s": finding.duration_s,
            "verdict": finding.verdict,
        }
        rows += [
            Row(field=each.field, value=each.value, std=each.std, unit=each.unit, **about)
            for each in finding.figures
        ]
        if not finding.figures:
            rows.append(Row(field="", value=math.nan, std=math.nan, unit="", **about))
    return rows


def merged(before: Iterable[Row], new: Sequence[Row]) -> list[Row]:
    """All rows in order; a ride that is in both stands as it was found now."""
    replaced = {(row.verb, row.digest) for row in new}
    kept = [row for row in before if (row.verb, row.digest) not in replaced]
    return sorted([*kept, *new], key=_order)


def _order(row: Row) -> tuple[str, str, int, str, str]:
    return row.vehicle, row.verb, row.start_ns, row.digest, row.field


def write(rows: Sequence[Row], out: Path) -> None:
    """Write a table whole or not at all.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    arrow, parquet = libraries()
    columns = {
        name: arrow.array([getattr(row, name) for row in rows], type=arrow.type_for_alias(kind))
        for name, kind in KINDS.items()
    }
    table = arrow.table(columns).replace_schema_metadata({KEY: FORMAT})
    unfinished = out.with_name(out.name + ".part")
    try:
        parquet.write_table(table, unfinished, compression="zstd")
        os.replace(unfinished, out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        unfinished.unlink(missing_ok=True)


def read(path: Path) -> list[Row]:
    """Read a table.

    Raises
    ------
    ConfigError
        If it is none.
    """
    arrow, parquet = libraries()
    try:
        with parquet.ParquetFile(path) as file:
            if (file.schema_arrow.metadata or {}).get(KEY) != FORMAT:
                raise ConfigError(f"{path}: is no table of a fleet", cure="name another --table")
            plain = file.read().to_pylist()
        return msgspec.convert(plain, list[Row])
    except (OSError, arrow.ArrowException, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: cannot be read as a table of a fleet ({error})") from error
