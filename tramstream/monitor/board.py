"""What `top` shows, as plain rows: nodes, devices and keys, with what deserves attention marked.

Computed from the statistics alone, and only the last messages are decoded, so that looking costs
next to nothing and looking twice gives the same answer.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import IntEnum
from itertools import chain
from typing import Any

from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.events.messages import facts_of, sentence_of
from tramstream.monitor.digest import digest
from tramstream.monitor.stats import KeyStats, Stats
from tramstream.proto.health_pb2 import DeviceHealth, Event, NodeHealth
from tramstream.transport.descriptions import Decoder

SILENT_S = 3.0
"""Three heartbeats."""
SLOW = 0.7
"""A key below this share of its nominal rate is marked."""
MISSED_PERIODS = 5
NEWS_S = 60.0
"""An event is shown for so long."""
SHORT_S = 0.3
"""A share over less is chance: the last heartbeat follows the one before at once."""


class Level(IntEnum):
    """How much attention something deserves."""

    FINE = 0
    WARNING = 1
    BAD = 2


@dataclass(frozen=True, slots=True)
class KeyRow:
    """One key."""

    key: str
    type: str
    rate_hz: float | None
    nominal_hz: float
    age_s: float | None
    count: int
    lost: int
    size_bytes: int
    bytes_per_s: float
    last: str
    rate_level: Level
    age_level: Level


@dataclass(frozen=True, slots=True)
class NodeRow:
    """One process, by its heartbeat; `cpu_percent` is of one core."""

    node: str
    state: str
    text: str
    age_s: float
    cpu_percent: float | None
    rss_bytes: int
    uptime_s: float
    messages_lost: int
    faults: int
    level: Level


@dataclass(frozen=True, slots=True)
class DeviceRow:
    """One device behind a bridge."""

    device: str
    port: str
    state: str
    text: str
    age_s: float
    bytes_per_s: float | None
    messages_decoded: int
    frames_rejected: int
    samples_lost: int
    level: Level


@dataclass(frozen=True, slots=True)
class EventRow:
    """The last event of one source, while it is news."""

    source: str
    kind: str
    facts: dict[str, float | int | str]
    text: str
    """The event as people read it."""
    age_s: float
    level: Level


@dataclass(frozen=True, slots=True)
class Board:
    """Everything on the screen."""

    vehicle: str
    now_ns: int
    nodes: list[NodeRow]
    devices: list[DeviceRow]
    events: list[EventRow]
    keys: list[KeyRow]

    @property
    def rate_hz(self) -> float:
        """Messages a second on all keys."""
        return sum(row.rate_hz or 0.0 for row in self.keys)

    @property
    def bytes_per_s(self) -> float:
        return sum(row.bytes_per_s for row in self.keys)

    @property
    def lost(self) -> int:
        return sum(row.lost for row in self.keys)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        plain = asdict(self)
        parts = (plain["nodes"], plain["devices"], plain["events"], plain["keys"])
        for row in chain(*parts):
            for name, value in row.items():
                if isinstance(value, Level):
                    row[name] = value.name.lower()
        totals = {"rate_hz": self.rate_hz, "bytes_per_s": self.bytes_per_s, "lost": self.lost}
        return plain | totals


def board(stats: Stats, vehicle: str, now_ns: int, decode: Decoder | None = None) -> Board:
    """The state of `vehicle` at `now_ns` as its messages tell it."""
    decode = decode or Decoder()
    nodes: list[NodeRow] = []
    devices: list[DeviceRow] = []
    events: list[EventRow] = []
    rows: list[KeyRow] = []
    for found in stats.in_order():
        if found.vehicle != vehicle:
            continue
        message = decode(found.last) if found.last is not None else None
        rows.append(_key_row(found, digest(message) if found.last is not None else "", now_ns))
        if isinstance(message, NodeHealth):
            nodes.append(_node_row(found, message, decode, now_ns))
        elif isinstance(message, DeviceHealth):
            devices.append(_device_row(found, message, decode, now_ns))
        elif isinstance(message, Event) and (found.age_s(now_ns) or 0.0) <= NEWS_S:
            events.append(_event_row(found, message, now_ns))
    return Board(vehicle, now_ns, nodes, devices, events, rows)


def _event_row(found: KeyStats, message: Event, now_ns: int) -> EventRow:
    return EventRow(
        source=message.source,
        kind=message.kind,
        facts=facts_of(message),
        text=sentence_of(message),
        age_s=found.age_s(now_ns) or 0.0,
        level=Level.FINE if message.severity == Event.DEBUG else _level(message.severity),
    )


def _key_row(found: KeyStats, last: str, now_ns: int) -> KeyRow:
    rate_hz, age_s = found.rate_hz(now_ns), found.age_s(now_ns)
    nominal_hz = found.key.rate_hz if found.key is not None else 0.0
    size_bytes = len(found.last.payload) if found.last is not None else 0
    slow = nominal_hz > 0 and rate_hz is not None and rate_hz < SLOW * nominal_hz
    overdue = 0.0
    if nominal_hz > 0 and age_s is not None:
        overdue = age_s / max(1.0, MISSED_PERIODS / nominal_hz)
    return KeyRow(
        key=found.path,
        type=found.type_name,
        rate_hz=rate_hz,
        nominal_hz=nominal_hz,
        age_s=age_s,
        count=found.count,
        lost=found.lost,
        size_bytes=size_bytes,
        bytes_per_s=(rate_hz or 0.0) * size_bytes,
        last=last,
        rate_level=Level.WARNING if slow else Level.FINE,
        age_level=Level.BAD if overdue > 5 else Level.WARNING if overdue > 1 else Level.FINE,
    )


def _node_row(found: KeyStats, message: NodeHealth, decode: Decoder, now_ns: int) -> NodeRow:
    age_s = found.age_s(now_ns) or 0.0
    before = decode(found.before) if found.before is not None else None
    state, level = name_of(NodeHealth.State, message.state), _level(message.state)
    if age_s > SILENT_S:
        state, level = "SILENT", Level.BAD
    return NodeRow(
        node=message.node,
        state=state,
        text=message.text,
        age_s=age_s,
        cpu_percent=_cpu_percent(before, message),
        rss_bytes=message.rss_bytes,
        uptime_s=message.uptime_s,
        messages_lost=message.messages_lost,
        faults=message.faults,
        level=level,
    )


def _level(state: int) -> Level:
    """Attention that a state deserves; one that nobody knows is bad."""
    return Level(state) if state in (Level.FINE, Level.WARNING) else Level.BAD


def _cpu_percent(before: Any, message: NodeHealth) -> float | None:
    """Of one core, between two heartbeats of one process."""
    if not isinstance(before, NodeHealth) or before.pid != message.pid:
        return None
    dt_s = message.uptime_s - before.uptime_s
    return 100.0 * (message.cpu_s - before.cpu_s) / dt_s if dt_s > SHORT_S else None


def _device_row(found: KeyStats, message: DeviceHealth, decode: Decoder, now_ns: int) -> DeviceRow:
    age_s = found.age_s(now_ns) or 0.0
    before = decode(found.before) if found.before is not None else None
    bytes_per_s = None
    if isinstance(before, DeviceHealth) and message.stamp_ns > before.stamp_ns:
        received = message.bytes_received - before.bytes_received
        bytes_per_s = max(0.0, received * S / (message.stamp_ns - before.stamp_ns))
    state, level = name_of(DeviceHealth.State, message.state), _level(message.state)
    if age_s > SILENT_S:
        state, level = "UNKNOWN", Level.BAD
    return DeviceRow(
        device=message.device,
        port=message.port,
        state=state,
        text=message.text,
        age_s=age_s,
        bytes_per_s=bytes_per_s,
        messages_decoded=message.messages_decoded,
        frames_rejected=message.frames_rejected,
        samples_lost=message.samples_lost,
        level=level,
    )
