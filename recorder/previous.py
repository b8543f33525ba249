"""What the end of a predecessor's record holds: where a recorder that was started again goes on."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from tramstream import keys
from tramstream.boundary import Undecodable, decode
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.file.opened import File, open_file
from tramstream.recorder.reader import Entry, Record
from tramstream.transport.resend import SPAN_S

FILES = 64
"""Of the newest files, so many are looked at."""
LATE_NS = 2 * S
"""Of a key that is not rare there is a message within so much."""


@dataclass(slots=True)
class Remembered:
    """The end of one topic in a record.

    Behind `after_ns` messages may be missing: it is the last one's time of publication, or that of
    the last before a gap that no `Loss` names. `known` are those from there on that the record has.
    """

    after_ns: int
    after_sequence: int | None
    """None if it is not known."""
    known: dict[int, int] = field(default_factory=dict)
    """Sequence numbers by time of publication."""
    times: list[tuple[int, int]] = field(default_factory=list)
    """Publication and log time from `after_ns` on."""

    def log_before(self, publish_ns: int) -> int:
        """Log time of the last message that was published before."""
        index = bisect_left(self.times, (publish_ns, 0)) - 1
        return self.times[index][1] if index >= 0 else 0


@dataclass(slots=True)
class Previous:
    """The end of a record, by topic; `since_ns` is where it was begun to be read."""

    since_ns: int = 0
    topics: dict[str, Remembered] = field(default_factory=dict)

    def has(self, topic: str, publish_ns: int) -> bool:
        """Whether the record holds a message, from the topic's `after_ns` on."""
        remembered = self.topics.get(topic)
        return remembered is not None and publish_ns in remembered.known

    def is_within(self, topic: str, publish_ns: int) -> bool:
        """Whether a message was published between those that the record holds."""
        remembered = self.topics.get(topic)
        return remembered is not None and publish_ns < remembered.times[-1][0]


NOTHING = Previous()


def remember(directory: Path, vehicle: str, boot_id: str, recorder: str) -> Previous:
    """Read the end of the newest record of this vehicle and boot in `directory`.

    Publishers hold no more than `SPAN_S`: what was recorded earlier is not asked for. Losses that
    `recorder` has named stay named.
    """
    files = list(_latest(directory, vehicle, boot_id))
    if not files:
        return NOTHING
    with closing(Record(files)) as record:
        since_ns = record.end_ns - int(SPAN_S * S)
        return summarise(record.messages(start_ns=since_ns), since_ns, recorder)


def _latest(directory: Path, vehicle: str, boot_id: str) -> Iterator[File]:
    """Files whose messages may be of the last `SPAN_S` of the newest record."""
    written: list[tuple[int, Path]] = []
    for path in directory.glob("*.mcap"):
        try:
            written.append((path.stat().st_mtime_ns, path))
        except OSError:
            continue  # deleted meanwhile, to make space
    since_ns = 0
    for _, path in sorted(written, reverse=True)[:FILES]:
        try:
            file = open_file(path)
        except RecordError:
            continue  # none of ours, or empty: nothing to go on from
        ours = file.metadata.get("vehicle") == vehicle and file.metadata.get("boot_id") == boot_id
        since_ns = since_ns or (file.end_ns - int(SPAN_S * S) if ours else 0)
        if ours and file.end_ns >= since_ns:
            yield file
            continue
        file.source.close()
        if ours:
            return


def summarise(entries: Iterator[Entry], since_ns: int, recorder: str) -> Previous:
    """The end of every topic, from messages in the order of their log times."""
    topics: dict[str, list[tuple[int, int, int]]] = {}
    named: dict[str, list[Loss]] = {}
    losses = keys.LOSS.at(recorder).path
    for entry in entries:
        end = topics.setdefault(entry.topic, [])
        end.append((entry.publish_ns, entry.sequence, entry.log_ns))
        if keys.split(entry.topic)[1] == losses:
            loss = decode(Loss, entry.payload, entry.topic)
            if isinstance(loss, Undecodable):
                continue
            named.setdefault(loss.key, []).append(loss)
    return Previous(
        since_ns,
        {
            topic: _end_of(sorted(end), named.get(topic, []), since_ns)
            for topic, end in topics.items()
        },
    )


def _end_of(messages: list[tuple[int, int, int]], named: list[Loss], since_ns: int) -> Remembered:
    """Where the first gap begins that nobody has named, else the last message."""
    first_ns, first, _ = messages[0]
    front_told = any(loss.before_publish_ns <= first_ns for loss in named)
    begin = len(messages) - 1
    if first > 1 and first_ns > since_ns + LATE_NS and not front_told:
        begin = -1  # rare, or begun since: some may be missing in front
    for index in range(begin):
        after_ns, sequence, _ = messages[index]
        before_ns, following, _ = messages[index + 1]
        missing = following - sequence - 1
        told = sum(
            loss.count
            for loss in named
            if after_ns <= loss.after_publish_ns and loss.before_publish_ns <= before_ns
        )
        if missing > told:
            begin = index
            break
    after_ns, after = messages[begin][:2] if begin >= 0 else (since_ns, None)
    begin = max(begin, 0)
    return Remembered(
        after_ns,
        after,
        {time_ns: number for time_ns, number, _ in messages[begin:]},
        [(time_ns, log_ns) for time_ns, _, log_ns in messages[begin:]],
    )
