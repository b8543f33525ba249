"""CAN frames as values, and what error frames mean.

Flags are those of the `CanFrames` message. Error frames carry their classes in the identifier and
details in the data, as Linux reports them (include/uapi/linux/can/error.h).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from tramstream.proto.raw_pb2 import CanFlag, CanFrames

EXTENDED = CanFlag.CAN_FLAG_EXTENDED
ERROR = CanFlag.CAN_FLAG_ERROR
REMOTE = CanFlag.CAN_FLAG_REMOTE
FD = CanFlag.CAN_FLAG_FD

ID_MASK = 0x1FFFFFFF
STANDARD_MASK = 0x7FF
DATA_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""What a frame can carry; beyond 8 bytes CAN FD only."""
CLASSIC_LENGTH = 8

HOST_OVERFLOW = 0x10000000
"""Our own error class, above Linux' (which end at bit 9): frames were lost here because this host
did not read in time; the data is how many, 8 bytes, big-endian. So the loss is in the record, at
its place in the stream, and a replay counts it too."""
GARBLED = 0x08000000
"""Our own error class: an adapter's line that is no frame; the data is how it begins."""

CONTROLLER = 0x004
CONTROLLER_DETAILS = (
    (0x30, "error passive"),
    (0x03, "controller overflow"),
    (0x0C, "error warning"),
    (0x40, "error active again"),
)
"""Bits of data[1] under `CONTROLLER`, worst first."""
ERROR_CLASSES = (
    (HOST_OVERFLOW, "host overflow"),
    (GARBLED, "garbled line"),
    (0x040, "bus-off"),
    (CONTROLLER, "controller"),
    (0x020, "no acknowledge"),
    (0x010, "transceiver"),
    (0x008, "protocol violation"),
    (0x002, "lost arbitration"),
    (0x001, "transmit timeout"),
    (0x080, "bus error"),
    (0x100, "controller restarted"),
    (0x200, "error counters"),
)
"""Worst first: a frame with several classes is counted once, under the first."""


class CanFrame(NamedTuple):
    """One frame with its arrival."""

    stamp_ns: int
    interface: str
    id: int
    flags: int
    data: bytes
    nibble: int = 0
    """FD: bit rate switch and error state. Remote: length that is asked for."""


class Rejected(NamedTuple):
    """Text that is not a frame."""

    reason: str
    text: str


def classify_error(id_: int, data: bytes) -> str:
    """Worst thing that an error frame reports, in words."""
    for bit, name in ERROR_CLASSES:
        if id_ & bit:
            if bit == CONTROLLER:
                return _controller_detail(data)
            return name
    return "unknown error"


def _controller_detail(data: bytes) -> str:
    status = data[1] if len(data) > 1 else 0
    for bits, name in CONTROLLER_DETAILS:
        if status & bits:
            return name
    return "controller"


def host_overflow(stamp_ns: int, interface: str, lost: int) -> CanFrame:
    """Error frame by which a port says that `lost` frames are missing here."""
    return CanFrame(stamp_ns, interface, HOST_OVERFLOW, ERROR, lost.to_bytes(8, "big"))


class Content(NamedTuple):
    """A frame without its arrival."""

    id: int
    flags: int
    data: bytes


class SlcanLines:
    """Host's side of slcan (LAWICEL CAN232 manual): an adapter's bytes to frames.

    Lines end in a carriage return, a line feed or both, as firmware on Arduino's `println` sends
    them. `d`, `D`, `b` and `B` are frames of CAN FD, without and with a faster data phase
    (CANable's dialect). An adapter's own stamp behind the data, of 4 digits (milliseconds) or 8
    (microseconds), is read over. Answers to commands are passed over, also when they end in a bell.
    A line that is no frame comes back as an error frame of class `GARBLED`. Equal results for any
    split.
    """

    LONGEST = 160
    """A frame of 29 bits with 64 bytes and a stamp of 8 digits has 146 characters."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Content]:
        *lines, rest = (self._rest + data.translate(_ENDS)).split(b"\r")
        frames = [_slcan_frame(line) for line in lines if line[:1] not in _ANSWERS]
        if len(rest) > self.LONGEST:
            rest = b"?" + rest[-1:]  # no end in sight: garbled, whatever follows until the next end
        self._rest = rest
        return frames


_ENDS = bytes.maketrans(b"\a\n", b"\r\r")
_HEX = re.compile(rb"[0-9A-Fa-f]+")
_ANSWERS = (b"", b"z", b"Z", b"V", b"v", b"N", b"F")
_SLCAN_FLAGS = {
    b"t": 0, b"T": EXTENDED, b"r": REMOTE, b"R": REMOTE | EXTENDED,
    b"d": FD, b"D": FD | EXTENDED, b"b": FD, b"B": FD | EXTENDED,
}  # fmt: skip
_STAMP_DIGITS = (0, 4, 8)


def _slcan_frame(line: bytes) -> Content:
    flags = _SLCAN_FLAGS.get(line[:1], ERROR)
    digits = 8 if flags & EXTENDED else 3
    if not flags & ERROR and _HEX.fullmatch(line, 1) and len(line) >= 2 + digits:
        id_, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits], 16)
        payload = line[2 + digits :]
        wanted = 0 if flags & REMOTE else 2 * DATA_LENGTHS[length]
        bits = ID_MASK if flags & EXTENDED else STANDARD_MASK
        known = id_ <= bits and (length <= CLASSIC_LENGTH or flags & FD)
        if known and len(payload) - wanted in _STAMP_DIGITS:
            return Content(id_, flags, bytes.fromhex(payload[:wanted].decode("ascii")))
    return Content(GARBLED, ERROR, line[:8])


def pack(frames: Iterable[CanFrame], device: str, *, read_stamps: bool = False) -> CanFrames:
    """One message of frames in the order of arrival; there must be one at least.

    Offsets cannot be negative: a stamp before its predecessor's (the host's clock was set while the
    frame waited) becomes the predecessor's. `read_stamps` says that the stamps are of the reading.
    """
    message = CanFrames(device=device, read_stamps=read_stamps)
    first_ns = latest_ns = -1
    for frame in frames:
        if first_ns < 0:
            first_ns = frame.stamp_ns
        latest_ns = max(latest_ns, frame.stamp_ns)
        message.offset_ns.append(latest_ns - first_ns)
        message.id.append(frame.id)
        message.flags.append(frame.flags)
        message.data.append(frame.data)
    message.stamp_ns = first_ns
    return message
