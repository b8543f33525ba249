"""An IMU that is mounted otherwise than configured: found out, left out, and the ride goes on.

Truth is the simulator's: the case is turned against what the vehicle's configuration says.
"""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np
import pytest
from rides import Errors, Ride, altered, judged, laid, ridden, time_s
from test_liveness import first_s
from test_tram_faults import DRIVER, PLAN, city
from test_tram_start import same

from tramstream.estimation.localiser import Estimate
from tramstream.events.kinds import Event
from tramstream.live import snapshots
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.mounting_witness import Judged
from tramstream.processors.tram_filter.events import MOUNTING_WRONG

GROSS = {"upside down": (180.0, 0.0, 0.0), "to the side": (0.0, 0.0, 90.0), "10°": (0.0, 0.0, 10.0)}
PROTECTION_SIGMA = 4.35
END_S = 105.0


@cache
def ride_of(turned_deg: tuple[float, float, float]) -> Ride:
    gnss = {"velocity": True, "rate_hz": 5.0}
    chosen = altered(city(), driver=DRIVER, gnss=gnss, imu={"misalignment_deg": turned_deg})
    return ridden(laid(PLAN + " | 300 |"), chosen, 2, END_S)


def gone(ride: Ride) -> tuple[Errors, list[tuple[float, Event]], TramLocaliser]:
    localiser, kept, said = TramLocaliser(ride.simulation.vehicle), [], []
    for number, frame in enumerate(ride.frames):
        estimate = localiser.take(frame)
        said += [(time_s(frame.stamp_ns), event) for event in localiser.complaints()]
        if estimate is not None and number % 5 == 0:
            kept.append(estimate)
    return judged(ride.simulation, localiser, kept), said, localiser


@pytest.mark.parametrize("how", GROSS)
def test_wrong_mounting_is_found_out_and_the_ride_goes_on_without_the_imu(how: str) -> None:
    ride = ride_of(GROSS[how])
    errors, said, _ = gone(ride)
    found_s = first_s(said, MOUNTING_WRONG)
    assert found_s < ride.departure_s(1) + 20.0
    assert [event.kind for _, event in said].count(MOUNTING_WRONG) == 1
    later = errors.within(max(found_s, ride.departure_s(1)) + 15.0, END_S)
    assert later.horizontal_m.max() < 5.0
    claimed = np.sqrt(np.linalg.eigvalsh(later.covariance[:, :2, :2])[:, 1])
    assert (later.horizontal_m < PROTECTION_SIGMA * claimed).all()


def test_gravity_tells_before_the_first_departure() -> None:
    ride = ride_of(GROSS["upside down"])
    assert first_s(gone(ride)[1], MOUNTING_WRONG) < ride.departure_s(1)


def test_mounting_within_what_the_filter_learns_is_found_right_and_costs_nothing_more() -> None:
    _, said, localiser = gone(ride_of((0.4, -0.7, 0.9)))
    assert localiser.memory.witness.judged is Judged.RIGHT
    assert first_s(said, MOUNTING_WRONG) == np.inf


def test_what_is_judged_outlasts_a_restart_bit_by_bit() -> None:
    ride = ride_of(GROSS["10°"])
    once, twice = (TramLocaliser(ride.simulation.vehicle) for _ in range(2))

    def pair(number: int) -> tuple[Estimate | None, Estimate | None]:
        return once.take(ride.frames[number]), twice.take(ride.frames[number])

    for number in range(len(ride.frames)):
        if number % 1200 == 700:
            state = snapshots.unpack(snapshots.pack(twice.snapshot()))
            twice = TramLocaliser(ride.simulation.vehicle)
            twice.restore(state)
        one, other = pair(number)
        assert same(one, other)
    assert once.memory.witness.judged is Judged.WRONG


def test_another_configuration_is_judged_anew() -> None:
    """Whoever has set the angles right gets his IMU back with the memory of the ride."""
    ride = ride_of(GROSS["to the side"])
    _, _, localiser = gone(ride)
    state = localiser.snapshot()
    vehicle = ride.simulation.vehicle
    assert vehicle.imu is not None
    roll, pitch, yaw = vehicle.imu.mounting_deg
    imu = msgspec.structs.replace(vehicle.imu, mounting_deg=(roll, pitch, yaw + 90.0))
    mended = TramLocaliser(msgspec.structs.replace(vehicle, imu=imu))
    mended.restore(state)
    assert mended.memory.witness.judged is Judged.OPEN
    mended.take(ride.frames[-1])
    assert mended._navigation is not None
    assert mended._navigation.readings.memory.out_ns == 0
