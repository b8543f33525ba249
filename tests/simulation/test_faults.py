"""Faults of sensors: what is recorded, held to what the sensor said without the fault."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream import keys
from tramstream.clock import S
from tramstream.keys import Key
from tramstream.lines.line import built_in_line
from tramstream.processor import Sample
from tramstream.simulation import scenario
from tramstream.simulation.event_kinds import (
    AXES,
    AnyEvent,
    Axis,
    ClockOff,
    Fault,
    GnssDrift,
    GnssFrozen,
    GnssHold,
    GnssJammed,
    GnssRateLost,
    GnssStated,
    ImuDead,
    ImuLost,
    ImuSaturated,
    ImuStuck,
    WheelsFrozen,
)
from tramstream.simulation.faults import Timed, faulted
from tramstream.simulation.scenario import Imu, Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation

Array = NDArray[np.float64]

START_S, LASTS_S, END_S = 20.123, 6.4, 40.0
MOVING: Scenario = scenario.Scenario(
    imu=Imu(rate_hz=100.0, batch=10), gnss=scenario.Gnss(), wheels=scenario.Wheels()
)


@cache
def recorded(*events: AnyEvent) -> tuple[Sample, ...]:
    fields = {name: getattr(MOVING, name) for name in MOVING.__struct_fields__}
    chosen = Scenario(**{**fields, "events": events})
    return tuple(Simulation(built_in_line(), chosen, 3, END_S).samples())


def of(key: Key, *events: AnyEvent) -> list[Sample]:
    return [each for each in recorded(*events) if each.key is key]


def readings(axis: Axis, samples: list[Sample]) -> tuple[Array, Array]:
    """Times of the ride and counts."""
    rows = [
        ((batch.stamp_ns + round(row * batch.period_ns) - EPOCH_NS) / S, value)
        for batch in (each.message for each in samples)
        for row, value in enumerate(getattr(batch, axis))
    ]
    time_s, counts = np.array(rows).T
    return time_s, counts


def within(time_s: Array) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (time_s >= START_S) & (time_s < START_S + LASTS_S)
    return inside


def times_s(samples: list[Sample]) -> Array:
    return (np.array([each.stamp_ns for each in samples]) - EPOCH_NS) / S


def fault(kind: type[Fault], **fields: object) -> Fault:
    return kind(start_s=START_S, duration_s=LASTS_S, **fields)  # type: ignore[arg-type]


ALL: list[Fault] = [
    fault(ImuStuck), fault(ImuDead), fault(ImuSaturated), fault(ImuLost),
    fault(ImuLost, straight=True), fault(GnssFrozen), fault(GnssHold, below_mps=30.0),
    fault(GnssJammed), fault(GnssStated), fault(GnssRateLost), fault(WheelsFrozen),
    fault(ClockOff, sensor="gnss", offset_s=0.3),
]  # fmt: skip


@pytest.mark.parametrize("each", ALL, ids=lambda each: type(each).__name__)
def test_fault_changes_its_sensor_alone_and_nothing_before_it(each: Fault) -> None:
    plain, broken = recorded(), recorded(each)
    changed = set()
    for key in (keys.TRUTH_STATE, keys.IMU_BATCH, keys.GNSS_FIX, keys.ODO_WHEELS):
        was = [sample.message for sample in plain if sample.key is key]
        now = [sample.message for sample in broken if sample.key is key]
        if was != now:
            changed.add(key.path)
        early = [message for message in now if message.stamp_ns < EPOCH_NS + (START_S - 0.2) * S]
        assert early == was[: len(early)]
    kind = type(each).__name__
    expected = next(
        key.path
        for word, key in (
            ("Imu", keys.IMU_BATCH),
            ("Gnss", keys.GNSS_FIX),
            ("Clock", keys.GNSS_FIX),
            ("Wheels", keys.ODO_WHEELS),
        )
        if kind.startswith(word)
    )
    assert changed == {expected}
    published = [sample.publish_ns for sample in broken]
    assert published == sorted(published)


@pytest.mark.parametrize("each", ALL, ids=lambda each: type(each).__name__)
def test_messages_that_a_fault_is_laid_over_stay_as_they_are(each: Fault) -> None:
    samples = recorded()
    before = [sample.message.SerializeToString() for sample in samples]
    start_ns = EPOCH_NS + round(START_S * S)
    list(faulted(samples, [Timed(each, start_ns, start_ns + round(LASTS_S * S))]))
    assert [sample.message.SerializeToString() for sample in samples] == before


# The inertial sensor ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("kind", "value"), [(ImuDead, 0.0), (ImuSaturated, 32767.0), (ImuStuck, None)]
)
def test_axis_reads_zero_its_end_or_what_it_read_last(
    kind: type[Fault], value: float | None
) -> None:
    time_s, was = readings("gyro_z", of(keys.IMU_BATCH))
    _, now = readings("gyro_z", of(keys.IMU_BATCH, fault(kind, axes=("gyro_z",))))
    inside = within(time_s)
    last = was[np.flatnonzero(inside)[0] - 1]
    np.testing.assert_array_equal(now[inside], last if value is None else value)
    np.testing.assert_array_equal(now[~inside], was[~inside])
    _, others = readings("accel_x", of(keys.IMU_BATCH, fault(kind, axes=("gyro_z",))))
    np.testing.assert_array_equal(others, readings("accel_x", of(keys.IMU_BATCH))[1])


def test_fault_that_begins_within_a_batch_begins_there() -> None:
    time_s, was = readings("accel_y", of(keys.IMU_BATCH))
    _, now = readings("accel_y", of(keys.IMU_BATCH, fault(ImuDead)))
    first = np.flatnonzero(within(time_s))[0]
    assert first % 10
    assert now[first - 1] == was[first - 1]
    assert now[first] == 0 != was[first]


def test_lost_samples_are_missing_and_the_counter_tells_how_many() -> None:
    lost = of(keys.IMU_BATCH, fault(ImuLost))
    time_s, _ = readings("gyro_x", lost)
    assert not within(time_s).any()
    numbers = [
        each.message.first_sample_sequence + row
        for each in lost
        for row in range(len(each.message.gyro_x))
    ]
    whole, _ = readings("gyro_x", of(keys.IMU_BATCH))
    np.testing.assert_allclose(time_s, whole[numbers], atol=1e-9)


def test_samples_drawn_straight_lie_on_the_line_between_their_neighbours() -> None:
    time_s, was = readings("accel_x", of(keys.IMU_BATCH))
    drawn = of(keys.IMU_BATCH, fault(ImuLost, straight=True))
    _, now = readings("accel_x", drawn)
    inside = np.flatnonzero(within(time_s))
    ends = [inside[0] - 1, inside[-1] + 1]
    line = np.interp(np.arange(len(was)), ends, was[ends])
    np.testing.assert_allclose(now[inside], line[inside], atol=0.5)  # rounded to counts
    rest = np.setdiff1d(np.arange(len(was)), inside)
    np.testing.assert_array_equal(now[rest], was[rest])
    assert [each.publish_ns for each in drawn] == [each.publish_ns for each in of(keys.IMU_BATCH)]


def test_gap_that_lasts_until_the_end_stays_level() -> None:
    gap = ImuLost(start_s=30.0, duration_s=100.0, straight=True)
    time_s, was = readings("gyro_z", of(keys.IMU_BATCH))
    _, now = readings("gyro_z", of(keys.IMU_BATCH, gap))
    first = np.flatnonzero(time_s >= 30.0)[0]
    assert len(now) == len(was)
    assert set(now[first:]) == {was[first - 1]}


# The receiver -------------------------------------------------------------------------------------
@pytest.mark.parametrize("velocity", ["kept", "zero", "absent"])
def test_frozen_receiver_repeats_its_last_valid_place(velocity: str) -> None:
    was, now = of(keys.GNSS_FIX), of(keys.GNSS_FIX, fault(GnssFrozen, velocity=velocity))
    inside = np.flatnonzero(within(times_s(now)))
    last = was[inside[0] - 1].message
    for row in inside:
        fix = now[row].message
        assert fix.valid
        assert (fix.latitude_deg, fix.longitude_deg) == (last.latitude_deg, last.longitude_deg)
        assert fix.stamp_ns == was[row].message.stamp_ns
        assert fix.HasField("vel_e_mps") == (velocity != "absent")
        expected = {"kept": last.vel_e_mps, "zero": 0.0, "absent": 0.0}[velocity]
        assert fix.vel_e_mps == expected


def test_static_hold_says_0_while_the_vehicle_creeps() -> None:
    hold = GnssHold(start_s=0.0, duration_s=END_S, below_mps=2.0)
    was, now = of(keys.GNSS_FIX), of(keys.GNSS_FIX, hold)
    slow = np.array([each.message.speed_mps < 2.0 for each in was])
    assert 0 < slow.sum() < len(slow)
    for is_slow, before, each in zip(slow, was, now, strict=True):
        assert each.message.speed_mps == (0.0 if is_slow else before.message.speed_mps)
        if not is_slow:
            assert each.message == before.message
    places = {each.message.latitude_deg for is_slow, each in zip(slow, now, strict=True) if is_slow}
    assert len(places) < 4  # one for each time that it stands


def test_boastful_receiver_states_a_share_of_what_it_stated() -> None:
    was, now = of(keys.GNSS_FIX), of(keys.GNSS_FIX, fault(GnssStated, factor=0.1))
    inside = within(times_s(was))
    ratio = [
        each.message.horizontal_std_m / before.message.horizontal_std_m
        for before, each in zip(was, now, strict=True)
    ]
    np.testing.assert_allclose(ratio, np.where(inside, 0.1, 1.0))


def test_lost_fixes_leave_one_in_so_many() -> None:
    inside = within(times_s(of(keys.GNSS_FIX))).sum()
    left = of(keys.GNSS_FIX, fault(GnssRateLost, keeps=4))
    assert within(times_s(left)).sum() == -(-inside // 4)
    assert not within(times_s(of(keys.GNSS_FIX, fault(GnssRateLost)))).any()


def test_jammed_receiver_has_few_satellites_and_errors_that_it_does_not_state() -> None:
    jammed = GnssJammed(start_s=0.0, duration_s=END_S + 1.0, std_m=10.0, satellites=5)
    was, now = of(keys.GNSS_FIX), of(keys.GNSS_FIX, jammed)
    north = [
        math.radians(each.message.latitude_deg - before.message.latitude_deg) * 6378137.0
        for before, each in zip(was, now, strict=True)
    ]
    assert 4.0 < np.std(north) < 16.0  # of some thirteen independent ones
    assert {each.message.satellites_used for each in now} == {5}
    assert [each.message.horizontal_std_m for each in now] == [
        each.message.horizontal_std_m for each in was
    ]
    deaf = of(keys.GNSS_FIX, fault(GnssJammed, satellites=3))
    valid = np.array([each.message.valid for each in deaf])
    np.testing.assert_array_equal(valid, ~within(times_s(deaf)))


@pytest.mark.parametrize("velocity", [False, True])
def test_spoofed_drift_is_in_the_velocity_if_the_spoofer_is_good(velocity: bool) -> None:
    drift = GnssDrift(start_s=10.0, duration_s=20.0, east_m=30.0, north_m=-10.0, velocity=velocity)
    was, now = of(keys.GNSS_FIX), of(keys.GNSS_FIX, drift)
    time_s = times_s(was)
    middle = (time_s > 11.0) & (time_s < 29.0)
    more = np.array([
        (
            each.message.vel_e_mps - before.message.vel_e_mps,
            each.message.vel_n_mps - before.message.vel_n_mps,
        )
        for before, each in zip(was, now, strict=True)
    ])  # fmt: skip
    expected = (1.5, -0.5) if velocity else (0.0, 0.0)
    np.testing.assert_allclose(more[middle], np.tile(expected, (middle.sum(), 1)), atol=2e-3)
    np.testing.assert_allclose(more[time_s < 10.0], 0.0, atol=1e-12)


# Wheels and clocks --------------------------------------------------------------------------------
def pulses(samples: list[Sample], wheel: int) -> Array:
    return np.array([each.message.wheels[wheel].pulses for each in samples], dtype=float)


def test_frozen_wheel_counts_nothing_and_makes_up_for_nothing() -> None:
    was, now = of(keys.ODO_WHEELS), of(keys.ODO_WHEELS, fault(WheelsFrozen, wheels=("left",)))
    inside = within(times_s(was))
    steps_was, steps_now = np.diff(pulses(was, 0)), np.diff(pulses(now, 0))
    np.testing.assert_array_equal(steps_now, np.where(inside[1:], 0.0, steps_was))
    np.testing.assert_array_equal(pulses(now, 1), pulses(was, 1))


def test_wheel_that_repeats_its_speed_goes_on_evenly() -> None:
    was, now = of(keys.ODO_WHEELS), of(keys.ODO_WHEELS, fault(WheelsFrozen, holds="speed"))
    inside = within(times_s(was))[1:]
    for wheel in (0, 1):
        steps_was, steps_now = np.diff(pulses(was, wheel)), np.diff(pulses(now, wheel))
        last = steps_was[np.flatnonzero(inside)[0] - 1]
        assert last > 0
        np.testing.assert_array_equal(steps_now, np.where(inside, last, steps_was))


def test_wheels_dead_from_the_start_count_0() -> None:
    dead = of(keys.ODO_WHEELS, WheelsFrozen(start_s=0.0, duration_s=END_S + 1.0))
    assert not pulses(dead, 0).any()
    assert pulses(of(keys.ODO_WHEELS), 0)[-1] > 1000


@pytest.mark.parametrize("offset_s", [0.3, -0.3])
def test_clock_that_is_off_moves_stamps_and_never_beyond_their_publication(offset_s: float) -> None:
    was = of(keys.GNSS_FIX)
    now = of(keys.GNSS_FIX, fault(ClockOff, sensor="gnss", offset_s=offset_s))
    inside = within(times_s(was))
    moved = times_s(now) - times_s(was)
    np.testing.assert_allclose(moved, np.where(inside, offset_s, 0.0), atol=1e-9)
    assert all(each.message.stamp_ns == each.stamp_ns <= each.publish_ns for each in now)


def test_scenario_file_names_faults_as_events() -> None:
    text = b"""
    [[events]]
    kind = "imu_stuck"
    start_s = 3.0
    duration_s = 2.0
    axes = ["gyro_z"]
    [[events]]
    kind = "wheels_frozen"
    stop = 2
    wheels = ["left"]
    """
    events = scenario.parse(text, "text").events
    assert isinstance(events[0], ImuStuck)
    assert events[0].axes == ("gyro_z",)
    assert isinstance(events[1], WheelsFrozen)
    assert set(AXES) > set(events[0].axes)
