"""A receiver alone, on a car in streets: no IMU, no wheels, no velocity; and one that holds on.

Truth is the simulator's; errors of the fixes have 0.5 m on each axis and last 20 s.
"""

from __future__ import annotations

import math
from functools import cache

import msgspec
import numpy as np
import pytest
from rides import Errors, Ride, altered, judged, laid, localised, reference, ridden, run, time_s
from seeds import seeds
from test_tram_start import copies

from tramstream.estimation.localiser import HEADING_UNKNOWN
from tramstream.processors.tram.localiser import TramLocaliser

SEEDS = seeds(2, of=3)
STREETS = "| 120 L12/90 80 R10/90 150 R10/90 60 L15/90 200 | 100 L10/90 120 R12/90 90 |"
"""Corners of 10 to 15 m, and a stop."""
CAR = {
    "speed_mps": 12.0,
    "acceleration_mps2": 1.8,
    "jerk_mps3": 1.5,
    "lateral_mps2": 2.5,
    "dwell_s": 20.0,
    "first_dwell_s": 20.0,
}


@cache
def car(seed: int) -> Ride:
    """A ride of a vehicle that has nothing but its receiver."""
    ride = ridden(laid(STREETS), altered(reference(), driver=CAR), seed)
    for frame in ride.frames:
        for field in ("imu", "ahead", "odometry"):
            frame.ClearField(field)
    simulation = ride.simulation
    simulation.vehicle = msgspec.structs.replace(simulation.vehicle, imu=None, odometer=None)
    return ride


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))


@pytest.mark.parametrize("seed", SEEDS)
def test_it_goes_where_its_fixes_go(seed: int) -> None:
    """Through every corner, from the first fix on; a receiver that errs by 0.7 m allows 1 m."""
    errors = localised(car(seed))
    assert rms(errors.horizontal_m) < 1.0
    assert errors.horizontal_m.max() < 7.0  # in a corner, a second after the last fix
    known = errors.within(35.0, math.inf)
    assert (known.mode != HEADING_UNKNOWN).all()
    claimed = np.trace(known.covariance[:, :2, :2], axis1=1, axis2=2)
    assert 0.05 < np.mean(known.horizontal_m**2) / np.mean(claimed) < 2.0


@pytest.mark.parametrize("seed", SEEDS)
def test_stop_does_not_turn_it(seed: int) -> None:
    ride = car(seed)
    errors = localised(ride)
    before = errors.at(ride.arrival_s(2) - 4.0).yaw_rad[0]
    after = errors.at(ride.departure_s(2)).yaw_rad[0]
    assert abs(math.remainder(after - before, math.tau)) < 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_one_fix_that_jumps_takes_it_along_for_no_more_than_two(seed: int) -> None:
    """Nobody else can tell; but no car leaps by 60 m in a second."""
    ride = car(seed)
    frames = copies(ride.between(-1.0, 60.0))
    fixes = [fix for frame in frames for fix in frame.gnss if time_s(fix.stamp_ns) > 40.0]
    fixes[0].latitude_deg += math.degrees(60.0 / 6.37e6)
    errors = localised(ride, frames)
    assert errors.within(44.5, 60.0).horizontal_m.max() < 5.0


# Static hold --------------------------------------------------------------------------------------
def held(ride: Ride) -> Errors:
    """The ride with a receiver that says of every fix that it does not move."""
    for frame in ride.frames:
        for fix in frame.gnss:
            fix.vel_e_mps = fix.vel_n_mps = fix.speed_mps = 0.0
    localiser = TramLocaliser(ride.simulation.vehicle)
    return judged(ride.simulation, localiser, run(localiser, ride.frames))


def test_receiver_that_says_that_it_does_not_move_stops_nobody() -> None:
    """Whoever moves is measured to move by some millimetres a second at least."""
    chosen = altered(reference(), driver=CAR | {"lateral_mps2": 1.0}, gnss={"velocity": True})
    errors = held(ridden(laid(STREETS), chosen, 1, 60.0)).within(30.0, 60.0)
    assert np.abs(errors.speed_mps).max() < 0.2
    assert errors.horizontal_m.max() < 3.0
