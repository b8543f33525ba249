"""J1939: what the identifier of a frame tells, and values that are none.

An identifier has priority (3 bits), parameter group (PGN, 18 bits) and the sender's source address
(8 bits). A message is known by its group and its sender; the priority is the sender's to choose. A
DBC of the standard cannot know the address: it says FE, the null address, from which nobody sends,
and means any.

References
----------
SAE J1939-21, section 5.1.2 (identifier), 5.2 (parameter group); SAE J1939-71, section 5.1.3, tables
1 and 2 (transmitted ranges), as Vector's "Introduction to J1939" prints them.
"""

from __future__ import annotations

from typing import NamedTuple

ANY_SOURCE = 0xFE
"""The null address: in a DBC, whoever sends it."""
_PDU2 = 0xF0
"""From this format on the next byte extends the group; below, it is the destination."""
NOT_AVAILABLE = "not available (J1939)"
IN_ERROR = "error indicator (J1939)"
RESERVED = "reserved value (J1939)"
_FIRST_RESERVED = 0xFB
_ERROR_BYTE = 0xFE
_NONE_BYTE = 0xFF
_ROUNDED = 1e-4
"""Of a largest value as DBCs round it: 250.996 for 250.99609375."""


class Address(NamedTuple):
    """Who sends what."""

    group: int
    """PGN; 0 for the destination's byte, where it has one."""
    source: int


def address_of(id_: int) -> Address:
    """Parameter group and source address of an identifier of 29 bits."""
    group = id_ >> 8 & 0x3FFFF
    if group >> 8 & 0xFF < _PDU2:
        group &= 0x3FF00
    return Address(group, id_ & 0xFF)


def stands_for_any(id_: int) -> bool:
    """Whether an identifier in a DBC can only be meant for J1939: a broadcast that nobody sends."""
    return id_ & 0xFF == ANY_SOURCE and id_ >> 16 & 0xFF >= _PDU2


def ends_like_a_parameter(largest: float | None, scale: float, offset: float, length: int) -> bool:
    """Whether the largest value that a DBC states is that of J1939: raw FA, FAFF, FAFFFFFF.

    Nobody else ends there; so a message of 29 bits tells its protocol that names none.
    """
    if length not in (8, 16, 32) or largest is None or not scale:
        return False
    raw = (largest - offset) / scale
    last = (_FIRST_RESERVED << (length - 8)) - 1
    return abs(raw - last) <= max(0.5, _ROUNDED * last)


def why_no_value(bits: int, length: int) -> str:
    """What an unsigned parameter says instead of a value; empty where it is one.

    From 8 bits on the uppermost byte tells (FF not available, FE error, FB to FD reserved),
    whatever follows it; of fewer bits the last two values do. One bit has no room for it.
    """
    if length >= 8:
        top = bits >> (length - 8)
        if top < _FIRST_RESERVED:
            return ""
        return {_NONE_BYTE: NOT_AVAILABLE, _ERROR_BYTE: IN_ERROR}.get(top, RESERVED)
    last = (1 << length) - 1
    if length == 1 or bits < last - 1:
        return ""
    return NOT_AVAILABLE if bits == last else IN_ERROR
