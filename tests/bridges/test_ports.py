"""Ports: pseudo terminals for serial lines, python-can's own buses and a socket pair for CAN."""

from __future__ import annotations

import errno
import os
import socket
import struct
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import can
import live
import pytest
import serial

from tramstream import keys
from tramstream.bridges import ports, serial_lines
from tramstream.bridges.odometer import socketcan
from tramstream.bridges.odometer.frames import ERROR, EXTENDED, FD, HOST_OVERFLOW, REMOTE, Content
from tramstream.bridges.odometer.slcan import SlcanAdapter
from tramstream.bridges.ports import CanPort, SerialPort, gnss_port, imu_port, odometer_port
from tramstream.clock import VehicleClock
from tramstream.config import Gnss, Imu, Odometer, Vehicle, Wheel
from tramstream.errors import ConfigError, DeviceError
from tramstream.live.ports import PortReader
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import CanFrames, RawBytes

CLOCK = VehicleClock(offset_ns=10**18)
WHEELS = {"left": Wheel(message="M", signal="S", kind="pulses")}
T = TypeVar("T")


class Pty:
    """A device on a pseudo terminal that appears at `link`."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = -1

    def plug(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            self.master = -1
            self.link.unlink()

    def send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.master, data[:2000]) :]


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    device = Pty(tmp_path / "device")
    device.plug()
    yield device
    device.unplug()


def serial_port(path: Path | str) -> SerialPort:
    return SerialPort(keys.IMU_BYTES, str(path), 2_000_000, CLOCK)


def can_port(interface: str, channel: object, **changes: Any) -> CanPort:
    config = Odometer(interface=interface, channel=str(channel), dbc="", wheels=WHEELS, **changes)
    return CanPort(config, CLOCK)


def until(read: Callable[[], T | None], enough: Callable[[list[T]], bool]) -> list[T]:
    """Messages read until they are enough."""
    messages: list[T] = []

    def got() -> bool:
        if not enough(messages) and (message := read()) is not None:
            messages.append(message)
        return enough(messages)

    live.until(got, "messages from the port", lambda: messages)
    return messages


def contents(messages: list[CanFrames]) -> list[Content]:
    return [
        Content(*columns)
        for message in messages
        for columns in zip(message.id, message.flags, message.data, strict=True)
    ]


# serial lines -------------------------------------------------------------------------------------


@pytest.mark.live
def test_serial_port_reads_every_byte_with_its_arrival(pty: Pty) -> None:
    port = serial_port(pty.link)
    port.open()
    assert port.read() is None
    data, read = os.urandom(10_000), b""
    stamps = []
    for start in range(0, len(data), 2_500):
        before_ns = CLOCK.now_ns()
        part = data[start : start + 2_500]
        pty.send(part)
        messages = until(port.read, partial(complete, len(part)))
        read += b"".join(message.data for message in messages)
        stamps += [before_ns, *(message.stamp_ns for message in messages), CLOCK.now_ns()]
        assert {message.device for message in messages} == {str(pty.link)}
    assert read == data
    assert stamps == sorted(stamps)
    port.close()
    port.close()


def complete(size: int, messages: list[RawBytes]) -> bool:
    return sum(len(message.data) for message in messages) >= size


@pytest.mark.live
def test_unplugged_line_is_a_device_error_and_reopens_when_it_is_back(pty: Pty) -> None:
    port = serial_port(pty.link)
    for word in (b"first", b"second"):
        port.open()
        pty.send(word)
        assert until(port.read, bool)[0].data == word
        pty.unplug()
        with pytest.raises(DeviceError, match="unplugged or hung up"):
            until(port.read, lambda got: False)
        with pytest.raises(DeviceError, match=r"no such device; .*\$\.imu\.device"):
            port.open()
        port.close()
        pty.plug()


@pytest.mark.live
def test_line_in_use_is_a_device_error_that_says_so(pty: Pty) -> None:
    first, second = serial_port(pty.link), serial_port(pty.link)
    first.open()
    with pytest.raises(DeviceError, match="another program uses it"):
        second.open()
    first.close()
    second.open()
    second.close()


def test_absent_line_names_path_field_and_cure(tmp_path: Path) -> None:
    port = SerialPort(keys.GNSS_BYTES, str(tmp_path / "ttyACM9"), 460_800, CLOCK)
    with pytest.raises(DeviceError) as caught:
        port.open()
    assert "ttyACM9: there is no such device; plug it in or correct $.gnss.device" in str(
        caught.value
    )
    port.close()


def test_line_without_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError, match=r"/dev/ttyACM0: no permission; .*group dialout"):
        serial_port("/dev/ttyACM0").open()


def test_file_that_is_no_line_is_a_device_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot be set up as a serial line"):
        serial_port(tmp_path / "file").open()


def test_reading_what_was_not_opened_is_a_device_error() -> None:
    for port in (serial_port("/dev/ttyACM0"), can_port("virtual", "x")):
        with pytest.raises(DeviceError, match="before it was opened"):
            port.read()
        port.close()


@pytest.fixture
def links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of udev's links that stay the same."""
    folder = tmp_path / "by-id"
    folder.mkdir()
    monkeypatch.setattr(serial_lines, "LINKS", (folder, tmp_path / "by-path"))
    return folder


@pytest.mark.live
def test_device_that_comes_back_under_another_name_is_found(tmp_path: Path, links: Path) -> None:
    device, other = Pty(tmp_path / "ttyACM0"), Pty(tmp_path / "ttyACM0")
    device.plug()
    (links / "usb-maker-7").symlink_to(os.readlink(device.link))
    port = serial_port(device.link)
    port.open()
    assert port.place == str(device.link)
    device.unplug()
    (links / "usb-maker-7").unlink()
    with pytest.raises(DeviceError):
        until(port.read, lambda got: False)
    other.plug()  # another device takes its name
    device.link = tmp_path / "ttyACM1"
    device.plug()
    (links / "usb-maker-7").symlink_to(os.readlink(device.link))
    (links / "usb-stranger-1").symlink_to(os.readlink(other.link))
    port.open()
    device.send(b"here")
    other.send(b"there")
    assert until(port.read, bool)[0].data == b"here"
    assert os.path.realpath(port.place) == os.path.realpath(device.link)
    port.close()
    device.unplug()
    other.unplug()


@pytest.mark.live
def test_twins_without_a_serial_number_are_told_apart_by_their_sockets(
    tmp_path: Path, links: Path
) -> None:
    """Both have one name by-id, which points to whichever was plugged in last."""
    sockets = tmp_path / "by-path"
    sockets.mkdir()
    first, second = Pty(tmp_path / "ttyACM0"), Pty(tmp_path / "ttyACM1")
    first.plug()
    (links / "usb-twin").symlink_to(os.readlink(first.link))
    (sockets / "usb-1").symlink_to(os.readlink(first.link))
    port = serial_port(first.link)
    port.open()
    first.unplug()
    second.plug()
    (links / "usb-twin").unlink()
    (links / "usb-twin").symlink_to(os.readlink(second.link))
    first.plug()
    (sockets / "usb-1").unlink()
    (sockets / "usb-1").symlink_to(os.readlink(first.link))
    port.open()
    assert port.place == str(first.link)
    port.close()
    first.unplug()
    second.unplug()


@pytest.mark.live
def test_spare_device_under_the_configured_name_is_taken(tmp_path: Path, links: Path) -> None:
    device = Pty(tmp_path / "ttyACM0")
    port = serial_port(device.link)
    for serial_number in "12":
        device.plug()
        link = links / f"usb-maker-{serial_number}"
        link.symlink_to(os.readlink(device.link))
        port.open()
        device.send(b"x")
        assert until(port.read, bool)[0].data == b"x"
        assert port.place == str(device.link)
        device.unplug()
        link.unlink()
        port.close()


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EIO, "Input/output error"),
        serial.SerialException(errno.EIO, "could not open port"),
        termios.error(errno.EIO, "Input/output error"),
        serial.SerialException("Could not configure port: (5, 'Input/output error')"),
    ],
    ids=["OSError", "pyserial", "termios", "without a number"],
)
def test_device_that_is_just_going_or_coming_is_a_device_error(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError, match=r"/dev/ttyACM0: it (does not answer; .*cable|cannot)"):
        serial_port("/dev/ttyACM0").open()


@pytest.mark.live
@pytest.mark.parametrize("failing", [OSError(errno.EIO, "gone"), OSError(errno.ENODEV, "gone")])
def test_read_that_fails_is_a_device_error_and_the_line_opens_again(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, failing: OSError
) -> None:
    port = serial_port(pty.link)
    port.open()
    pty.send(b"x")

    def fail(*_: object) -> bytes:
        raise failing

    with monkeypatch.context() as patch:
        patch.setattr(os, "read", fail)
        with pytest.raises(DeviceError, match="unplugged or hung up"):
            until(port.read, lambda got: False)
    port.open()
    pty.send(b"again")
    assert b"again" in b"".join(each.data for each in until(port.read, bool))
    port.close()


@pytest.mark.live
@pytest.mark.parametrize("when", ["before", "after", "while it opens"])
def test_device_is_read_whenever_it_is_there(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """Before its node, after it, or with its name there before it answers."""
    got: list[RawBytes] = []
    stop = threading.Event()
    reader = PortReader(serial_port(pty.link), got.append, stop)
    if when == "after":
        pty.unplug()
    elif when == "while it opens":
        refusals = iter([errno.EIO, errno.EACCES, errno.ENXIO])
        opening = serial.Serial

        def coming(*settings: Any, **more: Any) -> Any:
            number = next(refusals, None)
            if number is not None:
                raise serial.SerialException(number, "it is just coming")
            return opening(*settings, **more)

        monkeypatch.setattr(serial, "Serial", coming)
    reader.start()
    if when == "after":
        live.until(lambda: reader.trouble is not None and "no such" in str(reader.trouble), "away")
        pty.plug()
    live.until(lambda: reader.opened == 1, "the device is open")
    pty.send(b"here")
    live.until(lambda: b"".join(each.data for each in got) == b"here", "its bytes")
    assert reader.health() == (DeviceHealth.OPEN, None)
    stop.set()
    reader.join(5.0)


# CAN over python-can ------------------------------------------------------------------------------


@pytest.fixture
def bus() -> Iterator[Any]:
    with can.Bus(interface="virtual", channel="test_ports") as sender:
        yield sender


@pytest.mark.live
def test_frames_of_any_interface_come_with_flags_and_arrivals(bus: Any) -> None:
    port = can_port("virtual", "test_ports")
    port.open()
    assert port.read() is None
    before_ns = CLOCK.now_ns()
    bus.send(can.Message(arbitration_id=0xAA, data=b"\x01\x02", is_extended_id=False))
    bus.send(can.Message(arbitration_id=0x18FF0A31, data=b""))
    bus.send(can.Message(arbitration_id=0x7, is_remote_frame=True, is_extended_id=False, dlc=4))
    bus.send(can.Message(arbitration_id=0x8, data=bytes(12), is_fd=True, is_extended_id=False))
    bus.send(
        can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True, is_extended_id=False)
    )
    messages = until(port.read, lambda got: len(contents(got)) >= 5)
    assert contents(messages) == [
        Content(0xAA, 0, b"\x01\x02"),
        Content(0x18FF0A31, EXTENDED, b""),
        Content(0x7, REMOTE, b""),
        Content(0x8, FD, bytes(12)),
        Content(0x40, ERROR, bytes(8)),
    ]
    assert before_ns <= messages[0].stamp_ns <= CLOCK.now_ns()
    assert messages[0].device == "test_ports"
    port.close()
    port.close()


@pytest.mark.live
def test_multicast_bus_is_read() -> None:
    options = {"interface": "udp_multicast", "channel": "239.74.163.2"}
    port = can_port(**options)
    port.open()
    with can.Bus(**options) as sender:
        sender.send(can.Message(arbitration_id=0x55, data=b"x", is_extended_id=False))
        assert Content(0x55, 0, b"x") in contents(until(port.read, bool))
    port.close()


@pytest.mark.live
def test_slcan_adapter_on_a_serial_line_is_opened_read_and_reopened(pty: Pty) -> None:
    port = can_port("slcan", pty.link, bitrate=500_000)
    for data in (b"\x11", b"\x22"):
        port.open()
        until(lambda: os.read(pty.master, 1000), lambda got: b"S6\r" in b"".join(got))
        pty.send(b"\r\a\rt0AA1" + data.hex().encode() + b"\rT18FF0A310\rgarbage\rt0A")
        messages = until(port.read, lambda got: len(contents(got)) >= 3)
        pty.send(b"A0\r")
        messages += until(port.read, bool)
        assert contents(messages)[:2] == [
            Content(0xAA, 0, data),
            Content(0x18FF0A31, EXTENDED, b""),
        ]
        assert contents(messages)[2].flags == ERROR
        assert contents(messages)[3] == Content(0xAA, 0, b"")
        pty.unplug()
        with pytest.raises(DeviceError, match="unplugged or hung up"):
            until(port.read, lambda got: False)
        with pytest.raises(DeviceError, match=r"no such device; .*\$\.odometer\.channel"):
            port.open()
        port.close()
        pty.plug()


@pytest.mark.live
def test_frames_say_whether_somebody_stamped_them_when_they_came(pty: Pty, bus: Any) -> None:
    port = can_port("slcan", pty.link)
    port.open()
    pty.send(b"t0AA0\r")
    messages = until(port.read, bool)
    assert all(message.read_stamps for message in messages)
    assert port.join(messages * 2).read_stamps
    port.close()
    port = can_port("virtual", "test_ports")
    port.open()
    bus.send(can.Message(arbitration_id=0xAA, is_extended_id=False))
    assert not any(message.read_stamps for message in until(port.read, bool))
    port.close()


@pytest.mark.live
def test_slcan_adapter_that_did_not_hear_its_opening_is_told_again(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may start after its port was opened: what was written before then is gone."""
    monkeypatch.setattr(ports, "WAIT_S", 0.01)
    port = can_port("slcan", pty.link, silence_s=1e-6)
    port.open()
    until(lambda: os.read(pty.master, 1000), lambda got: b"O\r" in b"".join(got))
    adapter = SlcanAdapter()  # starts now
    assert port.read() is None
    heard = until(lambda: os.read(pty.master, 1000), lambda got: b"O\r" in b"".join(got))
    adapter.feed(b"".join(heard))
    assert adapter.channel_open
    port.close()


@pytest.mark.live
def test_slcan_bit_rate_that_does_not_exist_is_a_device_error(pty: Pty) -> None:
    with pytest.raises(DeviceError, match=r"\$\.odometer\.interface, channel and bitrate"):
        can_port("slcan", pty.link, bitrate=123).open()


def test_unknown_interface_is_a_device_error() -> None:
    with pytest.raises(DeviceError, match="cannot open CAN interface 'no_such'"):
        can_port("no_such", "x").open()


def test_missing_network_interface_names_the_cure() -> None:
    with pytest.raises(DeviceError, match=r"no such network interface; .*\$\.odometer\.channel"):
        can_port("socketcan", "can97").open()


def test_interface_that_is_down_names_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "if_nametoindex", lambda name: 3)
    monkeypatch.setattr(Path, "read_text", lambda self: "0x40080\n")
    with pytest.raises(DeviceError, match="ip link set can0 up type can bitrate 500000"):
        can_port("socketcan", "can0").open()


# socketcan: a socket pair instead of the kernel's -------------------------------------------------


class Kernel:
    """The far end of a CAN socket, and the table of interfaces."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.index = 3
        self.ends: list[tuple[socket.socket, socket.socket]] = []
        monkeypatch.setattr(can, "Bus", self._bus)
        monkeypatch.setattr(ports, "_interface_index", lambda config: self.index)

    def _bus(self, **_: object) -> SimpleNamespace:
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ends.append((near, far))
        return SimpleNamespace(socket=near, shutdown=near.close)

    def send(self, word: int, data: bytes) -> None:
        width = 64 if len(data) > 8 else 8
        self.ends[-1][1].send(struct.pack("=IB3x", word, len(data)) + data.ljust(width, b"\0"))


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernel]:
    simulated = Kernel(monkeypatch)
    yield simulated
    for ends in simulated.ends:
        for end in ends:
            end.close()


@pytest.mark.live
def test_frames_of_the_kernel_are_gathered_into_one_message(kernel: Kernel) -> None:
    port = can_port("socketcan", "can0")
    port.open()
    near = kernel.ends[-1][0]
    assert near.getsockopt(socket.SOL_SOCKET, socketcan.SO_RXQ_OVFL) == 1
    kernel.send(0xAA, b"\x01\x02")
    kernel.send(0x18FF0A31 | 0x80000000, b"")
    kernel.send(0x123 | 0x40000000, b"")
    kernel.send(0x20000004, b"\x00\x30" + bytes(6))
    kernel.send(0x7FF, bytes(range(12)))
    message = port.read()
    assert message is not None
    assert not message.read_stamps
    assert contents([message]) == [
        Content(0xAA, 0, b"\x01\x02"),
        Content(0x18FF0A31, EXTENDED, b""),
        Content(0x123, REMOTE, b""),
        Content(4, ERROR, b"\x00\x30" + bytes(6)),
        Content(0x7FF, FD, bytes(range(12))),
    ]
    port.close()


@pytest.mark.live
def test_losses_of_the_socket_become_error_frames_at_their_place(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = iter([0, 0, 5, 5, 2])  # the kernel's count wraps at 32 bits
    monkeypatch.setattr(
        socketcan, "read_ancillary", lambda items, dropped: (time.time(), next(counts))
    )
    port = can_port("socketcan", "can0")
    port.open()
    for id_ in range(5):
        kernel.send(id_, b"")
    message = port.read()
    assert message is not None
    assert list(message.id) == [0, 1, HOST_OVERFLOW, 2, 3, HOST_OVERFLOW, 4]
    lost = [int.from_bytes(c.data, "big") for c in contents([message]) if c.id == HOST_OVERFLOW]
    assert lost == [5, 2**32 - 3]
    port.close()


@pytest.mark.live
def test_link_down_after_good_frames_loses_none_of_them(kernel: Kernel) -> None:
    port = can_port("socketcan", "can0")
    port.open()
    near = kernel.ends[-1][0]
    replies: list[Any] = [
        (struct.pack("=IB3x8s", 1, 0, b""), [], 0, None),
        OSError(errno.ENETDOWN, "down"),
    ]

    class Socket:
        """Gives one frame, then the kernel's complaint, which comes once only."""

        fileno = near.fileno

        def recvmsg(self, *_: int) -> Any:
            reply = replies.pop(0) if replies else BlockingIOError()
            if isinstance(reply, OSError):
                raise reply
            return reply

    kernel.send(1, b"")  # makes the descriptor ready
    port._bus.socket = Socket()
    message = port.read()
    assert message is not None
    assert list(message.id) == [1]
    with pytest.raises(DeviceError, match=r"the CAN interface is lost .*down"):
        port.read()
    port.close()


@pytest.mark.live
def test_interface_made_anew_is_noticed_in_its_silence(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "WAIT_S", 0.0)
    port = can_port("socketcan", "can0", silence_s=1e-6)
    port.open()
    assert port.read() is None
    kernel.index = 4
    with pytest.raises(DeviceError, match="made anew"):
        port.read()
    port.open()
    assert port.read() is None
    port.close()


def test_age_of_a_frame_counts_only_where_it_can_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VehicleClock(0, 1.0, lambda: 5_000_000_000)
    config = Odometer(channel="can0", dbc="", wheels=WHEELS)
    port = CanPort(config, clock)
    monkeypatch.setattr(time, "time", lambda: 1000.0)
    assert port._arrival_ns(999.75) == 4_750_000_000
    for stamped_s in (1000.5, 998.0, 0.0, 5e9):  # the host's clock was set, or the adapter's own
        assert port._arrival_ns(stamped_s) == 5_000_000_000
    assert CanPort(config, VehicleClock(0, 4.0, lambda: 10**9))._arrival_ns(999.75) == 3_000_000_000


def test_ancillary_data_tells_stamp_and_losses() -> None:
    """Layouts: struct timespec and u32, as recvmsg hands them over."""
    items = [
        (socket.SOL_SOCKET, socketcan.SO_TIMESTAMPNS, struct.pack("@ll", 12, 500_000_000)),
        (socket.SOL_SOCKET, socketcan.SO_RXQ_OVFL, struct.pack("@I", 9)),
        (99, socketcan.SO_RXQ_OVFL, b""),
    ]
    assert socketcan.read_ancillary(items, 4) == (12.5, 9)
    assert socketcan.read_ancillary(items[:1], 4) == (12.5, 4)
    assert socketcan.read_ancillary([], 4) == (0.0, 4)


# factories ----------------------------------------------------------------------------------------


def test_factories_give_unopened_ports_with_their_keys() -> None:
    vehicle = Vehicle(
        vehicle="t",
        gnss=Gnss(device="/dev/gnss"),
        imu=Imu(device="/dev/imu"),
        odometer=Odometer(channel="can0", dbc="", wheels=WHEELS),
    )
    made = [make(vehicle, CLOCK) for make in (gnss_port, imu_port, odometer_port)]
    assert [port.key for port in made] == [keys.GNSS_BYTES, keys.IMU_BYTES, keys.ODO_FRAMES]
    assert [port.device for port in made] == ["/dev/gnss", "/dev/imu", "can0"]


@pytest.mark.parametrize("make", [gnss_port, imu_port, odometer_port])
def test_port_without_its_section_is_a_config_error(make: Callable[..., object]) -> None:
    with pytest.raises(ConfigError, match=r"\$\.\w+: missing"):
        make(Vehicle(vehicle="t"), CLOCK)
