"""The resampler: order by stamps whatever the order of arrival, gaps, silence, lateness, memory."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import (
    ACCEL_SCALE_MPS2,
    GYRO_SCALE_RADPS,
    MS,
    PERIOD_NS,
    START_NS,
    batch,
    batches,
    encoded,
    fix,
    messages,
    noise,
    stamp_of,
    step_all,
    tick,
    vehicle,
    wheels,
)

from tramstream import keys
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.live import snapshots
from tramstream.processor import Sample
from tramstream.processors.resampling.resampler import MAX_AHEAD_S, Resampler
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.proto.sync_pb2 import LateSample

LAG_NS = 300 * MS
SI = 1e-12
"""Rounding of means in SI units."""


def resampler(**fields: object) -> Resampler:
    return Resampler(vehicle(**fields))


def measurements(end_ns: int) -> list[Sample]:
    """Wheels at 50 Hz and fixes at 5 Hz until `end_ns`."""
    found = []
    for index in range((end_ns - START_NS) // (20 * MS)):
        stamp_ns = START_NS + 3 * MS + index * 20 * MS
        found.append(wheels(stamp_ns, [7 * index, 7 * index], index + 1))
        if index % 10 == 0:
            found.append(fix(stamp_ns, 5.0, index // 10 + 1))
    return found


def merged(*streams: list[Sample]) -> list[Sample]:
    """All samples in the order of their stamps."""
    return sorted((sample for stream in streams for sample in stream), key=lambda s: s.stamp_ns)


# Means and frames ---------------------------------------------------------------------------------
def test_means_are_in_si_and_stamped_at_their_centre() -> None:
    counts = noise(400)
    means = messages(step_all(resampler(), batches(counts)), keys.SYNC_IMU)
    expected = counts.reshape(6, 20, 20).mean(axis=2)
    np.testing.assert_allclose(
        [mean.gyro_z_radps for mean in means], expected[2] * GYRO_SCALE_RADPS, atol=SI
    )
    np.testing.assert_allclose(
        [mean.accel_x_mps2 for mean in means], expected[3] * ACCEL_SCALE_MPS2, atol=SI
    )
    for index, mean in enumerate(means):
        assert mean.stamp_ns == stamp_of(20 * index) + 19 * PERIOD_NS // 2
        assert (mean.sequence, mean.sample_count, mean.bridged_count) == (index + 1, 20, 0)
        assert mean.temperature_degc == pytest.approx(25.0)


def test_frames_are_ascending_and_hold_every_measurement_once_in_its_place() -> None:
    sent = measurements(START_NS + 4 * S)
    outputs = step_all(resampler(), merged(batches(noise(10_000)), sent))
    frames = messages(outputs, keys.SYNC_FRAME)
    before_ns = 0
    released = []
    for frame in frames:
        assert frame.stamp_ns > before_ns
        inside = [*frame.gnss, *frame.odometry]
        assert all(before_ns < message.stamp_ns <= frame.stamp_ns for message in inside)
        for field in (frame.gnss, frame.odometry):
            assert [m.stamp_ns for m in field] == sorted(m.stamp_ns for m in field)
        released += inside
        before_ns = frame.stamp_ns
    assert len(released) == len(sent)
    assert not messages(outputs, keys.SYNC_LATE)


def test_horizon_stays_the_lag_behind_the_newest_sample() -> None:
    processor = resampler()
    for sample in batches(noise(4000)):
        newest_ns = sample.stamp_ns + 19 * PERIOD_NS
        for output in processor.step(sample):
            if output.key is keys.SYNC_FRAME:
                assert output.stamp_ns <= newest_ns - LAG_NS
                assert newest_ns - LAG_NS - output.stamp_ns < 10 * MS


def test_a_rate_that_the_cut_off_does_not_fit_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"\$\.resampler\.cutoff_hz"):
        resampler(method="lowpass", cutoff_hz=50.0)


# Any cut and any order ----------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["mean", "lowpass"])
@settings(max_examples=20)
@given(sizes=st.lists(st.integers(1, 73), max_size=40))
def test_any_cut_into_batches_gives_the_same_bytes(method: str, sizes: list[int]) -> None:
    # A batch that ends later releases later, so measurements come before all of them.
    counts, sent = noise(2400), measurements(START_NS + S)
    lost = batches(counts[:, :1000], sizes), batches(counts[:, 1010:], sizes, 1010)
    whole = batches(counts[:, :1000], []), batches(counts[:, 1010:], [], 1010)
    one = step_all(resampler(method=method), [*sent, *whole[0], *whole[1]])
    other = step_all(resampler(method=method), [*sent, *lost[0], *lost[1]])
    assert encoded(other) == encoded(one)
    assert len(messages(one, keys.SYNC_GAP)) == 1


@settings(max_examples=30)
@given(data=st.data())
def test_order_of_arrival_makes_no_difference_while_nothing_is_late(data: st.DataObject) -> None:
    inertial, sent = batches(noise(3000)), measurements(START_NS + 1500 * MS)
    reference = step_all(resampler(), merged(inertial, sent))
    # Each measurement comes up to 200 ms early or late: less than the lag.
    shifts = data.draw(
        st.lists(st.integers(-200 * MS, 200 * MS), min_size=len(sent), max_size=len(sent))
    )
    arrivals = [
        (sample.stamp_ns + shift, sample) for sample, shift in zip(sent, shifts, strict=True)
    ]
    arrivals += [(sample.stamp_ns, sample) for sample in inertial]
    shuffled = [sample for _, sample in sorted(arrivals, key=lambda item: item[0])]
    assert encoded(step_all(resampler(), shuffled)) == encoded(reference)


def test_measurements_of_one_instant_keep_their_order_and_may_even_be_equal() -> None:
    stamp_ns = stamp_of(100)
    twins = [wheels(stamp_ns, [1]), wheels(stamp_ns, [1]), wheels(stamp_ns, [1])]
    outputs = step_all(resampler(), [*twins, *batches(noise(1000))])
    assert sum(len(frame.odometry) for frame in messages(outputs, keys.SYNC_FRAME)) == 3


# Gaps ---------------------------------------------------------------------------------------------
def with_gap(missing: int, counts: np.ndarray) -> list[Sample]:
    """Batches of 20; `missing` samples after sample 400 never come."""
    resume = 400 + missing
    return [*batches(counts[:, :400]), *batches(counts[:, resume:], [20] * 40, resume)]


@pytest.mark.parametrize("missing", [1, 7, 19, 20])
def test_short_gap_is_bridged_and_marked(missing: int) -> None:
    ramp = np.tile(np.arange(1600), (6, 1))
    outputs = step_all(resampler(), with_gap(missing, ramp))
    (gap,) = messages(outputs, keys.SYNC_GAP)
    assert (gap.first_missing, gap.missing_count, gap.bridged) == (400, missing, True)
    assert gap.duration_s == pytest.approx((missing + 1) * 0.0005)
    means = messages(outputs, keys.SYNC_IMU)
    assert sum(mean.bridged_count for mean in means) == missing
    for mean in means:
        assert mean.sample_count + mean.bridged_count == 20
        at = (mean.stamp_ns - START_NS) / PERIOD_NS
        assert mean.gyro_x_radps == pytest.approx(at * GYRO_SCALE_RADPS)


@pytest.mark.parametrize("missing", [21, 200, 20_000])
@pytest.mark.parametrize("method", ["mean", "lowpass"])
def test_long_gap_is_told_and_nothing_in_it_invented(missing: int, method: str) -> None:
    outputs = step_all(resampler(method=method), with_gap(missing, noise(missing + 1600)))
    (gap,) = messages(outputs, keys.SYNC_GAP)
    assert (gap.first_missing, gap.missing_count, gap.bridged) == (400, missing, False)
    assert gap.stamp_ns == stamp_of(399)
    for mean in messages(outputs, keys.SYNC_IMU):
        assert (mean.sample_count, mean.bridged_count) == (20, 0)
        first = mean.first_sample_sequence
        assert first + 20 <= 400 or first >= 400 + missing


@pytest.mark.parametrize("limit", [0, 3])
def test_gap_limit_is_the_configured_one(limit: int) -> None:
    for missing in (limit, limit + 1):
        outputs = step_all(resampler(max_bridge_samples=limit), with_gap(missing, noise(1600)))
        bridged = [gap.bridged for gap in messages(outputs, keys.SYNC_GAP)]
        assert bridged == ([] if missing == 0 else [missing <= limit])


def test_pause_without_a_missing_number_is_a_gap_not_a_window() -> None:
    counts = noise(1000)
    late_ns = 3 * S
    resumed = [
        batch(counts[:, begin : begin + 20], stamp_of(begin) + late_ns, begin)
        for begin in range(510, 990, 20)
    ]
    outputs = step_all(resampler(), [*batches(counts[:, :510]), *resumed])
    (gap,) = messages(outputs, keys.SYNC_GAP)
    assert (gap.missing_count, gap.bridged) == (0, False)
    assert gap.duration_s == pytest.approx(3.0005)
    for mean in messages(outputs, keys.SYNC_IMU):
        assert not stamp_of(510) <= mean.stamp_ns < stamp_of(510) + late_ns


def test_few_missing_numbers_over_a_long_time_are_not_bridged() -> None:
    counts = noise(1000)
    resumed = [batch(counts[:, :20], stamp_of(405) + S, 405)]
    (gap,) = messages(step_all(resampler(), [*batches(counts[:, :400]), *resumed]), keys.SYNC_GAP)
    assert (gap.missing_count, gap.bridged) == (5, False)


def test_restarted_device_begins_a_new_run() -> None:
    counts = noise(2000)
    restarted = [
        batch(counts[:, begin : begin + 20], stamp_of(begin) + S, begin)
        for begin in range(0, 1000, 20)
    ]
    outputs = step_all(resampler(), [*batches(counts[:, :1000]), *restarted])
    (gap,) = messages(outputs, keys.SYNC_GAP)
    assert (gap.missing_count, gap.bridged) == (0, False)
    means = messages(outputs, keys.SYNC_IMU)
    assert [mean.first_sample_sequence for mean in means] == [*range(0, 1000, 20)] * 2


# Lateness -----------------------------------------------------------------------------------------
def test_late_measurement_is_published_and_never_used() -> None:
    processor = resampler()
    step_all(processor, batches(noise(2000)))
    late = fix(START_NS + 100 * MS, 5.0, 17)
    (told,) = step_all(processor, [late])
    assert told.key is keys.SYNC_LATE
    assert told.message.key == keys.GNSS_FIX.path
    assert told.message.source_sequence == 17
    assert told.message.source_publish_ns == late.publish_ns
    assert told.message.horizon_ns >= late.stamp_ns
    later = step_all(processor, batches(noise(2000), first=2000))
    assert not any(frame.gnss for frame in messages(later, keys.SYNC_FRAME))
    assert processor.ledgers()[1].dropped == 1


def test_measurement_right_at_the_horizon_is_late_and_right_after_it_is_not() -> None:
    processor = resampler()
    frames = messages(step_all(processor, batches(noise(2000))), keys.SYNC_FRAME)
    horizon_ns = frames[-1].stamp_ns
    assert [s.key for s in processor.step(fix(horizon_ns))] == [keys.SYNC_LATE]
    assert processor.step(fix(horizon_ns + 1)) == []


def test_what_was_late_live_is_late_again_when_reprocessed() -> None:
    live = resampler()
    late = fix(START_NS + 100 * MS, 5.0, 3)
    samples = batches(noise(4000))
    told = step_all(live, [*samples[:100], late, *samples[100:]])
    (recorded,) = messages(told, keys.SYNC_LATE)
    again = resampler()
    again.late_recorded = {(keys.GNSS_FIX.path, late.publish_ns): recorded}
    assert encoded(step_all(again, [late, *samples])) == encoded(told)


def test_recorded_lateness_is_not_changed_by_repeating_it() -> None:
    recorded = LateSample(key=keys.GNSS_FIX.path, stamp_ns=START_NS, sequence=9, horizon_ns=1)
    before = recorded.SerializeToString()
    processor = resampler()
    sample = fix(START_NS)
    processor.late_recorded = {(keys.GNSS_FIX.path, sample.publish_ns): recorded}
    (told,) = processor.step(sample)
    assert told.message.SerializeToString() == before == recorded.SerializeToString()
    assert told.sequence == 9


def test_measurement_of_the_far_future_is_refused() -> None:
    processor = resampler()
    step_all(processor, batches(noise(1000)))
    near = fix(stamp_of(999) + int((MAX_AHEAD_S - 1) * S))
    far = fix(stamp_of(999) + int((MAX_AHEAD_S + 1) * S))
    assert [s.key for s in step_all(processor, [near, far])] == [keys.SYNC_LATE]
    assert processor.ledgers()[1].pending == 1


def test_far_future_measurement_at_the_very_start_does_not_hide_the_following() -> None:
    processor = resampler()
    outputs = step_all(processor, [fix(START_NS + 3600 * S), *batches(noise(2000))])
    assert len(messages(outputs, keys.SYNC_FRAME)) > 60
    refused = step_all(processor, [fix(START_NS + 3600 * S + index) for index in range(10)])
    assert len(messages(refused, keys.SYNC_LATE)) == 10  # they do not pile up


def test_reprocessing_does_not_judge_the_future_by_its_own_order() -> None:
    early = fix(stamp_of(20_000))  # live it came after the inertial samples of its time
    processor = resampler()
    processor.late_recorded = {}
    outputs = step_all(processor, [*batches(noise(20)), early, *batches(noise(24_000), first=20)])
    assert sum(len(frame.gnss) for frame in messages(outputs, keys.SYNC_FRAME)) == 1


@pytest.mark.parametrize(
    "garble",
    [
        lambda batch: batch.gyro_y.append(1),
        lambda batch: batch.accel_z.pop(),
        lambda batch: setattr(batch, "period_ns", math.nan),
        lambda batch: setattr(batch, "period_ns", math.inf),
        lambda batch: setattr(batch, "period_ns", -5e5),
        lambda batch: setattr(batch, "period_ns", 1e18),
    ],
)
def test_batch_that_no_bridge_makes_costs_itself_alone(garble: Callable[[ImuBatch], None]) -> None:
    good = batches(noise(2000))
    broken = copy.deepcopy(good[50].message)
    garble(broken)
    processor = resampler()
    samples = [*good[:50], good[50]._replace(message=broken), *good[50:]]
    made, right = step_all(processor, samples), step_all(resampler(), good)
    assert encoded(made) == encoded(right)
    assert processor.ledgers()[0].dropped >= len(broken.gyro_x)


def test_reversed_inertial_stamps_are_told_and_not_used() -> None:
    processor = resampler()
    step_all(processor, batches(noise(2000)))
    old = batches(noise(400))[3]
    (told,) = step_all(processor, [old])
    assert told.key is keys.SYNC_LATE
    assert told.message.key == keys.IMU_BATCH.path
    assert processor.ledgers()[0].dropped == 20


def test_run_that_overlaps_the_one_before_leaves_the_frames_ascending() -> None:
    counts = noise(3000)
    overlapping = [
        batch(counts[:, begin : begin + 20], stamp_of(980 + begin), 5000 + begin)
        for begin in range(0, 2000, 20)
    ]
    outputs = step_all(resampler(), [*batches(counts[:, :1000]), *overlapping])
    stamps = [frame.stamp_ns for frame in messages(outputs, keys.SYNC_FRAME)]
    assert stamps == sorted(set(stamps))
    assert len(stamps) > 80


# Silence ------------------------------------------------------------------------------------------
def test_ticks_move_the_horizon_while_there_is_no_inertial_data() -> None:
    sent = measurements(START_NS + 2 * S)
    ticks = [tick(START_NS + index * 100 * MS) for index in range(30)]
    outputs = step_all(resampler(), merged(sent, ticks))
    frames = messages(outputs, keys.SYNC_FRAME)
    assert not any(frame.HasField("imu") for frame in frames)
    assert sum(len(frame.odometry) for frame in frames) == len(sent) - 10
    assert sum(len(frame.gnss) for frame in frames) == 10
    assert [frame.stamp_ns for frame in frames] == [t.stamp_ns - LAG_NS for t in ticks]


def test_ticks_do_nothing_while_inertial_data_comes() -> None:
    inertial = batches(noise(4000))
    ticks = [tick(START_NS + 1 + index * 100 * MS) for index in range(20)]
    sent = measurements(START_NS + 2 * S)
    with_ticks = step_all(resampler(), merged(inertial, ticks, sent))
    assert encoded(with_ticks) == encoded(step_all(resampler(), merged(inertial, sent)))


def test_inertial_data_lost_midway_and_back_again() -> None:
    counts = noise(2000)
    back_ns = 5 * S
    first = [*batches(counts), *measurements(START_NS + S)]
    ticks = [tick(START_NS + index * 100 * MS) for index in range(1, 65)]
    again = [
        batch(counts[:, begin : begin + 20], START_NS + back_ns + begin * PERIOD_NS, 10_000 + begin)
        for begin in range(0, 2000, 20)
    ]
    sent = [wheels(START_NS + 1010 * MS + index * 20 * MS, [index]) for index in range(225)]
    outputs = step_all(resampler(), merged(first, ticks, again, sent))
    frames = messages(outputs, keys.SYNC_FRAME)
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == sorted(set(stamps))
    assert not messages(outputs, keys.SYNC_LATE)
    silent = [f for f in frames if START_NS + S < f.stamp_ns < START_NS + back_ns - LAG_NS]
    assert len(silent) >= 30
    assert not any(frame.HasField("imu") for frame in silent)
    assert all(frame.odometry for frame in silent)
    assert frames[-1].HasField("imu")
    (gap,) = messages(outputs, keys.SYNC_GAP)
    assert not gap.bridged
    assert gap.missing_count == 8000


def test_means_behind_a_horizon_that_ticks_moved_are_late() -> None:
    processor = resampler()
    step_all(processor, [*batches(noise(200)), tick(START_NS + 2 * S)])
    outputs = step_all(processor, batches(noise(400), first=200))  # a hold-up, not a silence
    late = messages(outputs, keys.SYNC_LATE)
    assert {message.key for message in late} == {keys.SYNC_IMU.path}
    assert len(late) == len(messages(outputs, keys.SYNC_IMU)) == 20
    assert not messages(outputs, keys.SYNC_FRAME)


def test_nothing_at_all_gives_frames_with_nothing_in_them() -> None:
    outputs = step_all(resampler(), [tick(START_NS + index * 100 * MS) for index in range(10)])
    assert [output.key for output in outputs] == [keys.SYNC_FRAME] * 10


def test_empty_batch_changes_nothing() -> None:
    processor = resampler()
    assert step_all(processor, [batch(noise(0), START_NS, 0)]) == []
    assert processor.ledgers()[0].received == 0


# Memory -------------------------------------------------------------------------------------------
def ride() -> list[Sample]:
    """Inertial data with a short and a long gap and a silence, measurements, ticks, one late."""
    counts = noise(4000)
    inertial = [
        *batches(counts[:, :510], [17] * 30),
        *batches(counts[:, 517:1000], [20] * 30, 517),
        *batches(counts[:, 1100:2000], [33] * 30, 1100),
        *batches(counts[:, :600], [20] * 30, 5000),
    ]
    ticks = [tick(START_NS + 1 + index * 100 * MS) for index in range(30)]
    stream = merged(inertial, ticks, measurements(START_NS + 2800 * MS))
    stream.insert(len(stream) // 3, fix(START_NS, 1.0, 99))
    return stream


@pytest.mark.parametrize("method", ["mean", "lowpass"])
@settings(max_examples=25)
@given(data=st.data())
def test_restored_resampler_goes_on_with_the_same_bytes(method: str, data: st.DataObject) -> None:
    samples = ride()
    whole = encoded(step_all(resampler(method=method), samples))
    cut = data.draw(st.integers(0, len(samples)))
    before, after = resampler(method=method), resampler(method=method)
    outputs = step_all(before, samples[:cut])
    state = snapshots.pack(before.snapshot())
    step_all(before, samples[cut:])
    after.restore(snapshots.unpack(state))
    assert snapshots.pack(after.snapshot()) == state
    outputs += step_all(after, samples[cut:])
    assert encoded(outputs) == whole


def test_ledgers_hold_every_sample_and_measurement() -> None:
    processor = resampler()
    samples = ride()
    step_all(processor, samples)
    inertial, measured = processor.ledgers()
    assert inertial.received == sum(
        len(s.message.gyro_x) for s in samples if s.key is keys.IMU_BATCH
    )
    assert measured.received == sum(s.key in (keys.GNSS_FIX, keys.ODO_WHEELS) for s in samples)
    assert measured.dropped == 1
