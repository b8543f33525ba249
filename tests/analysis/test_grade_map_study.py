"""Whole simulated rides through filter, smoother and matcher into a grade map, held to the line.

`pytest -m study -s tests/analysis/test_grade_map_study.py` prints the figures of docs/grade-map.md.
"""

from __future__ import annotations

import os
import time
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tramstream.analysis.grade_map.assemble import GradeMap, assemble
from tramstream.analysis.grade_map.heights import Priors
from tramstream.analysis.grade_map.passes import Ride
from tramstream.analysis.grade_map.record import ride_of
from tramstream.analysis.notebook.rides import write_ride
from tramstream.lines.line import Line, built_in_line
from tramstream.simulation import scenario as scenarios
from tramstream.simulation.line_map import network_of
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import Simulation
from tramstream.tracks.network import Network

NOTHING = Priors((), 0.0)
NODE_STD_M = 0.1
MINUTES = float(os.environ.get("TRAMSTREAM_GRADE_MINUTES", "10"))
RIDES = int(os.environ.get("TRAMSTREAM_GRADE_RIDES", "6"))


@cache
def line_and_network() -> tuple[Line, Network]:
    line = built_in_line()
    return line, network_of(line, NODE_STD_M, np.random.default_rng(3))


def ridden(folder: Path, chosen: Scenario, seed: int, duration_s: float) -> Ride:
    """A ride; every other one with the rear cab leading, so that x points against the line."""
    line, network = line_and_network()
    net = folder / "line.net"
    if not net.exists():
        network.save(net)
    turned = msgspec.structs.replace(chosen, reverse=bool(seed % 2))
    record = folder / f"ride{seed}.mcap"
    write_ride(Simulation(line, turned, seed, duration_s), record, {})
    began_s = time.perf_counter()
    found = ride_of(record, net)
    print(f"seed {seed}: {time.perf_counter() - began_s:.1f} s of {duration_s:g} s")
    assert isinstance(found, Ride), found
    return found


def true_slope(made: GradeMap) -> np.ndarray:
    """Mean slope of the line over each cell, rad; a network's chainage is along its plan."""
    line, _ = line_and_network()
    s = np.arange(0.0, line.length_m, 0.5)
    plan = np.concatenate([[0.0], np.cumsum(0.5 * np.cos(line.grade(s[:-1] + 0.25)))])
    climb = np.concatenate([[0.0], np.cumsum(0.5 * np.sin(line.grade(s[:-1] + 0.25)))])
    from_m, to_m = made.columns["from_m"], made.columns["to_m"]
    rise = np.interp(to_m, plan, climb) - np.interp(from_m, plan, climb)
    slope: np.ndarray = np.arctan(rise / (to_m - from_m))
    return slope


def figures(made: GradeMap) -> tuple[float, float, float]:
    """RMS of the error, %; median σ, %; NEES."""
    known = np.isfinite(made.columns["grade_rad"])
    error = (made.columns["grade_rad"] - true_slope(made))[known]
    std = made.columns["grade_std_rad"][known]
    rms = float(np.sqrt(np.mean(error**2)))
    return 100 * rms, 100 * float(np.median(std)), float(np.mean((error / std) ** 2))


def scenario_of(name: str) -> Scenario:
    """A built-in one; or the sensors of kaspar2023 as a city's driver drives them, in a body whose
    springs nobody knows or without."""
    if not name.startswith("reference"):
        return scenarios.load(name)
    chosen, tram = scenarios.load("kaspar2023"), scenarios.load("tram")
    driver = msgspec.structs.replace(tram.driver, dwell_s=10.0, first_dwell_s=15.0)
    chosen = msgspec.structs.replace(chosen, driver=driver)
    if "body" not in name:
        return chosen
    ekf = msgspec.structs.replace(
        chosen.ekf, pivot_m=3.2, bogie_distance_m=6.4, force_std_mps2_rthz=0.003
    )
    return msgspec.structs.replace(chosen, body=tram.body, ekf=ekf)


@pytest.mark.study
@pytest.mark.parametrize("name", ["reference", "reference with body", "city", "tram"])
def test_rides_of_a_line_merged(tmp_path: Path, name: str) -> None:
    chosen = scenario_of(name)
    rides = [ridden(tmp_path, chosen, seed, 60 * MINUTES) for seed in range(1, RIDES + 1)]
    for ride in rides:
        print(f"nod {np.degrees(ride.nod):.3f} ± {np.degrees(ride.nod_std):.3f} deg per m/s²")
    for count in range(1, len(rides) + 1):
        made = assemble(line_and_network()[1], rides[:count], NOTHING)
        rms, std, nees = figures(made)
        print(f"{name}, {count} rides: {rms:.3f} %, σ {std:.3f} %, NEES {nees:.2f}")
        for ride in made.rides:
            told = f"{ride.name}: bias {100 * ride.bias_rad:+.3f} %, scatter {ride.scatter}"
            print("   ", told, ride.out)
    # All cells of one map share one bias: of one map it is no more than plausible.
    assert nees < 6.6
