"""Simulated devices: what they say is the ride's truth, when they say it, and what readers get.

The streams are pure and tested without terminals. Tests marked `live` run the loop on real pseudo
terminals, on a vehicle clock that runs fast, and wait for conditions with a deadline.
"""

from __future__ import annotations

import math
import os
import select
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
import pyubx2
from hypothesis import given
from hypothesis import strategies as st

from tramstream import config
from tramstream.bridges import candump, ubx
from tramstream.bridges.adis import FRAME_LENGTH, AdisFramer
from tramstream.bridges.canframe import CanFrame
from tramstream.bridges.framing import Frame, Framer
from tramstream.bridges.pseudo_terminal import PseudoTerminal
from tramstream.bridges.simulated import (
    DBC_PATH,
    NO_FAULTS,
    Array,
    Cable,
    CanDevice,
    Chunk,
    Faults,
    ImuDevice,
    can_stream,
    imu_stream,
    riding,
    still,
)
from tramstream.bridges.simulated_files import GnssLog, can_file_stream
from tramstream.bridges.simulated_gnss import GPS_MINUS_UNIX_S, GnssDevice, gnss_stream
from tramstream.bridges.simulators import run_simulators
from tramstream.bridges.slcan import SlcanAdapter, encode_frame
from tramstream.clock import S, VehicleClock
from tramstream.errors import ConfigError
from tramstream.line import built_in_line
from tramstream.ride import Ride
from tramstream.sensors import Axle, GnssErrors, ImuScales

START_NS = 1_790_000_000 * S + 123_456_789
MINUTE_S = 60.0
DEADLINE_S = 20.0


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def until(stream: Iterator[Chunk], end_s: float = MINUTE_S) -> list[Chunk]:
    return list(takewhile(lambda chunk: chunk.due_ns < START_NS + end_s * S, stream))


def imu_chunks(seed: int = 1, faults: Faults = NO_FAULTS) -> list[Chunk]:
    rng, device = np.random.default_rng(seed), ImuDevice()
    return until(imu_stream(riding(ride()), rng, START_NS, MINUTE_S, device, faults))


def can_chunks(seed: int = 1, faults: Faults = NO_FAULTS) -> list[Chunk]:
    return until(can_stream(ride(), np.random.default_rng(seed), START_NS, faults=faults))


def gnss_chunks(
    seed: int = 1, faults: Faults = NO_FAULTS, device: GnssDevice | None = None
) -> list[Chunk]:
    return until(gnss_stream(ride(), np.random.default_rng(seed), START_NS, device, faults))


STREAMS = [imu_chunks, can_chunks, gnss_chunks]


def joined(chunks: list[Chunk]) -> bytes:
    return b"".join(chunk.data for chunk in chunks)


def total(chunks: list[Chunk], of: str) -> Counter[str]:
    counter: Counter[str] = Counter()
    for chunk in chunks:
        counter.update(getattr(chunk, of))
    return counter


def slcan_frames(data: bytes) -> list[tuple[int, bytes]]:
    lines = data.split(b"\r")[:-1]
    return [(int(line[1:4], 16), bytes.fromhex(line[5:].decode())) for line in lines]


# Streams ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chunks_of", STREAMS)
def test_same_seed_gives_the_same_chunks(chunks_of: Callable[..., list[Chunk]]) -> None:
    assert chunks_of(seed=5, faults=Faults()) == chunks_of(seed=5, faults=Faults())


@pytest.mark.parametrize("chunks_of", [imu_chunks, gnss_chunks])
def test_another_seed_gives_other_bytes(chunks_of: Callable[..., list[Chunk]]) -> None:
    assert joined(chunks_of(seed=5)) != joined(chunks_of(seed=6))


@pytest.mark.parametrize("chunks_of", STREAMS)
def test_chunks_are_in_the_order_of_their_due_times(chunks_of: Callable[..., list[Chunk]]) -> None:
    due = [chunk.due_ns for chunk in chunks_of(faults=Faults())]
    assert due == sorted(due)
    assert due[0] >= START_NS


def test_imu_frames_show_the_rides_specific_force_and_rate() -> None:
    frames = AdisFramer().feed(joined(imu_chunks())).frames
    count = len(frames)
    time_s = np.arange(count) / 2000.0 / (1 + ImuDevice().skew)
    f_b, omega_b = riding(ride())(time_s)
    scales = ImuScales()
    for counts, unit, truth, bias, density in (
        (frames["accel"], scales.accel_mps2, f_b, 0.1, 0.00022563),
        (frames["gyro"], scales.gyro_radps, omega_b, 0.0052359, 0.00011344),
    ):
        means = (counts * unit - truth)[: count // 2000 * 2000].reshape(-1, 2000, 3).mean(axis=1)
        # The mean over a second deviates by N; rounding adds 1e-4 of a count.
        np.testing.assert_allclose(means, bias, atol=5 * density)


def test_imu_stamps_run_on_the_devices_clock_and_wrap() -> None:
    frames = AdisFramer().feed(joined(imu_chunks())).frames
    assert np.all(np.diff(frames["sequence"].astype(np.int64)) == 1)
    steps = np.diff(frames["stamp_us"])  # u32: wraps
    assert np.all(steps == 500)
    assert frames["stamp_us"][0] > frames["stamp_us"][-1]


def test_imu_clumps_leave_when_their_last_sample_is_on_the_line() -> None:
    device = ImuDevice()
    frame_s = FRAME_LENGTH * 10 / device.baud_rate
    number = 0
    for chunk in imu_chunks():
        number += len(chunk.data) // FRAME_LENGTH
        taken_s = (number - 1) / device.rate_hz / (1 + device.skew)
        late_s = (chunk.due_ns - START_NS) / S - taken_s - frame_s
        assert -1e-8 <= late_s <= device.jitter_s + 1e-8


def test_imu_faults_are_what_the_framer_finds() -> None:
    chunks = imu_chunks(faults=Faults())
    injected = total(chunks, "faults")
    assert injected == {"frames_corrupted": 3, "samples_dropped": 7}
    bursts = AdisFramer().feed(joined(chunks))
    assert Counter(reject.reason for reject in bursts.rejected)["crc"] == 3
    assert len(bursts.frames) == total(chunks, "counts")["samples"]
    missing = np.diff(bursts.frames["sequence"].astype(np.int64)) - 1
    assert sorted(missing[missing > 0].tolist()) == [1, 1, 1, 7]


def test_standing_imu_feels_gravity_alone() -> None:
    stream = imu_stream(still, np.random.default_rng(3), START_NS, math.inf, ImuDevice())
    frames = AdisFramer().feed(joined(until(stream, 5.0))).frames
    accel = frames["accel"].mean(axis=0) * ImuScales().accel_mps2
    np.testing.assert_allclose(accel, [0.1, 0.1, 9.81009 + 0.1], atol=0.001)


@given(st.sampled_from(["ADIS16465-1", "ADIS16465-2", "ADIS16465-3"]))
def test_imu_counts_have_the_scale_of_the_model(model: str) -> None:
    # theory.md section 2, °/s per count
    degps = {"ADIS16465-1": 0.00625, "ADIS16465-2": 0.025, "ADIS16465-3": 0.1}[model]

    def turning(time_s: Array) -> tuple[Array, Array]:
        return np.zeros((len(time_s), 3)), np.full((len(time_s), 3), 1.0)

    rng, device = np.random.default_rng(3), ImuDevice(model=model)
    data = joined(until(imu_stream(turning, rng, START_NS, 1.0, device), 1.0))
    gyro = AdisFramer().feed(data).frames["gyro"].mean(axis=0) * math.radians(degps)
    np.testing.assert_allclose(gyro, 1.0 + 0.0052359, atol=0.001)


def test_pulses_on_the_bus_add_up_to_the_arc_length() -> None:
    database: Any = cantools.database.load_file(DBC_PATH)
    chunks = can_chunks()
    travelled, counter = 0.0, -1
    for number, chunk in enumerate(chunks):
        decoded = {
            database.get_message_by_frame_id(id_).name: database.decode_message(id_, data)
            for id_, data in slcan_frames(chunk.data)
        }
        wheels, time_s = decoded["WHEELS"], number / 50
        travelled += (wheels["PULSES_LEFT"] + wheels["PULSES_RIGHT"]) / 2 * Axle().m_per_pulse
        motion = ride().motion(time_s)
        assert travelled == pytest.approx(float(motion.arc_length_m), abs=Axle().m_per_pulse)
        assert wheels["COUNTER"] == (counter + 1) % 256
        counter = wheels["COUNTER"]
        assert decoded["DOORS"]["DOORS_OPEN"] == ride().doors_open(time_s)
        acceleration = float(motion.acceleration_mps2)
        # Newton's law with 150 t, drag and rolling below 1 kN at these speeds, steps of 10 N
        assert decoded["DRIVE"]["MOTOR_FORCE"] == pytest.approx(150e3 * acceleration, abs=1000)
        assert chunk.due_ns == START_NS + round((time_s + CanDevice().delay_s) * S)
    assert travelled > 100


def test_pulses_are_counted_as_they_are_sent() -> None:
    chunks = can_chunks()
    database: Any = cantools.database.load_file(DBC_PATH)
    sent: Counter[str] = Counter()
    for id_, data in slcan_frames(joined(chunks)):
        for name, value in database.decode_message(id_, data).items():
            sent[name] += int(value)
    counts = total(chunks, "counts")
    assert counts["frames"] == 3 * len(chunks)
    assert (counts["pulses_left"], counts["pulses_right"]) == (
        sent["PULSES_LEFT"],
        sent["PULSES_RIGHT"],
    )


def test_damaged_can_lines_are_no_frames_and_carry_no_pulses() -> None:
    chunks = can_chunks(faults=Faults())
    assert total(chunks, "faults") == {"lines_damaged": 2}
    odd = [line for line in joined(chunks).split(b"\r") if line and len(line) % 2 == 0]
    assert len(odd) == 2
    assert all(line.startswith(b"t1202") for line in odd)


def parsed(data: bytes) -> list[Any]:
    """Messages as pyubx2 reads them, an authority from outside."""
    return [pyubx2.UBXReader.parse(f.raw) for f in Framer().feed(data) if isinstance(f, Frame)]


def test_gnss_fixes_are_the_truth_within_their_errors() -> None:
    lever = (2.0, 0.5, 3.0)
    device = GnssDevice(p_va_v=lever)
    messages = [m for m in parsed(joined(gnss_chunks(device=device))) if m.identity == "NAV-PVT"]
    assert len(messages) in (299, 300)
    level = ride().line.level
    errors = []
    for pvt in messages:
        gps_ns = _gps_ns(pvt)
        time_s = np.array([(gps_ns - GPS_MINUS_UNIX_S * S + 37_500_000 - START_NS) / S])
        motion = ride().motion(time_s)
        yaw = motion.yaw_rad[0]
        antenna = ride().position_l(time_s)[0] + [
            math.cos(yaw) * lever[0] - math.sin(yaw) * lever[1],
            math.sin(yaw) * lever[0] + math.cos(yaw) * lever[1],
            lever[2],
        ]
        p_l = level.from_geodetic([math.radians(pvt.lat), math.radians(pvt.lon), pvt.height / 1000])
        errors.append(p_l - antenna)
        turning = motion.yaw_rate_radps[0] * math.hypot(lever[0], lever[1])
        speed = math.hypot(pvt.velN, pvt.velE) / 1000
        assert speed == pytest.approx(motion.speed_mps[0], abs=5 * 0.05 + turning)
    sigma = np.array([0.5, 0.5, 1.0])
    assert np.all(np.abs(errors) < 5 * sigma)
    steps = np.diff(errors, axis=0)  # 0.95/s: steps of σ √(2 (1 − φ)), rounding 11 mm and 1 mm
    expected = sigma * math.sqrt(2 * (1 - 0.95**0.2))
    np.testing.assert_allclose(np.std(steps, axis=0), expected, rtol=0.25)


def _gps_ns(pvt: Any) -> int:
    utc = np.datetime64(
        f"{pvt.year:04}-{pvt.month:02}-{pvt.day:02}T{pvt.hour:02}:{pvt.min:02}:{pvt.second:02}"
    )
    return int(utc.astype(np.int64)) * S + pvt.nano + GPS_MINUS_UNIX_S * S


def test_gnss_times_agree_with_each_other_and_lie_on_whole_periods() -> None:
    messages = parsed(joined(gnss_chunks()))
    week = next(m.week for m in messages if m.identity == "NAV-TIMEGPS")
    for message in messages:
        assert round(message.iTOW) % 200 == 0
        if message.identity == "NAV-PVT":
            assert _gps_ns(message) == (week * 604_800_000 + message.iTOW) * 1_000_000
        if message.identity == "NAV-TIMEGPS":
            assert (message.week, message.leapS) == (week, 18)
    assert {m.identity for m in messages} == {
        "NAV-PVT", "NAV-COV", "NAV-TIMEGPS", "NAV-TIMELS", "NAV-SAT", "NAV-EOE",
    }  # fmt: skip


def test_gnss_epochs_come_late_by_receiver_delay_and_line_time() -> None:
    device = GnssDevice()
    framer = Framer()
    for chunk in gnss_chunks(device=device):
        for frame in framer.feed(chunk.data):
            assert isinstance(frame, Frame)
            itow_ms = int.from_bytes(frame.payload[:4], "little")
            if frame.name == "NAV-PVT":
                now_ms = (chunk.due_ns - 37_500_000 + GPS_MINUS_UNIX_S * S) / 1e6 % 604_800_000
                line_ms = 100 * 10 / device.baud_rate * 1e3
                late_ms = now_ms - itow_ms - device.delay_s * 1e3
                assert line_ms <= late_ms < line_ms + device.jitter_s * 1e3 + 5.0


@pytest.mark.parametrize("rate_hz", [1, 2, 5, 10])
def test_gnss_rate_is_the_one_asked_for(rate_hz: int) -> None:
    device = GnssDevice(rate_hz=rate_hz)
    fixes = total(gnss_chunks(device=device), "counts")["fixes"]
    assert fixes == pytest.approx(MINUTE_S * rate_hz, abs=1)


def test_gnss_faults_are_a_bad_checksum_and_a_pulled_plug() -> None:
    chunks = gnss_chunks(faults=Faults())
    assert total(chunks, "faults") == {"checksums_spoilt": 1, "unplugged": 1}
    cable = [(c.due_ns - START_NS) / S for c in chunks if c.cable is not Cable.AS_BEFORE]
    assert cable == [30.0, 33.0]
    items = Framer().feed(joined(chunks))
    rejected = [item.reason for item in items if not isinstance(item, Frame)]
    assert rejected == ["UBX checksum"]
    names = Counter(item.name for item in items if isinstance(item, Frame))
    assert names["NAV-PVT"] == total(chunks, "counts")["fixes"] == names["NAV-EOE"] - 1


def test_gnss_accuracies_are_those_of_the_errors() -> None:
    device = GnssDevice(errors=GnssErrors(horizontal_std_m=0.3, vertical_std_m=0.7))
    messages = parsed(joined(gnss_chunks(device=device)))
    pvt = next(m for m in messages if m.identity == "NAV-PVT")
    cov = next(m for m in messages if m.identity == "NAV-COV")
    assert pvt.hAcc / 1000 == pytest.approx(0.3 * math.sqrt(2), abs=0.001)
    assert pvt.vAcc / 1000 == pytest.approx(0.7)
    assert [cov.posCovNN, cov.posCovEE, cov.posCovDD] == pytest.approx([0.09, 0.09, 0.49])


# Captured bytes -----------------------------------------------------------------------------------


def capture(times_s: list[float]) -> bytes:
    """A receiver's log with an epoch at each time of a day in 2026, and text ahead of it."""
    data = b"# Name: made up\n# Second line\n"
    for at_s in times_s:
        itow = round((86_400 * 3 + at_s) * 1000)
        gps = {"iTOW": itow, "week": 2425, "leapS": 18, "valid": 7}
        data += ubx.encode("NAV-TIMEGPS", gps) + ubx.encode("NAV-EOE", {"iTOW": itow})
    return data


def log_of(tmp_path: Path, data: bytes) -> GnssLog:
    path = tmp_path / "capture.ubx"
    path.write_bytes(data)
    return GnssLog.load(path)


def test_capture_leaves_byte_by_byte_at_its_own_pace(tmp_path: Path) -> None:
    data = capture([0.0, 1.0, 2.0, 5.0])
    chunks = list(log_of(tmp_path, data).stream(START_NS, 115_200))
    assert joined(chunks) == data.partition(b"Second line\n")[2]
    assert total(chunks, "counts") == {"frames": 8, "epochs": 4}
    steps = [(b.due_ns - a.due_ns) / S for a, b in pairwise(c for c in chunks if c.counts)]
    assert steps == pytest.approx([1.0, 1.0, 3.0])


def test_capture_jumping_in_time_goes_on_at_its_usual_pace(tmp_path: Path) -> None:
    chunks = list(log_of(tmp_path, capture([0.0, 1.0, 2.0, 9000.0, 9001.0])).stream(0, 115_200))
    steps = [(b.due_ns - a.due_ns) / S for a, b in pairwise(c for c in chunks if c.counts)]
    assert steps == pytest.approx([1.0, 1.0, 1.0, 1.0])


def test_looping_capture_repeats_after_one_more_step(tmp_path: Path) -> None:
    stream = log_of(tmp_path, capture([0.0, 1.0])).stream(START_NS, 115_200, loop=True)
    due = [(chunk.due_ns - START_NS) / S for chunk in until(stream, 7.5)]
    assert np.diff(due) == pytest.approx([1.0] * 7)


def test_capture_without_times_runs_at_the_speed_of_the_line(tmp_path: Path) -> None:
    chunks = list(log_of(tmp_path, b"\x55" * 11520).stream(START_NS, 115_200))
    assert (chunks[-1].due_ns - START_NS) / S == pytest.approx(1.0)
    assert joined(chunks) == b"\x55" * 11520


def test_empty_capture_says_nothing(tmp_path: Path) -> None:
    assert list(log_of(tmp_path, b"").stream(START_NS, 115_200, loop=True)) == []


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "length_s"),
    [("zed-f9r-drive.ubx", 527), ("ublox-zed-f9p_hpg1.11.log", 655), ("ublox-8.log", 72)],
)
def test_real_capture_takes_as_long_as_its_frames_say(
    data_dir: Path, name: str, length_s: float
) -> None:
    path = data_dir / "ubx" / name
    chunks = list(GnssLog.load(path).stream(START_NS, 460_800))
    assert path.read_bytes().endswith(joined(chunks))
    assert (chunks[-1].due_ns - START_NS) / S == pytest.approx(length_s, abs=2)


def test_candump_leaves_as_slcan_lines_at_its_own_pace(tmp_path: Path) -> None:
    lines = [
        "(100.000000) can0 170#0102030405060708",
        "(100.000500) can0 18FF0A31#01",
        "(100.500000) can0 044#R8",
        "what is this",
        "(101.000000) can0 044##1112233",
        "(101.250000) can0 7FF#",
    ]
    path = tmp_path / "bus.candump"
    path.write_text("\n".join(lines))
    chunks = list(can_file_stream(path, START_NS))
    assert joined(chunks) == b"t17080102030405060708\rT18FF0A31101\rr0448\rt7FF0\r"
    assert total(chunks, "counts") == {"frames": 4, "skipped": 2}
    assert [(c.due_ns - START_NS) / S for c in chunks] == pytest.approx([0.0005, 0.5, 1.25])


def test_looping_candump_repeats_and_one_without_frames_ends(tmp_path: Path) -> None:
    path = tmp_path / "bus.candump"
    path.write_text("(1.0) can0 001#\n(2.0) can0 002#\n")
    frames = joined(until(can_file_stream(path, START_NS, loop=True), 3.5)).split(b"\r")
    assert frames == [b"t0010", b"t0020"] * 3 + [b"t0010", b""]  # 2 ms from end to beginning
    path.write_text("nothing\n")
    assert sum(chunk.counts["frames"] for chunk in can_file_stream(path, START_NS, loop=True)) == 0


@pytest.mark.realdata
def test_real_candump_loses_no_frame_on_the_way(data_dir: Path) -> None:
    path = data_dir / "can" / "rav4_minute.candump"
    expected = [candump.parse_line(line) for line in path.read_text().splitlines()]
    frames = slcan_frames(joined(list(can_file_stream(path, START_NS))))
    assert frames == [(f.id, f.data) for f in expected if isinstance(f, CanFrame)]


# The adapter --------------------------------------------------------------------------------------

OPENING = b"C\rS6\r\rO\r"
"""What python-can's slcan interface sends first (can.interfaces.slcan, set_bitrate and open)."""


def test_adapter_opens_and_closes_its_channel() -> None:
    adapter = SlcanAdapter()
    assert not adapter.channel_open
    assert adapter.feed(OPENING) == b"\a\r\r\r"
    assert adapter.channel_open
    assert adapter.feed(b"O\r") == b"\a"  # is open already
    assert adapter.feed(b"C\r") == b"\r"
    assert not adapter.channel_open


def test_adapter_tells_version_serial_number_and_status() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"V\rN\rF\r") == b"V1013\rNTRAM\rF00\r"
    assert adapter.feed(b"t1230\rT000001230\rr1230\r") == b"z\rZ\rz\r"


def test_adapter_refuses_what_it_does_not_know() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"\xff\xfe\ry\r") == b"\a\a"
    assert adapter.commands_refused == 2


@given(st.lists(st.sampled_from([b"O", b"C", b"V", b"S6", b"", b"t1232FFEE", b"?"])), st.data())
def test_adapter_answers_alike_for_any_split(commands: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(command + b"\r" for command in commands)
    whole, split = SlcanAdapter(), SlcanAdapter()
    cut = data.draw(st.integers(0, len(stream)))
    assert whole.feed(stream) == split.feed(stream[:cut]) + split.feed(stream[cut:])
    assert whole.channel_open == split.channel_open


def test_frames_are_written_as_the_manual_has_them() -> None:
    assert encode_frame(0x10, b"\x11\x22") == b"t01021122\r"
    assert encode_frame(0x10, b"\x11\x22", extended=True) == b"T0000001021122\r"
    assert encode_frame(0x10, b"", remote_length=4) == b"r0104\r"


# Configuration ------------------------------------------------------------------------------------


def vehicle_of(tmp_path: Path, simulators: str, imu_rate_hz: int = 200) -> config.Vehicle:
    text = f"""
    vehicle = "test"
    [gnss]
    device = "./tram.gnss"
    [imu]
    device = "./tram.imu"
    rate_hz = {imu_rate_hz}
    {simulators}
    """
    return config.parse(text.encode(), "vehicle.toml", tmp_path)


RIDE = '[simulators.ride]\nkind = "ride"\nlink = "tram"\nseed = 4\n'


@pytest.mark.parametrize(
    ("simulators", "field"),
    [
        ('[simulators.a]\nkind = "ride"\n', r"\$\.simulators\.a\.link"),
        ('[simulators.a]\nkind = "gnss_file"\nlink = "x"\n', r"\$\.simulators\.a\.file"),
        (
            '[simulators.a]\nkind = "can_file"\nlink = "x"\nfile = "absent"\n',
            r"\$\.simulators\.a\.file",
        ),
        (
            '[simulators.a]\nkind = "imu_still"\nlink = "x"\n'
            '[simulators.b]\nkind = "imu_still"\nlink = "x"\n',
            "same link",
        ),
    ],
)
def test_unusable_simulator_is_refused_by_name(tmp_path: Path, simulators: str, field: str) -> None:
    vehicle = vehicle_of(tmp_path, simulators)
    with pytest.raises(ConfigError, match=field):
        run_simulators(vehicle, VehicleClock(START_NS), threading.Event())


def test_file_in_the_way_of_a_link_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "tram.imu").write_text("mine")
    with pytest.raises(ConfigError, match=r"tram\.imu"):
        run_simulators(vehicle_of(tmp_path, RIDE), VehicleClock(START_NS), threading.Event())
    assert [path.name for path in tmp_path.iterdir()] == ["tram.imu"]
    assert (tmp_path / "tram.imu").read_text() == "mine"


# Live ---------------------------------------------------------------------------------------------


class Running:
    """Simulators in a thread, on a clock that runs fast."""

    def __init__(self, vehicle: config.Vehicle, rate: float) -> None:
        self.clock = VehicleClock(START_NS, rate)
        self.stop = threading.Event()
        self.truths: list[Any] = []
        self.events: list[dict[str, Any]] = []
        self.result: dict[str, dict[str, Any]] = {}
        self._vehicle = vehicle
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.result = run_simulators(
            self._vehicle, self.clock, self.stop, self.truths.append, self.events.append
        )

    def __enter__(self) -> Running:
        self._thread.start()
        wait_for(lambda: any(event["event"] == "ready" for event in self.events))
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self.join()

    def join(self) -> None:
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive()

    def faults(self, device: str) -> Counter[str]:
        counter: Counter[str] = Counter()
        for event in self.events:
            if event["event"] == "fault" and event["device"] == device:
                counter.update(event["faults"])
        return counter


class Reader:
    """A program that reads a serial line, with a deadline, and leaves all as it finds it."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self._deadline = time.monotonic() + DEADLINE_S

    def __enter__(self) -> Reader:
        self._fd = os.open(self._link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def read(self) -> bytes:
        """What has come; empty once the line has hung up."""
        ready, _, _ = select.select([self._fd], [], [], self._deadline - time.monotonic())
        assert ready, "nothing came in time"
        try:
            return os.read(self._fd, 4096)
        except OSError:
            return b""


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.005)


@pytest.mark.live
def test_devices_of_a_ride_appear_and_are_gone_afterwards(tmp_path: Path) -> None:
    with Running(vehicle_of(tmp_path, RIDE), rate=10) as running:
        ready = running.events[0]
        assert ready["links"] == {
            f"ride.{suffix}": str(tmp_path / f"tram.{suffix}") for suffix in ("gnss", "imu", "can")
        }
        for link in ready["links"].values():
            assert os.readlink(link).startswith("/dev/pts/")
        wait_for(lambda: len(running.truths) > 30)
    assert list(tmp_path.iterdir()) == []
    stamps = [truth.stamp_ns for truth in running.truths]
    assert np.all(np.diff(stamps) == S // 10)
    for truth in running.truths:
        expected = ride().truth((truth.stamp_ns - stamps[0]) / S, truth.stamp_ns)
        assert truth == expected


@pytest.mark.live
def test_imu_reader_gets_every_sample_though_it_opens_twice(tmp_path: Path) -> None:
    framer, numbers = AdisFramer(), []
    with Running(vehicle_of(tmp_path, RIDE), rate=4) as running:
        for target in (400, 1200):
            with Reader(tmp_path / "tram.imu") as line:
                while len(numbers) < target:
                    numbers += framer.feed(line.read()).frames["sequence"].tolist()
    assert framer.rejected_by_reason == {}
    assert numbers == list(range(len(numbers)))
    assert running.result["ride.imu"]["overrun"] == {}


@pytest.mark.live
def test_python_can_opens_the_bus_and_hears_all_the_pulses(tmp_path: Path) -> None:
    database: Any = cantools.database.load_file(DBC_PATH)
    pulses: Counter[str] = Counter()
    with Running(vehicle_of(tmp_path, RIDE), rate=8) as running:
        options = {"channel": str(tmp_path / "tram.can"), "bitrate": 500_000}
        with can.Bus(interface="slcan", sleep_after_open=0.0, **options) as bus:
            first = None
            while pulses["LEFT"] < 5000:
                message = bus.recv(DEADLINE_S)
                assert message is not None
                if message.arbitration_id == 0x110:
                    wheels = database.decode_message(0x110, message.data)
                    first = wheels["COUNTER"] if first is None else first
                    pulses["LEFT"] += wheels["PULSES_LEFT"]
                    pulses["RIGHT"] += wheels["PULSES_RIGHT"]
    tally = running.result["ride.can"]
    assert tally["sent"]["pulses_left"] >= pulses["LEFT"]
    assert tally["unheard"].get("pulses_left", 0) == 0  # nothing is lost before the departure


@pytest.mark.live
def test_pulled_receiver_hangs_up_and_comes_back(tmp_path: Path) -> None:
    link = tmp_path / "tram.gnss"
    names: Counter[str] = Counter()
    with Running(vehicle_of(tmp_path, RIDE), rate=25) as running:
        framer = Framer()
        with Reader(link) as line:
            while data := line.read():
                names.update(_names(framer, data))
        assert names["NAV-PVT"] > 100
        injected = {"checksums_spoilt": 1, "unplugged": 1}
        wait_for(lambda: running.faults("ride.gnss") == injected)
        wait_for(link.exists)
        names.clear()
        framer = Framer()
        with Reader(link) as line:
            while names["NAV-PVT"] < 20:
                names.update(_names(framer, line.read()))
    tally = running.result["ride.gnss"]
    assert tally["unplugged"]["fixes"] in (14, 15, 16)  # three seconds
    assert tally["faults"] == injected


def _names(framer: Framer, data: bytes) -> list[str]:
    return [item.name for item in framer.feed(data) if isinstance(item, Frame)]


@pytest.mark.live
def test_absent_reader_blocks_nobody_and_its_bytes_are_counted(tmp_path: Path) -> None:
    with Running(vehicle_of(tmp_path, RIDE, imu_rate_hz=2000), rate=4) as running:
        wait_for(
            lambda: any(
                event["event"] == "progress" and event["devices"]["ride.imu"]["overrun"]
                for event in list(running.events)
            )
        )
        reached = len(running.truths)
        wait_for(lambda: len(running.truths) > reached + 5)
    tally = running.result["ride.imu"]
    assert tally["bytes_overrun"] > 0
    produced = tally["sent"]["samples"] + tally["overrun"]["samples"]
    assert tally["bytes_sent"] + tally["bytes_overrun"] == produced * FRAME_LENGTH


@pytest.mark.live
def test_simulators_end_with_their_files(tmp_path: Path) -> None:
    data = capture([0.0, 0.5, 1.0])
    (tmp_path / "capture.ubx").write_bytes(data)
    (tmp_path / "bus.candump").write_text("(1.0) can0 001#\n(2.0) can0 002#11\n")
    simulators = (
        '[simulators.receiver]\nkind = "gnss_file"\nlink = "rx"\nfile = "capture.ubx"\n'
        '[simulators.bus]\nkind = "can_file"\nlink = "bus"\nfile = "bus.candump"\n'
    )
    with Running(vehicle_of(tmp_path, simulators), rate=1) as running:
        heard = b""
        with Reader(tmp_path / "rx") as line:
            while not heard.endswith(data[-20:]):
                heard += line.read()
        running.join()
    assert data.endswith(heard)
    assert running.result["receiver"]["sent"] == {"frames": 6, "epochs": 3}
    assert running.result["bus"]["unheard"]["frames"] == 2  # nobody opened the channel
    assert running.truths == []


@pytest.mark.live
def test_terminal_drops_what_has_no_room_instead_of_waiting(tmp_path: Path) -> None:
    terminal = PseudoTerminal(tmp_path / "line")
    terminal.open()
    try:
        sent = sum(terminal.write(b"\x55" * 1000) for _ in range(100))
        assert 0 < sent < 100_000
        assert terminal.bytes_sent + terminal.bytes_overrun == 100_000
        assert terminal.read() == b""
    finally:
        terminal.close()
    assert not terminal.is_open
    assert not (tmp_path / "line").is_symlink()
