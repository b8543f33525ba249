"""Lines of candump, frames and error classes."""

from __future__ import annotations

from itertools import pairwise

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.bridges.odometer.candump import (
    LOCAL_DATE,
    NO_LINE,
    NO_STAMP,
    format_line,
    parse_line,
)
from tramstream.bridges.odometer.frames import (
    DATA_LENGTHS,
    ERROR,
    EXTENDED,
    FD,
    GARBLED,
    HOST_OVERFLOW,
    REMOTE,
    CanFrame,
    Content,
    Rejected,
    SlcanLines,
    classify_error,
    host_overflow,
    pack,
)
from tramstream.bridges.odometer.slcan import encode_frame


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1.5) can0 0AA#1A6F", (1_500_000_000, "can0", 0xAA, 0, b"\x1a\x6f")),
        ("(46408.584930) can0 7ff#", (46_408_584_930_000, "can0", 0x7FF, 0, b"")),
        ("(1.000000001) vcan1 18FF0A31#01", (1_000_000_001, "vcan1", 0x18FF0A31, EXTENDED, b"\1")),
        ("(1.0) can0 123#R", (10**9, "can0", 0x123, REMOTE, b"")),
        ("(1.0) can0 00000123#R8", (10**9, "can0", 0x123, REMOTE | EXTENDED, b"", 8)),
        ("(1.0) can0 123##5112233", (10**9, "can0", 0x123, FD, b"\x11\x22\x33", 5)),
        ("(1.0) can0 20000040#0000000000000000", (10**9, "can0", 0x40, ERROR, bytes(8))),
        ("  (1.0) can0 123#11.22 R\r\n", (10**9, "can0", 0x123, 0, b"\x11\x22")),
        (
            "(1.0) can0 123#1122334455667788_B T",
            (10**9, "can0", 0x123, 0, bytes.fromhex("1122334455667788")),
        ),
    ],
)
def test_line_is_read(line: str, frame: tuple[object, ...]) -> None:
    assert parse_line(line) == CanFrame(*frame)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "line",
    [
        "",
        "# comment",
        "1.0 can0 123#11",
        "(1) can0 123#11",
        "(1.0) can0 12#11",
        "(1.0) can0 123#1",
        "(1.0) can0 123#zz",
        "(1.0) can0 123#112233445566778899",
        "(1.0) can0 123##",
        "(1.0) can0 123##0112233445566778899",
        "(1.0) can0 123#R9",
        "(1.0) can0 123#R12",
        "(1.0) can0 800#11",
        "(1.0) can0 FFFFFFFF#11",
        "(1.0) can0 123",
        "(٣.0) can0 123#11",
        "(1.0) can0 123#11 22",
    ],
)
def test_malformed_line_is_a_value_with_its_reason(line: str) -> None:
    rejected = parse_line(line)
    assert isinstance(rejected, Rejected)
    assert rejected.reason
    assert rejected.text == line.strip()


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (" (1.5)  can0  0AA   [2]  1A 6F", (1_500_000_000, "can0", 0xAA, 0, b"\x1a\x6f")),
        (" (1.5)  can0  0AA   [0] ", (1_500_000_000, "can0", 0xAA, 0, b"")),
        ("(1.5)  vcan0  18FF0A31   [1]  01", (1_500_000_000, "vcan0", 0x18FF0A31, EXTENDED, b"\1")),
        ("(1.5)  can0  RX - -  0AA   [2]  1A 6F", (1_500_000_000, "can0", 0xAA, 0, b"\x1a\x6f")),
        ("(1.5)  can0  TX B E  0AA   [1]  1A", (1_500_000_000, "can0", 0xAA, 0, b"\x1a")),
        ("(1.5)  can0  123   [4]  remote request", (1_500_000_000, "can0", 0x123, REMOTE, b"", 4)),
        ("(1.5)  can0  123  [03]  11 22 33", (1_500_000_000, "can0", 0x123, FD, b"\x11\x22\x33")),
        ("(1.5)  can0  123  [08]  " + "11 " * 8, (1_500_000_000, "can0", 0x123, FD, b"\x11" * 8)),
        ("(1.5)  can0  123  [12]  " + "11 " * 12, (1_500_000_000, "can0", 0x123, FD, b"\x11" * 12)),
        ("(1.5)  can0  123   [2]  41 42   'AB'", (1_500_000_000, "can0", 0x123, 0, b"AB")),
        (
            "(1.5)  can0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME",
            (1_500_000_000, "can0", 0x4, ERROR, b"\0\1" + bytes(6)),
        ),
        (
            "(1.5)  can0  RX - -  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME  '........'",
            (1_500_000_000, "can0", 0x4, ERROR, b"\0\1" + bytes(6)),
        ),
        ("(1.0) can0 98FF0A31#01", (10**9, "can0", 0x18FF0A31, EXTENDED, b"\1")),
    ],
)
def test_line_that_candump_shows_to_people_is_read(line: str, frame: tuple[object, ...]) -> None:
    assert parse_line(line) == CanFrame(*frame)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("  can0  0AA   [2]  1A 6F", NO_STAMP),
        ("can0 0AA#1A6F", NO_STAMP),
        ("  can0  RX - -  18FF0A31   [1]  01", NO_STAMP),
        (" (2023-11-14 22:13:20.000000)  can0  0AA   [2]  1A 6F", LOCAL_DATE),
        ("(99999999999.000000) can0 0AA#1A6F", "its stamp is beyond the year 2262"),
        ("(1.5)  can0  0AA   [3]  1A 6F", "length and data do not agree"),
        ("(1.5)  can0  0AA   [2]  1A 6", "data is not pairs of hexadecimal digits"),
        ("(1.5)  can0  0AA   [9]  " + "1A " * 9, "no frame has this many bytes"),
        ("(1.5)  can0  0AA   [1]  1A   ERRORFRAME", "ERRORFRAME and identifier do not agree"),
        ("(1.5)  can0  FFF   [1]  1A", "identifier has more than 11 bits"),
        ("(1.5) can0 " + "1" * 600, NO_LINE),
    ],
)
def test_shown_line_that_is_no_frame_says_why(line: str, reason: str) -> None:
    assert parse_line(line) == Rejected(reason, line.strip())


@st.composite
def can_frames(draw: st.DrawFn) -> CanFrame:
    kind = draw(st.sampled_from([0, REMOTE, FD, ERROR]))
    wide = kind == ERROR or draw(st.booleans())
    id_ = draw(st.integers(0, 0x1FFFFFFF if wide else 0x7FF))
    length = draw(st.sampled_from(DATA_LENGTHS if kind == FD else DATA_LENGTHS[:9]))
    data = b"" if kind == REMOTE else draw(st.binary(min_size=length, max_size=length))
    nibble = draw(st.integers(0, 8)) if kind in (FD, REMOTE) else 0
    flags = kind | (EXTENDED if wide and kind != ERROR else 0)
    return CanFrame(draw(st.integers(0, 2 * 10**18)), "can0", id_, flags, data, nibble)


@given(can_frames())
def test_writer_and_reader_are_inverse(frame: CanFrame) -> None:
    assert parse_line(format_line(frame)) == frame


@given(st.text(max_size=60))
def test_no_text_raises(text: str) -> None:
    for line in (text, f"(1.0) can0 {text}", f"(1.0) can0 123#{text}"):
        assert isinstance(parse_line(line), CanFrame | Rejected)


@given(can_frames().filter(lambda frame: not frame.flags & FD and frame.flags != ERROR))
def test_lines_are_those_of_python_can(frame: CanFrame) -> None:
    """python-can's own writer of the format, as outside authority."""
    message = can.Message(
        timestamp=1.5,
        arbitration_id=frame.id,
        is_extended_id=bool(frame.flags & EXTENDED),
        is_remote_frame=bool(frame.flags & REMOTE),
        data=None if frame.flags & REMOTE else frame.data,
        dlc=frame.nibble if frame.flags & REMOTE else None,
    )
    with can.CanutilsLogWriter("/dev/null") as writer:
        lines: list[str] = []
        writer.file = Lines(lines)
        writer.on_message_received(message)
    read = parse_line(lines[-1])
    assert isinstance(read, CanFrame)
    assert (read.id, read.flags, read.data) == (frame.id, frame.flags, frame.data)


class Lines:
    """The little of a file that a log writer needs."""

    def __init__(self, lines: list[str]) -> None:
        self.write = lines.append

    def close(self) -> None:
        """Nothing to close."""


@pytest.mark.parametrize(
    ("id_", "data", "name"),
    [
        (0x040, "", "bus-off"),
        (0x004, "0030000000000000", "error passive"),
        (0x004, "0001000000000000", "controller overflow"),
        (0x204, "0004000000000000", "error warning"),
        (0x004, "0040000000000000", "error active again"),
        (0x004, "", "controller"),
        (0x020, "", "no acknowledge"),
        (0x08C, "0010080000000000", "error passive"),
        (0x088, "", "protocol violation"),
        (0x100, "", "controller restarted"),
        (HOST_OVERFLOW, "0000000000000005", "host overflow"),
        (GARBLED, "", "garbled line"),
        (0x00000000, "", "unknown error"),
    ],
)
def test_error_frames_are_named_by_their_worst_class(id_: int, data: str, name: str) -> None:
    """Classes: include/uapi/linux/can/error.h."""
    assert classify_error(id_, bytes.fromhex(data)) == name


def test_packed_frames_keep_their_order_and_arrivals() -> None:
    frames = [
        CanFrame(10, "c", 1, 0, b"a"),
        host_overflow(30, "c", 7),
        CanFrame(25, "c", 2, FD, b""),
    ]
    message = pack(frames, "can0")
    assert (message.stamp_ns, list(message.offset_ns)) == (10, [0, 20, 20])
    assert list(message.id) == [1, HOST_OVERFLOW, 2]
    assert list(message.flags) == [0, ERROR, FD]
    assert list(message.data) == [b"a", (7).to_bytes(8, "big"), b""]
    assert message.device == "can0"


@given(
    st.lists(can_frames().filter(lambda f: not f.flags & FD and f.flags != ERROR), max_size=8),
    st.lists(st.integers(0, 300), max_size=6),
)
def test_slcan_lines_are_read_in_any_split(frames: list[CanFrame], cuts: list[int]) -> None:
    stream = b"\r\az\rV1013\r"
    for frame in frames:
        stream += encode_frame(
            frame.id,
            frame.data,
            extended=bool(frame.flags & EXTENDED),
            remote_length=frame.nibble if frame.flags & REMOTE else None,
        )
    lines, contents = SlcanLines(), []
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    for start, end in pairwise(edges):
        contents += lines.feed(stream[start:end])
    assert contents == [Content(frame.id, frame.flags, frame.data) for frame in frames]


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n", b"\n\r", b"\r\r\n"])
def test_slcan_lines_may_end_as_firmware_likes(end: bytes) -> None:
    for cut in range(1, 20):
        lines = SlcanLines()
        stream = b"t0AA21A6F" + end + b"T18FF0A310" + end
        contents = lines.feed(stream[:cut]) + lines.feed(stream[cut:])
        assert contents == [Content(0xAA, 0, b"\x1a\x6f"), Content(0x18FF0A31, EXTENDED, b"")]


@pytest.mark.parametrize(
    ("line", "content"),
    [
        (b"d0AA21A6F", Content(0xAA, FD, b"\x1a\x6f")),
        (b"D18FF0A3191" + b"1" * 23, Content(0x18FF0A31, FD | EXTENDED, b"\x11" * 12)),
        (b"b0AAF" + b"22" * 64, Content(0xAA, FD, b"\x22" * 64)),
        (b"B18FF0A31F" + b"22" * 64 + b"0001E240", Content(0x18FF0A31, FD | EXTENDED, b'"' * 64)),
        (b"t0AA21A6F1234", Content(0xAA, 0, b"\x1a\x6f")),
        (b"t0AA21A6F0001E240", Content(0xAA, 0, b"\x1a\x6f")),
        (b"r0AA41234", Content(0xAA, REMOTE, b"")),
        (b"t0AA91122334455667788", Content(GARBLED, ERROR, b"t0AA9112")),
        (b"t0AA21A6F12345", Content(GARBLED, ERROR, b"t0AA21A6")),
        (b"tFFF0", Content(GARBLED, ERROR, b"tFFF0")),
    ],
)
def test_slcan_of_can_fd_and_with_stamps_is_read(line: bytes, content: Content) -> None:
    assert SlcanLines().feed(line + b"\r") == [content]


def test_garbled_slcan_lines_are_error_frames_and_the_next_is_read() -> None:
    lines = SlcanLines()
    good = Content(0x123, 0, b"\x11")
    text = b"t1231\rt123111\rt1239\r\xff\xfe\rtXYZ111\rt1231+1\rt1_2111\rt0x1111\rt123111\r"
    ids = [content.id for content in lines.feed(text)]
    assert ids == [GARBLED, 0x123, *[GARBLED] * 6, 0x123]
    assert lines.feed(b"t1231111234\r") == [good]  # with the adapter's time stamp
    assert [c.id for c in lines.feed(b"q" * 5000 + b"\r" + b"t123111\r")] == [GARBLED, 0x123]
    for _ in range(100):
        assert lines.feed(b"q" * 50) == []
    assert [c.id for c in lines.feed(b"\rt123111\r")] == [GARBLED, 0x123]
