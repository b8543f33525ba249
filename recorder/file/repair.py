"""Make a recorder's unfinished file whole where it lies, without a second copy on the disk.

1. What is to be written (the end of the file: messages of a torn chunk as a chunk of their own, the
   metadata once more with a `recovered` note, the summary; and heads that make damaged stretches
   void) goes into a redo log beside the file, with a checksum, and is synced.
2. The log is carried out, synced, the file gets its final name, the log is deleted.

Killed in step 1, the log's checksum fails and the untouched file is looked at again; killed in
step 2, the log is carried out again, which gives the same file. Good chunks are never moved, so a
file of five minutes takes well under a second.
"""

from __future__ import annotations

import fcntl
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import zstandard
from mcap.records import ChunkIndex, Header, MetadataIndex

from tramstream.errors import RecordError
from tramstream.recorder.file.chunk import assemble, encode_chunk
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.found import Part, Scan, attachment_at, restore
from tramstream.recorder.file.layout import GUARD, MAGIC, RECORD, VOID, encode, file_id_of
from tramstream.recorder.file.recover import Recovery, restore_schemas, values_of
from tramstream.recorder.file.scan import scan
from tramstream.recorder.file.sink import ACTIVE, reason
from tramstream.recorder.file.storage import DISK, Storage
from tramstream.recorder.file.summary import Contents

REDO = ".repair"
"""Ending of a repair's redo log, after the record's final name."""
_REDO_MAGIC = b"TramRep1"
_WRITE = struct.Struct("<QQ")
_LOT_BYTES = 4 << 20
_LARGEST = 1 << 62
"""No file is longer."""


def repair(active: Path, storage: Storage = DISK) -> Recovery:
    """Finish the record that a recorder left as `<name>.mcap.active`, in place.

    Safe to be killed at any moment and to be started again. A file without messages is deleted; of
    one that has its final name beside the other already, the other is taken away.

    Raises
    ------
    RecordError
        If the file is being written by somebody, holds what is no record, or its final name is
        taken.
    """
    final = active.with_name(active.name.removesuffix(ACTIVE))
    redo = final.with_name(final.name + REDO)
    with _locked(active) as fd:
        if final.exists() and not final.samefile(active):
            raise RecordError(
                f"{active}: {final.name} exists already", cure="move one of them away"
            )
        try:
            if final.exists():  # `Storage.rename` was cut between its two steps
                storage.unlink(active)
                storage.sync_directory(final.parent)
                with Source(final) as source:
                    return _of_finished(Recovery(active, final), source)
            log = _read_redo(redo)
            recovery = Recovery(active, final)
            with Source(active) as source:
                if log is None:
                    found = scan(source)
                    recovery.read(found)
                    if not recovery.messages:
                        return _delete_empty(active, found, storage)
                    restore_schemas(found)
                    log = _plan(source, found, recovery)
                    _write_redo(redo, log, storage)
            _carry_out(fd, log, storage)
            with Source(active) as source:
                recovery = recovery if recovery.messages else _of_finished(recovery, source)
            storage.rename(active, final)
            storage.sync_directory(final.parent)
            storage.unlink(redo)
            storage.sync_directory(final.parent)
        except OSError as error:
            raise RecordError(f"{active}: cannot be repaired: {reason(error)}") from error
    return recovery


@contextmanager
def _locked(active: Path) -> Iterator[int]:
    """Open for writing, if no living recorder has it."""
    try:
        fd = os.open(active, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise RecordError(f"{active}: cannot be repaired: {reason(error)}") from error
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise RecordError(
                f"{active}: is being written", cure="stop the recorder that has it first"
            ) from error
        yield fd
    finally:
        os.close(fd)


def _delete_empty(active: Path, found: Scan, storage: Storage) -> Recovery:
    """Delete a file that never got a message; keep one that has bytes nobody understands."""
    if found.size - found.good_end > 1 << 16:
        raise RecordError(
            f"{active}: holds no message that can be read", cure="look at it and delete it"
        )
    storage.unlink(active)
    storage.sync_directory(active.parent)
    return Recovery(active, None)


def _of_finished(recovery: Recovery, source: Source) -> Recovery:
    """What a repair that was killed half way had found: the finished file's own figures."""
    recovery.read(scan(source))
    return recovery


_Log = tuple[int, list[tuple[int, bytes]]]
"""Final size, and bytes to be written at offsets."""


def _plan(source: Source, found: Scan, recovery: Recovery) -> _Log:
    """What makes the file whole."""
    if found.finished and recovery.clean:
        return found.size, []
    contents, writes = _kept(source, found)
    end = found.good_end
    for part in (part for part in found.parts if part.whole):
        end = max(end, part.end)
    for offset, length in _void(found, end):
        writes.append((offset, RECORD.pack(VOID, length - RECORD.size)))
    writes += _front(source, found)
    tail = bytearray()
    values = values_of(found)
    torn = [restore(source, part).raw for part in found.parts if not part.whole]
    if torn:
        _add_chunk(tail, end, torn, contents, found)
    values["recovered"] = recovery.sentence
    tail += contents.add_metadata(values, end + len(tail))
    tail += contents.finish(end + len(tail), 0)
    writes.append((end, bytes(tail)))
    return end + len(tail), writes


def _kept(source: Source, found: Scan) -> tuple[Contents, list[tuple[int, bytes]]]:
    """Contents of what stays where it is, and heads of good chunks that are damaged themselves."""
    contents = Contents(found.schemas(), found.channels())
    writes: list[tuple[int, bytes]] = []
    for part in found.parts:
        for id_, count in part.tally.counts.items():
            contents.count(id_, count)
        if part.whole and part.head is not None:
            contents.add_chunk(_chunk_index(part))
            if part.guard is not None:
                guard = RECORD.pack(GUARD, part.offset - part.begin - RECORD.size)
                for offset, head in ((part.begin, guard), (part.offset, part.guard.head)):
                    if source.read(offset, len(head)) != head:
                        writes.append((offset, head))
    for offset, metadata in dict([*found.metadata, *found.proved_metadata]).items():
        record = encode(metadata)
        contents.metadata.append(MetadataIndex(offset, len(record), metadata.name))
        if source.read(offset, len(record)) != record:
            writes.append((offset, record))
    for offset, length in found.attachments:
        contents.add_attachment(attachment_at(source, offset, length), offset, length)
    return contents, writes


def _chunk_index(part: Part) -> ChunkIndex:
    assert part.head is not None
    return ChunkIndex(
        chunk_length=part.head.data_offset + part.head.data_size,
        chunk_start_offset=part.offset,
        compression=part.head.compression,
        compressed_size=part.head.data_size,
        message_end_time=part.tally.end_ns,
        message_index_length=part.index_bytes,
        message_index_offsets=dict(part.index_offsets),
        message_start_time=part.tally.start_ns,
        uncompressed_size=part.head.raw_size,
    )


def _front(source: Source, found: Scan) -> list[tuple[int, bytes]]:
    """The first bytes and the header again, if they are damaged: no tool opens a file without."""
    writes = [] if found.begins_well else [(0, MAGIC)]
    offset = len(MAGIC)
    lost = next((damage for damage in found.damages if damage.offset == offset), None)
    if lost is not None:
        room = lost.length - len(encode(Header("tramstream", "")))
        if room >= 0:
            writes.append((offset, encode(Header("tramstream", " " * room))))
    return writes


def _void(found: Scan, end: int) -> list[tuple[int, int]]:
    """Damaged stretches before `end`; a chunk's guard goes with it."""
    begins = {part.offset: part.begin for part in found.parts if not part.whole}
    proved = {offset for offset, _ in found.proved_metadata}
    stretches = []
    for damage in found.damages:
        begin = begins.get(damage.offset, damage.offset)
        length = damage.offset + damage.length - begin
        if (
            begin + length <= end
            and length >= RECORD.size
            and begin not in proved
            and begin > len(MAGIC)
        ):
            stretches.append((begin, length))
    return stretches


def _add_chunk(
    tail: bytearray, offset: int, torn: list[bytes], contents: Contents, found: Scan
) -> None:
    """Add messages of torn chunks as chunks of their own, all definitions before them."""
    definitions = b"".join(
        [encode(schema) for schema in contents.schemas.values()]
        + [encode(channel) for channel in contents.channels.values()]
    )
    tail += definitions
    file_id = found.file_id or file_id_of(b"")
    compressor = zstandard.ZstdCompressor(level=3)
    for records in _batches(torn):
        raw, marks, index = assemble(definitions, records, set(contents.channels))
        if not index:
            continue
        guard, chunk, indexes, entry = encode_chunk(compressor, raw, marks, index, file_id)
        tail += guard
        start = offset + len(tail)
        entry.chunk_start_offset = start
        entry.message_index_offsets = {
            id_: start + place for id_, place in entry.message_index_offsets.items()
        }
        contents.add_chunk(entry)
        tail += chunk + indexes


def _batches(torn: list[bytes]) -> Iterator[list[bytes]]:
    """Records of torn chunks in lots that one chunk can hold."""
    lot: list[bytes] = []
    for records in torn:
        if lot and sum(map(len, lot)) + len(records) > _LOT_BYTES:
            yield lot
            lot = []
        lot.append(records)
    yield lot


def _write_redo(path: Path, log: _Log, storage: Storage) -> None:
    size, writes = log
    body = b"".join(_WRITE.pack(offset, len(data)) + data for offset, data in writes)
    body = struct.pack("<Q", size) + body
    storage.unlink(path)  # of a repair that was killed
    fd = storage.create(path)
    try:
        _write_all(fd, _REDO_MAGIC + struct.pack("<I", zlib.crc32(body)) + body, 0, storage)
        storage.sync(fd)
    finally:
        storage.close(fd)
    storage.sync_directory(path.parent)


def _write_all(fd: int, data: bytes, offset: int, storage: Storage) -> None:
    view = memoryview(data)
    while view:
        done = storage.write(fd, view, offset)
        offset, view = offset + done, view[done:]


def _read_redo(path: Path) -> _Log | None:
    """A log that was written in full, or None."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    body = data[12:]
    if data[:8] != _REDO_MAGIC or data[8:12] != struct.pack("<I", zlib.crc32(body)):
        return None
    writes, position = [], 8
    while position + _WRITE.size <= len(body):
        offset, length = _WRITE.unpack_from(body, position)
        position += _WRITE.size + length
        writes.append((offset, body[position - length : position]))
    size = int.from_bytes(body[:8], "little")
    within = all(offset + len(data) <= size for offset, data in writes)
    return (size, writes) if position == len(body) and within and size < _LARGEST else None


def _carry_out(fd: int, log: _Log, storage: Storage) -> None:
    size, writes = log
    for offset, data in writes:
        _write_all(fd, data, offset, storage)
    storage.truncate(fd, size)
    storage.sync(fd)
