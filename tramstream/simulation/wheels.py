"""What the wheels of a ride count, and the force that moves the vehicle.

Wheels are fed the truth of consecutive instants in blocks of any size and remember what one block
hands to the next, so that the cut into blocks does not show in what they count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tramstream.config import Count, Positive, Struct
from tramstream.simulation.imu import STANDARD_GRAVITY_MPS2
from tramstream.simulation.ride import Motion

Array = NDArray[np.float64]

STILL_MPS = 1e-6
"""Rounding at the end of a braking is no turn."""


class Axle(Struct, frozen=True, kw_only=True):
    """The two measured wheels and their encoders: docs/theory.md, sections 3.5 and 3.9."""

    pulses_per_turn: Count = 2048
    radius_m: Positive = 0.3
    radius_error_m: tuple[float, float] = (0.0, 0.0)
    """Left and right: how much larger the wheel really is. The reference has 0.012 and 0.016."""
    track_m: Positive = 1.435
    signed: bool = True
    """Whether pulses count down when the vehicle runs against x."""

    @property
    def m_per_pulse(self) -> float:
        """What a pulse means to whoever knows nothing of the radius errors."""
        return math.tau * self.radius_m / self.pulses_per_turn


class Wheels:
    """Encoders of left and right wheel: whole pulses since the last message, the rest carried."""

    def __init__(self, axle: Axle | None = None, reverse: bool = False) -> None:
        self.axle = axle = axle or Axle()
        radius = axle.radius_m + np.array(axle.radius_error_m)
        self._pulses_per_m = axle.pulses_per_turn / (math.tau * radius)
        self._direction = -1 if reverse else 1
        self._start_m: float | None = None  # arc length of the first instant
        self._attitude = np.zeros((1, 3))  # roll, pitch, yaw of the last instant
        self._turned_rad = 0.0  # about the vehicle's own z, until then
        self._counted = np.zeros((1, 2), dtype=np.int64)
        self._travel = 1.0  # last direction of travel, against that of growing arc length
        self._slipped = np.zeros(2)  # in all, at the last instant
        self._before = np.zeros((2, 2))  # at the last turn: slipped along the line, and in all

    def measure(self, motion: Motion, slipped_m: Array | None = None) -> NDArray[np.int64]:
        """Pulses since the instant before, left and right, for each instant; shape (n, 2).

        The first instant ever is where counting starts. The way of a wheel is that of the axle's
        middle and half the track times the turned angle: the integral of v ∓ ω_z l/2. That angle is
        the one about the vehicle's own z, which on a grade is less than the yaw.

        Parameters
        ----------
        motion : Motion
        slipped_m : ndarray, shape (n, 2), optional
            What each wheel has turned beyond its way since the ride's start: negative for a wheel
            that slid.
        """
        if self._start_m is None:
            self._start_m = float(motion.arc_length_m[0])
            self._attitude = np.stack([motion.roll_rad, motion.pitch_rad, motion.yaw_rad], 1)[:1]
        way = motion.arc_length_m - self._start_m
        lever = self._turn(motion) * (self._direction * self.axle.track_m / 2)
        ways = np.stack([way - lever, way + lever], axis=1)
        if slipped_m is None:
            slipped_m = np.zeros_like(ways)
        counted = [self._counted]
        for travel, rows in self._legs(motion):
            if travel != self._travel:
                self._before = self._slips(self._slipped)
                self._travel = travel
            along = ways[rows] + self._slips(slipped_m[rows])[0]
            counted.append(self._whole(along * self._pulses_per_m))
            self._slipped = slipped_m[rows][-1]
        levels: NDArray[np.int64] = np.concatenate(counted)
        pulses = levels[1:] - levels[:-1]
        return self._direction * pulses if self.axle.signed else np.abs(pulses)

    def _legs(self, motion: Motion) -> list[tuple[float, slice]]:
        """Directions of travel along the line and their instants; standing keeps the last."""
        speed = self._direction * motion.speed_mps
        moving = np.where(np.abs(speed) > STILL_MPS, np.arange(len(speed)), -1)
        last = np.maximum.accumulate(moving)
        travel = np.where(last >= 0, np.sign(speed[last]), self._travel)
        turns = np.flatnonzero(np.diff(travel)) + 1
        edges = [0, *turns.tolist(), len(travel)]
        return [(float(travel[first]), slice(first, end)) for first, end in pairwise(edges)]

    def _slips(self, slipped_m: Array) -> Array:
        """Slip along the line, and in all, where it is in the direction of travel."""
        along, at_turn = self._before
        return np.stack([along + self._travel * (slipped_m - at_turn), slipped_m])

    def _whole(self, pulses: Array) -> NDArray[np.int64]:
        """Whole pulses; rounding at standstill is no pulse against the direction of travel."""
        whole = np.concatenate([self._counted, np.floor(pulses).astype(np.int64)])
        towards = np.maximum if self._travel > 0 else np.minimum
        whole = towards.accumulate(whole)[1:]
        self._counted = whole[-1:]
        return whole

    def _turn(self, motion: Motion) -> Array:
        """Angle about z since the first instant: trapezoids of ω_z dt = cφ cθ dψ − sφ dθ."""
        attitude = np.stack([motion.roll_rad, motion.pitch_rad, motion.yaw_rad], axis=1)
        attitude = np.concatenate([self._attitude, attitude])
        roll, pitch, yaw = attitude.T
        steep, bank = np.cos(roll) * np.cos(pitch), np.sin(roll)
        steps = (steep[1:] + steep[:-1]) / 2 * np.diff(yaw)
        steps -= (bank[1:] + bank[:-1]) / 2 * np.diff(pitch)
        turned: Array = self._turned_rad + np.cumsum(steps)
        self._attitude, self._turned_rad = attitude[-1:], float(turned[-1])
        return turned


@dataclass(frozen=True, slots=True)
class Resistance:
    """Longitudinal model of chladek2023 (docs/theory.md, section 3.6)."""

    mass_kg: float = 150_000.0
    drag_coefficient: float = 1.05
    frontal_area_m2: float = 14.484
    rolling_coefficient: float = 0.00005
    air_density_kgpm3: float = 1.201


def motor_force_n(motion: Motion, resistance: Resistance | None = None) -> Array:
    """Force of motors and brakes along x that makes the vehicle move as it does.

    The motion is that of a point on the track, whose pitch is minus the grade. None while standing:
    then the parking brake holds it.
    """
    model = resistance or Resistance()
    drag = 0.5 * model.drag_coefficient * model.frontal_area_m2 * model.air_density_kgpm3
    weight = model.mass_kg * STANDARD_GRAVITY_MPS2
    speed = motion.speed_mps
    force = (
        model.mass_kg * motion.acceleration_mps2
        + drag * speed * np.abs(speed)
        + weight * model.rolling_coefficient * np.sign(speed)
        - weight * np.sin(motion.pitch_rad)
    )
    return np.where(motion.standing, 0.0, force)
