"""Exports as other programs read them: GPX, KML, TUM poses, Parquet, GeoParquet, MATLAB."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet
import pytest
from looking import START_NS, VEHICLE
from scipy.io import loadmat

from tramstream import keys
from tramstream.attitude import C_vl
from tramstream.cli.export import export
from tramstream.clock import S
from tramstream.errors import ConfigError, RecordError
from tramstream.geodesy import LocalLevel
from tramstream.keys import Key
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, TruthState
from tramstream.recorder.file.writer import RecordFile

FIXES = 20
EVIL = "tram<&>\x01"


def put(record: RecordFile, key: Key, message, log_ns: int, number: int, vehicle: str) -> None:
    payload = message.SerializeToString()
    record.append(key.on(vehicle), key, payload, log_ns, log_ns, number)


def ridden(path: Path, vehicle: str = VEHICLE) -> Path:
    """Four seconds of fixes at 5 Hz, states and truth a metre apart, and inertial batches."""
    with RecordFile(path, vehicle) as record:
        for number in range(FIXES):
            stamp_ns = START_NS + number * S // 5
            place = {
                "stamp_ns": stamp_ns, "sequence": number + 1, "latitude_deg": 50 + number * 1e-5,
                "longitude_deg": 14.4, "height_ellipsoid_m": 250.0,
            }  # fmt: skip
            fix = GnssFix(valid=True, horizontal_std_m=1.5, fix_type=GnssFix.FIX_3D, **place)
            put(record, keys.GNSS_FIX, fix, stamp_ns, number + 1, vehicle)
            state = MotionState(
                mode=MotionState.TRACKING, yaw_rad=0.5, pitch_rad=-0.02, roll_rad=0.01, **place
            )
            state.covariance.extend([0.1] * 28)
            put(record, keys.EST_STATE, state, stamp_ns, number + 1, vehicle)
            truth = TruthState(yaw_rad=0.5, **{**place, "height_ellipsoid_m": 251.0})
            put(record, keys.TRUTH_STATE, truth, stamp_ns, number + 1, vehicle)
            batch = ImuBatch(
                stamp_ns=stamp_ns, sequence=number + 1, first_sample_sequence=4 * number,
                period_ns=0.5e6, gyro_scale_radps=0.1, accel_scale_mps2=0.01,
                temperature_scale_degc=0.5, temperature=50,
            )  # fmt: skip
            for kind, base in (("gyro", 0), ("accel", 100)):
                for axis in range(3):
                    name = f"{kind}_{'xyz'[axis]}"
                    getattr(batch, name).extend(base + 10 * axis + k for k in range(4))
            put(record, keys.IMU_BATCH, batch, stamp_ns, number + 1, vehicle)
    return path


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return ridden(tmp_path / "a.mcap")


def test_gpx_is_a_track_with_heights_and_times(record: Path, tmp_path: Path) -> None:
    export([record], gpx=tmp_path / "a.gpx")
    space = "{http://www.topografix.com/GPX/1/1}"
    points = ElementTree.parse(tmp_path / "a.gpx").getroot().findall(f".//{space}trkpt")
    assert len(points) == FIXES
    assert float(points[3].get("lat")) == pytest.approx(50.00003)
    assert points[3].find(f"{space}ele").text == "250.000"
    assert points[3].find(f"{space}time").text == "2026-09-21T14:13:20.600Z"


def test_kml_is_a_line_of_longitude_latitude_height(record: Path, tmp_path: Path) -> None:
    export([record], kml=tmp_path / "a.kml")
    space = "{http://www.opengis.net/kml/2.2}"
    (line,) = ElementTree.parse(tmp_path / "a.kml").getroot().findall(f".//{space}coordinates")
    corners = [[float(each) for each in corner.split(",")] for corner in line.text.split()]
    assert corners[0] == [14.4, 50.0]
    assert len(corners) == FIXES


def test_names_of_strangers_are_text_in_xml(tmp_path: Path) -> None:
    path = ridden(tmp_path / "evil.mcap", EVIL)
    for option in ("gpx", "kml"):
        out = tmp_path / f"a.{option}"
        export([path], **{option: out})
        assert "tram<&>" in "".join(ElementTree.parse(out).getroot().itertext())


def test_poses_are_east_north_up_of_the_first_one_for_truth_and_estimate_alike(
    record: Path, tmp_path: Path
) -> None:
    export([record], tum=tmp_path / "poses")
    found = {path.name: np.loadtxt(path) for path in (tmp_path / "poses").iterdir()}
    assert set(found) == {"est_ekf_state.tum", "raw_truth_state.tum"}
    poses = found["est_ekf_state.tum"]
    assert poses.shape == (FIXES, 8)
    level = LocalLevel.at_deg(50.0, 14.4, 250.0)
    last = level.from_geodetic(np.array([*np.radians([50 + 19e-5, 14.4]), 250.0]))
    np.testing.assert_allclose(poses[-1, 1:4], last, atol=1e-8)
    # The vertical of a place 20 m away is tilted by 3e-6.
    np.testing.assert_allclose(
        found["raw_truth_state.tum"][:, 1:4] - poses[:, 1:4], [[0, 0, 1.0]] * FIXES, atol=5e-6
    )
    x, y, z, w = poses[0, 4:]
    C_lv = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(C_lv, C_vl(0.01, -0.02, 0.5).T, atol=1e-8)
    with (tmp_path / "poses" / "est_ekf_state.tum").open() as file:
        assert file.readline().split()[0] == f"{START_NS // S}.000000000"


def test_inertial_batches_are_a_row_a_sample_in_si_units(record: Path, tmp_path: Path) -> None:
    export([record], parquet=tmp_path / "imu.parquet", csv=tmp_path / "imu.csv", key="raw/imu/*")
    table = pyarrow.parquet.read_table(tmp_path / "imu.parquet").to_pydict()
    assert len(table["stamp_ns"]) == 4 * FIXES
    assert table["sample"] == list(range(4 * FIXES))
    assert np.diff(table["stamp_ns"][:4]).tolist() == [500_000] * 3
    assert table["gyro_y_radps"][:4] == pytest.approx([1.0, 1.1, 1.2, 1.3])
    assert table["accel_z_mps2"][4:8] == pytest.approx([1.2, 1.21, 1.22, 1.23])
    assert table["temperature_degc"][0] == 25.0
    rows = [line.split(",") for line in (tmp_path / "imu.csv").read_text().splitlines()]
    by_name = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
    for name, column in table.items():
        assert [float(each) for each in by_name[name]] == pytest.approx(column)


def test_parquet_has_a_file_a_key_with_units_in_names_and_names_of_enumerations(
    record: Path, tmp_path: Path
) -> None:
    export([record], parquet=tmp_path / "out")
    assert len(list((tmp_path / "out").iterdir())) == 4
    states = pyarrow.parquet.read_table(tmp_path / "out" / "est_ekf_state.parquet").to_pydict()
    assert set(states["mode"]) == {"TRACKING"}
    assert states["yaw_rad"] == [0.5] * FIXES
    assert states["covariance.27"] == pytest.approx([0.1] * FIXES)


def test_geoparquet_says_where_it_is(record: Path, tmp_path: Path) -> None:
    export([record], geoparquet=tmp_path / "a.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    told = json.loads(table.schema.metadata[b"geo"])
    column = told["columns"][told["primary_column"]]
    assert (column["encoding"], column["geometry_types"]) == ("WKB", ["Point Z"])
    assert column["crs"]["id"] == {"authority": "EPSG", "code": 4979}
    order, kind, x, y, z = struct.unpack("<BIddd", table["geometry"][2].as_py())
    assert (order, kind) == (1, 1001)
    assert (x, y, z) == pytest.approx((14.4, 50.00002, 250.0))


def test_matlab_gets_a_struct_a_key(record: Path, tmp_path: Path) -> None:
    export([record], mat=tmp_path / "a.mat")
    found = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert found["est_ekf_state"]["latitude_deg"][1] == pytest.approx(50.00001)
    assert found["est_ekf_state"]["covariance_0"] == pytest.approx([0.1] * FIXES)
    assert len(found["raw_imu_batch"]["gyro_x_radps"]) == 4 * FIXES


@pytest.mark.parametrize(
    ("options", "rows"),
    [
        ({"rate_hz": 1.0}, 4),
        ({"rate_hz": 2.0}, 8),
        ({"rate_hz": 50.0}, FIXES),
        ({"start_s": 1.0}, 15),
        ({"start_s": 1.0, "duration_s": 2.0}, 10),
    ],
)
def test_part_of_the_time_and_fewer_messages(
    record: Path, tmp_path: Path, options: dict[str, float], rows: int
) -> None:
    outs = {"csv": tmp_path / "a.csv", "parquet": tmp_path / "a.parquet", "gpx": tmp_path / "a.gpx"}
    export([record], key="raw/gnss/fix", **outs, **options)
    assert len(outs["csv"].read_text().splitlines()) == 1 + rows
    assert pyarrow.parquet.read_table(outs["parquet"]).num_rows == rows
    assert outs["gpx"].read_text().count("<trkpt") == rows


def test_nothing_is_overwritten_silently(record: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.gpx"
    out.write_text("mine")
    with pytest.raises(ConfigError, match="--overwrite"):
        export([record], gpx=out)
    assert out.read_text() == "mine"
    with pytest.raises(ConfigError):
        export([record], gpx=record, overwrite=True)
    export([record], gpx=out, overwrite=True)
    assert "<gpx" in out.read_text()
    folder = tmp_path / "folder"
    export([record], csv=folder)
    with pytest.raises(ConfigError, match="--overwrite"):
        export([record], csv=folder)
    export([record], csv=folder, overwrite=True)


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordFile(path, VEHICLE) as record:
        put(record, keys.LOSS.at("x"), keys.LOSS.type(count=1), START_NS, 1, VEHICLE)
    for option, words in (
        ("gpx", "position"),
        ("tum", "pose"),
        ("geoparquet", "position"),
    ):
        with pytest.raises(RecordError, match=f"has no {words}"):
            export([path], **{option: tmp_path / f"a.{option}"})
        assert not (tmp_path / f"a.{option}").exists()
    with pytest.raises(RecordError, match="no key raw/x/y"):
        export([path], parquet=tmp_path / "out", key="raw/x/y")
