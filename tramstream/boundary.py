"""The boundary: where bytes off the bus, or out of a record, become messages.

Anybody may publish anything, so bytes that are no message are data and not an exception: `decode`
gives the message or an `Undecodable`, which callers count, tell and leave out. The record keeps the
bytes as they came.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

LATEST_NS = (1 << 63) - 1
"""Year 2262; numpy and databases hold no later instant, and no clock of ours shows one."""
LATEST_S = 9_223_372_036
"""The same of a Foxglove timestamp, before 1970 as well."""


class Undecodable(NamedTuple):
    """Bytes that are no message of their key's type."""

    key: str
    size: int
    reason: str

    def __str__(self) -> str:
        return f"{self.key}: {self.size} bytes are {self.reason}"


def decode(type_: Any, payload: bytes, key: str) -> Any:
    """The message of `type_` in `payload`, or an `Undecodable`; raises for no bytes.

    Parameters
    ----------
    type_ : message class
    payload : bytes
    key : str
        Where it came from, for the sentence.
    """
    try:
        message = type_.FromString(payload)
    except DecodeError:
        return Undecodable(key, len(payload), f"no {type_.DESCRIPTOR.full_name}")
    try:
        if message.stamp_ns <= LATEST_NS:
            return message
    except AttributeError:  # cheaper than to look first, for what is nearly always there
        if _timestamp_is_one(message):
            return message
    return Undecodable(
        key, len(payload), f"a {type_.DESCRIPTOR.full_name} of an instant that no clock shows"
    )


def _timestamp_is_one(message: Any) -> bool:
    """Whether a Foxglove timestamp, if there is one, is an instant."""
    field = message.DESCRIPTOR.fields_by_name.get("timestamp")
    if field is None or field.message_type is None:
        return True
    seconds = getattr(message.timestamp, "seconds", 0)
    return bool(abs(seconds) < LATEST_S)


def described(data: bytes, name: str) -> type[Message] | str:
    """The class of the messages called `name` that a FileDescriptorSet describes, or why not.

    Parameters
    ----------
    data : bytes
        Encoded FileDescriptorSet, a stranger's perhaps.
    name : str
        Full name of the message type.
    """
    try:
        files = {file.name: file for file in FileDescriptorSet.FromString(data).file}
        pool = DescriptorPool()

        def add(file_name: str) -> None:
            file = files.pop(file_name, None)
            if file is not None:
                for dependency in file.dependency:
                    add(dependency)
                pool.Add(file)

        for file_name in list(files):
            add(file_name)
        class_: type[Message] = GetMessageClass(pool.FindMessageTypeByName(name))
    except (DecodeError, KeyError, TypeError, ValueError, RecursionError):
        # What protobuf raises for a description that is garbage, or lacks the type or its parts.
        return f"of a type whose description ({name or 'without a name'}) is damaged"
    return class_


PROTOBUF = "application/protobuf;"
"""Beginning of the encoding that is declared on every put; the type's full name follows."""


def type_name(encoding: str) -> str:
    """Full name of the message type that an encoding declares; empty if it is not protobuf."""
    return encoding.removeprefix(PROTOBUF) if encoding.startswith(PROTOBUF) else ""


def name_of(enum: Any, number: int) -> str:
    """Name of an enumeration's value; of one that only a newer version knows, its number."""
    known = enum.DESCRIPTOR.values_by_number.get(number)
    return str(known.name) if known is not None else f"UNKNOWN_{number}"


def left_out(counts: Iterable[tuple[str, int]]) -> str:
    """One sentence about undecodable messages by key; empty if there are none."""
    told = [f"{count} on {key}" for key, count in counts if count]
    return f"messages that cannot be decoded were left out: {', '.join(told)}" if told else ""
