"""A ride along a line: the truth of the vehicle's motion and attitude at any time.

Speed comes from `simulation.speed_plan`. The vehicle's origin (the pivot of the front bogie) stays
on the track and its x axis along it: no side slip, attitude from the track's heading, grade and
cant. On a ride in reverse the rear cab leads: x points against the direction of travel. Where the
driver turns back (`Limits.turns_back`) he changes the cab and the vehicle stays as it stands: x
keeps its direction along the line, and speed along x changes its sign.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream.geodesy import convergence_rad
from tramstream.lines.line import Line
from tramstream.proto import raw_pb2
from tramstream.simulation.speed_plan import Limits, legs, plan

__all__ = ["Limits", "Motion", "Ride"]

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Where the vehicle's origin is on the line, and how it moves; one row an instant.

    Speed and acceleration are along x of the vehicle, attitude is that of docs/theory.md,
    section 1.2.
    """

    arc_length_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    yaw_rad: Array
    yaw_rate_radps: Array
    standing: NDArray[np.bool_]
    pitch_rad: Array
    roll_rad: Array
    pitch_rate_radps: Array
    roll_rate_radps: Array
    yaw_acceleration_radps2: Array
    pitch_acceleration_radps2: Array
    roll_acceleration_radps2: Array


class Ride:
    """A ride from the first stop of a line to the last; it stands before, after and between.

    Where the driver turns back it goes over parts of the line several times, both ways.

    Time is that of the ride, in seconds from its start.

    Parameters
    ----------
    line : Line
        The geometry; its first stop is where the ride starts.
    limits : Limits
        What the driver keeps to.
    reverse : bool
        Depart with the rear in front: speed is negative until the driver turns back.
    rng : Generator, optional
        Of the dwells, where the limits have them differ; without it each is the shortest.
    """

    DOOR_S = 1.0
    """Doors open so long after the stop and close so long before the departure."""

    def __init__(
        self,
        line: Line,
        limits: Limits | None = None,
        reverse: bool = False,
        rng: Generator | None = None,
    ) -> None:
        self.line = line
        self.limits = limits or Limits()
        self.direction = -1.0 if reverse else 1.0
        """Of x of the vehicle against that of growing arc length."""
        self.legs = legs(line, self.limits)
        """One, and one more for each time that the driver turns back."""
        self.phases = plan(self.legs, self.limits, rng)
        self._standing = (self.phases.v0 == 0) & (self.phases.a0 == 0) & (self.phases.jerk == 0)
        ends = np.append(self.phases.t0[1:], np.inf)
        self.dwells_s = np.stack([self.phases.t0[self._standing], ends[self._standing]], axis=1)
        """Arrival and departure at each halt, shape (halts, 2); the last never ends."""

    @property
    def duration_s(self) -> float:
        """From the start until standstill at the last stop."""
        return float(self.phases.t0[-1])

    @property
    def farthest_m(self) -> float:
        """Largest arc length that the ride comes to."""
        return float(np.max(self.phases.s0))

    def motion(self, time_s: ArrayLike) -> Motion:
        """Arc length and attitude with their rates at each instant."""
        index, dt = self._located(time_s)
        phases = self.phases
        v0, a0, jerk, along = (
            phases.v0[index],
            phases.a0[index],
            phases.jerk[index],
            phases.along[index],
        )
        s = phases.s0[index] + along * (dt * (v0 + dt * (a0 / 2 + dt * jerk / 6)))
        v = along * (v0 + dt * (a0 + dt * jerk / 2))
        a = along * (a0 + dt * jerk)
        yaw, grade, cant = self.line.yaw_shape(s), self.line.grade.shape(s), self.line.cant.shape(s)
        # With x against the line left and right, front and rear change places: so do the signs of
        # grade and cant. Which way the vehicle goes is in the sign of v alone.
        sign = self.direction
        return Motion(
            arc_length_m=s,
            speed_mps=sign * v,
            acceleration_mps2=sign * a,
            yaw_rad=yaw.value if sign > 0 else yaw.value + math.pi,
            yaw_rate_radps=yaw.slope_per_m * v,
            standing=self._standing[index],
            pitch_rad=-sign * grade.value,
            roll_rad=sign * cant.value,
            pitch_rate_radps=-sign * grade.slope_per_m * v,
            roll_rate_radps=sign * cant.slope_per_m * v,
            yaw_acceleration_radps2=yaw.slope_per_m * a + yaw.bend_per_m2 * v**2,
            pitch_acceleration_radps2=-sign * (grade.slope_per_m * a + grade.bend_per_m2 * v**2),
            roll_acceleration_radps2=sign * (cant.slope_per_m * a + cant.bend_per_m2 * v**2),
        )

    def _located(self, time_s: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Phase of each instant, and the time into it."""
        time = np.maximum(np.asarray(time_s, dtype=float), 0.0)
        index = np.searchsorted(self.phases.t0, time, side="right") - 1
        return index, time - self.phases.t0[index]

    def gone_m(self, time_s: ArrayLike) -> Array:
        """Way gone at each instant, which never decreases: the arc length until a first turn."""
        index, _ = self._located(time_s)
        phases = self.phases
        gone: Array = phases.fold_m[index] + phases.along[index] * self.motion(time_s).arc_length_m
        return gone

    def position_l(self, time_s: ArrayLike) -> Array:
        """Position of the vehicle's origin in `l`, m; shape (n, 3) for n instants."""
        return self.line.position_l(self.motion(time_s).arc_length_m)

    def attitude(self, motion: Motion) -> tuple[Array, Array, Array]:
        """Roll, pitch and yaw against level and east of the place, as states are published, rad.

        Those of a motion are against the level frame of the line (docs/theory.md, section 2.2).
        """
        level, p_l = self.line.level, self.line.position_l(motion.arc_length_m)
        east, north, _ = np.moveaxis(level.up_l(p_l), -1, 0)
        cos, sin = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
        yaw = motion.yaw_rad - convergence_rad(level, level.to_geodetic(p_l)[..., 1])
        return (
            motion.roll_rad + north * cos - east * sin,
            motion.pitch_rad - east * cos - north * sin,
            wrapped(yaw),
        )

    def grade_rad(self, motion: Motion) -> Array:
        """Slope of the track under the vehicle's origin along its x, uphill positive.

        Against level of the place, as attitude is published.
        """
        east, north, _ = np.moveaxis(self.up_l(motion), -1, 0)
        yaw = self.line.yaw_rad(motion.arc_length_m)
        grade = self.line.grade(motion.arc_length_m) + east * np.cos(yaw) + north * np.sin(yaw)
        along: Array = self.direction * grade
        return along

    def up_l(self, motion: Motion) -> Array:
        """Direction of the place's up in `l` where a motion is; shape (n, 3)."""
        return self.line.level.up_l(self.line.position_l(motion.arc_length_m))

    def time_at_s(self, arc_length_m: float) -> float:
        """Give the first instant at which the ride has come so far; the end if it never does."""
        phases = self.phases
        farthest = np.maximum.accumulate(phases.s0)
        index = max(int(np.searchsorted(farthest, arc_length_m, side="left")) - 1, 0)
        low = float(phases.t0[index])
        high = float(phases.t0[index + 1]) if index + 1 < len(phases.t0) else low
        for _ in range(60):
            middle = (low + high) / 2
            reached = float(self.motion(middle).arc_length_m) >= arc_length_m
            low, high = (low, middle) if reached else (middle, high)
        return high

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
        return self.truths(np.array([time_s]), [stamp_ns])[0]

    def truths(
        self, time_s: Array, stamps_ns: list[int], vehicle: Motion | None = None
    ) -> list[raw_pb2.TruthState]:
        """Give the truth at each instant of the ride as a message.

        `vehicle` is the motion of the vehicle where that is not the track's.
        """
        motion = self.motion(time_s)
        grade = self.grade_rad(motion)
        motion = vehicle or motion
        p_l = self.line.position_l(motion.arc_length_m)
        latitude, longitude, height = self.line.level.to_geodetic(p_l).T
        roll, pitch, yaw = self.attitude(motion)
        fields = {
            "stamp_ns": stamps_ns,
            "arc_length_m": motion.arc_length_m.tolist(),
            "speed_mps": motion.speed_mps.tolist(),
            "acceleration_mps2": motion.acceleration_mps2.tolist(),
            "latitude_deg": np.degrees(latitude).tolist(),
            "longitude_deg": np.degrees(longitude).tolist(),
            "height_ellipsoid_m": height.tolist(),
            "yaw_rad": yaw.tolist(),
            "yaw_rate_radps": motion.yaw_rate_radps.tolist(),
            "standing": motion.standing.tolist(),
            "roll_rad": roll.tolist(),
            "pitch_rad": pitch.tolist(),
            "grade_rad": grade.tolist(),
        }
        names = list(fields)
        return [
            raw_pb2.TruthState(**dict(zip(names, row, strict=True)))
            for row in zip(*fields.values(), strict=True)
        ]


def wrapped(angle_rad: Array) -> Array:
    """Angle within ±π."""
    turned: Array = angle_rad - math.tau * np.rint(angle_rad / math.tau)
    return turned
