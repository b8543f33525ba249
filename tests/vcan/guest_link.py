"""Links that go down, vanish and come back; see `guest_bus`."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from guest_bus import (
    DEADLINE_S,
    EXTENDED_BIT,
    GUEST_ONLY,
    REMOTE_BIT,
    Sender,
    can_port,
    drain,
    losses,
    make_vcan,
    numbers,
    remove,
    sh,
    wait_for,
)

from tramstream.bridges.odometer import socketcan
from tramstream.bridges.odometer.frames import EXTENDED, REMOTE, Content
from tramstream.bridges.ports import CanPort
from tramstream.errors import DeviceError
from tramstream.live.ports import PortReader
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import CanFrames

pytestmark = GUEST_ONLY


# The link -----------------------------------------------------------------------------------------
def test_link_down_loses_no_frame_that_had_come(port: CanPort, sender: Sender) -> None:
    for number in range(10):
        sender.send(number)
    sh("ip link set vcan0 down")
    message = port.read()
    assert message is not None
    assert list(message.id) == list(range(10))
    with pytest.raises(DeviceError, match=r"vcan0: the CAN interface is lost .*Network is down"):
        port.read()
    port.close()
    with pytest.raises(DeviceError, match="vcan0: the interface is down"):
        port.open()


def test_losses_before_the_link_goes_down_are_counted(port: CanPort, sender: Sender) -> None:
    sender.flood(30_000)
    sh("ip link set vcan0 down")
    found: list[Content] = []
    with pytest.raises(DeviceError, match="lost"):
        drain(port, found)
    assert len(numbers(found)) + losses(found) == 30_000


def test_link_that_was_down_for_a_moment_only_is_opened_again(
    port: CanPort, sender: Sender
) -> None:
    sh("ip link set vcan0 down")
    sh("ip link set vcan0 up")
    with pytest.raises(DeviceError, match="lost"):
        port.read()
    port.open()
    again = Sender()  # the other one has the kernel's word still to read
    again.send(5)
    assert drain(port) == [Content(5, 0, b"")]
    again.socket.close()


@pytest.mark.parametrize("channel", ["vcan0", "can0"])
def test_command_that_a_closed_interface_is_told_to_open_with_opens_it(
    vcan: None, channel: str
) -> None:
    sh(f"ip link set {channel} down")
    port = can_port(channel)
    with pytest.raises(DeviceError, match=f"{channel}: the interface is down; sudo ip") as caught:
        port.open()
    sh(str(caught.value).partition("sudo ")[2])
    port.open()
    port.close()
    sh(f"ip link set {channel} down")


def test_interface_that_is_absent_or_no_can_is_named_with_its_cure() -> None:
    with pytest.raises(DeviceError, match=r"can7: there is no such network interface; .*ip link"):
        can_port("can7").open()
    with pytest.raises(DeviceError, match=r"lo: is no CAN interface; .*\$\.odometer\.channel"):
        can_port("lo").open()


def test_interface_that_was_deleted_is_noticed_at_once(port: CanPort, sender: Sender) -> None:
    sender.send(1)
    remove("vcan0")
    found: list[Content] = []
    with pytest.raises(DeviceError, match="lost"):
        drain(port, found)
    assert [frame.id for frame in found] == [1]
    with pytest.raises(DeviceError, match="no such network interface"):
        port.open()
    make_vcan()
    port.open()
    again = Sender()
    again.send(2)
    assert drain(port) == [Content(2, 0, b"")]
    again.socket.close()


def test_interface_made_anew_is_noticed_by_silence_if_by_nothing_else(vcan: None) -> None:
    """Should the kernel's word be lost (somebody read SO_ERROR), the watchdog still sees it."""
    port = can_port(silence_s=1.0)
    opening_s = time.monotonic()
    port.open()
    remove("vcan0")
    make_vcan()
    assert port._bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0
    with pytest.raises(DeviceError, match="made anew"):
        [port.read() for _ in range(100)]
    assert time.monotonic() - opening_s > 1.0  # not before the silence was as long as was asked for
    port.close()


# The thread that keeps it open --------------------------------------------------------------------
class Reading:
    """A `PortReader` on `vcan0` and what it delivered."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.stop = threading.Event()
        self.reader = PortReader(can_port(silence_s=1.0), self.messages.append, self.stop)
        self.reader.start()

    def ids(self) -> list[int]:
        assert not [message for message in self.messages if not isinstance(message, CanFrames)]
        return [id_ for message in self.messages for id_ in message.id]

    def is_open(self) -> bool:
        return self.reader.health()[0] == DeviceHealth.OPEN

    def is_lost(self) -> bool:
        return self.reader.health()[0] == DeviceHealth.LOST


@pytest.fixture
def reading(vcan: None) -> Iterator[Reading]:
    made = Reading()
    yield made
    made.stop.set()
    made.reader.join(DEADLINE_S)


def test_reader_comes_back_with_its_interface(reading: Reading) -> None:
    """Down and up, deleted and made anew, deleted and made anew within a moment."""
    wait_for("open", reading.is_open)
    Sender().send(1)
    wait_for("the first frame", lambda: reading.ids() == [1])

    sh("ip link set vcan0 down")
    wait_for("noticed that it is down", reading.is_lost)
    wait_for("says so", lambda: "interface is down" in str(reading.reader.health()[1]))
    sh("ip link set vcan0 up")
    took_s = wait_for("open again", reading.is_open)
    Sender().send(2)
    wait_for("a frame after down and up", lambda: reading.ids() == [1, 2])
    print(f"\nopen {took_s:.1f} s after the link was up", end="")

    remove("vcan0")
    wait_for("noticed that it is gone", lambda: "no such" in str(reading.reader.health()[1]))
    make_vcan()
    took_s = wait_for("open again", reading.is_open)
    Sender().send(3)
    wait_for("a frame of the new interface", lambda: reading.ids() == [1, 2, 3])
    print(f", {took_s:.1f} s after it was made anew", end="")

    opened = reading.reader.opened
    remove("vcan0")
    make_vcan()
    took_s = wait_for("opened once more", lambda: reading.reader.opened > opened)
    wait_for("open", reading.is_open)
    Sender().send(4)
    wait_for("a frame of the third interface", lambda: reading.ids() == [1, 2, 3, 4])
    print(f", {took_s:.1f} s after it was replaced at one blow")


# Controllers --------------------------------------------------------------------------------------
def test_frames_of_a_controller_come_over_the_wire(wire: None) -> None:
    port = can_port("can0")
    port.open()
    other = Sender("can1")
    for number in range(5):
        other.send(0x1000 + number | EXTENDED_BIT, bytes([number]))
        time.sleep(0.01)  # its queue has ten places
    other.send(0x44 | REMOTE_BIT)
    time.sleep(0.05)
    info = port._bus.socket.getsockopt(socket.SOL_SOCKET, socketcan.SO_MEMINFO, 36)
    print(f"\nsix frames of a controller take {struct.unpack('=9I', info)[0]} bytes of the queue")
    found = drain(port)
    assert found[:5] == [Content(0x1000 + n, EXTENDED, bytes([n])) for n in range(5)]
    assert found[5:] == [Content(0x44, REMOTE, b"")]
    sh("ip link set can0 down")
    with pytest.raises(DeviceError, match="Network is down"):
        drain(port)
    port.close()
