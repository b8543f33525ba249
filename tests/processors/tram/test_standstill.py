"""Standing or not: wheels, shaking and fixes in every combination that deceives one of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rides import Array, Ride, judged, laid, localised, ridden, run, time_s
from seeds import seeds
from test_tram_faults import city
from test_tram_start import LINE, copies, plain

from tramstream.clock import S
from tramstream.live import snapshots
from tramstream.memory.stage import from_plain, to_plain
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.standstill import FAST_S, LOCKED_MPS, WHEELS_STILL_S, Standstill
from tramstream.processors.tram_filter.events import WHEEL_DEAD
from tramstream.processors.tram_model.records import READING_NUMBERS
from tramstream.proto.sync_pb2 import SyncFrame

SEEDS = seeds(1, of=3)
START_NS = 1_700_000_000 * S
STEP_S = 0.01
GRAVITY = 9.81
IDLING_RADPS = math.radians(2.35)
"""Amplitude on the y gyroscope of a car that idles, as a real drive has it (docs/accuracy.md)."""
IDLING_HZ = 13.0
SETTLED_S = 1.5


class Drive:
    """A `Standstill` and the sensors around it; everything is 0 unless told."""

    def __init__(self, seed: int = 1, imu: bool = True, wheels: bool = True) -> None:
        self.standstill = Standstill()
        self.time_s = 0.0
        self.steps = 0
        self.imu, self.wheels = imu, wheels
        self.rng = np.random.default_rng(seed)
        self.shaking = 0.0
        """Amplitude of the y gyroscope, rad/s; the forces shake with it."""

    def reading(self) -> Array:
        u = np.zeros(READING_NUMBERS)
        phase = math.tau * IDLING_HZ * self.time_s
        u[:3] = self.rng.normal(0.0, 1e-3, 3)
        u[3:6] = self.rng.normal(0.0, 2e-3, 3)
        u[1] += self.shaking * math.sin(phase)
        u[3:6] += 3.0 * self.shaking * np.sin(phase + np.arange(3))
        u[5] += GRAVITY
        return u

    def go(
        self,
        duration_s: float,
        turns: bool = False,
        gnss_mps: float | None = None,
        speed_mps: float = math.nan,
        speed_std_mps: float = 0.05,
        push_mps2: float = 0.0,
    ) -> list[bool]:
        said = []
        for _ in range(round(duration_s / STEP_S)):
            self.steps += 1
            self.time_s = self.steps * STEP_S
            stamp_ns = START_NS + round(self.time_s * S)
            if self.wheels and self.steps % 2 == 0:
                self.standstill.wheels(stamp_ns, turns)
            if gnss_mps is not None and self.steps % 20 == 0:
                self.standstill.speed_over_ground(stamp_ns, gnss_mps)
            u = None
            if self.imu:
                u = self.reading()
                u[3] += push_mps2
            said.append(self.standstill.step(stamp_ns, u, STEP_S, speed_mps, speed_std_mps**2, 0.0))
        return said

    def settled(self, said: list[bool], settled_s: float = SETTLED_S) -> set[bool]:
        return set(said[round(settled_s / STEP_S) :])


# Wheels -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("imu", [True, False])
@pytest.mark.parametrize("speed_mps", [math.nan, 0.0, 0.3])
def test_wheels_that_do_not_turn_stand(imu: bool, speed_mps: float) -> None:
    drive = Drive(imu=imu)
    assert drive.settled(drive.go(5.0, speed_mps=speed_mps), WHEELS_STILL_S + 0.1) == {True}


def test_one_turn_is_enough_to_move() -> None:
    drive = Drive()
    drive.go(5.0)
    assert set(drive.go(1.0, turns=True)[2:]) == {False}


@pytest.mark.parametrize("shaking", [IDLING_RADPS, 3.0 * IDLING_RADPS])
@pytest.mark.parametrize("seed", SEEDS)
def test_idling_is_not_motion(seed: int, shaking: float) -> None:
    drive = Drive(seed)
    drive.go(10.0, turns=True, gnss_mps=8.0, speed_mps=8.0)
    drive.shaking = shaking
    assert drive.settled(drive.go(20.0, gnss_mps=0.05, speed_mps=0.02)) == {True}
    amplitude = drive.standstill.noise[1]
    assert amplitude == pytest.approx(0.5 * shaking**2, rel=0.3)


def test_stuck_counter_while_gnss_is_fast_is_motion() -> None:
    drive = Drive()
    drive.go(10.0, turns=True, gnss_mps=8.0)
    said = drive.go(20.0, turns=False, gnss_mps=8.0)
    assert set(said) == {False}


def test_counter_stuck_from_the_beginning_is_found_out() -> None:
    drive = Drive()
    drive.go(10.0, gnss_mps=0.0)
    said = drive.go(20.0, gnss_mps=8.0)
    assert drive.settled(said, FAST_S + 0.5) == {False}


def test_fixes_that_jump_do_not_set_it_going() -> None:
    drive = Drive()
    drive.go(10.0, gnss_mps=0.0)
    assert set(drive.go(FAST_S - 0.5, gnss_mps=20.0)) == {True}
    assert set(drive.go(5.0, gnss_mps=0.0)) == {True}


@pytest.mark.parametrize("speed_mps", [8.0, -8.0, LOCKED_MPS + 0.3])
def test_wheel_that_slides_at_speed_is_not_standing(speed_mps: float) -> None:
    drive = Drive()
    drive.go(5.0, turns=True, speed_mps=speed_mps)
    assert set(drive.go(5.0, turns=False, speed_mps=speed_mps)) == {False}


def test_speed_that_nobody_is_sure_of_does_not_overrule_wheels() -> None:
    drive = Drive()
    drive.go(5.0, turns=True, speed_mps=3.0, speed_std_mps=2.0)
    said = drive.go(5.0, turns=False, speed_mps=3.0, speed_std_mps=2.0)
    assert drive.settled(said) == {True}


# Without wheels -----------------------------------------------------------------------------------
@pytest.mark.parametrize("idling", [0.0, IDLING_RADPS])
@pytest.mark.parametrize("seed", SEEDS)
def test_without_wheels_shaking_is_compared_with_that_of_the_ride(seed: int, idling: float) -> None:
    drive = Drive(seed, wheels=False)
    for _ in range(3):  # what it shakes by is learned
        drive.shaking = idling
        stood = drive.go(20.0, gnss_mps=0.05, speed_mps=0.05)
        drive.shaking = max(4.0 * idling, math.radians(1.0))
        ran = drive.go(20.0, gnss_mps=8.0, speed_mps=8.0, push_mps2=0.5)
    assert drive.settled(stood, 6.0) == {True}
    assert drive.settled(ran, 0.5) == {False}
    # Now without fixes: the shaking alone tells, though the speed has drifted.
    drive.shaking = idling
    assert drive.settled(drive.go(20.0, speed_mps=0.8), 6.0) == {True}


def test_without_wheels_a_push_sets_it_going_before_gnss_does() -> None:
    drive = Drive(wheels=False)
    assert drive.settled(drive.go(20.0, gnss_mps=0.05, speed_mps=0.02)) == {True}
    said = drive.go(1.0, gnss_mps=0.05, speed_mps=0.02, push_mps2=0.6)
    assert not said[-1]


def test_without_anything_but_time_it_does_not_stand() -> None:
    drive = Drive(imu=False, wheels=False)
    assert set(drive.go(5.0)) == {False}


def test_pause_of_the_readings_is_no_standing() -> None:
    drive = Drive(wheels=False)
    assert drive.go(5.0, speed_mps=0.0)[-1]
    drive.steps += round(10.0 / STEP_S)
    assert not drive.go(STEP_S, speed_mps=0.0)[0]


def test_memory_comes_back() -> None:
    one, other = Drive(3), Drive(3)
    for drive in (one, other):
        drive.shaking = IDLING_RADPS
        drive.go(5.0, turns=True, gnss_mps=5.0, speed_mps=5.0)
    state = to_plain(other.standstill)
    other.standstill = from_plain(Standstill, snapshots.unpack(snapshots.pack(state)))
    for drive in (one, other):
        drive.go(5.0, gnss_mps=0.1, speed_mps=0.1)
    a, b = to_plain(one.standstill), to_plain(other.standstill)
    assert snapshots.pack(a) == snapshots.pack(b)
    assert state["since_ns"] != a["since_ns"]  # what was handed out has not gone on


# In the filter ------------------------------------------------------------------------------------
def shaken(ride: Ride, seed: int) -> list[SyncFrame]:
    """The case shakes at stops as that of an idling car."""
    changed = copies(ride.frames)
    stamps = np.array([frame.stamp_ns for frame in changed])
    stands = ride.simulation.truth(stamps).motion.standing
    phase = np.random.default_rng(seed).uniform(0.0, math.tau)
    for frame, standing in zip(changed, stands, strict=True):
        if standing:
            swing = math.sin(math.tau * IDLING_HZ * time_s(frame.stamp_ns) + phase)
            frame.imu.gyro_y_radps += IDLING_RADPS * swing
            frame.imu.accel_x_mps2 += 0.1 * swing
    return changed


@pytest.mark.parametrize("seed", SEEDS)
def test_idling_vehicle_stands_where_it_is(seed: int) -> None:
    ride = plain(seed)
    errors = localised(ride, shaken(ride, seed))
    begin_s, end_s = ride.arrival_s(2) + 1.0, ride.departure_s(2)
    standing = errors.within(begin_s, end_s)
    assert standing.standing.all()
    assert np.abs(standing.estimate_l[:, :2] - standing.estimate_l[0, :2]).max() < 0.1
    assert np.ptp(standing.yaw_rad) < 0.002
    assert not errors.within(end_s + 1.0, 100.0).standing.any()
    quiet = localised(ride)
    added = errors.horizontal_m - quiet.horizontal_m
    assert added[errors.time_s > 20.0].max() < 0.3


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_counters_that_stick_on_the_way_do_not_stop_the_vehicle(seed: int, velocity: bool) -> None:
    ride = ridden(laid(LINE), city(gnss={"velocity": velocity}), seed, 60.0)
    frames = copies(ride.frames)
    stuck: dict[str, int] = {}
    for frame in frames:
        for reading in frame.odometry:
            for wheel in reading.wheels:
                if time_s(frame.stamp_ns) > 36.0:
                    wheel.pulses = stuck.setdefault(wheel.wheel, wheel.pulses)
    localiser = TramLocaliser(ride.simulation.vehicle)
    errors = judged(ride.simulation, localiser, run(localiser, frames)).within(36.0, 55.0)
    assert not errors.standing.any()
    assert errors.horizontal_m.max() < 3.0
    assert np.abs(errors.speed_mps).max() < 0.7
    assert WHEEL_DEAD in [event.kind for event in localiser.complaints()]
