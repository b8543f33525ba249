"""Frames of a real kernel, their stamps, and how losses are counted; see `guest_bus`."""

from __future__ import annotations

import math
import re
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from guest_bus import (
    BIT_RATE_SWITCH,
    CLOCK,
    ERROR_BIT,
    EXTENDED_BIT,
    GUEST_ONLY,
    GUEST_SLOWNESS_S,
    NOBODY,
    REMOTE_BIT,
    WHEELS_ID,
    Sender,
    contents,
    drain,
    losses,
    lost,
    numbers,
    sh,
    stamps_of,
    vehicle_of,
)

from tramstream import keys
from tramstream.bridges.odometer import socketcan
from tramstream.bridges.odometer.bridge import OdometerBridge
from tramstream.bridges.odometer.frames import ERROR, EXTENDED, FD, REMOTE, Content
from tramstream.bridges.ports import CanPort
from tramstream.clock import S
from tramstream.processor import Sample

pytestmark = GUEST_ONLY


# Frames -------------------------------------------------------------------------------------------
def test_every_kind_of_frame_arrives_as_it_was_sent(port: CanPort, sender: Sender) -> None:
    sender.send(0x110, b"\x01\x02")
    sender.send(0x7FF)
    sender.send(0x18FF0A31 | EXTENDED_BIT, bytes(8))
    sender.send(0x110 | EXTENDED_BIT, b"\x03")
    sender.send(0x123 | REMOTE_BIT)
    sender.send(0x1ABCDEF0 | REMOTE_BIT | EXTENDED_BIT)
    sender.send(0x321, bytes(range(12)), fd=0)
    sender.send(0x1FFFFFFF | EXTENDED_BIT, bytes(range(64)), fd=BIT_RATE_SWITCH)
    sender.send(0x322, b"\x05", fd=0)
    sender.send(ERROR_BIT | 0x004, b"\x00\x30" + bytes(6))
    sender.send(ERROR_BIT | 0x040, bytes(8))
    assert drain(port) == [
        Content(0x110, 0, b"\x01\x02"),
        Content(0x7FF, 0, b""),
        Content(0x18FF0A31, EXTENDED, bytes(8)),
        Content(0x110, EXTENDED, b"\x03"),
        Content(0x123, REMOTE, b""),
        Content(0x1ABCDEF0, REMOTE | EXTENDED, b""),
        Content(0x321, FD, bytes(range(12))),
        Content(0x1FFFFFFF, FD | EXTENDED, bytes(range(64))),
        Content(0x322, FD, b"\x05"),
        Content(0x004, ERROR, b"\x00\x30" + bytes(6)),
        Content(0x040, ERROR, bytes(8)),
    ]


def test_bridge_reads_wheels_and_counts_what_it_cannot_use(port: CanPort, sender: Sender) -> None:
    sender.send(WHEELS_ID, struct.pack("<HHB", 7, 8, 0))
    sender.send(WHEELS_ID | EXTENDED_BIT, struct.pack("<HHB", 99, 99, 0))  # another identifier
    sender.send(WHEELS_ID | REMOTE_BIT)
    sender.send(ERROR_BIT | 0x040, bytes(8))
    sender.send(WHEELS_ID, b"\x01")
    sender.send(WHEELS_ID, struct.pack("<HHB", 5, 6, 1))
    bridge = OdometerBridge(vehicle_of())
    message = port.read()
    assert message is not None
    readings = bridge.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 0))
    assert [reading.message.wheels[0].pulses for reading in readings] == [7, 12]
    assert bridge.device_counters()["rejected_by_reason"] == {
        "remote frame": 1,
        "bus-off": 1,
        "frame too short": 1,
    }


def test_stamps_are_those_of_the_arrival_and_not_of_the_reading(
    port: CanPort, sender: Sender
) -> None:
    """From the very first frame on: the kernel switches its stamps on with some delay."""
    spans = []
    for number in range(20):
        before_ns = CLOCK.now_ns()
        sender.send(number)
        spans.append((before_ns, CLOCK.now_ns()))
        time.sleep(0.02)
    time.sleep(0.4)
    message = port.read()
    assert message is not None
    assert list(message.id) == list(range(20))
    stamps = stamps_of(message)
    assert stamps == sorted(stamps)
    worst_ns = 0
    for stamp_ns, (before_ns, after_ns) in zip(stamps, spans, strict=True):
        worst_ns = max(worst_ns, before_ns - stamp_ns, stamp_ns - after_ns)
    print(f"\nstamps at most {worst_ns / 1e6:.3f} ms outside of the sending")
    assert worst_ns < 0.002 * S


def test_frames_that_waited_for_seconds_keep_their_arrival(port: CanPort, sender: Sender) -> None:
    """A reader that was held up (disk, suspended, swapped) must not bunch the wheels' pulses."""
    sent = []
    for number in range(6):
        sent.append(CLOCK.now_ns())
        sender.send(number)
        time.sleep(0.5)
    message = port.read()
    assert message is not None
    late_ns = [stamp - before for stamp, before in zip(stamps_of(message), sent, strict=True)]
    assert max(map(abs, late_ns)) < GUEST_SLOWNESS_S * S


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.4, -0.4])
def test_setting_the_clock_while_frames_wait_moves_no_stamp_out_of_order(
    port: CanPort, sender: Sender, step_s: float
) -> None:
    before_ns = CLOCK.now_ns()
    sender.send(1)
    time.sleep(0.1)
    time.clock_settime(time.CLOCK_REALTIME, time.time() + step_s)
    sender.send(2)
    time.sleep(0.1)
    message = port.read()
    after_ns = CLOCK.now_ns()
    assert message is not None
    stamps = [before_ns, *stamps_of(message), after_ns]
    assert stamps == sorted(stamps)
    sender.send(3)
    before_ns = CLOCK.now_ns() - int(GUEST_SLOWNESS_S * S)
    following = port.read()
    assert following is not None
    assert before_ns < following.stamp_ns < CLOCK.now_ns()


# Losses -------------------------------------------------------------------------------------------
def test_queue_is_as_long_as_was_asked_for(port: CanPort, sender: Sender) -> None:
    size = port._bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    assert size == 2 * socketcan.BUFFER_BYTES  # the kernel doubles it, for its own book-keeping
    sender.flood(5000)
    found = drain(port)
    assert numbers(found) == list(range(5000))
    assert losses(found) == 0


@pytest.mark.parametrize("fd", [False, True])
def test_flood_beyond_the_queue_is_counted_to_the_frame(
    port: CanPort, sender: Sender, fd: bool
) -> None:
    sent = 30_000
    sender.flood(sent, fd)
    found = drain(port)
    received = numbers(found)
    print(f"\nsent {sent}, received {len(received)}, counted {losses(found)}")
    assert received == list(range(len(received)))
    assert len(received) == math.ceil(2 * socketcan.BUFFER_BYTES / socketcan.FRAME_COST_BYTES)
    assert len(received) + losses(found) == sent  # though nothing came after the loss


def test_each_loss_is_told_at_its_place(port: CanPort, sender: Sender) -> None:
    """Three floods: whatever is missing between two frames is what was counted between them."""
    found: list[Content] = []
    start = 0
    for count in (30_000, 26_000, 24_000):
        for number in range(start, start + count):
            sender.socket.send(struct.pack("=IB3xQ", 1, 8, number))
        start += count
        message = port.read()  # a part of what waits only
        assert message is not None
        found += contents(message)
    found += drain(port)
    following, missing = 0, 0
    for frame in found:
        if lost(frame):
            missing += int.from_bytes(frame.data, "big")
        else:
            number = numbers([frame])[0]
            assert number == following + missing
            following, missing = number + 1, 0
    assert following + missing == start
    assert losses(found) + len(numbers(found)) == start


UNPRIVILEGED = """
import os, socket, sys
sys.path.insert(0, {folder!r})
import can, guest_bus as guest
from tramstream.cli.checks import devices
guest.can_port().open()  # whatever is imported late; the folders may be closed to others
os.setgroups([]); os.setgid({nobody}); os.setuid({nobody})
port = guest.can_port()
port.open()
print("size", port._bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF))
sender = guest.Sender()
sender.flood(5000)
found = guest.drain(port)
print("frames", len(guest.numbers(found)), "lost", guest.losses(found))
for finding in devices.check_queue(guest.odometer()):
    print("finding", finding.state, finding.text, "->", finding.cure)
"""


def unprivileged() -> str:
    script = UNPRIVILEGED.format(nobody=NOBODY, folder=str(Path(__file__).parent))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_who_is_not_root_reads_as_well_with_the_queue_that_the_system_allows(vcan: None) -> None:
    limit = Path("/proc/sys/net/core/rmem_max")
    kept = limit.read_text()
    said = unprivileged()
    print("\n" + said)
    assert f"size {2 * int(kept)}\n" in said
    received, counted = map(int, re.findall(r"(?:frames|lost) (\d+)", said))
    assert 200 < received < 1000
    assert received + counted == 5000
    assert f"holds {received} frames for us" in said
    cure = re.search(r"finding warning .*-> sudo (sysctl [^,]*)", said)
    assert cure is not None
    try:
        sh(cure.group(1))
        said = unprivileged()
        assert f"size {2 * socketcan.BUFFER_BYTES}\n" in said
        assert "frames 5000 lost 0\n" in said
        assert "finding" not in said
    finally:
        limit.write_text(kept)
