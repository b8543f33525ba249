"""Records, rides and estimates from Python: what is opened how, and what is said of what is not."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest

import tramstream as ts
from tramstream import keys
from tramstream.analysis.notebook.localisation import configured
from tramstream.errors import ConfigError
from tramstream.proto.health_pb2 import ClockReference
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.file.writer import RecordFile
from tramstream.simulation.simulation import EPOCH_NS

S = 1_000_000_000


@pytest.fixture(scope="module")
def ride() -> ts.Record:
    return ts.simulate("kaspar2023", seed=3, duration_s=3.0)


def append(file: RecordFile, key: keys.Key, message: object, log_ns: int, number: int) -> None:
    payload = message if isinstance(message, bytes) else message.SerializeToString()
    file.append(key.on("x"), key, payload, log_ns, log_ns, number)


def test_ride_holds_its_truth_and_the_same_seed_is_the_same_ride(ride: ts.Record) -> None:
    truth = ride["raw/truth/state"]
    again = ts.simulate("kaspar2023", seed=3, duration_s=3.0)
    other = ts.simulate("kaspar2023", seed=4, duration_s=3.0)
    assert truth["stamp_ns"].tolist() == (EPOCH_NS + np.arange(61) * S // 20).tolist()
    gyro = ride["raw/imu/batch"]["gyro_z"]
    assert np.array_equal(again["raw/imu/batch"]["gyro_z"], gyro)
    assert not np.array_equal(other["raw/imu/batch"]["gyro_z"], gyro)
    np.testing.assert_allclose(truth.time_s, np.arange(61) / 20, atol=1e-9)
    assert truth.utc[0] == np.datetime64(EPOCH_NS, "ns")


def test_ride_without_a_name_goes_with_its_record() -> None:
    ride = ts.simulate("kaspar2023", duration_s=1.0)
    place = ride.place
    assert place is not None
    assert place.exists()
    del ride
    gc.collect()
    assert not place.exists()


def test_ride_with_a_name_stays_and_is_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "ride.mcap"
    ts.simulate("kaspar2023", duration_s=1.0, out=out).close()
    with pytest.raises(ts.TramstreamError, match="exists; delete it or name another"):
        ts.simulate("kaspar2023", duration_s=1.0, out=str(out))
    with ts.open_record(str(out)) as by_text, ts.open_record(tmp_path) as by_folder:
        assert list(by_text) == list(by_folder) == list(ts.open_record([out]))


def test_keys_are_a_mapping_and_wrong_ones_offer_near_ones(ride: ts.Record) -> None:
    assert list(ride) == sorted(ride)
    assert "raw/gnss/fix" in ride
    assert "raw/gnss/fax" not in ride
    assert ride.get("raw/gnss/fax") is None
    with pytest.raises(KeyError, match=r"no key 'raw/gnss/fax'; did you mean raw/gnss/fix"):
        ride["raw/gnss/fax"]


def test_full_topic_is_a_key_too(ride: ts.Record) -> None:
    topic = keys.GNSS_FIX.on(ride.vehicle)
    assert len(ride[topic]) == len(ride["raw/gnss/fix"])


def test_part_of_a_ride_is_cut_by_arrival(ride: ts.Record) -> None:
    part = ride.read("raw/truth/state", "speed_mps", start_s=1.0, end_s=2.0)
    assert part.keys() == ["stamp_ns", "speed_mps", "log_ns", "publish_ns", "sequence"]
    np.testing.assert_allclose(part.time_s, np.arange(20, 40) / 20, atol=1e-9)


@pytest.mark.parametrize("place", ["no.mcap", ".", []])
def test_no_record_is_one_sentence(tmp_path: Path, place: str | list[str]) -> None:
    with pytest.raises(ts.TramstreamError, match=r"no\.mcap|holds no record|no file is named"):
        ts.open_record(tmp_path / place if isinstance(place, str) else place)


def test_what_is_left_out_is_counted_and_warned_of(tmp_path: Path) -> None:
    with RecordFile(tmp_path / "x.mcap", "x", {}) as file:
        append(file, keys.TRUTH_STATE, TruthState(stamp_ns=S), S, 1)
        append(file, keys.TRUTH_STATE, b"\xff", 2 * S, 2)
    record = ts.open_record(tmp_path / "x.mcap")
    with pytest.warns(ts.LeftOutWarning, match="left out: 1 on raw/truth/state"):
        columns = record["raw/truth/state"]
    assert len(columns) == 1
    assert record.undecodable == {"raw/truth/state": 1}
    assert "1 on raw/truth/state" in record.left_out


def test_utc_follows_the_hosts_clock_as_the_record_knows_it(tmp_path: Path) -> None:
    """The host's clock was set between 20 and 30 s: before that it was 5 s behind."""
    with RecordFile(tmp_path / "x.mcap", "x", {}) as file:
        for number, (at_s, utc_s) in enumerate(((20, 115), (30, 130))):
            reference = ClockReference(stamp_ns=at_s * S, host_utc_ns=utc_s * S)
            append(file, keys.CLOCK, reference, at_s * S, number)
        for number, at_s in enumerate((10, 25, 35)):
            append(file, keys.TRUTH_STATE, TruthState(stamp_ns=at_s * S), at_s * S, number)
    columns = ts.open_record(tmp_path / "x.mcap")["raw/truth/state"]
    assert columns.utc.astype("int64").tolist() == [105 * S, 120 * S, 135 * S]
    assert columns.time_s.tolist() == [0.0, 15.0, 25.0]


def test_settings_change_what_they_name_and_nothing_else(ride: ts.Record, tmp_path: Path) -> None:
    own, changed = configured(ride, {}), configured(ride, {"ekf": {"integrity_risk": 0.01}})
    assert own.ekf.integrity_risk != changed.ekf.integrity_risk == 0.01
    assert changed.gnss == own.gnss
    assert changed.imu == own.imu
    assert own.vehicle == ride.settings["vehicle"]
    taken = configured(ride, {"ekf": {"pivot_m": np.float64(1.5)}, "odometer": None})
    assert taken.ekf.pivot_m == 1.5
    assert taken.odometer is None
    with pytest.raises(ConfigError, match=r"\$\.ekf\.modle: unknown field; did you mean model"):
        configured(ride, {"ekf": {"modle": "tram"}})
    with pytest.raises(ConfigError, match=r"no\.toml: cannot read"):
        configured(ride, tmp_path / "no.toml")


def test_evaluating_what_cannot_be_judged_names_the_cure_in_python(ride: ts.Record) -> None:
    with pytest.raises(ts.TramstreamError, match=r"holds no est/ekf/state; `ts\.localise"):
        ts.evaluate(ride)


def test_estimates_count_their_time_from_the_beginning_of_the_ride(ride: ts.Record) -> None:
    estimates = ts.localise(ride)
    state = estimates["est/ekf/state"]
    assert estimates.source is ride
    expected = (state["stamp_ns"] - ride.reader.start_ns) / S
    np.testing.assert_allclose(state.time_s, expected, atol=1e-9)


def test_one_of_several_files_is_not_localised_alone(tmp_path: Path) -> None:
    out = tmp_path / "ride.mcap"
    ts.simulate("kaspar2023", duration_s=1.0, out=out).close()
    with pytest.raises(ts.TramstreamError, match="open the folder that holds them"):
        ts.localise(ts.open_record([out]))
