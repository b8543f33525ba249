"""Figures of the localisation filter: on frames of a simulated ride, compile time excluded."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from tramstream.analysis.studies.frames import frames
from tramstream.cli.figures.bench_stages import Figure
from tramstream.estimation.localiser import TRACKING
from tramstream.lines.line import built_in_line
from tramstream.memory.stage import from_plain
from tramstream.processor import Sample
from tramstream.processors.consistency.processor import ConfigurationCheck
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation

RIDE_S = 150.0
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


STAGES: dict[str, Callable[[], list[Figure]]] = {"ekf": ekf}
