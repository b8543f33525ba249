"""Records that are made to take all memory or all time: bounded, told, the rest saved."""

from __future__ import annotations

import struct
import sys
import zlib
from functools import cache
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from children import measured
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Header, Message, Schema
from record_samples import START_NS, active, plain, read, traffic, write

from tramstream.recorder.file import diskfile
from tramstream.recorder.file.chunk import MAX_CHUNK_BYTES, allowed_bytes, encode_chunk
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.layout import CHUNK_ZSTD, MAGIC, MAX_RECORD_BYTES, RECORD, encode
from tramstream.recorder.file.recover import recover
from tramstream.recorder.file.scan import scan
from tramstream.recorder.file.summary import Contents
from tramstream.recorder.reader import open_record

MORE_MB = 200
GIGABYTES = 3 << 30
IMPORTS = """
from pathlib import Path
from tramstream.recorder.describe import describe
from tramstream.recorder.reader import open_record
from tramstream.recorder.file.recover import recover
from tramstream.recorder.file.repair import repair
"""
INFO = "describe(open_record(Path(sys.argv[1]), any_schema=True))"
RECOVER = "recover(Path(sys.argv[1]), Path(sys.argv[1] + '.out'))"
REPAIR = "repair(Path(sys.argv[1]))"


@cache
def zeros(size: int, compression: str, stated: bool = True) -> bytes:
    """Compressed zeros, a few kilobytes of them for gigabytes."""
    block = bytes(1 << 20)
    if compression == "zstd":
        frame = zstandard.ZstdCompressor(level=1).compressobj(size=size if stated else -1)
        parts = [frame.compress(block) for _ in range(size >> 20)]
        return b"".join([*parts, frame.flush()])
    lz = lz4.frame.LZ4FrameCompressor()
    return b"".join([lz.begin(), *(lz.compress(block) for _ in range(size >> 20)), lz.flush()])


def chunk(data: bytes, raw_size: int, compression: str, crc: int = 0) -> bytes:
    name = compression.encode()
    content = struct.pack("<QQQII", START_NS, START_NS + 1, raw_size, crc, len(name)) + name
    content += struct.pack("<Q", len(data)) + data
    return RECORD.pack(Opcode.CHUNK, len(content)) + content


def good_chunk(number: int, payload: bytes = b"x", compression: str = "zstd") -> bytes:
    """A chunk of one message, as a writer makes it."""
    raw = encode(Schema(id=1, name="T", encoding="", data=b""))
    raw += encode(Channel(id=1, topic="/t", message_encoding="", schema_id=1, metadata={}))
    raw += encode(
        Message(
            channel_id=1, sequence=number, log_time=START_NS, publish_time=START_NS, data=payload
        )
    )
    data = zstandard.ZstdCompressor().compress(raw) if compression == "zstd" else raw
    return chunk(data, len(raw), compression, zlib.crc32(raw))


def finished(path: Path, chunks: list[bytes], name_each: int = 1) -> Path:
    """A finished foreign record; its summary names each chunk, or names it several times."""
    contents, data = Contents(), bytearray(MAGIC + encode_header())
    contents.schemas[1] = Schema(id=1, name="T", encoding="", data=b"")
    contents.channels[1] = Channel(id=1, topic="/t", message_encoding="", schema_id=1, metadata={})
    contents.counts[1] = len(chunks)
    for one in chunks:
        index = index_of(one, len(data))
        for _ in range(name_each):
            contents.add_chunk(index)
        data += one
    path.write_bytes(bytes(data) + contents.finish(len(data), 0))
    return path


def encode_header() -> bytes:
    return encode(Header(profile="", library="somebody"))


def index_of(record: bytes, offset: int) -> ChunkIndex:
    _, _, start_ns, end_ns, raw_size = struct.unpack_from("<BQQQQ", record)
    return ChunkIndex(
        chunk_length=len(record),
        chunk_start_offset=offset,
        compression="zstd",
        compressed_size=len(record) - 60,
        message_end_time=end_ns,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=start_ns,
        uncompressed_size=raw_size,
    )


BOMBS = {
    "zstd, states 1000": lambda: chunk(zeros(GIGABYTES, "zstd"), 1000, "zstd"),
    "zstd, size not in the frame": lambda: chunk(zeros(GIGABYTES, "zstd", False), 1000, "zstd"),
    "zstd, states 3 GB": lambda: chunk(zeros(GIGABYTES, "zstd"), GIGABYTES, "zstd"),
    "lz4, states 1000": lambda: chunk(zeros(1 << 30, "lz4"), 1000, "lz4"),
    "lz4, states 1 GB": lambda: chunk(zeros(1 << 30, "lz4"), 1 << 30, "lz4"),
}


@pytest.mark.parametrize("bomb", BOMBS)
@pytest.mark.parametrize("end", ["finished", "without an end", "torn"])
def test_chunk_gives_no_more_than_it_states_and_the_rest_is_saved(
    tmp_path: Path, bomb: str, end: str
) -> None:
    path = tmp_path / "a.mcap"
    chunks = [good_chunk(1), BOMBS[bomb](), good_chunk(2)]
    if end == "finished":
        finished(path, chunks)
    else:
        chunks = chunks if end == "without an end" else [*chunks[:1], chunks[1][:-20]]
        path.write_bytes(MAGIC + encode_header() + b"".join(chunks))
    for work in (INFO, RECOVER):
        more_mb, _, said = measured(IMPORTS, work, path)
        assert said == "done"
        assert more_mb < MORE_MB
    with open_record(tmp_path / "a.mcap.out") as saved:
        assert [entry.sequence for entry in saved.messages()] == [1] + [2] * (end != "torn")
    with open_record(path) as record:
        assert len(list(record.messages())) == 1 + (end != "torn")
        assert "chunk" in record.damaged


def test_recorder_that_starts_is_not_stopped_by_a_bomb_of_before(tmp_path: Path) -> None:
    """A torn chunk with a guard whose checksums hold: whoever writes the file can write those."""
    path = active(tmp_path / "a.mcap", traffic(40), 20)
    with Source(path) as source:
        file_id = scan(source).file_id
    raw = bytearray(8 << 20)
    guard, record, _, _ = encode_chunk(
        zstandard.ZstdCompressor(), raw, [], {1: [START_NS, 0]}, file_id
    )
    head_at = guard.index(record[: CHUNK_ZSTD.size])
    lying = bytearray(guard)
    lying[head_at + 25 : head_at + 33] = struct.pack("<Q", GIGABYTES)  # states 3 GB
    lying[-4:] = struct.pack("<I", zlib.crc32(bytes(lying[9:-4])))
    path.write_bytes(path.read_bytes() + bytes(lying) + record[:-3])
    more_mb, _, said = measured(IMPORTS, REPAIR, path)
    assert said == "done"
    assert more_mb < MORE_MB
    assert len(read(tmp_path / "a.mcap")) == 40


@pytest.mark.parametrize("named", [1, 400])
def test_chunks_together_give_what_a_file_of_this_size_can_hold(tmp_path: Path, named: int) -> None:
    """131 kB that would be gigabytes: hundreds of chunks, or one that the summary names often."""
    large = good_chunk(1, bytes(MAX_CHUNK_BYTES - 4096))
    path = finished(tmp_path / "a.mcap", [large] * (1 if named > 1 else 40), named)
    size = path.stat().st_size
    assert size < 200_000
    assert (40 if named == 1 else 400) * MAX_CHUNK_BYTES > 8 * allowed_bytes(size)
    for work in (INFO, RECOVER):
        more_mb, _, said = measured(IMPORTS, work, path)
        assert said == "done"
        assert more_mb < MORE_MB
    with open_record(path) as record:
        assert "states more than a record of this size can hold" in record.damaged


def test_record_that_is_too_long_is_stepped_over(tmp_path: Path) -> None:
    """An attachment of a gigabyte that takes no room on the disk."""
    path = tmp_path / "a.mcap"
    head = encode(Attachment(0, 0, "", "", b""))
    with path.open("wb") as file:
        file.write(MAGIC + encode_header() + good_chunk(1))
        file.write(RECORD.pack(Opcode.ATTACHMENT, 1 << 30) + head[9:])
        file.seek((1 << 30) - len(head) + 9, 1)
        file.write(good_chunk(2))
    more_mb, _, said = measured(IMPORTS, INFO, path)
    assert said == "done"
    assert more_mb < MORE_MB
    with open_record(path) as record:
        assert [entry.sequence for entry in record.messages()] == [1, 2]
        assert "too long to read" in record.damaged
    assert MAX_RECORD_BYTES < 1 << 30


def test_large_chunk_of_another_writer_is_read(tmp_path: Path) -> None:
    payload = bytes(range(256)) * (1 << 15)  # 8 MB, which compress to nothing
    path = finished(tmp_path / "a.mcap", [good_chunk(1, payload), good_chunk(2, b"", "")])
    with open_record(path) as record:
        assert [len(entry.payload) for entry in record.messages()] == [1 << 23, 0]
        assert record.damaged == ""


def test_what_only_looks_like_chunks_is_looked_at_a_bounded_number_of_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A megabyte of heads, each of which claims the rest of the file."""
    path = tmp_path / "a.mcap"
    one = struct.pack("<QQQII", 1, 2, 1 << 24, 7, 4) + b"zstd"
    junk = bytearray()
    total = 1 << 20
    while len(junk) < total:
        size = total - len(junk)
        junk += RECORD.pack(Opcode.CHUNK, len(one) + 8 + size) + one + struct.pack("<Q", size)
    path.write_bytes(MAGIC + encode_header() + bytes(3) + junk + bytes(total) + good_chunk(2))
    read_bytes = 0
    pread = diskfile.Source._pread

    def counted(self: Source, length: int, offset: int) -> bytes:
        nonlocal read_bytes
        data = pread(self, length, offset)
        read_bytes += len(data)
        return data

    monkeypatch.setattr(diskfile.Source, "_pread", counted)
    with Source(path) as source:
        scan(source)
    assert read_bytes < 400 << 20  # each of 20,000 heads would be 1 MB and more


def test_numbers_in_metadata_may_be_anything(tmp_path: Path) -> None:
    """A part of twenty digits would have all parts before it named as missing."""
    for name, part in (("a", "1"), ("b", "9" * 20), ("c", "9" * 5000)):
        values = {"session": "s", "part": part, "schema_version": "1"}
        write(tmp_path / f"{name}.mcap", traffic(3), metadata=values)
    more_mb, _, said = measured(IMPORTS, INFO, tmp_path)
    assert said == "done"
    assert more_mb < MORE_MB


def test_more_parts_than_files_may_be_open_are_read_together(tmp_path: Path) -> None:
    parts = [traffic(2, seed=number, start_ns=START_NS + number * 10**9) for number in range(80)]
    for number, sent in enumerate(parts):
        values = {"session": "s", "part": str(number + 1)}
        write(tmp_path / f"{number:03}.mcap", sent, metadata=values)
    work = (
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64)); "
        "import tramstream.recorder.file.diskfile as d; d.OPEN_FILES = 20; "
        "record = open_record(Path(sys.argv[1])); found = list(record.messages()); "
        "assert len(found) == 160, len(found); assert len(d._open) == 20"
    )
    _, _, said = measured(IMPORTS, work, tmp_path)
    assert said == "done"


@pytest.mark.study
def test_a_thousand_and_five_hundred_parts_are_read_with_the_usual_limit(tmp_path: Path) -> None:
    """`ulimit -n 1024`: 1,500 parts, as five days of a vehicle are."""
    for number in range(1500):
        values = {"session": "s", "part": str(number + 1)}
        sent = traffic(2, seed=number, start_ns=START_NS + number * 10**9)
        write(tmp_path / f"{number:04}.mcap", sent, metadata=values)
    work = (
        "resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024)); "
        "assert describe(open_record(Path(sys.argv[1]))).message_count == 3000"
    )
    assert measured(IMPORTS, work, tmp_path)[2] == "done"


def test_part_is_found_again_after_it_was_finished_and_not_after_it_was_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diskfile, "OPEN_FILES", 1)
    path, other = tmp_path / "a.mcap.active", tmp_path / "b"
    path.write_bytes(b"first")
    other.write_bytes(b"other")
    with Source(path) as one, Source(other) as two:
        path.rename(tmp_path / "a.mcap")
        assert two.read(0, 5) == b"other"
        assert one.read(0, 5) == b"first"
        assert two.read(0, 5) == b"other"
        (tmp_path / "new").write_bytes(b"stale")
        (tmp_path / "new").rename(tmp_path / "a.mcap")
        with pytest.raises(Exception, match="deleted or replaced"):
            one.read(0, 5)


def test_messages_of_chunks_that_all_overlap_come_in_order(tmp_path: Path) -> None:
    sent = traffic(300)
    ends = [one._replace(log_ns=one.log_ns + 10**12) for one in sent[::3]]
    mixed = [each for pair in zip(sent[::3], ends, sent[1::3], strict=True) for each in pair]
    path = write(tmp_path / "a.mcap", mixed, flush_every=3)
    with open_record(path) as record:
        found = list(record.messages())
        assert len(record.files[0].chunks) == 100
    assert sorted(plain(found)) == sorted(plain(mixed))
    order = [(entry.log_ns, entry.channel_id, entry.sequence) for entry in found]
    assert order == sorted(order)


def test_many_small_chunks_take_time_in_proportion(tmp_path: Path) -> None:
    """Steps are counted, not seconds: four times the chunks, four times the calls and no more."""
    calls = []
    for count in (500, 2000):
        path = tmp_path / f"{count}.mcap"
        write(path, traffic(count), flush_every=1)
        cut = tmp_path / f"{count}.cut"
        cut.write_bytes(path.read_bytes()[:-100])
        calls += [_lines_of_python(work) for work in (path, cut)]
    assert calls[2] < 5 * calls[0]
    assert calls[3] < 5 * calls[1]


def _lines_of_python(path: Path) -> int:
    count = 0

    def trace(frame: object, event: str, argument: object):
        nonlocal count
        count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        with open_record(path) as record:
            for _ in record.messages():
                pass
    finally:
        sys.settrace(before)
    return count


def test_recovery_of_a_bomb_keeps_what_else_there_is(tmp_path: Path) -> None:
    source = finished(tmp_path / "a.mcap", [good_chunk(1), BOMBS["zstd, states 1000"]()])
    assert not recover(source, tmp_path / "b.mcap").clean
