"""Wheels of the model `tram`: slips that begin at walking pace, and counters that come late."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from rides import Errors, Ride, altered, judged, reference, ridden, run

from tramstream.config import Vehicle, WheelConstant, Wheels
from tramstream.lines.line import built_in_line
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.wheel_path import WheelPath
from tramstream.processors.tram_sources.wheels import WheelPair
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.simulation.scenario import Slide, Slip

SEEDS = (1, 3)
STOP = 2
LATE_S = 0.012


def departing(seed: int, **changes: object) -> Ride:
    """Until half a minute after the departure from a stop."""
    chosen = altered(reference(), **changes)
    arrival_s = 54.0
    return ridden(built_in_line(), chosen, seed, arrival_s + 50.0)


def gone(ride: Ride) -> tuple[TramLocaliser, Errors]:
    localiser = TramLocaliser(ride.simulation.vehicle)
    return localiser, judged(ride.simulation, localiser, run(localiser, ride.frames))


@cache
def undisturbed(seed: int) -> Errors:
    return gone(departing(seed))[1]


def slips_of(localiser: TramLocaliser) -> int:
    navigation = localiser._navigation
    assert navigation is not None
    return navigation.wheels.slips


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("factor", [1.09, 1.4, 0.9])
def test_slip_at_walking_pace_is_no_slope(factor: float, seed: int) -> None:
    """From one second after the departure, at half a metre a second, for 1.4 s."""
    kind = Slip if factor > 1.0 else Slide
    departure_s = departing(seed).departure_s(STOP)
    slip = kind(start_s=departure_s + 1.0, duration_s=1.4, factor=factor)
    ride = departing(seed, events=(slip,))
    localiser, errors = gone(ride)
    after = errors.within(departure_s, departure_s + 30.0)
    assert slips_of(localiser) == 2  # each wheel once
    assert np.abs(after.speed_mps).max() < 0.08
    assert np.abs(after.within(departure_s + 8.0, departure_s + 30.0).speed_mps).max() < 0.03
    without = undisturbed(seed).within(departure_s, departure_s + 30.0)
    moved = (after.p_l - without.p_l)[:, :2]
    assert np.hypot(moved[:, 0], moved[:, 1]).max() < 0.3


@pytest.mark.parametrize("seed", SEEDS)
def test_wheels_with_a_late_counter_are_believed_after_a_slide_at_speed(seed: int) -> None:
    late = {"timing": {"stamp_offset_s": LATE_S}}
    departure_s = departing(seed).departure_s(STOP)
    slide = Slide(start_s=departure_s + 14.0, duration_s=2.0, factor=0.3)
    ride = departing(seed, events=(slide,), wheels=late)
    localiser, errors = gone(ride)
    assert slips_of(localiser) == 2
    after = errors.within(departure_s + 14.0, departure_s + 30.0)
    assert np.abs(after.speed_mps).max() < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_path_that_is_counted_anew_holds_what_the_counter_has_not_shown(sign: float) -> None:
    ekf = TramFilter(Vehicle(vehicle="none", wheels=Wheels()), 9.81)
    ekf.P = np.diag(np.full(len(Ix), 1e-4))
    ekf.set_wheel_sign(1, sign)
    x = ekf.state
    x[Ix.SPEED], x[Ix.WHEEL_DELAY], x[Ix.SCALE_B] = 10.0, 0.01, 0.02
    ekf.restart_path(1, 1e-6)
    assert ekf.state[Ix.PATH_B] == pytest.approx(sign * 0.102)
    assert ekf.expected_path(1) == pytest.approx(0.0, abs=1e-12)
    assert ekf.P[Ix.PATH_B, Ix.PATH_B] == pytest.approx(1e-6 + (10.0**2 + 0.01**2) * 1e-4)
    (verdict,) = ekf.apply(WheelPath(1, 0.0, 1e-6))
    assert verdict.innovation == pytest.approx(0.0, abs=1e-12)


def test_wheel_whose_constant_is_known_begins_with_it() -> None:
    each = {"right": WheelConstant(m_per_pulse=0.00092, scale_std=0.0002)}
    vehicle = Vehicle(vehicle="none", wheels=Wheels(m_per_pulse=0.00094, each=each))
    ekf = TramFilter(vehicle, 9.81)
    ekf.P = np.diag(np.full(len(Ix), 1e-4)) + 1e-6
    reading = Odometry(wheels=[WheelReading(wheel=name, pulses=0) for name in ("left", "right")])
    WheelPair(vehicle).assign(reading, ekf)
    assert ekf.state[Ix.SCALE_A] == 0.0
    assert ekf.P[Ix.SCALE_A, Ix.SCALE_A] == pytest.approx(1.01e-4)
    # Counted in the way of a pulse that all have, this wheel shows 94/92 of its path.
    assert ekf.state[Ix.SCALE_B] == pytest.approx(0.94 / 0.92 - 1.0)
    assert ekf.P[Ix.SCALE_B, Ix.SCALE_B] == pytest.approx(0.0002**2)
    assert np.count_nonzero(ekf.P[Ix.SCALE_B]) == 1
    assert np.count_nonzero(ekf.P[:, Ix.SCALE_B]) == 1


def test_ride_keeps_the_wheels_constants_that_it_was_told() -> None:
    radius_error_m = (0.006, -0.006)  # 2 % apart, and the filter is sure to a fiftieth of that
    ride = departing(1, wheels={"axle": {"radius_error_m": radius_error_m}})
    wheels = ride.simulation.vehicle.wheels
    radius_m = reference().wheels.axle.radius_m
    each = {
        name: WheelConstant(
            m_per_pulse=wheels.m_per_pulse * (1 + error_m / radius_m), scale_std=0.0004
        )
        for name, error_m in zip(("left", "right"), radius_error_m, strict=True)
    }
    vehicle = replace(ride.simulation.vehicle, wheels=replace(wheels, each=each))
    told = TramLocaliser(vehicle)
    errors = judged(ride.simulation, told, run(told, ride.frames))
    navigation = told._navigation
    assert navigation is not None
    scale = navigation.ekf.x[[Ix.SCALE_A, Ix.SCALE_B], 0]
    true = 1 / (1 + np.array(radius_error_m) / radius_m) - 1
    np.testing.assert_allclose(scale, true, atol=0.0008)
    variance = np.diag(navigation.ekf.P)[[Ix.SCALE_A, Ix.SCALE_B]]
    assert np.all(variance < 0.0004**2)  # also where the filter has gone back to a departure
    _, untold = gone(ride)
    late = slice(-800, None)
    known, learned = (np.sqrt(np.mean(e.speed_mps[late] ** 2)) for e in (errors, untold))
    assert known < 0.5 * learned
