"""The map matcher on small networks with a known truth: branches, parallels, reversals, the edge.

Estimates err as a filter's do: slowly, by what their covariance says. `networks` makes both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import estimates
import networks
import numpy as np
import pytest
from estimates import FILTER_LEVEL, Driven, Noise, Obeying, course, driven, steady, told
from networks import (
    BOTH,
    LEVEL,
    PARALLEL_M,
    SWITCH_M,
    Array,
    Made,
    arc,
    laid,
    made,
    straight,
)

from tramstream.clock import S
from tramstream.config import Map
from tramstream.estimation.localiser import HEADING_UNKNOWN, STARTING, values_of
from tramstream.estimation.track import OnTrack
from tramstream.lines.line import Line
from tramstream.memory.stage import assign, copied, from_plain, to_plain
from tramstream.processors.matching import hypotheses as kernels
from tramstream.processors.matching.matcher import HypothesesMemory, Match, Matcher
from tramstream.tracks.map_frame import MapFrame
from tramstream.tracks.rails import place, rails_of

SEEDS = range(4)
FEW = range(3)
SETTINGS = Map(network="", std_m=0.1)
MM = 1e-3
SURE = 0.95
STD_M = 0.5
"""Of the estimates, per axis, where a test says nothing else: a good filter with fixes."""


@dataclass(frozen=True)
class Said:
    """What the matcher said of a ride."""

    drive: Driven
    matches: list[Match]
    matcher: Matcher
    off_l: Array
    """(n, 2): error of the estimates as they were given."""
    on_tracks: list[OnTrack | None]
    """What a filter was told."""

    @property
    def s(self) -> Array:
        """True way along the ridden line."""
        return self.drive.course.s

    @property
    def run(self) -> Array:
        return np.array([each.run for each in self.matches])

    @property
    def probability(self) -> Array:
        return np.array([each.probability for each in self.matches])

    @property
    def chainage_m(self) -> Array:
        return np.array([each.chainage_m for each in self.matches])

    @property
    def plan(self) -> Array:
        return np.array([(each.east, each.north) for each in self.matches])

    @property
    def off_m(self) -> Array:
        """Distance of the published from the true place."""
        off: Array = np.hypot(*(self.plan - self.drive.plan).T)
        return off


def matched(
    case: Made,
    drive: Driven,
    settings: Map = SETTINGS,
    obeys: bool = True,
    alone: bool = False,
) -> Said:
    """Put a ride through a matcher, whose filter is put onto the rails where `obeys`."""
    matcher = Matcher(case.network, settings)
    frame = MapFrame(case.network, FILTER_LEVEL)
    obeying = Obeying(drive.noise)
    on_tracks: list[OnTrack | None] = []
    matches, off_l, last_ns = [], drive.off_l.copy(), drive.estimates[0].stamp_ns
    for estimate in drive.estimates:
        obeying.wait(max(estimate.stamp_ns - last_ns, 0) / S)
        last_ns = max(estimate.stamp_ns, last_ns)
        given = obeying.apply(estimate) if obeys else estimate
        match = matcher.step(given, frame, held=obeys, alone=alone)
        assert match is not None
        on_track = told(matcher, match, frame)
        assert_sane(match, matcher, on_track)
        on_tracks.append(on_track)
        off_l[len(matches)] += obeying.correction[:2] * obeys
        matches.append(match)
        if on_track is not None:
            obeying.take(on_track)
    return Said(drive, matches, matcher, off_l, on_tracks)


def assert_sane(match: Match, matcher: Matcher, on_track: OnTrack | None) -> None:
    """Numbers are numbers, probabilities are some, chainages are on their runs."""
    others = match.others
    numbers = [*match[1:7], *(each.probability for each in others)]
    numbers += [each.chainage_m for each in others]
    if on_track is not None:
        known = 9 if not math.isnan(on_track.grade_rad) else 7
        numbers += on_track[:known]
    assert np.isfinite(numbers).all(), match
    total = match.off_probability + match.probability + sum(each.probability for each in others)
    assert -1e-9 <= total <= 1.0 + 1e-6, match
    assert matcher.hypotheses <= kernels.MOST
    assert np.isfinite(matcher.memory[: kernels.HEAD]).all()
    if match.run >= 0:
        length = float(matcher.network.length_m[match.run >> 1])
        assert 0.0 <= match.chainage_m <= length
        assert match.chainage_std_m >= 0.0


# Branches -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("taken", ["straight", "branch"])
def test_taken_branch_is_found_soon_and_the_other_never_believed(taken: str, seed: int) -> None:
    case = networks.switch()
    said = matched(case, driven(case.path("stem", taken), steady(400.0, 8.0), seed=seed))
    stem, right = case.run("stem"), case.run(taken)
    (other,) = {case.run("straight"), case.run("branch")} - {right}
    believed = (said.run == other) & (said.probability > SURE)
    assert not believed.any()
    before, behind = said.s < 300.0 - 5.0 * STD_M, said.s > 300.0 + 15.0
    assert (said.run[before] == stem).all()
    # After 15 m the branches are 2.2 m and 17° apart.
    assert (said.run[behind] == right).all()
    assert (said.probability[said.s > 300.0 + 20.0] > SURE).all()
    put = np.array([each is not None for each in said.on_tracks])
    assert put[said.s > 330.0].any()


@pytest.mark.parametrize("seed", FEW)
def test_filter_is_not_put_onto_rails_before_it_is_known_which(seed: int) -> None:
    """What it is told is what it is truly off its track, also where the branches still touch."""
    case = networks.switch()
    for taken in ("straight", "branch"):
        drive = driven(case.path("stem", taken), steady(400.0, 8.0), seed=seed)
        said = matched(case, drive)
        for k, on_track in enumerate(said.on_tracks):
            if on_track is None:
                continue
            truly = float(np.array(on_track[:2]) @ said.off_l[k])
            assert on_track.across_m == pytest.approx(truly, abs=0.1)


@pytest.mark.parametrize("seed", FEW)
@pytest.mark.parametrize("from_", ["straight", "branch"])
def test_trailing_switch_needs_no_choice(from_: str, seed: int) -> None:
    case = networks.switch()
    line = case.path("stem", from_)
    way = steady(400.0, 8.0)
    backwards = way._replace(s=line.length_m - way.s, rate=-way.rate)
    said = matched(case, driven(line, backwards, seed=seed, rear=True))
    # The vehicle faces the stem and goes there.
    behind = said.s < 290.0
    assert (said.run[behind] == case.run("-stem")).all()
    assert (said.probability[behind] > 0.99).all()
    ahead = (said.s > 330.0) & (said.s < line.length_m - 15.0)
    assert (said.run[ahead] == case.run(f"-{from_}")).all()


@pytest.mark.parametrize("seed", FEW)
def test_crossover_is_told_from_going_straight_on(seed: int) -> None:
    case = networks.crossover()
    over = matched(
        case, driven(case.path("before", "link", "left_behind"), steady(400.0, 8.0), seed=seed)
    )
    assert over.run[-1] == case.run("left_behind"), "against its direction, as trams go there"
    assert over.probability[-1] > SURE
    on = matched(case, driven(case.path("before", "behind"), steady(400.0, 8.0), seed=seed))
    assert (on.run[on.s > 200.0 + 40.0] == case.run("behind")).all()
    assert (on.probability[on.s > 200.0 + 60.0] > SURE).all()


# Parallel tracks ----------------------------------------------------------------------------------
TOWARDS = PARALLEL_M * np.array([-math.sin(networks.YAW_RAD), math.cos(networks.YAW_RAD)])
"""From the right to the left of two parallel tracks."""


@pytest.mark.parametrize("name", ["right", "left"])
def test_opposite_track_is_excluded_by_the_direction_of_travel(name: str) -> None:
    """Even where the estimate lies on the opposite track all the way."""
    case = networks.double()
    aside = TOWARDS if name == "right" else -TOWARDS
    noise = Noise(std_m=1.5, offset_l=(float(aside[0]), float(aside[1])))
    for seed in FEW:
        way = course((150.0, 25.0), (0.0, 30.0), (150.0, 25.0), start_m=50.0)
        said = matched(case, driven(case.lines[name], way, noise, seed))
        assert (said.run == case.run(name)).all()
        assert (said.probability > 0.75).all()  # two deviations, and a bit by chance
        assert np.median(said.probability) > 0.9


def test_opposite_track_is_excluded_at_the_first_standstill_with_a_heading() -> None:
    case = networks.double()
    noise = Noise(std_m=1.5, offset_l=(float(TOWARDS[0]), float(TOWARDS[1])))
    said = matched(case, driven(case.lines["right"], course((0.0, 20.0), start_m=100.0), noise))
    assert (said.run == case.run("right")).all()
    assert (said.probability > SURE).all()


def test_without_a_heading_both_parallel_tracks_are_said() -> None:
    """Nobody knows yet which way it faces; the nearer track is the likelier one."""
    case = networks.double()
    drive = driven(
        case.lines["right"], course((0.0, 5.0), (60.0, 12.0), start_m=100.0), Noise(std_m=1.0)
    )
    begun = round(5.0 / estimates.STEP_S)
    said = matched(case, drive.altered(0, begun, mode=HEADING_UNKNOWN))
    for match in said.matches[:begun]:
        assert not match.headed
        tracks = {match.run >> 1} | {each.run >> 1 for each in match.others}
        assert tracks == {0, 1}
    assert not any(said.on_tracks[:begun])
    assert said.matches[begun].headed
    assert (said.run[begun:] == case.run("right")).all()
    assert (said.probability[begun:] > SURE).all()


@pytest.mark.parametrize("counted", [True, False], ids=("lever counted", "antenna's own place"))
@pytest.mark.parametrize("std_m", [0.02, 0.5, 1.5, 4.0])
def test_antenna_far_from_the_vehicle_is_no_obstacle_before_the_heading_is_known(
    std_m: float, counted: bool
) -> None:
    """A filter without a heading says where the vehicle is by half its lever arm's square more."""
    case, lever_m = networks.double(), 3.0
    drive = driven(case.lines["right"], steady(100.0, 5.0), Noise(std_m=0.01))
    matcher = Matcher(case.network, SETTINGS, lever_m=lever_m)
    frame = MapFrame(case.network, FILTER_LEVEL)
    variance = std_m**2 + (0.5 * lever_m**2 if counted else 0.0)
    for estimate in drive.altered(0, 100, mode=HEADING_UNKNOWN).estimates[:100]:
        given = replace(estimate, values=estimate.values.copy())
        given.covariance[:2, :2] = np.eye(2) * variance
        match = matcher.step(given, frame)
        assert match is not None
        assert_sane(match, matcher, None)
    assert match.run >> 1 == case.run("right") >> 1
    assert match.off_probability < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_two_hypotheses_on_a_passing_loop_join_again(seed: int) -> None:
    """Fixes of 3 m do not tell tracks 3.3 m apart; behind the loop there is one track again.

    Its switches are so flat that the heading does not tell them either.
    """
    case = networks.passing_loop(3000.0)
    noise = Noise(std_m=3.0, time_s=200.0, yaw_std_rad=0.05)
    names = "before", "left" if seed % 2 else "right", "behind"
    line = case.path(*names)
    said = matched(case, driven(line, steady(line.length_m - 5.0, 8.0), noise, seed))
    begin, end = 200.0, line.length_m - 200.0
    within = (said.s > begin + 40.0) & (said.s < end - 40.0)
    both = [
        {match.run, *(each.run for each in match.others)}
        for match, inside in zip(said.matches, within, strict=True)
        if inside
    ]
    doubted = {case.run("left"), case.run("right")}
    assert any(doubted <= each for each in both), "no doubt, no test"
    behind = said.s > end + 30.0
    assert (said.run[behind] == case.run("behind")).all()
    assert (said.probability[behind] > 0.99).all()
    assert said.matcher.hypotheses == 1


# Reversing ----------------------------------------------------------------------------------------
REVERSAL = course((340.0, 50.0), (0.0, 10.0), (-120.0, 30.0), (0.0, 10.0), (160.0, 35.0))
"""60 m over the switch, back to 60 m before it, and on again."""


@pytest.mark.parametrize("seed", FEW)
@pytest.mark.parametrize("taken", ["straight", "branch"])
def test_reversing_over_a_switch_and_back_keeps_the_branch(taken: str, seed: int) -> None:
    case = networks.switch()
    said = matched(case, driven(case.path("stem", taken), _from(20.0), seed=seed))
    time = said.drive.course.time_s
    behind = said.s > 320.0
    # Half a metre tells that it has turned round.
    back, forth = said.drive.course.rate < -1.2, said.drive.course.rate > 1.2
    assert (said.run[behind & forth] == case.run(taken)).all()
    assert (said.run[behind & back] == case.run(f"-{taken}")).all()
    stem = said.s < 295.0
    assert (said.run[stem & forth] == case.run("stem")).all()
    assert (said.run[stem & back] == case.run("-stem")).all()
    sure = (behind | stem) & (time > 20.0)
    assert (said.probability[sure] > SURE).all()
    assert said.off_m.max() < 5.0 * STD_M


def _from(start_m: float) -> estimates.Course:
    return REVERSAL._replace(s=REVERSAL.s + start_m)


@pytest.mark.parametrize("seed", FEW)
def test_switch_that_was_thrown_after_reversing_is_noticed(seed: int) -> None:
    """A triangle: over the switch one way, back, and on the other way."""
    case = networks.switch()
    turn = 300.0
    forth = course((360.0, 50.0), (0.0, 5.0), (-120.0, 30.0), (0.0, 10.0))
    on = course((200.0, 35.0), start_m=float(forth.s[-1]))
    first = driven(case.path("stem", "straight"), forth, seed=seed)
    second = driven(case.path("stem", "branch"), on, seed=seed)
    said = matched(case, _one_after_the_other(first, second))
    later = np.arange(len(said.s)) >= len(forth.s)
    wrong = said.run == case.run("straight")
    assert not (later & wrong & (said.s > turn + 20.0)).any()
    found = later & (said.s > turn + 25.0)
    assert (said.run[found] == case.run("branch")).all()
    assert (said.probability[found] > SURE).all()


@pytest.mark.parametrize("seed", FEW)
def test_vehicle_that_came_over_a_crossover_reverses_past_it(seed: int) -> None:
    """Behind it the switch is thrown: back along the left track, not back over the link."""
    case = networks.crossover()
    link = case.lines["link"].length_m
    forth = course((360.0, 50.0), (0.0, 10.0))
    first = driven(case.path("before", "link", "left_behind"), forth, seed=seed)
    left = case.path("left_before", "left_behind")
    at = case.lines["left_before"].length_m + 360.0 - 200.0 - link
    second = driven(left, course((-250.0, 50.0), start_m=at), seed=seed)
    said = matched(case, _one_after_the_other(first, second))
    later = np.arange(len(said.s)) >= len(forth.s)
    passed = later & (said.s < case.lines["left_before"].length_m - 25.0)
    assert (said.run[passed] == case.run("-left_before")).all()
    assert (said.probability[passed] > SURE).all()


def _one_after_the_other(first: Driven, second: Driven) -> Driven:
    """The second goes on with the error with which the first ended."""
    jump = first.off_l[-1] - second.off_l[0]
    count = len(second.estimates)
    fading = np.exp(-second.course.time_s / 60.0)[:, None] * jump
    later = []
    for k in range(count):
        each = second.estimates[k]
        values = each.values.copy()
        values[:2] += fading[k]
        gone_ns = first.estimates[-1].stamp_ns - second.estimates[0].stamp_ns
        stamp_ns = each.stamp_ns + gone_ns + round(estimates.STEP_S * S)
        later.append(replace(each, stamp_ns=stamp_ns, values=values))
    begin = first.course.time_s[-1] + estimates.STEP_S
    way = estimates.Course(
        np.concatenate([first.course.time_s, second.course.time_s + begin]),
        np.concatenate([first.course.s, second.course.s]),
        np.concatenate([first.course.rate, second.course.rate]),
    )
    return Driven(
        first.estimates + later,
        way,
        np.concatenate([first.plan, second.plan]),
        np.concatenate([first.off_l, second.off_l + fading]),
        first.noise,
    )


@pytest.mark.parametrize("seed", FEW)
def test_vehicle_driven_from_its_rear_cab_is_matched_in_its_direction_of_motion(seed: int) -> None:
    case = networks.double()
    way = course((150.0, 25.0), (0.0, 10.0), (150.0, 25.0), start_m=50.0)
    drive = driven(case.lines["right"], way, Noise(1.0), seed, rear=True)
    unknown = drive.altered(0, round(3.0 / estimates.STEP_S), mode=HEADING_UNKNOWN)
    said = matched(case, unknown)
    moving = said.drive.course.time_s > 3.0
    assert (said.run[moving] == case.run("right")).all()
    assert (said.probability[moving] > SURE).all()
    assert np.abs(said.chainage_m - said.s)[moving].max() < 5.0
    rising = np.diff(said.chainage_m[moving])
    assert rising.min() > -0.5


def test_heading_known_while_standing_does_not_say_which_way_it_will_go() -> None:
    """A vehicle with a heading from its last ride stands, then moves backwards: along the rules."""
    case = networks.double()
    way = course((0.0, 5.0), (150.0, 25.0), start_m=100.0)
    said = matched(case, driven(case.lines["right"], way, Noise(1.0), 1, rear=True))
    moving = said.s > 110.0
    assert (said.run[moving] == case.run("right")).all()
    assert (said.probability[moving] > SURE).all()


def test_others_are_said_in_the_direction_of_motion_too() -> None:
    """Runs and chainages of a match have one direction, and no run is said twice."""
    case = networks.double()
    drive = driven(
        case.lines["right"], course((150.0, 25.0), start_m=50.0), Noise(2.5), 1, rear=True
    )
    said = matched(case, drive.altered(0, round(3.0 / estimates.STEP_S), mode=HEADING_UNKNOWN))
    seen = 0
    for match, s in zip(said.matches, said.s.tolist(), strict=True):
        if match.headed and match.run >= 0:
            candidates = [
                (match.run, match.chainage_m),
                *((c.run, c.chainage_m) for c in match.others),
            ]
            runs = [run for run, _ in candidates]
            assert len({*runs}) == len(runs)
            seen += len(runs) > 1
            # Both tracks: along the right one, or against the left one, which is drawn against it.
            assert {*runs} <= {case.run("right"), case.run("-left")}
            assert all(chainage == pytest.approx(s, abs=10.0) for _, chainage in candidates)
    assert seen


# Standing -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", FEW)
@pytest.mark.parametrize("case", ["double", "switch"])
def test_standing_for_a_minute_changes_nothing_though_the_estimate_drifts(
    case: str, seed: int
) -> None:
    """By 4 m, sideways and along: nobody moves a vehicle whose wheels stand."""
    net = networks.double() if case == "double" else networks.switch()
    line = net.lines["right"] if case == "double" else net.path("stem", "branch")
    way = course((250.0, 40.0), (0.0, 60.0), start_m=30.0)
    said = matched(net, drifted(driven(line, way, seed=seed), (40.0, 100.0), 4.0))
    stands = np.flatnonzero(said.drive.course.rate == 0.0)[2:]
    assert len(stands) > 1100
    assert len({*said.run[stands].tolist()}) == 1
    assert np.ptp(said.chainage_m[stands]) < 0.05
    assert np.ptp(said.probability[stands]) < 0.01
    assert np.hypot(*np.ptp(said.plan[stands], axis=0)) < 0.05


def drifted(drive: Driven, within_s: tuple[float, float], way_m: float) -> Driven:
    """The estimate walks away within some time, sideways and along, and does not come back."""
    share = np.interp(drive.course.time_s, within_s, (0.0, 1.0))[:, None]
    across = TOWARDS / PARALLEL_M
    drift = share * way_m * (0.8 * across + 0.6 * np.array([across[1], -across[0]]))
    estimates = []
    for each, moved in zip(drive.estimates, drift, strict=True):
        values = each.values.copy()
        values[:2] += moved
        estimates.append(replace(each, values=values))
    return replace(drive, estimates=estimates, off_l=drive.off_l + drift)


@pytest.mark.parametrize("seed", FEW)
@pytest.mark.parametrize("drift_m", [0.0, 1.0, 2.0])
def test_place_moves_at_a_departure_by_no_more_than_the_estimate_has_drifted(
    drift_m: float, seed: int
) -> None:
    """It stands while the vehicle stands; then it is put back onto the estimate, at once."""
    case = networks.double()
    way = course((250.0, 40.0), (0.0, 30.0), (150.0, 25.0), start_m=30.0)
    drive = driven(case.lines["right"], way, Noise(1.0), seed)
    said = matched(case, drifted(drive, (40.0, 70.0), drift_m))
    assert (said.run == case.run("right")).all()
    farther = excess_m(said)
    departs = way.time_s[1:] > 70.0
    assert farther[~departs].max() < JITTER_M
    assert farther[departs].max() < max(drift_m, JITTER_M)
    assert np.sort(farther)[-2] < JITTER_M, "one step"


# No teleport --------------------------------------------------------------------------------------
JITTER_M = 0.5
"""A published place may go so much farther than the vehicle in a step: what a curve has told."""
SECOND_M = 1.0
"""The same within a second."""


def excess_m(said: Said, every: int = 1) -> Array:
    """How much farther the published place goes than the vehicle, from step to step."""
    step = np.hypot(*np.diff(said.plan[::every], axis=0).T)
    farther: Array = step - np.abs(np.diff(said.s[::every]))
    return farther


def assert_no_teleport(said: Said) -> None:
    assert excess_m(said).max() < JITTER_M
    assert excess_m(said, round(1.0 / estimates.STEP_S)).max() < SECOND_M


@pytest.mark.parametrize("seed", SEEDS)
def test_published_place_never_moves_much_faster_than_the_vehicle(seed: int) -> None:
    """Though the estimate itself jitters by 4 cm a step and is metres off."""
    case = networks.curved()
    way = course((200.0, 30.0), (0.0, 15.0), (250.0, 40.0), start_m=5.0)
    said = matched(case, driven(case.lines["track"], way, Noise(1.0), seed))
    begun = said.drive.course.time_s > 5.0
    assert (said.run == case.run("track")).all()
    assert said.off_m[begun].max() < 5.0
    assert_no_teleport(said)


@pytest.mark.parametrize("seed", FEW)
def test_curves_tell_where_along_the_track_the_vehicle_is(seed: int) -> None:
    """4 m off along the track before the curves, and still so: behind them less than 1 m."""
    case = networks.curved()
    noise = Noise(2.0, time_s=1e4, yaw_std_rad=0.005)
    line = case.lines["track"]
    drive = driven(line, steady(line.length_m - 10.0, 8.0), noise, seed)
    said = matched(case, drive)
    along = said.chainage_m - said.s
    end = said.s > line.length_m - 60.0
    assert np.abs(along[end]).max() < 1.0
    std = np.array([each.chainage_std_m for each in said.matches])
    assert std[end].max() < 1.0 < std[10]
    assert (np.abs(along[end]) < 4.0 * std[end]).all()


# Off the map --------------------------------------------------------------------------------------
SAID_WITHIN_M = 40.0
"""Behind the switch of a branch with 50 m radius that no map shows."""
FOUND_WITHIN_M = 40.0


def detour() -> tuple[Made, Line]:
    """A straight track, and a line that leaves it at 200 m and is back 240 m later."""
    angle = math.radians(40.0)
    away = arc(SWITCH_M, angle) + straight(30.0)
    back = arc(SWITCH_M, -2.0 * angle)
    home = straight(30.0) + arc(SWITCH_M, angle)
    line = laid(straight(200.0) + away + back + home + straight(200.0))
    return made({"track": laid(straight(700.0))}), line


@pytest.mark.parametrize("seed", SEEDS)
def test_leaving_the_map_is_said_and_the_return_found(seed: int) -> None:
    case, line = detour()
    said = matched(case, driven(line, steady(line.length_m - 5.0, 8.0), seed=seed))
    begin, end = 200.0, line.length_m - 200.0
    assert (said.run[said.s < begin - 5.0] == case.run("track")).all()
    off = said.run < 0
    assert off[(said.s > begin + SAID_WITHIN_M) & (said.s < end - 40.0)].all()
    assert (said.run[said.s > end + FOUND_WITHIN_M] == case.run("track")).all()
    assert (said.probability[said.s > end + FOUND_WITHIN_M] > 0.9).all()
    # Never put onto rails that it has left by a metre.
    for on_track, s in zip(said.on_tracks, said.s.tolist(), strict=True):
        if begin + 10.0 < s < end - 10.0:
            assert on_track is None


def test_vehicle_that_begins_off_the_map_is_found_when_it_comes_to_it() -> None:
    line = laid(straight(600.0))
    beyond = line.position_l(200.0)[:2]
    case = made({"track": laid(straight(400.0), beyond.tolist())})
    said = matched(case, driven(line, steady(550.0, 8.0), seed=1))
    assert (said.run[said.s < 180.0] == -1).all()
    assert (said.run[said.s > 200.0 + 15.0] == case.run("track")).all()


def test_vehicle_that_leaves_the_last_track_at_its_end_is_off_the_map() -> None:
    line = laid(straight(700.0))
    case = made({"track": laid(straight(400.0))})
    said = matched(case, driven(line, steady(650.0, 8.0), seed=1))
    assert (said.run[said.s < 395.0] == case.run("track")).all()
    assert (said.run[said.s > 400.0 + SAID_WITHIN_M] == -1).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicle_on_a_track_that_the_map_lacks_is_not_put_onto_the_opposite_one(seed: int) -> None:
    """The map has its own track up to 300 m and again from 600 m on, the opposite one all along."""
    whole = laid(straight(900.0))
    ahead = whole.position_l(900.0)[:2] - whole.position_l(0.0)[:2]
    start = np.array(networks.left_of(whole, networks.PARALLEL_M)) + ahead
    case = made(
        {
            "before": laid(straight(300.0)),
            "behind": laid(straight(300.0), whole.position_l(600.0)[:2].tolist()),
            "opposite": laid(straight(900.0), start.tolist(), networks.YAW_RAD + math.pi),
        }
    )
    said = matched(case, driven(whole, steady(880.0, 8.0), Noise(0.3), seed=seed), Map(network=""))
    assert (said.run[said.s < 290.0] == case.run("before")).all()
    lacked = (said.s > 300.0 + SAID_WITHIN_M) & (said.s < 600.0)
    wrong = lacked & (said.run == (case.run("opposite") ^ 1))
    assert not (said.probability[wrong] > 0.9).any()
    assert wrong.sum() < 0.1 * lacked.sum()
    told_of = [each is not None for each in said.on_tracks]
    assert not np.array(told_of)[lacked].any()
    assert (said.run[said.s > 600.0 + SAID_WITHIN_M] == case.run("behind")).all()


def test_vehicle_far_from_all_tracks_is_off_the_map() -> None:
    case = networks.single()
    line = laid(straight(300.0), (3000.0, 3000.0))
    said = matched(case, driven(line, steady(200.0, 8.0)))
    assert (said.run == -1).all()
    assert said.matcher.away_m() > 3e3
    assert all(match.off_probability > 0.99 and not match.others for match in said.matches)


# Many and few tracks ------------------------------------------------------------------------------
def fan(count: int = 60, apart_m: float = 1.5) -> Made:
    """More parallel tracks than there are hypotheses."""
    lines = {}
    for k in range(count):
        way = (k - count / 2) * apart_m
        start = -way * math.sin(networks.YAW_RAD), way * math.cos(networks.YAW_RAD)
        lines[f"track {k}"] = laid(straight(400.0), start)
    return made(lines, rules=dict.fromkeys(lines, BOTH))


def test_more_candidates_than_hypotheses_are_no_trouble() -> None:
    case = fan()
    line = case.lines["track 30"]
    drive = driven(line, course((0.0, 5.0), (250.0, 40.0), start_m=50.0), Noise(10.0), seed=3)
    near = matched(case, drive.altered(0, 60, mode=HEADING_UNKNOWN))
    assert max(near.probability) < 0.5, "nobody knows which of those"
    good = matched(case, driven(line, steady(300.0, 8.0, 50.0), Noise(0.3), seed=3))
    assert (good.run[-100:] == case.run("track 30")).all()


@pytest.mark.parametrize("seed", FEW)
def test_depot_with_64_tracks_does_not_break_it(seed: int) -> None:
    """Fixes of 4 m: dozens of hypotheses; at the end of its track the vehicle is on it or near."""
    case = networks.ladder()
    names = [*(f"lead {k}" for k in range(21)), "track 20"]
    line = case.path(*names)
    drive = driven(line, steady(line.length_m - 5.0, 6.0), Noise(4.0, yaw_std_rad=0.03), seed)
    said = matched(case, drive)
    assert said.off_m[-1] < 12.0
    assert said.run[-1] >= 0
    good = matched(case, driven(line, steady(line.length_m - 5.0, 6.0), Noise(0.4), seed))
    assert good.run[-1] == case.run("track 20")
    assert good.probability[-1] > SURE


def test_network_of_one_track_is_enough() -> None:
    case = networks.single()
    said = matched(case, driven(case.lines["track"], steady(380.0, 8.0, 5.0)))
    assert (said.run == case.run("track")).all()
    assert (said.probability > 0.9).all()
    assert all(match.others == () for match in said.matches[20:])


# Bad input ----------------------------------------------------------------------------------------
def test_nothing_is_said_before_the_filter_has_begun() -> None:
    case = networks.single()
    matcher, frame = Matcher(case.network, SETTINGS), MapFrame(case.network, FILTER_LEVEL)
    (first,) = driven(case.lines["track"], course()).estimates
    assert matcher.step(replace(first, mode=STARTING), frame) is None
    assert matcher.step(first, frame) is not None


@pytest.mark.parametrize("case", [networks.single(), networks.curved()], ids=["straight", "curved"])
@pytest.mark.parametrize("gap_s", [0.5, 5.0, 20.0])
def test_gap_in_the_estimates_is_bridged(case: Made, gap_s: float) -> None:
    """What the filter says behind it is as good as before: nothing of the way is lost.

    Nor is the filter put onto rails that it left behind in the meantime.
    """
    drive = driven(case.lines["track"], steady(390.0, 10.0, 2.0), seed=1)
    time = drive.course.time_s
    kept = np.flatnonzero((time < 10.0) | (time >= 10.0 + gap_s))
    said = matched(case, chosen(drive, kept))
    after = said.drive.course.time_s >= 10.0 + gap_s
    for k in np.flatnonzero(after).tolist():
        on_track = said.on_tracks[k]
        if on_track is not None:
            truly = float(np.array(on_track[:2]) @ said.off_l[k])
            assert on_track.across_m == pytest.approx(truly, abs=0.3)
    assert (said.run == case.run("track")).all()
    assert np.abs(said.chainage_m - said.s)[after].max() < 5.0 * STD_M


def chosen(drive: Driven, rows: Array) -> Driven:
    """Some of the estimates."""
    return Driven(
        [drive.estimates[k] for k in rows.tolist()],
        estimates.Course(*(each[rows] for each in drive.course)),
        drive.plan[rows],
        drive.off_l[rows],
        drive.noise,
    )


def test_stamps_twice_or_backwards_do_no_harm() -> None:
    case = networks.switch()
    drive = driven(case.path("stem", "branch"), steady(400.0, 8.0), seed=2)
    rows = np.arange(len(drive.estimates))
    rows = np.insert(rows, 300, rows[280:300])  # again, and older than the last
    rows = np.insert(rows, 700, np.repeat(rows[699], 20))
    said = matched(case, chosen(drive, rows))
    end = np.flatnonzero(said.s > 330.0)
    assert (said.run[end] == case.run("branch")).all()


def test_filter_that_begins_anew_is_followed() -> None:
    """It knows no heading for a while, and its place is another one."""
    case = networks.curved()
    line = case.lines["track"]
    drive = driven(line, steady(400.0, 8.0, 5.0), seed=1)
    fresh = driven(line, steady(400.0, 8.0, 5.0), Noise(3.0), seed=2)
    estimates = (
        drive.estimates[:500] + fresh.altered(500, 560, mode=HEADING_UNKNOWN).estimates[500:]
    )
    said = matched(case, replace(drive, estimates=estimates), obeys=False)
    assert (said.run[580:] == case.run("track")).all()
    assert said.off_m[580:].max() < 12.0


@pytest.mark.parametrize("std_m", [0.0, 1e-6, 1e3])
def test_covariances_that_cannot_be_give_numbers(std_m: float) -> None:
    """`assert_sane` looks at every match."""
    case = networks.switch()
    drive = driven(case.path("stem", "branch"), steady(400.0, 8.0), seed=1)
    covariance = np.diag([std_m**2] * 7)
    drive = replace(drive, noise=Noise(std_m, yaw_std_rad=std_m))
    estimates = [
        replace(
            each,
            values=values_of(each.motion, covariance, 0.0, each.yaw_rate_radps),
        )
        for each in drive.estimates
    ]
    matched(case, replace(drive, estimates=estimates))


@pytest.mark.parametrize("seed", FEW)
def test_stretch_that_the_map_has_wrong_by_a_metre_is_borne(seed: int) -> None:
    """Rails 1 m beside the map with σ 0.5 m, all the way: the track is right, and so is along."""
    case = networks.curved()
    line = case.lines["track"]
    offset = (0.7, -0.7)
    drive = driven(line, steady(line.length_m - 10.0, 8.0), Noise(0.3, offset_l=offset), seed)
    said = matched(case, drive, Map(network=""))
    assert (said.run == case.run("track")).all()
    assert (said.probability[100:] > 0.9).all()


# Memory -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("at", [30, 600, 800, 1100, 1500])
def test_restored_matcher_says_the_same_to_the_last_bit(at: int) -> None:
    """In the stem, at the switch, standing, on the way back and on again."""
    case = networks.switch()
    drive = driven(case.path("stem", "branch"), _from(20.0), seed=1)
    matcher, frame = Matcher(case.network, SETTINGS), MapFrame(case.network, FILTER_LEVEL)
    for estimate in drive.estimates[:at]:
        matcher.step(estimate, frame)
    kept, laid = to_plain(matcher.remembered), copied(frame.memory)
    rest: Sequence = drive.estimates[at : at + 800]
    expected = [repr(matcher.step(each, frame)) for each in rest]
    other, other_frame = Matcher(case.network, SETTINGS), MapFrame(case.network, FILTER_LEVEL, laid)
    assign(other.remembered, from_plain(HypothesesMemory, kept))
    assert [repr(other.step(each, other_frame)) for each in rest] == expected


def test_same_ride_twice_gives_the_same_matches() -> None:
    case = networks.passing_loop()
    drive = driven(case.path("before", "left", "behind"), steady(400.0, 8.0), Noise(2.0), 1)
    first, second = (matched(case, drive).matches for _ in range(2))
    assert repr(first) == repr(second)


def test_estimates_are_left_as_they_are() -> None:
    case = networks.switch()
    drive = driven(case.path("stem", "branch"), steady(400.0, 8.0))
    before = [each.values.copy() for each in drive.estimates]
    matched(case, drive)
    for kept, each in zip(before, drive.estimates, strict=True):
        np.testing.assert_array_equal(kept, each.values)


def test_reading_properties_changes_nothing() -> None:
    case = networks.switch()
    said = matched(case, driven(case.path("stem", "branch"), steady(350.0, 8.0)))
    matcher = said.matcher
    before = matcher.memory.copy()
    for _ in range(2):
        values = matcher.east, matcher.north, matcher.away_m(), matcher.hypotheses
        assert values == (matcher.east, matcher.north, matcher.away_m(), matcher.hypotheses)
    np.testing.assert_array_equal(matcher.memory, before)
    run = case.run("branch")
    assert matcher.name_of(run) == matcher.name_of(run) == case.network.name_of(run)
    e, n, _, _ = place(rails_of(case.network), run, said.matches[-1].chainage_m)
    assert (said.matches[-1].east, said.matches[-1].north) == pytest.approx((e, n), abs=MM)
    assert case.network.level == LEVEL
