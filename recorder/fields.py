"""A message type as columns, from its descriptor alone: whoever wrote the type.

A type becomes a tree once; batches of messages then go through it field by field, so that the work
of a value is one C call (`attrgetter`, `numpy.fromiter`) and no line of Python. What comes out:

- a field of a part is a column of its own, `part.field`; a Timestamp or Duration is `field_ns`;
- integers and enumerations are int64 (uint64 only where a value needs it), `float` is float32;
- a number that an optional field or an absent part lacks is NaN, or masked where it is no float;
- a text or bytes are objects, None where absent; a map is a dict;
- a repeated field is two-dimensional where all messages that have any element have equally many
  (an empty one is a row of NaN, if it holds floats), else an object column of arrays; so are the
  fields of repeated parts, `parts.field`. Lists within lists are lists of arrays;
- a part of a type that holds itself, or of one wider than `MOST_COLUMNS`, stays a message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, repeat
from operator import attrgetter
from typing import Any

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from numpy.typing import NDArray

from tramstream.boundary import LATEST_S
from tramstream.clock import S

Values = NDArray[Any]
Mask = NDArray[np.bool_]
Wanted = Callable[[str], bool]
"""Whether a column of this name is wanted."""

MOST_COLUMNS = 2048
"""A description of a few hundred bytes can name more columns than any memory holds."""
_KNOWN_TEXTS = 4096
"""Texts that a column keeps once; most columns of text hold a few words many times."""
_INSTANTS = ("google.protobuf.Timestamp", "google.protobuf.Duration")
_NUMBERS: dict[int, Any] = {
    FieldDescriptor.CPPTYPE_INT32: np.int64,
    FieldDescriptor.CPPTYPE_INT64: np.int64,
    FieldDescriptor.CPPTYPE_UINT32: np.int64,
    FieldDescriptor.CPPTYPE_UINT64: np.uint64,
    FieldDescriptor.CPPTYPE_ENUM: np.int64,
    FieldDescriptor.CPPTYPE_BOOL: np.bool_,
    FieldDescriptor.CPPTYPE_FLOAT: np.float32,
    FieldDescriptor.CPPTYPE_DOUBLE: np.float64,
}


class Column:
    """One column while it is filled: values one behind the other, and how they part into rows.

    Parameters
    ----------
    name : str
        With those of the parts it lies in.
    depth : int
        How many fields on the way to it are repeated, itself included.
    dtype : numpy type
    enum : EnumDescriptor, optional
        Of an enumeration's column.
    """

    def __init__(self, name: str, depth: int, dtype: Any, enum: Any = None) -> None:
        self.name, self.depth, self.enum = name, depth, enum
        self._values: list[Values] = [np.empty(0, dtype)]
        self._missing: list[Mask] = [np.empty(0, bool)]
        self._lengths: list[list[Values]] = [[np.empty(0, np.int64)] for _ in range(depth)]
        self._texts: dict[Any, Any] = {}

    def add(self, values: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
        """Take a batch: values, which of them are absent, elements of each list by level."""
        count, dtype = len(values), self._values[0].dtype
        if dtype.kind == "O":
            kept = boxed([self._once(value) for value in values])
            if absent is not None:
                kept[absent] = None
        else:
            kept = np.fromiter(values, dtype, count)
        self._values.append(kept)
        self._missing.append(np.zeros(count, bool) if absent is None else absent)
        for parts, each in zip(self._lengths, lengths, strict=True):
            parts.append(each)

    def _once(self, value: Any) -> Any:
        if type(value) not in (str, bytes):
            return value
        if len(self._texts) > _KNOWN_TEXTS:
            self._texts.clear()
        return self._texts.setdefault(value, value)

    def flat(self) -> Values:
        """All values one behind the other; absent numbers NaN or masked."""
        values, missing = _joined(self._values), _joined(self._missing)
        if values.dtype == np.uint64 and (not len(values) or values.max() < 1 << 63):
            values = values.view(np.int64)
        if values.dtype.kind == "O" or not missing.any():
            return values
        if values.dtype.kind == "f":
            return np.where(missing, np.array(np.nan, values.dtype), values)
        return np.ma.masked_array(values, missing)

    def lengths(self, level: int = 0) -> Values:
        """How many elements each message has; of a deeper level, each element of the one above."""
        return _joined(self._lengths[level])

    def rows(self) -> Values:
        """One row a message, see the top of the module."""
        values = self.flat()
        if self.depth == 0:
            return values
        return _rows(values, [self.lengths(level) for level in range(self.depth)])


def _joined(parts: list[Values]) -> Values:
    """Arrays as one, which takes their place."""
    if len(parts) > 1:
        parts[:] = [np.concatenate(parts)]
    return parts[0]


def _rows(values: Values, lengths: list[Values]) -> Values:
    """Values parted into rows, by the innermost lengths first."""
    count = int(lengths[0].max(initial=0))
    full = lengths[0] == count
    if len(lengths) == 1 and count and (full | (lengths[0] == 0)).all():
        if full.all():
            return values.reshape(-1, count)
        if values.dtype.kind == "f":
            rows = np.full((len(full), count), np.nan, values.dtype)
            rows[full] = values.reshape(-1, count)
            return rows
    parts: Any = values
    for each in reversed(lengths):
        ends = np.cumsum(each).tolist()
        parts = [parts[end - n : end] for n, end in zip(each.tolist(), ends, strict=True)]
    return boxed(parts)


def boxed(parts: Sequence[Any]) -> Values:
    """Each part as one object, whatever numpy would make of parts of equal length."""
    boxed = np.empty(len(parts), object)
    for index, part in enumerate(parts):
        boxed[index] = part
    return boxed


class Fields:
    """The columns of a message type, and how batches of messages get into them.

    Parameters
    ----------
    descriptor : Descriptor
        Of `google.protobuf`, whichever of its implementations made it.
    wanted : callable
        Of a column's name; others are not looked at.
    """

    def __init__(self, descriptor: Any, wanted: Wanted = lambda _: True) -> None:
        self.columns: dict[str, Column] = {}
        self._wanted = wanted
        self._add = self._part(descriptor, "", 0, ())

    def add(self, messages: Sequence[Any]) -> None:
        """Take a batch of messages of the type."""
        self._add(messages, None, ())

    def _part(self, descriptor: Descriptor, prefix: str, depth: int, above: Any) -> _Add:
        above = (*above, descriptor.full_name)
        taken = {field.name for field in descriptor.fields}
        adders = [self._field(field, prefix, depth, above, taken) for field in descriptor.fields]
        wanted = [each for each in adders if each is not None]

        def add(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
            for each in wanted:
                each(messages, absent, lengths)

        return add if wanted else _nothing

    def _field(
        self, field: FieldDescriptor, prefix: str, depth: int, above: Any, taken: set[str]
    ) -> _Add | None:
        """What puts one field of a batch into its columns; None if nothing of it is wanted."""
        name, type_ = prefix + field.name, field.message_type
        depth += field.is_repeated
        into: _Add | None
        if type_ is None:
            dtype = _NUMBERS.get(field.cpp_type, object)
            into = self._column(name, depth, dtype, field.enum_type)
        elif type_.full_name in _INSTANTS:
            alone = f"{field.name}_ns" not in taken
            into = self._instant(f"{name}_ns" if alone else name, depth)
        elif type_.GetOptions().map_entry:
            into = self._column(name, depth - 1, object)
            return _mapped(field.name, into) if into is not None else None
        elif type_.full_name in above or len(self.columns) > MOST_COLUMNS:
            into = self._column(name, depth, object)
        else:
            into = self._part(type_, f"{name}.", depth, above)
            into = None if into is _nothing else into
        if into is None:
            return None
        return _repeated(field.name, into) if field.is_repeated else _single(field, into)

    def _column(self, name: str, depth: int, dtype: Any, enum: Any = None) -> _Add | None:
        if not self._wanted(name):
            return None
        column = self.columns[name] = Column(name, depth, dtype, enum)
        return column.add

    def _instant(self, name: str, depth: int) -> _Add | None:
        into = self._column(name, depth, np.int64)
        if into is None:
            return None
        chosen = into

        def add(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
            count = len(messages)
            seconds = np.fromiter(map(attrgetter("seconds"), messages), np.int64, count)
            nanos = np.fromiter(map(attrgetter("nanos"), messages), np.int64, count)
            beyond = np.abs(seconds) >= LATEST_S
            absent = beyond if absent is None else absent | beyond
            chosen(np.where(absent, 0, seconds * S + nanos), absent, lengths)  # type: ignore[arg-type]

        return add


_Add = Callable[[Sequence[Any], Mask | None, Sequence[Values]], None]
"""Takes a batch of values or parts: which are absent, how many elements each list has by level."""


def _nothing(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
    """Of this part no column is wanted."""


def _single(field: FieldDescriptor, into: _Add) -> _Add:
    name, get = field.name, attrgetter(field.name)
    if not field.has_presence:
        return lambda messages, absent, lengths: into(list(map(get, messages)), absent, lengths)

    def add(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
        has: Any = type(messages[0]).HasField if messages else None
        missing = ~np.fromiter(map(has, messages, repeat(name)), np.bool_, len(messages))
        if absent is not None:
            missing |= absent
        into(list(map(get, messages)), missing, lengths)

    return add


def _repeated(name: str, into: _Add) -> _Add:
    get = attrgetter(name)

    def add(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
        lists = list(map(get, messages))
        counts = np.fromiter(map(len, lists), np.int64, len(lists))
        into(list(chain.from_iterable(lists)), None, (*lengths, counts))

    return add


def _mapped(name: str, into: _Add) -> _Add:
    get = attrgetter(name)

    def add(messages: Sequence[Any], absent: Mask | None, lengths: Sequence[Values]) -> None:
        into([dict(each) for each in map(get, messages)], absent, lengths)

    return add
