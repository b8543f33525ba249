"""What a node has to say of itself, its inputs, its memory and its device: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, INFO, define

FAULT = define(
    "node.fault",
    "a stage failed and goes on with what comes next, {trace}",
    cause="A bug in a processor, bridge or node: an exception that nobody expected.",
    severity=ERROR,
    error=str,
    trace=str,
)
FAULTY = define(
    "node.faulty",
    "{faults} faults, last {error}; trace in health/{node}/event",
    cause="Stages have failed since the node was started (node.fault tells each).",
    severity=ERROR,
    faults=int,
    error=str,
    node=str,
)
UNDECODABLE = define(
    "input.undecodable",
    "{key} holds bytes that are {reason}; not used (UNDECODABLE)",
    cause="Somebody publishes another type on the key, or a message that is cut.",
    cure="see with `tramstream top` who publishes it",
    key=str,
    reason=str,
)
FUTURE_STAMP = define(
    "input.future_stamp",
    "{key} has stamps {ahead_s} ahead of their arrival, limit {limit_s}; not used (STAMP)",
    cause="The clock of a device or of a publisher is ahead; one sample from the future would hold "
    "up everybody until then. The limit is that of a clock's fit (tramstream/live/stamps.py).",
    cure="look at that device's clock",
    key=str,
    ahead_s=float,
    limit_s=float,
)
SECOND_PUBLISHER = define(
    "input.second_publisher",
    "{key} is from a second publisher, {who}; not used (SOURCE)",
    cause="Two programs publish one key: two receivers, a node started twice, a replay onto a "
    "running vehicle.",
    cure="end one of them",
    key=str,
    who=str,
)
NOT_USED = define(
    "input.not_used",
    "{not_used} messages not used in all",
    cause="What was not used since the node was started, for any of these causes.",
    not_used=int,
)
SNAPSHOT_UNREADABLE = define(
    "memory.unreadable",
    "{path}: the snapshot cannot be read ({reason}); starting afresh",
    cause="The file of a process that died is damaged or not this user's.",
    path=str,
    reason=str,
)
MEMORY_TAKEN = define(
    "memory.taken",
    "{node} goes on from the memory of its predecessor",
    cause="A process that died was started again within a minute.",
    severity=INFO,
    node=str,
)
MEMORY_OF_OTHERS = define(
    "memory.of_others",
    "{path}: of other processors or settings; starting afresh",
    cause="The configuration or the version has changed since the process before.",
    path=str,
)
DEVICE_NOT_OPENED = define(
    "device.not_opened",
    "{device}: not opened yet",
    cause="The node has just begun.",
    device=str,
)
DEVICE_AWAY = define(
    "device.away",
    "{reason}",
    cause="The device is unplugged, held by another program, or refuses; it is tried again, from "
    "every 0.1 s to every 5 s.",
    cure="{advice}",
    severity=ERROR,
    device=str,
    reason=str,
    advice=str,
)
DEVICE_SILENT = define(
    "device.silent",
    "{device}: open, but silent for {silence_s}, limit {limit_s}",
    cause="The device says nothing: no power behind the adapter, a broken cable, another bit rate.",
    cure="check power, cable and bit rate",
    device=str,
    silence_s=float,
    limit_s=float,
)
PORT_FAILED = define(
    "device.port_failed",
    "{device}: {error}; it is opened again",
    cause="A bug in the port, told with its trace as node.fault.",
    severity=ERROR,
    device=str,
    error=str,
)
