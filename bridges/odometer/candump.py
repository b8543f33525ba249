"""Lines of `candump -L`: `(seconds) interface ID#DATA`, one frame each.

    (1436509052.249713) can0 044#2A366C2BBA        11-bit identifier: three digits
    (1436509052.249713) can0 18FF0A31#01           29-bit identifier: eight digits
    (1436509052.249713) can0 044#R8                remote frame that asks for 8 bytes
    (1436509052.249713) can0 044##1112233          CAN FD: one digit of flags, then data
    (1436509052.249713) can0 20000040#00…00        error frame: bit 29 of the identifier

A trailing `T` or `R` (candump -x) and `_x` (a raw length above 8) are read over. Format: can-utils,
lib.h, "CAN DATA formats".
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

LINE = re.compile(r"\((\d{1,12})\.(\d{1,9})\)\s+(\S{1,64})\s+(\S+)(?:\s+[RT])?", re.ASCII)
FRAME = re.compile(r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})(##?)(\S*)")
ERROR_BIT = 0x20000000
RAW_LENGTH = re.compile(r"_[0-9A-Fa-f]\Z")


def parse_line(line: str) -> CanFrame | Rejected:
    """One line of a log; whatever is wrong with it comes back as `Rejected`."""
    text = line.strip()
    parts = LINE.fullmatch(text)
    if parts is None:
        return Rejected("not a candump line", text)
    seconds, fraction, interface, body = parts.groups()
    frame = FRAME.fullmatch(body)
    if frame is None:
        return Rejected("identifier is not 3 or 8 hexadecimal digits", text)
    digits, separator, payload = frame.groups()
    id_, flags = int(digits, 16), 0
    if len(digits) == 8:
        flags = ERROR if id_ & ERROR_BIT else EXTENDED
        if id_ > ERROR_BIT | ID_MASK:
            return Rejected("identifier has more than 29 bits", text)
        id_ &= ID_MASK
    elif id_ > STANDARD_MASK:
        return Rejected("identifier has more than 11 bits", text)
    nibble, data = 0, b""
    if separator == "#" and payload[:1] in ("R", "r"):
        flags |= REMOTE
        if payload[1:]:
            if len(payload) > 2 or not "0" <= payload[1] <= "8":
                return Rejected("length of a remote frame is not 0 to 8", text)
            nibble = int(payload[1])
    else:
        if separator == "##":
            flags |= FD
            if not payload or payload[0] not in "0123456789abcdefABCDEF":
                return Rejected("CAN FD frame without its digit of flags", text)
            nibble, payload = int(payload[0], 16), payload[1:]
        try:
            data = bytes.fromhex(RAW_LENGTH.sub("", payload).replace(".", ""))
        except ValueError:
            return Rejected("data is not pairs of hexadecimal digits", text)
        if len(data) not in DATA_LENGTHS or (len(data) > CLASSIC_LENGTH and not flags & FD):
            return Rejected("no frame has this many bytes", text)
    stamp_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    return CanFrame(stamp_ns, interface, id_, flags, data, nibble)


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
