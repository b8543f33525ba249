"""Write one record so that a power cut takes little.

`append` only adds to the open chunk in memory. `flush` closes the chunk and hands it on; a worker
writes it whole and syncs it. A group that does not fit on the disk is cut off again and kept until
it does; beyond `limit_bytes` further messages are dropped and counted. Nothing in the file depends
on a clock or on chance: equal appends and flushes give equal bytes.

The library's `Writer.add_message` costs 4.6 µs a message here; the path below about 1 (it packs the
message into the chunk directly), so that reprocessing is not held up by its own output. Everything
else uses the library's record classes.
"""

from __future__ import annotations

import socket
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zstandard
from google.protobuf.message import Message
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, MetadataIndex, Schema

from tramstream import __version__
from tramstream.clock import boot_id
from tramstream.errors import RecordError, TramstreamError
from tramstream.events.kinds import Event
from tramstream.keys import SCHEMA_VERSION, Key, descriptor_set
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.file.chunk import BLOCK_BYTES, decode_chunk, encode_chunk, read_chunk_head
from tramstream.recorder.file.layout import MAGIC, MESSAGE, RECORD, encode, entries_of, file_id_of
from tramstream.recorder.file.sink import LIMIT_BYTES, Loss, LossBook, Sink, Worker
from tramstream.recorder.file.summary import Contents

_SOFTWARE = f"tramstream {__version__}"
MAX_MESSAGE_BYTES = 16 << 20
"""A longer message would make a chunk that no reader takes (`chunk.MAX_CHUNK_BYTES`)."""
CHUNK_BYTES = 1 << 20
"""A chunk is closed at this size even between flushes."""
_PAYLOAD_FROM = MESSAGE.size - RECORD.size
_pack = MESSAGE.pack


@dataclass(slots=True)
class _Stream:
    """One channel of the file; `index` alternates log time and offset in the open chunk."""

    id: int
    topic: str
    index: list[int] = field(default_factory=list)


class RecordFile:
    """One MCAP file, `<path>.active` until it is closed.

    Parameters
    ----------
    path : Path
        Final name.
    vehicle : str
        Empty for messages that are not tramstream's: the file then says nothing of us.
    metadata : Mapping[str, str], optional
        Added to the metadata record "tramstream" beside schema_version, vehicle and software. What
        tells one host or boot from another goes here (`host_metadata`), not into the writer.
    worker : Worker, optional
        With one the file is live: disk work is the worker's, trouble is shown in `state` and
        `trouble`, dropped messages are counted. Without one each full chunk is written at once and
        trouble raises RecordError.
    chunk_bytes, limit_bytes : int
        Size at which a chunk is closed; most that is kept while the disk refuses.

    Raises
    ------
    RecordError
        If a file of that name is already there.
    """

    def __init__(
        self,
        path: Path,
        vehicle: str,
        metadata: Mapping[str, str] | None = None,
        worker: Worker | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        limit_bytes: int = LIMIT_BYTES,
    ) -> None:
        if path.exists():
            raise RecordError(f"{path}: exists already; choose another name or delete it")
        self.path = path
        self.contents = Contents()
        self._live = worker is not None
        self._sink = Sink(path, worker or Worker(threaded=False), durable=self._live)
        self._losses = LossBook()
        self._chunk_bytes, self._limit_bytes = chunk_bytes, limit_bytes
        self._compressor = zstandard.ZstdCompressor(level=3)
        self._streams: dict[str, _Stream] = {}
        self._by_id: dict[int, _Stream] = {}
        self._fresh: list[bytes] = []
        self._crc = 0
        self.file_id = file_id_of(b"")
        self._full = self._closed = False
        self._buffer = bytearray()
        self._marks: list[int] = []
        self._mark = 0
        self.block_bytes = BLOCK_BYTES
        """Records that a tear loses; a file that can be made again is written faster in whole
        chunks."""
        values = {
            "schema_version": str(SCHEMA_VERSION),
            "vehicle": vehicle,
            "software": _SOFTWARE,
            **(metadata or {}),
        }
        self._values = values
        head = MAGIC + encode(Header("tramstream" if vehicle else "", _SOFTWARE))
        record = b""
        if vehicle:
            record = self.contents.add_metadata(values, len(head))
            self.file_id = file_id_of(record[: RECORD.size + RECORD.unpack_from(record)[1]])
        self._put(head + record)

    @property
    def size(self) -> int:
        """Bytes of the file so far, the open chunk as it is in memory."""
        return self._sink.size + len(self._buffer)

    @property
    def message_count(self) -> int:
        """Messages accepted."""
        return self.contents.message_count + self._messages()

    @property
    def dropped_count(self) -> int:
        """Messages dropped since the file was begun."""
        return self._losses.count

    @property
    def pending_bytes(self) -> int:
        """Closed chunks that are not in the file yet."""
        return self._sink.pending_bytes

    @property
    def spoiled(self) -> bool:
        """Whether a sync failed: the caller should go on in another file."""
        return self._sink.spoiled

    @property
    def finished(self) -> bool:
        """Whether the file has its final name."""
        return self._sink.finished

    @property
    def state(self) -> int:
        """A value of NodeHealth.State."""
        if self._full:
            return int(NodeHealth.FAILED)
        return int(NodeHealth.DEGRADED if self._sink.error else NodeHealth.OK)

    @property
    def trouble(self) -> Event | None:
        """What is wrong if the state is not OK."""
        return self._sink.trouble(self._losses.count)

    def adopt(self, other: RecordFile) -> None:
        """Take over all channels of `other` with their ids, so that parts number them alike."""
        for channel in other.contents.channels.values():
            self.define(channel, other.contents.schemas.get(channel.schema_id))

    def define(self, channel: Channel, schema: Schema | None) -> None:
        """Add a channel with a given id."""
        definitions = b""
        if schema is not None and schema.id not in self.contents.schemas:
            self.contents.schemas[schema.id] = schema
            definitions += encode(schema)
        self.contents.channels[channel.id] = channel
        definitions += encode(channel)
        self._fresh.append(definitions)
        self._buffer += definitions
        stream = _Stream(channel.id, channel.topic)
        self._by_id[channel.id] = stream
        self._streams.setdefault(channel.topic, stream)

    def attach(self, record: Metadata | Attachment) -> None:
        """Add a metadata record or an attachment that is not ours, as it is."""
        data = encode(record)
        if isinstance(record, Metadata):
            index = MetadataIndex(self._sink.size, len(data), record.name)
            self.contents.metadata.append(index)
        else:
            self.contents.add_attachment(record, self._sink.size, len(data))
        self._put(data)

    def append(
        self,
        topic: str,
        type_: type[Message] | Key | str,
        payload: bytes,
        log_ns: int,
        publish_ns: int,
        sequence: int,
    ) -> None:
        """Add one encoded message.

        `type_`, of which a topic's first counts, is its type, its key, or the encoding of bytes;
        `log_ns` is the arrival at the recorder; of `sequence` the lower 32 bits are kept.
        """
        stream = self._streams.get(topic) or self._register(topic, type_)
        if self._full or len(payload) > MAX_MESSAGE_BYTES:
            self._refuse(topic, len(payload), publish_ns)
            return
        self._add(stream, payload, log_ns, publish_ns, sequence)

    def append_to(
        self, channel_id: int, payload: bytes, log_ns: int, publish_ns: int, sequence: int
    ) -> None:
        """Add one message to a channel that was given by `define`."""
        if len(payload) > MAX_MESSAGE_BYTES:
            self._refuse(self._by_id[channel_id].topic, len(payload), publish_ns)
            return
        self._add(self._by_id[channel_id], payload, log_ns, publish_ns, sequence)

    def _refuse(self, topic: str, size: int, publish_ns: int) -> None:
        """Count a message that cannot be taken; who waits for the file is told."""
        self._losses.add(topic, publish_ns)
        if not self._live:
            raise RecordError(
                f"{self.path}: a message of {size / 1e6:.0f} MB on {topic} is too long for a "
                f"record, which takes {MAX_MESSAGE_BYTES / 1e6:.0f} MB at most; leave the key out"
            )

    def _add(
        self, stream: _Stream, payload: bytes, log_ns: int, publish_ns: int, sequence: int
    ) -> None:
        buffer = self._buffer
        stream.index += (log_ns, len(buffer))
        length = _PAYLOAD_FROM + len(payload)
        buffer += _pack(5, length, stream.id, sequence & 0xFFFFFFFF, log_ns, publish_ns)
        buffer += payload
        offset = len(buffer)
        if offset - self._mark >= self.block_bytes:
            self._marks.append(offset)
            self._mark = offset
            if offset >= self._chunk_bytes:
                self._close_chunk()
                if not self._live:
                    self._write()

    def flush(self) -> None:
        """Close the chunk and have everything written (and, when live, synced).

        Raises
        ------
        RecordError
            If the disk refuses and the file is not live.
        """
        self._close_chunk()
        self._write()
        self._full = self._live and self._sink.pending_bytes > self._limit_bytes

    def retitle(self, path: Path, facts: Mapping[str, str]) -> None:
        """Say before `close` what is known by now: the final name, and facts for the metadata."""
        self._close_chunk()
        self.path = self._sink.final = path
        self._put(self.contents.add_metadata({**self._values, **facts}, self._sink.size))

    def close(self) -> None:
        """Write the rest and the summary, sync, and give the file its final name.

        A live file gets it in the background: see `finished`; while the disk refuses, call `close`
        again, and `abandon` to give up.

        Raises
        ------
        RecordError
            If the disk refuses and the file is not live.
        """
        if not self._closed:
            self._close_chunk()
            self._closed = True
            self._sink.put(self.contents.finish(self._sink.size, self._crc))
        self._sink.finish()
        self._raise()

    def abandon(self, busy: bool = False) -> None:
        """Leave the file unfinished; what is not in it counts as dropped.

        `busy` says that the worker may hang in the file: it is then not closed either.
        """
        self._close_chunk()
        for group in self._sink.abandon(busy):
            self._count_lost(group)

    def discard(self) -> None:
        """Delete the unfinished file."""
        self._sink.discard()

    def take_losses(self) -> list[Loss]:
        """What was dropped since the last call, topic by topic."""
        return self._losses.take()

    def __enter__(self) -> RecordFile:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is None:
            self.close()
        elif not isinstance(error, Exception) or isinstance(error, TramstreamError):
            self.discard()  # ended, or refused: what stays would block the next run
        else:
            with suppress(RecordError):  # `recover` then finds all that was appended
                self.flush()
            self.abandon()

    def _write(self) -> None:
        self._sink.flush()
        self._raise()

    def _raise(self) -> None:
        if self._sink.error and not self._live:
            raise RecordError(self._sink.error)

    def _register(self, topic: str, type_: type[Message] | Key | str) -> _Stream:
        schema = None if isinstance(type_, str) else self._schema(type_)
        channel = Channel(
            id=max(self.contents.channels, default=0) + 1,
            topic=topic,
            message_encoding=type_ if isinstance(type_, str) else "protobuf",
            metadata={"schema_version": str(SCHEMA_VERSION)},
            schema_id=schema.id if schema is not None else 0,
        )
        self.define(channel, schema)
        return self._streams[topic]

    def _schema(self, type_: type[Message] | Key) -> Schema:
        kind: Any = type_.type if isinstance(type_, Key) else type_
        schemas = self.contents.schemas
        made = schema_of(kind, max(schemas, default=0) + 1)
        same = (each for each in schemas.values() if each.name == made.name)
        return next((each for each in same if each.data == made.data), made)

    def _messages(self) -> int:
        return sum(len(stream.index) for stream in self._by_id.values()) // 2

    def _close_chunk(self) -> None:
        index = {id_: stream.index for id_, stream in self._by_id.items() if stream.index}
        if not index or self._closed:
            return
        guard, chunk, indexes, entry = encode_chunk(
            self._compressor, self._buffer, self._marks, index, self.file_id
        )
        definitions = b"".join(self._fresh)
        start = self._sink.size + len(definitions) + len(guard)
        entry.chunk_start_offset = start
        entry.message_index_offsets = {
            id_: start + offset for id_, offset in entry.message_index_offsets.items()
        }
        self.contents.add_chunk(entry)
        for id_, entries in index.items():
            self.contents.count(id_, len(entries) // 2)
            self._by_id[id_].index = []
        self._fresh.clear()
        self._buffer, self._marks, self._mark = bytearray(), [], 0
        self._put(definitions + guard + chunk + indexes)
        self._full = self._live and self._sink.pending_bytes > self._limit_bytes

    def _put(self, group: bytes) -> None:
        self._crc = zlib.crc32(group, self._crc)
        self._sink.put(group)

    def _count_lost(self, group: bytes) -> None:
        """Count the messages of a group that never reached the file."""
        position = len(MAGIC) if group.startswith(MAGIC) else 0
        topics = {id_: (stream.topic, id_) for id_, stream in self._by_id.items()}
        while position + RECORD.size <= len(group):
            opcode, length = RECORD.unpack_from(group, position)
            if opcode == Opcode.CHUNK:
                head = read_chunk_head(group[position : position + 64])
                if head is not None:
                    data = group[position + head.data_offset :][: head.data_size]
                    raw = decode_chunk(head, data, None, cut=False).raw
                    for entry in entries_of(raw, topics, 0, 1 << 64):
                        self._losses.add(entry.topic, entry.publish_ns)
            position += RECORD.size + length


def schema_of(type_: Any, id_: int) -> Schema:
    """The schema record of a protobuf type: its file and all that it imports."""
    data = descriptor_set(type_).SerializeToString(deterministic=True)
    return Schema(id_, data, "protobuf", type_.DESCRIPTOR.full_name)


def host_metadata() -> dict[str, str]:
    """What tells this host and boot from others."""
    return {"host": socket.gethostname(), "boot_id": boot_id()}
