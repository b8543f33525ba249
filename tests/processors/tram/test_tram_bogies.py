"""A body on two bogies: it lies along the chord of the rail, and so do the numbers of the model.

The truth is geometry: both pivots are on the rail, at their distance; speed, rates and forces of
the point midway follow from differences of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from rides import LEVEL, Errors, altered, judged, laid, ridden, run
from test_tram_faults import PLAN, city

from tramstream.config import Ekf, Gnss, Imu, Vehicle, Wheels
from tramstream.estimation.kalman import Array
from tramstream.estimation.records import numbers, one
from tramstream.estimation.track import OnTrack
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_filter.start import PIVOT_STD_M, pivot_std_m
from tramstream.processors.tram_model import motion
from tramstream.processors.tram_model.records import READING
from tramstream.processors.tram_model.states import Ix
from tramstream.simulation.body import Body as Pivots

BASE_M = 6.4
"""Pivots of a T3: between its two bogies."""
TRACK_M = 1.435
GRAVITY = 9.81
DT_S = 0.01
SMOOTHING_S = 0.1
"""Of the angular acceleration, as `axes` gives it."""
SPEED_MPS = 6.0
RADIUS_M = 25.0
TRANSITION_M = 8.0
FINE_M = 0.002
ARC_LENGTH_M = np.arange(-20.0, 90.0, FINE_M)


class Rail(NamedTuple):
    """A straight, a clothoid, an arc, a clothoid and a straight again, by arc length."""

    yaw_rad: Array
    p: Array

    def at(self, s_m: Array) -> Array:
        """Place, shape (n, 2)."""
        return np.stack([np.interp(s_m, ARC_LENGTH_M, self.p[:, k]) for k in range(2)], axis=1)

    def heading(self, s_m: Array) -> Array:
        return np.asarray(np.interp(s_m, ARC_LENGTH_M, self.yaw_rad))


def rail(radius_m: float) -> Rail:
    ends = np.array([10.0, 10.0 + TRANSITION_M, 40.0, 40.0 + TRANSITION_M])
    curvature = np.interp(ARC_LENGTH_M, ends, [0.0, 1 / radius_m, 1 / radius_m, 0.0])
    yaw = np.cumsum(curvature) * FINE_M
    return Rail(yaw, np.cumsum(np.stack([np.cos(yaw), np.sin(yaw)], axis=1), axis=0) * FINE_M)


class Body(NamedTuple):
    """Of the chord: time, arc lengths of the pivots, place midway, yaw."""

    front_m: Array
    rear_m: Array
    middle: Array
    yaw_rad: Array


def body(track: Rail) -> Body:
    front = np.arange(0.0, 70.0, SPEED_MPS * DT_S)
    low, high = front - 1.05 * BASE_M, front - 0.95 * BASE_M
    for _ in range(40):
        rear = 0.5 * (low + high)
        apart = np.linalg.norm(track.at(front) - track.at(rear), axis=1)
        low, high = np.where(apart > BASE_M, rear, low), np.where(apart > BASE_M, high, rear)
    p_front, p_rear = track.at(front), track.at(rear)
    chord = p_front - p_rear
    return Body(front, rear, 0.5 * (p_front + p_rear), np.arctan2(chord[:, 1], chord[:, 0]))


def vehicle(distance_m: float) -> Vehicle:
    return Vehicle(
        vehicle="test",
        gnss=Gnss(device="none"),
        imu=Imu(device="none", lever_arm_m=(-BASE_M / 2, 0.0, 0.0)),
        wheels=Wheels(track_m=TRACK_M, bogie="front"),
        ekf=Ekf(pivot_m=BASE_M / 2, bogie_distance_m=distance_m),
    )


class Driven(NamedTuple):
    """What the motion model makes of the exact readings of a case midway, at each instant."""

    off_left_m: Array
    """Of the true place."""
    paths_m: Array
    """Of the left and the right wheel, shape (n, 2)."""
    speed_mps: Array


def drive(truth: Body, distance_m: float) -> Driven:
    ekf = TramFilter(vehicle(distance_m), GRAVITY)
    velocity = np.gradient(truth.middle, DT_S, axis=0)
    acceleration = np.gradient(velocity, DT_S, axis=0)
    x_axis = np.stack([np.cos(truth.yaw_rad), np.sin(truth.yaw_rad)], axis=1)
    y_axis = np.stack([-x_axis[:, 1], x_axis[:, 0]], axis=1)
    rate = np.gradient(truth.yaw_rad, DT_S)
    state = np.zeros(len(Ix))
    state[[Ix.EAST, Ix.NORTH]] = truth.middle[0]
    state[Ix.SPEED], state[Ix.YAW], state[Ix.PIVOT] = SPEED_MPS, truth.yaw_rad[0], BASE_M / 2
    ekf.x, ekf.P = state, np.eye(len(Ix)) * 1e-6
    u = one(READING)
    u["accelerometer"] = 1.0
    smoothed, rows = 0.0, []
    for k in range(len(rate)):
        e, n = ekf.x[Ix.EAST, 0], ekf.x[Ix.NORTH, 0]
        off = np.dot(np.array([e, n]) - truth.middle[k], y_axis[k])
        rows.append((off, *ekf.x[[Ix.PATH_A, Ix.PATH_B, Ix.SPEED], 0]))
        rising = (rate[k] - smoothed) / SMOOTHING_S
        smoothed += DT_S * rising
        u["angular_rate"] = 0.0, 0.0, rate[k]
        u["angular_acceleration"] = 0.0, 0.0, rising
        u["specific_force"] = *(acceleration[k] @ np.stack([x_axis[k], y_axis[k]]).T), GRAVITY
        motion.predict(ekf.memory, *given(ekf), numbers(u), DT_S)
    off, left, right, speed = np.array(rows).T
    return Driven(off, np.stack([left, right], axis=1), speed)


def given(ekf: TramFilter) -> tuple[Array, Array]:
    return numbers(ekf.parameters), numbers(ekf.situation)


@pytest.mark.parametrize("radius_m", [25.0, -25.0, 60.0])
def test_point_midway_leaves_the_rail_by_the_versine_and_comes_back(radius_m: float) -> None:
    truth = body(rail(radius_m))
    versine_m = BASE_M**2 / (8 * abs(radius_m))
    off_m = np.abs(drive(truth, BASE_M).off_left_m).max()
    assert off_m < 0.03
    without_m = np.abs(drive(truth, 0.0).off_left_m).max()
    assert without_m > 0.5 * versine_m


@pytest.mark.parametrize("radius_m", [25.0, -25.0])
def test_wheels_go_the_way_of_their_bogie(radius_m: float) -> None:
    """Its middle that of the front pivot, its axle turned as the rail there."""
    track = rail(radius_m)
    truth = body(track)
    turned = track.heading(truth.front_m)
    way = truth.front_m - truth.front_m[0]
    side = (turned - turned[0]) * TRACK_M / 2
    true = np.stack([way - side, way + side], axis=1)
    error = drive(truth, BASE_M).paths_m - true
    plain = drive(truth, 0.0).paths_m - true
    assert np.abs(error[-1]).max() < 0.1 * np.abs(plain[-1]).max()
    assert np.abs(error).max() < 0.1 * np.abs(plain).max()


@pytest.mark.parametrize("bend", [1.0, -1.0])
def test_vehicle_on_the_mapped_curve_has_nothing_to_correct(bend: float) -> None:
    """Midway its body is inside of the curve by the versine, to which the map adds nothing."""
    navigation = Navigation(vehicle(BASE_M), LEVEL)
    inside_m = RADIUS_M - math.sqrt(RADIUS_M**2 - BASE_M**2 / 4)
    curvature = bend / (RADIUS_M - inside_m)
    told = OnTrack(0.0, 1.0, bend * inside_m, 0.0, curvature, 1e-4, 1e-6, math.nan, math.nan)
    navigation.on_track(told)
    across, heading = navigation.memory.given
    assert abs(across.innovation) < 0.01 * inside_m
    assert abs(heading.innovation) < 1e-9


# Nobody has said that there are any ---------------------------------------------------------------
def found_pivot(pivots_m: tuple[float, ...]) -> tuple[float, float, Errors]:
    """What the filter finds of the pivot on a ride of two minutes with curves, and its errors."""
    stiff = Pivots(pivots_m=pivots_m, pitch_deg_per_mps2=0.0, roll_deg_per_mps2=0.0)
    gnss = {"velocity": True, "rate_hz": 5.0, "lever_arm_m": (3.0, 0.0, 3.2)}
    chosen = altered(city(), body=stiff, gnss=gnss)
    ride = ridden(laid(PLAN + " | 100 L40/60 100 R30/60 200 |"), chosen, 1, 130.0)
    unsaid = altered(
        ride.simulation.vehicle,
        ekf={"pivot_m": 0.0, "bogie_distance_m": 0.0, "pivot_std_m": -1.0},
        wheels={"bogie": ""},
    )
    localiser = TramLocaliser(unsaid)
    errors = judged(ride.simulation, localiser, run(localiser, ride.frames))
    (pivot,) = (each for each in localiser.learned() if each.name == "pivot")
    return pivot.value, pivot.std, errors


def test_bogies_that_nobody_has_configured_are_learned() -> None:
    """Midway between them is what does not slip; the rest of the chord is too little to matter."""
    pivot_m, std_m, errors = found_pivot((0.0, -BASE_M))
    assert pivot_m == pytest.approx(BASE_M / 2, abs=0.6)
    assert std_m < 0.3
    assert errors.within(60.0, 130.0).horizontal_m.max() < 2.0


def test_vehicle_that_is_a_point_is_found_to_be_one() -> None:
    pivot_m, std_m, _ = found_pivot((0.0, -0.1))
    assert pivot_m == pytest.approx(0.0, abs=0.3)
    assert std_m < 0.3


def test_pivot_is_sought_only_where_nothing_is_known_and_an_imu_can_tell() -> None:
    known = vehicle(BASE_M)
    bare = altered(known, ekf={"pivot_m": 0.0, "bogie_distance_m": 0.0})
    assert pivot_std_m(known) == 0.0
    assert pivot_std_m(bare) == PIVOT_STD_M
    assert pivot_std_m(altered(bare, imu=None)) == 0.0
    assert pivot_std_m(altered(bare, ekf={"pivot_std_m": 0.0})) == 0.0
    assert pivot_std_m(altered(known, ekf={"pivot_std_m": 1.0})) == 1.0
