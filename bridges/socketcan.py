"""What Linux' raw CAN sockets hand over: frames, kernel stamps, losses (linux/can.h, can/raw.h)."""

from __future__ import annotations

import socket
import struct

from tramstream.bridges.canframe import ERROR, EXTENDED, FD, ID_MASK, REMOTE, Content

# Not in Python's socket module (include/uapi/asm-generic/socket.h, linux/if.h).
SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
IFF_UP = 1

BUFFER_BYTES = 8 << 20
"""The default loses frames beyond 278 without a word; this holds some ten thousand."""
FD_SIZE = 72
_HEAD = struct.Struct("=IB3x")
_EXTENDED_BIT, _REMOTE_BIT, _ERROR_BIT = 0x80000000, 0x40000000, 0x20000000
_TIMESPEC = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
ANCILLARY_SIZE = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)


def prepare(can_socket: socket.socket) -> None:
    """Ask for a long queue, for its losses and for the kernel's stamps."""
    try:  # beyond the system's limit, for whoever may
        can_socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER_BYTES)
    except PermissionError:
        can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    can_socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    can_socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def from_struct(octets: bytes) -> Content:
    """Frame of a `struct can_frame` (16 bytes) or `canfd_frame` (72)."""
    word, length = _HEAD.unpack_from(octets)
    flags = FD if len(octets) == FD_SIZE else 0
    if word & _ERROR_BIT:
        return Content(word & ID_MASK, flags | ERROR, octets[8 : 8 + length])
    if word & _EXTENDED_BIT:
        flags |= EXTENDED
    if word & _REMOTE_BIT:
        return Content(word & ID_MASK, flags | REMOTE, b"")
    return Content(word & ID_MASK, flags, octets[8 : 8 + length])


def read_ancillary(items: list[tuple[int, int, bytes]], dropped: int) -> tuple[float, int]:
    """Kernel's stamp of a frame, and how many the socket had lost before it.

    The kernel leaves the count out while it is zero; `dropped` is the last one seen.
    """
    stamped_s = 0.0
    for level, kind, data in items:
        if level != socket.SOL_SOCKET:
            continue
        if kind == SO_TIMESTAMPNS and len(data) >= _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack_from(data)
            stamped_s = seconds + nanoseconds * 1e-9
        elif kind == SO_RXQ_OVFL:
            dropped = _COUNT.unpack_from(data)[0]
    return stamped_s, dropped
