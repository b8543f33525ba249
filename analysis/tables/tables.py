"""Tables of numbers as raw messages: what `tramstream import --csv --mapping` adds to a record.

Stamps are GPS time as Unix time, like those of imported captures; nothing tells when a row arrived,
so each is taken to have come when it was true, and a batch with its last sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tramstream.analysis.tables import columns, messages
from tramstream.analysis.tables import mapping as table_mapping
from tramstream.analysis.tables.columns import Mask, Placed
from tramstream.analysis.tables.mapping import GnssTable, ImuTable, OdometryTable
from tramstream.analysis.tables.messages import Row
from tramstream.analysis.tables.reader import Stamps, read
from tramstream.analysis.tables.units import scale_start_ns
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.errors import ConfigError


@dataclass
class Import:
    """What the tables gave."""

    rows: list[Row] = field(default_factory=list)
    tables: list[dict[str, Any]] = field(default_factory=list)
    """Per table: file, kind, how many rows, what was left out."""
    malformed_lines: int = 0


class Tables:
    """The tables of a mapping file, found but not yet read.

    Parameters
    ----------
    mapping : Path
        See docs/import-tables.md.
    given : list of str
        FILE, FOLDER or NAME=FILE: where the mapping's tables are.
    cuts : list of (start_s, duration_s)
        Fixes to withhold, beside the mapping's own cuts.
    """

    def __init__(self, mapping: Path, given: list[str], cuts: list[tuple[float, float]]) -> None:
        self.name = str(mapping)
        self.mapping = table_mapping.load(mapping)
        names = list(dict.fromkeys(table.file for table in self.mapping.tables))
        self.files = find_files(mapping, names, given)
        self._cuts = [(start_s, start_s + duration_s) for start_s, duration_s in cuts]

    def read(self, vehicle: Vehicle) -> Import:
        """Read everything and turn it into messages.

        Raises
        ------
        ConfigError
            If a table or the configuration cannot be used.
        """
        try:
            return self._read(vehicle)
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from error

    def _read(self, vehicle: Vehicle) -> Import:
        tables = [self._place(index) for index in range(len(self.mapping.tables))]
        _check_overlap(tables)
        start_ns = min(int(placed.stamps[0]) for placed in tables)
        level = columns.level_of(self.mapping, tables)
        made = Import()
        for placed in tables:
            table, content = placed.table, placed.content
            report: dict[str, Any] = {
                "file": str(content.path),
                "kind": type(table).__struct_config__.tag,
                "rows": len(content.time_ns),
                "start_s": (int(placed.stamps[0]) - start_ns) / S,
                "duration_s": int(placed.stamps[-1] - placed.stamps[0]) / S,
                "malformed_lines": content.malformed,
                "first_malformed": content.first_malformed,
            }
            if isinstance(table, ImuTable):
                rows, told = messages.inertial(placed, table, vehicle)
                report |= told
            elif isinstance(table, GnssTable):
                given = _given(placed.stamps, table, start_ns, [*table.cuts, *self._cuts])
                report |= {"given": int(given.sum()), "withheld": int((~given).sum())}
                fixes = messages.fixes(placed, table, level, vehicle.gnss)
                rows = messages.positioning(fixes, given, table.withheld == "truth")
            elif isinstance(table, OdometryTable):
                rows = messages.odometry(placed, table)
            else:
                rows = messages.truth(placed, table, level)
            made.rows += rows
            made.tables.append(report)
            made.malformed_lines += content.malformed
        return made

    def _place(self, index: int) -> Placed:
        """Read one table and put it on the record's clock."""
        table = self.mapping.tables[index]
        content = read(
            self.files[table.file],
            table,
            columns.number_columns(table),
            columns.text_columns(table),
        )
        clock = table.clock or self.mapping.clock
        assert clock is not None  # load() has seen to it
        dated = table.time.unit == "datetime"
        shift_ns = scale_start_ns(clock, int(content.time_ns[0]), dated)
        stamps = content.time_ns + (shift_ns + round(table.time.offset_s * S))
        if stamps[0] <= 0:
            raise ConfigError(
                f"{content.path}: its first row lies before 1970; are $.tables[{index}].time and "
                "its clock right?"
            )
        return Placed(index, table, content, stamps, clock)


def find_files(mapping: Path, names: list[str], given: list[str]) -> dict[str, Path]:
    """Where each table of a mapping is.

    A NAME=FILE names it; a FILE is the table of that name, or the only one there is; in a FOLDER,
    and last beside the mapping, it is looked for.

    Raises
    ------
    ConfigError
        If one is not found, or something given is of no use.
    """
    found: dict[str, Path] = {}
    folders: list[Path] = []
    for text in given:
        name, equals, rest = text.partition("=")
        path = Path(text)
        if equals and name in names:
            found[name] = Path(rest)
        elif path.is_dir():
            folders.append(path)
        else:
            named = [name for name in names if Path(name).name == path.name]
            if not named and len(names) == 1:
                named = names
            if not named:
                raise ConfigError(
                    f"--csv {text}: the mapping has no table of that name; say which of them it is "
                    f"with NAME=FILE: {', '.join(names)}"
                )
            found[named[0]] = path
    for name in names:
        for folder in [*folders, mapping.parent]:
            if name not in found and _is_file(folder / name):
                found[name] = folder / name
        if name not in found:
            places = " nor ".join(str(folder) for folder in [*folders, mapping.parent])
            raise ConfigError(
                f"{mapping}: {name} is not in {places}; give it, or its folder, with --csv"
            )
    return found


def _is_file(path: Path) -> bool:
    """Whether a file is there; a name that no disk takes is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def parse_cut(text: str) -> tuple[float, float]:
    """START_S:DURATION_S of a GNSS outage."""
    start, colon, duration = text.partition(":")
    try:
        start_s, duration_s = float(start), float(duration)
    except ValueError:
        start_s, duration_s = -1.0, 0.0
    if not colon or not (0 <= start_s < float("inf") and 0 < duration_s < float("inf")):
        raise ConfigError(f"--cut {text}: must read START_S:DURATION_S, e.g. 100:30")
    return start_s, duration_s


def _check_overlap(tables: list[Placed]) -> None:
    """Refuse tables of one drive that have no instant in common."""
    for placed in tables:
        others = [other.stamps for other in tables if other is not placed]
        if others and not any(
            placed.stamps[0] <= stamps[-1] and stamps[0] <= placed.stamps[-1] for stamps in others
        ):
            apart_s = min(abs(int(stamps[0] - placed.stamps[0])) for stamps in others) / S
            raise ConfigError(
                f"{placed.place}: {placed.content.path} has no instant in common with any other "
                f"table (it begins {apart_s:g} s apart); are the clocks and time.offset_s right?"
            )


def _given(
    stamps: Stamps, table: GnssTable, start_ns: int, cuts: list[tuple[float, float]]
) -> Mask:
    """Which fixes the filter gets."""
    given: Mask = np.ones(len(stamps), bool)
    if table.every_s is not None:
        given = columns.nearest_to_multiples(stamps, max(round(table.every_s * S), 1))
    for begin_s, end_s in cuts:
        after_s = (stamps - start_ns) / S
        given &= (after_s < begin_s) | (after_s >= end_s)
    return given
