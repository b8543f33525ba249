"""Decode and encode UBX messages by the tables of `ubx_layouts`.

A payload that does not have a length its type allows, or contradicts its own count of entries, is
refused, however good its checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tramstream.bridges.gnss import ubx_layouts
from tramstream.bridges.gnss.framer import Frame, Rejected, ubx_frame
from tramstream.bridges.gnss.ubx_layouts import Layout

REQUEST_LENGTH = 8
"""Length of a whole frame without payload: a request for the message, not the message."""


class UbxMessage(NamedTuple):
    """One decoded message, values in the units of its table.

    `records` are the entries of the repeating group, each in the table's order.
    """

    name: str
    fields: dict[str, Any]
    records: list[tuple[Any, ...]]
    form: str = ""
    """Which of several forms it had; empty for the newest."""

    def rows(self) -> list[dict[str, Any]]:
        """The records with their names: easier to read, slower."""
        names = ubx_layouts.BY_NAME[f"{self.name} {self.form}".rstrip()].group_names
        return [dict(zip(names, record, strict=True)) for record in self.records]


def decode(frame: Frame) -> UbxMessage | Rejected:
    """Decode a UBX frame.

    Refused are types without a table (`knows` tells beforehand), requests (no payload) and payloads
    of the wrong length.
    """
    forms = ubx_layouts.BY_KIND.get(frame.kind)
    if forms is None:
        return _refuse(frame, "UBX without a decoder")
    payload = frame.raw[6:-2]
    layout = next((form for form in forms if form.fits(payload)), None)
    if layout is None:
        return _refuse(frame, f"{forms[0].name} length")
    fixed, step = layout.fixed.size, layout.repeated.size
    extra = len(payload) - fixed
    fields = dict(zip(layout.names, layout.fixed.unpack_from(payload), strict=True))
    count = extra // step if step else 0
    if count != _expected_count(layout, fields, count):
        return _refuse(frame, f"{layout.name} count")
    for name, divisor in layout.scaled:
        fields[name] /= divisor
    records: list[tuple[Any, ...]] = []
    if count:
        records = list(layout.repeated.iter_unpack(payload[fixed:]))
        for at, divisor in layout.group_scaled:
            records = [(*r[:at], r[at] / divisor, *r[at + 1 :]) for r in records]
    return UbxMessage(layout.name, fields, records, layout.form)


def knows(kind: int) -> bool:
    """Whether there is a table for class and identifier `kind`."""
    return kind in ubx_layouts.BY_KIND


def encode(
    name: str,
    fields: Mapping[str, Any] | None = None,
    records: Sequence[Mapping[str, Any] | Sequence[Any]] = (),
) -> bytes:
    """Make the whole frame of message `name`; what is not given is zero.

    Parameters
    ----------
    name : str
        As the manual has it; an older form of a message by its title, `NAV-PVT u-blox 7`.
    fields : mapping
        Values in the units of the table. The count of records is filled in.
    records : sequence
        Entries of the repeating group, by name or in the table's order.

    Raises
    ------
    ValueError
        If there is no such message or field, or a value does not fit into its field.
    """
    layout = ubx_layouts.BY_NAME.get(name)
    if layout is None:
        raise ValueError(
            f"no layout for UBX message {name!r}; see tramstream.bridges.gnss.ubx_layouts"
        )
    values = dict(fields or {})
    if layout.version >= 0:
        values.setdefault("version", layout.version)
    if layout.count:
        values[layout.count] = len(records)
    payload = _pack(layout.fixed, layout.fields, values, name)
    for record in records:
        entry = record
        if not isinstance(entry, Mapping):
            entry = dict(zip(layout.group_names, entry, strict=True))
        payload += _pack(layout.repeated, layout.group, entry, name)
    return ubx_frame(layout.kind, payload)


def _pack(
    packer: struct.Struct,
    table: tuple[ubx_layouts.Field, ...],
    values: Mapping[str, Any],
    name: str,
) -> bytes:
    unknown = set(values) - {field.name for field in table}
    if unknown:
        raise ValueError(f"{name} has no field {', '.join(sorted(unknown))}")
    wire: list[Any] = []
    for field in table:
        text = field.type[0] == "C" or "*" in field.type
        value = values.get(field.name, b"" if text else 0)
        if field.scale != 1.0:
            value = round(value * field.divisor)
        wire.append(value)
    try:
        return packer.pack(*wire)
    except struct.error as error:
        raise ValueError(f"{name}: {error}") from error


def _expected_count(layout: Layout, fields: dict[str, Any], count: int) -> int:
    """How many records the message itself says it has; `count` if it does not say."""
    if layout.count:
        expected: int = fields[layout.count]
        return expected
    if layout.name == "ESF-MEAS":
        flags = fields["flags"]
        # older receivers leave the count at zero
        return (flags >> 11) + (flags >> 3 & 1) if flags >> 11 else count
    return count


def _refuse(frame: Frame, reason: str) -> Rejected:
    return Rejected(reason, frame.start, len(frame.raw))
