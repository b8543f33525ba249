"""Messages as text for people: one field a line, like YAML; long things shortened."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from google.protobuf.message import Message

from tramstream.clock import S
from tramstream.shown import shown

SHOWN_ITEMS = 8
SHOWN_BYTES = 32
HEAD_FIELDS = frozenset(("stamp_ns", "sequence", "timestamp"))
"""Stand in the header line already."""


def iso(stamp_ns: int) -> str:
    """UTC with all nanoseconds: `2025-11-22T03:05:01.123456789Z`."""
    seconds, nanoseconds = divmod(stamp_ns, S)
    text = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    return f"{text}.{nanoseconds:09d}Z"


def stamp_ns(message: Any) -> int | None:
    """When the message was true; None if it does not say."""
    fields = message.DESCRIPTOR.fields_by_name
    if "stamp_ns" in fields:
        return int(message.stamp_ns)
    if "timestamp" in fields and fields["timestamp"].message_type is not None:
        return int(message.timestamp.ToNanoseconds())
    return None


def readable(message: Message, full: bool = False) -> list[str]:
    """The fields, without stamp and sequence; unset optional ones are left out."""
    return list(_fields(message, full, skipped=HEAD_FIELDS))


def _fields(message: Message, full: bool, skipped: frozenset[str] = frozenset()) -> Iterator[str]:
    for field in message.DESCRIPTOR.fields:
        if field.name in skipped or (field.has_presence and not message.HasField(field.name)):
            continue
        value = getattr(message, field.name)
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            yield f"{field.name}:" if value else f"{field.name}: {{}}"
            yield from (f"  {name}: {item}" for name, item in sorted(value.items()))
        elif field.is_repeated:
            yield from _repeated(field, value, full)
        elif isinstance(value, Message):
            yield f"{field.name}:"
            yield from (f"  {text}" for text in _fields(value, full))
        else:
            yield from _text_lines(field.name, _scalar(field, value, full))


def _repeated(field: Any, values: Any, full: bool) -> Iterator[str]:
    listed = values if full else values[:SHOWN_ITEMS]
    rest = len(values) - len(listed)
    if field.message_type is None:
        items = [_scalar(field, value, full) for value in listed]
        items += [f"… {len(values)} in all"] if rest else []
        yield f"{field.name}: [{', '.join(items)}]"
        return
    yield f"{field.name}:" if values else f"{field.name}: []"
    for value in listed:
        inner = list(_fields(value, full)) or ["{}"]
        yield f"  - {inner[0]}"
        yield from (f"    {text}" for text in inner[1:])
    if rest:
        yield f"  … {len(values)} in all"


def _text_lines(name: str, text: str) -> Iterator[str]:
    """A text of several lines stands below its name."""
    if "\n" not in text:
        yield f"{name}: {text}"
        return
    yield f"{name}: |"
    yield from (f"  {part}" for part in text.rstrip("\n").split("\n"))


def _scalar(field: Any, value: Any, full: bool) -> str:
    if isinstance(value, bytes):
        front = value if full else value[:SHOWN_BYTES]
        return front.hex(" ") + (f" … {len(value)} bytes" if len(front) < len(value) else "")
    if field.enum_type is not None:
        known = field.enum_type.values_by_number.get(value)
        return known.name if known is not None else str(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.12g}"
    return shown(str(value), lines=True)
