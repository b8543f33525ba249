"""A record for people: keys to columns, whoever wrote them."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from tramstream import keys
from tramstream.clock import S
from tramstream.config_file import RECORD_ENTRY
from tramstream.errors import LeftOutWarning, RecordError
from tramstream.recorder import reader
from tramstream.recorder.message_columns import Clock, Columns, Span, read_columns, unknown

PathLike = str | os.PathLike[str]


class Record(Mapping[str, Columns]):
    """Keys of a record and their messages as columns.

    Made by `open_record`, `simulate` and `localise`.
    A key is `layer/source/quantity` (`est/ekf/state`), or a stranger's topic as it is. Each
    `record[key]` reads the file: take what it gives once, then work with that.
    """

    def __init__(
        self,
        opened: reader.Record,
        place: Path | None,
        source: Record | None = None,
        folder: tempfile.TemporaryDirectory[str] | None = None,
    ) -> None:
        self.reader = opened
        """The record as the rest of tramstream reads it: messages, damages, metadata."""
        self.place = place
        """The file or folder that it was opened by; None for several files."""
        self.source = source
        """The record that this one was made from in this session."""
        self._folder = folder  # goes when the record does
        self._told = ""

    def __enter__(self) -> Record:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; a record without a name of its own is gone then."""
        self.reader.close()
        if self._folder is not None:
            self._folder.cleanup()

    # Keys -----------------------------------------------------------------------------------------
    @cached_property
    def _topics(self) -> dict[str, str]:
        """Topics by key; where two vehicles have the same key, by the whole topic."""
        paths = [keys.split(topic)[1] or topic for topic in self.reader.channels]
        return {
            path if paths.count(path) == 1 else topic: topic
            for path, topic in zip(paths, self.reader.channels, strict=True)
        }

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._topics))

    def __len__(self) -> int:
        return len(self._topics)

    def __contains__(self, key: object) -> bool:
        return key in self._topics or key in self.reader.channels

    def __getitem__(self, key: str) -> Columns:
        return self.read(key)

    def read(
        self,
        key: str,
        columns: str | Iterable[str] = (),
        start_s: float | None = None,
        end_s: float | None = None,
    ) -> Columns:
        """Messages of `key`: all columns or those named, the whole ride or a part of it.

        Parameters
        ----------
        key : str
        columns : str or iterable of str
            Names of columns or of parts (`innovations`); faster, and takes less memory. The stamp
            comes along.
        start_s, end_s : float, optional
            Arrivals, seconds since the record's first one (`Columns.time_s`).

        Raises
        ------
        UnknownNameError
            If there is no such key or column; near ones are offered. It is a KeyError too.
        RecordError
            If the record does not describe the key with protobuf.
        """
        topic = self._topics.get(key, key)
        if topic not in self.reader.channels:
            raise unknown(f"{self._name} has no key", key, self)
        wanted = [columns] if isinstance(columns, str) else list(columns)
        bounds = (None if s is None else self.origin_ns + round(s * S) for s in (start_s, end_s))
        try:
            return read_columns(self.reader, {topic: wanted}, Span(*bounds), self._clock)[topic]
        finally:
            self._tell()

    def _tell(self) -> None:
        told = "; ".join(each for each in (self.damaged, self.left_out) if each)
        if told and told != self._told:
            self._told = told
            warnings.warn(told, LeftOutWarning, stacklevel=4)

    @cached_property
    def _clock(self) -> Clock:
        topic = self._topics.get(keys.CLOCK.path, "")
        name = keys.CLOCK.type.DESCRIPTOR.full_name
        source = self.source
        if topic and self.reader.type_of(topic) == name:
            found = read_columns(self.reader, {topic: ("host_utc_ns",)})[topic]
            return Clock(self.origin_ns, found["stamp_ns"], found["host_utc_ns"])
        if source is not None:
            return source._clock
        return Clock.plain(self.origin_ns)

    # What it is -----------------------------------------------------------------------------------
    @property
    def origin_ns(self) -> int:
        """Where `time_s` is 0: the first arrival, also of what was made from this record."""
        return self.reader.start_ns if self.source is None else self.source.origin_ns

    @property
    def duration_s(self) -> float:
        """From the first arrival to the last."""
        return (self.reader.end_ns - self.reader.start_ns) / S

    @property
    def vehicle(self) -> str:
        """Name of the vehicle; empty for a stranger's record."""
        return self.reader.vehicle

    @property
    def settings(self) -> dict[str, Any]:
        """The configuration that it was made with, as sections; empty where there is none.

        Units stand in the names. `localise` takes changes to it.
        """
        text = self.reader.metadata.get(RECORD_ENTRY, "")
        settings: dict[str, Any] = json.loads(text) if text else {}
        return settings

    @property
    def undecodable(self) -> dict[str, int]:
        """Messages that nothing could be made of so far, by key."""
        of = self.reader.undecodable
        return {key: of[topic] for key, topic in self._topics.items() if topic in of}

    @property
    def left_out(self) -> str:
        """One sentence about them, empty if there are none; reading warns with it, too."""
        return self.reader.left_out

    @property
    def damaged(self) -> str:
        """One sentence about damage found so far, empty without any; reading warns with it, too."""
        return self.reader.damaged

    @property
    def _name(self) -> str:
        return str(self.place or self.reader.paths[0])

    def __repr__(self) -> str:
        width = max(map(len, self._topics), default=0)
        lines = [f"{self._name}: {self.duration_s:.1f} s, {self.reader.message_count} messages"]
        for key in self:
            info = self.reader.channels[self._topics[key]]
            lines.append(f"  {key:{width}}  {info.count:7}  {info.schema}")
        return "\n".join(lines)


def open_record(place: PathLike | Sequence[PathLike]) -> Record:
    """Open a record: a file, a folder with the parts of one, or the parts themselves.

    Damaged and unfinished ones are read as far as they can be proved right; `Record.damaged` tells.

    Raises
    ------
    RecordError
        If there is no record, or none that this version reads.
    """
    if isinstance(place, str | os.PathLike):
        one = Path(place).expanduser()
        return Record(reader.open_record(one), one)
    paths = [Path(each).expanduser() for each in place]
    if not paths:
        raise RecordError("open_record: no file is named")
    return Record(reader.open_record(paths), None)
