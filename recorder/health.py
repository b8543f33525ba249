"""What a record says of the system itself: states of nodes and devices, losses, sentences.

States are kept as runs: from the message that first told one to the last that still did, so hours
of heartbeats come down to the few times that something changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys
from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.events.messages import identity_of, sentence_of
from tramstream.proto.health_pb2 import ClockReference, DeviceHealth, Event, Loss, NodeHealth

SILENCE_NS = 5 * S
"""Heartbeats come once a second; a longer pause ends a run, for nobody knows the state."""


@dataclass(slots=True)
class Run:
    """One node or device in one state, from `start_ns` to `end_ns`."""

    state: str
    text: str
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Sentence:
    """One line of a node's log; `kind` is that of the event which it words, empty if of none."""

    stamp_ns: int
    level: str
    node: str
    text: str
    kind: str = ""


@dataclass(slots=True)
class Happened:
    """All events of one kind that one source has told."""

    node: str
    kind: str
    level: str
    count: int
    """Those included that it did not tell one by one."""
    first_ns: int
    last_ns: int
    last: str
    """The last of them, worded."""


@dataclass(slots=True)
class Health:
    """The `health/` part of a record; nodes and devices by the source of their key."""

    nodes: dict[str, list[Run]] = field(default_factory=dict)
    devices: dict[str, list[Run]] = field(default_factory=dict)
    last_of_node: dict[str, NodeHealth] = field(default_factory=dict)
    last_of_device: dict[str, DeviceHealth] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    happened: dict[tuple[str, str], Happened] = field(default_factory=dict)
    """Events by source and kind, in the order in which they came up."""
    _told: set[tuple[str, str]] = field(default_factory=set)  # of these by events, not heartbeats
    _lines: dict[tuple[str, int, int], Sentence] = field(default_factory=dict)
    utc_offset_ns: int | None = None
    """Host's UTC minus vehicle clock, as last told; None if nobody did."""

    @property
    def log(self) -> list[Sentence]:
        """Events, and what was said by programs that know none, each once."""
        return list(self._lines.values())

    def add(self, topic: str, message: Any) -> None:
        """Take a message of one of `HEALTH_TYPES`."""
        source = keys.split(topic)[1].split("/")[1:2]
        _ADD[type(message).DESCRIPTOR.full_name](self, source[0] if source else topic, message)


def _add_node(health: Health, source: str, beat: NodeHealth) -> None:
    state = name_of(NodeHealth.State, beat.state)
    _extend(health.nodes.setdefault(source, []), state, beat.text, beat.stamp_ns)
    before = health.last_of_node.get(source)
    lasting = {identity_of(trouble) for trouble in before.troubles} if before is not None else set()
    for trouble in beat.troubles:
        begins = identity_of(trouble) not in lasting
        if begins and (source, trouble.kind) not in health._told:
            _happen(health, source, trouble, beat.stamp_ns)
    health.last_of_node[source] = beat


def _add_device(health: Health, source: str, device: DeviceHealth) -> None:
    state = name_of(DeviceHealth.State, device.state)
    _extend(health.devices.setdefault(source, []), state, device.text, device.stamp_ns)
    health.last_of_device[source] = device


def _add_loss(health: Health, source: str, loss: Loss) -> None:
    health.losses.append(loss)


def _add_event(health: Health, source: str, event: Event) -> None:
    level, text = name_of(Event.Severity, event.severity), sentence_of(event)
    node, stamp_ns = event.source or source, event.stamp_ns
    place = (source, stamp_ns, event.sequence & 0xFFFFFFFF)
    health._lines[place] = Sentence(stamp_ns, level, node, text, event.kind)
    health._told.add((source, event.kind))
    _happen(health, source, event, stamp_ns)


def _happen(health: Health, source: str, event: Event, stamp_ns: int) -> None:
    """Count an event, or the beginning of a trouble that lasts."""
    level, text = name_of(Event.Severity, event.severity), sentence_of(event)
    known = health.happened.get((source, event.kind))
    if known is None:
        node = event.source or source
        known = Happened(node, event.kind, level, 0, stamp_ns, stamp_ns, text)
        health.happened[source, event.kind] = known
    known.count += 1 + event.unsaid
    known.last_ns, known.last = stamp_ns, text


def _add_log(health: Health, source: str, log: Any) -> None:
    """A sentence; if it words an event, that one is there, or comes and takes its place."""
    level = name_of(Log.Level, log.level)
    stamp_ns = log.timestamp.ToNanoseconds()
    number = log.line if log.file else -1 - len(health._lines)
    line = Sentence(stamp_ns, level, log.name or source, log.message)
    health._lines.setdefault((source, stamp_ns, number), line)


def _add_clock(health: Health, source: str, reference: ClockReference) -> None:
    health.utc_offset_ns = reference.host_utc_ns - reference.stamp_ns


def _extend(runs: list[Run], state: str, text: str, stamp_ns: int) -> None:
    """The state holds until the next message, unless that one is long in coming."""
    last = runs[-1] if runs else None
    if last is not None and 0 <= stamp_ns - last.end_ns <= SILENCE_NS:
        last.end_ns = stamp_ns
        if last.state == state:
            last.text = text or last.text
            return
    runs.append(Run(state, text, stamp_ns, stamp_ns))


_ADD: dict[str, Callable[[Health, str, Any], None]] = {
    NodeHealth.DESCRIPTOR.full_name: _add_node,
    DeviceHealth.DESCRIPTOR.full_name: _add_device,
    Loss.DESCRIPTOR.full_name: _add_loss,
    Event.DESCRIPTOR.full_name: _add_event,
    Log.DESCRIPTOR.full_name: _add_log,
    ClockReference.DESCRIPTOR.full_name: _add_clock,
}
HEALTH_TYPES = frozenset(_ADD)
"""Full names of the message types that tell how the system is doing."""
