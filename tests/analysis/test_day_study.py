"""The study of a day: its way, its halts, and that nothing grows on a short one."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from networks import PARALLEL_M, Made, after, curved, laid, left_of, made, straight

from tramstream import config
from tramstream.analysis.worlds import day as study
from tramstream.analysis.worlds import day_way
from tramstream.analysis.worlds.day import Case, Part, Setting
from tramstream.analysis.worlds.study import base
from tramstream.errors import ConfigError
from tramstream.graph import Graph
from tramstream.processors.resampling.resampler import Resampler
from tramstream.simulation.event_kinds import GnssRateLost, ImuLost
from tramstream.simulation.ride import Ride
from tramstream.simulation.simulation import Simulation
from tramstream.simulation.speed_plan import Break, Limits
from tramstream.simulation.track_rides import MapError, Route, lay
from tramstream.tracks.network import LineStop, RouteLine

RNG = np.random.default_rng


@cache
def ring() -> Made:
    """Two tracks of 2 km that lead into each other, a shorter way, and storage beside the first."""
    there = laid(straight(2000.0))
    stored = {
        f"storage {number}": laid(straight(100.0), left_of(there, number * PARALLEL_M))
        for number in range(1, 7)
    }
    lines = {"there": there, "back": after(there, straight(2000.0)), **stored}
    lines |= {"detour": after(there, straight(500.0))}
    joins = [("there", "back"), ("back", "there"), ("there", "detour"), ("detour", "there")]
    joins += [pair for name in stored for pair in ((name, "there"), ("back", name))]
    return made(lines, joins)


def line(name: str) -> RouteLine:
    stops = tuple(LineStop(f"{name} {m}", float(m)) for m in range(0, 1900, 140))
    return RouteLine("1", name, "", "", (ring().run(name),), 50.0, 1900.0, stops)


def planned(rounds: int = 2, day_s: float = 8000.0) -> day_way.Day:
    lines = (line("there"), line("back"))
    return day_way.day(ring().network, lines, rounds, day_s, RNG(1))


# The way ------------------------------------------------------------------------------------------
def test_way_is_the_shortest_legal_one() -> None:
    there, back, detour = (ring().run(name) for name in ("there", "back", "detour"))
    assert day_way.way(ring().network, there, there) == (0.0, (there,))
    length_m, runs = day_way.way(ring().network, back, detour)
    assert runs == (back, there, detour)
    assert length_m == pytest.approx(2500.0, abs=0.1)
    with pytest.raises(ConfigError, match="no legal way"):
        day_way.way(ring().network, there, there ^ 1)


def test_storage_lies_among_other_tracks() -> None:
    run = day_way.storage(ring().network, ring().run("there"))
    assert list(ring().lines)[run >> 1].startswith("storage")
    with pytest.raises(ConfigError, match="no storage track"):
        day_way.storage(curved().network, 0)


def test_day_goes_out_of_storage_over_its_rounds_and_back() -> None:
    names = list(ring().lines)
    gone = [names[run >> 1] for run in planned().route.runs]
    assert gone[0] == gone[-1]
    assert gone[1:-1] == ["there", "back", "there", "back"]
    stops_m = planned().route.stops_m
    assert stops_m[0] == 0.0
    assert stops_m[1] == pytest.approx(100.0 - day_way.BEGIN_M + 50.0, abs=0.1)
    assert len(stops_m) == 2 + 4 * len(line("there").stops)


def test_breaks_are_at_termini_and_turns_on_the_second_line() -> None:
    day, count = planned(), len(line("there").stops)
    assert day.turns_back == (1 + count + 12, 1 + count + 10)
    rails = laid(straight(day.route.length_m))
    rails.stops_m = np.array(day.route.stops_m)
    ride = Ride(rails, Limits(turns_back=day.turns_back, breaks=day.breaks))
    termini = {day.route.stops_m[number * count] for number in range(1, 5)}
    stood = np.diff(ride.dwells_s, axis=1)[:-1, 0]
    long = np.flatnonzero(stood > 200.0)
    places = ride.motion(ride.dwells_s[long, 0]).arc_length_m.tolist()
    assert places[0] == 0.0
    assert set(places[1:]) == termini
    assert stood[day.off_halt - 1] == pytest.approx(
        day_way.OFF_AFTER_S + day.off_s + day_way.OFF_MARGIN_S
    )


def test_sensors_are_off_for_an_eighth_of_the_day() -> None:
    day = planned()
    assert [type(each) for each in day.events] == [ImuLost, GnssRateLost]
    assert all(each.stop == day.off_halt for each in day.events)
    assert all(each.duration_s == 1000.0 for each in day.events)


def test_as_many_rounds_as_fit() -> None:
    assert Case("net").rounds == 3
    assert Case("net", hours=2.0).rounds == 1


def test_sensors_are_those_of_the_worlds_but_for_the_frames() -> None:
    found = study.sensors(100.0)
    assert found.imu == base().imu
    assert found.wheels == base().wheels
    assert found.resampler == config.Resampler(factor=4)
    slow = Simulation(laid(straight(200.0)), study.sensors(20.0), 1, 10.0)
    frames = list(study._frames(slow, Graph([Resampler(slow.vehicle)])))
    assert len(frames) == pytest.approx(200, abs=10)


# Growth -------------------------------------------------------------------------------------------
WAY_M = 250.0
LIMITS = {"ekf": 1.05, "map_matcher": 1.05, "resampler": 1.25, "configuration_check": 1.5}
"""Memory at the end over that in the middle. What waits in the resampler hangs on the moment; the
check keeps two minutes of driving, and there are no more in this ride."""


def shuttle(path: Path) -> tuple[Case, Setting]:
    """There, back and there on one track, with the sensors off once; IMU at 100 Hz."""
    network = curved().network
    network.save(path)
    route = Route("shuttle", (0,), 10.0, WAY_M, (0.0, WAY_M))
    ride = lay(network, route, RNG(1), MapError(0.2))
    turns = (2, 1)
    chosen = base()
    assert chosen.imu is not None
    driver = replace(chosen.driver, turns_back=turns, turn_s=10.0, first_dwell_s=12.0)
    at = {"stop": 2, "duration_s": 4.0}
    chosen = replace(
        chosen,
        driver=driver,
        imu=replace(chosen.imu, rate_hz=100.0, batch=5),
        events=(ImuLost(**at), GnssRateLost(**at)),
    )
    simulation = Simulation(ride.line, chosen, 1)
    day = day_way.Day(route, turns, (Break(halt=1, duration_s=12.0),), 2, 4.0)
    return Case(str(path)), Setting(day, ride, simulation)


def test_memory_of_filter_and_matcher_does_not_grow_and_figures_stay(tmp_path: Path) -> None:
    case, made = shuttle(tmp_path / "small.tracks")
    found = list(study.parts(case, made))
    assert len(found) == 2 * study.PARTS
    for with_map in (False, True):
        own = [each for each in found if each.with_map == with_map]
        for name, size in own[-1].memory.items():
            assert size <= LIMITS[name] * own[study.PARTS // 2].memory[name], name
        assert len(own[-1].memory) == len(LIMITS) - (not with_map)
        assert all(each.p90_m < 4.0 for each in own[2:])  # fixes of 1.0 m per axis
        assert sum(each.frames for each in own) > 90 * made.simulation.duration_s
    assert sum(each.way_m for each in found) == pytest.approx(2 * 3 * WAY_M, rel=0.02)
    assert found[-1].right_track_share == 1.0


def test_day_that_is_stopped_is_judged_as_far_as_it_came(tmp_path: Path) -> None:
    case, made = shuttle(tmp_path / "small.tracks")
    asked = iter(range(10_000))
    free, mapped = study.parts(case, made, lambda: next(asked) >= 1500)
    assert free.number == mapped.number == 1
    assert free.frames == mapped.frames == 1500
    assert 0.0 < free.way_m < WAY_M


def part(number: int, **fields: float) -> Part:
    values = dict.fromkeys(Part._fields, 1.0) | {"number": number, "with_map": False, "raised": {}}
    memory = {"ekf": int(fields.pop("memory", 1.0)), "map": 0}
    return Part(**{**values, **fields, "memory": memory})  # type: ignore[arg-type]


def test_growth_is_that_of_the_last_part() -> None:
    few = [part(1), part(2)]
    assert study.growth(few, False) is None
    grown = study.growth([*few, part(3, memory=3.0, step_us=2.0, process_bytes=1.5)], False)
    assert grown == (False, 2.0, 3.0, 1.5)
    assert study.growth(few, True) is None
