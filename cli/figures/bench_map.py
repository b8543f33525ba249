"""Figures of the map: how fast a network is read, and what matching costs on it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from msgspec.structs import replace

from tramstream import keys
from tramstream.analysis.studies import matching as study
from tramstream.analysis.studies.frames import frames
from tramstream.cli.figures.bench_filter import median_us
from tramstream.cli.figures.bench_stages import Figure, median_s
from tramstream.config import Map
from tramstream.graph import Graph
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.tracks import network as networks

RIDE_S = 240.0
LOAD_GOAL_S, MATCH_GOAL_US, RATIO_GOAL, MEMORY_GOAL_MB = 0.3, 100.0, 2.0, 150.0
_MEMORY = """
import sys
from pathlib import Path
from tramstream.config import Map
from tramstream.processors.matching.matcher import Matcher
from tramstream.tracks import network
def mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
before = mb()
matcher = Matcher(network.load(Path(sys.argv[1])), Map(network=""))
print(mb() - before)
"""


def measure(net: Path) -> list[Figure]:
    """Ride along the first line of a network, with the scenario `matching`.

    `map_match_us`: a state matched, with its messages. `map_filter_ratio`: localisation filter and
    map matcher over the filter alone. Both on moving and standing stretches as they come.

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
    together = Graph([LocalisationFilter(mapped), MapMatcher(mapped)])
    without_us = median_us(LocalisationFilter(simulation.vehicle).step, made)
    with_us = median_us(together.step, made)
    alone = LocalisationFilter(mapped)
    states = [each for frame in made for each in alone.step(frame) if each.key is keys.EST_STATE]
    match_us = median_us(MapMatcher(mapped).step, states)
    memory = subprocess.run(
        [sys.executable, "-c", _MEMORY, str(net)], capture_output=True, text=True, check=True
    )
    return [
        Figure("map_load_s", load_s, LOAD_GOAL_S, False),
        Figure("map_match_us", match_us, MATCH_GOAL_US, False),
        Figure("map_filter_ratio", with_us / without_us, RATIO_GOAL, False),
        Figure("map_memory_mb", float(memory.stdout), MEMORY_GOAL_MB, False),
    ]
