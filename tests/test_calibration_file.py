"""The calibration that a configuration names: merged, owned by one file, with its origin told."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from typer.testing import CliRunner

from tramstream import config_file, mounting
from tramstream.attitude import C_bv_of, C_vl
from tramstream.calibrated import Provenance, Source
from tramstream.calibration_file import document
from tramstream.cli.main import make_app
from tramstream.config import Imu, Vehicle
from tramstream.config_file import digest, load, parse, to_json, to_toml
from tramstream.errors import ConfigError

OWN = """
vehicle = "t"
calibration = "cal.toml"
[imu]
device = "/dev/imu"
[gnss]
device = "/dev/gnss"
"""
FRAGMENT = """
[imu]
gyro_noise_radps_rthz = 0.00012
mounting_deg = [1.0, 2.0, 3.0]
mounting_std_deg = [0.1, 0.2, 0.5]
[gnss]
lever_arm_m = [1.0, 0.5, 3.0]
[wheels]
m_per_pulse = 0.00093
[wheels.each.left]
m_per_pulse = 0.000931
scale_std = 0.0002
[provenance]
tool = "allan"
software = "tramstream 0.1.0"
made = "2026-11-29T21:00:00Z"
[provenance.std]
"imu.gyro_noise_radps_rthz" = 0.000001
[[provenance.records]]
file = "a.mcap"
"""


def files(folder: Path, own: str = OWN, fragment: str = FRAGMENT) -> Path:
    """A configuration beside its calibration."""
    (folder / "cal.toml").write_text(fragment)
    path = folder / "tram.toml"
    path.write_text(own)
    return path


def refused(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path)
    return str(caught.value)


def test_fields_of_the_calibration_are_the_vehicles(tmp_path: Path) -> None:
    vehicle = load(files(tmp_path))
    assert vehicle.imu is not None
    assert vehicle.gnss is not None
    assert vehicle.imu.gyro_noise_radps_rthz == 0.00012
    assert vehicle.imu.device == "/dev/imu"
    assert mounting.about_axes(vehicle.imu.mounting_std_deg) == (0.1, 0.2, 0.5)
    assert vehicle.gnss.lever_arm_m == (1.0, 0.5, 3.0)
    assert vehicle.wheels.m_per_pulse == 0.00093
    assert vehicle.wheels.each["left"].scale_std == 0.0002
    assert vehicle.calibrated is not None
    assert vehicle.calibrated.file == str(tmp_path / "cal.toml")
    assert vehicle.calibrated.records == (Source(file="a.mcap"),)
    assert set(vehicle.calibrated.fields) == {
        "imu.gyro_noise_radps_rthz", "imu.mounting_deg", "imu.mounting_std_deg",
        "gnss.lever_arm_m", "wheels.m_per_pulse", "wheels.each",
    }  # fmt: skip


def test_field_that_both_files_state_is_refused_and_both_are_named(tmp_path: Path) -> None:
    for value in ("0.0002", "0.00012"):  # another value, or the same
        own = OWN.replace("[gnss]", f"gyro_noise_radps_rthz = {value}\n[gnss]")
        sentence = refused(files(tmp_path, own))
        assert "$.imu.gyro_noise_radps_rthz: is stated here and in" in sentence
        assert str(tmp_path / "tram.toml") in sentence
        assert str(tmp_path / "cal.toml") in sentence


@pytest.mark.parametrize(
    ("fragment", "says"),
    [
        ("[imu]\ngyro_nose = 1.0", r"\$\.imu\.gyro_nose: unknown field"),
        ("[imu]\ngyro_noise_radps_rthz = -1.0", r"\$\.imu\.gyro_noise_radps_rthz.*must be > 0"),
        ("[imu]\ndevice = 'x'", r"\$\.imu\.device: is of the vehicle"),
        ("[ekf]\nmodel = 'tram'", r"\$\.ekf: is no part of a calibration"),
        ("[imu", "not TOML"),
        ("imu = 3", r"\$\.imu: must be a section"),
        ("[provenance]\ntol = 'x'", r"\$\.provenance\.tol: unknown field"),
        ("[imu]\nmounting_q_bv = [1.0, 1.0, 0.0, 0.0]\nmounting_deg = [0,0,1]", "size 1.41421"),
    ],
)
def test_bad_calibration_is_refused_with_its_own_name(
    fragment: str, says: str, tmp_path: Path
) -> None:
    path = files(tmp_path, fragment=fragment)
    with pytest.raises(ConfigError, match=says) as caught:
        load(path)
    assert str(caught.value).startswith(str(tmp_path / "cal.toml"))


def test_absent_calibration_and_a_sensor_that_is_not_there_are_refused(tmp_path: Path) -> None:
    path = files(tmp_path, 'vehicle = "t"\ncalibration = "cal.toml"\n')
    assert "$.imu: is not there, but" in refused(path)
    (tmp_path / "cal.toml").unlink()
    assert "cal.toml: cannot be read" in refused(path)
    assert "$.calibration: must be the name of a file" in refused(
        files(tmp_path, 'vehicle = "t"\ncalibration = 3\n')
    )


def test_merged_configuration_goes_into_the_record_and_comes_back(tmp_path: Path) -> None:
    vehicle = load(files(tmp_path))
    assert msgspec.json.decode(to_json(vehicle), type=Vehicle) == vehicle
    assert parse(to_toml(vehicle).encode(), "printed", Path("/")) == vehicle


def test_digest_is_of_the_values_and_not_of_where_they_come_from(tmp_path: Path) -> None:
    known = digest(load(files(tmp_path)))
    (tmp_path / "other").mkdir()
    assert digest(load(files(tmp_path / "other"))) == known
    by_hand = msgspec.structs.replace(load(files(tmp_path)), calibrated=None)
    assert digest(by_hand) == known
    other = FRAGMENT.replace("0.00012", "0.00013")
    assert digest(load(files(tmp_path, fragment=other))) != known


def test_config_shows_where_each_value_comes_from(tmp_path: Path) -> None:
    path = files(tmp_path)
    result = CliRunner().invoke(make_app("config"), ["config", str(path)])
    assert result.exit_code == 0
    lines = {line.split(" = ")[0]: line for line in result.stdout.splitlines() if " = " in line}
    origin = f"# {tmp_path / 'cal.toml'}: allan 2026-11-29T21:00:00Z"
    assert lines["gyro_noise_radps_rthz"].endswith(f"{origin}, σ 0.000001")
    assert f"lever_arm_m = [1.0, 0.5, 3.0]  {origin}" in result.stdout
    assert "#" not in lines["accel_noise_mps2_rthz"]
    assert f"[wheels.each.left]  {origin}" in result.stdout


def test_written_calibration_is_read_as_it_was(tmp_path: Path) -> None:
    source = Source.of("a ride.mcap", "t", 1_790_000_000 * 10**9, 1_790_000_060 * 10**9)
    assert (source.start, source.duration_s) == ("2026-09-21T14:13:20Z", 60.0)
    origin = Provenance.now("allan", (source,), {"imu.gyro_noise_radps_rthz": 1e-9}, ("one",))
    text = document({"imu": {"gyro_noise_radps_rthz": 1.2e-4}}, origin)
    vehicle = load(files(tmp_path, fragment=text))
    assert vehicle.imu is not None
    assert vehicle.imu.gyro_noise_radps_rthz == 1.2e-4
    known = vehicle.calibrated
    assert known is not None
    assert (known.tool, known.records, known.std, known.notes) == (
        "allan", (source,), {"imu.gyro_noise_radps_rthz": 1e-9}, ("one",),
    )  # fmt: skip


# Mounting -----------------------------------------------------------------------------------------
angles = some.floats(-180.0, 180.0)


@given(angles, some.one_of(some.floats(-90.0, 90.0), some.sampled_from([90.0, -90.0])), angles)
def test_angles_and_quaternion_are_one_turn_over_all_of_so3(
    roll: float, pitch: float, yaw: float
) -> None:
    q = mounting.quaternion_of((roll, pitch, yaw))
    C_bv = C_vl(*np.radians((roll, pitch, yaw)))
    np.testing.assert_allclose(mounting.matrix_of(q), C_bv, atol=1e-14)
    again = C_vl(*np.radians(mounting.angles_of(q)))
    np.testing.assert_allclose(again, C_bv, atol=1e-13)
    assert mounting.between_rad(q, mounting.quaternion_of(mounting.angles_of(q))) < 1e-7
    quaternion = Imu(device="", mounting_q_bv=q)
    np.testing.assert_allclose(C_bv_of(quaternion), C_bv, atol=1e-14)
    np.testing.assert_array_equal(C_bv_of(Imu(device="", mounting_deg=(roll, pitch, yaw))), C_bv)


def test_angle_between_two_mountings_is_that_of_their_turn() -> None:
    p = mounting.quaternion_of((10.0, 20.0, 30.0))
    q = mounting.product(mounting.quaternion_of((0.0, 0.0, 0.5)), p)
    assert np.degrees(mounting.between_rad(p, q)) == pytest.approx(0.5)
    assert mounting.between_rad(p, (-p[0], -p[1], -p[2], -p[3])) == pytest.approx(0.0, abs=1e-9)


def test_vehicle_of_a_quaternion_has_the_angles_too_and_one_that_differs_is_refused() -> None:
    w, x, y, z = mounting.quaternion_of((10.0, -90.0, 30.0))
    stated = f"mounting_q_bv = [{w}, {x}, {y}, {z}]\n"

    def text(more: str) -> bytes:
        return f'vehicle = "t"\n[imu]\ndevice = "d"\n{stated}{more}'.encode()

    vehicle = parse(text(""), "t", Path("/"))
    assert vehicle.imu is not None
    turned = C_vl(*np.radians((10.0, -90.0, 30.0)))
    np.testing.assert_allclose(C_vl(*np.radians(vehicle.imu.mounting_deg)), turned, atol=1e-13)
    assert parse(text("mounting_deg = [10, -90, 30]"), "t", Path("/")).imu == vehicle.imu
    for other in ("[10, -90, 31]", "[0, 0, 0]"):
        with pytest.raises(ConfigError, match="are different turns: state one"):
            parse(text(f"mounting_deg = {other}"), "t", Path("/"))


def test_mounting_that_two_files_state_in_two_ways_must_be_one_turn(tmp_path: Path) -> None:
    q = mounting.quaternion_of((1.0, 2.0, 3.0))
    own = OWN.replace("[gnss]", f"mounting_q_bv = {list(q)}\n[gnss]")
    assert load(files(tmp_path, own)).imu is not None
    other = FRAGMENT.replace("[1.0, 2.0, 3.0]", "[1.0, 2.0, 4.0]")
    assert "are different turns" in refused(files(tmp_path, own, other))


def test_records_made_before_are_read_with_one_deviation_of_the_mounting() -> None:
    old = '{"vehicle": "t", "imu": {"device": "d", "mounting_std_deg": 0.5}}'
    vehicle = msgspec.json.decode(old, type=Vehicle)
    assert vehicle.imu is not None
    assert mounting.about_axes(vehicle.imu.mounting_std_deg) == (0.5, 0.5, 0.5)
    assert config_file.digest(vehicle)
