"""Motion along a line: a speed profile with bounded jerk, and the truth of the ride at any time.

The line is cut where the permitted speed changes (√(lateral limit / curvature), at most the limit)
and at the stops. At each cut the speed is the highest that both sides permit and that can be
reached from the neighbouring cuts, with no acceleration there; between two cuts the speed rises to
a top, keeps it, and falls. So the whole ride is a table of phases of constant jerk, and arc length,
speed and acceleration are polynomials of time: exact at every instant, forwards or at random.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.line import Line
from tramstream.proto import raw_pb2

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """How the driver drives: theory.md section 3, simulation of the reference."""

    speed_mps: float = 15.0
    acceleration_mps2: float = 0.5
    jerk_mps3: float = 0.2
    lateral_mps2: float = 0.1
    dwell_s: float = 8.0
    first_dwell_s: float = 2.0
    """Short, so that a demo sees a departure at once."""


class Motion(NamedTuple):
    """Where the vehicle's origin is on the line, and how it moves; one row an instant."""

    arc_length_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    yaw_rad: Array
    yaw_rate_radps: Array
    standing: NDArray[np.bool_]


class Ride:
    """A ride from the first stop of a line to the last; it stands before, after and between.

    Time is that of the ride, in seconds from its start.

    Parameters
    ----------
    line : Line
        The geometry; its first stop is where the ride starts.
    limits : Limits
        What the driver keeps to.
    """

    DOOR_S = 1.0
    """Doors open so long after the stop and close so long before the departure."""

    def __init__(self, line: Line, limits: Limits | None = None) -> None:
        self.line = line
        self.limits = limits or Limits()
        self.phases = plan(line, self.limits)
        self._standing = (self.phases.v0 == 0) & (self.phases.a0 == 0) & (self.phases.jerk == 0)
        ends = np.append(self.phases.t0[1:], np.inf)
        self.dwells_s = np.stack([self.phases.t0[self._standing], ends[self._standing]], axis=1)
        """Arrival and departure at each stop, shape (stops, 2); the last never ends."""

    @property
    def duration_s(self) -> float:
        """From the start until standstill at the last stop."""
        return float(self.phases.t0[-1])

    def motion(self, time_s: ArrayLike) -> Motion:
        """Arc length and yaw with their rates at each instant."""
        time = np.maximum(np.asarray(time_s, dtype=float), 0.0)
        phases = self.phases
        index = np.searchsorted(phases.t0, time, side="right") - 1
        dt = time - phases.t0[index]
        v0, a0, jerk = phases.v0[index], phases.a0[index], phases.jerk[index]
        arc_length = phases.s0[index] + dt * (v0 + dt * (a0 / 2 + dt * jerk / 6))
        speed = v0 + dt * (a0 + dt * jerk / 2)
        yaw_rate = self.line.curvature_per_m(arc_length) * speed
        return Motion(
            arc_length,
            speed,
            a0 + dt * jerk,
            self.line.yaw_rad(arc_length),
            yaw_rate,
            self._standing[index],
        )

    def position_l(self, time_s: ArrayLike) -> Array:
        """Position of the vehicle's origin in `l`, m; shape (n, 3) for n instants."""
        return self.line.position_l(self.motion(time_s).arc_length_m)

    def doors_open(self, time_s: ArrayLike) -> NDArray[np.bool_]:
        """Whether the doors are open: at stops, but for `DOOR_S` at either end."""
        time = np.asarray(time_s, dtype=float)
        arrival, departure = self.dwells_s.T
        index = np.maximum(np.searchsorted(arrival, time, side="right") - 1, 0)
        opened: NDArray[np.bool_] = (time >= arrival[index] + self.DOOR_S) & (
            time < departure[index] - self.DOOR_S
        )
        return opened

    def truth(self, time_s: float, stamp_ns: int) -> raw_pb2.TruthState:
        """Give the truth at `time_s` of the ride as a message stamped `stamp_ns`."""
        motion = self.motion(time_s)
        latitude, longitude, height = self.line.level.to_geodetic(
            self.line.position_l(motion.arc_length_m)
        )
        return raw_pb2.TruthState(
            stamp_ns=stamp_ns,
            arc_length_m=float(motion.arc_length_m),
            speed_mps=float(motion.speed_mps),
            acceleration_mps2=float(motion.acceleration_mps2),
            latitude_deg=math.degrees(latitude),
            longitude_deg=math.degrees(longitude),
            height_ellipsoid_m=float(height),
            yaw_rad=math.remainder(float(motion.yaw_rad), math.tau),
            yaw_rate_radps=float(motion.yaw_rate_radps),
            standing=bool(motion.standing),
        )


class Phases(NamedTuple):
    """Constant jerk from `t0` on, until the next phase; the state at `t0`."""

    t0: Array
    s0: Array
    v0: Array
    a0: Array
    jerk: Array


class Region(NamedTuple):
    """Track of one permitted speed between two cuts; `stop` if the vehicle halts at its end."""

    start_m: float
    end_m: float
    limit_mps: float
    stop: bool


def regions(line: Line, limits: Limits) -> list[Region]:
    """Cut a line where the permitted speed changes and at its stops."""
    found: list[Region] = []
    stops = {float(stop) for stop in line.stops_m}
    first, last = float(line.stops_m[0]), float(line.stops_m[-1])
    cuts = sorted({float(start) for start in line.starts_m} | stops)
    for start, end in pairwise(cut for cut in cuts if first <= cut <= last):
        bent = max(abs(line.curvature_per_m([start, (start + end) / 2, np.nextafter(end, start)])))
        limit = limits.speed_mps
        if bent > 0:
            limit = min(limit, math.sqrt(limits.lateral_mps2 / bent))
        before = found[-1] if found else None
        if before and not before.stop and math.isclose(before.limit_mps, limit):
            found[-1] = Region(before.start_m, end, min(before.limit_mps, limit), end in stops)
        else:
            found.append(Region(start, end, limit, end in stops))
    return found


def plan(line: Line, limits: Limits) -> Phases:
    """Plan a ride from the first stop to the last as phases of constant jerk."""
    parts = regions(line, limits)
    speeds = _cut_speeds(parts, limits)
    rows: list[tuple[float, float, float, float, float]] = []
    first_m = parts[0].start_m
    rows.append((0.0, first_m, 0.0, 0.0, 0.0))
    time = limits.first_dwell_s
    for part, v0, v1 in zip(parts, speeds[:-1], speeds[1:], strict=True):
        s, v, a = part.start_m, v0, 0.0
        for duration, jerk in _region_phases(part.end_m - part.start_m, v0, v1, part, limits):
            rows.append((time, s, v, a, jerk))
            s += duration * (v + duration * (a / 2 + duration * jerk / 6))
            v += duration * (a + duration * jerk / 2)
            a += duration * jerk
            time += duration
        if part.stop:
            rows.append((time, part.end_m, 0.0, 0.0, 0.0))
            time += limits.dwell_s
    return Phases(*(np.array(column) for column in zip(*rows, strict=True)))


def _cut_speeds(parts: list[Region], limits: Limits) -> list[float]:
    """Highest speed at each cut that both sides permit and both neighbours can reach."""
    speeds = [0.0]
    for part, after in zip(parts, [*parts[1:], None], strict=True):
        permitted = 0.0 if part.stop or after is None else min(part.limit_mps, after.limit_mps)
        speeds.append(min(permitted, _reach(speeds[-1], part, limits)))
    for index in range(len(parts) - 1, -1, -1):
        speeds[index] = min(speeds[index], _reach(speeds[index + 1], parts[index], limits))
    return speeds


def _reach(speed_mps: float, part: Region, limits: Limits) -> float:
    """Highest speed within the region's limit that its length allows to go to from `speed_mps`."""
    length = part.end_m - part.start_m
    return _highest(
        speed_mps, part.limit_mps, lambda top: _change_m(speed_mps, top, limits) <= length
    )


def _highest(low: float, high: float, possible: Callable[[float], bool]) -> float:
    """Bisect for the highest speed that is possible, where every lower one is."""
    if low >= high or possible(high):
        return high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if possible(middle) else (low, middle)
    return low


def _change_phases(dv_mps: float, limits: Limits) -> list[tuple[float, float]]:
    """Durations and jerks that change the speed by `dv_mps`, without acceleration at the ends."""
    peak = min(limits.acceleration_mps2, math.sqrt(abs(dv_mps) * limits.jerk_mps3))
    if peak == 0:
        return []
    jerk = math.copysign(limits.jerk_mps3, dv_mps)
    ramp = peak / limits.jerk_mps3
    return [(ramp, jerk), (max(abs(dv_mps) / peak - ramp, 0.0), 0.0), (ramp, -jerk)]


def _change_m(v0_mps: float, v1_mps: float, limits: Limits) -> float:
    """Way that a change of speed takes: the acceleration is symmetric in time."""
    duration = math.fsum(phase[0] for phase in _change_phases(v1_mps - v0_mps, limits))
    return (v0_mps + v1_mps) / 2 * duration


def _region_phases(
    length_m: float, v0: float, v1: float, part: Region, limits: Limits
) -> list[tuple[float, float]]:
    """Durations and jerks from one end of a region to the other: up, along, down."""

    def way(top: float) -> float:
        return _change_m(v0, top, limits) + _change_m(top, v1, limits)

    top = _highest(max(v0, v1), part.limit_mps, lambda speed: way(speed) <= length_m)
    along = (max(length_m - way(top), 0.0) / top, 0.0)
    return [*_change_phases(top - v0, limits), along, *_change_phases(v1 - top, limits)]
