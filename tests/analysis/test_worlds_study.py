"""The study of worlds: what is true, what is told, what counts as said, sums, and a short ride."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from tramstream.analysis.evaluate.errors import errors
from tramstream.analysis.studies.states import SaidStates, truth_at
from tramstream.analysis.worlds import study, sums
from tramstream.analysis.worlds.moments import at_speed_s, corners_s
from tramstream.analysis.worlds.study import Case, Figures, Raised
from tramstream.analysis.worlds.table import TODAY, WORLDS, World, changed, world_of
from tramstream.simulation.vehicle import configuration

LONG_S = 300.0


def case(world: str, **fields: Any) -> Case:
    return Case(**{"world": world, "duration_s": LONG_S, **fields})


def figures(world: str = TODAY, **fields: Any) -> Figures:
    values: dict[str, Any] = {
        "case": case(world),
        "with_map": False,
        "duration_s": LONG_S,
        "states": 1000,
        "p50_m": 0.5,
        "p90_m": 1.0,
        "moving_p90_m": 1.0,
        "rms_m": 0.6,
        "max_m": 3.0,
        "max_at_s": 10.0,
        "nees": 2.0,
        "beyond_share": 0.0,
        "protection_m": 4.0,
        "heading_rms_deg": 0.1,
        "right_track_share": None,
        "fault_s": None,
        "raised": (),
    }
    return Figures(**{**values, **fields})


# What is true and what is told --------------------------------------------------------------------
def test_names_of_worlds_are_their_own_and_the_first_is_todays() -> None:
    names = [world.name for world in WORLDS]
    assert names[0] == TODAY
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: world.name)
def test_operator_is_told_of_nothing_that_is_not_in_the_table(world: World) -> None:
    vehicle = study.told(world)
    usual = configuration(study.base())
    if not world.told:
        assert vehicle == usual
    else:
        assert vehicle != usual
    simulation = study.simulation_of(case(world.name))
    shared = simulation.duration_s
    assert shared == min(LONG_S, world.duration_s or LONG_S)
    if world.wanted.said_s is not None:
        begins_s = study.fault_s(case(world.name), simulation)
        assert begins_s is not None
        assert begins_s < shared - world.wanted.said_s


def test_world_as_today_is_the_scenario_but_for_the_rate_of_its_imu() -> None:
    chosen, base = study.simulation_of(case(TODAY)).scenario, study.base()
    assert chosen == base
    assert base.imu is not None
    assert (base.imu.rate_hz, base.imu.batch) == (study.RATE_HZ, study.BATCH)


def test_changes_reach_into_sections_and_leave_the_rest() -> None:
    base = study.base()
    made = changed(base, {"gnss": {"errors": {"decay": 0.5}}, "imu": None})
    assert made.imu is None
    assert made.gnss is not None
    assert base.gnss is not None
    assert made.gnss.errors == replace(base.gnss.errors, decay=0.5)
    assert made.wheels == base.wheels


def test_faults_begin_at_speed_and_gaps_in_corners() -> None:
    simulation = study.simulation_of(case(TODAY))
    ride = simulation.ride
    begins_s = at_speed_s(ride, LONG_S)
    speed = ride.motion(begins_s + np.arange(0.0, 10.0, 0.5)).speed_mps
    assert begins_s >= 0.4 * LONG_S
    assert (np.abs(speed) > 5.9).all()
    corners = corners_s(ride, LONG_S)
    assert corners
    bent = ride.line.curvature_per_m(ride.motion(np.array(corners)).arc_length_m)
    assert (np.abs(bent) > 1 / 60.0).all()


# What counts as said ------------------------------------------------------------------------------
REFUSED, STUCK = ("ekf", "tram.fix_refused", ("GNSS",)), ("ekf", "imu.stuck", ())


def raised(*rows: tuple[float, tuple[str, str, tuple[str, ...]]]) -> tuple[Raised, ...]:
    return tuple(Raised(time_s, *what) for time_s, what in rows)


def test_fault_is_said_by_the_first_event_that_today_has_not() -> None:
    ride = figures(
        "IMU stuck", fault_s=100.0, raised=raised((90.0, STUCK), (101.0, REFUSED), (104.0, STUCK))
    )
    same = raised((80.0, STUCK), (100.5, REFUSED))
    found = study.said(ride, same)
    assert found is not None
    assert (found.time_s, found.kind) == (104.0, "imu.stuck")
    later = study.said(ride, raised((102.0, REFUSED)))
    assert later is not None
    assert later.time_s == 101.0
    assert study.said(ride._replace(raised=ride.raised[:1]), same) is None
    assert study.said(ride._replace(fault_s=None), ()) is None


# Sums ---------------------------------------------------------------------------------------------
def test_ratio_is_that_of_the_same_rides_and_times_are_after_the_fault() -> None:
    rides = [
        figures(case=case(world, seed=seed), moving_p90_m=p90, fault_s=fault_s, raised=said)
        for world, seed, p90, fault_s, said in (
            (TODAY, 1, 1.0, None, ()),
            (TODAY, 2, 2.0, None, ()),
            ("IMU stuck", 1, 3.0, 100.0, raised((103.0, STUCK))),
            ("IMU stuck", 2, 2.0, 110.0, ()),
        )
    ]
    today, stuck = sums.sums(rides)
    assert (today.world, today.ratio, today.said_s) == (TODAY, 1.0, None)
    assert stuck.ratio == pytest.approx((3.0 / 1.0 + 2.0 / 2.0) / 2)
    assert stuck.said_s == (3.0, None)
    assert stuck.said_by == ("imu.stuck",)
    assert set(stuck.failed) == {"P90", "said"}


def test_worlds_that_nobody_sensible_meets_are_held_to_less() -> None:
    spoofed = figures("spoofed jump", moving_p90_m=100.0, nees=500.0, fault_s=150.0)
    frozen = figures("frozen fixes", moving_p90_m=100.0, nees=500.0, fault_s=150.0)
    found = {each.world: set(each.failed) for each in sums.sums([figures(), spoofed, frozen])}
    assert found == {
        TODAY: set(),
        "spoofed jump": {"said"},
        "frozen fixes": {"P90", "NEES", "said"},
    }
    assert sums.all_beyond_share([figures(beyond_share=0.02), spoofed], False) == 0.02
    assert sums.all_beyond_share([spoofed], True) is None


def test_world_near_its_bound_need_not_be_near_todays() -> None:
    near, far = (
        figures("slow fix errors", moving_p90_m=2.2, bound_p90_m=least) for least in (2.0, 1.5)
    )
    today = figures()
    (_, held), (_, lost) = sums.sums([today, near]), sums.sums([today, far])
    assert held.over_bound == pytest.approx(1.1)
    assert held.failed == ()
    assert lost.over_bound == pytest.approx(2.2 / 1.5)
    assert lost.failed == ("P90",)
    assert sums.sums([today])[0].over_bound is None


def test_bound_of_slow_errors_is_what_nobody_can_see_of_them() -> None:
    """Errors of ten minutes are all there in two: P90 of 1 m per axis is √(2 ln 10) = 2.15 m."""
    slow, honest = (
        study.bound_p90_m(study.simulation_of(case(world, duration_s=120.0)))
        for world in ("slow fix errors", "honest receiver")
    )
    assert slow is not None
    assert honest is not None
    assert 1.9 < slow < 2.15
    assert honest < 0.8 * slow
    before = study.simulation_of(case("honest receiver", duration_s=10.0))
    assert study.bound_p90_m(before) is None


def test_without_todays_rides_there_is_no_ratio() -> None:
    (only,) = sums.sums([figures("static hold")])
    assert math.isnan(only.ratio)


# A ride -------------------------------------------------------------------------------------------
def test_short_ride_is_judged_and_is_the_same_again() -> None:
    chosen = case("first departure", duration_s=50.0)
    first, second = study.study(chosen), study.study(chosen)
    (ride,) = first
    assert first == second
    assert not ride.with_map
    assert ride.duration_s == 50.0
    assert ride.states > 300
    assert 0.0 < ride.p50_m <= ride.p90_m <= ride.max_m < 30.0
    assert ride.beyond_share is not None
    assert ride.right_track_share is None


def test_every_name_is_found_and_no_other() -> None:
    assert all(world_of(world.name) is world for world in WORLDS)
    assert world_of("sunshine") is None


def test_ride_without_inertial_data_is_judged_ten_times_a_second_as_well() -> None:
    (ride,) = study.study(case("position-only receiver", duration_s=20.0))
    assert ride.states > 150
    assert ride.p90_m < 20.0


def test_filter_that_says_nothing_has_no_figures() -> None:
    simulation = study.simulation_of(case(TODAY, duration_s=5.0))
    known = SaidStates("tram").states(simulation.line.level)
    assert len(known) == 0
    judged = errors(known, truth_at(simulation, known.stamp_ns))
    assert all(math.isnan(value) for value in study._errors(judged).values())
    assert math.isnan(study._nees(judged))
