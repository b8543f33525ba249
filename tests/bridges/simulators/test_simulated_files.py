"""Captured bytes leave whole and at their own pace."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
import pytest

from tramstream.bridges.gnss import ubx
from tramstream.bridges.odometer import candump
from tramstream.bridges.odometer.frames import CanFrame
from tramstream.bridges.simulators.captures import GnssLog, can_file_stream
from tramstream.bridges.simulators.streams import Chunk
from tramstream.clock import S

START_NS = 1_790_000_000 * S + 123_456_789


def until(stream: Iterator[Chunk], end_s: float) -> list[Chunk]:
    return list(takewhile(lambda chunk: chunk.due_ns < START_NS + end_s * S, stream))


def joined(chunks: list[Chunk]) -> bytes:
    return b"".join(chunk.data for chunk in chunks)


def total(chunks: list[Chunk], of: str) -> Counter[str]:
    counter: Counter[str] = Counter()
    for chunk in chunks:
        counter.update(getattr(chunk, of))
    return counter


def slcan_frames(data: bytes) -> list[tuple[int, bytes]]:
    lines = data.split(b"\r")[:-1]
    return [(int(line[1:4], 16), bytes.fromhex(line[5:].decode())) for line in lines]


def capture(times_s: list[float]) -> bytes:
    """A receiver's log with an epoch at each time of a day in 2026, and text ahead of it."""
    data = b"# Name: made up\n# Second line\n"
    for at_s in times_s:
        itow = round((86_400 * 3 + at_s) * 1000)
        gps = {"iTOW": itow, "week": 2425, "leapS": 18, "valid": 7}
        data += ubx.encode("NAV-TIMEGPS", gps) + ubx.encode("NAV-EOE", {"iTOW": itow})
    return data


def log_of(tmp_path: Path, data: bytes) -> GnssLog:
    path = tmp_path / "capture.ubx"
    path.write_bytes(data)
    return GnssLog.load(path)


def test_capture_leaves_byte_by_byte_at_its_own_pace(tmp_path: Path) -> None:
    data = capture([0.0, 1.0, 2.0, 5.0])
    chunks = list(log_of(tmp_path, data).stream(START_NS, 115_200))
    assert joined(chunks) == data.partition(b"Second line\n")[2]
    assert total(chunks, "counts") == {"frames": 8, "epochs": 4}
    steps = [(b.due_ns - a.due_ns) / S for a, b in pairwise(c for c in chunks if c.counts)]
    assert steps == pytest.approx([1.0, 1.0, 3.0])


def test_capture_jumping_in_time_goes_on_at_its_usual_pace(tmp_path: Path) -> None:
    chunks = list(log_of(tmp_path, capture([0.0, 1.0, 2.0, 9000.0, 9001.0])).stream(0, 115_200))
    steps = [(b.due_ns - a.due_ns) / S for a, b in pairwise(c for c in chunks if c.counts)]
    assert steps == pytest.approx([1.0, 1.0, 1.0, 1.0])


def test_looping_capture_repeats_after_one_more_step(tmp_path: Path) -> None:
    stream = log_of(tmp_path, capture([0.0, 1.0])).stream(START_NS, 115_200, loop=True)
    due = [(chunk.due_ns - START_NS) / S for chunk in until(stream, 7.5) if chunk.counts]
    assert np.diff(due) == pytest.approx([1.0] * 7)


def test_capture_without_times_runs_at_the_speed_of_the_line(tmp_path: Path) -> None:
    chunks = list(log_of(tmp_path, b"\x55" * 11520).stream(START_NS, 115_200))
    assert (chunks[-1].due_ns - START_NS) / S == pytest.approx(1.0)
    assert joined(chunks) == b"\x55" * 11520


def test_empty_capture_says_nothing(tmp_path: Path) -> None:
    assert list(log_of(tmp_path, b"").stream(START_NS, 115_200, loop=True)) == []


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "length_s"),
    [("zed-f9r-drive.ubx", 527), ("ublox-zed-f9p_hpg1.11.log", 655), ("ublox-8.log", 72)],
)
def test_real_capture_takes_as_long_as_its_frames_say(
    data_dir: Path, name: str, length_s: float
) -> None:
    path = data_dir / "ubx" / name
    chunks = list(GnssLog.load(path).stream(START_NS, 460_800))
    assert path.read_bytes().endswith(joined(chunks))
    assert (chunks[-1].due_ns - START_NS) / S == pytest.approx(length_s, abs=2)


def test_candump_leaves_as_slcan_lines_at_its_own_pace(tmp_path: Path) -> None:
    lines = [
        "(100.000000) can0 170#0102030405060708",
        "(100.000500) can0 18FF0A31#01",
        "(100.500000) can0 044#R8",
        "what is this",
        "(101.000000) can0 044##1112233",
        "(101.250000) can0 7FF#",
    ]
    path = tmp_path / "bus.candump"
    path.write_text("\n".join(lines))
    chunks = list(can_file_stream(path, START_NS))
    assert joined(chunks) == b"t17080102030405060708\rT18FF0A31101\rr0448\rt7FF0\r"
    assert total(chunks, "counts") == {"frames": 4, "skipped": 2}
    assert [(c.due_ns - START_NS) / S for c in chunks] == pytest.approx([0.0005, 0.5, 1.25])


def test_looping_candump_repeats_and_one_without_frames_ends(tmp_path: Path) -> None:
    path = tmp_path / "bus.candump"
    path.write_text("(1.0) can0 001#\n(2.0) can0 002#\n")
    frames = joined(until(can_file_stream(path, START_NS, loop=True), 3.5)).split(b"\r")
    assert frames == [b"t0010", b"t0020"] * 3 + [b"t0010", b""]  # 2 ms from end to beginning
    path.write_text("nothing\n")
    assert sum(chunk.counts["frames"] for chunk in can_file_stream(path, START_NS, loop=True)) == 0


@pytest.mark.realdata
def test_real_candump_loses_no_frame_on_the_way(data_dir: Path) -> None:
    path = data_dir / "can" / "rav4_minute.candump"
    expected = [candump.parse_line(line) for line in path.read_text().splitlines()]
    frames = slcan_frames(joined(list(can_file_stream(path, START_NS))))
    assert frames == [(f.id, f.data) for f in expected if isinstance(f, CanFrame)]
