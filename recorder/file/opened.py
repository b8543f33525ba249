"""One file of a record: opened by its summary, or by walking through it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex, Schema

from tramstream.errors import RecordError
from tramstream.recorder.file.chunk import (
    MAX_CHUNK_BYTES,
    MAX_GUARD_BYTES,
    Restored,
    allowed_bytes,
    decode_chunk,
    read_chunk_head,
    read_guard,
)
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.found import Damage, Part, Scan, restore
from tramstream.recorder.file.layout import (
    COPY,
    GUARD_MAGIC,
    MAX_RECORD_BYTES,
    METADATA_NAME,
    RECORD,
    decode,
    read_copy,
    tally,
)
from tramstream.recorder.file.scan import data_holds, scan
from tramstream.recorder.file.summary import Contents, read_summary

_DIGITS = 6
"""A million parts of five minutes are ten years."""
_MAX_METADATA_BYTES = 4 << 20
_GUARD_REACH_BYTES = (1 << 12, MAX_GUARD_BYTES)
"""A guard is looked for so far before its chunk: nearly all are short."""


@dataclass(slots=True)
class Chunk:
    """Where messages are; `channels` is empty if it is not known which."""

    file: File
    start_ns: int
    end_ns: int
    place: ChunkIndex | Part
    channels: frozenset[int] = frozenset()


@dataclass(slots=True)
class File:
    """One file of a record."""

    path: Path
    source: Source
    metadata: dict[str, str] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0
    finished: bool = False
    data_end: int | None = None
    """Where the summary says that the data end; None if the file was walked through."""
    damages: list[Damage] = field(default_factory=list)
    told: set[int] = field(default_factory=set)
    """Where chunks are whose damage is in `damages` already."""
    chunks: list[Chunk] = field(default_factory=list)
    topics: dict[int, tuple[str, int]] = field(default_factory=dict)
    decompressor: zstandard.ZstdDecompressor = field(default_factory=zstandard.ZstdDecompressor)

    @property
    def session(self) -> str:
        return self.metadata.get("session", "")

    @property
    def part(self) -> int:
        text = self.metadata.get("part", "")
        return _number(text) or 0


def open_file(path: Path) -> File:
    source = Source(path)
    try:
        if not source.size:
            raise RecordError(f"{path}: is empty; it was created and never written, so delete it")
        file = File(path, source)
        summary = read_summary(source)
        if summary is not None:
            _by_summary(file, summary[0])
            file.data_end = summary[1]
        else:
            _by_scan(file, scan(source))
    except RecordError:
        source.close()
        raise
    return file


def _by_summary(file: File, contents: Contents) -> None:
    file.finished = True
    file.schemas, file.channels = contents.schemas, contents.channels
    file.counts, file.start_ns, file.end_ns = contents.counts, contents.start_ns, contents.end_ns
    for index in contents.metadata:
        if index.name == METADATA_NAME:
            file.metadata |= _metadata_at(file, index)
    allowed = allowed_bytes(file.source.size)
    for chunk in contents.chunks:
        if chunk.uncompressed_size > min(MAX_CHUNK_BYTES, allowed):
            what = "a chunk that states more than a record of this size can hold"
            file.damages.append(Damage(chunk.chunk_start_offset, chunk.chunk_length, what))
            continue
        allowed -= chunk.uncompressed_size
        ids = frozenset(chunk.message_index_offsets)
        span = chunk.message_start_time, chunk.message_end_time
        file.chunks.append(Chunk(file, *span, chunk, ids))


def _metadata_at(file: File, index: MetadataIndex) -> dict[str, str]:
    """Values of a metadata record; its copy goes first, for it has a checksum."""
    length = min(index.length, _MAX_METADATA_BYTES)
    head = file.source.read(index.offset + index.length, RECORD.size)
    if len(head) == RECORD.size:
        opcode, copied = RECORD.unpack(head)
        if opcode == COPY and copied <= _MAX_METADATA_BYTES:
            copy = read_copy(file.source.read(index.offset + index.length + RECORD.size, copied))
            if copy is not None:
                return copy.metadata
    record = decode(Metadata, file.source.read(index.offset + RECORD.size, length - RECORD.size))
    if record is None:
        file.damages.append(Damage(index.offset, index.length, "the record's metadata"))
    return record.metadata if record is not None else {}


def _by_scan(file: File, found: Scan) -> None:
    if not found.parts and not found.begins_well:
        raise RecordError(
            f"{file.path}: is no record (it does not begin like an MCAP file and no message is in "
            "it); check the name"
        )
    file.schemas, file.channels = found.schemas(), found.channels()
    file.finished = found.finished
    file.damages = found.damages
    if file.source.locked:  # being written: what is not whole yet is not damaged
        end = file.source.size
        file.damages = [d for d in found.damages if d.offset + d.length < end]
    for _, metadata in found.proved_metadata or found.metadata:
        if metadata.name == METADATA_NAME:
            file.metadata |= metadata.metadata
    for part in found.parts:
        counted = part.tally
        for id_, count in counted.counts.items():
            file.counts[id_] = file.counts.get(id_, 0) + count
        ids = frozenset(counted.counts)
        file.chunks.append(Chunk(file, counted.start_ns, counted.end_ns, part, ids))
    file.start_ns = min((chunk.start_ns for chunk in file.chunks), default=0)
    file.end_ns = max((chunk.end_ns for chunk in file.chunks), default=0)
    file.counts = {id_: count for id_, count in file.counts.items() if id_ in file.channels}


def load(chunk: Chunk) -> Restored:
    """Records of a chunk; what cannot be proved is left out and noted once."""
    source, place = chunk.file.source, chunk.place
    if isinstance(place, Part):
        return restore(source, place)
    record = source.read(place.chunk_start_offset, min(place.chunk_length, MAX_RECORD_BYTES))
    head = read_chunk_head(record[:64])
    restored = Restored(b"", whole=False)
    if head is not None and head.raw_size <= place.uncompressed_size:
        data = record[head.data_offset :]
        restored = decode_chunk(head, data, None, False, chunk.file.decompressor)
    if not restored.whole:
        if chunk.file.metadata:  # a file of ours
            restored = _by_guard(source, place)
        if not restored.whole and place.chunk_start_offset not in chunk.file.told:
            chunk.file.told.add(place.chunk_start_offset)
            saved = sum(tally(restored.raw).counts.values())
            what = f"a damaged chunk, {saved} messages of it saved"
            damage = Damage(place.chunk_start_offset, place.chunk_length, what)
            chunk.file.damages.append(damage)
    return restored


def place_of(chunk: Chunk) -> tuple[int, int]:
    """Where a chunk begins in its file, and how long it is."""
    place = chunk.place
    if isinstance(place, Part):
        return place.offset, place.end - place.offset
    return place.chunk_start_offset, place.chunk_length


def _by_guard(source: Source, place: ChunkIndex) -> Restored:
    """What the guard before a damaged chunk can prove of it."""
    for reach in _GUARD_REACH_BYTES:
        begin = max(place.chunk_start_offset - reach, 0)
        before = source.read(begin, place.chunk_start_offset - begin)
        guard = read_guard(before[max(before.rfind(GUARD_MAGIC), 0) :])
        if guard is not None:
            break
    head = read_chunk_head(guard.head) if guard is not None else None
    if (
        head is None
        or head.data_offset + head.data_size != place.chunk_length
        or head.raw_size > place.uncompressed_size
        or head.data_size > MAX_CHUNK_BYTES
    ):
        return Restored(b"", whole=False)
    data = source.read(place.chunk_start_offset + head.data_offset, head.data_size)
    return decode_chunk(head, data, guard, cut=False)


def check_outside(file: File) -> None:
    """Look at the bytes outside of the chunks too, of a file that was opened by its summary.

    They tell nothing that the summary does not tell, but a disk that changes them changes others.
    """
    if file.data_end is None or data_holds(file.source, file.data_end):
        return
    known = {damage.offset for damage in file.damages}
    file.damages += [each for each in scan(file.source).damages if each.offset not in known]


def schema_version(file: File) -> int | None:
    texts = [file.metadata.get("schema_version", "")]
    texts += [channel.metadata.get("schema_version", "") for channel in file.channels.values()]
    return next((number for text in texts if (number := _number(text)) is not None), None)


def _number(text: str) -> int | None:
    """A count out of metadata, where anything may stand."""
    return int(text) if text.isdecimal() and len(text) <= _DIGITS else None
