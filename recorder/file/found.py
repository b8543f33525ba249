"""What a walk through a file found, and how to get at it."""

from __future__ import annotations

from dataclasses import dataclass, field

from mcap.records import Attachment, Channel, Metadata, Schema

from tramstream.errors import RecordError
from tramstream.recorder.file.chunk import ChunkHead, Guard, Restored, decode_chunk
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.layout import NOTHING, RECORD, Tally, decode, tally
from tramstream.recorder.file.summary import Contents


@dataclass(slots=True)
class Damage:
    """A stretch of the file that is not what was written, and what it cost."""

    offset: int
    length: int
    what: str
    saved_bytes: int = 0
    """So many of them gave messages nevertheless."""


@dataclass(slots=True)
class Part:
    """One chunk as it was found, or a run of messages outside of chunks (`head` is None).

    `begin` to `end` covers it with its guard and message indexes. `tally` counts what it gives.
    """

    begin: int
    offset: int
    end: int
    head: ChunkHead | None
    guard: Guard | None = None
    whole: bool = True
    tally: Tally = NOTHING
    index_offsets: dict[int, int] = field(default_factory=dict)
    index_bytes: int = 0


@dataclass(slots=True)
class Scan:
    """What a walk through a file found."""

    size: int
    begins_well: bool = True
    profile: str = ""
    library: str = ""
    file_id: bytes = b""
    parts: list[Part] = field(default_factory=list)
    damages: list[Damage] = field(default_factory=list)
    plain: Contents = field(default_factory=Contents)
    proved: Contents = field(default_factory=Contents)
    metadata: list[tuple[int, Metadata]] = field(default_factory=list)
    proved_metadata: list[tuple[int, Metadata]] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    """Where they are, and the lengths of their records: the data may be long (`attachment_at`)."""
    good_end: int = 0
    finished: bool = False

    def schemas(self) -> dict[int, Schema]:
        """By id; what a checksum vouches for goes before what stands alone."""
        return {**self.plain.schemas, **self.proved.schemas}

    def channels(self) -> dict[int, Channel]:
        return {**self.plain.channels, **self.proved.channels}


def attachment_at(source: Source, offset: int, length: int) -> Attachment:
    """An attachment that the walk found whole.

    Raises
    ------
    RecordError
        If it is not there any more.
    """
    content = source.read(offset + RECORD.size, length - RECORD.size)
    attachment = decode(Attachment, content)
    if attachment is None:
        raise RecordError(f"{source.path}: changes while it is read; try again")
    return attachment


def restore(source: Source, part: Part) -> Restored:
    """The records of a part, as far as they can be had."""
    if part.head is None:
        return Restored(source.read(part.offset, part.end - part.offset), whole=True)
    data = source.read(part.offset + part.head.data_offset, part.head.data_size)
    cut = len(data) < part.head.data_size
    restored = decode_chunk(part.head, data, part.guard, cut)
    if restored.whole or part.guard is not None:
        return restored
    end = tally(restored.raw).end
    return Restored(restored.raw[:end], whole=False)
