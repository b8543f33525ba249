"""Where a vehicle stands that has not moved yet: fixes jump, and walk, the first ones too."""

from __future__ import annotations

import math

import pytest
from rides import Errors, Ride, altered, judged, laid, localised, ridden, run
from seeds import seeds
from test_tram_faults import PLAN, city

from tramstream.clock import S
from tramstream.estimation.localiser import HEADING_UNKNOWN
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram_sources.first_place import FirstPlace, FirstPlaceMemory
from tramstream.simulation.scenario import GnssJump

TAU_S, STD_M = 20.0, 0.5
SEEDS = seeds(2, of=3)
LEVER_M = 3.1
"""How far the antenna is from the origin, at most, where the heading is not known."""
PLACE_M = 2.5
"""Of fixes of 0.5 m an axis: 5 σ."""


def taken(places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Places that were believed one after another, of fixes at 1 Hz."""
    first = FirstPlace(TAU_S, FirstPlaceMemory())
    found = [first.take(k * S, *place, STD_M) for k, place in enumerate(places, 1)]
    return [places[0], *(place for place in found if place is not None)]


def test_first_fix_is_believed_where_none_jumps() -> None:
    """What walks off by half a metre a second is no jump, and no mean is taken."""
    assert taken([(0.5 * k, -0.3 * k) for k in range(40)]) == [(0.0, 0.0)]


@pytest.mark.parametrize("jumped", [1, 3, 8])
def test_first_fixes_that_have_jumped_are_overruled_by_as_many_and_one(jumped: int) -> None:
    places = [(50.0, 0.0)] * jumped + [(0.1, 0.2)] * 20
    assert taken(places) == [(50.0, 0.0), (0.1, 0.2)]
    assert taken(places[: 2 * jumped - 1]) == [(50.0, 0.0)]


def test_jump_that_ends_gives_the_first_place_back() -> None:
    """Three seconds, eight elsewhere, and back: it is believed while it is the longest."""
    places = [(0.0, 0.0)] * 3 + [(15.0, 0.0)] * 8 + [(0.2, 0.0)] * 20
    assert taken(places) == [(0.0, 0.0), (15.0, 0.0), (0.0, 0.0)]


def test_jumps_that_are_shorter_do_not_move_it() -> None:
    places = [(0.0, 0.0)] * 10 + [(0.0, 15.0)] * 8 + [(0.0, 0.1)] * 8 + [(9.0, 9.0)] * 8
    assert taken(places) == [(0.0, 0.0)]


def test_memory_stays_small() -> None:
    memory = FirstPlaceMemory()
    first = FirstPlace(TAU_S, memory)
    for k in range(200):
        first.take(k * S, 100.0 * k, 0.0, STD_M)
    assert len(memory.levels) <= 8


# The ride -----------------------------------------------------------------------------------------
def jumping(seed: int, start_s: float, duration_s: float) -> tuple[Ride, Errors]:
    """A ride whose fixes jump by 15 m about its first departure, and have velocities."""
    jump = GnssJump(start_s=start_s, duration_s=duration_s, east_m=9.0, north_m=-12.0)
    gnss = {"velocity": True, "rate_hz": 5.0, "lever_arm_m": (3.0, 0.0, 3.2)}
    chosen = altered(city(events=(jump,)), driver={"first_dwell_s": 25.0}, gnss=gnss)
    ride = ridden(laid(PLAN), chosen, seed, 50.0)
    return ride, localised(ride)


@pytest.mark.parametrize(("start_s", "duration_s"), [(0.0, 8.0), (3.0, 8.0), (22.0, 10.0)])
@pytest.mark.parametrize("seed", SEEDS)
def test_jump_around_the_first_departure_is_not_followed(
    seed: int, start_s: float, duration_s: float
) -> None:
    ride, errors = jumping(seed, start_s, duration_s)
    departure_s = ride.departure_s(1)
    seeking = errors.within(departure_s - 2.0, 50.0)
    unknown = seeking.mode == HEADING_UNKNOWN
    assert unknown.any()
    assert seeking.horizontal_m[unknown].max() < LEVER_M + PLACE_M
    assert seeking.horizontal_m[~unknown].max() < PLACE_M


@pytest.mark.parametrize("seed", SEEDS)
def test_claim_does_not_go_up_and_down_between_fixes_of_a_second(seed: int) -> None:
    """From the departure until the heading is known, with a receiver of 1 Hz."""
    chosen = altered(city(), gnss={"velocity": True})
    ride = ridden(laid(PLAN), chosen, seed, 25.0)
    localiser = TramLocaliser(ride.simulation.vehicle)
    errors = judged(ride.simulation, localiser, run(localiser, ride.frames, 1))
    departed = errors.within(ride.departure_s(1) + 0.5, math.inf)
    seeking = departed.covariance[departed.mode == HEADING_UNKNOWN][:, 0, 0] ** 0.5
    assert len(seeking) > 100
    assert seeking.max() < 1.5 * seeking.min()
