"""The rides of chladek2023: a longitudinal model of a tram, its driver, and a profile of heights.

    m dv/dt = F − ½ c_w A ρ v |v| − m g c_r sign(v) − m g sin α

Braking is negative force, the motor's force is bounded, and rolling resistance has the sign of the
motion. The driver is a PID on the speed: a reference and a square wave. All rides of a drive are
stepped side by side. Filters in the distance domain see a ride in cells of `CELL_M`: speed and
height at its edges, the mean force over the way between them.

Equations: docs/chladek2023.md.

References
----------
R. Chládek, road-grade estimation by onboard multisensor fusion, BSc thesis, CTU Prague 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.lines import geojson
from tramstream.simulation.wheels import Resistance

Array = NDArray[np.float64]

GRAVITY_MPS2 = 9.81
"""As in the work."""
CELL_M = 2.5
"""Step of the work's filters in the distance domain."""
STEP_S = 0.02
"""Of the simulation: a fifth of the shortest period of a driver's wave."""
FORCE_N = (-1.2966e5, 1.4314e5)
"""What brakes and motors can."""
GAINS = (6e6, 0.0, 10.0)
"""Proportional, integral, derivative: N/(m/s), N/m, N/(m/s²)."""
REFERENCE_MPS = 25.0
AMPLITUDE_MPS, PERIOD_S = 5.0, 10.0
"""Of the square wave in the single ride."""
AMPLITUDES_MPS, PERIODS_S = (0.0, 10.0), (0.1, 20.0)
"""Between which those of many rides are drawn."""
SPEED_WALK_MPS, HEIGHT_STD_M = 0.1, 1.0
"""Noise: by so much the speed's error walks from cell to cell; a height's is white."""


@dataclass(frozen=True)
class Model:
    """The vehicle divided by its mass."""

    mass_kg: float
    drag_per_m: float
    """½ c_w A ρ / m."""
    rolling: float
    """c_r."""

    def acceleration_mps2(self, force_n: Array, speed_mps: Array, grade_rad: Array) -> Array:
        """Of a vehicle that moves; one that stands is not held by its resistance."""
        change: Array = (
            force_n / self.mass_kg
            - self.drag_per_m * speed_mps * np.abs(speed_mps)
            - GRAVITY_MPS2 * (self.rolling * np.sign(speed_mps) + np.sin(grade_rad))
        )
        return change


def model_of(vehicle: Resistance) -> Model:
    """What of a vehicle its motion depends on."""
    drag = 0.5 * vehicle.drag_coefficient * vehicle.frontal_area_m2 * vehicle.air_density_kgpm3
    return Model(vehicle.mass_kg, drag / vehicle.mass_kg, vehicle.rolling_coefficient)


VEHICLE = model_of(Resistance())


class Profile(NamedTuple):
    """Heights and slopes at the edges of cells; the height is the integral of sin α."""

    name: str
    way_m: Array
    grade_rad: Array
    height_m: Array


def profile_of(name: str, way_m: Array, grade_rad: Array) -> Profile:
    """A profile of slopes; its height begins at nothing."""
    rise = np.sin(grade_rad)
    steps = (rise[1:] + rise[:-1]) / 2 * np.diff(way_m)
    return Profile(name, way_m, grade_rad, np.concatenate([[0.0], np.cumsum(steps)]))


def profile_in(source: str, length_m: float | None = None) -> Profile:
    """Slopes of a map's line, FILE.geojson#LINE/DIRECTION.

    Its heights are smoothed by a Gaussian of 60 m, and more where that leaves more than 8 %.

    Parameters
    ----------
    source : str
        See `tramstream.lines.geojson`.
    length_m : float, optional
        So much from its beginning; what lies behind still smooths it.
    """
    track = geojson.read(source)
    slope = geojson.slope(track)
    end_m = slope.knots_m[-1] if length_m is None else min(length_m, slope.knots_m[-1])
    way = np.arange(0.0, end_m + CELL_M / 2, CELL_M)
    return profile_of(track.name, way, slope(way))


class Waves(NamedTuple):
    """What the drivers of several rides add to the reference; arrays, one entry a ride."""

    amplitude_mps: Array
    period_s: Array


def one_wave() -> Waves:
    """The single ride's."""
    return Waves(np.array([AMPLITUDE_MPS]), np.array([PERIOD_S]))


def drawn_waves(count: int, rng: np.random.Generator) -> Waves:
    """Those of many rides."""
    return Waves(rng.uniform(*AMPLITUDES_MPS, count), rng.uniform(*PERIODS_S, count))


class Drive(NamedTuple):
    """Rides against time, one row a `STEP_S`, one column a ride."""

    way_m: Array
    speed_mps: Array
    force_n: Array
    """From this row to the next."""


def drive(profile: Profile, waves: Waves, start_mps: float = REFERENCE_MPS) -> Drive:
    """Drive over a profile until the last of the rides has its end."""
    gain, integral_gain, derivative_gain = GAINS
    way = np.zeros(len(waves.period_s))
    speed, total = np.full_like(way, start_mps), np.zeros_like(way)
    before: Array | None = None
    rows: list[tuple[Array, Array, Array]] = []
    while not len(rows) or way.min() < profile.way_m[-1]:
        phase = len(rows) * STEP_S / waves.period_s % 1.0
        wanted = REFERENCE_MPS + waves.amplitude_mps * np.where(phase < 0.5, 1.0, -1.0)
        error = wanted - speed
        total = total + error * STEP_S
        change = np.zeros_like(error) if before is None else (error - before) / STEP_S
        before = error
        force = gain * error + integral_gain * total + derivative_gain * change
        force = np.clip(force, *FORCE_N)
        rows.append((way, speed, force))
        grade = np.interp(way, profile.way_m, profile.grade_rad)
        acceleration = VEHICLE.acceleration_mps2(force, speed, grade)
        way = way + speed * STEP_S + acceleration * STEP_S**2 / 2
        speed = speed + acceleration * STEP_S
    rows.append((way, speed, np.zeros_like(way)))
    return Drive(*(np.stack(column) for column in zip(*rows, strict=True)))


class Rides(NamedTuple):
    """Rides cell by cell: one row a ride; what is measured beside what is true."""

    speed_mps: Array
    """(rides, n + 1): at the edges of the cells."""
    force_n: Array
    """(rides, n): mean over the way of a cell, measured without error."""
    measured_speed_mps: Array
    measured_height_m: Array

    def take(self, which: slice) -> Rides:
        return Rides(*(each[which] for each in self))


def in_cells(profile: Profile, driven: Drive, rng: np.random.Generator | None) -> Rides:
    """Bring rides to the cells of their profile and measure them; without `rng` free of noise.

    Between two rows the force is constant, so v² and work are straight in the way.
    """
    edges = profile.way_m
    work = np.cumsum(driven.force_n[:-1] * np.diff(driven.way_m, axis=0), axis=0)
    work = np.concatenate([np.zeros((1, work.shape[1])), work])
    count = driven.way_m.shape[1]
    speed, force = np.empty((count, len(edges))), np.empty((count, len(edges) - 1))
    for ride in range(count):
        way = driven.way_m[:, ride]
        speed[ride] = np.sqrt(np.interp(edges, way, driven.speed_mps[:, ride] ** 2))
        force[ride] = np.diff(np.interp(edges, way, work[:, ride])) / np.diff(edges)
    height = np.broadcast_to(profile.height_m, speed.shape)
    if rng is None:
        return Rides(speed, force, speed, height)
    walk = np.cumsum(rng.normal(0.0, SPEED_WALK_MPS, speed.shape), axis=1)
    white = rng.normal(0.0, HEIGHT_STD_M, speed.shape)
    return Rides(speed, force, speed + walk, height + white)


def rmse(estimate: Array, truth: Array) -> float:
    """Root mean square error."""
    return float(np.sqrt(np.mean((estimate - truth) ** 2)))
