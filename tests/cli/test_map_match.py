"""`tramstream map match`: what it says of a path, and where its rides come from."""

from __future__ import annotations

import csv
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.message import Message
from looking import START_NS, VEHICLE, write_fixes
from networks import town

from tramstream import keys
from tramstream.analysis.studies.match_source import Source
from tramstream.cli.map_match import describe, match
from tramstream.errors import ConfigError, RecordError
from tramstream.keys import Key
from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.lines import lay_lines, path_of
from tramstream.processors.matching.offline import Leg, Place
from tramstream.processors.matching.offline import Path as MatchedPath
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import ClockReference
from tramstream.recorder.file.writer import RecordFile
from tramstream.tracks.linear_reference import references
from tramstream.tracks.network import Network

START = datetime(2026, 9, 21, 8, 0, tzinfo=UTC)
S = 1_000_000_000


@pytest.fixture(scope="module")
def network() -> Network:
    return lay_lines(town(), [LineRequest("9", "out", ("West", "Far", "West"))])[0]


@pytest.fixture(scope="module")
def file(network: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("net") / "town.net"
    network.save(path)
    return path


def source(*legs: Leg) -> Source:
    places = [Place(k * S, leg.run, leg.begin_m, 0.5, 1.0) for k, leg in enumerate(legs)]
    stamps = np.arange(len(legs), dtype=np.int64) * S
    path = MatchedPath(places, list(legs))
    return Source(stamps, np.zeros((len(legs), 2)), None, path, "made up", ())


def ride(network: Network) -> bytes:
    """Points along the line at 8 m/s, once a second."""
    line = network.lines[0]
    path = path_of(network, line.runs, line.begin_m, line.length_m)
    at = np.arange(0.0, 1000.0, 8.0)
    plan = np.column_stack([np.interp(at, path[:, 0], path[:, k]) for k in (1, 2)])
    degrees = np.degrees(network.geodetic_of(plan)).tolist()
    points = "".join(
        f'<trkpt lat="{latitude:.8f}" lon="{longitude:.8f}">'
        f"<time>{(START + timedelta(seconds=k)).isoformat()}</time></trkpt>"
        for k, (latitude, longitude) in enumerate(degrees)
    )
    return f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>".encode()


# Figures ------------------------------------------------------------------------------------------
def test_leg_reaches_to_the_end_of_its_run_where_the_next_one_joins(network):
    legs = Leg(0, 0, S, 100.0, 593.0, 0.99), Leg(2, S, 2 * S, 4.0, 300.0, 0.9)
    figures = describe(network, references(network), source(*legs))
    assert [(leg["from_m"], leg["to_m"]) for leg in figures["path"]] == [(100, 600), (0, 300)]
    assert figures["length_m"] == pytest.approx(800)
    joined = Leg(0, 0, S, 100.0, 593.0, 0.99), Leg(8, S, 2 * S, 4.0, 300.0, 0.9)
    figures = describe(network, references(network), source(*joined))
    assert [(leg["from_m"], leg["to_m"]) for leg in figures["path"]] == [(100, 593), (4, 300)]


def test_leg_tells_where_on_the_line_it_is(network):
    figures = describe(network, references(network), source(Leg(2, 0, S, 50.0, 150.0, 1.0)))
    (line,) = figures["path"][0]["lines"]
    assert (line["line"], line["direction"], line["destination"]) == ("9", "out", "West")
    assert (line["from_m"], line["to_m"]) == pytest.approx((600, 700))


def test_ride_off_the_map_has_no_length(network):
    figures = describe(network, references(network), source(Leg(-1, 0, S, 0.0, 0.0, 0.0)))
    assert (figures["length_m"], figures["on_track_share"], figures["across_rms_m"]) == (0, 0, None)
    assert figures["path"][0]["edge"] is None
    assert "km away" in figures["notes"][-1]
    json.dumps(figures, allow_nan=False)


# Rides --------------------------------------------------------------------------------------------
def test_trace_along_a_line_is_matched_to_its_runs(network, file, tmp_path, capsys):
    (tmp_path / "ride.gpx").write_bytes(ride(network))
    page, table = tmp_path / "ride.html", tmp_path / "ride.csv"
    match(tmp_path / "ride.gpx", file, page, table, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    edges = [leg["edge"] for leg in figures["path"] if leg["edge"]]
    assert edges[-3:] == [network.name_of(run) for run in (0, 2, 4)]
    assert figures["across_rms_m"] < 1.0
    assert figures["path"][-1]["to_m"] == pytest.approx(992.0 + 50.0 - 1000.0, abs=5.0)
    assert "default-src 'none'" in page.read_text()
    with table.open(newline="", encoding="utf-8") as opened:
        rows = [row for row in csv.DictReader(opened) if row["edge"]]
    last = rows[-1]
    assert (last["line"], last["direction"]) == ("9", "out")
    assert float(last["line_chainage_m"]) == pytest.approx(992.0, abs=5.0)
    assert figures["path"][0]["entered"] == "2026-09-21 08:00:00"


def write_states(path: Path, network: Network) -> Path:
    """States of a ride along the first street at 10 m/s, without covariance; UTC is 7 s ahead."""
    with RecordFile(path, VEHICLE) as record:

        def append(key: Key, message: Message, stamp_ns: int, sequence: int) -> None:
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, stamp_ns, stamp_ns, sequence)

        reference = ClockReference(stamp_ns=0, host_utc_ns=7 * S)
        append(keys.CLOCK, reference, START_NS, 1)
        for k in range(400):
            stamp_ns = START_NS + k * S // 10
            latitude_deg, longitude_deg = np.degrees(network.geodetic_of([100.0 + k, 0.5])).tolist()
            state = MotionState(
                stamp_ns=stamp_ns,
                mode=MotionState.TRACKING,
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                height_ellipsoid_m=250.0,
                speed_mps=10.0,
            )
            append(keys.EST_STATE, state, stamp_ns, k + 1)
    return path


def test_record_is_matched_by_its_states(network, file, tmp_path, capsys):
    match(write_states(tmp_path / "ride.mcap", network), file, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    (leg,) = figures["path"][-1:]
    assert leg["edge"] == network.name_of(0)
    assert leg["to_m"] == pytest.approx(499.0, abs=1.0)
    assert leg["lines"][0]["to_m"] == pytest.approx(449.0, abs=1.0)
    assert figures["across_rms_m"] == pytest.approx(0.5, abs=0.05)
    assert figures["path"][0]["entered"] == "2026-09-21 14:13:27"


def test_record_of_a_receiver_alone_is_matched_by_its_fixes(network, file, tmp_path, capsys):
    with RecordFile(tmp_path / "fixes.mcap", VEHICLE) as record:
        for k in range(60):
            latitude_deg, longitude_deg = np.degrees(network.geodetic_of([8.0 * k, 1.0])).tolist()
            stamp_ns = START_NS + k * S
            fix = GnssFix(
                stamp_ns=stamp_ns,
                sequence=k + 1,
                valid=True,
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
            )
            topic, payload = keys.GNSS_FIX.on(VEHICLE), fix.SerializeToString()
            record.append(topic, keys.GNSS_FIX, payload, stamp_ns, stamp_ns, k + 1)
    match(tmp_path / "fixes.mcap", file, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    assert figures["path"][-1]["edge"] == network.name_of(0)
    assert "its fixes were matched" in figures["notes"][0]


def test_record_without_anything_to_match_is_refused(file, tmp_path):
    with pytest.raises(RecordError, match="neither est/ekf/state nor fixes"):
        match(write_fixes(tmp_path / "fixes.mcap", [1, 2, 3]), file)


def test_outputs_never_take_the_place_of_what_is_there(network, file, tmp_path):
    trace = tmp_path / "ride.gpx"
    trace.write_bytes(ride(network))
    with pytest.raises(ConfigError, match="choose another"):
        match(trace, file, csv=trace, overwrite=True)
    page = tmp_path / "there.html"
    page.write_text("old")
    with pytest.raises(ConfigError, match="exists already"):
        match(trace, file, page)


def test_file_of_no_kind_is_refused(file, tmp_path):
    (tmp_path / "odd.gpx").write_bytes(b"odd")
    with pytest.raises(ConfigError, match="neither GPX nor GeoJSON"):
        match(tmp_path / "odd.gpx", file)
