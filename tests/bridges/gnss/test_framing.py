"""Framing: any cut gives the same, nothing intact is lost, every byte is accounted for."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum

from tramstream.bridges.gnss import framer as framer_module
from tramstream.bridges.gnss.frame_checks import Window, crc24q
from tramstream.bridges.gnss.framer import (
    NMEA,
    NOISE,
    RTCM3,
    UBX,
    Frame,
    Framer,
    Rejected,
    nmea_frame,
    rtcm3_frame,
    ubx_frame,
)
from tramstream.memory.stage import assign

MON_PATCH = 0x0A27
NAV_PVT = 0x0107
RXM_RAWX = 0x0215
UNKNOWN = 0x7F01

CAPTURES = (
    "u-blox-m8t-time.log",
    "ublox-8.log",
    "ublox-neo-m8l.log",
    "ublox-zed-f9p-nmea.log",
    "ublox-zed-f9p_hpg1.11.log",
    "ublox-zed-f9r.log",
    "zed-f9r-drive.ubx",
)

GGA = nmea_frame("GNGGA,000941.00,4404.13387,N,12118.85628,W,1,12,1.01,1144.8,M,-21.4,M,,")
PVT = ubx_frame(NAV_PVT, bytes(range(92)))
RAWX = ubx_frame(RXM_RAWX, bytes(11) + b"\x03" + bytes(4) + bytes(range(96)))
CORRECTION = rtcm3_frame(bytes([0x43, 0x50, *range(40)]))


def long_header(length: int) -> bytes:
    """Of a message without a table, which may be of any length."""
    return b"\xb5\x62" + UNKNOWN.to_bytes(2, "big") + length.to_bytes(2, "little")


frames = st.one_of(
    st.builds(ubx_frame, st.sampled_from([UNKNOWN, 0x0122, MON_PATCH]), st.binary(max_size=60)),
    st.sampled_from([PVT, GGA, RAWX, CORRECTION]),
    st.builds(rtcm3_frame, st.binary(max_size=50)),
)
dirt = st.one_of(
    st.binary(max_size=20),
    st.sampled_from(
        [b"\xb5", b"\xb5\x62", b"$", b"$G\xff", b"$GNGGA,1", b"!A", b"\xd3\x00", b"\xd3\x00\x00"]
    ),
    st.builds(lambda frame, at: frame[: at % len(frame)], frames, st.integers(0, 200)),
    st.builds(
        lambda frame, at, bit: flip(frame, (at % len(frame)) * 8 + bit),
        frames, st.integers(0, 200), st.integers(0, 7),
    ),
)  # fmt: skip
several = st.lists(frames, max_size=5).map(b"".join)
around = st.one_of(  # frames inside of a frame, and behind a start that claims to hold them
    st.builds(ubx_frame, st.just(UNKNOWN), several),
    st.builds(lambda inner: rtcm3_frame(inner[:1023]), several),
    st.builds(lambda inner: flip(ubx_frame(UNKNOWN, inner), 8 * len(inner) + 55), several),
    st.builds(lambda inner: ubx_frame(UNKNOWN, inner + GGA.rstrip()), several),
    st.sampled_from(
        [long_header(n) for n in (40, 100, 300, 8192)] + [b"\xd3\x00\x64", b"\xd3\x03\xff"]
    ),
)
streams = st.lists(st.one_of(frames, dirt, around), max_size=12).map(b"".join)


def flip(data: bytes, bit: int) -> bytes:
    spoilt = bytearray(data)
    spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)


def run(pieces: list[bytes]) -> list[Frame | Rejected]:
    framer = Framer()
    out = [item for piece in pieces for item in framer.feed(piece)]
    return out + framer.flush()


def cut(data: bytes, places: list[int]) -> list[bytes]:
    edges = [0, *sorted(places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def delivered(data: bytes) -> list[bytes]:
    return [item.raw for item in run([data]) if isinstance(item, Frame)]


@settings(max_examples=300)
@given(streams, st.lists(st.integers(0, 400), max_size=8))
def test_any_cut_gives_the_same_frames_and_rejections(stream: bytes, places: list[int]) -> None:
    whole = run([stream])
    assert run(cut(stream, [min(place, len(stream)) for place in places])) == whole
    assert run([stream[i : i + 1] for i in range(len(stream))]) == whole


@settings(max_examples=200)
@given(streams)
def test_frames_and_rejections_tile_the_stream(stream: bytes) -> None:
    at, sentence = 0, False
    for item in run([stream]):
        if sentence:  # what is left of a line's end belongs to it
            assert set(stream[at : item.start]) <= set(b"\r\n")
            at = item.start
        if isinstance(item, Frame):
            assert (item.start, item.raw) == (at, stream[at : item.end + 1])
            at = item.end + 1
        else:
            assert item.start == at
            at += item.size
        sentence = isinstance(item, Frame) and item.protocol == NMEA
    assert at == len(stream) or (sentence and not stream[at:].strip(b"\r\n"))


@settings(max_examples=200)
@given(st.lists(streams, max_size=5), st.integers(0, 5))
def test_bytes_balance_at_any_time_and_memory_can_be_moved(
    pieces: list[bytes], moved_at: int
) -> None:
    framer, moved = Framer(), Framer()
    for count, piece in enumerate(pieces):
        if count == moved_at:
            assign(moved, framer)
        out = framer.feed(piece)
        if count >= moved_at:
            assert moved.feed(piece) == out
        assert framer.bytes_in == (
            framer.bytes_in_frames + framer.bytes_rejected + framer.bytes_pending
        )
    framer.flush()
    assert framer.bytes_pending == 0
    assert framer.bytes_in == framer.bytes_in_frames + framer.bytes_rejected


def test_each_protocol_is_recognised_and_named() -> None:
    found = [item for item in run([PVT + GGA + CORRECTION]) if isinstance(item, Frame)]
    assert [(f.protocol, f.kind, f.name) for f in found] == [
        (UBX, NAV_PVT, "NAV-PVT"),
        (NMEA, 0, "GNGGA"),
        (RTCM3, 1077, "1077"),
    ]
    assert [f.payload for f in found] == [PVT[6:-2], GGA[1:-5], CORRECTION[3:-3]]
    assert [f.end for f in found] == [99, 99 + len(GGA), 99 + len(GGA) + len(CORRECTION)]


def test_frame_survives_lone_sync_byte() -> None:
    for lone in (b"\xb5", b"$", b"!", b"\xd3", b"\xb5\xb5", b"\xb5$", b"\xd3\xd3"):
        assert delivered(lone + PVT) == [PVT]


FALSE_STARTS = (b"\xb5\x62", b"$G", b"!A", b"\xd3\x00", b"\xd3\x03")
WHOLE = (PVT, GGA, CORRECTION, RAWX)


@pytest.mark.parametrize("behind", [1, 2])
@pytest.mark.parametrize("frame", WHOLE, ids=("UBX", "NMEA", "RTCM3", "counted UBX"))
@pytest.mark.parametrize("false", FALSE_STARTS, ids=("UBX", "NMEA $", "NMEA !", "RTCM3", "long"))
def test_frame_that_begins_right_behind_a_false_start_is_delivered(
    false: bytes, frame: bytes, behind: int
) -> None:
    """However long the frame is that the false start claims: it is there once that has come."""
    assert delivered(false[:behind] + frame + bytes(2048)) == [frame]


@given(
    st.lists(st.sampled_from([*FALSE_STARTS, b"\xb5", b"$", b"!", b"\xd3"]), max_size=9),
    st.sampled_from(WHOLE),
)
def test_frame_behind_any_nesting_of_false_starts_is_delivered(
    false: list[bytes], frame: bytes
) -> None:
    assert delivered(b"".join(false) + frame) == [frame]


def test_intact_frame_behind_a_corrupt_header_is_delivered() -> None:
    for bit in range(16, 48):  # class, identifier and length of the first frame
        assert delivered(flip(RAWX, bit) + PVT + GGA)[-2:] == [PVT, GGA]


def test_flipped_length_bit_does_not_make_the_framer_wait() -> None:
    framer = Framer()
    for frame in (PVT, RAWX):
        for bit in range(32, 48):
            out = framer.feed(flip(frame, bit) + PVT)
            assert [item.raw for item in out if isinstance(item, Frame)] == [PVT]


def test_frame_hidden_in_a_frame_that_never_ends_is_delivered_at_the_end() -> None:
    header = b"\xb5\x62\x7f\x01" + (4000).to_bytes(2, "little")
    framer = Framer()
    assert framer.feed(header + PVT) == []
    out = framer.flush()
    assert out == [Rejected("UBX truncated", 0, 6), Frame(UBX, NAV_PVT, PVT, 105)]


CHAINS = ([PVT, PVT, PVT], [GGA, GGA, GGA], [PVT, GGA, CORRECTION], [GGA, CORRECTION, RAWX])
LONG_STARTS = (long_header(8192), b"\xd3\x03\xff", long_header(8192) + b"\xd3\x03\xff")


@pytest.mark.parametrize("chain", CHAINS, ids=("UBX", "NMEA", "mixed", "RTCM3 inside"))
@pytest.mark.parametrize("start", LONG_STARTS, ids=("UBX", "RTCM3", "one inside the other"))
def test_stream_goes_on_behind_a_long_false_start_with_the_third_whole_frame(
    start: bytes, chain: list[bytes]
) -> None:
    """Not after the 8 kB that it claims, for which a receiver that says little needs a minute."""
    framer = Framer()
    found = framer.feed(start)
    for frame in chain[:2]:
        found += framer.feed(frame)
    assert found == []
    found += framer.feed(chain[2])
    found += framer.feed(PVT)
    assert [item.raw for item in found if isinstance(item, Frame)] == [*chain, PVT]
    assert framer.bytes_rejected == len(start)


def test_long_false_start_is_the_same_in_a_file_as_it_was_live() -> None:
    """Also where a check value would agree at its end, which nobody has waited for."""
    for inner in (3 * PVT, 3 * GGA, PVT + 2 * GGA + b"\x01\x02"):
        outer = ubx_frame(UNKNOWN, inner)
        live = run([bytes([byte]) for byte in outer + PVT])
        assert live == run([outer + PVT]) == run([outer, PVT])
        assert live[0] == Rejected("UBX overtaken", 0, 6)
        assert len([item for item in live if isinstance(item, Frame)]) == 4


class Counting(Window):
    """Counts the places at which it looks for a chain."""

    judged = 0

    def end_of_chain(self, at: int) -> tuple[int, int]:
        Counting.judged += 1
        return super().end_of_chain(at)


@pytest.mark.parametrize("step", [16, 100_000])
@pytest.mark.parametrize("inner", [b"", b"\xb5\x62\x02\x13\x84\x00", b"$A*41"])
def test_nested_long_starts_are_looked_into_a_few_times_each(
    inner: bytes, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many claim to hold all the others, and however they come: that is linear time."""
    monkeypatch.setattr(framer_module, "Window", Counting)
    monkeypatch.setattr(Counting, "judged", 0)
    hostile = 2000 * (long_header(8184) + inner)
    framer = Framer()
    for at in range(0, len(hostile), step):
        framer.feed(hostile[at : at + step])
    assert 0 < Counting.judged <= 4 * 4000


def test_valid_outer_frame_wins_over_what_lies_inside() -> None:
    for outer in (ubx_frame(UNKNOWN, PVT + GGA), rtcm3_frame(b"\x43\x50" + PVT)):
        assert delivered(outer + GGA) == [outer, GGA]


def test_length_that_the_type_cannot_have_is_refused_however_good_the_checksum() -> None:
    short = ubx_frame(NAV_PVT, bytes(85))
    long = ubx_frame(NAV_PVT, bytes(96))
    miscounted = ubx_frame(RXM_RAWX, bytes(11) + b"\x02" + bytes(4) + bytes(96))
    framer = Framer()
    framer.feed(short + long + miscounted)
    framer.flush()
    assert framer.frames == 0
    assert framer.false_starts == {"UBX length": 2, "UBX count": 1}


def test_patch_of_65535_bytes_does_not_stop_the_stream() -> None:
    patch = ubx_frame(MON_PATCH, bytes(65535))
    framer = Framer()
    out = framer.feed(patch[:100])
    assert out == []  # settled at once: nothing but noise so far
    out = framer.feed(patch[100:] + PVT)
    assert out == [
        Rejected("UBX length", 0, len(patch)),
        Frame(UBX, NAV_PVT, PVT, len(patch) + 99),
    ]


def test_empty_rtcm3_frame_and_lone_preamble_do_no_harm() -> None:
    filler = rtcm3_frame(b"")
    assert delivered(filler + PVT) == [filler, PVT]
    assert delivered(b"\xd3\x00\x00" + PVT) == [PVT]


def test_sentence_with_a_foreign_byte_is_refused() -> None:
    assert run([b"$G\xff" + GGA]) == [
        Rejected("NMEA malformed", 0, 3),
        Frame(NMEA, 0, GGA, 2 + len(GGA)),
    ]


def test_sentence_without_end_does_not_swallow_the_next() -> None:
    assert delivered(GGA[:-4] + GGA) == [GGA]
    assert delivered(b"$GNGGA," + b"1" * 5000 + GGA) == [GGA]


def test_text_header_is_noise() -> None:
    text = b"# a capture's header: name = value\n"
    assert run([text + PVT])[0] == Rejected(NOISE, 0, len(text))


def test_every_truncation_keeps_the_whole_frames() -> None:
    """A sentence is whole with its checksum; what there is of its line end belongs to it."""
    stream = PVT + GGA + CORRECTION
    for size in range(len(stream)):
        found = delivered(stream[:size])
        assert found[:1] == [PVT][: size >= len(PVT)]
        assert len(found) == (size >= len(PVT)) + (size >= len(PVT + GGA) - len(b"\r\n"))
        assert all(frame.rstrip() == GGA.rstrip() for frame in found[1:])


LINE_ENDS = (b"\r\n", b"\n", b"\n\n", b"\r\r\n", b"\r\n\r\n", b"\r", b"\n\r", b"\r\r\r\n", b"")


@pytest.mark.parametrize("end", LINE_ENDS, ids=repr)
def test_sentence_may_end_its_line_as_it_likes(end: bytes) -> None:
    """As after an editor, git, or a terminal that was not raw; nothing of it is rejected."""
    sentence = GGA.rstrip() + end
    framer = Framer()
    out = framer.feed(3 * sentence + PVT + sentence) + framer.flush()
    assert all(isinstance(item, Frame) for item in out)
    assert [item.name for item in out if isinstance(item, Frame)] == [
        "GNGGA", "GNGGA", "GNGGA", "NAV-PVT", "GNGGA",
    ]  # fmt: skip
    assert framer.bytes_rejected == framer.bytes_pending == 0
    assert framer.bytes_in == framer.bytes_in_frames
    payloads = {item.payload for item in out if isinstance(item, Frame) and item.protocol == NMEA}
    assert payloads == {GGA[1:-5]}


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.sampled_from([GGA.rstrip(), PVT, b"#"]), st.sampled_from(LINE_ENDS))),
    st.lists(st.integers(0, 400), max_size=8),
)
def test_line_ends_are_the_same_wherever_the_stream_is_cut(
    lines: list[tuple[bytes, bytes]], places: list[int]
) -> None:
    stream = b"".join(line + end for line, end in lines)
    whole, pieces = Framer(), Framer()
    expected = whole.feed(stream) + whole.flush()
    found: list[Frame | Rejected] = []
    for piece in cut(stream, [min(place, len(stream)) for place in places]):
        found += pieces.feed(piece)
    assert found + pieces.flush() == expected
    assert pieces.bytes_rejected == whole.bytes_rejected
    assert pieces.bytes_in == pieces.bytes_in_frames + pieces.bytes_rejected


def test_line_end_is_waited_for_no_longer_than_until_something_else_comes() -> None:
    framer = Framer()
    assert framer.feed(GGA.rstrip()) == []
    assert framer.bytes_pending == len(GGA.rstrip())
    (first,) = framer.feed(b"\xb5")
    assert isinstance(first, Frame)
    assert first.raw == GGA.rstrip()


@pytest.mark.parametrize("size", [84, 92])
def test_message_may_have_the_length_of_any_of_its_forms(size: int) -> None:
    """NAV-PVT of u-blox 7 has 84 bytes (GPS.G7-SW-12001, 35.15), since u-blox 8 it has 92."""
    frame = ubx_frame(NAV_PVT, bytes(size))
    assert delivered(frame + PVT) == [frame, PVT]


@given(st.binary(max_size=1026))
def test_crc24q_agrees_with_pyrtcm(data: bytes) -> None:
    assert crc24q(data) == calc_crc24q(data)


@given(st.binary(max_size=3000))
def test_fletcher_checksum_agrees_with_pyubx2(payload: bytes) -> None:
    frame = ubx_frame(UNKNOWN, payload)
    assert frame[-2:] == calc_checksum(frame[2:-2])


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_any_cut_of_a_capture_gives_the_same(data_dir: Path, name: str) -> None:
    data = (data_dir / "ubx" / name).read_bytes()
    whole = run([data])
    rng = np.random.default_rng(7)
    for cuts in (10, 3000):
        assert run(cut(data, rng.integers(0, len(data), cuts).tolist())) == whole
    start = int(rng.integers(0, len(data) - 20_000))
    piece = data[start : start + 20_000]
    assert run([piece[i : i + 1] for i in range(len(piece))]) == run([piece])


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_flipped_bits_cost_no_intact_frame(data_dir: Path, name: str) -> None:
    """One bit in 10,000 is flipped; every frame without a flipped bit arrives, in its place."""
    data = (data_dir / "ubx" / name).read_bytes()
    clean = [item for item in run([data]) if isinstance(item, Frame)]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        bits = np.unique(rng.integers(0, len(data) * 8, round(len(data) * 8 / 10_000)))
        spoilt = np.frombuffer(data, np.uint8).copy()
        np.bitwise_xor.at(spoilt, bits // 8, (1 << bits % 8).astype(np.uint8))
        hit = np.zeros(len(data) + 1, np.int64)
        hit[1:] = np.cumsum(np.bincount(bits // 8, minlength=len(data)))
        intact = {(f.end, f.raw) for f in clean if hit[f.end + 1] == hit[f.start]}
        got = {(f.end, f.raw) for f in run([spoilt.tobytes()]) if isinstance(f, Frame)}
        assert intact <= got
        assert len(intact) < len(clean)  # the flips did hit frames
