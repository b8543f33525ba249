"""Walk through a file that may be cut or damaged; find everything in it that can be proved.

Each record is believed only if its lengths agree with each other; a chunk only if its checksum
holds, else only those of its blocks that its guard vouches for. Where a record cannot be right, the
walk goes on at the next guard, chunk or end of the data section, searched byte by byte from there:
one wrong length costs one record, not the rest of the file. A summary whose checksum holds is used
for definitions and for where the chunks are.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left
from collections.abc import Iterator

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Metadata, Schema

from tramstream.recorder.file.chunk import (
    MAX_CHUNK_BYTES,
    Guard,
    allowed_bytes,
    decode_chunk,
    guard_bytes,
    read_chunk_head,
    read_guard,
)
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.found import Damage, Part, Scan, restore
from tramstream.recorder.file.layout import (
    COPY,
    DATA_END_BYTES,
    GUARD,
    GUARD_MAGIC,
    MAGIC,
    MAX_RECORD_BYTES,
    RECORD,
    VOID,
    copy_of,
    decode,
    encode,
    file_id_of,
    read_copy,
    tally,
)
from tramstream.recorder.file.places import DATA_END, Places
from tramstream.recorder.file.summary import read_end, read_summary

_WINDOW_BYTES = 1 << 20
_HEAD_BYTES = 64
_AHEAD_BYTES = 1 << 16
_RUN_BYTES = 1 << 20
_SEARCH_BYTES = 64 << 20
"""At least so much is looked at in search of chunks; a file may be full of what looks like one."""
_KINDS: dict[int, type[McapRecord]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}


def scan(source: Source) -> Scan:
    """Walk through `source`; see `Scan`."""
    return _Walk(source).run()


def data_holds(source: Source, data_end: int) -> bool | None:
    """Whether all bytes before `data_end` have the CRC-32 that stands there; None if none does."""
    stated = source.read(data_end, DATA_END_BYTES)
    if not stated.startswith(DATA_END):
        return False
    if stated.endswith(bytes(4)):
        return None
    crc = 0
    for position in range(0, data_end, _WINDOW_BYTES):
        crc = zlib.crc32(source.read(position, min(_WINDOW_BYTES, data_end - position)), crc)
    return stated.endswith(struct.pack("<I", crc))


class _Walk:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.found = Scan(source.size)
        self.guard: tuple[int, int, Guard] | None = None  # begin, end, guard
        self.end = source.size
        self.hints: list[int] = []
        """Where the summary says that chunks are, ascending."""
        self.allowed_bytes = allowed_bytes(source.size)
        """Of this the chunks' stated sizes are subtracted."""
        self.refused = -1
        """Where a chunk states more than that."""
        self.search_bytes = _SEARCH_BYTES + source.size
        """So much is still read to see whether what looks like a chunk is one."""
        self.ahead = 0, b""
        """An offset, and bytes of the file from there on."""
        self.places = Places(source)
        self.trusted = -1  # where a chunk follows its damaged guard
        self.chunked = False  # some chunk was kept
        self.ended = False  # past the end of data, in a summary that is not whole
        self.data_end = source.size
        """Where the end of the data stands, as the summary says or the walk has found it."""

    def run(self) -> Scan:
        found = self.found
        summary = read_summary(self.source)
        if summary is not None:
            found.proved, self.end = summary
            self.hints = sorted(chunk.chunk_start_offset for chunk in found.proved.chunks)
            self.data_end = self.end
        end = read_end(self.source)
        if end is not None:
            found.finished = True
            self.end = min(self.end, end.footer)
        position = len(MAGIC)
        if self._read(0, position) != MAGIC:
            found.begins_well = False
            found.damages.append(Damage(0, min(position, found.size), "the file's first bytes"))
        found.good_end = position
        while position < self.end:
            after = self._record(position)
            if after is None:
                after = self._next(position + 1)
                self._lost(position, after - position)
            position = after
        if end is not None and not end.whole:
            what = "bytes of the summary are not as written"
            found.damages.append(Damage(end.footer, 1, what))
        if found.finished and not found.damages and data_holds(self.source, self.data_end) is False:
            what = "bytes outside of the messages are not as written"
            found.damages.append(Damage(self.data_end, 1, what))
        return found

    def _read(self, offset: int, length: int) -> bytes:
        """Bytes of the file: of a walk's many short reads only some reach the disk."""
        begin = offset - self.ahead[0]
        if begin < 0 or begin + length > len(self.ahead[1]):
            self.ahead = offset, self.source.read(offset, max(length, _AHEAD_BYTES))
            begin = 0
        return self.ahead[1][begin : begin + length]

    def _record(self, position: int) -> int | None:
        """Take the record at `position`; where the next one begins, or None if it cannot be."""
        head = self._read(position, _HEAD_BYTES)
        if self.guard is not None and self.guard[1] == position:
            return self._chunk(position, self.guard[2].head, self.guard)
        if len(head) < RECORD.size:
            return None
        opcode, length = RECORD.unpack_from(head)
        if opcode == Opcode.CHUNK:
            ours = self.found.file_id and position != self.trusted and not self._hinted(position)
            return None if ours else self._chunk(position, head, None)
        if opcode == GUARD or head[9:17] == GUARD_MAGIC:
            return self._guard(position)
        after = int(position + RECORD.size + length)
        if opcode == 0 or after > self.end:
            return None
        if length > MAX_RECORD_BYTES:
            return self._too_long(position, after)
        if opcode == Opcode.MESSAGE:  # in a file with chunks that is a damaged opcode
            return None if self.found.file_id or self.chunked else self._run(position)
        content = self._read(position + RECORD.size, length)
        if not self._take(opcode, position, content):
            return None
        if opcode == Opcode.DATA_END and not self.ended:
            self.ended, self.data_end = True, position
        if not self.ended:
            self.found.good_end = after
        return after

    def _take(self, opcode: int, position: int, content: bytes) -> bool:
        """Keep a record outside of chunks; False if it cannot be right."""
        found = self.found
        match opcode:
            case Opcode.MESSAGE_INDEX:
                return self._message_index(position, content)
            case Opcode.DATA_END:
                return len(content) == 4
            case Opcode.FOOTER:  # a whole one stands where the walk ends (`read_end`)
                return False
            case _ if opcode == COPY:
                return self._copy(position, content)
            case _ if opcode not in _KINDS:
                return self._plausible(position + RECORD.size + len(content))
        record = decode(_KINDS[opcode], content)
        if record is None:
            return False
        exact = len(encode(record)) == RECORD.size + len(content)
        if not exact and not self._plausible(position + RECORD.size + len(content)):
            return False
        match record:
            case Header():
                found.profile, found.library = record.profile, record.library
            case Schema():
                found.plain.schemas[record.id] = record
            case Channel():
                found.plain.channels[record.id] = record
            case Metadata():
                found.metadata.append((position, record))
            case Attachment():
                found.attachments.append((position, RECORD.size + len(content)))
        return True

    def _copy(self, position: int, content: bytes) -> bool:
        metadata = read_copy(content)
        if metadata is None:
            return False
        record = encode(metadata)
        self.found.proved_metadata.append((position - len(record), metadata))
        if not self.found.file_id:
            self.found.file_id = file_id_of(record)
        return len(content) == len(copy_of(record)) - RECORD.size

    def _message_index(self, position: int, content: bytes) -> bool:
        if len(content) < 6:
            return False
        channel_id, size = struct.unpack_from("<HI", content)
        if size != len(content) - 6 or size % 16:
            return False
        part = self.found.parts[-1] if self.found.parts else None
        if part is not None and part.end == position and part.whole:
            part.index_offsets[channel_id] = position
            part.index_bytes += RECORD.size + len(content)
            part.end = position + RECORD.size + len(content)
        return True

    def _guard(self, position: int) -> int | None:
        content = self._read(position + RECORD.size, _HEAD_BYTES + len(GUARD_MAGIC) * 4)
        size = guard_bytes(content)
        guard = None
        if RECORD.size < size <= MAX_RECORD_BYTES and position + size <= self.end:
            guard = read_guard(self._read(position + RECORD.size, size - RECORD.size))
        if guard is None:
            return self._damaged_guard(position, content)
        if (self.found.file_id or guard.file_id) != guard.file_id:
            return None
        self.found.file_id = guard.file_id
        self.guard = (position, position + size, guard)
        return position + size

    def _damaged_guard(self, position: int, content: bytes) -> int | None:
        """Step over a guard that lost its checksum, if a chunk follows and the guard is ours.

        A chunk without a guard of this file would be believed by its own checksum alone, and a
        stale disk block of an older record holds such chunks.
        """
        _, length = RECORD.unpack(self._read(position, RECORD.size))
        after = int(position + RECORD.size + length)
        known = zip(self.found.file_id, content[8:16], strict=False)
        if length > MAX_RECORD_BYTES or sum(a == b for a, b in known) < 7:
            return None
        if read_chunk_head(self._read(after, _HEAD_BYTES)) is None:
            return None
        self.found.damages.append(Damage(position, after - position, "a chunk's guard"))
        self.trusted = after
        return after

    def _chunk(
        self, position: int, head: bytes, guarded: tuple[int, int, Guard] | None
    ) -> int | None:
        """Take the chunk at `position`; `guarded` is the guard right before it."""
        self.guard = None
        chunk = read_chunk_head(head)
        if chunk is None:
            return None
        if max(chunk.data_size, chunk.raw_size) > min(MAX_CHUNK_BYTES, self.allowed_bytes):
            self.refused = position
            return None
        self.allowed_bytes -= chunk.raw_size
        end = position + chunk.data_offset + chunk.data_size
        begin, guard = (guarded[0], guarded[2]) if guarded else (position, None)
        part = Part(begin, position, end, chunk, guard)
        restored = restore(self.source, part)
        part.whole, part.tally = restored.whole, tally(restored.raw)
        if not part.whole and guard is None:
            beyond = end > self.end and self._next(position + 1) >= self.end
            if not beyond:  # damaged, not cut: nothing of it can be proved
                return None
        self._keep(part)
        if part.whole:
            self.found.good_end, self.ended = end, False
            return end
        after = end if end <= self.end and self._plausible(end) else self._next(position + 1)
        part.end = after
        self._lost(position, after - position, sum(part.tally.counts.values()))
        self.found.damages[-1].saved_bytes = restored.used_bytes
        return after

    def _keep(self, part: Part) -> None:
        counted = part.tally
        proved = part.guard is not None or (part.whole and part.head is not None)
        contents = self.found.proved if proved else self.found.plain
        for schema in counted.schemas:
            contents.schemas.setdefault(schema.id, schema)
        for channel in counted.channels:
            contents.channels.setdefault(channel.id, channel)
        if counted.counts:
            self.found.parts.append(part)
            self.chunked = self.chunked or part.head is not None

    def _run(self, position: int) -> int | None:
        """Take messages that stand outside of chunks (foreign files)."""
        raw = self._read(position, min(_RUN_BYTES, self.end - position))
        end = 0
        while end + RECORD.size <= len(raw):
            opcode, length = RECORD.unpack_from(raw, end)
            if opcode != Opcode.MESSAGE or (length > len(raw) and end):
                break
            if end + RECORD.size + length > len(raw):
                if end == 0 and position + RECORD.size + length <= self.end:
                    raw = self._read(position, RECORD.size + length)
                    end = len(raw)
                break
            end += RECORD.size + length
        counted = tally(raw[:end])
        contents = self.found.plain.channels, self.found.proved.channels
        if not counted.counts or not all(
            any(id_ in channels for channels in contents) for id_ in counted.counts
        ):
            return None
        end = position + counted.end
        self.found.parts.append(Part(position, position, end, None, tally=counted))
        return end

    def _plausible(self, position: int) -> bool:
        """Whether a record may begin at `position`."""
        head = self._read(position, RECORD.size)
        if position >= self.end or len(head) < RECORD.size:
            return position <= self.source.size
        opcode, length = RECORD.unpack_from(head)
        known = 0 < opcode <= Opcode.DATA_END or opcode in (GUARD, COPY, VOID)
        return known and bool(length <= MAX_RECORD_BYTES)

    def _next(self, position: int) -> int:
        """Where the next guard, chunk or end of data begins, from `position` on."""
        index = bisect_left(self.hints, position)
        limit = self.hints[index] if index < len(self.hints) else self.end
        for candidate in self._candidates(position, limit):
            return candidate
        return limit

    def _hinted(self, position: int) -> bool:
        index = bisect_left(self.hints, position)
        return index < len(self.hints) and self.hints[index] == position

    def _too_long(self, position: int, after: int) -> int | None:
        """Step over a record that is longer than what is read, if another one follows it."""
        if not self._plausible(after):
            return None
        self.found.damages.append(Damage(position, after - position, "a record too long to read"))
        return after

    def _candidates(self, position: int, limit: int) -> Iterator[int]:
        for at in self.places.between(position, limit):
            if self._genuine(at, self._read(at, _HEAD_BYTES)):
                yield at

    def _genuine(self, position: int, head: bytes) -> bool:
        if head[9:17] == GUARD_MAGIC:
            self.search_bytes -= guard_bytes(self._read(position + RECORD.size, _HEAD_BYTES))
            if self.search_bytes < 0:
                return False
            keep, self.guard = self.guard, None
            after = self._guard(position)
            self.guard = keep
            return after is not None
        if head.startswith(DATA_END):
            return self._plausible(position + DATA_END_BYTES)
        chunk = read_chunk_head(head)
        if chunk is None or self.found.file_id:  # a chunk of ours is found by its guard
            return False
        size = max(min(chunk.data_size, self.end - position), chunk.raw_size)
        if max(chunk.data_size, chunk.raw_size) > MAX_CHUNK_BYTES or size > self.search_bytes:
            return False
        self.search_bytes -= size
        data = self._read(position + chunk.data_offset, chunk.data_size)
        cut = len(data) < chunk.data_size
        return cut or decode_chunk(chunk, data, None, cut=False).whole

    def _lost(self, offset: int, length: int, saved: int = -1) -> None:
        torn = offset + length >= self.source.size and not self.found.finished
        if saved >= 0:
            what = f"a {'torn' if torn else 'damaged'} chunk, {saved} messages of it saved"
        elif offset == self.refused:
            what = "a chunk that states more than a record of this size can hold"
        elif self._read(offset, 1) == bytes([Opcode.CHUNK]):
            what = "a damaged chunk, nothing of it saved"
        else:
            what = "the file ends within a record" if torn else "bytes that are no record"
        self.found.damages.append(Damage(offset, length, what))
