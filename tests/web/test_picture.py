"""What the page shows of messages."""

from __future__ import annotations

import math

from looking import VEHICLE, envelope

from tramstream import keys
from tramstream.clock import S
from tramstream.keys import Key
from tramstream.monitor.stats import Stats
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.proto.gnss_pb2 import GnssFix, GnssSatellites
from tramstream.proto.health_pb2 import DeviceHealth, Event, NodeHealth
from tramstream.proto.raw_pb2 import Odometry
from tramstream.transport.descriptions import Decoder
from tramstream.web.columns import COLUMNS
from tramstream.web.picture import EVENTS_KEPT, EVENTS_SENT, Picture

NOW_NS = 1_790_000_000 * S


class Shown:
    """A picture that is fed as the page feeds it."""

    def __init__(self) -> None:
        self.stats = Stats()
        self.picture = Picture(self.stats, Decoder(), VEHICLE)

    def put(self, key: Key, message, arrival_ns: int = NOW_NS) -> None:
        found = envelope(key, message, arrival_ns)
        self.stats.add(found)
        self.picture.add(found)


def state(**fields) -> MotionState:
    return MotionState(
        **{"stamp_ns": NOW_NS, "mode": MotionState.TRACKING, "latitude_deg": 50.0,
           "longitude_deg": 14.0, "speed_mps": 10.0, "yaw_rad": math.radians(30.0), **fields}
    )  # fmt: skip


def test_nothing_is_shown_before_anything_came() -> None:
    frame = Shown().picture.frame(NOW_NS)
    assert [frame[name] for name in ("state", "gnss", "wheels", "match", "grade")] == [None] * 5
    assert "row" not in frame


def test_place_is_of_now_and_certainty_of_the_filter() -> None:
    shown = Shown()
    shown.put(keys.EST_STATE, state(latitude_deg=49.9, along_std_m=0.4, protection_across_m=2.0))
    shown.put(keys.EST_NOW, state(latitude_deg=50.1))
    found = shown.picture.frame(NOW_NS)["state"]
    assert (found["latitude_deg"], found["along_std_m"]) == (50.1, 0.4)
    assert found["protection_across_m"] == 2.0
    assert found["mode"] == "TRACKING"
    assert found["heading_deg"] == 60.0  # 30° counter-clockwise from east


def test_heading_that_nobody_knows_is_not_shown() -> None:
    shown = Shown()
    shown.put(keys.EST_STATE, state(mode=MotionState.HEADING_UNKNOWN))
    frame = shown.picture.frame(NOW_NS)
    assert frame["state"]["heading_deg"] is None
    assert frame["row"][COLUMNS.index("heading_deg")] is None


def test_what_came_too_long_ago_is_not_shown_as_if_it_were_of_now() -> None:
    shown = Shown()
    shown.put(keys.EST_STATE, state())
    shown.put(keys.GNSS_FIX, GnssFix(stamp_ns=NOW_NS, valid=True, latitude_deg=50))
    late = shown.picture.frame(NOW_NS + 10 * S)
    assert late["state"] is None
    assert late["gnss"] is None
    assert shown.picture.frame(NOW_NS)["state"] is not None


def test_innovations_between_two_frames_are_told_by_their_largest_and_refusals_are_counted() -> (
    None
):
    shown = Shown()
    first, second = state(), state()
    for name, value, accepted in (("gnss_east", -3.0, True), ("wheel_a", 1.0, False)):
        first.innovations.add(measurement=name, value=value, variance=4.0, accepted=accepted)
    second.innovations.add(measurement="gnss_north", value=2.0, variance=4.0, accepted=False)
    second.innovations.add(measurement="wheel_b", value=0.5, variance=4.0, accepted=False)
    for each in (first, second):
        shown.put(keys.EST_STATE, each)
    frame = shown.picture.frame(NOW_NS)
    assert frame["innovations"] == {"gnss": -1.5, "wheels": 0.5}
    assert frame["refused"] == {"wheels": 2, "gnss": 1}
    row = dict(zip(COLUMNS, frame["row"], strict=True))
    assert (row["refused"], row["gnss_innovation"], row["map_innovation"]) == (3, -1.5, None)
    assert shown.picture.frame(NOW_NS)["refused"] == {}


def test_every_valid_fix_is_drawn_once() -> None:
    shown = Shown()
    for latitude_deg, valid in ((50.0, True), (50.1, True), (0.0, False)):
        fix = GnssFix(stamp_ns=NOW_NS, valid=valid, latitude_deg=latitude_deg, longitude_deg=14)
        shown.put(keys.GNSS_FIX, fix)
    assert shown.picture.frame(NOW_NS)["fixes"] == [[50.0, 14.0], [50.1, 14.0]]
    assert shown.picture.frame(NOW_NS)["fixes"] == []


def test_speed_of_wheels_is_the_mean_of_those_that_tell_one() -> None:
    shown = Shown()
    odometry = Odometry(stamp_ns=NOW_NS, doors_open=True)
    odometry.wheels.add(wheel="a", speed_mps=9.0)
    odometry.wheels.add(wheel="b", speed_mps=11.0)
    odometry.wheels.add(wheel="c", pulses=17)
    shown.put(keys.ODO_WHEELS, odometry)
    assert shown.picture.frame(NOW_NS)["wheels"] == {
        "speed_mps": 10.0, "doors_open": True, "force_n": None,
    }  # fmt: skip


def test_match_carries_its_alternatives_and_the_place_on_the_line() -> None:
    shown = Shown()
    match = MapMatch(
        stamp_ns=NOW_NS, state=MapMatch.ON_TRACK, run=8, edge="1-2", probability=0.9, chainage_m=12
    )
    match.alternatives.add(edge="3-4", run=6, probability=0.1)
    match.references.add(line="7", direction="0", chainage_m=1234.5)
    shown.put(keys.MAP_MATCH, match)
    found = shown.picture.frame(NOW_NS)["match"]
    assert (found["run"], found["probability"]) == (8, 0.9)
    assert found["alternatives"] == [{"edge": "3-4", "run": 6, "probability": 0.1}]
    assert found["references"] == [{"line": "7", "direction": "0", "chainage_m": 1234.5}]


def test_events_are_numbered_kept_and_worded() -> None:
    shown = Shown()
    key = keys.EVENT.at("tram")
    count = EVENTS_KEPT + 30
    for number in range(count):
        event = Event(stamp_ns=NOW_NS, source="tram", kind="tram.test", sentence="number {n}")
        event.facts.add(name="n", integer=number)
        event.severity = Event.WARNING
        shown.put(key, event)
    shown.put(key, Event(stamp_ns=NOW_NS, kind="tram.hidden", severity=Event.DEBUG))
    last = shown.picture.status(NOW_NS)["events"]
    assert [each["number"] for each in last] == list(range(count - EVENTS_SENT + 1, count + 1))
    assert last[-1]["text"] == f"number {count - 1}"
    assert last[-1]["level"] == "warning"
    assert len(shown.picture.status(NOW_NS, all_events=True)["events"]) == EVENTS_KEPT


def test_nodes_devices_and_satellites_are_listed() -> None:
    shown = Shown()
    shown.put(keys.HEARTBEAT.at("imu"), NodeHealth(node="imu", state=NodeHealth.DEGRADED, text="x"))
    shown.put(keys.DEVICE.at("imu"), DeviceHealth(device="imu", state=DeviceHealth.LOST))
    sky = GnssSatellites(stamp_ns=NOW_NS)
    sky.satellites.add(gnss_id=2, sv_id=7, cno_dbhz=41, elevation_deg=30, azimuth_deg=90, used=True)
    sky.satellites.add(gnss_id=9, sv_id=70, cno_dbhz=0)
    shown.put(keys.GNSS_SATELLITES, sky)
    status = shown.picture.status(NOW_NS)
    assert [(each["node"], each["level"]) for each in status["nodes"]] == [("imu", "warning")]
    assert [(each["device"], each["level"]) for each in status["devices"]] == [("imu", "bad")]
    assert [each["name"] for each in status["satellites"]] == ["E07", "?70"]
    assert status["satellites"][1]["elevation_deg"] is None
