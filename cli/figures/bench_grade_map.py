"""Figures of the grade map: what merging 300 rides of 12 km takes, and one more; no filter runs.

Rides are drawn, not smoothed: a line of hills, a bias for each ride, noise for each cell. Smoothing
is `reprocess --smooth`; `docs/grade-map.md` has its figures.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tramstream.analysis.grade_map import file
from tramstream.analysis.grade_map.assemble import assemble, rides_of
from tramstream.analysis.grade_map.cells import cells_of
from tramstream.analysis.grade_map.heights import Priors
from tramstream.analysis.grade_map.passes import Passes, Ride
from tramstream.cli.figures.bench_stages import Figure
from tramstream.lines.line import built_in_line
from tramstream.simulation.line_map import network_of
from tramstream.tracks.network import Network

RIDES = 300
BIAS_RAD, NOISE_RAD = 5e-4, 1e-3
ADD_GOAL_S = 1.0
_CHILD = "from tramstream.cli.figures.bench_grade_map import child; child()"


def measure() -> list[Figure]:
    """Measure in a process of its own, whose memory is that of nothing else."""
    file.libraries()  # if it is not installed, one sentence says so
    done = subprocess.run([sys.executable, "-c", _CHILD], capture_output=True, check=True)
    goals = {"grade_map_add_s": ADD_GOAL_S}
    return [
        Figure(name, value, goals.get(name), False)
        for name, value in json.loads(done.stdout).items()
    ]


def child() -> None:
    """Print the figures as JSON.

    `grade_map_merge_s`: all rides at once. `grade_map_add_s`: the map of all but one read, the last
    ride merged in, the map written. `grade_map_memory_mb`: above what the rides and the imports
    take.
    """
    network = network_of(built_in_line(), 0.0, np.random.default_rng(0))
    rides = [drawn(network, seed) for seed in range(RIDES)]
    nothing = Priors((), 0.0)
    assemble(network, [drawn(network, seed, 0.05) for seed in range(3)], nothing)  # loads all
    before_mb = _most_mb()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.parquet"
        began_s = time.perf_counter()
        made = assemble(network, rides, nothing)
        merge_s = time.perf_counter() - began_s
        file.write(made, path)
        size_mb = path.stat().st_size / 1e6
        memory_mb = _most_mb() - before_mb
        file.write(assemble(network, rides[:-1], nothing), path)
        began_s = time.perf_counter()
        known = rides_of(file.read(path), network)
        file.write(assemble(network, [*known, rides[-1]], nothing), path)
        add_s = time.perf_counter() - began_s
    figures = {
        "grade_map_cells": float(len(made)),
        "grade_map_merge_s": merge_s,
        "grade_map_add_s": add_s,
        "grade_map_mb": size_mb,
        "grade_map_memory_mb": memory_mb,
    }
    print(json.dumps(figures))


def _most_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def drawn(network: Network, seed: int, share: float = 1.0) -> Ride:
    """A ride over all tracks, or the first share of the cells, every other one backwards."""
    rng = np.random.default_rng(seed)
    count = round(share * int(cells_of(network).starts[-1]))
    cell = np.arange(count)
    sign = 1 - 2 * (seed % 2)
    grade = 0.04 * np.sin(cell / 15.0) + sign * BIAS_RAD * rng.standard_normal()
    passes = Passes(
        cell.astype(np.int32),
        np.full(count, sign, dtype=np.int8),
        (grade + NOISE_RAD * rng.standard_normal(count)).astype(np.float32),
        np.full(count, NOISE_RAD, dtype=np.float32) * rng.uniform(0.9, 1.1, count).astype("f4"),
        rng.normal(250.0, 1.0, count).astype(np.float32),
        np.full(count, 1.0, dtype=np.float32),
    )
    way_m = 5.0 * count
    return Ride(f"{seed}", f"{seed:016x}", "bench", 1, 0.0, 0.0, False, way_m, 0, 0, 0, passes)
