"""What a record holds: figures for people and scripts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from tramstream import keys
from tramstream.boundary import name_of
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.names import UTC_OFFSET
from tramstream.recorder.reader import Entry, Record

_WRAP = 1 << 32


@dataclass(slots=True)
class ChannelFigures:
    """One topic: how much of it there is, and how much is missing by its sequence numbers."""

    topic: str
    path: str
    type: str
    count: int = 0
    rate_hz: float = 0.0
    gaps: int = 0
    missing: int = 0
    restarts: int = 0
    reported_lost: dict[str, int] = field(default_factory=dict)
    first_log_ns: int = 0
    last_log_ns: int = 0


@dataclass(slots=True)
class DamageFigures:
    file: str
    offset: int
    length_bytes: int
    what: str


@dataclass(slots=True)
class Description:
    """One record, whatever number of files."""

    files: list[str]
    unfinished: list[str]
    vehicle: str
    schema_version: int | None
    software: str
    recovered: str
    start_ns: int
    end_ns: int
    utc_offset_ns: int
    """UTC minus the vehicle clock, by which the two stamps above are told; 0 if they are UTC."""
    duration_s: float
    size_bytes: int
    message_count: int
    channels: list[ChannelFigures]
    missing_parts: list[int]
    damages: list[DamageFigures]
    damaged: str
    left_out: str
    """What of it was to be decoded and could not be."""

    def to_json(self) -> dict[str, Any]:
        """Plain data; units stand in the names."""
        return asdict(self)


def describe(record: Record, see: Callable[[Entry], None] | None = None) -> Description:
    """Read `record` through and describe it; every checksum is looked at on the way.

    `see` is shown every message, for whoever would read the record through as well.
    """
    figures = {
        info.topic: ChannelFigures(info.topic, keys.split(info.topic)[1] or info.topic, info.schema)
        for info in record.channels.values()
    }
    latest: dict[str, int] = {}
    losses: list[Loss] = []
    count = 0
    for entry in record.messages():
        count += 1
        _add(figures[entry.topic], entry, latest)
        if see is not None:
            see(entry)
        if figures[entry.topic].type == Loss.DESCRIPTOR.full_name:
            loss = record.decode(entry)
            losses += [loss] if isinstance(loss, Loss) else []
    record.check_outside()
    for loss in losses:
        topic = next((topic for topic in figures if _names(topic, loss.key)), None)
        if topic is not None:
            cause = name_of(Loss.Cause, loss.cause)
            reported = figures[topic].reported_lost
            reported[cause] = reported.get(cause, 0) + loss.count
    for channel in figures.values():
        span_s = (channel.last_log_ns - channel.first_log_ns) / 1e9
        channel.rate_hz = (channel.count - 1) / span_s if span_s > 0 else 0.0
    start_ns = min((c.first_log_ns for c in figures.values() if c.count), default=0)
    end_ns = max((c.last_log_ns for c in figures.values() if c.count), default=0)
    return Description(
        files=[str(path) for path in record.paths],
        unfinished=[str(file.path) for file in record.files if not file.finished],
        vehicle=record.vehicle,
        schema_version=record.schema_version,
        software=record.metadata.get("software", ""),
        recovered=record.metadata.get("recovered", ""),
        start_ns=start_ns,
        end_ns=end_ns,
        utc_offset_ns=_utc_offset_ns(record),
        duration_s=(end_ns - start_ns) / 1e9,
        size_bytes=record.size_bytes,
        message_count=count,
        channels=sorted(figures.values(), key=lambda channel: channel.topic),
        missing_parts=_missing_parts(record),
        damages=[
            DamageFigures(str(path), damage.offset, damage.length, damage.what)
            for path, damage in record.damages
        ],
        damaged=record.damaged,
        left_out=record.left_out,
    )


def _add(channel: ChannelFigures, entry: Entry, latest: dict[str, int]) -> None:
    """Count one message; a number below the last one is a publisher that began anew."""
    before = latest.get(entry.topic)
    if before is None:
        channel.first_log_ns = entry.log_ns
    elif entry.sequence != before:
        step = (entry.sequence - before) % _WRAP
        if step >= _WRAP // 2:
            channel.restarts += 1
        elif step > 1:
            channel.gaps += 1
            channel.missing += step - 1
    latest[entry.topic] = entry.sequence
    channel.count += 1
    channel.last_log_ns = entry.log_ns


def _utc_offset_ns(record: Record) -> int:
    """What the recorder knew of it at the end of a part; 0 if it had nothing to correct."""
    for file in record.files:
        text = file.metadata.get(UTC_OFFSET, "")
        if text.removeprefix("-").isdecimal() and abs(int(text[:20])) < _WRAP**2 // 4:
            return int(text)
    return 0


def _names(topic: str, key: str) -> bool:
    """Whether `key`, full or a path, is `topic`."""
    return key == topic or key == keys.split(topic)[1]


def _missing_parts(record: Record) -> list[int]:
    """Parts between others of the same session that are not here."""
    parts: dict[str, set[int]] = {}
    for file in record.files:
        if file.session and file.part:
            parts.setdefault(file.session, set()).add(file.part)
    return sorted(
        number
        for present in parts.values()
        for number in range(min(present), max(present))
        if number not in present
    )
