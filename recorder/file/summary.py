"""The end of a record: what it holds, and where."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.layout import (
    DATA_END_BYTES,
    FOOTER_BYTES,
    MAGIC,
    METADATA_NAME,
    RECORD,
    copy_of,
    encode,
)

_KINDS: dict[int, type[McapRecord]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}
_INDEX = struct.Struct("<QQQQI")
"""Of a chunk index: first and last log time, place, length, bytes of the map that follows."""
_INDEX_NAME, _INDEX_SIZES = struct.Struct("<QI"), struct.Struct("<QQ")


@dataclass(slots=True)
class Contents:
    """What has been written to one file, enough to write or to replace its summary."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    start_ns: int = 0
    end_ns: int = 0

    @property
    def message_count(self) -> int:
        return sum(self.counts.values())

    def count(self, channel_id: int, messages: int) -> None:
        self.counts[channel_id] = self.counts.get(channel_id, 0) + messages

    def add_chunk(self, chunk: ChunkIndex) -> None:
        """Take note of a chunk; the first one sets the start."""
        start_ns = chunk.message_start_time
        self.start_ns = min(self.start_ns, start_ns) if self.chunks else start_ns
        self.end_ns = max(self.end_ns, chunk.message_end_time)
        self.chunks.append(chunk)

    def add_metadata(self, values: dict[str, str], offset: int) -> bytes:
        """The metadata record for `offset` and its copy."""
        record = encode(Metadata(METADATA_NAME, values))
        self.metadata.append(MetadataIndex(offset, len(record), METADATA_NAME))
        return record + copy_of(record)

    def add_attachment(self, record: Attachment, offset: int, length: int) -> None:
        """Take note of an attachment at `offset`."""
        self.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=record.log_time,
                create_time=record.create_time,
                data_size=len(record.data),
                name=record.name,
                media_type=record.media_type,
            )
        )

    def finish(self, offset: int, data_crc: int) -> bytes:
        """Everything from DataEnd to the last magic, for a data section that ends at `offset`.

        `data_crc` is the CRC-32 of all bytes before, 0 if it is not known.
        """
        start = offset + DATA_END_BYTES
        body, offsets = bytearray(), []
        for opcode, records in self._groups():
            group_start = len(body)
            for record in records:
                body += encode(record)
            if len(body) > group_start:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_start=start + group_start,
                        group_length=len(body) - group_start,
                    )
                )
        offset_start = start + len(body)
        for entry in offsets:
            body += encode(entry)
        footer = encode(Footer(start, offset_start, 0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(body))
        footer = encode(Footer(start, offset_start, crc))
        return encode(DataEnd(data_crc)) + body + footer + MAGIC

    def _groups(self) -> Iterable[tuple[Opcode, Iterable[McapRecord]]]:
        statistics = Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunks),
            message_count=self.message_count,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
        yield Opcode.SCHEMA, self.schemas.values()
        yield Opcode.CHANNEL, self.channels.values()
        yield Opcode.STATISTICS, [statistics]
        yield Opcode.CHUNK_INDEX, self.chunks
        yield Opcode.ATTACHMENT_INDEX, self.attachments
        yield Opcode.METADATA_INDEX, self.metadata


class End(NamedTuple):
    """The end of a file that was finished, by whatever writer."""

    footer: int
    """Where the footer begins, and the summary, if there is one, ends."""
    whole: bool
    """Whether the checksum over summary and footer holds, if one is stated."""


def read_end(source: Source) -> End | None:
    """The footer that a finished file has in front of its last magic; None if there is none."""
    tail = source.read(source.size - FOOTER_BYTES, FOOTER_BYTES)
    if len(tail) < FOOTER_BYTES or not tail.endswith(MAGIC):
        return None
    place = source.size - FOOTER_BYTES
    opcode, length = RECORD.unpack_from(tail)
    footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD.size :])))
    if opcode != Opcode.FOOTER or length != 20 or footer.summary_start > place:
        return None
    if not footer.summary_crc:
        return End(place, whole=True)
    start = footer.summary_start or place
    crc = zlib.crc32(tail[: RECORD.size + 16], zlib.crc32(source.read(start, place - start)))
    return End(place, crc == footer.summary_crc)


def read_summary(source: Source) -> tuple[Contents, int] | None:
    """Contents of a finished file by its summary, and where its data section ends.

    None if there is no summary, its checksum does not hold (or there is none) or it does not say
    where the messages are and of which channels.
    """
    tail = source.read(source.size - FOOTER_BYTES, FOOTER_BYTES)
    if len(tail) < FOOTER_BYTES or not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
        return None
    footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD.size :])))
    start, end = footer.summary_start, source.size - FOOTER_BYTES
    if not 0 < start <= end:
        return None
    body = source.read(start, end - start)
    if zlib.crc32(tail[: RECORD.size + 16], zlib.crc32(body)) != footer.summary_crc:
        return None
    contents, statistics = _collect(body)
    if statistics is None or (statistics.message_count and not contents.chunks):
        return None
    contents.counts = {id_: n for id_, n in statistics.channel_message_counts.items() if n}
    contents.start_ns = statistics.message_start_time
    contents.end_ns = statistics.message_end_time
    if contents.message_count != statistics.message_count or not _describes_all(contents):
        return None
    return contents, start - DATA_END_BYTES


def _describes_all(contents: Contents) -> bool:
    """Whether the summary repeats the channels and schemas of its messages, as it need not."""
    channels = contents.channels
    return all(id_ in channels for id_ in contents.counts) and all(
        not channel.schema_id or channel.schema_id in contents.schemas
        for channel in channels.values()
    )


def _collect(body: bytes) -> tuple[Contents, Statistics | None]:
    """Records of a summary whose checksum holds."""
    contents, statistics, position = Contents(), None, 0
    while position + RECORD.size <= len(body):
        opcode, length = RECORD.unpack_from(body, position)
        begin, position = position + RECORD.size, position + RECORD.size + length
        kind = _KINDS.get(opcode)
        if kind is None:
            continue
        try:
            if kind is ChunkIndex:
                contents.chunks.append(_chunk_index(body[begin:position]))
                continue
            stream = ReadDataStream(BytesIO(body[begin:position]))
            record = kind.read(stream)  # type: ignore[attr-defined]
        except (McapError, UnicodeDecodeError, struct.error, MemoryError, OverflowError):
            return contents, None
        match record:
            case Schema():
                contents.schemas[record.id] = record
            case Channel():
                contents.channels[record.id] = record
            case MetadataIndex():
                contents.metadata.append(record)
            case AttachmentIndex():
                contents.attachments.append(record)
            case Statistics():
                statistics = record
    return contents, statistics


def _chunk_index(content: bytes) -> ChunkIndex:
    """A chunk index; there may be a hundred thousand, and mcap's reader takes 70 µs for one.

    Raises
    ------
    struct.error, UnicodeDecodeError
        If its lengths lie.
    """
    start_ns, end_ns, offset, length, size = _INDEX.unpack_from(content)
    begin = _INDEX.size + size
    indexed_bytes, name_size = _INDEX_NAME.unpack_from(content, begin)
    begin += _INDEX_NAME.size + name_size
    compressed, uncompressed = _INDEX_SIZES.unpack_from(content, begin)
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=offset,
        compression=content[begin - name_size : begin].decode(),
        compressed_size=compressed,
        message_end_time=end_ns,
        message_index_length=indexed_bytes,
        message_index_offsets=dict(
            struct.iter_unpack("<HQ", content[_INDEX.size : _INDEX.size + size])
        ),
        message_start_time=start_ns,
        uncompressed_size=uncompressed,
    )
