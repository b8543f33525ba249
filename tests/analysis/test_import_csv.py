"""Tables become records by a mapping file: units, frames, clocks, gaps, dirt, two real drives."""

from __future__ import annotations

import csv
import json
import math
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tramstream import config_file, keys
from tramstream.analysis.tables import mapping as table_mapping
from tramstream.analysis.tables import units as table_units
from tramstream.analysis.tables.captures import Imports
from tramstream.analysis.tables.imu import MAX_JITTER, even_stretches
from tramstream.analysis.tables.reader import increasing
from tramstream.analysis.tables.tables import Tables, find_files, parse_cut
from tramstream.attitude import C_vl
from tramstream.cli.main import make_app
from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel, ecef_from_geodetic
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import rerun

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs" / "import-tables.md"
MM = 1e-3
NS = 1e-9
START_NS = 1_700_000_000_000_000_000
RELATIVE = '[clock]\nkind = "relative"\nstart = "2023-11-14T22:13:20"\n'
"""Second zero is START_NS."""

IMU = """
[[tables]]
kind = "imu"
file = "imu.csv"
time = { column = "t", unit = "s" }
gyro = { columns = ["wx", "wy", "wz"], unit = "rad/s" }
accel = { columns = ["ax", "ay", "az"], unit = "m/s2" }
[vehicle]
vehicle = "test"
imu = { device = "imu.csv", rate_hz = 100, batch = 10 }
resampler = { factor = 1, max_bridge_samples = 5 }
"""
GNSS = """
[[tables]]
kind = "gnss"
file = "gnss.csv"
time = { column = "t", unit = "s" }
position = { frame = "geodetic", columns = ["lat", "lon", "h"], unit = "deg" }
horizontal_std = { values = [0.3, 0.4], unit = "m" }
vertical_std = { value = 70, unit = "cm" }
"""
GNSS_ROWS = "t,lat,lon,h\n0,50,14,200\n1,50.0001,14.0001,201\n"
ODOMETRY = """
[[tables]]
kind = "odometry"
file = "odo.csv"
time = { column = "t", unit = "s" }
wheels.left = { column = "v", unit = "km/h" }
"""
TRUTH = """
[[tables]]
kind = "truth"
file = "truth.csv"
time = { column = "t", unit = "s" }
position = { frame = "ecef", columns = ["x", "y", "z"], unit = "m" }
"""


class Desk:
    """A folder with tables and a mapping."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "o.mcap"

    def put(self, mapping: str, **tables: str) -> None:
        (self.folder / "m.toml").write_text(mapping, encoding="utf-8")
        for name, text in tables.items():
            (self.folder / f"{name}.csv").write_text(text, encoding="utf-8")

    def run(self, *cuts: tuple[float, float]) -> dict[str, Any]:
        self.out.unlink(missing_ok=True)
        imports = Imports(None, "", "ADIS16465-1")
        imports.tables(Tables(self.folder / "m.toml", [], list(cuts)))
        return imports.write(self.out)

    def messages(self, key: keys.Key) -> list[Any]:
        return messages(self.out, key)

    def refused(self) -> str:
        with pytest.raises(ConfigError) as caught:
            self.run()
        assert str(caught.value).startswith(str(self.folder / "m.toml"))
        return str(caught.value)


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def messages(path: Path, key: keys.Key) -> list[Any]:
    with open_record(path) as record:
        return [record.decode(e) for e in record.messages(lambda t: t.endswith(key.path))]


def imu_rows(stamps_s: list[float] | np.ndarray, values: np.ndarray | None = None) -> str:
    values = np.tile([0, 0, 0, 0, 0, 9.8], (len(stamps_s), 1)) if values is None else values
    lines = ["t,wx,wy,wz,ax,ay,az"]
    for stamp_s, row in zip(stamps_s, values, strict=True):
        lines.append(",".join([f"{stamp_s:.9f}", *(f"{value:.4f}" for value in row)]))
    return "\n".join(lines)


def samples(batches: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps in ns and values in SI of all samples."""
    stamps, values = [], []
    for batch in batches:
        columns = np.array([batch.gyro_x, batch.gyro_y, batch.gyro_z, batch.accel_x,
                            batch.accel_y, batch.accel_z], float)  # fmt: skip
        columns[:3] *= batch.gyro_scale_radps
        columns[3:] *= batch.accel_scale_mps2
        stamps += [batch.stamp_ns + batch.period_ns * k for k in range(len(batch.gyro_x))]
        values.append(columns.T)
    return np.array(stamps), np.concatenate(values)


# Inertial rows ------------------------------------------------------------------------------------
def test_inertial_rows_come_back_to_the_digit_in_batches_of_the_configuration(desk: Desk) -> None:
    written = np.random.default_rng(1).normal(0, 5, (95, 6)).round(4)
    desk.put(RELATIVE + IMU, imu=imu_rows(np.arange(95) / 100, written))
    result = desk.run()
    batches = desk.messages(keys.IMU_BATCH)
    assert [len(batch.gyro_x) for batch in batches] == [10] * 9 + [5]
    assert [batch.first_sample_sequence for batch in batches] == list(range(0, 95, 10))
    stamps, values = samples(batches)
    np.testing.assert_allclose(stamps, START_NS + np.arange(95) * 10_000_000, rtol=0, atol=256)
    np.testing.assert_allclose(values, written, rtol=1e-15, atol=0)
    assert result["tables"][0]["rate_hz"] == pytest.approx(100, rel=1e-12)


@pytest.mark.parametrize(
    ("gyro", "accel", "factors"),
    [
        ("deg/s", "g", (math.pi / 180, 9.80665)),
        ("mdeg/s", "mg", (math.pi / 180e3, 9.80665e-3)),
        ("mrad/s", "m/s2", (1e-3, 1.0)),
    ],
)
def test_inertial_units_are_scales_of_integers(
    gyro: str, accel: str, factors: tuple[float, float], desk: Desk
) -> None:
    mapping = RELATIVE + IMU.replace('"rad/s"', f'"{gyro}"').replace('"m/s2"', f'"{accel}"')
    desk.put(mapping, imu=imu_rows([0, 0.01, 0.02], np.tile([0.25, 1, -2, 0, 0.5, 1.001], (3, 1))))
    desk.run()
    (batch,) = desk.messages(keys.IMU_BATCH)
    assert (batch.gyro_x[0], batch.gyro_y[0], batch.gyro_z[0]) == (25, 100, -200)
    assert (batch.accel_x[0], batch.accel_y[0], batch.accel_z[0]) == (0, 500, 1001)
    assert batch.gyro_scale_radps == pytest.approx(factors[0] / 100, rel=1e-15)
    assert batch.accel_scale_mps2 == pytest.approx(factors[1] / 1000, rel=1e-15)


def test_digits_that_do_not_fit_into_32_bits_are_rounded(desk: Desk) -> None:
    text = "t,wx,wy,wz,ax,ay,az\n" + "".join(
        f"{0.01 * k},0.123456789012345,-1.9,0,0,0,9.80665123456789\n" for k in range(3)
    )
    desk.put(RELATIVE + IMU, imu=text)
    desk.run()
    _, values = samples(desk.messages(keys.IMU_BATCH))
    np.testing.assert_allclose(values[0, 0], 0.123456789012345, atol=0.5e-9)
    np.testing.assert_allclose(values[0, 5], 9.80665123456789, atol=0.5e-8)


def test_rounded_stamps_are_put_back_on_an_even_line(desk: Desk) -> None:
    even_s = 10 + 0.010003 * np.arange(3000)
    desk.put(RELATIVE + IMU, imu=imu_rows(even_s.round(3)))
    told = desk.run()["tables"][0]
    stamps, _ = samples(desk.messages(keys.IMU_BATCH))
    np.testing.assert_allclose((stamps - START_NS) * NS, even_s, rtol=0, atol=0.05 * MM)
    assert told["jitter_s"] == pytest.approx(0.5 * MM, abs=0.05 * MM)
    assert told["rate_hz"] == pytest.approx(1 / 0.010003, rel=1e-5)


def test_gap_is_counted_in_samples_and_bridged_or_marked_by_the_resampler(desk: Desk) -> None:
    kept = [k for k in range(400) if not 103 <= k < 106 and not 200 <= k < 250]
    desk.put(RELATIVE + IMU, imu=imu_rows([k / 100 for k in kept]))
    desk.run()
    rerun(desk.out, desk.folder / "r.mcap", None)
    gaps = messages(desk.folder / "r.mcap", keys.SYNC_GAP)
    found = [(gap.first_missing, gap.missing_count, gap.bridged) for gap in gaps]
    assert found == [(103, 3, True), (200, 50, False)]
    means = messages(desk.folder / "r.mcap", keys.SYNC_IMU)
    assert len(means) == 350
    wanted = [START_NS + k * 10_000_000 for k in range(400) if not 200 <= k < 250]
    np.testing.assert_allclose([mean.stamp_ns for mean in means], wanted, rtol=0, atol=256)


def test_stretch_that_wanders_is_cut_until_lines_are_near() -> None:
    period_ns = 1e7
    wandering_ns = np.cumsum(period_ns * (1 + 0.02 * np.sin(np.arange(2000) / 100)))
    found = list(even_stretches(wandering_ns, period_ns))
    assert [each.start for each in found[1:]] == [each.stop for each in found[:-1]]
    assert len(found) < 20
    for each in found:
        line = each.first_ns + each.period_ns * np.arange(each.stop - each.start)
        assert np.abs(line - wandering_ns[each.start : each.stop]).max() <= MAX_JITTER * period_ns


def test_configuration_with_another_rate_is_refused_with_the_right_one(desk: Desk) -> None:
    desk.put(RELATIVE + IMU.replace("rate_hz = 100, ", ""), imu=imu_rows(np.arange(50) / 100))
    assert "$.vehicle.imu.rate_hz: is 2000" in desk.refused()
    assert "write rate_hz = 100" in desk.refused()


# Clocks -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("clock", "time", "cell", "dated"),
    [
        ("kind = 'gps_week'\nweek = 2288", "unit = 's'", "252800.25", True),
        ("kind = 'gps_week'\ndate = '2023-11-18'", "unit = 'ms'", "252800250", True),
        ("kind = 'gps'", "unit = 's'", "1384035200.25", True),
        ("kind = 'utc'", "unit = 's'", "1699999982.25", True),
        ("kind = 'utc'", "unit = 'us'", "1699999982250000", True),
        ("kind = 'utc'", "unit = 'datetime'", "2023-11-14T22:13:02.25Z", True),
        ("kind = 'utc'", "unit = 'datetime'", "2023/11/14 23:13:02.250+01:00", True),
        ("kind = 'gps'", "unit = 'datetime'", "2023-11-14 22:13:20.25", True),
        ("kind = 'relative'\nstart = '2023-11-14T22:13:20'", "unit = 's'", "2.5e-1", False),
        ("kind = 'utc'", "unit = 's', offset_s = -2.0", "1699999984.25", True),
    ],
)
def test_every_clock_leads_to_gps_time_as_unix_time(
    clock: str, time: str, cell: str, dated: bool, desk: Desk
) -> None:
    mapping = f"[clock]\n{clock}\n" + GNSS.replace(
        'time = { column = "t", unit = "s" }', f'time = {{ column = "t", {time} }}'
    )
    desk.put(mapping, gnss=f"t,lat,lon,h\n{cell},50,14,200\n")
    desk.run()
    (fix,) = desk.messages(keys.GNSS_FIX)
    assert fix.stamp_ns == START_NS + 250_000_000
    assert fix.HasField("gps_time_ns") == dated
    if dated:
        assert fix.gps_time_ns == START_NS + 250_000_000 - 315_964_800 * 10**9
        assert fix.itow_ms == 252_800_250
        assert fix.utc_ns == START_NS + 250_000_000 - 18 * 10**9


def test_unix_time_keeps_its_nanoseconds(desk: Desk) -> None:
    mapping = "[clock]\nkind = 'utc'\n" + GNSS
    desk.put(mapping, gnss="t,lat,lon,h\n1699999982.000000001,50,14,200\n")
    desk.run()
    assert desk.messages(keys.GNSS_FIX)[0].stamp_ns == START_NS + 1


def test_tables_without_an_instant_in_common_are_refused(desk: Desk) -> None:
    desk.put(RELATIVE + GNSS + ODOMETRY, gnss=GNSS_ROWS, odo="t,v\n500,1\n501,1\n")
    assert "no instant in common" in desk.refused()


# Frames -------------------------------------------------------------------------------------------
GEODETIC = [math.radians(50.07), math.radians(14.43), 250.0]
ORIGIN = LocalLevel.at_deg(50.0, 14.4, 200.0)
E, N, U = ORIGIN.from_geodetic(GEODETIC)
X, Y, Z = ecef_from_geodetic(GEODETIC)


@pytest.mark.parametrize(
    ("frame", "unit", "cells"),
    [
        ("geodetic", "deg", (50.07, 14.43, 250.0)),
        ("geodetic", "rad", tuple(GEODETIC)),
        ("geodetic", "1e-7 deg", (500700000, 144300000, 250.0)),
        ("ecef", "m", (X, Y, Z)),
        ("ecef", "km", (X / 1e3, Y / 1e3, Z / 1e3)),
        ("enu", "m", (E, N, U)),
        ("ned", "m", (N, E, -U)),
    ],
)
@pytest.mark.parametrize("origin", ["degrees", "ecef"])
def test_every_frame_leads_to_the_same_place(
    frame: str, unit: str, cells: tuple[float, ...], origin: str, desk: Desk
) -> None:
    where = "latitude_deg = 50.0\nlongitude_deg = 14.4\nheight_m = 200.0"
    if origin == "ecef":
        where = f"ecef_m = {list(map(float, ORIGIN.origin_e))}"
    mapping = f"{RELATIVE}[origin]\n{where}\n" + GNSS.replace("geodetic", frame).replace(
        '"deg" }', f'"{unit}" }}'
    )
    desk.put(mapping, gnss="t,lat,lon,h\n0," + ",".join(repr(float(c)) for c in cells) + "\n")
    desk.run()
    (fix,) = desk.messages(keys.GNSS_FIX)
    found = [math.radians(fix.latitude_deg), math.radians(fix.longitude_deg)]
    found_e = ecef_from_geodetic([*found, fix.height_ellipsoid_m])
    np.testing.assert_allclose(found_e, [X, Y, Z], rtol=0, atol=1e-3 * MM)
    assert fix.horizontal_std_m == pytest.approx(0.5)  # of axes of 0.3 and 0.4 m
    assert fix.vertical_std_m == pytest.approx(0.7)
    (location,) = desk.messages(keys.GNSS_LOCATION)
    assert location.latitude == fix.latitude_deg
    assert location.timestamp.ToNanoseconds() == fix.stamp_ns


def test_origin_may_be_the_first_point_of_the_truth(desk: Desk) -> None:
    mapping = RELATIVE + "[origin]\nfirst = 'truth'\n" + GNSS.replace("geodetic", "enu")
    desk.put(
        mapping.replace('unit = "deg" }', 'unit = "m" }') + TRUTH,
        gnss="t,lat,lon,h\n0,0,0,0\n1,3,4,0\n",
        truth=f"t,x,y,z\n0,{X!r},{Y!r},{Z!r}\n".replace("np.float64(", "").replace(")", ""),
    )
    desk.run()
    first, second = desk.messages(keys.GNSS_FIX)
    (truth,) = desk.messages(keys.TRUTH_STATE)
    assert first.latitude_deg == pytest.approx(truth.latitude_deg, abs=1e-12)
    assert first.longitude_deg == pytest.approx(truth.longitude_deg, abs=1e-12)
    level = LocalLevel.at_deg(truth.latitude_deg, truth.longitude_deg, truth.height_ellipsoid_m)
    place = [
        math.radians(second.latitude_deg),
        math.radians(second.longitude_deg),
        second.height_ellipsoid_m,
    ]
    np.testing.assert_allclose(level.from_geodetic(place), [3, 4, 0], rtol=0, atol=1e-3 * MM)


def test_height_may_be_the_same_in_every_row(desk: Desk) -> None:
    position = '["lat", "lon"], unit = "deg", height_m = 321.5 }'
    mapping = GNSS.replace('["lat", "lon", "h"], unit = "deg" }', position)
    desk.put(RELATIVE + mapping, gnss=GNSS_ROWS)
    desk.run()
    assert [fix.height_ellipsoid_m for fix in desk.messages(keys.GNSS_FIX)] == [321.5, 321.5]


@pytest.mark.parametrize(
    ("frame", "columns", "cells"),
    [
        ("enu", '["a", "b", "c"]', "10.8,-14.4,3.6"),
        ("ned", '["a", "b", "c"]', "-14.4,10.8,-3.6"),
        ("course", '["a", "b"]', f"18,{math.degrees(math.atan2(3, -4))},0"),
    ],
)
def test_velocity_of_every_frame(frame: str, columns: str, cells: str, desk: Desk) -> None:
    velocity = f'velocity = {{ frame = "{frame}", columns = {columns}, unit = "km/h" }}\n'
    deviation = 'speed_std = { value = 0.1, unit = "m/s" }\n'
    rows = f"t,lat,lon,h,a,b,c\n0,50,14,200,{cells}\n"
    desk.put(RELATIVE + GNSS + velocity + deviation, gnss=rows)
    desk.run()
    (fix,) = desk.messages(keys.GNSS_FIX)
    assert fix.speed_mps == pytest.approx(5.0)
    assert fix.speed_std_mps == pytest.approx(0.1)
    assert fix.course_deg == pytest.approx(math.degrees(math.atan2(3, -4)) % 360)
    if frame == "course":
        assert not fix.HasField("vel_d_mps")
    else:
        found = (fix.vel_e_mps, fix.vel_n_mps, fix.vel_d_mps)
        assert found == pytest.approx((3.0, -4.0, -1.0))


def test_fix_without_a_velocity_is_no_standstill(desk: Desk) -> None:
    desk.put(RELATIVE + GNSS + ODOMETRY, gnss=GNSS_ROWS, odo="t,v\n0,36\n0.5,36\n1,36\n")
    desk.run()
    assert all(fix.speed_std_mps > 100 for fix in desk.messages(keys.GNSS_FIX))
    rerun(desk.out, desk.folder / "r.mcap", None)
    states = messages(desk.folder / "r.mcap", keys.EST_DISTANCE)
    assert states[-1].speed_mps == pytest.approx(10.0, abs=0.1)


def test_quality_grades_fixes_by_numbers_and_words(desk: Desk) -> None:
    quality = 'quality = { column = "q", valid = ["dgps"], fixed = [1], float = [2, "F"] }\n'
    rows = "".join(f"{k},50,14,200,{q}\n" for k, q in enumerate(["1.000", "2", "F", "dgps", "5"]))
    desk.put(RELATIVE + GNSS + quality, gnss="t,lat,lon,h,q\n" + rows)
    desk.run()
    fixes = desk.messages(keys.GNSS_FIX)
    assert [fix.valid for fix in fixes] == [True, True, True, True, False]
    carriers = [GnssFix.FIXED, GnssFix.FLOAT, GnssFix.FLOAT, GnssFix.NONE, GnssFix.NONE]
    assert [fix.carrier for fix in fixes] == carriers


# Odometry and truth -------------------------------------------------------------------------------
def test_wheels_give_speeds_and_pulses_that_add_up(desk: Desk) -> None:
    more = """
wheels.right = { column = "d", unit = "pulses" }
wheels.middle = { column = "n", unit = "total pulses" }
yaw_rate = { column = "w", unit = "deg/s" }
motor_force = { column = "f", unit = "kN" }
doors_open = "door"
"""
    desk.put(
        RELATIVE + ODOMETRY + more,
        odo="t,v,d,n,w,f,door\n0,36,3,1000,90,1.5,0\n0.02,-18,4,1007,-90,-2,1\n",
    )
    desk.run()
    first, second = desk.messages(keys.ODO_WHEELS)
    assert second.stamp_ns - first.stamp_ns == 20_000_000
    assert [reading.wheel for reading in second.wheels] == ["left", "right", "middle"]
    assert [reading.speed_mps for reading in (first.wheels[0], second.wheels[0])] == [10.0, -5.0]
    assert [reading.pulses for reading in second.wheels[1:]] == [7, 1007]
    assert second.yaw_rate_radps == pytest.approx(-math.pi / 2)
    assert second.motor_force_n == pytest.approx(-2000)
    assert (first.doors_open, second.doors_open) == (False, True)


def test_truth_holds_what_the_table_knows_and_nothing_else(desk: Desk) -> None:
    rows = f"t,x,y,z,v,s\n0,{float(X)},{float(Y)},{float(Z)},36,0.03\n"
    desk.put(RELATIVE + TRUTH, truth=rows)
    desk.run()
    (state,) = desk.messages(keys.TRUTH_STATE)
    assert state.latitude_deg == pytest.approx(50.07, abs=1e-12)
    assert {field.name for field, _ in state.ListFields()} == {
        "stamp_ns", "sequence", "latitude_deg", "longitude_deg", "height_ellipsoid_m"
    }  # fmt: skip
    more = """
speed = { column = "v", unit = "km/h" }
position_std = { columns = ["s", "s"], unit = "m" }
"""
    desk.put(RELATIVE + TRUTH + more, truth=rows)
    desk.run()
    (state,) = desk.messages(keys.TRUTH_STATE)
    assert state.speed_mps == pytest.approx(10.0)
    assert state.position_std_m == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("convention", "cells"), [("frd", "2,-5,30"), ("flu", "2,5,60"), ("frd", "2,-5,390")]
)
def test_attitude_is_positive_nose_down_and_counter_clockwise_from_east(
    convention: str, cells: str, desk: Desk
) -> None:
    attitude = f"""
attitude = {{ convention = "{convention}", columns = ["r", "p", "y"], unit = "deg" }}
"""
    rows = f"t,x,y,z,r,p,y2\n0,{float(X)},{float(Y)},{float(Z)},{cells}\n"
    desk.put(RELATIVE + TRUTH + attitude.replace('"y"]', '"y2"]'), truth=rows)
    desk.run()
    (state,) = desk.messages(keys.TRUTH_STATE)
    found = np.degrees([state.roll_rad, state.pitch_rad, state.yaw_rad])
    np.testing.assert_allclose(found, [2, 5, 60], atol=1e-9)


# What the filter gets -----------------------------------------------------------------------------
def quarter_rows(count: int) -> str:
    """Four fixes a second, a millisecond before the quarters."""
    rows = [f"{100 + k / 4 - 0.001:.3f},50,{14 + k * 1e-6:.6f},200\n" for k in range(count)]
    return "t,lat,lon,h\n" + "".join(rows)


def test_thinning_keeps_fixes_nearest_to_whole_seconds_and_the_rest_is_truth(desk: Desk) -> None:
    desk.put(RELATIVE + GNSS + 'every_s = 1.0\nwithheld = "truth"\n', gnss=quarter_rows(41))
    result = desk.run()
    fixes, truth = desk.messages(keys.GNSS_FIX), desk.messages(keys.TRUTH_STATE)
    seconds = [(fix.stamp_ns - START_NS) / 1e9 for fix in fixes]
    np.testing.assert_allclose(seconds, np.arange(100, 111) - 0.001, rtol=0, atol=1e-9)
    assert len(truth) == 30
    assert not {fix.stamp_ns for fix in fixes} & {state.stamp_ns for state in truth}
    assert truth[0].position_std_m == pytest.approx(0.5 / math.sqrt(2))
    assert [state.sequence for state in truth] == list(range(1, 31))
    told = result["tables"][0]
    assert (told["given"], told["withheld"]) == (11, 30)


def test_cuts_of_mapping_and_command_are_left_out_after_the_first_row_of_all(desk: Desk) -> None:
    extra = 'cuts = [[3.0, 4.0]]\nwithheld = "truth"\n'
    desk.put(
        RELATIVE + GNSS + extra + ODOMETRY,
        gnss=quarter_rows(41),
        odo="t,v\n98.999,1\n110,1\n",  # one second before the first fix
    )
    desk.run((6.0, 2.5))
    seconds = [(f.stamp_ns - START_NS) / 1e9 - 98.999 for f in desk.messages(keys.GNSS_FIX)]
    assert len(seconds) == 41 - 4 - 10
    assert not any(3 <= s < 4 - 1e-6 or 6 <= s < 8.5 - 1e-6 for s in seconds)
    assert len(desk.messages(keys.TRUTH_STATE)) == 14


def test_withheld_fixes_are_dropped_unless_told_otherwise(desk: Desk) -> None:
    desk.put(RELATIVE + GNSS + "every_s = 1.0\n", gnss=quarter_rows(41))
    assert keys.TRUTH_STATE.path not in desk.run()["messages"]


@pytest.mark.parametrize("text", ["30", "30:", ":5", "a:b", "-1:5", "5:0", "nan:1", "1:inf"])
def test_cut_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="START_S:DURATION_S"):
        parse_cut(text)


def test_record_without_inertial_data_is_reprocessed_to_its_end(desk: Desk) -> None:
    rows = "".join(f"{k / 10},{k}\n" for k in range(50))
    desk.put(RELATIVE + GNSS + ODOMETRY, gnss=GNSS_ROWS, odo="t,v\n" + rows)
    desk.run()
    rerun(desk.out, desk.folder / "r.mcap", None)
    frames = messages(desk.folder / "r.mcap", keys.SYNC_FRAME)
    assert sum(len(frame.odometry) for frame in frames) == 50
    assert sum(len(frame.gnss) for frame in frames) == 2
    assert messages(desk.folder / "r.mcap", keys.SYNC_LATE) == []


def test_publication_is_in_order_and_never_before_the_last_sample(desk: Desk) -> None:
    stamps_s = np.arange(300) / 100
    desk.put(
        RELATIVE + GNSS + ODOMETRY + IMU,
        gnss=GNSS_ROWS,
        odo="t,v\n0.5,1\n0.6,1\n",
        imu=imu_rows(stamps_s),
    )
    desk.run()
    with open_record(desk.out) as record:
        entries = [(e.topic, e.log_ns, e.publish_ns, record.decode(e)) for e in record.messages()]
    logs = [log_ns for _, log_ns, _, _ in entries]
    assert logs == sorted(logs)
    for topic, log_ns, publish_ns, message in entries:
        if topic.endswith(keys.IMU_BATCH.path):
            last_ns = message.stamp_ns + message.period_ns * (len(message.gyro_x) - 1)
            assert log_ns == publish_ns == pytest.approx(last_ns, abs=256)
        elif not topic.endswith(keys.GNSS_LOCATION.path):
            assert log_ns == publish_ns == message.stamp_ns


# Dirt ---------------------------------------------------------------------------------------------
def test_rows_that_are_none_are_counted_and_the_first_is_named(desk: Desk) -> None:
    rows = "0,50,14,200\n1,fifty,14,200\n2,50,14\n\n3,nan,14,200\n,50,14,200\n5,50,14,200\n"
    desk.put(RELATIVE + GNSS, gnss="t,lat,lon,h\n" + rows)
    result = desk.run()
    assert result["messages"][keys.GNSS_FIX.path] == 2
    assert result["malformed_lines"] == 4
    told = result["tables"][0]["first_malformed"]
    assert told == "line 3: column lat: 'fifty' is no number"


def test_one_wrong_stamp_costs_one_row(desk: Desk) -> None:
    for wrong in ("99999", "0", "3"):
        rows = "".join(f"{wrong if k == 4 else k},50,14,200\n" for k in range(10))
        desk.put(RELATIVE + GNSS, gnss="t,lat,lon,h\n" + rows)
        result = desk.run()
        assert result["messages"][keys.GNSS_FIX.path] == 9
        assert result["malformed_lines"] == 1
        assert "in the order of time" in result["tables"][0]["first_malformed"]


def test_longest_increasing_part_is_strict_and_longest() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        stamps = rng.integers(0, 12, 9)
        kept = increasing(stamps.astype(np.int64))
        assert np.all(np.diff(stamps[kept]) > 0)
        assert np.all(np.diff(kept) > 0)
        longest = [1] * len(stamps)
        for k in range(len(stamps)):
            for j in range(k):
                if stamps[j] < stamps[k]:
                    longest[k] = max(longest[k], longest[j] + 1)
        assert len(kept) == max(longest)


def test_rows_of_other_sensors_are_neither_used_nor_malformed(desk: Desk) -> None:
    rows = "t,lat,lon,h,v\n0,50,14,200,\n0.1,,,,36\n0.2,nan,NaN,,36\n1,50,14,200,\n"
    mapping = RELATIVE + GNSS + ODOMETRY.replace("odo.csv", "gnss.csv")
    desk.put(mapping, gnss=rows)
    result = desk.run()
    assert result["malformed_lines"] == 0
    assert result["messages"][keys.GNSS_FIX.path] == 2
    assert result["messages"][keys.ODO_WHEELS.path] == 2


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("", "gnss.csv: is empty"),
        ("t,lat,lon,h\n", "gnss.csv: has no rows"),
        ("t,latt,lon,h\n0,50,14,200\n", "line 1: no column 'lat'; did you mean 'latt'?"),
        ("t;lat;lon;h\n0;50;14;200\n", "is the delimiter ','?"),
        ("t,lat,lat,lon,h\n0,50,50,14,200\n", "two columns are named 'lat'"),
        ("t,lat,lon,h\n0,x,14,200\n1,y,14,200\n", "no row can be used; line 2: column lat: 'x'"),
        ("t,lat,lon,h\nnoon,50,14,200\n", "column t: 'noon' is no time in s"),
        ("t,lat,lon,h\n1,,,\n", "the wanted columns are empty in each of its 1 rows"),
        ("t,lat,lon,h\n1,5007,1443,200\n", "are the frame and the units of $.tables[0].position"),
        ("t,lat,lon,h\n1,50,14,6378137\n", "are the frame and the units of $.tables[0].position"),
    ],
)
def test_table_that_cannot_be_used_is_one_sentence(rows: str, words: str, desk: Desk) -> None:
    desk.put(RELATIVE + GNSS, gnss=rows)
    assert words in desk.refused()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('unit = "deg" }', 'unit = "m" }'), "$.tables[0].position.unit: 'm' is not the unit"),
        (('unit = "cm"', 'unit = "ft"'), "there are: m, mm, cm, km"),
        (("value = 70", "valu = 70"), "$.tables[0].vertical_std.valu: unknown field; did you mean"),
        (("value = 70, ", ""), "$.tables[0].vertical_std: give either a column or a value"),
        (('"lat", "lon", "h"', '"lat", "lon"'), "$.tables[0].position.columns"),
        (('kind = "gnss"', 'kind = "gps"'), "$.tables[0]"),
        (('frame = "geodetic"', 'frame = "ecef"'), "$.tables[0].position.unit"),
        (("[0.3, 0.4]", "[0.3, -0.4]"), "$.tables[0].horizontal_std.values[1]"),
        (('kind = "relative"', 'kind = "gps_week"'), "week or a date"),
        (("2023-11-14T22", "14.11.2023 22"), "$.clock.start"),
        (
            ('[clock]\nkind = "relative"\nstart = "2023-11-14T22:13:20"\n', ""),
            "$.tables[0].clock: missing",
        ),
        (("[[tables]]", "cuts = 1\n[[tables]]"), "cuts: unknown field"),
    ],
)
def test_mapping_that_cannot_be_used_names_the_field(
    change: tuple[str, str], words: str, desk: Desk
) -> None:
    mapping = (RELATIVE + GNSS).replace(*change)
    assert mapping != RELATIVE + GNSS
    desk.put(mapping, gnss=GNSS_ROWS)
    assert words in desk.refused()


def test_positions_counted_from_an_origin_want_one(desk: Desk) -> None:
    enu = GNSS.replace("geodetic", "enu").replace('"deg" }', '"m" }')
    desk.put(RELATIVE + enu, gnss=GNSS_ROWS)
    assert "$.origin: missing" in desk.refused()
    desk.put(RELATIVE + "[origin]\nfirst = 'gnss'\n" + enu, gnss=GNSS_ROWS)
    assert "itself counted from the origin" in desk.refused()
    desk.put(RELATIVE + "[origin]\nlatitude_deg = 50.0\n" + enu, gnss=GNSS_ROWS)
    assert "$.origin: give latitude_deg" in desk.refused()


# Where the tables are, and the command ------------------------------------------------------------
def test_tables_are_found_by_name_folder_and_beside_the_mapping(tmp_path: Path) -> None:
    ride = tmp_path / "ride"
    ride.mkdir()
    for path in (ride / "imu.csv", tmp_path / "gnss.csv", tmp_path / "other.txt"):
        path.write_text("x")
    mapping = tmp_path / "m.toml"
    names = ["imu.csv", "gnss.csv"]
    found = find_files(mapping, names, [str(ride)])
    assert found == {"imu.csv": ride / "imu.csv", "gnss.csv": tmp_path / "gnss.csv"}
    found = find_files(mapping, names, [f"gnss.csv={tmp_path / 'other.txt'}", f"{ride}/imu.csv"])
    assert found == {"imu.csv": ride / "imu.csv", "gnss.csv": tmp_path / "other.txt"}
    assert find_files(mapping, ["a.csv"], [str(tmp_path / "other.txt")]) == {
        "a.csv": tmp_path / "other.txt"
    }
    with pytest.raises(ConfigError, match=r"other\.txt: the mapping has no table of that name"):
        find_files(mapping, names, [str(tmp_path / "other.txt")])
    with pytest.raises(ConfigError, match=r"imu\.csv is not in"):
        find_files(mapping, names, [])


def blocks() -> list[tuple[str, str, str]]:
    """Language, file name and text of the page's code blocks."""
    return re.findall(r"```(\w+) ?(\S*)\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_example_of_the_page_prints_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _, name, text in blocks():
        if name:
            (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    commands = next(text for language, _, text in blocks() if language == "sh").splitlines()
    printed = next(text for language, _, text in blocks() if language == "text")
    results = [CliRunner().invoke(make_app(), shlex.split(command)[1:]) for command in commands]
    assert [result.exit_code for result in results] == [0, 0], results[0].output
    assert sorted(results[0].output.splitlines()) == sorted(printed.splitlines())
    assert len(messages(tmp_path / "estimate.mcap", keys.SYNC_IMU)) == 7  # one of them bridged


def test_page_names_every_field_and_unit() -> None:
    page = PAGE.read_text()
    structs = [table_mapping.Mapping, table_mapping.Origin, table_units.Clock,
               table_mapping.ImuTable, table_mapping.GnssTable, table_mapping.OdometryTable,
               table_mapping.TruthTable, table_mapping.Time, table_mapping.Position,
               table_mapping.Velocity, table_mapping.Quality]  # fmt: skip
    table = page.split("## A mapping")[1]
    for struct in structs:
        for name in struct.__struct_encode_fields__:
            assert re.search(rf"\b{name}\b", table), f"{struct.__name__}.{name}"
    for dimension, units in table_units.UNITS.items():
        assert f"| {dimension} | {', '.join(f'`{unit}`' for unit in units)} |" in page


def test_command_tells_of_its_tables_in_one_json_object(desk: Desk) -> None:
    desk.put(RELATIVE + GNSS, gnss=GNSS_ROWS)
    mapping = str(desk.folder / "m.toml")
    arguments = ["import", "--mapping", mapping, "--out", str(desk.out), "--json", "--cut", "0.5:1"]
    result = CliRunner().invoke(make_app(), arguments)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["tables"][0]["given"] == 1
    with open_record(desk.out) as record:
        assert record.vehicle == "import"
    lonely = CliRunner().invoke(make_app(), ["import", "--csv", "x", "--out", str(desk.out)])
    assert isinstance(lonely.exception, ConfigError)
    assert "--mapping" in str(lonely.exception)


def test_configuration_of_the_mapping_is_the_records_unless_one_is_given(
    desk: Desk, tmp_path: Path
) -> None:
    desk.put(RELATIVE + IMU, imu=imu_rows(np.arange(20) / 100))
    desk.run()
    with open_record(desk.out) as record:
        recorded = json.loads(record.metadata[config_file.RECORD_ENTRY])
    assert (recorded["vehicle"], recorded["imu"]["rate_hz"]) == ("test", 100.0)
    other = tmp_path / "other.toml"
    other.write_text("vehicle = 'other'\n[imu]\ndevice = 'x'\nrate_hz = 99.0\n")
    imports = Imports(other, "", "ADIS16465-1")
    imports.tables(Tables(tmp_path / "m.toml", [], []))
    assert imports.vehicle.vehicle == "other"


# The real drives ----------------------------------------------------------------------------------
def drive(data_dir: Path, name: str, folder: str, out: Path) -> dict[str, Any]:
    imports = Imports(None, "", "ADIS16465-1")
    mapping = REPOSITORY / "mappings" / f"{name}.toml"
    imports.tables(Tables(mapping, [str(data_dir / "drives" / folder)], []))
    return imports.write(out)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def rtkx(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rtkx") / "rtkx.mcap"
    result = drive(data_dir, "rtkx", "rtkx_first_half", out)
    assert result["malformed_lines"] == 0
    return out


@pytest.mark.parametrize("name", ["rtkx", "smartloc"])
def test_mapping_of_a_drive_loads_and_tells_where_it_looked(name: str, tmp_path: Path) -> None:
    path = REPOSITORY / "mappings" / f"{name}.toml"
    mapping = table_mapping.load(path)
    assert mapping.vehicle is not None
    assert mapping.vehicle.vehicle == name
    with pytest.raises(ConfigError, match=f"{mapping.tables[0].file} is not in {tmp_path}"):
        Tables(path, [str(tmp_path)], [])


@pytest.mark.realdata
def test_rtkx_holds_one_fix_in_four_and_the_others_as_truth(rtkx: Path, data_dir: Path) -> None:
    rows = rows_of(data_dir / "drives" / "rtkx_first_half" / "gnss_rtk.csv")
    sunday_ns = int(np.datetime64("2025-07-06", "ns").astype(np.int64))
    fixes, truth = messages(rtkx, keys.GNSS_FIX), messages(rtkx, keys.TRUTH_STATE)
    assert (len(rows), len(fixes), len(truth)) == (1080, 270, 810)
    by_stamp = {sunday_ns + round(float(row["gps_sow_s"]) * 1e3) * 10**6: row for row in rows}
    assert {m.stamp_ns for m in (*fixes, *truth)} == set(by_stamp)
    for message in (*fixes, *truth):
        row = by_stamp[message.stamp_ns]
        assert message.latitude_deg == pytest.approx(float(row["lat_deg"]), abs=1e-12)
        assert message.longitude_deg == pytest.approx(float(row["lon_deg"]), abs=1e-12)
        assert message.height_ellipsoid_m == pytest.approx(float(row["h_m"]), abs=1e-9)
    assert all(fix.stamp_ns // 10**6 % 1000 == 999 for fix in fixes)
    assert [fix.carrier == GnssFix.FIXED for fix in fixes] == [
        by_stamp[fix.stamp_ns]["Q"] == "1" for fix in fixes
    ]
    row = by_stamp[fixes[0].stamp_ns]
    assert row["gps_sow_s"] == "243258.999"
    assert fixes[0].horizontal_std_m == pytest.approx(math.hypot(0.0099, 0.0099))
    assert not fixes[0].HasField("vel_n_mps")


@pytest.mark.realdata
def test_rtkx_inertial_samples_are_those_of_the_table(rtkx: Path, data_dir: Path) -> None:
    rows = rows_of(data_dir / "drives" / "rtkx_first_half" / "imu_raw.csv")
    written = np.array([[float(cell) for cell in row.values()] for row in rows])
    stamps, values = samples(messages(rtkx, keys.IMU_BATCH))
    np.testing.assert_allclose(np.degrees(values[:, :3]), written[:, 4:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(values[:, 3:] / 9.80665, written[:, 1:4], rtol=0, atol=1e-12)
    sunday_ns = int(np.datetime64("2025-07-06", "ns").astype(np.int64))
    moved_s = (stamps - sunday_ns) / 1e9 - (written[:, 0] - 0.125)
    assert np.abs(moved_s).max() < 1.6 * MM
    assert np.std(moved_s) < 0.6 * MM


@pytest.mark.realdata
def test_rtkx_mounting_fits_gravity_and_the_motion_of_the_antenna(rtkx: Path) -> None:
    """Ψ turns case axes into forward, left, up: what RTK says of the motion, the IMU says too."""
    with open_record(rtkx) as record:
        vehicle = json.loads(record.metadata[config_file.RECORD_ENTRY])
    C_bv = C_vl(*np.radians(vehicle["imu"]["mounting_deg"]))
    stamps, values = samples(messages(rtkx, keys.IMU_BATCH))
    omega_v, f_v = values[:, :3] @ C_bv, values[:, 3:] @ C_bv
    fixes = sorted(
        [*messages(rtkx, keys.GNSS_FIX), *messages(rtkx, keys.TRUTH_STATE)],
        key=lambda message: message.stamp_ns,
    )
    places = np.radians([[m.latitude_deg, m.longitude_deg, 0] for m in fixes])
    places[:, 2] = [m.height_ellipsoid_m for m in fixes]
    p_l = LocalLevel(*places[0]).from_geodetic(places)
    time_s = (np.array([m.stamp_ns for m in fixes]) - fixes[0].stamp_ns) / 1e9
    imu_s = (stamps - fixes[0].stamp_ns) / 1e9
    # Chords over a second, at its middle.
    v_l = p_l[4:, :2] - p_l[:-4, :2]
    speed, middle_s = np.hypot(*v_l.T), (time_s[4:] + time_s[:-4]) / 2
    still = np.interp(imu_s, middle_s, speed) < 0.02
    still &= imu_s < 30
    f_still = f_v[still].mean(axis=0)
    np.testing.assert_allclose(f_still[:2], 0, atol=9.8 * math.radians(1.5))  # street and ±0.5°
    assert f_still[2] == pytest.approx(9.8, abs=0.2)

    def over_a_second(rate: np.ndarray) -> np.ndarray:
        """Mean rate between the middles of neighbouring chords, a second apart, smoothed alike."""
        path = np.cumsum(rate) * np.median(np.diff(imu_s))
        smooth = np.convolve(path, np.full(101, 1 / 101), "same")
        return np.interp(middle_s[4:], imu_s, smooth) - np.interp(middle_s[:-4], imu_s, smooth)

    inside = (middle_s[:-4] > imu_s[0] + 1) & (middle_s[4:] < imu_s[-1] - 1)
    moving = inside & (np.minimum(speed[4:], speed[:-4]) > 3)
    course = np.unwrap(np.arctan2(v_l[:, 1], v_l[:, 0]))
    turned = (course[4:] - course[:-4] + np.pi) % (2 * np.pi) - np.pi
    bias = omega_v[still, 2].mean()
    slope = np.polyfit(turned[moving], over_a_second(omega_v[:, 2] - bias)[moving], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.02)
    assert np.corrcoef(turned[moving], over_a_second(omega_v[:, 2])[moving])[0, 1] > 0.99
    faster = (speed[4:] - speed[:-4])[moving]
    slope = np.polyfit(faster, over_a_second(f_v[:, 0])[moving], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.2)  # slopes of the street are in f_x
    lateral = ((speed[4:] + speed[:-4]) / 2 * turned)[moving]
    assert np.polyfit(lateral, over_a_second(f_v[:, 1])[moving], 1)[0] == pytest.approx(1, abs=0.15)


@pytest.mark.realdata
def test_smartloc_holds_odometry_fixes_and_reference(data_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "smartloc.mcap"
    drive(data_dir, "smartloc", "smartloc_potsdamer", out)
    folder = data_dir / "drives" / "smartloc_potsdamer"
    start_ns = int(np.datetime64("2016-05-01", "ns").astype(np.int64))
    lines = (folder / "Berlin_Potsdamer_Platz_Input.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line.startswith("odom3")]
    readings = messages(out, keys.ODO_WHEELS)
    assert len(readings) == len(rows) == 1372
    for reading, row in zip(readings, rows, strict=True):
        assert reading.stamp_ns == pytest.approx(start_ns + float(row[1]) * 1e9, abs=256)
        assert reading.wheels[0].speed_mps == float(row[2])
        assert reading.yaw_rate_radps == float(row[7])
    truth, fixes = messages(out, keys.TRUTH_STATE), messages(out, keys.GNSS_FIX)
    lines = (folder / "Berlin_Potsdamer_Platz_GT.txt").read_text().splitlines()
    points = np.array([line.split()[2:5] for line in lines], float)
    degrees = np.array([[m.latitude_deg, m.longitude_deg, m.height_ellipsoid_m] for m in truth])
    truth_e = ecef_from_geodetic(degrees * [np.pi / 180, np.pi / 180, 1])
    np.testing.assert_allclose(truth_e, points, rtol=0, atol=1e-2 * MM)
    level = LocalLevel.at_deg(*degrees[0])
    found = np.array([[f.latitude_deg, f.longitude_deg, f.height_ellipsoid_m] for f in fixes])
    found_l = level.from_geodetic(found * [np.pi / 180, np.pi / 180, 1])
    written = np.genfromtxt(folder / "lsq_fixes_enu.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(found_l, written[:, 1:4], rtol=0, atol=1e-2 * MM)
    assert [fix.satellites_used for fix in fixes] == written[:, 4].astype(int).tolist()
    errors = found_l[:, :2] - level.from_geodetic(degrees * [np.pi / 180, np.pi / 180, 1])[:, :2]
    rms_m = math.sqrt(np.mean(np.sum(errors**2, axis=1)))
    assert rms_m == pytest.approx(34.6, abs=0.1)  # ../shared/data/README.md
    assert fixes[0].horizontal_std_m == pytest.approx(rms_m, rel=0.05)


def test_table_whose_name_no_disk_takes_is_not_found(tmp_path: Path) -> None:
    (tmp_path / "ride.toml").write_text(RELATIVE + GNSS.replace("gnss.csv", "x" * 5000))
    with pytest.raises(ConfigError, match="is not in"):
        Tables(tmp_path / "ride.toml", [], [])
