"""The IMU's frames: any split, any damage, the page for the firmware's author."""

from __future__ import annotations

import re
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream.bridges.imu import framer as adis
from tramstream.bridges.imu.framer import FRAME_LENGTH, AdisFramer, Bursts, Rejected
from tramstream.memory.stage import assign

PAGE = Path(__file__).resolve().parents[3] / "docs" / "imu-framing.md"


def frames(count: int, first: int = 1) -> bytes:
    rng = np.random.default_rng(first)
    sequence = first + np.arange(count)
    gyro = rng.integers(-32768, 32768, (count, 3))
    return adis.encode(
        500 * sequence, sequence, gyro, gyro[:, ::-1], rng.integers(-400, 900, count)
    )


def feed_in_parts(data: bytes, cuts: list[int]) -> tuple[bytes, list[Rejected], AdisFramer]:
    framer, good, rejected = AdisFramer(), b"", []
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    for start, end in pairwise(edges):
        bursts = framer.feed(data[start:end])
        good += bursts.frames.tobytes()
        rejected += bursts.rejected
        assert framer.bytes_fed == end
    return good, rejected, framer


def scan(data: bytes) -> bytes:
    """Naive reading of docs/imu-framing.md: at each byte, is a good frame there?"""
    good, at = b"", 0
    while at + 36 <= len(data):
        body, crc = data[at + 2 : at + 32], data[at + 32 : at + 36]
        framed = data[at : at + 4] == b"\xad\x65\x01\x1c"
        if framed and zlib.crc32(body) == int.from_bytes(crc, "little"):
            burst = data[at + 12 : at + 32]
            if any(burst) and sum(burst[:18]) == int.from_bytes(burst[18:], "big"):
                good += data[at : at + 36]
            at += 36
        else:
            at += 1
    return good


pieces = st.one_of(
    st.integers(1, 4).map(lambda n: frames(n, 100 * n)),
    st.binary(max_size=50),
    st.sampled_from([b"\xad", adis.SYNC, adis.HEADER, b"\xad\xad\x65", adis.SYNC + b"\x01"]),
    st.integers(1, 35).map(lambda n: frames(1)[:n]),
    st.integers(1, 35).map(lambda n: frames(1)[n:]),
    st.integers(0, 35).map(lambda n: flipped(frames(1), n)),
)


def flipped(data: bytes, at: int, mask: int = 0x10) -> bytes:
    return data[:at] + bytes((data[at] ^ mask,)) + data[at + 1 :]


@given(st.lists(pieces, max_size=8).map(b"".join), st.lists(st.integers(0, 10_000), max_size=12))
@settings(max_examples=300)
def test_any_split_gives_what_the_whole_gives(data: bytes, cuts: list[int]) -> None:
    good, rejected, framer = feed_in_parts(data, [])
    assert good == scan(data)
    parts_good, parts_rejected, parts_framer = feed_in_parts(data, cuts)
    assert (parts_good, parts_rejected) == (good, rejected)
    assert parts_framer == framer
    assert framer.bytes_framed == len(good)
    assert framer.bytes_pending < FRAME_LENGTH
    assert sum(framer.rejected_by_reason.values()) == len(rejected)


def test_stream_fed_byte_by_byte_gives_every_frame() -> None:
    data = b"\xad" + frames(5) + adis.SYNC + frames(3, 50) + b"\xad"
    good, _, framer = feed_in_parts(data, list(range(len(data))))
    assert good == frames(5) + frames(3, 50)
    assert framer.bytes_pending == 1


def test_stream_cut_at_every_byte_yields_its_whole_frames() -> None:
    data = frames(4)
    for end in range(len(data) + 1):
        bursts = AdisFramer().feed(data[:end])
        assert len(bursts.frames) == end // FRAME_LENGTH
        assert bursts.rejected == []


def test_every_changed_byte_costs_its_own_frame_only() -> None:
    before, hit, after = frames(1, 1), frames(1, 2), frames(1, 3)
    for at in range(FRAME_LENGTH):
        for mask in range(1, 256):
            bursts = AdisFramer().feed(before + flipped(hit, at, mask) + after)
            assert bursts.frames.tobytes() == before + after


@given(st.lists(st.integers(0, 36 * 8 - 1), min_size=2, max_size=2, unique=True))
@settings(max_examples=200)
def test_two_flipped_bits_never_pass(bits: list[int]) -> None:
    damaged = frames(1)
    for bit in bits:
        damaged = flipped(damaged, bit // 8, 1 << bit % 8)
    assert len(AdisFramer().feed(damaged).frames) == 0


@pytest.mark.parametrize("false_start", [adis.SYNC, adis.HEADER, frames(1)[:20], frames(1)[:35]])
def test_frame_right_behind_a_false_start_is_found(false_start: bytes) -> None:
    bursts = AdisFramer().feed(false_start + frames(2, 7))
    assert bursts.frames.tobytes() == frames(2, 7)
    assert [rejected.length for rejected in bursts.rejected] == [1]


def test_sync_inside_a_burst_is_no_start() -> None:
    sync = int.from_bytes(adis.SYNC, "big", signed=True)
    data = adis.encode([5], [9], [[sync] * 3], [[sync] * 3])
    bursts = AdisFramer().feed(data)
    assert bursts.frames.tobytes() == data
    assert bursts.rejected == []


def test_reasons_name_what_is_wrong_and_where() -> None:
    damaged = bytearray(frames(1))
    damaged[20] ^= 1  # on the SPI lines: the microcontroller's CRC is right
    damaged[32:] = zlib.crc32(damaged[2:32]).to_bytes(4, "little")
    dead = bytearray(frames(1)[:12] + bytes(20))
    dead += zlib.crc32(dead[2:]).to_bytes(4, "little")
    broken = flipped(frames(1, 9), 15)
    data = b"noise" + bytes(damaged) + bytes(dead) + broken + b"\xad\x65\x02" + frames(1)
    framer = AdisFramer()
    bursts = framer.feed(data)
    assert bursts.frames.tobytes() == frames(1)
    assert bursts.rejected == [
        Rejected(adis.REJECT_CHECKSUM, 5, 36),
        Rejected(adis.REJECT_EMPTY, 41, 36),
        Rejected(adis.REJECT_CRC, 77, 1),
        Rejected(adis.REJECT_HEADER, 113, 1),
    ]
    assert framer.bytes_rejected == len(data) - FRAME_LENGTH
    assert framer.rejected_by_reason == {"checksum": 1, "empty burst": 1, "crc": 1, "header": 1}


def test_encoder_and_decoder_are_inverse_at_the_extremes() -> None:
    stamp = [0, 2**32 - 1, 2**32 + 5]
    gyro = np.array([[-32768, 32767, 0], [1, -1, 2], [40_000, -40_000, 7]])
    data = adis.encode(
        stamp, [0, 2**32 - 1, 2**32], gyro, -gyro, [-400, 850, 0], 0x8001, [65535, 65536, 3]
    )
    got = AdisFramer().feed(data).frames
    assert got["stamp_us"].tolist() == [0, 2**32 - 1, 5]
    assert got["sequence"].tolist() == [0, 2**32 - 1, 0]
    assert got["gyro"].tolist() == np.clip(gyro, -32768, 32767).tolist()
    assert got["accel"].tolist() == np.clip(-gyro, -32768, 32767).tolist()
    assert got["temperature"].tolist() == [-400, 850, 0]
    assert got["diag_stat"].tolist() == [0x8001] * 3
    assert got["data_cntr"].tolist() == [65535, 0, 3]
    assert AdisFramer().feed(adis.encode([1], [1], [[1, 2, 3]], [[4, 5, 6]])).frames["checksum"] > 0


def test_burst_bytes_lie_as_in_the_data_sheet() -> None:
    """ADIS16465 data sheet, Burst Read Function: big-endian words, sum of the bytes before."""
    data = adis.encode(
        [0], [0], [[0x0102, 0x0304, 0x0506]], [[0x0708, 0x090A, 0x0B0C]], 0x0D0E, 0x0F10, [0x1112]
    )
    burst = data[12:32]
    words = "0F10 0102 0304 0506 0708 090A 0B0C 0D0E 1112"
    assert burst[:18].hex() == words.replace(" ", "").lower()
    assert int.from_bytes(burst[18:], "big") == sum(range(1, 0x13))


def test_example_of_the_page_is_what_the_code_makes() -> None:
    text = PAGE.read_text()
    block = re.search(r"```hex\n(.*?)```", text, re.DOTALL)
    assert block is not None
    example = bytes.fromhex(re.sub(r"#.*", "", block[1]))
    assert len(example) == FRAME_LENGTH
    frame = AdisFramer().feed(example).frames
    assert int(frame["stamp_us"][0]) == 123_456_789
    assert int(frame["sequence"][0]) == 70_000
    assert frame["gyro"].tolist() == [[100, -200, 300]]
    assert frame["accel"].tolist() == [[-10, 20, 3924]]
    crc = re.search(r"CRC-32 of the example: `0x([0-9A-F]{8})`", text)
    assert crc is not None
    assert int(crc[1], 16) == zlib.crc32(example[2:32])


def test_restored_framer_goes_on_at_any_byte() -> None:
    data = frames(3) + b"\xad\x65" + flipped(frames(1), 30) + frames(2, 8)
    whole = AdisFramer()
    expected = whole.feed(data)
    for cut in range(len(data)):
        first, second = AdisFramer(), AdisFramer()
        head = first.feed(data[:cut])
        assign(second, first)
        tail = second.feed(data[cut:])
        assert joined(head, tail) == joined(expected)
        assert second == whole


def joined(*parts: Bursts) -> tuple[bytes, list[Rejected]]:
    rejected = [reject for part in parts for reject in part.rejected]
    return b"".join(part.frames.tobytes() for part in parts), rejected


def test_nothing_fed_gives_nothing() -> None:
    bursts = AdisFramer().feed(b"")
    assert len(bursts.frames) == 0
    assert bursts.rejected == []
