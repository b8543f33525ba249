"""The adapter answers as the manual says, however the host's bytes are cut."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tramstream.bridges.odometer.slcan import SlcanAdapter, encode_frame

OPENING = b"C\rS6\r\rO\r"
"""What python-can's slcan interface sends first (can.interfaces.slcan, set_bitrate and open)."""


def test_adapter_opens_and_closes_its_channel() -> None:
    adapter = SlcanAdapter()
    states = [adapter.channel_open]
    answers = []
    for commands in (OPENING, b"O\r", b"C\r"):
        answers.append(adapter.feed(commands))
        states.append(adapter.channel_open)
    assert answers == [b"\a\r\r\r", b"\a", b"\r"]  # closed already, open already
    assert states == [False, True, True, False]


def test_adapter_tells_version_serial_number_and_status() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"V\rN\rF\r") == b"V1013\rNTRAM\rF00\r"
    assert adapter.feed(b"t1230\rT000001230\rr1230\r") == b"z\rZ\rz\r"


def test_adapter_refuses_what_it_does_not_know() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"\xff\xfe\ry\r") == b"\a\a"
    assert adapter.commands_refused == 2


@given(st.lists(st.sampled_from([b"O", b"C", b"V", b"S6", b"", b"t1232FFEE", b"?"])), st.data())
def test_adapter_answers_alike_for_any_split(commands: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(command + b"\r" for command in commands)
    whole, split = SlcanAdapter(), SlcanAdapter()
    cut = data.draw(st.integers(0, len(stream)))
    assert whole.feed(stream) == split.feed(stream[:cut]) + split.feed(stream[cut:])
    assert whole.channel_open == split.channel_open


def test_frames_are_written_as_the_manual_has_them() -> None:
    assert encode_frame(0x10, b"\x11\x22") == b"t01021122\r"
    assert encode_frame(0x10, b"\x11\x22", extended=True) == b"T0000001021122\r"
    assert encode_frame(0x10, b"", remote_length=4) == b"r0104\r"
