"""top: the board out of statistics, the screen at any width, and the verb on a live bus."""

from __future__ import annotations

import io
import json
import re

import pytest
from looking import START_NS, VEHICLE, busy_bus, envelope, fix, tramstream
from rich.console import Console

from tramstream import keys
from tramstream.cli.monitor.screen import WIDE
from tramstream.cli.top import live_screen, render
from tramstream.clock import S
from tramstream.events import define
from tramstream.events.messages import message_of
from tramstream.events.wording import clipped, lasting, scaled
from tramstream.monitor.board import Board, Level, board
from tramstream.monitor.digest import digest
from tramstream.monitor.stats import Stats
from tramstream.proto.estimate_pb2 import GradeState, GradeStopping, StoppingDistance
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import DeviceHealth, NodeHealth
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, WheelReading
from tramstream.transport.bus import LocalBus

NOW_NS = START_NS + 20 * S


def healthy() -> Stats:
    """Twenty seconds of one node with one device that publishes fixes at 5 Hz."""
    stats = Stats(5.0)
    for step in range(100):
        at_ns = START_NS + (step + 1) * S // 5
        stats.add(envelope(keys.GNSS_FIX, fix(step), at_ns, step + 1))
    for step in range(20):
        at_ns = START_NS + (step + 1) * S
        beat = NodeHealth(
            stamp_ns=at_ns, node="gnss", pid=7, uptime_s=step, cpu_s=0.25 * step, rss_bytes=50 << 20
        )
        device = DeviceHealth(
            stamp_ns=at_ns, device="gnss", port="/dev/ttyACM0", bytes_received=1000 * step
        )
        stats.add(envelope(keys.HEARTBEAT.at("gnss"), beat, at_ns, step + 1))
        stats.add(envelope(keys.DEVICE.at("gnss"), device, at_ns, step + 1))
    return stats


def shown(stats: Stats, width: int, now_ns: int = NOW_NS, height: int = 0) -> list[str]:
    text = io.StringIO()
    console = Console(file=text, width=width, highlight=False)
    console.print(render(board(stats, VEHICLE, now_ns), "A title.", height), end="")
    return text.getvalue().splitlines()


# Board --------------------------------------------------------------------------------------------
def test_healthy_board_has_nothing_marked():
    found = board(healthy(), VEHICLE, NOW_NS)
    rows = {row.key: row for row in found.keys}
    assert list(rows) == ["raw/gnss/fix", "health/gnss/device", "health/gnss/heartbeat"]
    assert rows["raw/gnss/fix"].rate_hz == pytest.approx(5.0)
    assert rows["raw/gnss/fix"].age_s == 0.0
    levels = [row.rate_level for row in found.keys] + [row.age_level for row in found.keys]
    assert set(levels) == {Level.FINE}
    (node,), (device,) = found.nodes, found.devices
    assert (node.state, node.level) == ("OK", Level.FINE)
    assert node.cpu_percent == pytest.approx(25.0)
    assert device.bytes_per_s == pytest.approx(1000.0)
    assert found.lost == 0


def test_looking_twice_gives_the_same():
    stats = healthy()
    assert board(stats, VEHICLE, NOW_NS) == board(stats, VEHICLE, NOW_NS)


def test_silence_marks_keys_node_and_device():
    found = board(healthy(), VEHICLE, NOW_NS + 60 * S)
    assert {row.age_level for row in found.keys} == {Level.BAD}
    assert {row.rate_hz for row in found.keys} == {0.0}
    assert (found.nodes[0].state, found.nodes[0].level) == ("SILENT", Level.BAD)
    assert (found.devices[0].state, found.devices[0].level) == ("UNKNOWN", Level.BAD)


def test_slow_and_lossy_key_is_marked():
    stats = Stats(5.0)
    for step in range(20):
        stats.add(envelope(keys.GNSS_FIX, fix(step), START_NS + (step + 1) * S, 3 * step + 1))
    (row,) = board(stats, VEHICLE, NOW_NS).keys
    assert row.rate_level == Level.WARNING
    assert row.lost == 2 * 19


def test_processor_share_is_not_told_across_a_restart():
    stats = Stats(5.0)
    for number, pid in ((1, 7), (2, 8)):
        beat = NodeHealth(node="gnss", pid=pid, uptime_s=number, cpu_s=number)
        stats.add(envelope(keys.HEARTBEAT.at("gnss"), beat, START_NS + number * S, number))
    assert board(stats, VEHICLE, START_NS + 2 * S).nodes[0].cpu_percent is None


def test_sick_node_and_device_say_why():
    stats = Stats(5.0)
    beat = NodeHealth(node="gnss", state=NodeHealth.DEGRADED, text="no device")
    device = DeviceHealth(device="gnss", state=DeviceHealth.LOST, text="/dev/x: not there")
    stats.add(envelope(keys.HEARTBEAT.at("gnss"), beat, NOW_NS))
    stats.add(envelope(keys.DEVICE.at("gnss"), device, NOW_NS))
    found = board(stats, VEHICLE, NOW_NS)
    assert (found.nodes[0].state, found.nodes[0].level) == ("DEGRADED", Level.WARNING)
    assert (found.devices[0].state, found.devices[0].level) == ("LOST", Level.BAD)
    text = "\n".join(shown(stats, 120))
    assert "no device" in text
    assert "/dev/x: not there" in text


def test_last_event_of_a_source_is_shown_while_it_is_news():
    refused = define("test.refused", "a fix {key}: {innovation_m}", key=str, innovation_m=float)
    event = message_of(refused(key=keys.GNSS_FIX.path, innovation_m=41.2), "ekf")
    event.stamp_ns = NOW_NS - 5 * S
    stats = healthy()
    stats.add(envelope(keys.EVENT.at("ekf"), event, NOW_NS - 5 * S, 1))
    (row,) = board(stats, VEHICLE, NOW_NS).events
    assert (row.source, row.kind, row.level) == ("ekf", "test.refused", Level.WARNING)
    assert row.facts == {"key": "raw/gnss/fix", "innovation_m": 41.2}
    assert any("a fix raw/gnss/fix: 41.2 m" in line for line in shown(stats, 120))
    assert board(stats, VEHICLE, NOW_NS + 300 * S).events == []
    (plain,) = board(stats, VEHICLE, NOW_NS).as_dict()["events"]
    assert (plain["level"], plain["facts"]["innovation_m"]) == ("warning", 41.2)


def test_other_vehicles_are_left_out():
    stats = healthy()
    stats.add(envelope(keys.GNSS_FIX, fix(1), NOW_NS, vehicle="other"))
    assert len(board(stats, VEHICLE, NOW_NS).keys) == 3


def test_board_is_plain_data():
    plain = json.loads(json.dumps(board(healthy(), VEHICLE, NOW_NS).as_dict()))
    assert plain["nodes"][0]["level"] == "fine"
    assert plain["rate_hz"] == pytest.approx(7.0)


# Screen -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("width", [1, 20, 40, 80, WIDE - 1, WIDE, 160, 300])
def test_no_line_is_wider_than_the_screen(width):
    lines = shown(healthy(), width)
    assert max(map(len, lines)) <= width
    assert len(lines) == len(shown(healthy(), 300))


def test_screen_has_title_health_and_keys():
    text = "\n".join(shown(healthy(), 160))
    for part in (VEHICLE, "A title.", "25.0 %", "52.4 MB", "/dev/ttyACM0", "raw/gnss/fix", "50.09"):
        assert part in text


@pytest.mark.parametrize("height", [2, 5, 12])
def test_what_does_not_fit_is_counted(height):
    whole = shown(healthy(), 100)
    lines = shown(healthy(), 100, height=height)
    assert len(lines) == height
    hidden = int(re.findall(r"… (\d+) more lines", lines[-1])[0])
    assert hidden + height - 1 == len(whole)


def test_empty_bus_has_a_screen():
    assert "nothing on the bus yet" in "\n".join(shown(Stats(), 80))


def test_what_a_device_sends_cannot_move_the_cursor():
    stats = Stats()
    beat = NodeHealth(node="gnss\x1b[2J", state=NodeHealth.DEGRADED, text="a\nb\x07")
    stats.add(envelope(keys.HEARTBEAT.at("gnss"), beat, NOW_NS))
    text = "\n".join(shown(stats, 120))
    assert not set(text) & {"\x1b", "\x07", "\r"}
    assert "a·b·" in text


def test_live_screen_shows_what_the_bus_carries():
    bus = LocalBus()
    text = io.StringIO()
    console = Console(file=text, width=100, height=20, force_terminal=True, highlight=False)
    with live_screen(bus, VEHICLE, "a demo", console) as refresh:
        payload = fix(1).SerializeToString()
        bus.publish(keys.GNSS_FIX.on(VEHICLE), payload, keys.GNSS_FIX.encoding, 1)
        refresh()
    assert "a demo" in text.getvalue()
    assert "gnss/fix" in text.getvalue()


# Digests and numbers ------------------------------------------------------------------------------
@pytest.mark.parametrize("key", keys.ALL, ids=lambda key: key.path)
def test_every_message_type_has_a_digest_even_when_empty(key):
    assert "\n" not in digest(key.type())


def test_digests_hold_what_matters():
    fix_ = GnssFix(
        fix_type=GnssFix.FIX_3D, valid=True, satellites_used=14, speed_mps=8.3, latitude_deg=50.1
    )
    assert digest(fix_).startswith("8.30 m/s  3D  14 sat")
    assert "not valid" in digest(GnssFix(fix_type=GnssFix.FIX_3D))
    wheels = [WheelReading(wheel="left", pulses=-7), WheelReading(wheel="b", speed_mps=2)]
    reading = Odometry(wheels=wheels, doors_open=True, motor_force_n=12_300)
    assert digest(reading) == "left -7  b 2.00 m/s  doors open  +12.3 kN"
    batch = ImuBatch(
        gyro_x=[1, 3], gyro_y=[0, 0], gyro_z=[0, 0], accel_x=[0, 0], accel_y=[0, 0],
        accel_z=[10, 30], gyro_scale_radps=1e-3, accel_scale_mps2=0.5,
    )  # fmt: skip
    assert digest(batch).startswith("a +0.00 +0.00 +10.00 m/s²  ω +2.0 +0.0 +0.0 mrad/s  2 ×")
    slope = GradeState(grade_rad=-0.03, grade_std_rad=0.001, body_pitch_rad=0.005, mass_kg=4.0e4)
    assert digest(slope) == "slope -3.00 ±0.10 %  nod +0.29°  40.0 ±0.0 t"
    stops = [StoppingDistance(deceleration_mps2=1.0, distance_m=112.5, distance_std_m=8.0)]
    stops.append(StoppingDistance(deceleration_mps2=0.2))
    told = GradeStopping(speed_mps=15.0, stops=stops)
    assert digest(told) == "112 ±8 m with 1 m/s²  no stop with 0.2 m/s²  15.0 m/s"
    assert digest(None) == "cannot be decoded"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0 B"), (999, "999 B"), (999.6, "1.0 kB"), (48_123, "48.1 kB"), (654_321, "654 kB"),
     (99_960, "100 kB"), (5e9, "5.0 GB"), (5e12, "5000 GB")],
)  # fmt: skip
def test_quantities_are_scaled(value, text):
    assert scaled(value, "B") == text


@pytest.mark.parametrize("seconds", [0, 0.004, 9.99, 9.996, 59, 119, 120, 5969, 5970, 3.5e5, 1e6])
def test_durations_are_short(seconds):
    assert len(lasting(seconds)) <= 7


def test_clipped_text_tells_that_it_is():
    assert [clipped("abcd", width) for width in (4, 3, 1, 0)] == ["abcd", "ab…", "…", "…"]


# Live ---------------------------------------------------------------------------------------------
@pytest.mark.live
def test_top_once_and_json_show_a_live_bus():
    with busy_bus() as folder:
        plain = tramstream("top", "--json", "--listen-s", 1, runtime_dir=folder)
        text = tramstream("top", "--once", "--listen-s", 1, runtime_dir=folder, COLUMNS="80")
    assert plain.returncode == text.returncode == 0
    found = json.loads(plain.stdout)
    assert set(found) >= set(Board.__dataclass_fields__)
    assert [row["key"] for row in found["keys"]] == ["raw/gnss/fix", "health/gnss/heartbeat"]
    assert found["nodes"][0]["state"] == "OK"
    assert "raw/gnss/fix" in text.stdout
    assert max(map(len, text.stdout.splitlines())) <= 80
    assert "\x1b" not in text.stdout
