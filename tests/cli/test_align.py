"""`tramstream align`: the mounting out of a record, what it writes, and when it gives no figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mounted import TURN, drawn, ride, write_record
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from tramstream import mounting
from tramstream.analysis.mounting.drive import Inertial
from tramstream.analysis.studies.mounting_rides import off_rad
from tramstream.attitude import C_vl
from tramstream.cli.main import make_app
from tramstream.config_file import load
from tramstream.errors import CheckFailedError, ConfigError

Array = NDArray[np.float64]
MAPPING = Path(__file__).resolve().parent.parent.parent / "mappings" / "rtkx.toml"


def align(*arguments: object) -> Result:
    """Run the verb in this process."""
    return CliRunner().invoke(make_app("align"), ["align", *map(str, arguments)])


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    write_record(path, drawn().drive)
    return path


def verdict(path: Path) -> str:
    """What is said instead of figures; nothing looks like one."""
    result = align(path, "--json")
    assert isinstance(result.exception, CheckFailedError)
    assert result.exception.exit_status == 1
    told: dict[str, Any] = json.loads(result.stdout)
    assert told["verdict"]
    for name in ("mounting_q_bv", "mounting_deg", "mounting_std_deg"):
        assert told[name] is None
    assert all(each["C_bv"] is None and each["std_deg"] is None for each in told["rides"])
    return str(told["verdict"])


def test_mounting_of_a_record_is_found_and_the_vehicle_takes_it(
    record: Path, tmp_path: Path
) -> None:
    out = tmp_path / "tram.calibration.toml"
    result = align(record, "-o", out, "--json")
    assert result.exception is None, result.exception
    told = json.loads(result.stdout)
    C_bv = np.array(mounting.matrix_of(tuple(told["mounting_q_bv"])))
    off = np.degrees(off_rad(C_bv.T, TURN.T))
    assert np.all(np.abs(off) < 4 * np.array(told["mounting_std_deg"]))
    assert max(told["mounting_std_deg"]) < 0.5
    assert told["cross_level_part_deg"][0] > 0.02  # upright is what straight track says
    assert [each["holds"] for each in told["rides"][0]["theses"]] == [True] * 5
    config = tmp_path / "tram.toml"
    config.write_text(
        f'vehicle = "simulated"\ncalibration = "{out.name}"\n[imu]\ndevice = "/dev/null"\n'
    )
    imu = load(config).imu
    assert imu is not None
    assert imu.mounting_q_bv == pytest.approx(told["mounting_q_bv"])
    assert imu.mounting_std_deg == pytest.approx(tuple(told["mounting_std_deg"]), abs=1e-4)
    again = align(record, "-o", out)
    assert isinstance(again.exception, ConfigError)
    assert "--overwrite" in str(again.exception)


def test_page_shows_the_ride_in_vehicle_axes(record: Path, tmp_path: Path) -> None:
    page = tmp_path / "align.html"
    assert align(record, "--page", page).exception is None
    text = page.read_text()
    for each in ("Mounting of the IMU", "Force in the vehicle", "at a stand the force points up"):
        assert each in text


def test_table_names_axes_deviations_and_theses(record: Path) -> None:
    printed = align(record).stdout
    for text in ("roll", "pitch", "yaw", "mounting_q_bv", "cross-level", "holds", "departures"):
        assert text in printed


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("dead", "gyro z reads 0 throughout: it is dead"),
        ("stuck", "accel x is stuck from 1"),
        ("clipped", "accel z is clipped"),
    ],
)
def test_axis_that_is_no_sensor_gets_no_figure(tmp_path: Path, what: str, said: str) -> None:
    f_b, omega_b = (each.copy() for each in drawn().drive.inertial)
    if what == "dead":
        omega_b[:, 2] = 0.0
    elif what == "stuck":
        f_b[1200:, 0] = f_b[1200, 0]
    else:
        limit = float(np.percentile(f_b[:, 2], 90))
        f_b[:, 2] = np.minimum(f_b[:, 2], limit)
    path = tmp_path / f"{what}.mcap"
    write_record(path, drawn().drive._replace(inertial=Inertial(f_b, omega_b)))
    assert said in verdict(path)


def test_record_without_fixes_gets_no_figure(tmp_path: Path) -> None:
    path = tmp_path / "blind.mcap"
    write_record(path, drawn().drive, fixes=False)
    assert "no fixes" in verdict(path)


def test_work_s_two_stages_tell_a_record_s_mounting(record: Path) -> None:
    told = json.loads(align(record, "--model", "melenovsky2023", "--json").stdout)["rides"][0]
    for name in ("initial_deg", "mounting_deg"):
        C_bv = C_vl(*np.radians(told[name]))
        assert np.degrees(np.linalg.norm(off_rad(C_bv.T, TURN.T))) < 6.0


def test_two_records_are_put_together(record: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    write_record(other, drawn(seed=2).drive)
    one = json.loads(align(record, "--json").stdout)
    both = json.loads(align(record, other, "--json").stdout)
    assert both["chance"] > 1e-3
    shares = np.array(both["mounting_std_deg"]) / np.array(one["mounting_std_deg"])
    assert shares == pytest.approx([0.71] * 3, abs=0.1)
    assert ride()[1].vehicle == "simulated"


@pytest.mark.realdata
def test_rtkx_is_mounted_as_its_authors_say(data_dir: Path, tmp_path: Path) -> None:
    """Case to a body with axes forward, right, down: 180, −6.79, 185.35°, good to 0.5°."""
    path = tmp_path / "rtkx.mcap"
    drive = data_dir / "drives" / "rtkx_first_half"
    arguments = ["import", "--csv", drive, "--mapping", MAPPING, "-o", path]
    assert CliRunner().invoke(make_app("import"), list(map(str, arguments))).exit_code == 0
    road = ("--cross-level-deg", 1, "--cross-level-m", 500)
    told = json.loads(align(path, *road, "--json").stdout)
    C_bv = np.array(mounting.matrix_of(tuple(told["mounting_q_bv"])))
    theirs = C_vl(*np.radians([180.0, -6.79, 185.35])).T @ np.diag([1.0, -1.0, -1.0])
    off = np.degrees(off_rad(C_bv.T, theirs.T))
    assert np.all(np.abs(off) < 0.7)
    assert np.all(np.abs(off) < 3 * np.hypot(told["mounting_std_deg"], 0.25))
