"""The thread that keeps a device open, with a device that does what a script says."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live import HANG_S
from scripted import FakePort, Impatient, raw

from tramstream.clock import S
from tramstream.errors import DeviceError
from tramstream.live.events import DEVICE_AWAY, DEVICE_NOT_OPENED, DEVICE_SILENT
from tramstream.live.ports import (
    BACKOFF_FIRST_S,
    BACKOFF_MAX_S,
    SILENT_S,
    PortReader,
    join_reads,
    size,
)
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import CanFrames


def read_all(script: list[Any]) -> tuple[PortReader, list[Any], Impatient]:
    """Run a reader until the script is at its end."""
    stop = Impatient()
    got: list[Any] = []
    port = FakePort(script, stop)
    reader = PortReader(port, got.append, stop)
    reader.start()
    reader.join(HANG_S)
    assert not port.is_open
    return reader, got, stop


def lost(text: str = "unplugged") -> DeviceError:
    return DeviceError(f"/dev/fake: {text}")


def test_messages_are_delivered_and_counted() -> None:
    reader, got, _ = read_all([raw(b"ab"), None, raw(b"cde")])
    assert [message.data for message in got] == [b"ab", b"cde"]
    assert (reader.bytes_received, reader.opened) == (5, 1)


def test_lost_device_is_opened_again_with_a_growing_bounded_pause() -> None:
    reader, got, stop = read_all([*[lost()] * 9, raw(b"x")])
    assert [message.data for message in got] == [b"x"]
    assert reader.opened == 10
    pauses = stop.waited_s[:9]
    assert pauses[0] == BACKOFF_FIRST_S
    assert pauses == sorted(pauses)
    assert pauses[-1] == BACKOFF_MAX_S


def test_pause_is_short_again_after_a_message() -> None:
    _, _, stop = read_all([lost(), lost(), lost(), raw(b"x"), lost(), raw(b"y")])
    assert stop.waited_s[3] == BACKOFF_FIRST_S


def test_health_names_what_was_lost_until_it_is_back() -> None:
    stop = Impatient()
    port = FakePort([lost("no such device")], stop)
    reader = PortReader(port, lambda message: None, stop)
    seen = [reader.health()]
    reopen = port.open

    def look_and_open() -> None:
        seen.append(reader.health())
        reopen()

    port.open = look_and_open  # type: ignore[method-assign]
    reader.start()
    reader.join(HANG_S)
    not_yet = (DeviceHealth.LOST, DEVICE_NOT_OPENED(device="/dev/fake"))
    facts = {"reason": "/dev/fake: no such device", "advice": ""}
    away = (DeviceHealth.LOST, DEVICE_AWAY(device="/dev/fake", **facts))
    assert seen == [not_yet, not_yet, away]
    assert reader.health() == (DeviceHealth.OPEN, None)


def test_bug_in_a_port_is_delivered_and_the_device_opened_again() -> None:
    bug = KeyError("surprise")
    reader, got, _ = read_all([raw(b"a"), bug, raw(b"b")])
    assert got[1] is bug
    assert [message.data for message in (got[0], got[2])] == [b"a", b"b"]
    assert reader.opened == 2


def test_device_that_says_nothing_is_silent_with_a_cure() -> None:
    now_s = [100.0]
    stop = Impatient()
    reader = PortReader(FakePort([], stop), lambda message: None, stop, lambda: now_s[0])
    reader.start()
    reader.join(HANG_S)
    now_s[0] += SILENT_S - 0.1
    assert reader.health() == (DeviceHealth.OPEN, None)
    now_s[0] += 0.2
    silent = DEVICE_SILENT(device="/dev/fake", silence_s=3.0, limit_s=SILENT_S)
    assert reader.health() == (DeviceHealth.SILENT, silent)
    assert "check power" in str(silent)


def test_reader_that_was_never_started_can_be_joined() -> None:
    stop = Impatient()
    reader = PortReader(FakePort([], stop), lambda message: None, stop)
    reader.join(0.0)
    assert (reader.opened, reader.bytes_received) == (0, 0)


@given(st.lists(st.binary(min_size=1, max_size=20), min_size=1, max_size=20))
def test_joined_reads_keep_every_byte_and_arrival(parts: list[bytes]) -> None:
    reads = [raw(data, at_s=0.005 * index) for index, data in enumerate(parts)]
    joined = join_reads(reads)
    assert joined.data == b"".join(parts)
    begin = 0
    for read, length, offset_ns in zip(
        reads, joined.read_length, joined.read_offset_ns, strict=True
    ):
        assert joined.data[begin : begin + length] == read.data
        assert joined.stamp_ns + offset_ns == read.stamp_ns
        begin += length
    assert joined.device == "/dev/fake"


@given(st.lists(st.lists(st.integers(0, 20_000_000), min_size=1, max_size=5), min_size=1))
def test_joined_frames_keep_every_frame_and_arrival(offsets: list[list[int]]) -> None:
    reads = [
        CanFrames(
            stamp_ns=S + index * 20_000_000,
            device="can0",
            offset_ns=sorted(group),
            id=range(len(group)),
            flags=[index % 8] * len(group),
            data=[bytes([index % 256])] * len(group),
        )
        for index, group in enumerate(offsets)
    ]

    def frames(messages: list[CanFrames]) -> list[tuple[int, int, int, bytes]]:
        return [
            (message.stamp_ns + offset_ns, id_, flags, data)
            for message in messages
            for offset_ns, id_, flags, data in zip(
                message.offset_ns, message.id, message.flags, message.data, strict=True
            )
        ]

    assert frames([join_reads(reads)]) == frames(reads)


def test_frame_that_the_kernel_stamped_before_the_last_read_is_not_put_before_the_first() -> None:
    """Offsets have no sign; the message begins with its first read."""
    reads = [
        CanFrames(stamp_ns=S + later_ns, offset_ns=[0, 5], id=[1, 2], flags=[0, 0], data=[b""] * 2)
        for later_ns in (0, -1000, 70)
    ]
    joined = join_reads(reads)
    assert joined.stamp_ns == S
    assert list(joined.offset_ns) == [0, 5, 0, 5, 70, 75]


def test_size_is_that_of_the_device_data() -> None:
    assert size(raw(b"abc")) == 3
    assert size(CanFrames(data=[b"12", b"", b"345"])) == 5


def test_joining_nothing_is_a_bug() -> None:
    with pytest.raises(IndexError):
        join_reads([])
