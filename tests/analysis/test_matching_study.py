"""The study of the map matcher: verdicts against a known truth, tables, and one whole ride."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from networks import junctions as network
from networks import passing_loop

from tramstream import keys
from tramstream.analysis.studies import matching as study
from tramstream.analysis.studies import matching_figures as summed
from tramstream.analysis.studies import matching_judge as judge
from tramstream.analysis.studies.matching import Case
from tramstream.analysis.studies.matching_columns import Said
from tramstream.analysis.studies.matching_figures import (
    BESIDE,
    DIRECTION,
    NEAREST_FIX,
    NEAREST_STATE,
    STANDING,
    STRICT,
    SWITCHES,
    TRACK,
    Figures,
    Tally,
)
from tramstream.errors import ConfigError
from tramstream.processor import Sample
from tramstream.proto.estimate_pb2 import MapAlternative, MapMatch, MotionState
from tramstream.simulation.scenario import Gnss, Imu, Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation
from tramstream.simulation.speed_plan import Limits
from tramstream.simulation.track_rides import MapError, NetworkRide, Route, Spots, lay
from tramstream.tracks.network import Array

MAIN = Route("main", (0, 2, 6), 10.0, 1150.0, (0.0, 1150.0))
LAST_M = 1150.0


@cache
def main_ride() -> NetworkRide:
    return lay(network(), MAIN, np.random.default_rng(1), MapError(0.2))


def spots(*rows: tuple[int, float]) -> Spots:
    return Spots(np.array([run for run, _ in rows]), np.array([at for _, at in rows]))


def verdicts(route_m: float, *rows: tuple[int, float]) -> judge.Verdicts:
    return judge.judge(main_ride(), spots(*rows), np.full(len(rows), route_m))


# Points -------------------------------------------------------------------------------------------
def test_answer_is_right_on_the_true_track_in_either_direction() -> None:
    found = verdicts(490.0, (2, 200.0), (2, 230.0), (3, 400.0))
    assert found.on_track.all()
    np.testing.assert_array_equal(found.onward, [True, True, False])
    np.testing.assert_allclose(found.along_m, [0.0, 30.0, 0.0], atol=1e-9)


def test_neighbouring_run_of_the_route_is_right_only_near_the_node() -> None:
    found = verdicts(280.0, (2, 1.0), (2, 10.0), (0, 299.0))  # the node is at 290
    np.testing.assert_array_equal(found.on_track, [True, False, True])
    np.testing.assert_array_equal(found.right, [True, False, True])
    np.testing.assert_allclose(found.along_m, [11.0, 20.0, 9.0], atol=1e-9)


def test_parallel_track_is_wrong_however_near() -> None:
    far_m = float(network().length_m[5])
    found = verdicts(490.0, (10, far_m - 500.0), (11, 500.0))
    assert not found.right.any()
    assert np.isnan(found.along_m).all()


def test_other_branch_is_not_parted_until_its_rails_are_a_metre_away() -> None:
    rows = [(4, float(at)) for at in range(1, 60)]
    found = judge.judge(main_ride(), spots(*rows), 290.0 + np.arange(1.0, 60.0))
    assert not found.on_track[16:].any()
    branch = np.arange(1, 60)
    at = network().samples_of(2)
    off_m = np.interp(branch, np.arange(60), np.abs(network().north[at])[:60])
    np.testing.assert_array_equal(found.unparted[off_m < 0.9], True)
    np.testing.assert_array_equal(found.unparted[off_m > 1.1], False)


def test_track_that_crosses_is_another_one_where_it_crosses() -> None:
    built = network()
    turned = replace(
        built, yaw_rad=built.yaw_rad + 0.5 * (np.repeat(np.arange(7), np.diff(built.starts)) == 2)
    )
    ride = replace(main_ride(), network=turned)
    near, route_m = spots((4, 3.0)), np.array([293.0])
    assert judge.judge(main_ride(), near, route_m).right.all()
    assert not judge.judge(ride, near, route_m).right.any()


# Switches -----------------------------------------------------------------------------------------
def passed(run_at: dict[int, tuple[int, float]], beyond_m: float = 30.0) -> list[bool]:
    """Verdicts of the two switches, if from a place on the route on a run's point is said."""
    route_m = np.arange(0.0, LAST_M, 1.0)
    true = main_ride().spots_at(route_m)
    run, chainage = true.run.copy(), true.chainage_m.copy()
    for from_m, (wrong, at) in run_at.items():
        run[from_m : from_m + 100], chainage[from_m : from_m + 100] = wrong, at
    said = Spots(run, chainage)
    found = judge.ways(
        main_ride(), said, judge.judge(main_ride(), said, route_m), route_m, beyond_m
    )
    assert [each.choice.node for each in found] == network().to_node[:2].tolist()
    return [each.right for each in found]


def test_way_is_right_where_the_answer_beyond_is_on_the_route() -> None:
    assert passed({}) == [True, True]


def test_way_is_wrong_on_the_other_branch_and_on_the_run_before() -> None:
    assert passed({300: (4, 30.0)}) == [False, True]
    assert passed({300: (0, 200.0)}) == [False, True]
    assert passed({900: (12, 25.0)}) == [True, False]


def test_mistake_counts_at_the_switch_where_it_was_made() -> None:
    run = int(network().following_of(12)[0])
    assert run in judge.reached(network(), 12, 100.0)
    assert run not in judge.reached(network(), 12, 50.0)
    assert passed({900: (8, 1.0)}) == [True, False]


def test_switch_is_left_out_where_the_ride_ends_just_beyond() -> None:
    route_m = np.arange(0.0, 900.0, 1.0)
    said = main_ride().spots_at(route_m)
    found = judge.ways(main_ride(), said, judge.judge(main_ride(), said, route_m), route_m, 30.0)
    assert [each.choice.node for each in found] == network().to_node[:1].tolist()


@pytest.mark.parametrize(("apart_m", "choices"), [(0.1, 0), (3.3, 1)])
def test_interlaced_tracks_are_no_choice(apart_m: float, choices: int) -> None:
    """Rails a hand beside each other that become one again."""
    made = passing_loop(apart_m=apart_m)
    runs = tuple(made.run(name) for name in ("before", "left", "behind"))
    length_m = float(made.network.length_m.sum() - made.network.length_m[runs[1] >> 1]) - 20.0
    route = Route("loop", runs, 10.0, length_m, (0.0, length_m))
    ride = lay(made.network, route, np.random.default_rng(1), MapError(0.2))
    route_m = np.arange(0.0, length_m)
    said = ride.spots_at(route_m)
    found = judge.ways(ride, said, judge.judge(ride, said, route_m), route_m)
    assert len(found) == choices


def test_way_is_asked_where_rails_have_parted_if_that_is_farther() -> None:
    branch, crossover = main_ride().choices
    assert 15.0 < judge.parted_m(main_ride(), branch) < 20.0
    apart_m = judge.parted_m(main_ride(), crossover)
    off_m = np.abs(network().north[network().samples_of(6)])
    np.testing.assert_allclose(off_m[round(apart_m)], judge.PARTED_M, atol=0.12)
    assert apart_m > judge.BEYOND_M / 2
    route_m = np.arange(0.0, LAST_M, 1.0)
    said = main_ride().spots_at(route_m)
    asked = judge.ways(
        main_ride(), said, judge.judge(main_ride(), said, route_m), route_m, 5.0, parted=True
    )
    assert [each.row for each in asked] == [
        math.ceil(choice.route_m + judge.parted_m(main_ride(), choice))
        for choice in (branch, crossover)
    ]


# Probabilities ------------------------------------------------------------------------------------
def test_bins_hold_what_was_said_and_count_stretches() -> None:
    probability = np.array([0.9, 0.91, 0.9, 0.5, 0.9, 1.0])
    right = np.array([True, True, False, False, True, True])
    run, time_s = np.array([1, 1, 1, 1, 2, 1]), np.array([0.0, 1.0, 20.0, 21.0, 22.0, 23.0])
    found = judge.reliability(probability, right, run, time_s)
    ninety, half, certain = (
        int(np.searchsorted(judge.EDGES, p, side="right")) - 1 for p in (0.9, 0.5, 1.0)
    )
    assert (found.points[ninety], found.right[ninety], found.episodes[ninety]) == (4, 3, 3)
    assert (found.points[half], found.right[half], found.episodes[half]) == (1, 0, 1)
    assert (found.points[certain], found.right[certain]) == (1, 1)
    assert np.sum(found.points) == 6
    (_, table, _) = summed.bins(found)
    assert (table.low, table.high) == (0.87, 0.93)
    assert table.stated == pytest.approx(0.9025)
    assert table.right == pytest.approx(0.75)


def test_calibrated_probabilities_are_found_calibrated() -> None:
    rng = np.random.default_rng(2)
    stated = rng.uniform(size=40_000)
    right = rng.uniform(size=len(stated)) < stated
    run, time_s = np.zeros(len(stated), dtype=np.int64), 10.0 * np.arange(len(stated))
    for each in summed.bins(judge.reliability(stated, right, run, time_s)):
        assert each.episodes == each.points
        assert each.right == pytest.approx(each.stated, abs=4 * each.std + 1e-9)


# A ride -------------------------------------------------------------------------------------------
BRISK = Scenario(
    driver=Limits(speed_mps=14.0, acceleration_mps2=1.0, jerk_mps3=0.6, first_dwell_s=20.0),
    imu=Imu(),
    gnss=Gnss(),
)
Wrong = dict[tuple[float, float], tuple[int, float]]
"""Within times of the ride, a point of another run that is said instead of the true one."""


@cache
def simulation() -> Simulation:
    return Simulation(main_ride().line, BRISK, 1)


def said(wrong: Wrong, silent_s: float) -> Said:
    """Made-up answers at 10 Hz: the truth with probability 0.9, a neighbour with 0.1."""
    ride, found = main_ride(), Said()
    stamps_ns = EPOCH_NS + np.arange(int(10 * simulation().duration_s)) * 100_000_000
    truth = simulation().truth(stamps_ns)
    degrees = np.degrees(ride.line.level.to_geodetic(truth.p_l)[:, :2])
    at = ride.spots_at(ride.route_at(truth.motion.arc_length_m))
    for row, stamp_ns in enumerate(stamps_ns.tolist()):
        time_s = row / 10
        first, other = (int(at.run[row]), float(at.chainage_m[row])), (10, 500.0)
        for (begin_s, end_s), instead in wrong.items():
            if begin_s <= time_s < end_s:
                first, other = instead, first
        state = MotionState(
            stamp_ns=stamp_ns, latitude_deg=degrees[row, 0], longitude_deg=degrees[row, 1]
        )
        match = MapMatch(
            stamp_ns=stamp_ns, state=MapMatch.ON_TRACK, run=first[0], chainage_m=first[1],
            chainage_std_m=1.0, probability=0.9, direction_known=True,
            alternatives=[MapAlternative(run=other[0], chainage_m=other[1], probability=0.1)],
        )  # fmt: skip
        outputs = [Sample(keys.EST_STATE, state, stamp_ns, 1)]
        if time_s >= silent_s:
            outputs.append(Sample(keys.MAP_MATCH, match, stamp_ns, 1))
        found.keep(outputs)
    return found


def figured(wrong: Wrong | None = None, silent_s: float = 0.0) -> Figures:
    return study.figures(Case("", "1/0"), main_ride(), simulation(), said(wrong or {}, silent_s))


def test_true_answers_are_all_right() -> None:
    figures = figured()
    for name in (TRACK, STRICT, STANDING, BESIDE, DIRECTION, *SWITCHES):
        tally = figures.tallies[name]
        assert tally.total > 0
        assert tally.right == tally.total, name
    assert figures.tallies[SWITCHES[0]].total == 2
    assert figures.tallies[NEAREST_FIX] == Tally(0, 0)
    assert np.max(np.abs(figures.along_m)) < 1e-3
    assert figures.mistakes == ()
    (_, ninety) = summed.bins(figures.candidates)
    assert ninety.right == 1.0
    assert ninety.episodes == 3  # one a run


def test_wrong_answers_are_counted_and_told() -> None:
    figures = figured({(5.0, 15.0): (10, 900.0)})
    tally = figures.tallies[TRACK]
    assert tally.total - tally.right == 100
    standing = figures.tallies[STANDING]
    assert standing.total - standing.right == 100
    (mistake,) = figures.mistakes
    assert (mistake.kind, mistake.standing) == ("track", True)
    assert (mistake.start_s, mistake.end_s) == pytest.approx((5.0, 14.9))
    assert (mistake.true, mistake.said) == (network().name_of(0), network().name_of(10))
    low, ninety = summed.bins(figures.candidates)
    assert (low.points, ninety.points) == (tally.total, tally.total)
    assert low.right == pytest.approx(100 / tally.total)
    assert ninety.right == pytest.approx(1 - 100 / tally.total)


def test_time_without_an_answer_counts_from_the_first_one_on() -> None:
    late, early = figured(silent_s=10.0), figured()
    assert late.starting_s == pytest.approx(10.0)
    assert early.tallies[TRACK].total - late.tallies[TRACK].total == 100
    assert late.tallies[TRACK].share == 1.0
    never = figured(silent_s=1e6)
    assert never.tallies[TRACK] == Tally(0, early.tallies[TRACK].total)
    assert never.tallies[SWITCHES[0]] == Tally(0, 2)


def test_rides_add_up() -> None:
    one, other = figured(), figured({(5.0, 15.0): (10, 900.0)})
    other = other._replace(route="detour", seed=2)
    first, second, whole = summed.totals([one, other])
    assert (first.name, second.name, whole.name) == ("1/0", "detour", "all")
    for name in summed.TALLIES:
        assert whole.tallies[name].right == sum(
            each.tallies[name].right for each in (first, second)
        )
    assert np.sum(whole.best.points) == np.sum(first.best.points) + np.sum(second.best.points)
    assert [each.name for each in summed.totals([one])] == ["1/0"]


def test_lines_are_chosen_by_name_and_direction() -> None:
    assert study.lines(network()) == ["1/0"]
    assert study.lines(network(), ["1"]) == ["1/0"]
    with pytest.raises(ConfigError, match="no line '7'; it has 1/0"):
        study.lines(network(), ["7"])


def test_whole_ride_goes_through_filter_and_matcher_and_repeats_itself(tmp_path: Path) -> None:
    path = tmp_path / "small.net"
    network().save(path)
    case = Case(str(path), "1/0", seed=2, duration_s=75.0, free=True)
    first, again = study.study(case), study.study(case)
    assert (
        first._replace(step_us=0.0, along_m=np.zeros(0)).__repr__()
        == again._replace(step_us=0.0, along_m=np.zeros(0)).__repr__()
    )
    np.testing.assert_array_equal(first.along_m, again.along_m)
    assert first.tallies[TRACK].total > 600
    assert 0.3 < (first.tallies[NEAREST_FIX].share or 0.0) < 0.95
    assert 0.3 < (first.tallies[NEAREST_STATE].share or 0.0) <= 1.0
    assert first.tallies[DIRECTION].share == 1.0
    other = study.study(case._replace(detour=True, free=False, duration_s=30.0))
    assert other.route == study.DETOUR
    assert other.tallies[TRACK].total > 250
    assert other.tallies[NEAREST_STATE] == Tally(0, 0)


def test_kinds_differ_in_their_sensors_and_in_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "small.net"
    network().save(path)
    case = Case(str(path), "1/0", seed=2)
    ride = study.ride_of(case)
    plain, slow, gyro = (
        study.simulation_of(case._replace(kind=kind), ride) for kind in study.KINDS
    )
    assert plain.seed == slow.seed == gyro.seed
    for simulation_ in (plain, slow, gyro):
        assert simulation_.scenario.gnss is not None
        assert simulation_.scenario.imu is not None
    assert slow.scenario.gnss.errors.decay > plain.scenario.gnss.errors.decay
    walks = [each.scenario.imu.errors.gyro_walk_radps2_rthz for each in (plain, slow, gyro)]
    assert walks[0] == walks[1] < walks[2]
    told = study.vehicle_of(case._replace(kind=study.SLOW), slow).gnss
    assert told is not None
    assert told.error_tau_s == 20.0
    assert study.Case("", "1/0", kind=study.SLOW).route == "1/0, slow"


def errors_of(case: Case) -> Array:
    ride = study.ride_of(case)
    return np.asarray(ride.line.position_l(np.linspace(0.0, 500.0, 50)))


def test_map_is_wrong_in_another_way_for_every_seed(tmp_path: Path) -> None:
    path = tmp_path / "small.net"
    network().save(path)
    case = Case(str(path), "1/0", seed=2)
    assert np.max(np.abs(errors_of(case) - errors_of(case._replace(seed=3)))) > 0.1
    np.testing.assert_array_equal(errors_of(case), errors_of(case))
