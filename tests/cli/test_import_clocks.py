"""Sources of an import whose clocks differ, and files in which nothing decodes."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tramstream import keys
from tramstream.analysis.tables.clocks import parse_offset
from tramstream.bridges.imu import framer as adis
from tramstream.cli.main import make_app
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import rerun

UTC_S = 1_710_000_000
DBC = """VERSION ""

BU_: ECU

BO_ 256 WHEEL_SPEEDS: 8 ECU
 SG_ WHEEL_SPEED_FL : 0|16@1+ (0.01,0) [0|655] "km/h" ECU
"""


def sentence(body: str) -> bytes:
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n".encode()


def nmea(path: Path, seconds: int = 20, date: str = "090324", minute: int = 0) -> Path:
    """A receiver that stands at one place, a fix a second."""
    data = b""
    for number in range(seconds):
        time = f"12{minute:02d}{number:02d}.00"
        data += sentence(f"GPRMC,{time},A,5004.5300,N,01426.2680,E,1.0,0.0,{date},,,A") + sentence(
            f"GPGGA,{time},5004.5300,N,01426.2680,E,1,09,0.9,200.0,M,45.0,M,,"
        )
    path.write_bytes(data)
    return path


def candump(path: Path, start_s: float, seconds: int = 20) -> Path:
    lines = [
        f"({start_s + step / 10:.6f}) can0 100#{struct.pack('<H', 1000 + step).hex()}000000000000"
        for step in range(10 * seconds)
    ]
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".dbc").write_text(DBC)
    return path


def run(*arguments: object) -> None:
    """Import; what it refuses is raised."""
    result = CliRunner().invoke(make_app("import"), ["import", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output


def spans(path: Path) -> dict[str, tuple[int, int]]:
    found: dict[str, list[int]] = {}
    with open_record(path) as record:
        for entry, message in record.decoded():
            stamp_ns = getattr(message, "stamp_ns", entry.log_ns)
            found.setdefault(keys.split(entry.topic)[1], []).append(stamp_ns)
    return {path: (min(each), max(each)) for path, each in found.items()}


def test_captures_on_clocks_of_different_years_are_refused_with_the_offset_that_joins_them(
    tmp_path: Path,
) -> None:
    receiver, bus = nmea(tmp_path / "a.nmea"), candump(tmp_path / "b.candump", 1000.0)
    out = tmp_path / "o.mcap"
    sources = ("--nmea", receiver, "--can", bus, "--dbc", bus.with_suffix(".dbc"), "-o", out)
    with pytest.raises(ConfigError, match="share no instant") as refused:
        run(*sources)
    assert not list(tmp_path.glob("o.mcap*"))
    assert "2024-03-09 12:00" in str(refused.value)
    assert "1970-01-01 00:16" in str(refused.value)
    offset = refused.value.cure.partition("--offset-s ")[2].split()[0]
    assert offset.startswith("can=")
    run(*sources, "--offset-s", offset)
    found = spans(out)
    assert abs(found[keys.GNSS_FIX.path][0] - found[keys.ODO_WHEELS.path][0]) < 2 * S
    assert rerun(out, tmp_path / "r.mcap", None).duration_s < 60


def test_stated_offset_moves_everything_of_its_source(tmp_path: Path) -> None:
    bus = candump(tmp_path / "b.candump", 1000.0)
    alone = tmp_path / "alone.mcap", tmp_path / "later.mcap"
    run("--can", bus, "--dbc", bus.with_suffix(".dbc"), "-o", alone[0])
    run("--can", bus, "--dbc", bus.with_suffix(".dbc"), "-o", alone[1], "--offset-s", "can=2.5")
    one, two = spans(alone[0]), spans(alone[1])
    for path in (keys.ODO_FRAMES.path, keys.ODO_WHEELS.path):
        assert [b - a for a, b in zip(one[path], two[path], strict=True)] == [5 * S // 2] * 2


def test_offset_of_a_source_that_is_not_imported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--offset-s imu"):
        run("--nmea", nmea(tmp_path / "a.nmea"), "-o", tmp_path / "o", "--offset-s", "imu=1")


@pytest.mark.parametrize("text", ["imu", "imu=", "imu=x", "imu=nan", "imu=1e300", "wheel=3", "=3"])
def test_offset_that_does_not_read_so_is_refused_with_the_names(text: str) -> None:
    with pytest.raises(ConfigError, match="can, gnss, imu"):
        parse_offset(text)


def test_ride_of_a_receiver_whose_first_date_is_wrong_ends_in_its_own_time(tmp_path: Path) -> None:
    first = nmea(tmp_path / "first.nmea", 8, date="060180").read_bytes()
    receiver = tmp_path / "a.nmea"
    receiver.write_bytes(first + nmea(tmp_path / "then.nmea", 20, minute=1).read_bytes())
    run("--nmea", receiver, "-o", tmp_path / "o.mcap")
    assert rerun(tmp_path / "o.mcap", tmp_path / "r.mcap", None).duration_s < 120


@pytest.mark.parametrize(
    ("option", "content", "cure"),
    [
        ("--ubx", b"no receiver says this\n" * 50, "baud rate"),
        ("--nmea", sentence("GPXXX,1,2")[:-4] + b"00\r\n", "baud rate"),
        ("--adis", bytes(10 * adis.FRAME_LENGTH), "docs/imu-framing.md"),
        ("--can", b"(1000.0) can0 7FF#00\n", "DBC"),
        ("--can", b"  can0  100   [8]  00 01 02 03 04 05 06\n" * 20 + b"nothing", "candump -L"),
    ],
)
def test_file_in_which_nothing_decodes_ends_with_2_and_the_cure(
    tmp_path: Path, option: str, content: bytes, cure: str
) -> None:
    source, dbc = tmp_path / "a.bin", tmp_path / "a.dbc"
    source.write_bytes(content)
    dbc.write_text(DBC)
    more = ("--dbc", dbc) if option == "--can" else ()
    with pytest.raises(ConfigError, match=r"nothing in it decodes|none of its") as refused:
        run(option, source, *more, "-o", tmp_path / "o.mcap")
    assert refused.value.exit_status == 2
    assert cure in str(refused.value)
    assert str(source) in str(refused.value)
    assert not list(tmp_path.glob("o.mcap*"))
