"""The inertial bridge against a simulated device: columns, stamps, losses, restarts."""

from __future__ import annotations

import pickle
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tramstream import keys
from tramstream.bridges.imu import framer
from tramstream.bridges.imu.bridge import (
    GYRO_SCALE_RADPS,
    HOLD_NS,
    NOTE_COUNTER,
    NOTE_PAUSE,
    NOTE_RESTART,
    ImuBridge,
)
from tramstream.bridges.imu.framer import FRAME_LENGTH
from tramstream.clock import S
from tramstream.config import Imu, Vehicle
from tramstream.errors import ConfigError
from tramstream.live.snapshots import pack
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import ImuBatch, RawBytes

US, MS = 1_000, 1_000_000
PERIOD_NS = 500 * US
HOST_START_NS = 1_700_000_000 * S
Read = tuple[bytes, int]


def vehicle(model: str = "ADIS16465-1", **changes: object) -> Vehicle:
    return Vehicle(vehicle="t", imu=Imu(device="/dev/imu", model=model, **changes))  # type: ignore[arg-type]


@dataclass
class Device:
    """An IMU with its microcontroller: `sequence` and stamp count from where they are told."""

    sequence: int = 0
    stamp_us: int = 0
    skew: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def frames(self, count: int) -> bytes:
        """Next samples; each column tells the sample's number."""
        numbers = self.sequence + np.arange(count)
        stamps_us = self.stamp_us + 500 * np.arange(count)
        self.sequence += count
        self.stamp_us += 500 * count
        return framer.encode(stamps_us, numbers, columns(numbers), -columns(numbers) - 1)

    def skip(self, count: int) -> None:
        """Lose samples between sensor and line."""
        self.sequence += count
        self.stamp_us += 500 * count


def columns(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack([numbers % 30_000, numbers * 7 % 30_011, numbers * 13 % 29_989], axis=1)


def message(reads: list[Read]) -> Sample:
    raw = RawBytes(stamp_ns=reads[0][1], data=b"".join(data for data, _ in reads))
    for data, arrival_ns in reads:
        raw.read_length.append(len(data))
        raw.read_offset_ns.append(arrival_ns - reads[0][1])
    return Sample(keys.IMU_BYTES, raw, raw.stamp_ns, 1)


def run(bridge: ImuBridge, reads: Iterable[Read]) -> list[ImuBatch]:
    batches: list[ImuBatch] = []
    for read in reads:
        batches += (sample.message for sample in bridge.step(message([read])))
        assert all(ledger.balanced for ledger in bridge.ledgers())
    return batches


def every(data: bytes, size: int = 10 * FRAME_LENGTH, start_ns: int = HOST_START_NS) -> list[Read]:
    """Reads of `size` bytes that arrive when their last byte does, at 2 kHz."""
    byte_ns = PERIOD_NS / FRAME_LENGTH
    cuts = [*range(0, len(data), size), len(data)]
    return [(data[a:b], start_ns + round(b * byte_ns)) for a, b in pairwise(cuts)]


def numbers_of(batches: list[ImuBatch]) -> list[int]:
    return [batch.first_sample_sequence + k for batch in batches for k in range(len(batch.gyro_x))]


def check_columns(batches: list[ImuBatch]) -> None:
    numbers = np.array(numbers_of(batches))
    gyro, accel = columns(numbers).T.tolist(), (-columns(numbers) - 1).T.tolist()
    for axis, name in enumerate("xyz"):
        assert [v for b in batches for v in getattr(b, f"gyro_{name}")] == gyro[axis]
        assert [v for b in batches for v in getattr(b, f"accel_{name}")] == accel[axis]


# content ------------------------------------------------------------------------------------------


def test_batches_are_windows_of_the_sequence_and_hold_what_was_sent() -> None:
    batches = run(ImuBridge(vehicle()), every(Device(sequence=7).frames(400), 100))
    check_columns(batches)
    assert [batch.first_sample_sequence for batch in batches] == [7, *range(20, 400, 20)]
    assert [len(batch.gyro_x) for batch in batches] == [13] + [20] * 19
    assert [batch.sequence for batch in batches] == list(range(1, 21))
    assert {batch.temperature for batch in batches} == {250}


@pytest.mark.parametrize(("model", "full_scale_degps"), [("1", 125), ("2", 500), ("3", 2000)])
def test_scales_of_the_models_are_those_of_the_data_sheet(
    model: str, full_scale_degps: int
) -> None:
    """ADIS16465 data sheet: ±125, ±500, ±2000 °/s are 20,000 counts; 8 g is 32,000; 0.1 °C."""
    (batch,) = run(ImuBridge(vehicle(f"ADIS16465-{model}")), every(Device().frames(20)))
    assert np.rad2deg(20_000 * batch.gyro_scale_radps) == pytest.approx(full_scale_degps, rel=1e-12)
    assert 32_000 * batch.accel_scale_mps2 == pytest.approx(8 * 9.80665, rel=1e-12)
    assert batch.temperature_scale_degc == 0.1
    assert batch.model == f"ADIS16465-{model}"
    assert batch.model in GYRO_SCALE_RADPS


def test_diagnostics_of_all_samples_are_joined_and_temperature_is_the_last() -> None:
    zeros, diag = np.ones((20, 3)), np.zeros(20, int)
    diag[3], diag[9] = 0x0004, 0x0100
    data = framer.encode(500 * np.arange(20), np.arange(20), zeros, zeros, np.arange(20), diag)
    (batch,) = run(ImuBridge(vehicle()), every(data))
    assert batch.diag_stat == 0x0104
    assert batch.temperature == 19


@given(st.lists(st.integers(0, 90 * FRAME_LENGTH), max_size=30), st.integers(1, 200))
@settings(max_examples=60)
def test_any_cut_of_the_bytes_gives_the_same_columns(cuts: list[int], batch: int) -> None:
    device = Device(sequence=2**32 - 30)
    data = device.frames(30) + b"\xad\x65noise" + device.frames(20)
    device.skip(3)
    data += device.frames(40)
    edges = sorted({0, *cuts, len(data)})
    byte_ns = PERIOD_NS // FRAME_LENGTH
    reads = [(data[a:b], HOST_START_NS + b * byte_ns) for a, b in pairwise(edges)]
    parts = run(ImuBridge(vehicle(batch=batch)), reads)
    whole = run(ImuBridge(vehicle(batch=batch)), [(data, HOST_START_NS + len(data) * byte_ns)])
    check_columns(parts)
    for part, other in zip(parts, whole, strict=True):
        part.stamp_ns, part.period_ns = other.stamp_ns, other.period_ns
        assert part == other


def test_same_reads_in_other_messages_give_the_same_batches() -> None:
    reads = jittered(Device(), 2_000)[0]
    rng = np.random.default_rng(5)
    expected = run(ImuBridge(vehicle()), reads)
    for _ in range(5):
        bridge, batches, at = ImuBridge(vehicle()), [], 0
        while at < len(reads):
            count = int(rng.integers(1, 12))
            batches += [s.message for s in bridge.step(message(reads[at : at + count]))]
            at += count
        assert batches == expected


def test_message_without_read_lengths_is_one_read() -> None:
    data = Device().frames(40)
    raw = RawBytes(stamp_ns=HOST_START_NS, data=data)
    single = ImuBridge(vehicle()).step(Sample(keys.IMU_BYTES, raw, HOST_START_NS, 1))
    assert [s.message for s in single] == run(ImuBridge(vehicle()), [(data, HOST_START_NS)])


# stamps -------------------------------------------------------------------------------------------


def jittered(device: Device, count: int, mean_ns: float = 2 * MS) -> tuple[list[Read], list[int]]:
    """Reads of 10 samples whose arrival is up to 5 ms late; true host time of every sample.

    A sample's frame takes 180 µs on the line, which the bridge knows and takes off.
    """
    reads, truth = [], []
    line_ns = 10 * FRAME_LENGTH * S // 2_000_000
    for first in range(0, count, 10):
        ideal_ns = (first + np.arange(10)) * PERIOD_NS * (1 + device.skew)
        truth += [HOST_START_NS + round(t) for t in ideal_ns]
        late_ns = min(device.rng.exponential(mean_ns), 5 * MS)
        reads.append((device.frames(10), truth[-1] + line_ns + int(late_ns)))
    return reads, truth


def test_stamps_do_not_jitter_with_the_arrivals() -> None:
    device = Device(stamp_us=123, skew=50e-6)
    reads, truth = jittered(device, 60 * 2000)
    bridge = ImuBridge(vehicle())
    batches = run(bridge, reads)
    settled = [batch for batch in batches if batch.first_sample_sequence >= 40 * 2000]
    errors_ns = [batch.stamp_ns - truth[batch.first_sample_sequence] for batch in settled]
    assert np.abs(errors_ns).max() < 20 * US  # the fastest arrivals are not late at all
    spacing_ns = np.diff([batch.stamp_ns for batch in settled])
    assert np.abs(spacing_ns - 20 * PERIOD_NS * (1 + 50e-6)).max() < 1 * US
    periods_ns = np.array([batch.period_ns for batch in settled])
    assert np.abs(periods_ns - PERIOD_NS * (1 + 50e-6)).max() < 50
    counters = bridge.device_counters()
    assert counters["clock_skew_ppm"] == pytest.approx(50, abs=1)
    assert counters["clock_residual_s"] == pytest.approx(1.4e-3, rel=0.3)


def test_batches_never_overlap_from_the_first_on() -> None:
    for seed in range(5):
        device = Device(skew=-80e-6, rng=np.random.default_rng(seed))
        batches = run(ImuBridge(vehicle()), jittered(device, 6 * 2000)[0])
        for before, after in pairwise(batches):
            last_ns = before.stamp_ns + 19 * before.period_ns
            assert 0.85 * PERIOD_NS < after.stamp_ns - last_ns < 1.15 * PERIOD_NS


def test_single_sample_has_the_nominal_period() -> None:
    batches = run(ImuBridge(vehicle(batch=1, rate_hz=1000.0)), every(Device().frames(3)))
    assert [batch.period_ns for batch in batches] == [1 * MS] * 3


# wraps, losses, restarts --------------------------------------------------------------------------


@pytest.mark.parametrize("before", [1, 19, 20, 37])
def test_wrap_of_stamp_and_sequence_goes_unnoticed(before: int) -> None:
    device = Device(sequence=2**32 - before, stamp_us=2**32 - 500 * before)
    bridge = ImuBridge(vehicle())
    batches = run(bridge, every(device.frames(100)))
    plain = run(ImuBridge(vehicle()), every(Device(sequence=2**32 - before).frames(100)))
    check_columns(batches)
    assert [b.stamp_ns for b in batches] == [b.stamp_ns for b in plain]
    numbers = numbers_of(batches)
    assert numbers == list(range(2**32 - before, 2**32 - before + len(numbers)))
    counters = bridge.device_counters()
    assert counters["samples_lost"] == 0
    assert counters["rejected_by_reason"] == {}


def test_wrap_of_data_cntr_goes_unnoticed() -> None:
    bridge = ImuBridge(vehicle())
    run(bridge, every(Device(sequence=65_500).frames(100)))
    assert bridge.device_counters()["rejected_by_reason"] == {}


@pytest.mark.parametrize("lost", [1, 5, 20, 4000])
@pytest.mark.parametrize("size", [FRAME_LENGTH, 7 * FRAME_LENGTH + 5, 10**6])
def test_lost_samples_are_counted_and_end_a_batch(lost: int, size: int) -> None:
    device = Device()
    reads = every(device.frames(50), size)
    device.skip(lost)
    reads += every(device.frames(100), size, HOST_START_NS + (50 + lost) * PERIOD_NS)
    bridge = ImuBridge(vehicle())
    batches = run(bridge, reads)
    check_columns(batches)
    assert bridge.device_counters()["samples_lost"] == lost
    assert 50 not in numbers_of(batches)
    for batch in batches:
        first, count = batch.first_sample_sequence, len(batch.gyro_x)
        assert first // 20 == (first + count - 1) // 20
    resumed = next(b for b in batches if b.first_sample_sequence == 50 + lost)
    assert resumed.period_ns == pytest.approx(PERIOD_NS, rel=1e-3)


def test_damaged_frame_is_rejected_once_and_lost_once() -> None:
    data = bytearray(Device().frames(60))
    data[25 * FRAME_LENGTH + 13] ^= 0x40
    bridge = ImuBridge(vehicle())
    batches = run(bridge, every(bytes(data)))
    check_columns(batches)
    assert sorted(set(range(60)) - set(numbers_of(batches))) == [25]
    counters = bridge.device_counters()
    assert counters["frames_rejected"] == 1
    assert counters["bytes_rejected"] == FRAME_LENGTH
    assert counters["samples_lost"] == 1
    assert counters["messages_decoded"] == 59


@pytest.mark.parametrize("size", [10 * FRAME_LENGTH, 10**6])
def test_device_that_restarts_begins_a_new_run_and_fit(size: int) -> None:
    data = Device(sequence=10_000, stamp_us=10**9).frames(110) + Device(stamp_us=77).frames(60)
    bridge = ImuBridge(vehicle())
    batches = run(bridge, every(data, size))
    check_columns(batches)
    assert numbers_of(batches) == [*range(10_000, 10_110), *range(60)]
    counters = bridge.device_counters()
    assert counters["rejected_by_reason"] == {NOTE_RESTART: 1}
    assert counters["samples_lost"] == 0
    if size < 10**6:  # one read of 85 ms does not tell when the runs met
        spacing_ns = np.diff([batch.stamp_ns for batch in batches]).tolist()
        assert spacing_ns == pytest.approx([10 * MS] * 5 + [5 * MS] + [10 * MS] * 2, abs=10 * US)


@pytest.mark.parametrize("sequence", [0, 109, 2**31 - 60, 2**31 + 60, 2**32 - 1])
def test_sequence_that_falls_back_or_repeats_is_a_restart(sequence: int) -> None:
    bridge = ImuBridge(vehicle())
    data = Device().frames(110) + Device(sequence=sequence, stamp_us=55_000).frames(40)
    run(bridge, every(data))
    assert bridge.device_counters()["rejected_by_reason"][NOTE_RESTART] == 1


@pytest.mark.parametrize("stamp_us", [0, 54_000, 54_500, 10**9])
def test_stamp_that_does_not_fit_the_sequence_is_a_restart(stamp_us: int) -> None:
    bridge = ImuBridge(vehicle())
    data = Device().frames(110) + Device(sequence=110, stamp_us=stamp_us).frames(50)
    batches = run(bridge, every(data))
    check_columns(batches)
    assert bridge.device_counters()["rejected_by_reason"] == {NOTE_RESTART: 1}
    stamps = [batch.stamp_ns for batch in batches]
    assert stamps == sorted(stamps)


def test_pause_without_a_lost_sample_ends_a_batch() -> None:
    bridge = ImuBridge(vehicle())
    data = Device().frames(10) + Device(sequence=10, stamp_us=5_000 + 2_000).frames(30)
    batches = run(bridge, every(data))
    assert [len(batch.gyro_x) for batch in batches] == [10, 10, 20]
    assert bridge.device_counters()["rejected_by_reason"] == {NOTE_PAUSE: 1}


@pytest.mark.parametrize("apart", [False, True], ids=["one read", "two reads"])
@pytest.mark.parametrize(
    ("interval_us", "lengths"),
    [(500, [20, 20]), (749, [20, 20]), (751, [10, 10, 20]), (1200, [10, 10, 20])],
)
def test_neighbours_are_contiguous_up_to_one_and_a_half_periods(
    interval_us: int, lengths: list[int], apart: bool
) -> None:
    """Of a sensor at 2 kHz: 750 µs; no sequence number is missing."""
    late = Device(sequence=10, stamp_us=4_500 + interval_us)
    parts = [Device().frames(10), late.frames(30)]
    reads = parts if apart else [b"".join(parts)]
    bridge = ImuBridge(vehicle())
    arrivals_ns = [HOST_START_NS + number * 5 * MS for number in range(len(reads))]
    batches = run(bridge, zip(reads, arrivals_ns, strict=True))
    check_columns(batches)
    assert [len(batch.gyro_x) for batch in batches] == lengths
    pauses = len(lengths) - 2
    assert bridge.device_counters()["rejected_by_reason"] == ({NOTE_PAUSE: 1} if pauses else {})
    assert bridge.device_counters()["samples_lost"] == 0


def test_counter_of_the_sensor_that_disagrees_is_noted_and_the_sample_kept() -> None:
    ones, counter = np.ones((60, 3)), np.arange(60)
    counter[20:] += 1
    counter[45:] += 1
    data = framer.encode(500 * np.arange(60), np.arange(60), ones, ones, data_cntr=counter)
    for size in (FRAME_LENGTH, 10**6):
        bridge = ImuBridge(vehicle())
        assert len(numbers_of(run(bridge, every(data, size)))) == 60
        assert bridge.device_counters()["rejected_by_reason"] == {NOTE_COUNTER: 2}


def test_silence_of_hours_keeps_the_clock() -> None:
    device, bridge = Device(skew=20e-6), ImuBridge(vehicle())
    run(bridge, jittered(device, 40 * 2000)[0])
    hours = 3 * 3600
    device.skip(2000 * hours)  # the stamp wraps twice meanwhile
    elapsed_ns = (device.sequence + 10) * PERIOD_NS * (1 + 20e-6)
    batches = run(bridge, [(device.frames(40), HOST_START_NS + int(elapsed_ns) + 20 * MS)])
    counters = bridge.device_counters()
    assert counters["samples_lost"] == 2000 * hours
    assert NOTE_RESTART not in counters["rejected_by_reason"]
    truth_ns = HOST_START_NS + round(batches[-1].first_sample_sequence * PERIOD_NS * (1 + 20e-6))
    assert batches[-1].stamp_ns == pytest.approx(truth_ns, abs=30 * MS)  # 2 ppm over 3 h


@pytest.mark.parametrize(
    ("sequence", "stamp_us"), [(2**24 + 110, 55_500), (110 + 2**30, 55_000), (2**31 - 1, 0)]
)
@pytest.mark.parametrize("size", [FRAME_LENGTH, 10**6])
def test_sequence_that_jumps_by_hours_in_no_time_is_a_restart(
    sequence: int, stamp_us: int, size: int
) -> None:
    """Arrivals tell that there was no silence in which the stamp could have wrapped."""
    bridge = ImuBridge(vehicle())
    data = Device().frames(110) + Device(sequence=sequence, stamp_us=stamp_us).frames(40)
    batches = run(bridge, every(data, size))
    check_columns(batches)
    counters = bridge.device_counters()
    assert counters["rejected_by_reason"] == {NOTE_RESTART: 1}
    assert counters["samples_lost"] == 0
    assert all(0 <= b.stamp_ns - HOST_START_NS + 60 * MS < S for b in batches)


def test_open_batch_is_closed_by_a_read_that_brings_none_after_a_while() -> None:
    bridge = ImuBridge(vehicle())
    assert run(bridge, [(Device().frames(5), HOST_START_NS)]) == []
    assert run(bridge, [(b"\x00", HOST_START_NS + HOLD_NS)]) == []
    (batch,) = run(bridge, [(b"\x00", HOST_START_NS + HOLD_NS + 1)])
    assert numbers_of([batch]) == list(range(5))


def test_noise_alone_gives_nothing_and_is_counted() -> None:
    bridge = ImuBridge(vehicle())
    noise = np.random.default_rng(2).integers(0, 256, 20_000, np.uint8).tobytes()
    assert run(bridge, every(noise, 999)) == []
    (bytes_ledger, samples) = bridge.ledgers()
    assert bytes_ledger.received == 20_000
    assert bytes_ledger.dropped + bytes_ledger.pending == 20_000
    assert samples.received == 0
    assert "clock_offset_s" not in bridge.device_counters()


# memory -------------------------------------------------------------------------------------------


def test_restored_bridge_goes_on_like_the_one_that_was_copied() -> None:
    device = Device(sequence=3)
    data = device.frames(60)
    device.skip(2)
    data += b"\xad\x65\x01" + device.frames(70) + Device(stamp_us=9).frames(50)
    reads = every(data, 100)
    whole = ImuBridge(vehicle())
    expected = [run(whole, [read]) for read in reads]
    for cut in range(len(reads)):
        first, second = ImuBridge(vehicle()), ImuBridge(vehicle())
        run(first, reads[:cut])
        state = first.snapshot()
        copy = pickle.dumps(state)
        second.restore(state)
        assert [run(second, [read]) for read in reads[cut:]] == expected[cut:]
        assert pickle.dumps(state) == copy
        assert pack(second.snapshot()) == pack(whole.snapshot())
        assert second.device_counters() == whole.device_counters()


def test_ledgers_follow_every_byte_and_sample() -> None:
    bridge = ImuBridge(vehicle())
    run(bridge, [(b"xx" + Device().frames(45) + b"\xad", HOST_START_NS)])
    bytes_ledger, samples = bridge.ledgers()
    assert (bytes_ledger.delivered, bytes_ledger.dropped, bytes_ledger.pending) == (45 * 36, 2, 1)
    assert (samples.received, samples.delivered, samples.pending) == (45, 40, 5)


def test_vehicle_without_an_imu_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match=r"\$\.imu: missing"):
        ImuBridge(Vehicle(vehicle="t"))
