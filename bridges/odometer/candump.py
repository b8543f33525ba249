"""Lines of candump: `(seconds) interface ID#DATA` of `candump -L`, and those made to be looked at.

    (1436509052.249713) can0 044#2A366C2BBA        11-bit identifier: three digits
    (1436509052.249713) can0 18FF0A31#01           29-bit identifier: eight digits
    (1436509052.249713) can0 044#R8                remote frame that asks for 8 bytes
    (1436509052.249713) can0 044##1112233          CAN FD: one digit of flags, then data
    (1436509052.249713) can0 20000040#00…00        error frame: bit 29 of the identifier

A trailing `T` or `R` (candump -x) and `_x` (a raw length above 8) are read over. `candump -t a`
writes the same frames for people:

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA
    (1436509052.249713)  can0  RX - -  18FF0A31   [1]  01          -x: direction and flags
    (1436509052.249713)  can0  044   [8]  remote request
    (1436509052.249713)  can0  044  [03]  11 22 33                 CAN FD: two digits of length
    (1436509052.249713)  can0  20000040   [8]  00 … 00   ERRORFRAME
    (1436509052.249713)  can0  044   [2]  41 42   'AB'             -a: as text too

What tells no instant is no frame: a line without a stamp, and one with a date (`-t A`), which is of
an unknown time zone. Format: can-utils, lib.h, "CAN DATA formats"; lib.c, `snprintf_long_canframe`;
candump.c.
"""

from __future__ import annotations

import re

from tramstream.bridges.odometer.frames import (
    CLASSIC_LENGTH,
    DATA_LENGTHS,
    ERROR,
    EXTENDED,
    FD,
    ID_MASK,
    REMOTE,
    STANDARD_MASK,
    CanFrame,
    Rejected,
)

LINE = re.compile(r"\((\d{1,12})\.(\d{1,9})\)\s+(\S{1,64})\s+(\S.*)", re.ASCII)
FRAME = re.compile(r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})(##?)(\S*)(?:\s+[RT])?")
VIEW = re.compile(
    r"(?:(?:RX|TX)\s+[B-]\s+[E-]\s+)?([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+"
    r"(?:\[(\d{1,2})\]|\{([0-9A-Fa-f])\})\s*(.*)",
    re.ASCII,
)
VIEW_DATA = re.compile(
    r"((?:[0-9A-Fa-f]{2}\s*)*|remote request\s*)(?:'.*'\s*)?(ERRORFRAME\s*)?(?:'.*')?", re.ASCII
)
DATE = re.compile(r"\(\d{4}-\d\d-\d\d[ T]", re.ASCII)
UNSTAMPED = re.compile(rf"\S{{1,64}}\s+(?:{FRAME.pattern}|{VIEW.pattern})", re.ASCII)
EXTENDED_BIT = 0x80000000
ERROR_BIT = 0x20000000
RAW_LENGTH = re.compile(r"_[0-9A-Fa-f]\Z")
LATEST_S = 2**63 // 1_000_000_000 - 86_400
"""A stamp of nanoseconds has 63 bits: the year 2262, less what clocks differ by."""
LONGEST = 512
"""Characters of a line; 64 bytes of CAN FD, shown as numbers and as text, have some 350."""
NO_LINE = "not a candump line"
NO_STAMP = "no stamp (candump -L or -t a writes one)"
LOCAL_DATE = "a date of an unknown time zone (candump -L or -t a writes seconds)"


def parse_line(line: str) -> CanFrame | Rejected:
    """One line of a log; whatever is wrong with it comes back as `Rejected`."""
    text = line.strip()
    parts = LINE.fullmatch(text) if len(text) <= LONGEST else None
    if parts is None:
        return Rejected(_without_instant(text), text)
    seconds, fraction, interface, body = parts.groups()
    if int(seconds) >= LATEST_S:
        return Rejected("its stamp is beyond the year 2262", text)
    stamp_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    frame, view = FRAME.fullmatch(body), VIEW.fullmatch(body)
    if frame is not None:
        found = _logged(*frame.groups())
    elif view is not None:
        found = _viewed(*view.groups())
    else:
        found = "identifier is not 3 or 8 hexadecimal digits"
    if isinstance(found, str):
        return Rejected(found, text)
    return CanFrame(stamp_ns, interface, *found)


def _without_instant(text: str) -> str:
    if len(text) > LONGEST:
        return NO_LINE
    if DATE.match(text):
        return LOCAL_DATE
    return NO_STAMP if UNSTAMPED.fullmatch(text) else NO_LINE


_Found = tuple[int, int, bytes, int]
"""Identifier, flags, data, nibble."""


def _identifier(digits: str) -> tuple[int, int] | str:
    """Identifier and flags of its digits, or what is wrong with them."""
    id_, flags = int(digits, 16), 0
    if len(digits) == 8:
        if id_ & EXTENDED_BIT and not id_ & ERROR_BIT:
            id_ ^= EXTENDED_BIT  # as the kernel and a DBC mark it
        flags = ERROR if id_ & ERROR_BIT else EXTENDED
        if id_ > ERROR_BIT | ID_MASK:
            return "identifier has more than 29 bits"
        id_ &= ID_MASK
    elif id_ > STANDARD_MASK:
        return "identifier has more than 11 bits"
    return id_, flags


def _logged(digits: str, separator: str, payload: str) -> _Found | str:
    """A frame as `candump -L` writes it, or what is wrong with it."""
    identifier = _identifier(digits)
    if isinstance(identifier, str):
        return identifier
    id_, flags = identifier
    if separator == "#" and payload[:1] in ("R", "r"):
        length = payload[1:] or "0"
        if len(length) > 1 or not "0" <= length <= "8":
            return "length of a remote frame is not 0 to 8"
        return id_, flags | REMOTE, b"", int(length)
    nibble = 0
    if separator == "##":
        flags |= FD
        if not payload or payload[0] not in "0123456789abcdefABCDEF":
            return "CAN FD frame without its digit of flags"
        nibble, payload = int(payload[0], 16), payload[1:]
    data = _octets(RAW_LENGTH.sub("", payload).replace(".", ""), bool(flags & FD))
    return data if isinstance(data, str) else (id_, flags, data, nibble)


def _viewed(digits: str, length: str | None, code: str | None, rest: str) -> _Found | str:
    """A frame as candump shows it, or what is wrong with it."""
    identifier, shown = _identifier(digits), VIEW_DATA.fullmatch(rest)
    if isinstance(identifier, str):
        return identifier
    if shown is None:
        return "data is not pairs of hexadecimal digits"
    id_, flags = identifier
    size = int(length) if length is not None else min(int(code or "0", 16), CLASSIC_LENGTH)
    if shown[1].startswith("remote"):
        if size > CLASSIC_LENGTH:
            return "length of a remote frame is not 0 to 8"
        return id_, flags | REMOTE, b"", size
    if bool(shown[2]) != bool(flags & ERROR):
        return "ERRORFRAME and identifier do not agree"
    if length is not None and len(length) == 2:
        flags |= FD
    data = _octets("".join(shown[1].split()), bool(flags & FD))
    if isinstance(data, str):
        return data
    return (id_, flags, data, 0) if len(data) == size else "length and data do not agree"


def _octets(digits: str, fd: bool) -> bytes | str:
    """Data of their digits, or what is wrong with them."""
    try:
        data = bytes.fromhex(digits)
    except ValueError:
        return "data is not pairs of hexadecimal digits"
    if len(data) not in DATA_LENGTHS or (len(data) > CLASSIC_LENGTH and not fd):
        return "no frame has this many bytes"
    return data


def format_line(frame: CanFrame) -> str:
    """The line of a frame, with microseconds unless the stamp has more."""
    seconds, fraction_ns = divmod(frame.stamp_ns, 1_000_000_000)
    fraction = f"{fraction_ns:09d}"
    fraction = fraction[:6] if fraction.endswith("000") else fraction
    id_ = f"{frame.id:03X}"
    if frame.flags & ERROR:
        id_ = f"{frame.id | ERROR_BIT:08X}"
    elif frame.flags & EXTENDED:
        id_ = f"{frame.id:08X}"
    if frame.flags & REMOTE:
        body = f"#R{frame.nibble or ''}"
    elif frame.flags & FD:
        body = f"##{frame.nibble:X}{frame.data.hex().upper()}"
    else:
        body = f"#{frame.data.hex().upper()}"
    return f"({seconds}.{fraction}) {frame.interface} {id_}{body}"
