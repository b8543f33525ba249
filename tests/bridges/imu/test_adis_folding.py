"""Folded bytes of the IMU: the same once unfolded, whatever they are; small if they are frames."""

from __future__ import annotations

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from tramstream.bridges.imu import framer
from tramstream.bridges.imu.folding import FOLDING, as_read, fold
from tramstream.proto.raw_pb2 import RawBytes


def frames(count: int, seed: int = 1) -> bytes:
    """A still sensor with noise of a few counts."""
    chance = np.random.default_rng(seed)
    number = np.arange(count)
    return framer.encode(
        stamp_us=1_000_000 + 500 * number,
        sequence=70_000 + number,
        gyro=chance.integers(-40, 40, (count, 3)),
        accel=chance.integers(-40, 40, (count, 3)),
    )


@given(
    st.lists(
        st.one_of(
            st.binary(max_size=50), st.integers(0, 5).map(frames), st.just(framer.HEADER * 3)
        ),
        max_size=5,
    ).map(b"".join)
)
def test_any_bytes_come_back(data):
    message = RawBytes(data=data)
    fold(message)
    assert len(message.data) == len(data)
    assert as_read(message) == data
    assert as_read(RawBytes.FromString(message.SerializeToString())) == data


def test_frames_take_a_third_of_the_room():
    """What is left is the noise of six axes, about a byte each, of 36 bytes."""
    data = b"\x01\x02" + frames(200) + b"\xad"
    message = RawBytes(data=data)
    fold(message)
    plain, folded = (len(zstandard.compress(each)) for each in (data, message.data))
    assert folded < plain / 2.5
    assert folded < 200 * 9


def test_cut_of_the_stream_does_not_matter():
    data = frames(20)
    for cut in range(0, 80, 7):
        message = RawBytes(data=data[cut : len(data) - cut])
        fold(message)
        assert as_read(message) == data[cut : len(data) - cut]


def test_bytes_that_are_not_folded_are_as_read():
    assert as_read(RawBytes(data=b"abc")) == b"abc"


def test_hostile_message_gives_bytes_or_one_sentence():
    assert as_read(RawBytes(data=b"abc", folding=FOLDING, folded_from=4_000_000_000)) == b"abc"
    with pytest.raises(ValueError, match="folded as 'later'"):
        as_read(RawBytes(data=b"abc", folding="later"))
