"""Buses of the guest of `run.py`, and who speaks on them; a plugin of pytest for its fixtures.

The tests in `guest_*.py` make, stop and delete network interfaces and set the clock: they run in
the guest only. `vcan0` is a virtual interface; `can0` and `can1` are two emulated SJA1000
controllers on one wire.
"""

from __future__ import annotations

import os
import shlex
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tramstream.bridges.odometer.frames import ERROR, HOST_OVERFLOW, Content
from tramstream.bridges.ports import CanPort
from tramstream.clock import VehicleClock
from tramstream.config import Odometer, Vehicle, Wheel
from tramstream.proto.raw_pb2 import CanFrames

CLOCK = VehicleClock(offset_ns=10**18)
DBC = str(Path(__file__).resolve().parents[2] / "tramstream" / "data" / "tram.dbc")
WHEELS = {"left": Wheel(message="WHEELS", signal="PULSES_LEFT", kind="pulses")}
WHEELS_ID = 272
NOBODY = 65534
DEADLINE_S = 30.0
GUEST_SLOWNESS_S = 0.1
"""Between two lines of Python in software emulation, generously."""
EXTENDED_BIT, REMOTE_BIT, ERROR_BIT = 0x80000000, 0x40000000, 0x20000000
BIT_RATE_SWITCH = 1

GUEST_ONLY = pytest.mark.skipif(
    not Path("/sys/class/net/can1").exists() or os.geteuid() != 0, reason="the guest of run.py only"
)


# The bus ------------------------------------------------------------------------------------------
def sh(command: str, fails: bool = False) -> str:
    """Run a command; what it prints."""
    done = subprocess.run(shlex.split(command), capture_output=True, text=True, check=False)
    assert bool(done.returncode) == fails, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout + done.stderr


class Sender:
    """Another program's socket on the bus."""

    def __init__(self, channel: str = "vcan0") -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.socket.bind((channel,))

    def send(self, word: int, data: bytes = b"", fd: int | None = None) -> None:
        width = 8 if fd is None else 64
        head = struct.pack("=IBB2x", word, len(data), fd or 0)
        self.socket.send(head + data.ljust(width, b"\0"))

    def flood(self, count: int, fd: bool = False) -> None:
        layout = struct.Struct("=IB3xQ56x" if fd else "=IB3xQ")
        length = 64 if fd else 8
        for number in range(count):
            self.socket.send(layout.pack(number % 0x800, length, number))


def make_vcan() -> None:
    sh("ip link add vcan0 type vcan")
    sh("ip link set vcan0 up")


def remove(channel: str) -> None:
    subprocess.run(["ip", "link", "del", channel], capture_output=True, check=False)


@pytest.fixture
def vcan() -> Iterator[None]:
    remove("vcan0")
    make_vcan()
    yield
    remove("vcan0")


@pytest.fixture
def sender(vcan: None) -> Iterator[Sender]:
    made = Sender()
    yield made
    made.socket.close()


@pytest.fixture
def port(vcan: None) -> Iterator[CanPort]:
    made = can_port()
    made.open()
    yield made
    made.close()


@pytest.fixture
def wire() -> Iterator[None]:
    """`can0` and `can1`, up and with a bit rate."""
    for channel in ("can0", "can1"):
        sh(f"ip link set {channel} down")
        sh(f"ip link set {channel} up type can bitrate 500000 restart-ms 100")
    yield
    for channel in ("can0", "can1"):
        sh(f"ip link set {channel} down")


def odometer(channel: str = "vcan0", **changes: Any) -> Odometer:
    return Odometer(**{"channel": channel, "dbc": DBC, "wheels": WHEELS, **changes})


def can_port(channel: str = "vcan0", **changes: Any) -> CanPort:
    return CanPort(odometer(channel, **changes), CLOCK)


def vehicle_of(channel: str = "vcan0", **changes: Any) -> Vehicle:
    return Vehicle(vehicle="t", odometer=odometer(channel, **changes))


def contents(message: CanFrames) -> list[Content]:
    return [
        Content(*columns) for columns in zip(message.id, message.flags, message.data, strict=True)
    ]


def stamps_of(message: CanFrames) -> list[int]:
    return [message.stamp_ns + offset_ns for offset_ns in message.offset_ns]


def drain(port: CanPort, found: list[Content] | None = None) -> list[Content]:
    """Frames until there are none; they are in `found` also if the link is lost."""
    found = [] if found is None else found
    while (message := port.read()) is not None:
        found += contents(message)
    return found


def losses(frames: list[Content]) -> int:
    return sum(int.from_bytes(frame.data, "big") for frame in frames if lost(frame))


def lost(frame: Content) -> bool:
    return bool(frame.flags & ERROR and frame.id & HOST_OVERFLOW)


def numbers(frames: list[Content]) -> list[int]:
    return [struct.unpack_from("=Q", frame.data)[0] for frame in frames if not frame.flags & ERROR]


def wait_for(what: str, condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> float:
    """Seconds until a condition holds."""
    started_s = time.monotonic()
    while not condition():
        assert time.monotonic() - started_s < deadline_s, f"never: {what}"
        time.sleep(0.02)
    return time.monotonic() - started_s
