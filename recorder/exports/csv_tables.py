"""Messages of a record as tables: one CSV file a key.

Columns are the message's fields in their order, with their names (which hold the units); fields of
parts are joined by dots, elements of lists and maps by their index or key. Bytes are written in
hex, enumerations by name, a Foxglove timestamp as nanoseconds. An absent field is an empty cell; a
text that a spreadsheet would take for a formula has a `'` in front. A batch of inertial samples is
one row a sample, in SI units.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.timestamp_pb2 import Timestamp

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.exports.inertial import COLUMNS, samples
from tramstream.recorder.exports.window import WHOLE, Window
from tramstream.recorder.reader import Record
from tramstream.shown import cell

_Order = tuple[tuple[int, str], ...]
_ARRIVAL = ("log_ns", "publish_ns")
_NAME_LENGTH = 60
"""Characters: of four bytes each, with ending and number, they fit into the 255 bytes of a name."""


def export_csv(
    record: Record,
    out: Path,
    window: Window = WHOLE,
    advance: Callable[[int], None] | None = None,
) -> list[Path]:
    """Write the messages of `record` that are wanted; the files written.

    `out` is a file if its name ends in .csv and one key is meant, else a folder with a file a key.
    `advance` is told of each message passed; a record is passed twice. A file appears when it is
    whole.

    Raises
    ------
    RecordError
        If there is no such key, or several are meant for one file.
    """
    topics = [t for t, info in record.channels.items() if info.count and window.means(t)]
    if not topics:
        raise RecordError(
            f"{record.paths[0]}: has no key {window.key or 'at all'}; see `tramstream info`"
        )
    single = out.suffix == ".csv"
    if single and len(topics) > 1:
        raise RecordError(f"{out}: one file holds one key, {len(topics)} are meant; add --key")
    if not single:
        out.mkdir(parents=True, exist_ok=True)
    inertial = {t for t in topics if record.type_of(t) == ImuBatch.DESCRIPTOR.full_name}
    columns = _columns(record, set(topics) - inertial, window, advance)
    written: list[Path] = []
    for topic in topics:
        path = out if single else _free(out, _file_name(topic), written)
        rows = (
            _inertial(record, topic, window)
            if topic in inertial
            else _rows(record, topic, columns[topic], window)
        )
        _write(rows, path, advance)
        written.append(path)
    return written


def _file_name(topic: str) -> str:
    """A topic as a file name that every file system takes, whatever the topic holds."""
    name = (keys.split(topic)[1] or topic).strip("/")
    return "".join(c if c.isalnum() or c in "._-" else "_" for c in name)[:_NAME_LENGTH]


def _free(folder: Path, name: str, taken: list[Path]) -> Path:
    """A file of this name, or with a number behind it where another topic has it."""
    path, number = folder / f"{name}.csv", 1
    while path in taken:
        number += 1
        path = folder / f"{name}_{number}.csv"
    return path


def _columns(
    record: Record, topics: set[str], window: Window, advance: Callable[[int], None] | None
) -> dict[str, list[str]]:
    """Every column that any message of a topic has, in the order of the fields."""
    found: dict[str, dict[str, _Order]] = {topic: {} for topic in topics}
    for entry, message in record.decoded(topics.__contains__, *window.span(record)):
        known = found[entry.topic]
        for order, name, _ in flatten(message):
            if name not in known:
                known[name] = order
        if advance is not None:
            advance(1)
    return {topic: sorted(known, key=known.__getitem__) for topic, known in found.items()}


def _rows(record: Record, topic: str, columns: list[str], window: Window) -> Iterator[list[Any]]:
    """The head, and a row a message."""
    place = {name: index + len(_ARRIVAL) for index, name in enumerate(columns)}
    yield [*_ARRIVAL, *map(cell, columns)]
    for entry, message in window.decoded(record, topic):
        row: list[Any] = [""] * (len(columns) + len(_ARRIVAL))
        row[0], row[1] = entry.log_ns, entry.publish_ns
        for _, name, value in flatten(message):
            row[place[name]] = cell(value)
        yield row


def _inertial(record: Record, topic: str, window: Window) -> Iterator[list[Any]]:
    """The head, and a row a sample, in SI units: no program reads lists of counts."""
    yield [*_ARRIVAL, *COLUMNS]
    for entry, batch in window.decoded(record, topic):
        for sample in samples(batch):
            yield [entry.log_ns, entry.publish_ns, *sample]


def _write(rows: Iterator[list[Any]], path: Path, advance: Callable[[int], None] | None) -> None:
    """Write a file that appears when it is whole."""
    unfinished = path.with_name(path.name + ".part")
    try:
        with unfinished.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            for row in rows:
                writer.writerow(row)
                if advance is not None:
                    advance(1)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def flatten(
    message: Any, prefix: str = "", order: _Order = ()
) -> Iterator[tuple[_Order, str, Any]]:
    """Cells of a message: where the column stands, its name, its value."""
    for index, field in enumerate(message.DESCRIPTOR.fields):
        value = getattr(message, field.name)
        name, here = prefix + field.name, (*order, (index, ""))
        if _is_map(field):
            for key in sorted(value):
                yield from _cells(value[key], f"{name}.{key}", (*here, (0, str(key))), None)
        elif field.is_repeated:
            for number, element in enumerate(value):
                yield from _cells(element, f"{name}.{number}", (*here, (number, "")), field)
        elif not field.has_presence or message.HasField(field.name):
            yield from _cells(value, name, here, field)


def _cells(
    value: Any, name: str, order: _Order, field: FieldDescriptor | None
) -> Iterator[tuple[_Order, str, Any]]:
    if isinstance(value, Timestamp):
        yield order, f"{name}_ns", value.ToNanoseconds()
    elif hasattr(value, "DESCRIPTOR"):
        yield from flatten(value, f"{name}.", order)
    elif isinstance(value, bytes):
        yield order, name, value.hex()
    elif field is not None and field.enum_type is not None:
        known = field.enum_type.values_by_number.get(value)
        yield order, name, known.name if known is not None else value
    else:
        yield order, name, value


def _is_map(field: FieldDescriptor) -> bool:
    kind = field.message_type
    return kind is not None and kind.GetOptions().map_entry
