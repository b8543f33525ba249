"""Sensors that do not live: left out within seconds, said, taken back; the ride goes on without.

Truth is the simulator's. A fault is put into the frames of a ride; what it costs is told by the
same ride with that sensor absent, or by what the filter claims.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from rides import Errors, Ride, judged, laid, reference, ridden, time_s
from test_tram_faults import DRIVER, PLAN, altered

from tramstream.attitude import C_vl
from tramstream.estimation.records import numbers, one
from tramstream.events.kinds import Event
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.standstill import FAST_S
from tramstream.processors.tram_filter import events
from tramstream.processors.tram_model import axes
from tramstream.processors.tram_model.records import INERTIAL
from tramstream.proto.sync_pb2 import SyncFrame

AT_S, LASTS_S = 33.0, 12.0
"""In motion, from before the second stop until after it."""
AXES = (
    "gyro_x_radps",
    "gyro_y_radps",
    "gyro_z_radps",
    "accel_x_mps2",
    "accel_y_mps2",
    "accel_z_mps2",
)
RANGE_RADPS, RANGE_MPS2 = 2.1, 19.6
"""Ends of the range of common sensors: 125 °/s, 2 g."""
PROTECTION_SIGMA = 4.35
"""What is published as a bound (docs/theory.md, section 13)."""
Fault = Callable[[list[SyncFrame]], None]


@cache
def undisturbed(velocity: bool = True) -> Ride:
    gnss = {"velocity": velocity, "rate_hz": 5.0}
    chosen = altered(reference(), driver=DRIVER, gnss=gnss)
    return ridden(laid(PLAN + " | 300 |"), chosen, 2, 105.0)


def during(frames: list[SyncFrame], start_s: float, lasts_s: float) -> list[SyncFrame]:
    return [each for each in frames if start_s < time_s(each.stamp_ns) <= start_s + lasts_s]


def gone(
    ride: Ride, fault: Fault, start_s: float = AT_S, lasts_s: float = LASTS_S
) -> tuple[Errors, list[tuple[float, Event]]]:
    """Errors of the ride with a fault in it, and what was said at which time."""
    frames = []
    for each in ride.frames:
        frame = SyncFrame()
        frame.CopyFrom(each)
        frames.append(frame)
    fault(during(frames, start_s, lasts_s))
    localiser = TramLocaliser(ride.simulation.vehicle)
    kept, said = [], []
    for number, frame in enumerate(frames):
        estimate = localiser.take(frame)
        said += [(time_s(frame.stamp_ns), event) for event in localiser.complaints()]
        if estimate is not None and number % 5 == 0:
            kept.append(estimate)
    return judged(ride.simulation, localiser, kept), said


def first_s(said: list[tuple[float, Event]], kind: object) -> float:
    return next((at_s for at_s, event in said if event.kind is kind), np.inf)


def worst_sigma(errors: Errors) -> float:
    """Largest horizontal error in terms of the larger deviation that is claimed."""
    claimed = np.sqrt(np.linalg.eigvalsh(errors.covariance[:, :2, :2])[:, 1])
    return float((errors.horizontal_m / claimed).max())


# The IMU ------------------------------------------------------------------------------------------
def stuck(frames: list[SyncFrame]) -> None:
    for frame in frames[1:]:
        for axis in AXES:
            setattr(frame.imu, axis, getattr(frames[0].imu, axis))


def dead(frames: list[SyncFrame]) -> None:
    for frame in frames:
        for axis in AXES:
            setattr(frame.imu, axis, 0.0)


def at(axis: str, value: float) -> Fault:
    def fault(frames: list[SyncFrame]) -> None:
        for frame in frames:
            setattr(frame.imu, axis, value)

    return fault


def absent(frames: list[SyncFrame]) -> None:
    for frame in frames:
        frame.ClearField("imu")


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize(
    "fault",
    [
        stuck,
        dead,
        at("gyro_z_radps", RANGE_RADPS),
        at("accel_x_mps2", RANGE_MPS2),
        at("accel_y_mps2", -RANGE_MPS2),
        at("gyro_z_radps", 0.0),
    ],
    ids=["stuck", "dead", "yaw at its end", "along at its end", "across at its end", "yaw dead"],
)
def test_imu_that_does_not_live_is_as_one_that_is_absent(fault: Fault, velocity: bool) -> None:
    ride = undisturbed(velocity)
    without, _ = gone(ride, absent)
    errors, said = gone(ride, fault)
    assert first_s(said, events.IMU_STUCK) < AT_S + 0.5
    assert AT_S + LASTS_S < first_s(said, events.IMU_LIVES) < AT_S + LASTS_S + 2.0
    later, others = errors.within(AT_S, 75.0), without.within(AT_S, 75.0)
    print(f"{later.horizontal_m.max():.2f} m, absent {others.horizontal_m.max():.2f} m")
    assert later.horizontal_m.max() < 1.5 * others.horizontal_m.max() + 0.5
    assert worst_sigma(later) < PROTECTION_SIGMA


def readings(rows: np.ndarray) -> list[int]:
    """What becomes of readings of the case."""
    inertial, C_vb = numbers(one(INERTIAL)), np.ascontiguousarray(C_vl(0.0, 0.0, 0.0).T)
    return [axes.take_reading(inertial, C_vb, *row, 0.01) for row in rows]


def living(count: int, step: float = 1e-4) -> np.ndarray:
    """Readings of a sensor that stands, in whole steps of its scale."""
    noise = np.random.default_rng(3).normal(0.0, 1e-3, (count, 6))
    return np.round((noise + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8])) / step) * step


def test_sensor_that_lives_is_never_stuck() -> None:
    assert set(readings(living(20_000))) == {axes.TAKEN}


def test_coarse_sensor_learns_how_long_it_repeats_itself() -> None:
    """Steps of two deviations: most readings repeat the one before."""
    became = np.array(readings(living(20_000, step=2e-3)))
    assert (became[5_000:] == axes.TAKEN).all()


def test_axis_that_is_not_measured_is_not_stuck() -> None:
    rows = living(500)
    rows[:, 3] = 0.0
    assert set(readings(rows)) == {axes.TAKEN}


def test_axis_that_stops_living_is_found_and_taken_back() -> None:
    rows = living(1_000)
    rows[300:500, 2] = rows[299, 2]
    became = np.array(readings(rows))
    limits = [300 + axes.STUCK_READINGS - 1, 500 + axes.ALIVE_READINGS - 1]
    changes = [k for k, (a, b) in enumerate(pairwise(became), 1) if a != b]
    assert changes == pytest.approx(limits, abs=3)


# Wheels -------------------------------------------------------------------------------------------
def freeze(*names: str) -> Fault:
    def fault(frames: list[SyncFrame]) -> None:
        last: dict[str, int] = {}
        for frame in frames:
            for reading in frame.odometry:
                for wheel in reading.wheels:
                    if not names or wheel.wheel in names:
                        wheel.pulses = last.setdefault(wheel.wheel, wheel.pulses)

    return fault


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("names", [(), ("left",)], ids=["both", "one"])
def test_wheels_that_freeze_at_speed_are_left_out(names: tuple[str, ...], velocity: bool) -> None:
    ride = undisturbed(velocity)
    errors, said = gone(ride, freeze(*names))
    plain, _ = gone(ride, lambda _: None)
    assert first_s(said, events.WHEEL_DEAD) < AT_S + 5.0
    assert AT_S + LASTS_S <= first_s(said, events.WHEEL_LIVES) < AT_S + LASTS_S + 5.0
    added = errors.within(AT_S, 75.0).horizontal_m.max() - plain.within(AT_S, 75).horizontal_m.max()
    print(f"frozen wheels add {added:.2f} m")
    assert added < 2.0
    assert worst_sigma(errors.within(AT_S, 75.0)) < PROTECTION_SIGMA


@pytest.mark.parametrize("velocity", [True, False])
def test_wheels_at_0_from_the_start_are_found_out_soon_after_the_departure(velocity: bool) -> None:
    ride = undisturbed(velocity)
    departure_s = ride.departure_s(1)
    errors, said = gone(ride, freeze(), -1.0, 100.0)
    found_s = first_s(said, events.WHEEL_DEAD)
    print(f"found {found_s - departure_s:.1f} s after the departure")
    assert found_s < departure_s + FAST_S + 5.0
    assert worst_sigma(errors.within(0.0, 75.0)) < PROTECTION_SIGMA
    assert errors.within(departure_s + 20.0, 75.0).horizontal_m.max() < 5.0


def test_wheels_that_freeze_at_a_stop_do_not_hold_the_vehicle_there() -> None:
    ride = undisturbed()
    errors, said = gone(ride, freeze(), ride.arrival_s(2) + 5.0, 100.0)
    departure_s = ride.departure_s(2)
    assert first_s(said, events.WHEELS_LIED) < departure_s + FAST_S + 5.0
    later = errors.within(departure_s + 12.0, 105.0)
    assert len(later.time_s) > 100
    assert later.horizontal_m.max() < 3.0


# Fixes --------------------------------------------------------------------------------------------
def freeze_fixes(frames: list[SyncFrame]) -> None:
    fixes = [fix for frame in frames for fix in frame.gnss]
    for fix in fixes[1:]:
        stamp_ns = fix.stamp_ns
        fix.CopyFrom(fixes[0])
        fix.stamp_ns = stamp_ns


@pytest.mark.parametrize("velocity", [True, False])
def test_fixes_that_freeze_at_speed_are_left_out(velocity: bool) -> None:
    ride = undisturbed(velocity)
    start_s = ride.departure_s(1) + 8.0
    errors, said = gone(ride, freeze_fixes, start_s, 12.0)
    assert first_s(said, events.FIXES_FROZEN) < start_s + 3.0
    assert all(at_s < start_s + 12.5 for at_s, each in said if each.kind is events.FIXES_FROZEN)
    assert worst_sigma(errors.within(start_s, 75.0)) < PROTECTION_SIGMA


def test_fixes_that_stay_while_the_vehicle_stands_are_not_frozen() -> None:
    ride = undisturbed()
    start_s = ride.arrival_s(2) + 1.0
    _, said = gone(ride, freeze_fixes, start_s, ride.departure_s(2) - start_s - 1.0)
    assert first_s(said, events.FIXES_FROZEN) == np.inf
