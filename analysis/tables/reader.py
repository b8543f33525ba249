"""Rows of a text table as columns of numbers; what is no row is counted and told, not raised.

A row that cannot be used (a cell that is no number, too few cells, a time that does not come after
those around it) is left out. A table that cannot be used at all (no such column, no row left) is a
ConfigError. Rows whose wanted cells are all empty belong to somebody else: tables that hold several
sensors look like that.
"""

from __future__ import annotations

import csv
import difflib
from array import array
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.tables.mapping import Column, Table, Time, Value
from tramstream.analysis.tables.units import instant_ns
from tramstream.errors import ConfigError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_TICKS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Powers of ten to nanoseconds."""
_LIMIT_NS = 1 << 62
_LARGEST = 1e18
"""A cell that is larger is no figure of a vehicle, and its square is no number."""
_DELIMITERS = {"tab": "\t", ",": ",", ";": ";"}
_EMPTY = frozenset(("", "nan", "null", "none", "na", "n/a", "-"))


@dataclass
class Content:
    """What a table held."""

    path: Path
    time_ns: Stamps
    """As in the table, in nanoseconds: neither its offset nor its clock are in it."""
    numbers: dict[Column, Array]
    texts: dict[Column, list[str]]
    malformed: int = 0
    first_malformed: str = ""
    """One sentence."""


@dataclass
class _Collector:
    """Takes rows, keeps the wanted cells."""

    time: Time
    times: list[int]
    """Where the wanted cells are in a row."""
    numbers: list[int]
    texts: list[int]
    names: Sequence[str]
    """Of the header, for sentences."""
    lines: array[int] = field(default_factory=lambda: array("q"))
    stamps: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    """Row after row."""
    words: list[list[str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._width = 1 + max(self.times + self.numbers + self.texts)

    def take(self, line: int, row: list[str]) -> str:
        """Keep a row; else say what is wrong with it."""
        if len(row) < self._width:
            return f"has {len(row)} cells, column {self._width - 1} is wanted"
        cells = [row[place].strip() for place in self.numbers]
        if cells and all(cell.lower() in _EMPTY for cell in cells):
            return ""
        values = []
        for place, cell in zip(self.numbers, cells, strict=True):
            value = _number(cell)
            if value is None:
                return f"column {self._name(place)}: {cell!r} is no number"
            values.append(value)
        text = " ".join(row[place].strip() for place in self.times)
        stamp_ns = _time_ns(text, self.time.unit)
        if stamp_ns is None:
            return f"column {self._name(self.times[0])}: {text!r} is no time in {self.time.unit}"
        self.lines.append(line)
        self.stamps.append(stamp_ns)
        self.values.extend(values)
        if self.texts:
            self.words.append([row[place].strip() for place in self.texts])
        return ""

    def _name(self, place: int) -> str:
        return self.names[place] if self.names else str(place)


def read(path: Path, table: Table, numbers: Sequence[Column], texts: Sequence[Column]) -> Content:
    """Read the wanted columns of a table.

    Parameters
    ----------
    numbers, texts : sequence of Column
        Columns that hold numbers, and words.

    Raises
    ------
    ConfigError
        If it is not there, lacks a column or has no usable row.
    """
    malformed, first, matched = 0, "", 0
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            rows = _rows(file, table)
            names = _header(path, table, rows)
            places = {
                column: _place(path, column, names, table)
                for column in [*_columns(table), *numbers, *texts]
            }
            collector = _Collector(
                table.time,
                [places[column] for column in time_columns(table)],
                [places[column] for column in numbers],
                [places[column] for column in texts],
                names,
            )
            only = table.rows
            for line, row in rows:
                if only is not None:
                    place = places[only.column]
                    if place >= len(row) or not same(row[place].strip(), only.equals):
                        continue
                matched += 1
                problem = collector.take(line, row)
                if problem:
                    malformed += 1
                    first = first or f"line {line}: {problem}"
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check its name") from error
    except csv.Error as error:
        raise ConfigError(f"{path}: {error}; is it a table of text?") from error
    _refuse_empty(path, table, len(collector.stamps), matched, first)
    content = _content(path, collector, numbers, texts)
    content.malformed += malformed
    content.first_malformed = first or content.first_malformed
    return content


def time_columns(table: Table) -> tuple[Column, ...]:
    """Columns that make up the time."""
    column = table.time.column
    return column if isinstance(column, tuple) else (column,)


def same(cell: str, wanted: Value) -> bool:
    """Whether a cell holds a value: text literally, numbers as numbers."""
    return cell == wanted if isinstance(wanted, str) else _number(cell) == wanted


def _columns(table: Table) -> list[Column]:
    return [*time_columns(table), *([table.rows.column] if table.rows is not None else [])]


def _rows(file: Iterator[str], table: Table) -> Iterator[tuple[int, list[str]]]:
    """Rows that are not blank, with the number of the line that they end on."""
    line = 0

    def lines() -> Iterator[str]:
        nonlocal line
        for text in file:
            line += 1
            if not (table.comment and text.startswith(table.comment)):
                yield text

    if table.delimiter == "whitespace":
        for text in lines():
            row = text.split()
            if row:
                yield line, row
    else:
        delimiter = _DELIMITERS[table.delimiter]
        for row in csv.reader(lines(), delimiter=delimiter, skipinitialspace=True):
            if any(row):
                yield line, row


def _header(path: Path, table: Table, rows: Iterator[tuple[int, list[str]]]) -> list[str]:
    if not table.header:
        return []
    _, names = next(rows, (0, []))
    if not names:
        raise ConfigError(f"{path}: is empty")
    return [name.strip() for name in names]


def _place(path: Path, column: Column, names: list[str], table: Table) -> int:
    """Where a column is in a row."""
    if isinstance(column, int):
        if column < 0 or (names and column >= len(names)):
            raise ConfigError(
                f"{path}: no column {column}; the first is 0 and the header has {len(names)}"
            )
        return column
    if not table.header:
        raise ConfigError(
            f"{path}: column {column!r} has a name, but the mapping says header = false; "
            "name it by its place, the first being 0"
        )
    if names.count(column) > 1:
        raise ConfigError(f"{path}: two columns are named {column!r}; name it by its place")
    if column in names:
        return names.index(column)
    if len(names) == 1:
        raise ConfigError(
            f"{path}: line 1: no column {column!r}, only one that reads {names[0]!r}; "
            f"is the delimiter {table.delimiter!r}?"
        )
    near = difflib.get_close_matches(column, names, n=1)
    guess = f"did you mean {near[0]!r}? " if near else ""
    raise ConfigError(f"{path}: line 1: no column {column!r}; {guess}there are: {', '.join(names)}")


def _refuse_empty(path: Path, table: Table, kept: int, matched: int, first: str) -> None:
    if kept:
        return
    if first:
        raise ConfigError(
            f"{path}: no row can be used; {first}; are delimiter, columns and time.unit right?"
        )
    if matched:
        raise ConfigError(f"{path}: the wanted columns are empty in each of its {matched} rows")
    if table.rows is not None:
        raise ConfigError(
            f"{path}: no row has {table.rows.equals!r} in column {table.rows.column!r}"
        )
    raise ConfigError(f"{path}: has no rows")


def _content(
    path: Path, collector: _Collector, numbers: Sequence[Column], texts: Sequence[Column]
) -> Content:
    """Columns of what was taken, as far as its time goes forward."""
    stamps = np.array(collector.stamps, dtype=np.int64)
    values = np.array(collector.values).reshape(len(stamps), len(numbers))
    kept, text = np.arange(len(stamps)), ""
    if np.any(np.diff(stamps) <= 0):
        kept = increasing(stamps)
        left_out = np.setdiff1d(np.arange(len(stamps)), kept)
        text = (
            f"line {collector.lines[left_out[0]]}: its time does not lie between those of its "
            "neighbours; are the rows in the order of time?"
        )
    return Content(
        path=path,
        time_ns=stamps[kept],
        numbers={column: values[kept, index] for index, column in enumerate(numbers)},
        texts={
            column: [collector.words[row][index] for row in kept.tolist()]
            for index, column in enumerate(texts)
        },
        malformed=len(stamps) - len(kept),
        first_malformed=text,
    )


def increasing(stamps: Stamps) -> NDArray[np.int64]:
    """Places of the longest strictly increasing part: one wrong stamp costs one row.

    References
    ----------
    M. L. Fredman, "On computing the length of longest increasing subsequences", Discrete
    Mathematics 11 (1975) 29-35.
    """
    ends: list[int] = []  # the least stamp that ends an increasing part of each length
    places: list[int] = []  # where that is
    before = np.full(len(stamps), -1, dtype=np.int64)
    for place, stamp in enumerate(stamps.tolist()):
        length = bisect_left(ends, stamp)
        if length == len(ends):
            ends.append(stamp)
            places.append(place)
        else:
            ends[length], places[length] = stamp, place
        if length:
            before[place] = places[length - 1]
    chain = np.empty(len(ends), dtype=np.int64)
    place = places[-1] if places else -1
    for index in range(len(ends) - 1, -1, -1):
        chain[index] = place
        place = int(before[place])
    return chain


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= _LARGEST else None  # NaN is not


def _time_ns(text: str, unit: str) -> int | None:
    """Nanoseconds in a cell, to the last digit that it has."""
    if unit == "datetime":
        return instant_ns(text)
    try:
        number = Decimal(text).scaleb(_TICKS[unit])
        if not number.is_finite() or abs(number) > _LIMIT_NS:
            return None
    except ArithmeticError:
        return None
    return round(number)
