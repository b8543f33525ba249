"""Records of other writers, intact and with one bit flipped: told the same by reading and saving.

The writer is mcap's own; what it may leave out (chunks, checksums, summary, statistics, indexes,
repeated definitions) is left out one by one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from mcap.writer import CompressionType, IndexType, Writer
from record_samples import MS, START_NS, plain, read, traffic, write

from tramstream.keys import descriptor_set
from tramstream.recorder.describe import describe
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.recover import Recovery, recover
from tramstream.recorder.file.scan import scan
from tramstream.recorder.reader import open_record

COUNT = 60
STEP = 31
"""Between the bytes that are flipped within a file of 21 kB, most of it descriptions of types."""
VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "no chunks": {"use_chunking": False},
    "no checksums": {"enable_crcs": False},
    "no checksum of the data": {"enable_data_crcs": False},
    "all checksums": {"enable_data_crcs": True},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "no repeated channels": {"repeat_channels": False},
    "no repeated schemas": {"repeat_schemas": False},
    "no indexes": {"index_types": IndexType.NONE},
    "no chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "no message index": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "not compressed": {"compression": CompressionType.NONE},
    "no chunks, no checksums": {"use_chunking": False, "enable_crcs": False},
    "no summary": {
        "use_chunking": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
        "index_types": IndexType.NONE,
    },
    "chunks alone": {
        "enable_crcs": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
        "index_types": IndexType.NONE,
    },
}


def foreign(path: Path, **options: Any) -> Path:
    """A record by mcap's own writer, with metadata and an attachment."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=600, **options)
        writer.start("", "another writer")
        schema = writer.register_schema(
            "foxglove.LocationFix",
            "protobuf",
            descriptor_set(LocationFix).SerializeToString(),
        )
        channel = writer.register_channel("gps", "protobuf", schema)
        writer.add_metadata("ride", {"driver": "none"})
        writer.add_attachment(START_NS, START_NS, "note.txt", "text/plain", b"by hand")
        for number in range(COUNT):
            at_ns = START_NS + 100 * number * MS
            payload = LocationFix(latitude=50 + number / 1e4).SerializeToString()
            writer.add_message(channel, at_ns, payload, at_ns, number)
        writer.finish()
    return path


def told(path: Path) -> tuple[str, int, int]:
    """What `info` says is damaged; messages; files that were not finished."""
    with open_record(path, any_schema=True) as record:
        description = describe(record)
    return description.damaged, description.message_count, len(description.unfinished)


@pytest.mark.parametrize("name", VARIANTS)
def test_intact_record_of_another_writer_is_intact(tmp_path: Path, name: str) -> None:
    path = foreign(tmp_path / "a.mcap", **VARIANTS[name])
    assert told(path) == ("", COUNT, 0)
    recovery = recover(path, tmp_path / "b.mcap")
    assert (recovery.clean, recovery.messages) == (True, COUNT)
    assert plain(sorted(read_all(path))) == plain(sorted(read_all(tmp_path / "b.mcap")))


def read_all(path: Path) -> list[Any]:
    with open_record(path) as record:
        return list(record.messages())


@pytest.mark.parametrize("name", ["as it is", "no chunks", "no summary"])
def test_cut_record_of_another_writer_is_told(tmp_path: Path, name: str) -> None:
    path = foreign(tmp_path / "a.mcap", **VARIANTS[name])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    damaged, count, unfinished = told(path)
    assert damaged
    assert 0 < count <= COUNT
    assert unfinished == 1
    assert not recover(path, tmp_path / "b.mcap").clean


def flipped(data: bytes, place: int, bit: int) -> bytes:
    return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]


def test_each_flipped_byte_is_told_by_reading_as_by_saving(tmp_path: Path) -> None:
    """In chunks and outside of them; each of the first and last bytes, and some between them."""
    data = write(tmp_path / "a.mcap", traffic(12), flush_every=6).read_bytes()
    path = tmp_path / "b.mcap"
    silent = []
    ends = [*range(100), *range(len(data) - 100, len(data))]
    for place in sorted({*ends, *range(0, len(data), STEP)}):
        path.write_bytes(flipped(data, place, place % 8))
        saving = Recovery(path, None)
        with Source(path) as source:
            saving.read(scan(source))
        if saving.clean or not told(path)[0]:
            silent.append((place, saving.clean))
    assert silent == []


def test_what_is_damaged_outside_of_chunks_costs_no_message(tmp_path: Path) -> None:
    sent = traffic(12)
    data = write(tmp_path / "a.mcap", sent, flush_every=6).read_bytes()
    path = tmp_path / "b.mcap"
    path.write_bytes(flipped(data, 0x40, 0))
    assert told(path)[0]
    assert read(path) == plain(sent)
