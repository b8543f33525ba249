"""What Linux' raw CAN sockets hand over: frames, kernel stamps, losses (linux/can.h, can/raw.h).

What is said here of the kernel was seen on one: `tests/vcan`, docs/can.md.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path

from tramstream.bridges.odometer.frames import ERROR, EXTENDED, FD, ID_MASK, REMOTE, Content
from tramstream.errors import DeviceError

# Not in Python's socket module (include/uapi/asm-generic/socket.h, linux/if.h).
SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
SO_MEMINFO = 55
IFF_UP = 1
CAN_TYPE = "280"
"""ARPHRD_CAN (linux/if_arp.h), as sysfs writes it."""
INTERFACES = Path("/sys/class/net")

BUFFER_BYTES = 8 << 20
"""The default loses frames beyond 278 without a word; this holds 21 846: the kernel doubles what it
is asked for."""
FRAME_COST_BYTES = 768
"""What the kernel reckons for a frame in the queue, classic or FD (Linux 6.1, 64 bit)."""
FD_SIZE = 72
_HEAD = struct.Struct("=IB3x")
_EXTENDED_BIT, _REMOTE_BIT, _ERROR_BIT = 0x80000000, 0x40000000, 0x20000000
_TIMESPEC = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
_MEMINFO = struct.Struct("@9I")
_STAMP_SLACK_S = 1e-3
"""How far the readings of two clocks may lie apart."""
ANCILLARY_SIZE = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)


def prepare(can_socket: socket.socket) -> None:
    """Ask for a long queue, for its losses and for the kernel's stamps."""
    try:  # beyond the system's limit, for whoever may
        can_socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER_BYTES)
    except PermissionError:
        can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    can_socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    can_socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def granted_bytes() -> int:
    """Length of queue that this process is granted, as `BUFFER_BYTES` counts it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
        prepare(any_socket)
        return any_socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def interface_index(name: str, bitrate: int) -> int:
    """Index of a CAN interface, which has to be there and up.

    Raises
    ------
    DeviceError
        One sentence with the interface and the cure.
    """
    folder = INTERFACES / name
    try:
        index = socket.if_nametoindex(name)
        is_up = is_interface_up(folder)
        is_can = not is_up or (folder / "type").read_text().strip() == CAN_TYPE
    except OSError as error:
        raise DeviceError(
            f"{name}: there is no such network interface",
            cure="plug the adapter in, load its driver, or "
            "correct $.odometer.channel (ip link shows what there is)",
        ) from error
    if not is_up:
        # Virtual ones (vcan, vxcan) have no bit rate and refuse the whole command that sets one.
        virtual = "/devices/virtual/" in str(folder.resolve())
        rate = "" if virtual else f" type can bitrate {bitrate} restart-ms 100"
        raise DeviceError(
            f"{name}: the interface is down", cure=f"sudo ip link set {name} up{rate}"
        )
    if not is_can:
        raise DeviceError(
            f"{name}: is no CAN interface",
            cure="correct $.odometer.channel (ip link show type can shows what there is)",
        )
    return index


def is_interface_up(folder: Path) -> bool:
    """Whether the interface of a folder of `INTERFACES` is up.

    `operstate` would not do: of virtual interfaces it says "unknown".
    """
    return bool(int((folder / "flags").read_text(), 16) & IFF_UP)


def drop_count(can_socket: socket.socket) -> int:
    """How many frames the socket has lost so far, also those after the last one in its queue.

    Zero where the kernel does not tell (before 4.12).
    """
    try:
        info = can_socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size)
    except OSError:
        return 0
    drops: int = _MEMINFO.unpack(info)[-1]
    return drops


class Arrivals:
    """Ages of frames that the kernel stamped with the host's wall clock.

    The wall clock may be set at any moment, and frames may have waited for long. A frame came after
    the queue was last seen empty and before now: of the clock as it is set now and as it was set
    then, the one counts by which that holds. By neither: it came just now.
    """

    def __init__(
        self,
        wall_s: Callable[[], float] = time.time,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._wall_s = wall_s
        self._monotonic_s = monotonic_s
        self._offset_s = self._earlier_offset_s = 0.0  # wall minus monotonic
        self.look()
        self.empty_since(monotonic_s())

    def look(self) -> None:
        """Compare the two clocks; to be done before frames are read."""
        brackets = []
        for _ in range(3):  # the tightest, should the process lose its turn in between
            before_s, wall_s, after_s = self._monotonic_s(), self._wall_s(), self._monotonic_s()
            brackets.append((after_s - before_s, wall_s - (before_s + after_s) / 2))
        self._offset_s = min(brackets)[1]

    def empty_since(self, monotonic_s: float) -> None:
        """Note that the queue was found empty after this instant: what it gives now came later."""
        self._earliest_s = monotonic_s
        self._earlier_offset_s = self._offset_s

    def age_s(self, stamped_s: float) -> float:
        """How long ago a frame came."""
        now_s = self._monotonic_s()
        for offset_s in (self._offset_s, self._earlier_offset_s):
            arrival_s = stamped_s - offset_s
            if self._earliest_s - _STAMP_SLACK_S <= arrival_s <= now_s + _STAMP_SLACK_S:
                self._earliest_s = max(self._earliest_s, arrival_s)
                return max(0.0, now_s - arrival_s)
        return 0.0


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
