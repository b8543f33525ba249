"""Compiles every kernel that a vehicle uses: `python -m tramstream.processors.warm_up`.

A short simulated ride goes through the resampler and the localisation filter with a map, as
messages would on the vehicle; what no such ride meets is called by hand, and so is the matcher, by
which a second process can begin (`python -m tramstream.processors.warm_up 1 2`: the second of two).
The parts only divide the work: each process goes through all of them.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from tramstream.config import Ekf, Map, Vehicle
from tramstream.estimation.localiser import (
    HEADING_UNKNOWN,
    TRACKING,
    Estimate,
    values_of,
)
from tramstream.graph import Graph
from tramstream.lines.line import Line, built_in_line
from tramstream.machine import kernels, machine_code
from tramstream.processors.distance.processor import DistanceFilter
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.matcher import Matcher
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.resampling.resampler import Resampler
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.gnss_velocity import GnssVelocity
from tramstream.processors.tram_model.track import TrackDistance, TrackGrade, TrackHeading
from tramstream.processors.tram_model.vertical_constraint import VerticalConstraint
from tramstream.processors.tram_model.wheel_speed import WheelSpeed
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation
from tramstream.tracks.map_frame import MapFrame
from tramstream.tracks.network import FORWARDS, Network
from tramstream.tracks.signature import of_line

PROCESSORS = (
    *(Resampler, DistanceFilter, LocalisationFilter, MapMatcher, GradeEstimator),
    SegmentFinder,
)
RIDE_S = 50.0
"""Standing, departure, alignment, a curve."""
MAPPED_M = 600.0
"""More than the ride goes."""


def compile_all(first: int = 0) -> None:
    """Call all kernels once, beginning with part number `first`."""
    parts = (_go_on_a_ride, _match, _measure, _find_place)
    for k in range(len(parts)):
        parts[(first + k) % len(parts)]()


def _go_on_a_ride() -> None:
    simulation = Simulation(built_in_line(), scenario.load("city"), 1, RIDE_S)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.tracks"
        one_track(simulation.line).save(path)
        vehicle = msgspec.structs.replace(simulation.vehicle, map=Map(network=str(path)))
        graph = Graph([made(vehicle) for made in PROCESSORS])
    for sent in simulation.samples():
        graph.step(sent)


def _match() -> None:
    """Look for the track and follow it, before the heading is known and after."""
    line = built_in_line()
    network = one_track(line)
    matcher = Matcher(network, Map(network=""))
    frame = MapFrame(network, line.level)
    for k in range(40):
        place = line.position_l(np.array([2.0 * k]))[0]
        motion = (*place, 10.0, 0.0, 0.0, float(line.yaw_rad(np.array([2.0 * k]))[0]))
        values = values_of(motion, np.eye(7) * 0.01, 0.0, 0.0)
        mode = HEADING_UNKNOWN if k < 2 else TRACKING
        matcher.step(Estimate(1 + 200_000_000 * (k + 1), mode, values, standing=k < 2), frame)


def _find_place() -> None:
    """Compile what looks for a place on a line."""
    SegmentFinder(Vehicle(vehicle="none"), [of_line(built_in_line())])


def _measure() -> None:
    """Take the measurements that the ride has not."""
    ekf = TramFilter(Vehicle(vehicle="none", ekf=Ekf()), 9.81)
    for measurement in (
        WheelSpeed(0, 0.0, 1.0),
        GnssVelocity(0.0, 0.0, 1.0),
        TrackDistance(0.0, 1.0, 0.0, 1.0),
        TrackHeading(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        TrackGrade(0.0, 1.0),
        VerticalConstraint(),
    ):
        ekf.apply(measurement)


def one_track(line: Line) -> Network:
    """The begin of a line as a network, exact: building one from a map has kernels of its own."""
    count = int(MAPPED_M) + 1
    at = np.linspace(0.0, MAPPED_M, count)
    plan = line.position_l(at)
    integers, singles = np.zeros(1, np.int32), np.zeros(count, np.float32)
    return Network(
        latitude_rad=line.level.latitude_rad,
        longitude_rad=line.level.longitude_rad,
        height_m=line.level.height_m,
        starts=np.array([0, count], np.int32),
        length_m=np.array([MAPPED_M]),
        rules=np.array([FORWARDS], np.int8),
        from_node=integers,
        to_node=integers + np.int32(1),
        node_id=np.arange(2),
        node_switch=np.zeros(2, np.int8),
        following_starts=np.zeros(3, np.int32),
        following=integers[:0],
        east=plan[:, 0].copy(),
        north=plan[:, 1].copy(),
        yaw_rad=line.yaw_rad(at),
        curvature_per_m=line.curvature_per_m(at),
        across_std_m=singles,
        yaw_std_rad=singles,
        height=singles,
        grade_rad=singles,
        grade_std_rad=singles + np.float32(0.01),
        partner=np.zeros(count, np.int8),
    )


if __name__ == "__main__":
    os.umask(0o077)  # what is run is nobody else's
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    compile_all(number)
    machine_code.mark_complete(kernels.used())
