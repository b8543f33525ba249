"""What becomes of a record's file on its way to the disk: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, define

DISK_REFUSES = define(
    "record.disk_refuses",
    "{path}: {reason}; {waiting_bytes} wait in memory, {dropped} messages were dropped",
    cause="The disk is full, read-only, broken or gone. Messages wait in memory as long as there "
    "is room, and are written as soon as the disk takes them.",
    cure="{advice}",
    severity=ERROR,
    path=str,
    reason=str,
    advice=str,
    waiting_bytes=int,
    dropped=int,
)
PART_RESCUED = define(
    "record.part_rescued",
    "{part}: was deleted or moved while it was written; it is whole again",
    cause="Somebody has deleted or moved a file that the recorder has open.",
    cure="leave files that end in .active alone",
    part=str,
)
