"""Estimates of vehicles that run on the exact lines of `networks`.

What the estimates are off is made here: a first-order Gauss-Markov error of position and heading,
with the covariance that it truly has. The filter's frame lies kilometres away from the network's
and at another height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from networks import LEVEL, Array
from numpy.random import Generator

from tramstream.clock import S
from tramstream.estimation.localiser import COVARIANCE, TRACKING, Estimate, values_of
from tramstream.estimation.track import CERTAIN, LocalTrack, OnTrack
from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.lines.line import Line
from tramstream.processors.matching import hypotheses as kernels
from tramstream.processors.matching.matcher import Match, Matcher
from tramstream.tracks.map_frame import MapFrame

FILTER_LEVEL = LocalLevel.at_deg(50.10, 14.45, 190.0)
"""Of the estimates: 3 km away, 60 m lower."""
STEP_S = 0.05
BEGIN_NS = 1_000 * S


class Course(NamedTuple):
    """A motion along a line."""

    time_s: Array
    s: Array
    """Way along the line, m."""
    rate: Array
    """Its derivative, m/s; negative: against the line."""


def course(*legs: tuple[float, float], start_m: float = 0.0, step_s: float = STEP_S) -> Course:
    """Go legs of (metres, seconds), each from standstill to standstill; no metres: stand."""
    time, way, rate = [np.zeros(1)], [np.full(1, start_m)], [np.zeros(1)]
    for metres, seconds in legs:
        u = np.arange(1, round(seconds / step_s) + 1) / round(seconds / step_s)
        time.append(time[-1][-1] + u * seconds)
        way.append(way[-1][-1] + metres * (3.0 - 2.0 * u) * u * u)
        rate.append(metres / seconds * 6.0 * u * (1.0 - u))
    return Course(*(np.concatenate(each) for each in (time, way, rate)))


def steady(metres: float, speed_mps: float, start_m: float = 0.0) -> Course:
    """Go at one speed from the first instant to the last."""
    time = np.arange(0.0, metres / speed_mps, STEP_S)
    return Course(time, start_m + speed_mps * time, np.full(len(time), speed_mps))


@dataclass(frozen=True)
class Noise:
    """Gauss-Markov errors of the estimates, and what they claim.

    They change while the vehicle moves: one that stands is held by its wheels.
    """

    std_m: float = 0.5
    """Per axis."""
    time_s: float = 300.0
    yaw_std_rad: float = 0.01
    yaw_time_s: float = 300.0
    offset_l: tuple[float, float] = (0.0, 0.0)
    """East, north: what is added and not claimed."""


class Obeying:
    """A filter's share in the estimates: it takes what a matcher tells it about the rails.

    A Kalman filter of the error of place and heading, which is what `driven` makes: each forgets
    itself, and what it was told with it.
    """

    def __init__(self, noise: Noise) -> None:
        self._initial = np.diag([noise.std_m**2, noise.std_m**2, noise.yaw_std_rad**2])
        self._times_s = np.array([noise.time_s, noise.time_s, noise.yaw_time_s])
        self.P = self._initial.copy()
        self.correction = np.zeros(3)
        """East, north, yaw: what to add to an estimate."""

    def wait(self, dt_s: float) -> None:
        keep = np.exp(-dt_s / self._times_s)
        self.correction *= keep
        both = np.outer(keep, keep)
        self.P = both * self.P + (1.0 - both) * self._initial

    def take(self, told: OnTrack) -> None:
        """Take how far the estimate is off the track."""
        east, north, bend = told.normal_east, told.normal_north, told.bend_per_m
        H = np.array([[east, north, 0.0], [-bend * north, bend * east, 1.0]])
        S = H @ self.P @ H.T + np.diag([told.across_variance, told.yaw_variance])
        K = np.linalg.solve(S, H @ self.P).T
        self.correction -= K @ (told.across_m, told.yaw_off_rad)
        self.P = self.P - K @ S @ K.T

    def apply(self, estimate: Estimate) -> Estimate:
        """The estimate of a filter that has been told."""
        values = estimate.values.copy()
        values[[0, 1, 6]] += self.correction
        covariance = values[COVARIANCE:].reshape(7, 7)
        covariance[np.ix_([0, 1, 6], [0, 1, 6])] = self.P
        return replace(estimate, values=values)


def told(matcher: Matcher, match: Match, frame: MapFrame) -> OnTrack | None:
    """What a filter makes of a match whose estimate is the matcher's last; in its frame `l`."""
    circle = match.circle
    if circle is None or circle.probability < CERTAIN:
        return None
    track = LocalTrack(0, *circle[3:7], *(circle[k] for k in (10, 7, 8, 11, 12, 13)))
    on_track = track.told(matcher.east, matcher.north, matcher.yaw_rad)
    assert on_track is not None, "a circle that does not stand for where it was asked"
    turn = float(frame.numbers[kernels.ROTATION])
    east, north = on_track.normal_east, on_track.normal_north
    cos, sin = math.cos(turn), math.sin(turn)
    return on_track._replace(
        normal_east=cos * east + sin * north, normal_north=cos * north - sin * east
    )


@dataclass(frozen=True)
class Driven:
    """Estimates of a vehicle, and the truth."""

    estimates: list[Estimate]
    course: Course
    plan: Array
    """(n, 2): true place in the network's plan."""
    off_l: Array
    """(n, 2): error of the estimates."""
    noise: Noise

    @property
    def stamps(self) -> list[int]:
        return [each.stamp_ns for each in self.estimates]

    def altered(self, begin: int, end: int, **changes: object) -> Driven:
        """Estimates of a part with other fields, such as a mode."""
        estimates = list(self.estimates)
        estimates[begin:end] = [replace(each, **changes) for each in estimates[begin:end]]
        return replace(self, estimates=estimates)


def gauss_markov(rng: Generator, time_s: Array, std: float, correlation_s: float) -> Array:
    """First-order, stationary."""
    error = np.empty(len(time_s))
    error[0] = rng.normal(0.0, std)
    for k, dt in enumerate(np.diff(time_s).tolist()):
        keep = math.exp(-dt / correlation_s)
        error[k + 1] = keep * error[k] + rng.normal(0.0, std * math.sqrt(1.0 - keep * keep))
    return error


def driven(
    line: Line, way: Course, noise: Noise | None = None, seed: int = 0, rear: bool = False
) -> Driven:
    """Estimates along a line.

    Parameters
    ----------
    rear : bool
        The vehicle's x axis points against the line: it goes along it with a negative speed.
    """
    noise = noise or Noise()
    rng = np.random.default_rng(seed)
    geodetic = line.level.to_geodetic(line.position_l(way.s))
    flat = geodetic.copy()
    flat[:, 2] = LEVEL.height_m
    p_l = FILTER_LEVEL.from_geodetic(geodetic)
    moving_s = np.concatenate([[0.0], np.cumsum(np.diff(way.time_s) * (way.rate[1:] != 0.0))])
    off = [gauss_markov(rng, moving_s, noise.std_m, noise.time_s) for _ in range(2)]
    off_l = np.column_stack(off) + noise.offset_l
    p_l[:, :2] += off_l
    yaw = line.yaw_rad(way.s) + np.pi * rear
    yaw = yaw - convergence_rad(line.level, geodetic[:, 1])
    yaw = yaw + convergence_rad(FILTER_LEVEL, geodetic[:, 1])
    yaw = yaw + gauss_markov(rng, moving_s, noise.yaw_std_rad, noise.yaw_time_s)
    turn = way.rate * line.curvature_per_m(way.s)
    speed = -way.rate if rear else way.rate
    covariance = np.diag(
        [noise.std_m**2, noise.std_m**2, 1.0, 0.01, 1e-4, 1e-4, noise.yaw_std_rad**2]
    )
    estimates = [
        Estimate(
            BEGIN_NS + round(time * S),
            TRACKING,
            values_of((*place, v, 0.0, 0.0, heading), covariance, 0.0, rate),
            v == 0.0,
        )
        for time, place, v, heading, rate in zip(
            way.time_s.tolist(), p_l, speed.tolist(), yaw.tolist(), turn.tolist(), strict=True
        )
    ]
    return Driven(estimates, way, LEVEL.from_geodetic(flat)[:, :2], off_l, noise)
