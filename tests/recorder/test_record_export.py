"""What people take out of a record: figures, tables, tracks; and the verbs that print them."""

from __future__ import annotations

import csv
import json
import math

import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from record_samples import START_NS, VEHICLE, active, traffic, write

from tramstream import keys
from tramstream.cli.export import export
from tramstream.cli.info import info
from tramstream.cli.recover import recover
from tramstream.clock import S
from tramstream.errors import DamagedRecordError, RecordError
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.recorder.describe import describe
from tramstream.recorder.exports.csv_tables import export_csv
from tramstream.recorder.exports.geojson import geojson
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record


def put(record, key, message, log_ns, sequence):
    record.append(key.on(VEHICLE), key, message.SerializeToString(), log_ns, log_ns, sequence)


def described(path):
    with open_record(path) as record:
        return describe(record)


def test_gaps_and_restarts_are_counted_by_sequence_numbers(tmp_path):
    numbers = [5, 6, 9, 10, 20, 1, 2, 4]
    with RecordFile(tmp_path / "a.mcap", VEHICLE) as record:
        for step, number in enumerate(numbers):
            put(record, keys.ODO_WHEELS, Odometry(), START_NS + step * S, number)
        loss = Loss(key=keys.ODO_WHEELS.path, count=3, cause=Loss.DISK)
        put(record, keys.LOSS.at("recorder"), loss, START_NS + 9 * S, 1)
    description = described(tmp_path / "a.mcap")
    wheels = next(c for c in description.channels if c.path == keys.ODO_WHEELS.path)
    assert (wheels.count, wheels.gaps, wheels.missing, wheels.restarts) == (8, 3, 2 + 9 + 1, 1)
    assert wheels.rate_hz == pytest.approx(1.0)
    assert wheels.reported_lost == {"DISK": 3}
    assert description.duration_s == 9.0


def test_missing_part_is_named(tmp_path):
    for number in (1, 2, 4):
        write(
            tmp_path / f"{number}.mcap", traffic(3), metadata={"session": "s", "part": f"{number}"}
        )
    assert described(tmp_path).missing_parts == [3]


def test_info_prints_one_json_object(tmp_path, capsys):
    info([write(tmp_path / "a.mcap", traffic(200), 50)], as_json=True)
    figures = json.loads(capsys.readouterr().out)
    assert figures["message_count"] == 200
    assert figures["vehicle"] == VEHICLE
    assert figures["damages"] == []
    assert sum(channel["count"] for channel in figures["channels"]) == 200


def test_info_of_a_damaged_record_prints_and_ends_with_3(tmp_path, capsys):
    path = write(tmp_path / "a.mcap", traffic(200), 50)
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(DamagedRecordError, match="damaged") as damage:
        info([path])
    assert damage.value.exit_status == 3
    assert keys.IMU_BATCH.path in capsys.readouterr().out


def test_recover_finishes_an_unfinished_record_in_place(tmp_path, capsys):
    recover(active(tmp_path / "a.mcap", traffic(100), 30))
    assert capsys.readouterr().out.strip() == str(tmp_path / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_recover_writes_beside_a_damaged_record_and_ends_with_3(tmp_path, capsys):
    path = write(tmp_path / "a.mcap", traffic(200), 50)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(DamagedRecordError):
        recover(path, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    assert figures["target"] == str(tmp_path / "a.recovered.mcap")
    assert figures["messages"] == described(tmp_path / "a.recovered.mcap").message_count


def test_csv_has_a_column_a_field_with_lists_indexed(tmp_path):
    with RecordFile(tmp_path / "a.mcap", VEHICLE) as record:
        one = WheelReading(wheel="left", pulses=7)
        both = [one, WheelReading(wheel="right", speed_mps=1.5)]
        put(record, keys.ODO_WHEELS, Odometry(stamp_ns=1, sequence=1, wheels=[one]), 10, 1)
        put(record, keys.ODO_WHEELS, Odometry(stamp_ns=2, sequence=2, wheels=both), 20, 2)
        put(record, keys.LOSS.at("x"), Loss(cause=Loss.DISK), 30, 1)
    with open_record(tmp_path / "a.mcap") as record:
        written = export_csv(record, tmp_path / "out")
    assert [path.name for path in written] == ["raw_odo_wheels.csv", "health_x_loss.csv"]
    rows = list(csv.DictReader(written[0].open()))
    assert list(rows[0]) == [
        "log_ns",
        "publish_ns",
        "stamp_ns",
        "sequence",
        "wheels.0.wheel",
        "wheels.0.pulses",
        "wheels.1.wheel",
        "wheels.1.speed_mps",
    ]
    assert rows[0]["wheels.1.wheel"] == ""
    assert rows[1]["wheels.1.speed_mps"] == "1.5"
    assert next(csv.DictReader(written[1].open()))["cause"] == "DISK"


def test_csv_of_one_key_is_one_file(tmp_path, capsys):
    path = write(tmp_path / "a.mcap", traffic(300))
    export([path], csv=tmp_path / "fix.csv", key="raw/gnss/fix")
    assert len((tmp_path / "fix.csv").read_text().splitlines()) == 1 + 3
    with pytest.raises(RecordError, match="one file holds one key"):
        export([path], csv=tmp_path / "all.csv")
    with pytest.raises(RecordError, match="has no key"):
        export([path], csv=tmp_path / "x.csv", key="raw/gnss/none")


def test_export_without_a_format_says_which_there_are(tmp_path):
    with pytest.raises(RecordError, match="--geojson"):
        export([tmp_path])


def test_track_ends_its_line_where_positions_are_missing(tmp_path):
    with RecordFile(tmp_path / "a.mcap", VEHICLE) as record:
        for number, second in enumerate([0, 1, 2, 60, 61], 1):
            fix = LocationFix(
                latitude=50 + number * 1e-4,
                longitude=14.4,
                altitude=250,
                position_covariance=[4, 0, 0, 0, 9, 0, 0, 0, 16],
                position_covariance_type="KNOWN",
            )
            fix.timestamp.FromNanoseconds(START_NS + second * S)
            put(record, keys.GNSS_LOCATION, fix, START_NS + second * S, number)
        put(record, keys.GNSS_LOCATION, LocationFix(), START_NS + 70 * S, 6)
    with open_record(tmp_path / "a.mcap") as record:
        features = geojson(record)["features"]
    kinds = [feature["geometry"]["type"] for feature in features]
    assert kinds == ["LineString"] * 2 + ["Point"] * 5
    assert [len(feature["geometry"]["coordinates"]) for feature in features[:2]] == [3, 2]
    assert features[2]["geometry"]["coordinates"] == [14.4, 50.0001, 250.0]
    assert features[2]["properties"]["stamp_ns"] == START_NS
    assert features[2]["properties"]["horizontal_std_m"] == pytest.approx(13**0.5)
    assert features[2]["properties"]["vertical_std_m"] == 4.0


@pytest.mark.parametrize("key", [keys.GNSS_LOCATION, keys.GNSS_FIX], ids=lambda key: key.path)
def test_position_without_a_height_has_two_coordinates(tmp_path, key):
    if key is keys.GNSS_LOCATION:
        fix = LocationFix(latitude=50.0, longitude=14.4, altitude=math.nan)
        fix.timestamp.FromNanoseconds(START_NS)
    else:
        fix = GnssFix(stamp_ns=START_NS, latitude_deg=50.0, longitude_deg=14.4, valid=True)
    with RecordFile(tmp_path / "a.mcap", VEHICLE) as record:
        put(record, key, fix, START_NS, 1)
    with open_record(tmp_path / "a.mcap") as record:
        (point,) = geojson(record)["features"]
    assert point["geometry"]["coordinates"] == [14.4, 50.0]


def test_track_of_raw_fixes_where_nothing_else_is(tmp_path, capsys):
    path = write(tmp_path / "a.mcap", traffic(300))
    export([path], geojson=tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert [f["geometry"]["type"] for f in features] == ["LineString"] + ["Point"] * 3
