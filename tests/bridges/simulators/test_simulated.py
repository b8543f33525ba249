"""IMU and CAN bus of a simulated ride: what they say is the truth, and when they say it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from itertools import takewhile
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.bridges.imu.framer import FRAME_LENGTH, AdisFramer
from tramstream.bridges.simulators.streams import (
    DBC_PATH,
    NO_FAULTS,
    Array,
    CanDevice,
    Chunk,
    Faults,
    ImuDevice,
    can_stream,
    imu_stream,
    riding,
    still,
)
from tramstream.clock import S
from tramstream.lines.line import built_in_line
from tramstream.simulation.imu import ImuScales
from tramstream.simulation.ride import Ride
from tramstream.simulation.wheels import Axle

START_NS = 1_790_000_000 * S + 123_456_789
MINUTE_S = 60.0


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


STREAMS = [imu_chunks, can_chunks]


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


@pytest.mark.parametrize("chunks_of", STREAMS)
def test_same_seed_gives_the_same_chunks(chunks_of: Callable[..., list[Chunk]]) -> None:
    assert chunks_of(seed=5, faults=Faults()) == chunks_of(seed=5, faults=Faults())


def test_another_seed_gives_other_bytes() -> None:
    assert joined(imu_chunks(seed=5)) != joined(imu_chunks(seed=6))


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
    for counts, unit, truth, bias, density, drift in (
        (frames["accel"], scales.accel_mps2, f_b, 0.1, 0.00022563, 0.000035316),
        (frames["gyro"], scales.gyro_radps, omega_b, 0.0052359, 0.00011344, 0.00007563 * 60**0.5),
    ):
        means = (counts * unit - truth)[: count // 2000 * 2000].reshape(-1, 2000, 3).mean(axis=1)
        # The mean over a second deviates by N, the bias by B, and by K·√t; rounding adds 1e-4 of a
        # count.
        np.testing.assert_allclose(means, bias, atol=5 * math.hypot(density, drift))


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
    # docs/theory.md, section 3.2, °/s per count
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
        # Newton's law with 150 t, drag and rolling below 1 kN at these speeds, steps of 10 N
        uphill = float(motion.acceleration_mps2 - 9.80665 * np.sin(motion.pitch_rad))
        moves = not motion.standing
        assert decoded["DRIVE"]["MOTOR_FORCE"] == pytest.approx(150e3 * uphill * moves, abs=1000)
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
