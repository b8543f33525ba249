"""`tramstream allan`: figures of standstill, what it refuses to give figures of, what it writes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import allantools
import numpy as np
import pytest
from numpy.typing import NDArray
from standing import ACCEL_MPS2, GYRO_RADPS, START_NS, white, write_record
from typer.testing import CliRunner, Result

from tramstream import keys
from tramstream.analysis.calibration.inertial import inertial_samples
from tramstream.analysis.notebook.rides import simulate
from tramstream.cli.main import make_app
from tramstream.config_file import load
from tramstream.errors import CheckFailedError, ConfigError, DamagedRecordError, RecordError
from tramstream.proto.gnss_pb2 import EsfMeasurements
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.message_columns import read_columns
from tramstream.recorder.reader import open_record
from tramstream.simulation import scenario

RATE_HZ = 20.0
COUNT = 7000
"""350 s."""
STD = 20.0


def allan(*arguments: object) -> Result:
    """Run the verb in this process."""
    return CliRunner().invoke(make_app("allan"), ["allan", *map(str, arguments)])


def figures(*arguments: object) -> dict[str, Any]:
    result = allan(*arguments, "--json")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def verdict(*arguments: object) -> str:
    """What is said instead of figures; nothing looks like one."""
    result = allan(*arguments, "--json")
    assert isinstance(result.exception, CheckFailedError)
    assert result.exception.exit_status == 1
    told = json.loads(result.stdout)
    assert told["axes"] == []
    assert told["settings"] == {"imu": {}}
    assert told["verdict"] in str(result.exception)
    return str(told["verdict"])


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("still") / "still.mcap"
    write_record(path, white(COUNT, STD), RATE_HZ)
    return path


def test_white_noise_is_found_and_what_is_not_there_is_said(still: Path) -> None:
    found = figures(still)
    assert found["key"] == keys.IMU_BATCH.path
    assert found["rate_hz"] == pytest.approx(RATE_HZ)
    assert found["standing_s"] == pytest.approx(COUNT / RATE_HZ)
    assert found["moving_s"] == 0
    for axis, each in enumerate(found["axes"]):
        unit = GYRO_RADPS if axis < 3 else ACCEL_MPS2
        white_noise = math.hypot(STD, math.sqrt(1 / 12)) * unit / math.sqrt(RATE_HZ)
        of_fit = each["fit"]["N"]
        assert of_fit["value"] == pytest.approx(white_noise, abs=4 * of_fit["std"])
        assert of_fit["std"] / of_fit["value"] == pytest.approx(1 / math.sqrt(2 * COUNT), rel=0.02)
        assert each["tangents"]["N"] == pytest.approx(white_noise, rel=0.3)
    largest = max(each["fit"]["N"]["value"] for each in found["axes"][:3])
    assert found["settings"]["imu"]["gyro_noise_radps_rthz"] == largest


def test_deviation_of_a_record_is_that_of_allantools(still: Path) -> None:
    counts = white(COUNT, STD)
    for number, each in enumerate(figures(still)["axes"]):
        unit = GYRO_RADPS if number < 3 else ACCEL_MPS2
        tau_s, deviation, _, _ = allantools.oadev(
            counts[:, number] * unit, rate=RATE_HZ, data_type="freq", taus=np.array(each["tau_s"])
        )
        np.testing.assert_allclose(tau_s, each["tau_s"])
        np.testing.assert_allclose(deviation, each["allan_deviation"], rtol=1e-9)


def test_columns_read_out_of_bytes_are_those_of_the_messages(still: Path) -> None:
    with open_record(still) as record:
        samples = list(inertial_samples(record))
        topic = keys.IMU_BATCH.on("still")
        columns = read_columns(record, {topic: ()})[topic]
    assert len(samples) == 1
    (one,) = samples
    for name, row in zip(
        ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"), one.counts, strict=True
    ):
        np.testing.assert_array_equal(np.asarray(columns[name]).ravel(), row)
    np.testing.assert_array_equal(one.stamp_ns, columns["stamp_ns"])
    np.testing.assert_array_equal(one.first, columns["first_sample_sequence"])
    np.testing.assert_array_equal(one.period_ns, columns["period_ns"])
    np.testing.assert_array_equal(one.accel_scale_mps2, columns["accel_scale_mps2"])
    np.testing.assert_allclose(one.temperature_degc, 25.0)
    assert set(one.length.tolist()) == {20}


@pytest.mark.parametrize("value", [0, 1, -1, 63, 64, -64, -65, 8191, -8192, 2**31 - 1, -(2**31)])
def test_every_count_that_a_message_holds_is_read(value: int, tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    write_record(path, np.full((40, 6), value, np.int32), RATE_HZ)
    with open_record(path) as record:
        (one,) = inertial_samples(record)
    assert np.all(one.counts == value)
    assert one.counts.shape == (6, 40)


def odd_record(path: Path, payloads: list[bytes]) -> None:
    with RecordFile(path, "odd", {}) as record:
        for number, payload in enumerate(payloads):
            topic = keys.IMU_BATCH.on("odd")
            stamp_ns = START_NS + number
            record.append(topic, keys.IMU_BATCH, payload, stamp_ns, stamp_ns, number + 1)


def test_messages_of_other_writers_and_torn_ones_are_read_or_counted(tmp_path: Path) -> None:
    columns = {name: [1, -200, 3] for name in ("gyro_x", "gyro_y", "gyro_z")}
    columns |= {name: [4, 5, -600] for name in ("accel_x", "accel_y", "accel_z")}
    plain = ImuBatch(stamp_ns=5, first_sample_sequence=7, period_ns=1e6, **columns)
    whole = plain.SerializeToString()
    short = ImuBatch(stamp_ns=5, gyro_x=[1, 2], gyro_y=[1]).SerializeToString()
    # gyro_x one by one: the same message, as an older protobuf writer lays it out.
    rest = ImuBatch(**{**{n: v for n, v in columns.items() if n != "gyro_x"}, "stamp_ns": 5})
    one_by_one = rest.SerializeToString() + b"".join(
        bytes([9 << 3]) + bytes(each) for each in ([2], [0x8F, 0x03], [6])
    )
    path = tmp_path / "odd.mcap"
    odd_record(path, [whole, whole[:-1], short, one_by_one, b"", whole])
    with open_record(path) as record:
        found = list(inertial_samples(record))
        assert sum(record.undecodable.values()) == 1
    rows = np.concatenate([each.counts for each in found], axis=1)
    assert rows[0].tolist() == [1, -200, 3] * 3
    assert rows[5].tolist() == [4, 5, -600] * 3


# What there are no figures of ---------------------------------------------------------------------
@pytest.mark.parametrize(
    ("count", "says"),
    [
        (1, "one inertial sample, which has no noise"),
        (2, "0.1 s of inertial samples are too short"),
        (48, "2.4 s of inertial samples are too short: figures need 300 s of standstill"),
        (1200, "60 s of inertial samples are too short"),
    ],
)
def test_too_short_a_record_has_a_verdict_and_no_figures(
    count: int, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "short.mcap"
    write_record(path, white(count, STD), RATE_HZ)
    assert says in verdict(path)


def test_record_without_inertial_samples_has_a_verdict(tmp_path: Path) -> None:
    path = tmp_path / "none.mcap"
    odd_record(path, [ImuBatch(stamp_ns=1, period_ns=1e6).SerializeToString()])
    assert verdict(path) == "there are no inertial samples"
    simulate(scenario.parse(b"end_s = 1.0\n", "x"), duration_s=2.0, out=tmp_path / "bare.mcap")
    assert verdict(tmp_path / "bare.mcap") == "there are no inertial samples"


RIDE = b"[imu]\nrate_hz = 50.0\nbatch = 10\n[driver]\nfirst_dwell_s = 0.0\ndwell_s = 3.0\n"


def test_ride_has_a_verdict(tmp_path: Path) -> None:
    path = tmp_path / "ride.mcap"
    simulate(scenario.parse(RIDE, "ride"), duration_s=400.0, out=path)
    assert "moves or shakes" in verdict(path)


def test_ride_at_constant_speed_is_seen_by_the_wheels(tmp_path: Path) -> None:
    text = RIDE + b"[wheels]\nrate_hz = 5.0\n"
    path = tmp_path / "ride.mcap"
    simulate(scenario.parse(text, "ride"), duration_s=400.0, out=path)
    result = allan(path, "--json")
    told = json.loads(result.stdout)
    assert told["standing_s"] < 60.0
    for begin_s, end_s in told["stretches_s"]:
        assert end_s - begin_s < 60.0


def moved(counts: NDArray[np.int32], begin_s: float, end_s: float) -> NDArray[np.int32]:
    """The same with somebody who shakes the case between two times."""
    rng = np.random.default_rng(8)
    span = slice(int(begin_s * RATE_HZ), int(end_s * RATE_HZ))
    length = span.stop - span.start
    counts[span] += np.rint(2000 * rng.standard_normal((length, 6))).astype(np.int32)
    return counts


def test_stretches_that_move_are_found_and_left_out(tmp_path: Path, still: Path) -> None:
    path = tmp_path / "moved.mcap"
    write_record(path, moved(white(COUNT, STD), 100.0, 110.0), RATE_HZ)
    found = figures(path)
    (_, end_s), (begin_s, _) = found["stretches_s"]
    assert 95.0 < end_s <= 100.0
    assert 110.0 <= begin_s < 115.0
    assert found["moving_s"] == pytest.approx(10.0, abs=2.0)
    for own, quiet in zip(found["axes"], figures(still)["axes"], strict=True):
        one, other = own["fit"]["N"], quiet["fit"]["N"]
        assert one["value"] == pytest.approx(other["value"], abs=4 * one["std"])


def test_shaken_all_the_time_has_a_verdict(tmp_path: Path) -> None:
    path = tmp_path / "shaken.mcap"
    counts = white(COUNT, STD)
    for begin_s in range(0, 344, 8):
        moved(counts, begin_s, begin_s + 2)
    write_record(path, counts, RATE_HZ)
    assert "moves or shakes all the time" in verdict(path)


def test_dead_axis_has_no_figures_and_the_others_have(tmp_path: Path) -> None:
    path = tmp_path / "dead.mcap"
    counts = white(COUNT, STD)
    counts[:, 1] = 7
    counts[:, 4] = np.maximum(counts[:, 4] - 32700, -32768)
    write_record(path, counts, RATE_HZ)
    axes = {each["axis"]: each for each in figures(path)["axes"]}
    assert axes["gyro y"]["trouble"] == "reads 7 counts throughout: dead or stuck"
    assert "at the end of its range" in axes["accel y"]["trouble"]
    for name, each in axes.items():
        assert ("fit" in each) == (name not in ("gyro y", "accel y"))


def test_lost_samples_are_bridged_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "lost.mcap"
    write_record(path, white(COUNT, STD), RATE_HZ, lost=lambda number: number in (100, 200, 300))
    found = figures(path)
    assert found["bridged_samples"] == 60
    assert found["stretches_s"] == [[0.0, COUNT / RATE_HZ]]


def test_long_gap_parts_two_stretches(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    write_record(path, white(COUNT, STD), RATE_HZ, lost=lambda number: 200 <= number < 220)
    found = figures(path)
    assert found["bridged_samples"] == 0
    assert len(found["stretches_s"]) == 2


def test_other_sensor_on_the_way_is_refused(tmp_path: Path, still: Path) -> None:
    other = tmp_path / "other.mcap"
    write_record(other, white(COUNT, STD), 2 * RATE_HZ)
    result = allan(still, other)
    assert isinstance(result.exception, RecordError)
    assert "name the records of one" in str(result.exception)


def test_two_records_tell_together(tmp_path: Path, still: Path) -> None:
    other = tmp_path / "other.mcap"
    write_record(other, white(COUNT, STD, seed=2), RATE_HZ)
    found = figures(still, other)
    assert found["standing_s"] == pytest.approx(2 * COUNT / RATE_HZ)
    assert len(found["records"]) == 2
    assert len(found["stretches_s"]) == 2


def test_damaged_record_is_said_and_the_rest_is_read(tmp_path: Path, still: Path) -> None:
    path = tmp_path / "damaged.mcap"
    data = bytearray(still.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    result = allan(path, "--least-s", 60, "--json")
    assert isinstance(result.exception, DamagedRecordError)
    assert json.loads(result.stdout)["axes"]


# What is written ----------------------------------------------------------------------------------
def test_written_calibration_is_one_that_a_vehicle_names(tmp_path: Path, still: Path) -> None:
    out = tmp_path / "imu.toml"
    found = figures(still, "-o", out)
    config = tmp_path / "tram.toml"
    config.write_text('vehicle = "t"\ncalibration = "imu.toml"\n[imu]\ndevice = "d"\n')
    vehicle = load(config)
    assert vehicle.imu is not None
    assert vehicle.calibrated is not None
    for name, value in found["settings"]["imu"].items():
        assert getattr(vehicle.imu, name) == value
    assert vehicle.calibrated.records[0].file == str(still)
    assert vehicle.calibrated.records[0].duration_s == pytest.approx(COUNT / RATE_HZ, abs=1)
    assert any("gyro_walk_radps2_rthz: not seen" in note for note in vehicle.calibrated.notes)
    again = allan(still, "-o", out)
    assert isinstance(again.exception, ConfigError)
    assert "exists already" in str(again.exception)


def test_nothing_is_written_without_figures(tmp_path: Path) -> None:
    path, out = tmp_path / "short.mcap", tmp_path / "imu.toml"
    write_record(path, white(100, STD), RATE_HZ)
    verdict(path, "-o", out)
    assert not out.exists()


def test_page_and_table_are_of_the_same_fit(tmp_path: Path, still: Path) -> None:
    page = tmp_path / "allan.html"
    result = allan(still, "--page", page)
    assert result.exit_code == 0
    value = figures(still)["axes"][0]["fit"]["N"]["value"]
    assert f"{value:.4g}" in result.stdout
    assert "not seen, at most" in result.stdout
    text = page.read_text()
    assert f"{value:.4g}" in text
    assert "not seen, at most" in text
    assert "http-equiv" in text


def test_receivers_own_sensors_are_read(tmp_path: Path) -> None:
    path = tmp_path / "esf.mcap"
    counts = white(4000, STD)
    with RecordFile(path, "esf", {}) as record:
        for number, row in enumerate(counts.tolist()):
            message = EsfMeasurements(source="ESF-MEAS", stamp_ns=START_NS + number * 100_000_000)
            for kind, raw in zip((14, 13, 5, 16, 17, 18), row, strict=True):
                message.items.add(type=kind, raw=raw, time_tag=5000 + 100 * number)
            stamp_ns, topic = message.stamp_ns, keys.GNSS_ESF_MEASUREMENTS.on("esf")
            payload = message.SerializeToString()
            record.append(
                topic, keys.GNSS_ESF_MEASUREMENTS, payload, stamp_ns, stamp_ns, number + 1
            )
    found = figures(path)
    assert found["key"] == keys.GNSS_ESF_MEASUREMENTS.path
    assert found["rate_hz"] == pytest.approx(10.0)
    expected = STD * math.radians(2.0**-12) / math.sqrt(10.0)
    assert found["axes"][0]["fit"]["N"]["value"] == pytest.approx(expected, rel=0.05)
    assert found["axes"][5]["fit"]["N"]["value"] == pytest.approx(
        STD * 2.0**-10 / math.sqrt(10.0), rel=0.05
    )
