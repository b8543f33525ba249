"""The boundary: where bytes off the bus, or out of a record, become messages.

Anybody may publish anything, so bytes that are no message are data and not an exception: `decode`
gives the message or an `Undecodable`, which callers count, tell and leave out. The record keeps the
bytes as they came.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper
from google.protobuf.message import DecodeError

LATEST_NS = (1 << 63) - 1
"""Year 2262; numpy and databases hold no later instant, and no clock of ours shows one."""
EARLIEST_S, LATEST_S = -62_135_596_800, 9_223_372_036
"""Of a Foxglove timestamp: from the year 1 on, which is protobuf's own bound."""


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
    return bool(EARLIEST_S <= seconds < LATEST_S)


def name_of(enum: EnumTypeWrapper, number: int) -> str:
    """Name of an enumeration's value; of one that only a newer version knows, its number."""
    known = enum.DESCRIPTOR.values_by_number.get(number)
    return str(known.name) if known is not None else f"UNKNOWN_{number}"


def left_out(counts: Iterable[tuple[str, int]]) -> str:
    """One sentence about undecodable messages by key; empty if there are none."""
    told = [f"{count} on {key}" for key, count in counts if count]
    return f"messages that cannot be decoded were left out: {', '.join(told)}" if told else ""
