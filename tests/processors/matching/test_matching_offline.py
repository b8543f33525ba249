"""The path of a whole ride: right from its first metre, and of traces that no filter has seen."""

from __future__ import annotations

import math

import estimates
import networks
import numpy as np
import pytest
from estimates import FILTER_LEVEL, Driven, Noise, course, driven, gauss_markov, steady
from networks import Made, laid, straight

from tramstream.clock import S
from tramstream.config import Map
from tramstream.estimation.localiser import HEADING_UNKNOWN, LEVEL_ERROR, LEVEL_STD
from tramstream.lines.line import Line
from tramstream.processors.matching.matcher import TRACE_FORGET_S, Matcher
from tramstream.processors.matching.offline import (
    Path,
    PathFinder,
    find_path,
    trace_estimates,
)
from tramstream.tracks.map_frame import MapFrame

SETTINGS = Map(network="", std_m=0.1)
SEEDS = range(3)
NEAR_M = 8.0
"""Of a node, where the run before and the one behind it are both right."""


def path_of(case: Made, drive: Driven) -> Path:
    return find_path(case.network, SETTINGS, ((each, FILTER_LEVEL) for each in drive.estimates))


def runs_of(path: Path) -> list[int]:
    return [leg.run for leg in path.legs]


def trace_of(
    line: Line, way: estimates.Course, std_m: float, seed: int, every_s: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plain fixes along a line: stamps, latitude and longitude, deviations."""
    rng = np.random.default_rng(seed)
    rows = slice(None, None, round(every_s / estimates.STEP_S))
    time, s = way.time_s[rows], way.s[rows]
    p_l = line.position_l(s)
    p_l[:, :2] += np.column_stack([gauss_markov(rng, time, std_m, 60.0) for _ in range(2)])
    stamps = (estimates.BEGIN_NS + np.round(time * S)).astype(np.int64)
    return stamps, line.level.to_geodetic(p_l)[:, :2], np.full(len(time), std_m)


def causal_runs(case: Made, drive: Driven) -> list[int]:
    matcher, frame = Matcher(case.network, SETTINGS), MapFrame(case.network, FILTER_LEVEL)
    matches = [matcher.step(each, frame) for each in drive.estimates]
    return [match.run for match in matches if match is not None]


# Rides --------------------------------------------------------------------------------------------
def test_path_is_right_from_its_first_metre_though_the_matcher_was_in_doubt() -> None:
    """It begins on one of two tracks 3.3 m apart with fixes of 3 m; their ends differ a little."""
    case = networks.passing_loop(3000.0)
    loop = case.lines["left"].length_m
    doubted = 0
    for seed in range(6):
        name = "left" if seed % 2 else "right"
        line = case.path(name, "behind")
        drive = driven(
            line,
            steady(loop + 130.0, 8.0, 20.0),
            Noise(3.0, time_s=300.0, yaw_std_rad=0.004),
            seed,
        )
        path = path_of(case, drive)
        right = case.run(name)
        causal = np.array(causal_runs(case, drive))
        inside = drive.course.s < loop - NEAR_M
        found = np.array([each.run for each in path.places])
        early = np.array([each.probability for each in path.places])[inside][:200]
        doubted += int((early < 0.9).any() or (causal[inside] != right).any())
        assert len({*found[inside].tolist()}) == 1, "one run all the way"
        assert {*found.tolist()} <= {case.run("left"), case.run("right"), case.run("behind")}
        assert (found[drive.course.s > loop + NEAR_M] == case.run("behind")).all()
        # What the causal matcher believes at the end of the loop, the path has from its beginning.
        last = int(np.flatnonzero(inside)[-1])
        assert (found[inside] == causal[last]).all()
    assert doubted, "no doubt, no test"


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("taken", ["straight", "branch"])
def test_path_goes_over_to_the_taken_branch_at_the_switch(taken: str, seed: int) -> None:
    case = networks.switch()
    drive = driven(case.path("stem", taken), steady(400.0, 8.0), seed=seed)
    path = path_of(case, drive)
    assert runs_of(path) == [case.run("stem"), case.run(taken)]
    first, second = path.legs
    s = dict(zip(drive.stamps, drive.course.s.tolist(), strict=True))
    # The causal matcher says the stem's run until it knows better; the path has no such doubt.
    assert s[first.end_ns] == pytest.approx(300.0, abs=3.0)
    assert s[second.begin_ns] == pytest.approx(300.0, abs=3.0)
    assert (first.begin_m, second.end_m) == pytest.approx((0.0, 100.0), abs=3.0)
    assert second.probability > 0.9
    for place, off, true in zip(path.places, drive.off_l, drive.course.s.tolist(), strict=True):
        assert abs(place.across_m) < math.hypot(*off) + 0.1
        chainage = place.chainage_m + 300.0 * (place.run != case.run("stem"))
        assert chainage == pytest.approx(true, abs=math.hypot(*off) + 0.3)


def test_path_of_a_ride_without_a_heading_at_first_begins_where_the_ride_begins() -> None:
    case = networks.double()
    for name in ("right", "left"):
        drive = driven(case.lines[name], course((0.0, 8.0), (300.0, 45.0), start_m=100.0), seed=1)
        drive = drive.altered(0, round(9.0 / estimates.STEP_S), mode=HEADING_UNKNOWN)
        path = path_of(case, drive)
        moving = [each.run for each in path.places[round(9.5 / estimates.STEP_S) :]]
        assert {*moving} == {case.run(name)}
        begin = {each.run >> 1 for each in path.places[: round(8.0 / estimates.STEP_S)]}
        assert begin == {case.run(name) >> 1}, "known from behind"


def test_path_of_a_reversal_has_runs_in_the_direction_of_motion() -> None:
    case = networks.switch()
    way = course((360.0, 50.0), (0.0, 10.0), (-120.0, 30.0), (0.0, 10.0), (100.0, 25.0))
    path = path_of(case, driven(case.path("stem", "branch"), way, seed=1))
    expected = ["stem", "branch", "-branch", "-stem", "stem", "branch"]
    assert runs_of(path) == [case.run(name) for name in expected]


def test_path_that_leaves_the_map_says_so() -> None:
    case = networks.single()
    line = laid(straight(380.0) + networks.arc(50.0, 1.0) + straight(150.0))
    path = path_of(case, driven(line, steady(line.length_m - 5.0, 8.0), seed=1))
    assert runs_of(path) == [case.run("track"), -1]


def test_empty_ride_has_an_empty_path() -> None:
    assert PathFinder(networks.single().network, SETTINGS).path() == Path([], [])


def test_legs_are_the_places_in_order() -> None:
    case = networks.switch()
    path = path_of(case, driven(case.path("stem", "branch"), steady(400.0, 8.0), seed=1))
    stamps = [each.stamp_ns for each in path.places]
    assert stamps == sorted(stamps)
    for before, behind in zip(path.legs, path.legs[1:], strict=False):
        assert before.end_ns < behind.begin_ns
    assert path.legs[0].begin_ns == stamps[0]
    assert path.legs[-1].end_ns == stamps[-1]
    assert all(0.0 <= leg.probability <= 1.0 for leg in path.legs)


# Traces -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("taken", ["straight", "branch"])
def test_trace_of_plain_fixes_finds_the_path(taken: str, seed: int) -> None:
    """Fixes of 2 m every second."""
    case = networks.switch()
    way = steady(420.0, 8.0, 5.0)
    trace = trace_of(case.path("stem", taken), way, 2.0, seed)
    path = find_path(case.network, SETTINGS, trace_estimates(*trace), TRACE_FORGET_S)
    places = [each for each in path.places if each.stamp_ns > trace[0][0] + 12 * S]
    true = np.interp([each.stamp_ns for each in places], trace[0], way.s[:: round(1 / 0.05)])
    stem, right = case.run("stem"), case.run(taken)
    for place, s in zip(places, true.tolist(), strict=True):
        if abs(s - 300.0) > 10.0:
            assert place.run == (stem if s < 300.0 else right)
            chainage = place.chainage_m + 300.0 * (place.run == right)
            assert chainage == pytest.approx(s, abs=8.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_trace_that_jitters_at_a_stop_neither_turns_round_nor_leaves_the_map(seed: int) -> None:
    """Fixes wander by some decimetres a second while the vehicle stands."""
    case = networks.switch()
    way = course((200.0, 30.0), (0.0, 20.0), (220.0, 35.0))
    trace = trace_of(case.path("stem", "branch"), way, 2.0, seed)
    path = find_path(case.network, SETTINGS, trace_estimates(*trace), TRACE_FORGET_S)
    later = [each.run for each in path.places if each.stamp_ns > trace[0][0] + 12 * S]
    assert {*later} == {case.run("stem"), case.run("branch")}


def test_trace_on_double_track_is_on_the_one_whose_way_it_goes() -> None:
    """Fixes of 4 m: the rules tell, for both directions."""
    case = networks.double()
    for name in ("right", "left"):
        for seed in SEEDS:
            way = steady(500.0, 8.0, 50.0)
            trace = trace_of(case.lines[name], way, 4.0, seed)
            path = find_path(case.network, SETTINGS, trace_estimates(*trace), TRACE_FORGET_S)
            moving = [each.run for each in path.places if each.stamp_ns > trace[0][0] + 10 * S]
            assert {*moving} == {case.run(name)}


def test_trace_of_curves_both_ways_is_followed() -> None:
    case = networks.curved()
    line = case.lines["track"]
    trace = trace_of(line, steady(line.length_m - 5.0, 8.0, 2.0), 2.0, 1)
    path = find_path(case.network, SETTINGS, trace_estimates(*trace), TRACE_FORGET_S)
    later = [each.run for each in path.places if each.stamp_ns > trace[0][0] + 5 * S]
    assert {*later} == {case.run("track")}


def test_estimates_of_a_trace_have_its_speed_and_direction() -> None:
    line = networks.single().lines["track"]
    stamps, geodetic, std_m = trace_of(line, steady(300.0, 8.0), 1e-6, 1)
    made = list(trace_estimates(stamps, geodetic, std_m))
    assert made[0][0].stamp_ns == stamps[0]
    for estimate, _ in made[5:-1]:
        assert estimate.speed_mps == pytest.approx(8.0, abs=0.01)
        assert estimate.yaw_rad == pytest.approx(networks.YAW_RAD, abs=1e-3)
        assert not estimate.standing


def test_trace_that_stands_knows_no_heading() -> None:
    line = networks.single().lines["track"]
    trace = trace_of(line, course((0.0, 30.0), start_m=50.0), 1e-3, 1)
    for estimate, _ in trace_estimates(*trace):
        assert estimate.standing
        assert estimate.mode == HEADING_UNKNOWN


def test_trace_that_is_silent_for_two_minutes_says_nothing_of_them() -> None:
    line = networks.single().lines["track"]
    stamps, geodetic, std_m = trace_of(line, steady(300.0, 8.0), 0.5, 1)
    later = stamps.copy()
    later[20:] += 120 * S
    made = [each.stamp_ns for each, _ in trace_estimates(later, geodetic, std_m)]
    silent = [each for each in made if later[19] < each < later[20]]
    assert silent == []
    assert len(made) >= len(stamps)


def test_trace_without_deviations_is_taken_for_a_poor_one() -> None:
    line = networks.single().lines["track"]
    stamps, geodetic, std_m = trace_of(line, steady(300.0, 8.0), 0.5, 1)
    for estimate, _ in trace_estimates(stamps, geodetic, np.full(len(std_m), math.nan)):
        assert estimate.covariance[0, 0] >= 4.0
        known = np.delete(estimate.values, [LEVEL_ERROR, LEVEL_STD])
        assert np.isfinite(known).all()


def test_trace_of_a_single_fix_is_a_place_without_a_direction() -> None:
    line = networks.single().lines["track"]
    stamps, geodetic, std_m = trace_of(line, course(start_m=50.0), 0.5, 1)
    case = networks.single()
    path = find_path(case.network, SETTINGS, trace_estimates(stamps, geodetic, std_m))
    assert all(np.isfinite(place.chainage_m) for place in path.places)
