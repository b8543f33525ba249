"""The bytes of a record: MCAP's own layout, and what tramstream adds to it.

A record is an MCAP file (https://mcap.dev/spec) in this order::

    magic  Header  Metadata "tramstream"  Copy
    ( Schema*  Channel*  Guard  Chunk  MessageIndex* )*
    DataEnd  Schema*  Channel*  Statistics  ChunkIndex*  MetadataIndex*  SummaryOffset*
    Footer  magic

Guard and Copy are private records (MCAP leaves opcodes from 0x80 to applications; other tools skip
them). They hold what MCAP has no checksum for:

- A **Guard** stands before its chunk, repeats the chunk's head and has the CRC-32 of each
  compressed block, so that a torn or damaged chunk gives all that can be proved right, and so that
  the next chunk is found when a length is damaged. `file_id` binds it to its file: a stale disk
  block of an older file never passes.
- A **Copy** repeats the metadata record before it, with a CRC-32.

Schemas and channels stand in the chunk that first uses them (where its CRC protects them), once
more before that chunk (so that a lost chunk does not take them along) and in the summary.
"""

from __future__ import annotations

import struct
import zlib
from hashlib import blake2b
from io import BytesIO
from typing import NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
GUARD, COPY, VOID = 0x90, 0x91, 0x92
"""Private opcodes. VOID covers bytes of a repaired file that hold nothing any more."""
GUARD_MAGIC, COPY_MAGIC = b"TramGrd1", b"TramCpy1"

RECORD = struct.Struct("<BQ")
"""Opcode and length of every record."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time; the payload follows."""
CHUNK = struct.Struct("<BQQQQI")
"""Opcode, length, start, end, uncompressed size, CRC-32; compression and data follow."""
CHUNK_ZSTD = struct.Struct("<BQQQQII4sQ")
"""The head of a chunk of ours up to its data."""
FOOTER_BYTES = RECORD.size + 20 + len(MAGIC)
DATA_END_BYTES = RECORD.size + 4
MAX_RECORD_BYTES = 64 << 20
"""Longest record that is read: a chunk with its head is shorter (`chunk.MAX_CHUNK_BYTES`). A longer
attachment is stepped over and told."""

METADATA_NAME = "tramstream"
Record_ = TypeVar("Record_", bound=McapRecord)


class Entry(NamedTuple):
    """One message of a record, still encoded."""

    topic: str
    payload: bytes
    log_ns: int
    publish_ns: int
    sequence: int
    channel_id: int


class Tally(NamedTuple):
    """What the records of one chunk are: `end` is where the last whole one ends."""

    counts: dict[int, int]
    schemas: list[Schema]
    channels: list[Channel]
    start_ns: int
    end_ns: int
    end: int


NOTHING = Tally({}, [], [], 0, 0, 0)


def encode(record: McapRecord) -> bytes:
    """Bytes of a record, opcode and length included."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def decode(kind: type[Record_], content: bytes) -> Record_ | None:
    """The record of `kind` whose content is `content`, or None if that cannot be.

    Encoding it again must give the same bytes, so that a damaged inner length is always found;
    fields that a newer writer added at the end are passed over, as MCAP wants.
    """
    stream = ReadDataStream(BytesIO(content))
    try:
        record: Record_ = kind.read(stream)  # type: ignore[attr-defined]
    except (McapError, UnicodeDecodeError, struct.error, MemoryError, OverflowError):
        return None
    return record if content.startswith(encode(record)[RECORD.size :]) else None


def copy_of(metadata: bytes) -> bytes:
    """The Copy that follows the metadata record `metadata`."""
    head = RECORD.pack(COPY, len(COPY_MAGIC) + 4 + len(metadata))
    return head + COPY_MAGIC + struct.pack("<I", zlib.crc32(metadata)) + metadata


def read_copy(content: bytes) -> Metadata | None:
    """The metadata of a Copy's content, or None if its checksum does not hold."""
    body = content[12:]
    if content[:8] != COPY_MAGIC or content[8:12] != struct.pack("<I", zlib.crc32(body)):
        return None
    return decode(Metadata, body[RECORD.size :])


def file_id_of(metadata: bytes) -> bytes:
    """Eight bytes that bind guards to the file with the metadata record `metadata`."""
    return blake2b(metadata, digest_size=8).digest()


def message_index(channel_id: int, entries: list[int]) -> bytes:
    """A MessageIndex record; `entries` alternates log time and offset in the chunk."""
    size = 8 * len(entries)
    head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, size + 6, channel_id, size)
    return head + struct.pack(f"<{len(entries)}Q", *entries)


def entries_of(
    raw: bytes, topics: dict[int, tuple[str, int]], start_ns: int, end_ns: int
) -> list[Entry]:
    """Messages of a chunk's records on the channels of `topics` (topic, channel id to give out).

    Only those with start_ns ≤ log_ns < end_ns, in the order in which they stand.
    """
    found: list[Entry] = []
    keep, unpack, get, make = found.append, MESSAGE.unpack_from, topics.get, tuple.__new__
    position, size = 0, len(raw)
    last = size - MESSAGE.size
    while position <= last:
        opcode, length, channel_id, sequence, log_ns, publish_ns = unpack(raw, position)
        end = position + 9 + length
        if opcode == 5:
            known = get(channel_id)
            if known is not None and start_ns <= log_ns < end_ns and position + 31 <= end <= size:
                payload = raw[position + 31 : end]
                entry = (known[0], payload, log_ns, publish_ns, sequence, known[1])
                keep(make(Entry, entry))
        position = end
    return found


def tally(raw: bytes) -> Tally:
    """Count a chunk's messages and collect its definitions; stops at what is not whole."""
    counts: dict[int, int] = {}
    schemas: list[Schema] = []
    channels: list[Channel] = []
    defined: set[tuple[int, bytes]] = set()
    start_ns, end_ns = 1 << 64, 0
    unpack, last = MESSAGE.unpack_from, len(raw) - MESSAGE.size
    position, size = 0, len(raw)
    while position < size:
        if position <= last:
            opcode, length, channel_id, _, log_ns, _ = unpack(raw, position)
        elif position + RECORD.size <= size:  # no message is as short
            opcode, length = RECORD.unpack_from(raw, position)
        else:
            break
        end = position + 9 + length
        if end > size or opcode == 0:
            break
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size - RECORD.size:
                break
            counts[channel_id] = counts.get(channel_id, 0) + 1
            start_ns = min(start_ns, log_ns)
            end_ns = max(end_ns, log_ns)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definition = raw[position + 9 : end]
            if (opcode, definition[:2]) not in defined:  # the first one with an id goes
                defined.add((opcode, definition[:2]))
                schema = decode(Schema, definition) if opcode == Opcode.SCHEMA else None
                channel = decode(Channel, definition) if opcode == Opcode.CHANNEL else None
                schemas += [schema] if schema else []
                channels += [channel] if channel else []
        position = end
    return Tally(counts, schemas, channels, start_ns if counts else 0, end_ns, position)
