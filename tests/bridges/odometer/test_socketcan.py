"""Tests of what is asked of Linux' CAN sockets, without one; `tests/vcan` has a real kernel."""

from __future__ import annotations

import errno
import os
import socket
import struct
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from tramstream.bridges import ports
from tramstream.bridges.odometer import socketcan
from tramstream.bridges.odometer.frames import HOST_OVERFLOW
from tramstream.bridges.odometer.socketcan import Arrivals
from tramstream.bridges.ports import CanPort
from tramstream.clock import VehicleClock
from tramstream.config import Odometer, Wheel
from tramstream.errors import DeviceError

MS = 1e-3
CONFIG = Odometer(
    channel="can0", dbc="", wheels={"left": Wheel(message="M", signal="S", kind="pulses")}
)


class Clocks:
    """The host's two clocks."""

    def __init__(self) -> None:
        self.monotonic_s = 50.0
        self.offset_s = 1000.0

    def arrivals(self) -> Arrivals:
        return Arrivals(lambda: self.monotonic_s + self.offset_s, lambda: self.monotonic_s)


# ages ---------------------------------------------------------------------------------------------
def test_age_is_the_wall_clock_s_however_long_a_frame_waited() -> None:
    clocks = Clocks()
    arrivals = clocks.arrivals()
    clocks.monotonic_s += 30.0
    arrivals.look()
    ages = [arrivals.age_s(1050.0 + waited_s) for waited_s in (0.0, 1.0, 29.0, 30.0)]
    assert ages == pytest.approx([30.0, 29.0, 1.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 5.0, -5.0])
def test_clock_set_while_frames_wait_changes_no_age(step_s: float) -> None:
    clocks = Clocks()
    arrivals = clocks.arrivals()
    before_s = clocks.monotonic_s + 1.0 + clocks.offset_s
    clocks.offset_s += step_s
    after_s = clocks.monotonic_s + 2.0 + clocks.offset_s
    clocks.monotonic_s += 3.0
    arrivals.look()
    assert arrivals.age_s(before_s) == pytest.approx(2.0, abs=1e-6)
    assert arrivals.age_s(after_s) == pytest.approx(1.0, abs=1e-6)


def test_stamp_that_cannot_be_counts_as_now() -> None:
    clocks = Clocks()
    arrivals = clocks.arrivals()
    clocks.monotonic_s += 1.0
    arrivals.look()
    arrivals.empty_since(clocks.monotonic_s)
    for stamped_s in (0.0, 1050.5, 1051.0 + 2 * MS, 5e9):  # before it was empty, or yet to come
        assert arrivals.age_s(stamped_s) == 0.0
    assert arrivals.age_s(1051.0 + 0.5 * MS) == 0.0


def test_clocks_are_the_hosts_where_none_are_given() -> None:
    began_s = time.monotonic()
    age_s = Arrivals().age_s(time.time())
    assert 0.0 <= age_s <= time.monotonic() - began_s + MS


# losses and link ----------------------------------------------------------------------------------
class FakeSocket:
    """Replies in turn; the kernel's order, as `tests/vcan` saw it."""

    def __init__(self, near: socket.socket, replies: list[Any]) -> None:
        self.fileno = near.fileno
        self._replies = replies

    def recvmsg(self, *_: int) -> Any:
        reply = self._replies.pop(0) if self._replies else BlockingIOError()
        if isinstance(reply, OSError):
            raise reply
        return struct.pack("=IB3x8s", reply, 0, b""), [], 0, None


@pytest.fixture
def pair(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A port on one end of a socket pair, the other end, and the port."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    bus = SimpleNamespace(socket=near, shutdown=near.close)
    monkeypatch.setattr(can, "Bus", lambda **_: bus)
    monkeypatch.setattr(ports, "_interface_index", lambda config: 3)
    monkeypatch.setattr(ports, "WAIT_S", 0.0)
    monkeypatch.setattr(ports, "CAN_GATHER_S", 0.0)
    port = CanPort(CONFIG, VehicleClock())
    port.open()
    yield near, far, port
    port.close()
    far.close()


def test_frames_that_wait_behind_the_link_s_end_are_read_first(pair: Any) -> None:
    near, far, port = pair
    far.send(b"ready")
    port._bus.socket = FakeSocket(near, [OSError(errno.ENETDOWN, "down"), 1, 2])
    message = port.read()
    assert message is not None
    assert list(message.id) == [1, 2]
    with pytest.raises(DeviceError, match="down"):
        port.read()


def test_complaint_that_never_ends_ends_the_reading(pair: Any) -> None:
    near, far, port = pair
    far.send(b"ready")
    complaints = [OSError(errno.EBADF, "broken") for _ in range(2 * ports.FRAME_LIMIT)]
    port._bus.socket = FakeSocket(near, [1, *complaints])
    message = port.read()
    assert message is not None
    assert list(message.id) == [1]
    with pytest.raises(DeviceError, match="broken"):
        port.read()


def test_losses_after_the_last_frame_are_told_once(
    pair: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, port = pair
    counts = iter([7, 7, 2**32 - 1, 2])
    monkeypatch.setattr(port, "_count_drops", lambda: next(counts))
    message = port.read()
    assert message is not None
    assert list(message.id) == [HOST_OVERFLOW]
    assert int.from_bytes(message.data[0], "big") == 7
    assert port.read() is None
    assert port.read() is None  # fewer than before: not the socket's word
    port._dropped = 2**32 - 1
    wrapped = port.read()
    assert wrapped is not None
    assert int.from_bytes(wrapped.data[0], "big") == 3


def test_sockets_tell_their_losses_and_the_queue_they_were_granted() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
        assert socketcan.drop_count(any_socket) == 0
    with OldKernel(socket.AF_UNIX) as old:
        assert socketcan.drop_count(old) == 0
    limit = int(Path("/proc/sys/net/core/rmem_max").read_text())
    granted = (socketcan.BUFFER_BYTES, min(limit, socketcan.BUFFER_BYTES))
    assert socketcan.granted_bytes() in granted


class OldKernel(socket.socket):
    """A socket that knows nothing of its memory."""

    def getsockopt(self, *_: Any) -> Any:
        raise OSError(errno.ENOPROTOOPT, os.strerror(errno.ENOPROTOOPT))


# the interface ------------------------------------------------------------------------------------
@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sysfs' folder of an interface, which is up and on CAN."""
    made = tmp_path / "devices" / "virtual" / "net" / "vcan0"
    made.mkdir(parents=True)
    (made / "flags").write_text("0x1\n")
    (made / "type").write_text("280\n")
    for name in ("vcan0", "can0"):
        (tmp_path / name).symlink_to(made)
    monkeypatch.setattr(socketcan, "INTERFACES", tmp_path)
    monkeypatch.setattr(socket, "if_nametoindex", lambda name: 3)
    return made


def test_interface_has_to_be_up_and_on_can(folder: Path) -> None:
    assert socketcan.interface_index("vcan0", 500_000) == 3
    assert socketcan.is_interface_up(folder)
    (folder / "type").write_text("1\n")
    with pytest.raises(DeviceError, match="vcan0: is no CAN interface"):
        socketcan.interface_index("vcan0", 500_000)


def test_virtual_interface_that_is_down_is_not_given_a_bit_rate(
    folder: Path, tmp_path: Path
) -> None:
    (folder / "flags").write_text("0x40080\n")
    with pytest.raises(DeviceError, match=r"sudo ip link set vcan0 up$"):
        socketcan.interface_index("vcan0", 500_000)
    real = tmp_path / "devices" / "pci" / "can0"
    real.parent.mkdir()
    folder.rename(real)
    (tmp_path / "can0").unlink()
    (tmp_path / "can0").symlink_to(real)
    with pytest.raises(DeviceError, match=r"set can0 up type can bitrate 250000 restart-ms 100$"):
        socketcan.interface_index("can0", 250_000)
