"""What the recorder has to say of its folder, of keys and of what it has had again."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, INFO, define

FOLDER_REFUSED = define(
    "recorder.folder_refused",
    "{folder}: the folder of records cannot be made or read: {reason}",
    cause="A disk that is not mounted, or a folder of somebody else.",
    cure="{advice}",
    severity=ERROR,
    folder=str,
    reason=str,
    advice=str,
)
NO_SPACE = define(
    "recorder.no_space",
    "{folder}: recording stopped, {free_bytes} are free, the floor is {floor_bytes} "
    "($.recorder.free_space_floor_bytes), and no record may be deleted",
    cause="The disk is nearly full, and what is left are records that somebody has protected "
    "(*.keep), or nobody's records.",
    cure="make space or remove *.keep files",
    severity=ERROR,
    folder=str,
    free_bytes=int,
    floor_bytes=int,
)
NOT_FINISHED = define(
    "recorder.not_finished",
    "the disk did not take all; what is written is repaired at the next start",
    cause="The recorder had to end while the disk refused or was slower than 10 s.",
    severity=ERROR,
)
PART_DELETED = define(
    "recorder.part_deleted",
    "{part}: deleted, {free_bytes} were free, the floor is {floor_bytes} "
    "($.recorder.free_space_floor_bytes)",
    cause="The disk had less room than the floor: the oldest record goes first. Putting a file "
    "NAME.mcap.keep beside a record protects it.",
    part=str,
    free_bytes=int,
    floor_bytes=int,
)
SPACE_HELD = define(
    "recorder.space_held",
    "{part}: was deleted, but its space is not free yet, somebody may still read it",
    cause="A program has the deleted record open.",
    cure="end what reads it (fuser shows which)",
    part=str,
)
PART_NOT_DELETED = define(
    "recorder.part_not_deleted",
    "{part}: cannot be deleted: {reason}",
    cause="The record belongs to another user, or the disk is read-only.",
    cure="{advice}",
    part=str,
    reason=str,
    advice=str,
)
PART_RENAMED = define(
    "recorder.part_renamed",
    "{part}: the time is known now, it is {to}",
    cause="The computer had no clock when the part was begun.",
    severity=INFO,
    part=str,
    to=str,
)
PART_REPAIRED = define(
    "recorder.part_repaired",
    "{part}: {messages} messages over {lasting_s} saved; {damaged_bytes} were not as written, "
    "{torn} chunks torn or damaged, {unknown} messages left out whose channel is not described",
    cause="The run before ended without finishing its record: a power cut or a kill.",
    severity=INFO,
    part=str,
    messages=int,
    lasting_s=float,
    damaged_bytes=int,
    torn=int,
    unknown=int,
)
EMPTY_DELETED = define(
    "recorder.empty_deleted",
    "{part}: held no message and was deleted",
    cause="The run before ended before its record had a message.",
    severity=INFO,
    part=str,
)
PART_NOT_REPAIRED = define(
    "recorder.part_not_repaired",
    "{reason}",
    cause="A record that was not finished holds nothing that can be read, is being written by "
    "another recorder, or lies on a disk that refuses.",
    cure="{advice}",
    reason=str,
    advice=str,
)
HAD_AGAIN = define(
    "recorder.had_again",
    "{messages} messages that did not come were had again",
    cause="The bus has dropped messages, or the recorder stood still; their publishers still had "
    "them.",
    severity=INFO,
    messages=int,
)
STRANGE_ANSWER = define(
    "recorder.strange_answer",
    "{size_bytes} that answer a question for missing messages are {reason}; left out",
    cause="Somebody else answers for a publisher.",
    cure="end that program",
    size_bytes=int,
    reason=str,
)
KEY_OF_OTHERS = define(
    "recorder.key_of_others",
    "{key}: not recorded, for it is no key of this vehicle",
    cause="Somebody publishes below this vehicle's prefix under another name.",
    cure="give that program this vehicle's name ($.vehicle), or end it",
    key=str,
)
TOO_MANY_KEYS = define(
    "recorder.too_many_keys",
    "{key}: not recorded; {limit} keys are, and this is more",
    cause="Somebody who is no node of the vehicle makes up ever new keys.",
    cure="end that program, or leave its keys out ($.recorder.exclude)",
    key=str,
    limit=int,
)
SECOND_PUBLISHER = define(
    "recorder.second_publisher",
    "{key} comes from a second publisher, {who}; it is recorded as {kept}",
    cause="Two programs publish one key: two receivers, a node started twice, a replay onto a "
    "running vehicle.",
    cure="end one of them",
    key=str,
    who=str,
    kept=str,
)
NOT_DESCRIBED = define(
    "recorder.not_described",
    "messages of {type} are recorded as bytes, for {reason}",
    cause="The type is of another package, and its publisher does not answer for it.",
    cure="a processor's types are described by its node; other programs answer on tram/schema/TYPE",
    type=str,
    reason=str,
)
