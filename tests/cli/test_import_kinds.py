"""Captures as people have them: other units, other buses, other clocks; inputs made here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tramstream import keys
from tramstream.analysis.tables.captures import Imports
from tramstream.bridges.gnss.clock import GPS_EPOCH_UNIX_S
from tramstream.bridges.imu import framer
from tramstream.bridges.odometer.j1939 import NOT_AVAILABLE
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.recorder.reader import open_record

UTC_S = 1_709_640_000  # 2024-03-05 12:00:00, GPS − UTC = 18 s
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECU\n'
GNSS = """[clock]
kind = "gps"
[[tables]]
kind = "gnss"
file = "fixes.csv"
time = {{ column = "t", unit = "s" }}
position = {{ frame = "geodetic", columns = ["lat", "lon", "h"], unit = "deg" }}
horizontal_std = {{ values = [1.0], unit = "m" }}
vertical_std = {{ value = 1.0, unit = "m" }}
[vehicle]
vehicle = "t"
"""


def dbc(folder: Path, unit: str, name: str = "WHEEL_SPEED_FL") -> Path:
    path = folder / "wheels.dbc"
    path.write_text(
        f'{HEAD}BO_ 170 SPEEDS: 8 ECU\n SG_ {name} : 7|16@0+ (0.01,0) [0|250] "{unit}" ECU\n',
        encoding="cp1252",
    )
    return path


def log(folder: Path, count: int = 50, interfaces: int = 1, start_s: float = UTC_S) -> Path:
    path = folder / "bus.candump"
    path.write_text(
        "".join(
            f"({start_s + k * 0.02:.6f}) can{k % interfaces} 0AA#{100 * k:04X}000000000000\n"
            for k in range(count)
        )
    )
    return path


def imported(out: Path, **sources: Any) -> dict[str, list[Any]]:
    """Messages by key of an import; `can` and so on are the arguments of `Imports`."""
    imports = Imports(None, "", "ADIS16465-1", sources.pop("offsets", None))
    if "tables" in sources:
        from tramstream.analysis.tables.tables import Tables

        imports.tables(Tables(sources["tables"], [], []))
    if "adis" in sources:
        imports.imu(sources["adis"])
    if "can" in sources:
        imports.can(*sources["can"])
    imports.write(out)
    found: dict[str, list[Any]] = {}
    with open_record(out) as record:
        for each in record.messages():
            found.setdefault(keys.split(each.topic)[1], []).append(record.decode(each))
    return found


def fixes(folder: Path, start_s: float, count: int = 5) -> Path:
    rows = "".join(f"{start_s - GPS_EPOCH_UNIX_S + k},50.0,14.4,200\n" for k in range(count))
    (folder / "fixes.csv").write_text(f"t,lat,lon,h\n{rows}")
    path = folder / "fixes.toml"
    path.write_text(GNSS.format())
    return path


def imu(folder: Path, sequence: list[int], stamp_us: list[int]) -> Path:
    ones = np.ones((len(sequence), 3))
    path = folder / "imu.bin"
    path.write_bytes(framer.encode(np.array(stamp_us), np.array(sequence), ones, ones))
    return path


# units --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["KPH", "KM/H", "Kph", "km/h", "km/hr"])
@pytest.mark.parametrize("named", [True, False])
def test_speed_in_any_spelling_is_a_speed(tmp_path: Path, unit: str, named: bool) -> None:
    wheels = ["left=SPEEDS.WHEEL_SPEED_FL"] if named else []
    found = imported(tmp_path / "o.mcap", can=(log(tmp_path), dbc(tmp_path, unit), wheels))
    readings = found[keys.ODO_WHEELS.path]
    assert [each.wheels[0].speed_mps for each in readings] == pytest.approx(
        [k / 3.6 for k in range(50)]
    )
    assert not any(each.wheels[0].HasField("pulses") for each in readings)


@pytest.mark.parametrize("unit", ["rpm", "deg/s", ""])
def test_wheel_in_a_unit_that_nobody_knows_is_refused_with_the_cure(
    tmp_path: Path, unit: str
) -> None:
    imports = Imports(None, "", "ADIS16465-1")
    with pytest.raises(ConfigError, match=r"the unit '.*'.*WHEEL_SPEED_FL:km/h"):
        imports.can(log(tmp_path), dbc(tmp_path, unit), ["left=SPEEDS.WHEEL_SPEED_FL"])
    wheels = ["left=SPEEDS.WHEEL_SPEED_FL:m/s"]
    found = imported(tmp_path / "o.mcap", can=(log(tmp_path), dbc(tmp_path, unit), wheels))
    assert found[keys.ODO_WHEELS.path][7].wheels[0].speed_mps == pytest.approx(7.0)


# clocks -------------------------------------------------------------------------------------------


def test_one_instant_of_utc_and_of_gps_has_one_stamp(tmp_path: Path) -> None:
    """A receiver that says UTC_S in GPS time, 18 s later in GPS than the bus' UTC of that name."""
    found = imported(
        tmp_path / "o.mcap",
        tables=fixes(tmp_path, UTC_S + 18),
        can=(log(tmp_path, 250), dbc(tmp_path, "m/s"), []),
    )
    assert found[keys.GNSS_FIX.path][0].stamp_ns == found[keys.ODO_WHEELS.path][0].stamp_ns
    assert found[keys.GNSS_FIX.path][0].utc_ns == UTC_S * S


def test_capture_that_counts_from_its_start_is_refused_until_its_offset_is_stated(
    tmp_path: Path,
) -> None:
    sources = {
        "tables": fixes(tmp_path, UTC_S),
        "adis": imu(tmp_path, list(range(4000)), [500 * k for k in range(4000)]),
    }
    with pytest.raises(
        ConfigError, match=r"share no instant: .*--offset-s imu=\d+\.\d+ makes both"
    ):
        imported(tmp_path / "o.mcap", **sources)
    offsets = {"imu": UTC_S * S}
    found = imported(tmp_path / "p.mcap", offsets=offsets, **sources)
    assert found[keys.IMU_BATCH.path][0].stamp_ns == pytest.approx((UTC_S + 1) * S, abs=10**7)
    assert found[keys.GNSS_FIX.path][0].stamp_ns == UTC_S * S


def test_frame_ahead_of_its_time_costs_one_reading(tmp_path: Path) -> None:
    path = log(tmp_path, 300)
    lines = path.read_text().splitlines()
    lines[100] = (
        lines[100].replace(f"({UTC_S}", f"({UTC_S + 5}").replace(f"({UTC_S + 2}", f"({UTC_S + 9}")
    )
    path.write_text("\n".join(lines))
    readings = imported(tmp_path / "o.mcap", can=(path, dbc(tmp_path, "m/s"), []))[
        keys.ODO_WHEELS.path
    ]
    assert len(readings) == 299
    assert len({each.stamp_ns for each in readings}) == 299


def test_clock_that_steps_back_costs_no_reading(tmp_path: Path) -> None:
    path = log(tmp_path, 300)
    behind = log(tmp_path, 300, start_s=UTC_S - 40).read_text()
    ahead = "".join(
        f"({UTC_S + k * 0.02:.6f}) can0 0AA#{100 * k:04X}000000000000\n" for k in range(300)
    )
    path.write_text(ahead + behind)
    readings = imported(tmp_path / "o.mcap", can=(path, dbc(tmp_path, "m/s"), []))[
        keys.ODO_WHEELS.path
    ]
    steps = np.diff([each.stamp_ns for each in readings])
    assert len(readings) == 600
    assert np.abs(steps - 20_000_000).max() < 2000


# buses and frames ---------------------------------------------------------------------------------


def test_two_buses_are_told_apart_in_the_record(tmp_path: Path) -> None:
    path = log(tmp_path, 40, interfaces=2)
    with pytest.raises(ConfigError, match="--bus can0"):
        imported(tmp_path / "o.mcap", can=(path, dbc(tmp_path, "m/s"), []))
    found = imported(tmp_path / "p.mcap", can=(path, dbc(tmp_path, "m/s"), [], "can1"))
    speeds = [each.wheels[0].speed_mps for each in found[keys.ODO_WHEELS.path]]
    assert speeds == pytest.approx(list(range(1, 40, 2)))
    frames = found[keys.ODO_FRAMES.path]
    count = {bus: sum(len(f.id) for f in frames if f.device == bus) for bus in ("can0", "can1")}
    assert count == {"can0": 20, "can1": 20}


def test_bus_is_that_of_the_configuration_where_there_is_one(tmp_path: Path) -> None:
    path = log(tmp_path, 40, interfaces=2)
    dbc(tmp_path, "m/s")
    config = tmp_path / "tram.toml"
    config.write_text(
        'vehicle = "t"\n[odometer]\nchannel = "can1"\ndbc = "wheels.dbc"\n'
        '[odometer.wheels.left]\nmessage = "SPEEDS"\nsignal = "WHEEL_SPEED_FL"\nkind = "speed"\n'
    )
    imports = Imports(config, "", "ADIS16465-1")
    imports.can(path, None, [])
    imports.write(tmp_path / "o.mcap")
    with open_record(tmp_path / "o.mcap") as record:
        readings = [
            record.decode(each)
            for each in record.messages(lambda topic: topic.endswith(keys.ODO_WHEELS.path))
        ]
    assert [each.wheels[0].speed_mps for each in readings] == pytest.approx(list(range(1, 40, 2)))


def test_log_as_candump_shows_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "view.txt"
    path.write_text(
        "".join(
            f" ({UTC_S + k * 0.02:.6f})  can0  0AA   [8]  {k:02X} 00 00 00 00 00 00 00\n"
            for k in range(20)
        )
    )
    readings = imported(tmp_path / "o.mcap", can=(path, dbc(tmp_path, "m/s"), []))[
        keys.ODO_WHEELS.path
    ]
    assert [each.wheels[0].speed_mps for each in readings] == pytest.approx(
        [2.56 * k for k in range(20)]
    )


@pytest.mark.parametrize("source", [0x00, 0x17])
def test_sender_whom_the_dbc_does_not_name_is_read(tmp_path: Path, source: int) -> None:
    path = tmp_path / "j.dbc"
    path.write_text(
        f"{HEAD}BO_ {0x98FEF1FE} CCVS1: 8 ECU\n"
        ' SG_ WheelSpeed : 8|16@1+ (0.00390625,0) [0|250] "km/h" ECU\n'
    )
    capture = tmp_path / "j.candump"
    capture.write_text(
        "".join(
            f"({UTC_S + k / 10:.6f}) can0 18FEF1{source:02X}#FF00{k:02X}FFFFFFFFFF\n"
            for k in range(20)
        )
    )
    readings = imported(tmp_path / "o.mcap", can=(capture, path, []))[keys.ODO_WHEELS.path]
    speeds = [3.6 * each.wheels[0].speed_mps for each in readings]
    assert speeds == pytest.approx(list(range(20)))


def test_log_of_which_no_value_is_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "j.dbc"
    path.write_text(
        f"{HEAD}BO_ {0x98FEF1FE} CCVS1: 8 ECU\n"
        ' SG_ WheelSpeed : 8|16@1+ (0.00390625,0) [0|250] "km/h" ECU\n'
    )
    capture = tmp_path / "j.candump"
    capture.write_text(f"({UTC_S}.000000) can0 18FEF100#FFFFFFFFFFFFFFFF\n" * 3)
    with pytest.raises(ConfigError, match=f"none can be used .*3 {NOT_AVAILABLE[:13]}"):
        Imports(None, "", "ADIS16465-1").can(capture, path, [])


# inertial captures --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sequence", "stamp_us"),
    [
        ([0x11170, 0x1011171, 0x11172], [0, 1, 1000]),
        ([0, 1, 2], [0, 2**31, 2**31 + 1]),
        ([5, 4, 3, 2], [4, 3, 2, 1]),
        ([0, 2**31, 2**32 - 1], [0, 0, 0]),
        ([0, 1, 2, 3], [0, 3_000_000, 6_000_000, 9_000_000]),
    ],
)
def test_numbers_that_jump_are_restarts_and_no_stamp_is_before_time(
    tmp_path: Path, sequence: list[int], stamp_us: list[int]
) -> None:
    found = imported(tmp_path / "o.mcap", adis=imu(tmp_path, sequence, stamp_us))
    batches = found[keys.IMU_BATCH.path]
    assert sum(len(each.gyro_x) for each in batches) == len(sequence)
    assert all(0 <= each.stamp_ns < 30 * S for each in batches)


def test_device_that_was_started_again_does_not_let_time_pass(tmp_path: Path) -> None:
    """Its stamp falls back, which 32 bits alone would take for 71 minutes."""
    runs = list(range(2000))
    stamps = [10**9 + 500 * k for k in runs] + [77 + 500 * k for k in runs]
    found = imported(tmp_path / "o.mcap", adis=imu(tmp_path, runs + runs, stamps))
    batches = found[keys.IMU_BATCH.path]
    assert sum(len(each.gyro_x) for each in batches) == 4000
    lasts_s = (batches[-1].stamp_ns - batches[0].stamp_ns) / S
    assert lasts_s == pytest.approx(2.0, abs=0.05)
