"""Figures of the localisation filter: on frames of a simulated ride, compile time excluded."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from tramstream import keys
from tramstream.analysis.studies.frames import frames
from tramstream.cli.figures.bench_stages import Figure
from tramstream.estimation.localiser import TRACKING
from tramstream.lines.line import built_in_line
from tramstream.memory.stage import from_plain
from tramstream.processor import Sample
from tramstream.processors.consistency.processor import ConfigurationCheck
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.proto.estimate_pb2 import MapMatch
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation
from tramstream.tracks.signature import of_line

RIDE_S = 150.0
GRADE_RIDE_S = 60.0
CHUNK = 250
"""Steps that are timed at a time; the median of the chunks counts."""


def ekf() -> list[Figure]:
    """Measure the filter alone, with all that is published, and the configuration's check.

    `ekf_step_us`: prediction, lateral force, and the odometry and GNSS that fall into a step.
    `localisation_step_us`: the whole processor, standstill detection, prediction to now and two
    messages included. `configuration_check_us`: a frame through the check, which is to take less
    than a hundredth of a core.
    """
    # IMU at 100 Hz, two wheels at 50 Hz, GNSS at 1 Hz.
    simulation = Simulation(built_in_line(), scenario.load("kaspar2023"), 1, RIDE_S)
    made, vehicle = list(frames(simulation, [])), simulation.vehicle
    whole = LocalisationFilter(vehicle)
    navigation: Navigation | None = None
    rest: list[Sample] = []
    for index, frame in enumerate(made):
        whole.step(frame)
        estimate = whole.localiser.ahead()
        if estimate is not None and estimate.mode == TRACKING and not estimate.standing:
            level = whole.localiser.level
            assert level is not None  # there is an estimate
            navigation = Navigation(vehicle, level)
            state = whole.localiser.snapshot()["navigation"]
            assert state is not None
            navigation.go_back(from_plain(NavigationMemory, state))
            rest = made[index + 1 :]
            break
    assert navigation is not None, "the ride is long enough to find its heading"
    noise = navigation.reading[:6] * 0.0

    def step(frame: Sample) -> None:
        navigation.read(frame.message)
        navigation.run(frame.message, False, noise)

    check_us = median_us(ConfigurationCheck(vehicle).step, made)
    return [
        Figure("ekf_step_us", median_us(step, rest), 15.0, False),
        Figure("localisation_step_us", median_us(lambda frame: whole.step(frame), rest)),
        Figure("configuration_check_us", check_us, 100.0, False),
    ]


def median_us(step: Callable[[Any], object], frames: Sequence[Any]) -> float:
    """Median over chunks of the time of a step; the first chunk does not count."""
    found = []
    for begin in range(0, len(frames) - CHUNK, CHUNK):
        started = time.perf_counter()
        for frame in frames[begin : begin + CHUNK]:
            step(frame)
        found.append(1e6 * (time.perf_counter() - started) / CHUNK)
    found = sorted(found[1:])
    return found[len(found) // 2]


def grade() -> list[Figure]:
    """Measure the slope's processor: a frame with the state and the match that belong to it.

    Frames are those of `city`, with fixes at 5 Hz, wheels and motor force at 50 Hz; the states are
    the localisation filter's, the matches made by hand. All that is published is included.
    """
    simulation = Simulation(built_in_line(), scenario.load("city"), 1, GRADE_RIDE_S)
    vehicle = simulation.vehicle
    localisation = LocalisationFilter(vehicle)
    groups: list[tuple[Sample, ...]] = []
    for frame in frames(simulation, []):
        states = [each for each in localisation.step(frame) if each.key is keys.EST_STATE]
        groups.append((frame, *states, *(_match(each) for each in states)))
    estimator = GradeEstimator(vehicle)

    def step(group: tuple[Sample, ...]) -> None:
        for sample in group:
            estimator.step(sample)

    return [Figure("grade_step_us", median_us(step, groups), 8.0, False)]


def _match(state: Sample) -> Sample:
    """A match of a state's instant, like the map matcher's."""
    message = MapMatch(
        stamp_ns=state.stamp_ns,
        sequence=state.sequence,
        state=MapMatch.ON_TRACK,
        edge="1234567890-2345678901",
        chainage_m=100.0,
        probability=0.99,
    )
    return Sample(keys.MAP_MATCH, message, state.stamp_ns, state.sequence)


def segments() -> list[Figure]:
    """Measure the processor of stops, turns and places: frames of `city`, a place being looked for.

    `segments_us` is a frame's median, `segments_place_us` its mean over the ride with the built-in
    line to look for, the search with no idea where it is included.
    """
    simulation = Simulation(built_in_line(), scenario.load("city"), 1, GRADE_RIDE_S)
    made, vehicle = list(frames(simulation, [])), simulation.vehicle
    alone = SegmentFinder(vehicle)
    finder = SegmentFinder(vehicle, [of_line(simulation.line)])
    median = median_us(alone.step, made)
    started = time.perf_counter()
    for frame in made:
        finder.step(frame)
    mean = 1e6 * (time.perf_counter() - started) / len(made)
    return [
        Figure("segments_us", median, 15.0, False),
        Figure("segments_place_us", mean),
    ]


STAGES: dict[str, Callable[[], list[Figure]]] = {
    "ekf": ekf,
    "grade": grade,
    "segments": segments,
}
