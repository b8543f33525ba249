"""Any key as columns: every kind of field at its place, whoever wrote the type."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from tramstream.errors import MissingPackageError, RecordError, UnknownNameError
from tramstream.recorder import fields
from tramstream.recorder.fields import Fields
from tramstream.recorder.message_columns import BATCH, Columns, Span, read_columns
from tramstream.recorder.reader import open_record

TOPIC = "/camera/things"
_F = FieldDescriptorProto
LABELS = {"one": _F.LABEL_OPTIONAL, "many": _F.LABEL_REPEATED}


def described() -> descriptor_pb2.FileDescriptorSet:
    """A stranger's type with every kind of field, as its compiler would describe it."""
    file = descriptor_pb2.FileDescriptorProto(
        name="thing.proto",
        package="camera",
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )

    def add(message: Any, name: str, type_: int, label: str = "one", of: str = "") -> Any:
        number = len(message.field) + 1
        return message.field.add(
            name=name, number=number, type=type_, label=LABELS[label], type_name=of or None or None
        )

    colour = file.enum_type.add(name="Colour")
    for number, name in enumerate(("GREY", "RED", "GREEN")):
        colour.value.add(name=name, number=number)
    corner = file.message_type.add(name="Corner")
    add(corner, "x_px", _F.TYPE_DOUBLE)
    add(corner, "hue", _F.TYPE_ENUM, of=".camera.Colour")
    add(corner, "weights", _F.TYPE_DOUBLE, "many")
    thing = file.message_type.add(name="Thing")
    add(thing, "class", _F.TYPE_STRING)  # a word of Python's own
    add(thing, "count", _F.TYPE_UINT32)
    add(thing, "big", _F.TYPE_UINT64)
    add(thing, "ratio", _F.TYPE_FLOAT)
    add(thing, "seen", _F.TYPE_BOOL)
    add(thing, "pixels", _F.TYPE_BYTES)
    add(thing, "colour", _F.TYPE_ENUM, of=".camera.Colour")
    for name, type_ in (("depth_m", _F.TYPE_DOUBLE), ("score", _F.TYPE_INT32)):
        add(thing, name, type_).proto3_optional = True
        thing.field[-1].oneof_index = len(thing.oneof_decl)
        thing.oneof_decl.add(name=f"_{name}")
    add(thing, "centre", _F.TYPE_MESSAGE, of=".camera.Corner")
    add(thing, "corners", _F.TYPE_MESSAGE, "many", ".camera.Corner")
    add(thing, "row", _F.TYPE_INT64, "many")
    add(thing, "at", _F.TYPE_MESSAGE, of=".google.protobuf.Timestamp")
    add(thing, "parent", _F.TYPE_MESSAGE, of=".camera.Thing")
    entry = thing.nested_type.add(name="TagsEntry")
    entry.options.map_entry = True
    add(entry, "key", _F.TYPE_STRING)
    add(entry, "value", _F.TYPE_INT32)
    add(thing, "tags", _F.TYPE_MESSAGE, "many", ".camera.Thing.TagsEntry")
    found = descriptor_pb2.FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(found.file.add())
    found.file.append(file)
    return found


def thing_class() -> Any:
    pool = DescriptorPool()
    for file in described().file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("camera.Thing"))


Thing = thing_class()


def write(path: Path, payloads: Iterable[bytes], encoding: str = "protobuf") -> Path:
    """A record of a stranger: message number n arrives at n seconds."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        data = described().SerializeToString()
        schema = writer.register_schema("camera.Thing", encoding, data)
        channel = writer.register_channel(TOPIC, "protobuf", schema)
        for number, payload in enumerate(payloads):
            log_ns = number * 1_000_000_000
            writer.add_message(channel, log_ns, payload, log_ns + 5, number)
        writer.finish()
    return path


def columns_of(path: Path, *messages: Any, names: tuple[str, ...] = ()) -> Columns:
    with open_record(write(path, [each.SerializeToString() for each in messages])) as record:
        return read_columns(record, {TOPIC: names})[TOPIC]


def first() -> Any:
    message = Thing(count=2**32 - 1, big=7, ratio=0.5, seen=True, pixels=b"\x00\xff", colour=2)
    setattr(message, "class", "tram")
    message.depth_m, message.score = 4.25, -3
    message.centre.x_px, message.centre.hue = 1.5, 1
    for x_px in (1.0, 2.0):
        message.corners.add(x_px=x_px, hue=1, weights=[x_px] * int(x_px))
    message.row.extend([5, 6])
    message.at.FromNanoseconds(1_700_000_000_123_456_789)
    message.tags["left"] = 1
    message.parent.count = 9
    return message


def test_every_kind_of_field_is_in_its_column(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap", first(), Thing(row=[7, 8], corners=first().corners))
    assert columns.keys() == [
        *("class", "count", "big", "ratio", "seen", "pixels", "colour", "depth_m", "score"),
        *("centre.x_px", "centre.hue", "centre.weights"),
        *("corners.x_px", "corners.hue", "corners.weights"),
        *("row", "at_ns", "parent", "tags", "log_ns", "publish_ns", "sequence"),
    ]
    assert columns["class"].tolist() == ["tram", ""]
    assert columns["count"].tolist() == [2**32 - 1, 0]
    assert columns["count"].dtype == columns["big"].dtype == np.int64
    assert columns["ratio"].dtype == np.float32
    assert columns["ratio"].tolist() == [0.5, 0.0]
    assert columns["seen"].dtype == bool
    assert columns["seen"].tolist() == [True, False]
    assert columns["pixels"].tolist() == [b"\x00\xff", b""]
    assert columns["colour"].tolist() == [2, 0]
    assert columns.names("colour").tolist() == ["GREEN", "GREY"]
    assert columns["row"].tolist() == [[5, 6], [7, 8]]
    assert columns["row"].shape == (2, 2)
    assert columns["corners.x_px"].tolist() == [[1.0, 2.0], [1.0, 2.0]]
    assert columns.names("corners.hue").tolist() == [["RED", "RED"]] * 2
    assert [[w.tolist() for w in row] for row in columns["corners.weights"]] == [
        [[1.0], [2.0, 2.0]]
    ] * 2
    assert columns["tags"].tolist() == [{"left": 1}, {}]
    assert columns["log_ns"].tolist() == [0, 1_000_000_000]
    assert columns["publish_ns"].tolist() == [5, 1_000_000_005]
    assert columns["sequence"].tolist() == [0, 1]
    assert columns["parent"][0].count == 9


def test_what_is_absent_is_nan_masked_or_none(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap", Thing(), first())
    assert math.isnan(columns["depth_m"][0])
    assert columns["depth_m"][1] == 4.25
    assert columns["score"][0] is np.ma.masked
    assert columns["score"][1] == -3
    assert math.isnan(columns["centre.x_px"][0])
    assert columns.names("centre.hue").tolist() == [None, "RED"]
    assert columns["at_ns"][0] is np.ma.masked
    assert columns["at_ns"][1] == 1_700_000_000_123_456_789
    assert columns["parent"][0] is None


def test_lists_of_unequal_length_are_arrays_of_their_own_and_empty_floats_are_nan(
    tmp_path: Path,
) -> None:
    columns = columns_of(tmp_path / "x.mcap", Thing(row=[1]), Thing(), Thing(row=[2, 3]), first())
    assert [row.tolist() for row in columns["row"]] == [[1], [], [2, 3], [5, 6]]
    corners = columns["corners.x_px"]
    assert corners.shape == (4, 2)
    assert np.isnan(corners[:3]).all()
    assert corners[3].tolist() == [1.0, 2.0]


def test_unsigned_numbers_stay_unsigned_only_where_they_must(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap", Thing(big=2**63), Thing(big=1))
    assert columns["big"].dtype == np.uint64
    assert columns["big"].tolist() == [2**63, 1]


def test_elements_of_a_repeated_part_are_rows_with_their_messages_time(tmp_path: Path) -> None:
    elements = columns_of(tmp_path / "x.mcap", Thing(), first(), Thing(), first()).elements(
        "corners"
    )
    assert len(elements) == 4
    assert elements["log_ns"].tolist() == [1_000_000_000] * 2 + [3_000_000_000] * 2
    assert elements["x_px"].tolist() == [1.0, 2.0, 1.0, 2.0]
    assert elements.names("hue").tolist() == ["RED"] * 4
    assert elements.to_pandas()["x_px"].sum() == 6.0


def test_columns_chosen_by_name_or_part_are_read_alone(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap", first(), names=("corners", "count"))
    assert {*columns} - {"log_ns", "publish_ns", "sequence"} == {
        *("count", "corners.x_px", "corners.hue", "corners.weights")
    }


def test_wrong_names_offer_near_ones(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap", first())
    with pytest.raises(UnknownNameError, match=r"no column 'dept_m'; did you mean depth_m\?"):
        columns["dept_m"]
    with pytest.raises(KeyError):
        columns["dept_m"]
    with pytest.raises(UnknownNameError, match=r"'ratios'; did you mean ratio\?"):
        columns_of(tmp_path / "y.mcap", first(), names=("ratios",))
    with pytest.raises(UnknownNameError, match="ratio holds no enumeration; those that do: colour"):
        columns.names("ratio")
    with pytest.raises(UnknownNameError, match=r"no repeated part 'corner'; did you mean corners"):
        columns.elements("corner")


def test_more_messages_than_a_batch_keep_their_order_and_a_span_cuts_by_arrival(
    tmp_path: Path,
) -> None:
    count = 2 * BATCH + 3
    payloads = [Thing(count=n, row=range(n % 3)).SerializeToString() for n in range(count)]
    path = write(tmp_path / "x.mcap", payloads)
    with open_record(path) as record:
        columns = read_columns(record, {TOPIC: ()})[TOPIC]
        part = read_columns(record, {TOPIC: ()}, Span(10**10, 13 * 10**9))[TOPIC]
    assert columns["count"].tolist() == list(range(count))
    assert [len(row) for row in columns["row"]] == [n % 3 for n in range(count)]
    assert part["count"].tolist() == [10, 11, 12]


def test_undecodable_messages_are_left_out_and_counted(tmp_path: Path) -> None:
    whole = Thing(count=1).SerializeToString()
    path = write(tmp_path / "x.mcap", [whole, b"\xff\xff", whole])
    with open_record(path) as record:
        columns = read_columns(record, {TOPIC: ()})[TOPIC]
        assert columns["sequence"].tolist() == [0, 2]
        assert record.undecodable == {TOPIC: 1}


def test_key_without_protobuf_is_refused_in_a_sentence(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", [b"{}", b"{}"], encoding="jsonschema")
    with open_record(path) as record, pytest.raises(RecordError, match="2 messages are of no type"):
        read_columns(record, {TOPIC: ()})


def test_key_without_messages_has_its_columns(tmp_path: Path) -> None:
    columns = columns_of(tmp_path / "x.mcap")
    assert len(columns) == 0
    assert columns["depth_m"].dtype == np.float64
    assert columns["depth_m"].shape == columns["row"].shape == (0,)
    assert columns.to_pandas().shape[0] == columns.to_polars().shape[0] == 0


def test_wide_types_do_not_take_all_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty types, each with two parts of the next, would be a milliard of columns."""
    file = descriptor_pb2.FileDescriptorProto(name="wide.proto", package="wide", syntax="proto3")
    for level in range(30):
        message = file.message_type.add(name=f"L{level}")
        for number in (1, 2):
            message.field.add(
                name=f"p{number}",
                number=number,
                type=_F.TYPE_MESSAGE if level < 29 else _F.TYPE_DOUBLE,
                label=_F.LABEL_OPTIONAL,
                type_name=f".wide.L{level + 1}" if level < 29 else None,
            )
    pool = DescriptorPool()
    pool.Add(file)
    found = Fields(pool.FindMessageTypeByName("wide.L0"))
    assert len(found.columns) <= fields.MOST_COLUMNS + 30


# Frames -------------------------------------------------------------------------------------------
def test_pandas_frame_has_every_column_and_no_number_is_changed(tmp_path: Path) -> None:
    frame = columns_of(tmp_path / "x.mcap", first(), Thing(row=[7, 8])).to_pandas()
    assert frame["row.1"].tolist() == [6, 8]
    assert frame["score"].dtype.name == "Int64"
    assert frame["score"].isna().tolist() == [False, True]
    assert frame["at_ns"][0] == 1_700_000_000_123_456_789
    assert frame["centre.x_px"].isna().tolist() == [False, True]
    assert frame["class"].tolist() == ["tram", ""]


def test_polars_frame_has_every_column_and_no_number_is_changed(tmp_path: Path) -> None:
    frame = columns_of(tmp_path / "x.mcap", first(), Thing(row=[7, 8])).to_polars()
    assert frame["row"].to_list() == [[5, 6], [7, 8]]
    assert frame["score"].to_list() == [-3, None]
    assert frame["at_ns"].to_list() == [1_700_000_000_123_456_789, None]
    assert frame["pixels"].to_list() == [b"\x00\xff", b""]
    assert frame["class"].to_list() == ["tram", ""]


@pytest.mark.parametrize("name", ["pandas", "polars"])
def test_frame_without_its_package_names_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    columns = columns_of(tmp_path / "x.mcap", first())
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingPackageError, match=f"is not installed: `pip install {name}`"):
        getattr(columns, f"to_{name}")()


# Any message --------------------------------------------------------------------------------------
@given(
    st.lists(
        st.tuples(
            st.none() | st.floats(allow_nan=False),
            st.none() | st.integers(-(2**31), 2**31 - 1),
            st.lists(st.integers(-(2**63), 2**63 - 1), max_size=3),
            st.lists(st.lists(st.floats(allow_nan=False), max_size=2), max_size=2),
        ),
        max_size=20,
    ),
    st.integers(1, 7),
)
def test_columns_hold_what_the_messages_held_whatever_the_batches(
    rows: list[tuple[Any, Any, list[int], list[list[float]]]], size: int
) -> None:
    found = Fields(Thing.DESCRIPTOR)
    messages = []
    for depth_m, score, row, corners in rows:
        message = Thing(depth_m=depth_m, score=score, row=row)
        for weights in corners:
            message.corners.add(weights=weights)
        messages.append(message)
    for start in range(0, len(messages), size):
        found.add(messages[start : start + size])
    columns = {name: column.rows() for name, column in found.columns.items()}
    assert [None if math.isnan(x) else x for x in columns["depth_m"]] == [r[0] for r in rows]
    assert [None if x is np.ma.masked else x for x in columns["score"]] == [r[1] for r in rows]
    assert [list(row) for row in columns["row"]] == [r[2] for r in rows]
    assert [[list(w) for w in row] for row in columns["corners.weights"]] == [r[3] for r in rows]
