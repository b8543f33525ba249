"""Simulated rides for tests of the localisation filters: frames in memory, and errors to truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.studies.frames import frames
from tramstream.clock import S
from tramstream.estimation.localiser import Estimate, Localiser
from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, parse_plan
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation import scenario
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation

Array = NDArray[np.float64]

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
EVERY = 5
"""Judged frames: 20 Hz."""


@cache
def laid(plan: str, yaw_deg: float = 20.0) -> Line:
    """A level line out of a plan; see `tramstream.lines.line.parse_plan`."""
    segments, stops_m = parse_plan(plan)
    return Line(segments, stops_m, LEVEL, math.radians(yaw_deg))


def altered(base: Any, **changes: Any) -> Any:
    """A configuration with some fields changed; a dictionary changes fields of a section."""
    fields = {}
    for name, value in changes.items():
        section = getattr(base, name)
        fields[name] = (
            altered(section, **value) if isinstance(value, dict) and section is not None else value
        )
    return msgspec.structs.replace(base, **fields)


@cache
def reference() -> Scenario:
    """The sensors of kaspar2023: 100 Hz IMU, 1 Hz fixes, two wheels."""
    return scenario.load("kaspar2023")


@dataclass(frozen=True)
class Ride:
    """A simulated ride as the filter sees it."""

    simulation: Simulation
    frames: list[SyncFrame]

    def between(self, start_s: float, end_s: float) -> list[SyncFrame]:
        """Frames of a part of the ride."""
        return [each for each in self.frames if start_s < time_s(each.stamp_ns) <= end_s]

    def arrival_s(self, stop: int) -> float:
        return float(self.simulation.ride.dwells_s[stop - 1, 0])

    def departure_s(self, stop: int) -> float:
        return float(self.simulation.ride.dwells_s[stop - 1, 1])


def time_s(stamp_ns: int) -> float:
    """Time of the ride."""
    return (stamp_ns - EPOCH_NS) / S


def ridden(line: Line, chosen: Scenario, seed: int, duration_s: float | None = None) -> Ride:
    """Simulate a ride and put it through the resampler."""
    simulation = Simulation(line, chosen, seed, duration_s)
    return Ride(simulation, [frame.message for frame in frames(simulation, [])])


@dataclass(frozen=True)
class Errors:
    """Estimate minus truth at some instants of a ride; times are those of the ride."""

    time_s: Array
    p_l: Array
    """(n, 3): of the position, in the line's frame."""
    along_m: Array
    across_m: Array
    speed_mps: Array
    yaw_rad: Array
    estimate_l: Array
    """(n, 3): the position itself."""
    covariance: Array
    """(n, 7, 7): what was claimed."""
    mode: NDArray[np.int64]
    standing: NDArray[np.bool_]
    stands: NDArray[np.bool_]
    """Whether the vehicle truly stands."""
    speed: Array
    """As estimated."""

    @property
    def horizontal_m(self) -> Array:
        return np.hypot(self.p_l[:, 0], self.p_l[:, 1])

    def within(self, start_s: float, end_s: float) -> Errors:
        """Those of a part of the ride."""
        chosen = (self.time_s >= start_s) & (self.time_s <= end_s)
        return Errors(**{name: column[chosen] for name, column in vars(self).items()})

    def at(self, instant_s: float) -> Errors:
        """The one nearest to an instant."""
        nearest = int(np.abs(self.time_s - instant_s).argmin())
        return Errors(**{name: col[nearest : nearest + 1] for name, col in vars(self).items()})


def run(localiser: Localiser, frames: Iterable[SyncFrame], every: int = EVERY) -> list[Estimate]:
    """Every so many estimates of `localiser` on `frames`."""
    kept = []
    for number, frame in enumerate(frames):
        estimate = localiser.take(frame)
        if estimate is not None and number % every == 0:
            kept.append(estimate)
    return kept


def judged(simulation: Simulation, localiser: Localiser, kept: Sequence[Estimate]) -> Errors:
    """Hold estimates to the truth."""
    stamps = np.array([each.stamp_ns for each in kept])
    level = localiser.level
    assert level is not None
    geodetic = level.to_geodetic(np.array([each.p_l for each in kept]))
    estimate_l = simulation.line.level.from_geodetic(geodetic)
    truth = simulation.truth(stamps)
    turned = (simulation.line.level.longitude_rad - level.longitude_rad) * math.sin(
        level.latitude_rad
    )  # meridians of the two frames converge
    p_l = estimate_l - truth.p_l
    cos, sin = np.cos(truth.motion.yaw_rad), np.sin(truth.motion.yaw_rad)
    speed = np.array([each.speed_mps for each in kept])
    yaw = np.array([each.yaw_rad for each in kept]) - turned - truth.motion.yaw_rad
    return Errors(
        time_s=(stamps - EPOCH_NS) / S,
        p_l=p_l,
        along_m=cos * p_l[:, 0] + sin * p_l[:, 1],
        across_m=cos * p_l[:, 1] - sin * p_l[:, 0],
        speed_mps=speed - truth.motion.speed_mps,
        yaw_rad=np.remainder(yaw + np.pi, 2 * np.pi) - np.pi,
        estimate_l=estimate_l,
        covariance=np.array([each.covariance for each in kept]),
        mode=np.array([each.mode for each in kept]),
        standing=np.array([each.standing for each in kept]),
        stands=truth.motion.standing,
        speed=speed,
    )


def localised(ride: Ride, frames: Sequence[SyncFrame] | None = None) -> Errors:
    """Errors of the filter `tram` on a whole ride, or on other frames of it."""
    localiser = TramLocaliser(ride.simulation.vehicle)
    kept = run(localiser, ride.frames if frames is None else frames)
    return judged(ride.simulation, localiser, kept)
