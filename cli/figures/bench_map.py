"""Figures of the map: how fast a network is read, and what matching costs on it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from msgspec.structs import replace

from tramstream.analysis.studies import matching as study
from tramstream.analysis.studies.frames import frames
from tramstream.cli.figures.bench_filter import median_us
from tramstream.cli.figures.bench_stages import Figure, median_s
from tramstream.config import Map, Vehicle
from tramstream.estimation.localiser import Estimate
from tramstream.geodesy import LocalLevel
from tramstream.processor import Sample
from tramstream.processors.localisation.matching import Matched
from tramstream.processors.localisation.models import localiser
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.tracks import network as networks

RIDE_S = 240.0
LOAD_GOAL_S, MATCH_GOAL_US, RATIO_GOAL, MEMORY_GOAL_MB = 0.3, 100.0, 2.0, 150.0
_MEMORY = """
import sys
from pathlib import Path
from tramstream import network
from tramstream.machine import machine_code
from tramstream.config import Map, Vehicle
from tramstream.processors.matching.matcher import Matcher
def mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
before = mb()
matcher = Matcher(network.load(Path(sys.argv[1])), Map(network=""))
print(mb() - before)
"""


def measure(net: Path) -> list[Figure]:
    """Ride along the first line of a network, with the scenario `matching`.

    `map_match_us`: a match with its message. `map_filter_ratio`: the localisation processor with
    the map over the same without. Both on moving and standing stretches as they come.

    Raises
    ------
    ConfigError
        If the network cannot be read or has no line.
    """
    load_s = median_s(lambda: networks.load(net))
    network = study.load(str(net))
    case = study.Case(str(net), study.lines(network)[0], duration_s=RIDE_S)
    simulation = study.simulation_of(case, study.ride_of(case))
    mapped = replace(simulation.vehicle, map=Map(network=str(net)))
    made = list(frames(simulation, []))
    without_us, with_us = (
        median_us(LocalisationFilter(vehicle).step, made)
        for vehicle in (simulation.vehicle, mapped)
    )
    matched = Matched(mapped)
    match_us = median_us(lambda each: matched.take(*each), list(_estimates(mapped, made)))
    memory = subprocess.run(
        [sys.executable, "-c", _MEMORY, str(net)], capture_output=True, text=True, check=True
    )
    return [
        Figure("map_load_s", load_s, LOAD_GOAL_S, False),
        Figure("map_match_us", match_us, MATCH_GOAL_US, False),
        Figure("map_filter_ratio", with_us / without_us, RATIO_GOAL, False),
        Figure("map_memory_mb", float(memory.stdout), MEMORY_GOAL_MB, False),
    ]


def _estimates(vehicle: Vehicle, made: list[Sample]) -> Iterator[tuple[Estimate, LocalLevel]]:
    """What a filter says, and in which frame."""
    filtered = localiser(vehicle)
    for frame in made:
        estimate = filtered.take(frame.message)
        if estimate is not None and filtered.level is not None:
            yield estimate, filtered.level
