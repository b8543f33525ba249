"""Captures become records: receivers against gpsd, a car's CAN bus against its reference."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tramstream import keys
from tramstream.analysis.tables.captures import Imports
from tramstream.bridges.imu import framer
from tramstream.errors import ConfigError, RecordError
from tramstream.recorder.reader import open_record

CAPTURES = (
    "u-blox-m8t-time.log",
    "ublox-8.log",
    "ublox-neo-m8l.log",
    "ublox-zed-f9p-nmea.log",
    "ublox-zed-f9p_hpg1.11.log",
    "ublox-zed-f9r.log",
    "zed-f9r-drive.ubx",
)
GPS_UNIX_S = 315_964_800


def messages(path: Path, key: keys.Key) -> list[Any]:
    with open_record(path) as record:
        return [record.decode(e) for e in record.messages(lambda t: t.endswith(key.path))]


def imported(source: Path, out: Path) -> dict[str, Any]:
    imports = Imports(None, "", "ADIS16465-1")
    imports.gnss(source)
    return imports.write(out)


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_every_capture_imports_and_keeps_its_bytes(
    name: str, data_dir: Path, tmp_path: Path
) -> None:
    source = data_dir / "ubx" / name
    result = imported(source, tmp_path / "o.mcap")
    assert result["devices"]["gnss"]["messages_decoded"] > 20
    raw = messages(tmp_path / "o.mcap", keys.GNSS_BYTES)
    assert b"".join(message.data for message in raw) == source.read_bytes()
    stamps = [fix.stamp_ns for fix in messages(tmp_path / "o.mcap", keys.GNSS_FIX)]
    assert stamps == sorted(stamps)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["ublox-zed-f9r.log", "ublox-neo-m8l.log"])
def test_positions_from_nav_pvt_are_those_of_gpsd(
    name: str, data_dir: Path, tmp_path: Path
) -> None:
    """Every report that gpsd made of a NAV-PVT has a fix of ours at its time and place.

    The F9R sends no other UBX solution; where gpsd merged NMEA's coarser digits into the epoch, it
    is off by 1.02e-7°. Of the M8L they are the reports that go back in time (its NAV-PVT comes
    later than the HNR-PVT of newer epochs) with status 2; gpsd gives HNR-PVT status 6.
    """
    source = data_dir / "ubx" / name
    imported(source, tmp_path / "o.mcap")
    fixes = {
        round(fix.utc_ns / 1e6): fix
        for fix in messages(tmp_path / "o.mcap", keys.GNSS_FIX)
        if fix.source == "NAV-PVT"
    }
    compared, newest_ms = 0, 0
    for line in source.with_suffix(".log.chk").read_text().splitlines():
        report = json.loads(line) if line.startswith("{") else {}
        if report.get("class") != "TPV" or "lat" not in report:
            continue
        instant = np.datetime64(report["time"].rstrip("Z")).astype("datetime64[ms]")
        time_ms = int(instant.astype(int))
        if "f9r" in name or (time_ms < newest_ms and report["status"] == 2):
            fix = fixes[time_ms]
            assert fix.latitude_deg == pytest.approx(report["lat"], abs=1.02e-7)
            assert fix.longitude_deg == pytest.approx(report["lon"], abs=1.02e-7)
            compared += 1
        newest_ms = max(newest_ms, time_ms)
    assert compared >= 15


@pytest.mark.realdata
def test_stamps_of_an_import_are_gps_time_as_unix_time(data_dir: Path, tmp_path: Path) -> None:
    imported(data_dir / "ubx" / "zed-f9r-drive.ubx", tmp_path / "o.mcap")
    fixes = messages(tmp_path / "o.mcap", keys.GNSS_FIX)
    errors = [f.stamp_ns - (f.gps_time_ns + GPS_UNIX_S * 10**9) for f in fixes]
    assert max(map(abs, errors)) < 10_000  # ns; the receiver's own nano is of that size


@pytest.mark.realdata
def test_wheel_speeds_of_the_car_are_those_of_its_reference(data_dir: Path, tmp_path: Path) -> None:
    imports = Imports(None, "", "ADIS16465-1")
    imports.can(data_dir / "can" / "rav4_minute.candump", data_dir / "can" / "toyota_2017.dbc", [])
    imports.write(tmp_path / "o.mcap")
    readings = messages(tmp_path / "o.mcap", keys.ODO_WHEELS)
    with (data_dir / "can" / "rav4_minute_wheel_speed_mps.csv").open() as file:
        reference = list(csv.DictReader(file))
    assert len(readings) == len(reference)
    for reading, row in zip(readings, reference, strict=True):
        assert reading.stamp_ns == round(float(row["t_s"]) * 1e6) * 1000
        for wheel in reading.wheels:
            expected = float(row[f"{wheel.wheel.rsplit('_', 1)[1]}_mps"])
            assert wheel.speed_mps == pytest.approx(expected, abs=1e-9)


def test_imu_capture_gives_the_samples_and_device_intervals_that_were_written(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(5)
    count = 400
    counts = rng.integers(-3000, 3000, (count, 6)).astype(np.int16)
    capture = tmp_path / "imu.bin"
    capture.write_bytes(
        framer.encode(
            np.arange(count, dtype=np.int64) * 500 + 2**32 - 50_000,  # the stamp wraps on the way
            np.arange(count),
            counts[:, :3],
            counts[:, 3:],
        )
    )
    imports = Imports(None, "bench", "ADIS16465-2")
    imports.imu(capture)
    imports.write(tmp_path / "o.mcap")
    batches = messages(tmp_path / "o.mcap", keys.IMU_BATCH)
    assert [len(batch.gyro_x) for batch in batches] == [20] * 20
    assert [x for batch in batches for x in batch.accel_z] == counts[:, 5].tolist()
    spacing = np.diff([batch.stamp_ns for batch in batches])
    assert np.all(np.abs(spacing - 10_000_000) < 2_000)


def test_wheel_that_the_dbc_has_not_is_refused_by_name(tmp_path: Path) -> None:
    from tramstream.bridges.simulators.streams import DBC_PATH

    capture = tmp_path / "log.candump"
    capture.write_text("(1.000000) can0 110#0100010000\n")
    imports = Imports(None, "", "ADIS16465-1")
    with pytest.raises(ConfigError, match="PULSES_LEFTT"):
        imports.can(capture, Path(DBC_PATH), ["left=WHEELS.PULSES_LEFTT"])


def test_absent_capture_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"nothing\.ubx: cannot be read"):
        Imports(None, "", "ADIS16465-1").gnss(tmp_path / "nothing.ubx")


def test_lines_that_are_no_frames_are_counted(tmp_path: Path) -> None:
    from tramstream.bridges.simulators.streams import DBC_PATH

    capture = tmp_path / "log.candump"
    capture.write_text("(1.000000) can0 110#0100010000\nnoise\n(1.020000) can0 110#0100010001\n")
    imports = Imports(None, "", "ADIS16465-1")
    imports.can(capture, Path(DBC_PATH), ["left=WHEELS.PULSES_LEFT"])
    result = imports.write(tmp_path / "o.mcap")
    assert result["malformed_lines"] == 1
    assert result["messages"][keys.ODO_WHEELS.path] == 2


def test_output_never_replaces_what_it_is_made_from(tmp_path: Path) -> None:
    from tramstream.cli.terminal.session import make_room

    source = tmp_path / "ride.mcap"
    source.write_bytes(b"ride")
    (tmp_path / "link.mcap").symlink_to(source)
    for out, of in ((source, source), (tmp_path / "link.mcap", source), (source, tmp_path)):
        with pytest.raises(ConfigError, match="choose another --out"):
            make_room(out, [of], overwrite=True)
    assert source.read_bytes() == b"ride"
    other = tmp_path / "old.mcap"
    other.write_bytes(b"old")
    make_room(other, [source], overwrite=True)
    assert not other.exists()
