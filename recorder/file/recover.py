"""Save what can be proved right of a cut or damaged record.

`recover` writes a clean copy and leaves the source alone; `tramstream.recorder.file.repair` makes a
recorder's unfinished file whole where it lies.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.found import Scan, attachment_at, restore
from tramstream.recorder.file.layout import METADATA_NAME, entries_of
from tramstream.recorder.file.scan import scan
from tramstream.recorder.file.writer import RecordFile, schema_of


@dataclass(slots=True)
class Recovery:
    """What a recovery saved and what it could not."""

    source: Path
    target: Path | None
    messages: int = 0
    chunks_kept: int = 0
    chunks_damaged: int = 0
    bytes_damaged: int = 0
    messages_from_torn_chunk: int = 0
    messages_unknown: int = 0
    start_ns: int = 0
    end_ns: int = 0

    @property
    def clean(self) -> bool:
        """Whether nothing was damaged."""
        return not (self.bytes_damaged or self.messages_unknown)

    @property
    def sentence(self) -> str:
        name = self.source.name
        if self.target is None:
            return f"{name}: held no message and was deleted"
        span_s = (self.end_ns - self.start_ns) / 1e9
        text = f"{name}: {self.messages} messages over {span_s:.1f} s saved"
        if self.chunks_damaged:
            chunks = "a torn or damaged chunk"
            if self.chunks_damaged > 1:
                chunks = f"{self.chunks_damaged} torn or damaged chunks"
            text += f", {self.messages_from_torn_chunk} of them from {chunks}"
        if self.bytes_damaged:
            text += f"; {self.bytes_damaged} bytes were not as written"
        if self.messages_unknown:
            text += f"; {self.messages_unknown} messages left out whose channel is not described"
        return text

    def read(self, found: Scan) -> None:
        """Take over what a walk through the source found."""
        known = found.channels()
        for part in found.parts:
            kept = sum(count for id_, count in part.tally.counts.items() if id_ in known)
            self.messages += kept
            self.messages_unknown += sum(part.tally.counts.values()) - kept
            self.messages_from_torn_chunk += 0 if part.whole else kept
            self.chunks_kept += part.whole
        self.chunks_damaged = sum("chunk" in damage.what for damage in found.damages)
        self.bytes_damaged = sum(damage.length - damage.saved_bytes for damage in found.damages)
        self.start_ns = min((part.tally.start_ns for part in found.parts), default=0)
        self.end_ns = max((part.tally.end_ns for part in found.parts), default=0)


def recover(source: Path, target: Path) -> Recovery:
    """Write all that can be saved of `source` into the new record `target`.

    Topics, schemas, metadata, times and sequence numbers stay; the metadata gets `recovered`, a
    sentence. The order is that of the source.

    Raises
    ------
    RecordError
        If `source` is no record or `target` cannot be written.
    """
    with Source(source) as file:
        found = scan(file)
        if not found.parts and not found.begins_well:
            raise RecordError(f"{source}: is no record and holds no message; check the name")
        recovery = Recovery(source, target)
        recovery.read(found)
        values = values_of(found)
        vehicle = values.get("vehicle", "")
        values["recovered"] = recovery.sentence
        with RecordFile(target, vehicle, values) as record:
            _copy_rest(file, found, record, bool(vehicle))
            _define(found, record)
            topics = {id_: (known.topic, id_) for id_, known in found.channels().items()}
            for part in found.parts:
                for entry in entries_of(restore(file, part).raw, topics, 0, 1 << 64):
                    record.append_to(
                        entry.channel_id,
                        entry.payload,
                        entry.log_ns,
                        entry.publish_ns,
                        entry.sequence,
                    )
    return recovery


def values_of(found: Scan) -> dict[str, str]:
    """The record's own metadata; the vehicle from the keys if it was lost."""
    values: dict[str, str] = {}
    for _, metadata in found.proved_metadata or found.metadata:
        if metadata.name == METADATA_NAME:
            values |= metadata.metadata
    if found.file_id or values:
        topics = (channel.topic for channel in found.channels().values())
        vehicle = next((name for topic in topics if (name := keys.split(topic)[0])), "")
        values = {"vehicle": vehicle or "unknown", **values}
    return values


def _copy_rest(file: Source, found: Scan, record: RecordFile, ours: bool) -> None:
    for _, metadata in found.metadata:
        if metadata.name != METADATA_NAME or not ours:
            record.attach(metadata)
    for offset, length in found.attachments:
        record.attach(attachment_at(file, offset, length))


def _define(found: Scan, record: RecordFile) -> None:
    """Channels and schemas under their ids; a schema that was lost comes from our own keys."""
    restore_schemas(found)
    schemas = found.schemas()
    for channel in found.channels().values():
        record.define(channel, schemas.get(channel.schema_id))


def restore_schemas(found: Scan) -> None:
    schemas = found.schemas()
    for channel in found.channels().values():
        key = keys.find(keys.split(channel.topic)[1])
        if channel.schema_id and channel.schema_id not in schemas and key is not None:
            found.plain.schemas[channel.schema_id] = schema_of(key.type, channel.schema_id)
