"""Read records: one file, several parts, a whole folder; finished, still written or damaged.

`open_record` reads the summary of a finished file; where there is none, or it is damaged, it walks
through the file (`recorder.file.scan`). Messages come chunk by chunk with their checksums checked,
in the order (log_ns, channel_id, sequence), also across chunks and parts whose times overlap.
What is damaged is left out and stands in `damages`; it is never guessed at. What cannot be
decoded is handed out as it is by `messages`, left out by `decoded`, and counted in `undecodable`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from google.protobuf.message import Message

from tramstream import boundary, keys
from tramstream.boundary import Undecodable
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.recorder.file.found import Damage
from tramstream.recorder.file.layout import Entry, entries_of
from tramstream.recorder.file.merge import in_order
from tramstream.recorder.file.opened import (
    Chunk,
    File,
    check_outside,
    load,
    open_file,
    place_of,
    schema_version,
)
from tramstream.recorder.file.sink import ACTIVE

__all__ = ["ChannelInfo", "Damage", "Entry", "Record", "open_record"]

PAUSE_NS = 60 * S
"""Where nothing at all comes for longer, a record has a pause: a logger that was switched off, a
clock that was set by years. No time passes in it: longer than any gap that a processor measures,
and short enough for thousands of pauses in one record."""
_FOREVER_NS = 1 << 64
_TIMES = itemgetter(2), itemgetter(3)
"""Of an entry: when it came, when it was sent."""


@dataclass(slots=True)
class ChannelInfo:
    """One topic of a record."""

    topic: str
    schema: str
    count: int
    channel_id: int


class Record:
    """A record, whatever number of files it consists of. Made by `open_record`."""

    def __init__(self, files: list[File]) -> None:
        self.files = files
        self.metadata = files[0].metadata
        self.channels: dict[str, ChannelInfo] = {}
        self._classes: dict[str, Any] = {}
        self._undecodable: dict[str, set[int]] = {}
        ids: set[int] = set()
        highest = 0
        for file in files:
            for id_, channel in file.channels.items():
                info = self.channels.get(channel.topic)
                if info is None:
                    free = id_ if id_ not in ids else highest + 1
                    highest = max(highest, free)
                    ids.add(free)
                    schema = file.schemas.get(channel.schema_id)
                    name = schema.name if schema else ""
                    info = self.channels[channel.topic] = ChannelInfo(channel.topic, name, 0, free)
                info.count += file.counts.get(id_, 0)
                file.topics[id_] = (channel.topic, info.channel_id)

    def __enter__(self) -> Record:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.close()

    def close(self) -> None:
        for file in self.files:
            file.source.close()

    @property
    def paths(self) -> list[Path]:
        """The files, in order."""
        return [file.path for file in self.files]

    @property
    def vehicle(self) -> str:
        """From the metadata, else from the keys; empty for a foreign file."""
        for file in self.files:
            if "vehicle" in file.metadata:
                return file.metadata["vehicle"]
        return next((name for topic in self.channels if (name := keys.split(topic)[0])), "")

    @property
    def schema_version(self) -> int | None:
        """None for a file that tramstream did not write."""
        return schema_version(self.files[0])

    @property
    def message_count(self) -> int:
        return sum(info.count for info in self.channels.values())

    @property
    def start_ns(self) -> int:
        """First arrival; 0 for a record without messages."""
        first_ns = min((file.start_ns for file in self.files if file.counts), default=0)
        return min(first_ns, boundary.LATEST_NS)

    @property
    def end_ns(self) -> int:
        """Last arrival; 0 for a record without messages."""
        last_ns = max((file.end_ns for file in self.files if file.counts), default=0)
        return min(last_ns, boundary.LATEST_NS)

    @property
    def size_bytes(self) -> int:
        return sum(file.source.size for file in self.files)

    @property
    def damages(self) -> list[tuple[Path, Damage]]:
        """Everything found damaged so far; chunks of a finished file are looked at when read."""
        return [(file.path, damage) for file in self.files for damage in file.damages]

    def check_outside(self) -> None:
        """Look also at what is not read for messages: see `damages` then."""
        for file in self.files:
            check_outside(file)

    @property
    def damaged(self) -> str:
        """One sentence, empty if nothing is known to be damaged."""
        damages = self.damages
        if not damages:
            return ""
        path, first = damages[0]
        more = f" and {len(damages) - 1} more" if len(damages) > 1 else ""
        return f"{path}: {first.length} bytes at {first.offset} are damaged ({first.what}){more}"

    def messages(
        self,
        match: Callable[[str], bool] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Entry]:
        """Messages with start_ns ≤ log_ns < end_ns on topics that `match` says yes to.

        In the order (log_ns, channel_id, sequence). Channel ids count over all parts.
        """
        start, end = start_ns or 0, _FOREVER_NS if end_ns is None else end_ns
        wanted = {
            id(file): {
                id_: known for id_, known in file.topics.items() if match is None or match(known[0])
            }
            for file in self.files
        }
        chunks = [
            chunk
            for file in self.files
            for chunk in file.chunks
            if chunk.end_ns >= start
            and chunk.start_ns < end
            and (not chunk.channels or not chunk.channels.isdisjoint(wanted[id(file)]))
        ]
        chunks.sort(key=attrgetter("start_ns"))
        yield from in_order(
            chunks,
            lambda chunk: _dated(
                chunk, entries_of(load(chunk).raw, wanted[id(chunk.file)], start, end)
            ),
        )

    @property
    def undecodable(self) -> dict[str, int]:
        """Messages that `decode` could make nothing of so far, by topic."""
        return {topic: len(seen) for topic, seen in self._undecodable.items()}

    @property
    def left_out(self) -> str:
        """One sentence about them, empty if there are none."""
        counts = ((keys.split(topic)[1] or topic, n) for topic, n in self.undecodable.items())
        sentence = boundary.left_out(counts)
        return f"{self.files[0].path}: {sentence}" if sentence else ""

    def decoded(
        self,
        match: Callable[[str], bool] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[tuple[Entry, Any]]:
        """Entries as `messages` gives them, with what is in them."""
        for entry in self.messages(match, start_ns, end_ns):
            message = self.decode(entry)
            if not isinstance(message, Undecodable):
                yield entry, message

    def decode(self, entry: Entry) -> Any:
        """The message of `entry`: our own type where we know it, else by the file's description.

        An `Undecodable` if the payload is not of that type, or the file does not describe it; no
        bytes of a record raise. It is counted in `undecodable`, however often it is asked for.
        """
        topic = entry.topic
        class_ = self._classes.get(topic) or self.class_of(topic)
        message: Any
        if isinstance(class_, str):
            message = Undecodable(topic, len(entry.payload), class_)
        else:
            message = boundary.decode(class_, entry.payload, topic)
        if isinstance(message, Undecodable):
            which = hash((entry.log_ns, entry.publish_ns, entry.sequence, entry.payload))
            self._undecodable.setdefault(topic, set()).add(which)
        return message

    def types(self) -> list[type[Message]]:
        """The message types of its keys, each once, but for those that it does not describe."""
        classes = (self.class_of(topic) for topic in self.channels)
        known = [each for each in classes if not isinstance(each, str)]
        return list({each.DESCRIPTOR.full_name: each for each in known}.values())

    def type_of(self, topic: str) -> str:
        """Full name of the topic's message type."""
        return self.channels[topic].schema

    def class_of(self, topic: str) -> type[Message] | str:
        """The type of a topic's messages, or what they are instead."""
        class_: type[Message] | str | None = self._classes.get(topic)
        if class_ is None:
            class_ = self._classes[topic] = self._class(topic)
        return class_

    def _class(self, topic: str) -> type[Message] | str:
        """The type of a topic's messages, or why there is none."""
        name = self.type_of(topic)
        known = keys.TYPES.get(name)
        if known is not None:
            return known
        for file in self.files:
            for schema in file.schemas.values():
                if schema.name == name and schema.encoding == "protobuf":
                    return boundary.described(schema.data, name)
        return "of no type that the record describes with protobuf"


def _dated(chunk: Chunk, entries: list[Entry]) -> list[Entry]:
    """Leave out, and tell, what came or was sent at an instant that no clock shows."""
    latest_ns = boundary.LATEST_NS
    if not entries or max(max(map(time_of, entries)) for time_of in _TIMES) <= latest_ns:
        return entries
    kept = [entry for entry in entries if max(entry.log_ns, entry.publish_ns) <= latest_ns]
    offset, length = place_of(chunk)
    what = f"{len(entries) - len(kept)} messages of an instant that no clock shows"
    damage = Damage(offset, length, what, length)
    if damage not in chunk.file.damages:
        chunk.file.damages.append(damage)
    return kept


def open_record(paths: Path | Iterable[Path], any_schema: bool = False) -> Record:
    """Open a file, a folder, or several parts, which may be given in any order.

    Parameters
    ----------
    paths : Path or iterable of Path
    any_schema : bool
        Open records of another schema version too (to describe or recover them).

    Raises
    ------
    RecordError
        If a file is no record, is empty, is of another schema version, or belongs to another
        vehicle than the first.
    """
    names: list[Path] = []
    for path in [paths] if isinstance(paths, Path) else paths:
        names += _in_folder(path) if path.is_dir() else [path]
    files: list[File] = []
    try:
        for name in names:
            files.append(open_file(name))
            if not any_schema:
                _check_version(files[-1])
        record = Record(_in_order(files))
        _check_vehicle(record)
    except RecordError:
        for file in files:
            file.source.close()
        raise
    return record


def _in_folder(folder: Path) -> list[Path]:
    names = sorted(folder.glob("*.mcap")) + sorted(folder.glob(f"*.mcap{ACTIVE}"))
    names = [name for name in names if name.stat().st_size]
    if not names:
        raise RecordError(f"{folder}: holds no record (*.mcap); name the folder that does")
    return names


def _in_order(files: list[File]) -> list[File]:
    """Sessions by their start, then parts by their number."""
    starts: dict[str, int] = {}
    for file in files:
        session = file.session or str(file.path)
        starts[session] = min(starts.get(session, _FOREVER_NS), file.start_ns)

    def order(file: File) -> tuple[int, str, int, int, str]:
        session = file.session or str(file.path)
        return (starts[session], session, file.part, file.start_ns, str(file.path))

    return sorted(files, key=order)


def _check_version(file: File) -> None:
    version = schema_version(file)
    if version is not None and version != keys.SCHEMA_VERSION:
        raise RecordError(
            f"{file.path}: has schema version {version}, this tramstream reads "
            f"{keys.SCHEMA_VERSION}; read it with {file.metadata.get('software', 'the version')} "
            "that wrote it"
        )


def _check_vehicle(record: Record) -> None:
    vehicles = {
        file.metadata["vehicle"]: file.path for file in record.files if "vehicle" in file.metadata
    }
    if len(vehicles) > 1:
        (one, first), (other, second) = list(vehicles.items())[:2]
        raise RecordError(
            f"{second}: is a record of vehicle {other}, {first} one of {one}; name the files of one"
        )
