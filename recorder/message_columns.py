"""One key of a record as columns: names to arrays, with times, names of enumerations and frames.

Batches of messages go through `tramstream.recorder.fields`, which says what a column is; a message
is gone when its numbers are in the columns. An hour of `est/ekf/state` (360,000 messages) takes
0.2 GB.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.boundary import Undecodable
from tramstream.clock import S
from tramstream.errors import MissingPackageError, RecordError, UnknownNameError
from tramstream.recorder.fields import Column, Fields, Values, boxed
from tramstream.recorder.reader import Entry, Record

ARRIVAL = ("log_ns", "publish_ns", "sequence")
"""Columns that the file itself gives; a field of the message goes before one of the same name."""
BATCH = 1024
_STAMPS = ("stamp_ns", "timestamp_ns", "log_ns")
"""Where a message says when it was true, in the order of preference."""


@dataclass(frozen=True)
class Clock:
    """What a record knows of times: where its own begins, and UTC as the host knew it."""

    origin_ns: int
    """Vehicle clock: the first arrival."""
    stamp_ns: NDArray[np.int64]
    host_utc_ns: NDArray[np.int64]

    @classmethod
    def plain(cls, origin_ns: int) -> Clock:
        """One that knows no UTC."""
        return cls(origin_ns, np.empty(0, np.int64), np.empty(0, np.int64))

    def utc_ns(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """UTC by the last reference at or before each instant, before the first by that.

        Without a reference the instants stay what they are: Unix time as the host believed it when
        it was booted.
        """
        if not len(self.stamp_ns):
            return stamp_ns
        last = np.searchsorted(self.stamp_ns, stamp_ns, side="right") - 1
        offset_ns: NDArray[np.int64] = (self.host_utc_ns - self.stamp_ns)[np.maximum(last, 0)]
        return stamp_ns + offset_ns


class Columns:
    """Messages of one key, a column for each field; like a pandas frame it iterates over names.

    `columns["speed_mps"]` is an array, `list(columns)` are the names, `len(columns)` the messages.
    """

    def __init__(
        self, key: str, type_: str, columns: Mapping[str, Column | Values], clock: Clock
    ) -> None:
        self.key = key
        self.type = type_
        """Full name of the message type."""
        self._columns = dict(columns)
        self._clock = clock

    def __getitem__(self, name: str) -> Values:
        """The column `name`; made when it is asked for the first time."""
        found = self._column(name)
        return found.rows() if isinstance(found, Column) else found

    def _column(self, name: str) -> Column | Values:
        try:
            return self._columns[name]
        except KeyError:
            raise unknown(f"{self.key} has no column", name, self._columns) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def keys(self) -> list[str]:
        """Names of the columns."""
        return list(self._columns)

    def __repr__(self) -> str:
        width = max(map(len, self._columns), default=0)
        lines = [f"{self.key}: {len(self)} messages of {self.type}"]
        for name in self._columns:
            column = self[name]
            shape = f" × {column.shape[1]}" if column.ndim > 1 else ""
            lines.append(f"  {name:{width}}  {column.dtype}{shape}")
        return "\n".join(lines)

    # Time -----------------------------------------------------------------------------------------
    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """When each message was true, on the vehicle clock; where it does not say, its arrival."""
        return self[next(name for name in _STAMPS if name in self._columns)]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """The same in seconds since the first arrival in the record."""
        time_s: NDArray[np.float64] = (self.stamp_ns - self._clock.origin_ns) / S
        return time_s

    @property
    def utc(self) -> NDArray[np.datetime64]:
        """The same as UTC, by the host's clock as the record knows it (`health/clock/reference`).

        A record without that (a simulated one, a stranger's) has only what its stamps say.
        """
        utc: NDArray[np.datetime64] = self._clock.utc_ns(self.stamp_ns).astype("datetime64[ns]")
        return utc

    # Names and elements ---------------------------------------------------------------------------
    def names(self, name: str) -> Values:
        """The column of an enumeration by its names, `UNKNOWN_7` for what only others know.

        Raises
        ------
        UnknownNameError
            If the column holds no enumeration.
        """
        column = self._column(name)
        if not isinstance(column, Column) or column.enum is None:
            with_names = [
                each
                for each, found in self._columns.items()
                if isinstance(found, Column) and found.enum is not None
            ]
            raise UnknownNameError(
                f"{self.key}: {name} holds no enumeration; "
                f"those that do: {', '.join(with_names) or 'none'}"
            )
        return _named(column.rows(), column.enum)

    def elements(self, part: str) -> Columns:
        """One row for each element of a repeated part: its fields beside the message's times.

        `columns.elements("innovations")` has `stamp_ns`, `measurement`, `value` and so on; of a
        repeated number (`covariance`), the numbers one below the other.

        Raises
        ------
        UnknownNameError
            If nothing below `part` is repeated once.
        """
        below = {
            name.removeprefix(f"{part}."): column
            for name, column in self._columns.items()
            if (name == part or name.startswith(f"{part}."))
            and isinstance(column, Column)
            and column.depth == 1
        }
        if not below:
            lists = {
                name.rpartition(".")[0] or name: None
                for name, column in self._columns.items()
                if isinstance(column, Column) and column.depth == 1
            }
            raise unknown(f"{self.key} has no repeated part", part, lists)
        counts = next(iter(below.values())).lengths()
        rows: dict[str, Column | Values] = {
            name: np.repeat(self[name], counts)
            for name in (*_STAMPS, *ARRIVAL)
            if name in self._columns
        }
        rows |= {name: _Flat(column) for name, column in below.items()}
        return Columns(f"{self.key} {part}", self.type, rows, self._clock)

    # Frames ---------------------------------------------------------------------------------------
    def to_pandas(self) -> Any:
        """A pandas DataFrame with the columns' names.

        Two-dimensional columns become one for each element (`covariance.0` …), as `tramstream
        export --csv` names them; masked numbers become nullable ones (`Int64`, `boolean`).

        Raises
        ------
        MissingPackageError
        """
        pandas = _package("pandas", "to_pandas")
        made: dict[str, Any] = {}
        for name in self._columns:
            column = self[name]
            if column.ndim > 1:
                of = {f"{name}.{index}": each for index, each in enumerate(column.T)}
            else:
                of = {name: column}
            made |= {each: _nullable(pandas, values) for each, values in of.items()}
        return pandas.DataFrame(made)

    def to_polars(self) -> Any:
        """A polars DataFrame with the columns' names; repeated fields are lists or arrays.

        Raises
        ------
        MissingPackageError
        """
        polars = _package("polars", "to_polars")
        return polars.DataFrame([_series(polars, name, self[name]) for name in self._columns])


class _Flat(Column):
    """The elements of a repeated field, one a row."""

    def __init__(self, of: Column) -> None:
        super().__init__(of.name, 0, object, of.enum)
        self._of = of

    def flat(self) -> Values:
        return self._of.flat()


def unknown(sentence: str, name: str, known: Iterable[str]) -> UnknownNameError:
    """What to raise for a name that there is none of; near ones are offered, else all."""
    all_ = list(known)
    near = difflib.get_close_matches(name, all_, n=3) or [
        each for each in all_ if name and name in each
    ]
    offer = f"did you mean {' or '.join(near[:3])}?" if near else f"there are: {', '.join(all_)}"
    return UnknownNameError(f"{sentence} {name!r}; {offer}")


def _named(values: Values, enum: Any) -> Values:
    """Numbers of an enumeration as its names, whatever lists they stand in; None where masked."""
    known = {number: value.name for number, value in enum.values_by_number.items()}

    def name(value: Any) -> Any:
        if value is np.ma.masked:
            return None
        if isinstance(value, list | np.ndarray):
            return _named(boxed(value) if isinstance(value, list) else value, enum)
        return known.get(int(value), f"UNKNOWN_{value}")

    named = np.empty(values.shape[:1], object)
    for index, value in enumerate(values):
        named[index] = name(value)
    return np.stack(named.tolist()) if values.ndim > 1 and len(named) else named


# Frames -------------------------------------------------------------------------------------------
def _package(name: str, asked: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingPackageError(
            f"{asked}() needs {name}, which is not installed: `pip install {name}`"
        ) from error


def _nullable(pandas: Any, values: Values) -> Any:
    """A masked column as pandas' own nullable one."""
    if not isinstance(values, np.ma.MaskedArray):
        return values
    mask = np.ma.getmaskarray(values)
    kind = pandas.arrays.BooleanArray if values.dtype == bool else pandas.arrays.IntegerArray
    return kind(values.data, mask)


def _series(polars: Any, name: str, values: Values) -> Any:
    """A column as polars knows it; what it has no type for (maps, messages) as text."""
    if isinstance(values, np.ma.MaskedArray):
        return polars.Series(name, values.tolist())
    if values.dtype != object:
        return polars.Series(name, values)
    first = next((each for each in values if each is not None), "")
    if isinstance(first, np.ndarray):
        return polars.Series(name, [each.tolist() for each in values], strict=False)
    if isinstance(first, list):
        lists = [[each.tolist() for each in row] for row in values]
        return polars.Series(name, lists, strict=False)
    kinds: dict[type, Any] = {str: polars.String, bytes: polars.Binary}
    if type(first) in kinds:
        return polars.Series(name, values.tolist(), dtype=kinds[type(first)])
    texts = [None if each is None else str(each).strip() for each in values]
    return polars.Series(name, texts, dtype=polars.String)


# Reading ------------------------------------------------------------------------------------------
class Span(NamedTuple):
    """A part of a record by arrival: `start_ns` ≤ log_ns < `end_ns`; None is no bound."""

    start_ns: int | None = None
    end_ns: int | None = None


_WHOLE = Span()


class _Arrivals:
    """What the file says of each message."""

    def __init__(self) -> None:
        self._parts = {name: [np.empty(0, np.int64)] for name in ARRIVAL}

    def add(self, entries: Sequence[Entry]) -> None:
        for name, parts in self._parts.items():
            values = map(attrgetter(name), entries)
            parts.append(np.fromiter(values, np.int64, len(entries)))

    def columns(self) -> dict[str, Values]:
        return {name: np.concatenate(parts) for name, parts in self._parts.items()}


def read_columns(
    record: Record,
    topics: Mapping[str, Sequence[str]],
    span: Span = _WHOLE,
    clock: Clock | None = None,
) -> dict[str, Columns]:
    """Read topics of a record in one pass, of each the columns of these names or parts; all if
    none is named.

    Raises
    ------
    RecordError
        If the record does not say with protobuf what is on a topic.
    UnknownNameError
        If there is no such column.
    """
    fields = {topic: _fields(record, topic, names) for topic, names in topics.items()}
    arrivals = {topic: _Arrivals() for topic in topics}
    waiting: dict[str, tuple[list[Entry], list[Any]]] = {topic: ([], []) for topic in topics}

    def take(topic: str) -> None:
        entries, messages = waiting[topic]
        arrivals[topic].add(entries)
        fields[topic].add(messages)
        waiting[topic] = ([], [])

    for entry in record.messages(fields.__contains__, *span):
        message = record.decode(entry)
        if isinstance(message, Undecodable):
            continue
        entries, messages = waiting[entry.topic]
        entries.append(entry)
        messages.append(message)
        if len(messages) == BATCH:
            take(entry.topic)
    for topic in topics:
        take(topic)
    clock = clock or Clock.plain(record.start_ns)
    return {
        topic: Columns(
            keys.split(topic)[1] or topic,
            record.type_of(topic),
            {**each.columns, **arrivals[topic].columns(), **each.columns},
            clock,
        )
        for topic, each in fields.items()
    }


def _fields(record: Record, topic: str, names: Sequence[str]) -> Fields:
    type_ = record.class_of(topic)
    path = keys.split(topic)[1] or topic
    if isinstance(type_, str):
        count = record.channels[topic].count
        raise RecordError(f"{record.paths[0]}: {path}: {count} messages are {type_}")
    if not names:
        return Fields(type_.DESCRIPTOR)
    wanted = set(names)
    unseen = wanted.difference(ARRIVAL)

    def want(column: str) -> bool:
        parts = column.split(".")
        ways = {".".join(parts[:end]) for end in range(1, len(parts) + 1)}
        unseen.difference_update(ways)
        return not wanted.isdisjoint(ways) or column in _STAMPS

    fields = Fields(type_.DESCRIPTOR, want)
    if unseen:
        raise unknown(f"{path} has no column", min(unseen), Fields(type_.DESCRIPTOR).columns)
    return fields
