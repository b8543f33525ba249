"""A vehicle with two cabs: the driver turns back, the body stays as it stands."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.attitude import C_vl
from tramstream.errors import ConfigError
from tramstream.lines.line import built_in_line
from tramstream.simulation.body import Body, Carriage, antenna_of
from tramstream.simulation.events import Happenings
from tramstream.simulation.imu import inertial
from tramstream.simulation.ride import Ride
from tramstream.simulation.roughness import Roughness, Shaking
from tramstream.simulation.scenario import Scenario, Slide, parse
from tramstream.simulation.speed_plan import Break, Limits
from tramstream.simulation.wheels import Axle, Wheels

Array = NDArray[np.float64]

MM = 1e-3  # m
GRAVITY = 9.81  # m/s²
TURNS = Limits(speed_mps=12.0, acceleration_mps2=1.0, jerk_mps3=0.8, lateral_mps2=0.8,
               turns_back=(4, 2), turn_s=40.0)  # fmt: skip
STEP_S = 1e-3
WAYS = pytest.mark.parametrize("reverse", [False, True])


@cache
def ride(reverse: bool = False) -> Ride:
    return Ride(built_in_line(), TURNS, reverse)


def until_s() -> float:
    """When the vehicle is at the fifth stop: all three legs lie before it."""
    return ride().time_at_s(float(ride().line.stops_m[4]))


def instants() -> Array:
    return np.arange(0.0, until_s(), 0.02)


def halts() -> Array:
    """Places of the first halts: stops 1 to 4, back to 2, on to 5."""
    return ride().line.stops_m[[0, 1, 2, 3, 2, 1, 2, 3, 4]]


def test_halts_are_the_stops_in_the_order_in_which_they_are_come_to() -> None:
    arrival, departure = ride().dwells_s[:9].T
    for instant in (arrival, departure - 1e-6):
        motion = ride().motion(instant)
        np.testing.assert_array_equal(motion.arc_length_m, halts())
        assert np.all(motion.standing)
    dwells = departure - arrival
    np.testing.assert_allclose(dwells[[3, 5]], 40.0)
    np.testing.assert_allclose(dwells[[1, 2, 4, 6, 7, 8]], TURNS.dwell_s)
    assert len(ride().dwells_s) == len(ride().line.stops_m) + 4


@WAYS
def test_integral_of_speed_is_the_way_and_that_of_acceleration_the_speed(reverse: bool) -> None:
    time_s, along = instants(), -1.0 if reverse else 1.0
    motion, middle = ride(reverse).motion(time_s), ride(reverse).motion(time_s[:-1] + 0.01)
    for rate, half, value in (
        (motion.speed_mps, middle.speed_mps, along * motion.arc_length_m),
        (motion.acceleration_mps2, middle.acceleration_mps2, motion.speed_mps),
    ):
        simpson = 0.02 / 6 * (rate[:-1] + 4 * half + rate[1:])
        np.testing.assert_allclose(np.cumsum(simpson), value[1:] - value[0], atol=MM)
    assert motion.speed_mps.min() < -5.0
    assert motion.speed_mps.max() > 5.0


@WAYS
def test_integrals_of_rates_are_the_attitude(reverse: bool) -> None:
    time_s = instants()
    motion, middle = ride(reverse).motion(time_s), ride(reverse).motion(time_s[:-1] + 0.01)
    for name in ("roll", "pitch", "yaw"):
        rate, half = (getattr(each, f"{name}_rate_radps") for each in (motion, middle))
        simpson = 0.02 / 6 * (rate[:-1] + 4 * half + rate[1:])
        angle = getattr(motion, f"{name}_rad")
        np.testing.assert_allclose(np.cumsum(simpson), angle[1:] - angle[0], atol=1e-5)


def test_body_stands_on_the_same_place_in_the_same_way_whichever_cab_leads() -> None:
    gone = np.array([550.0, 700.0, 800.0])
    first, last = float(ride().legs[0].ends_m[0]), float(ride().legs[1].ends_m[1])
    time_s = np.arange(0.0, until_s(), 0.001)
    way = ride().gone_m(time_s)
    assert way[0] == first
    assert np.all(np.diff(way) >= 0.0)
    turn_m = float(ride().line.stops_m[3])
    there = ride().motion(np.interp(gone, way, time_s))
    back = ride().motion(np.interp(2 * turn_m - gone, way, time_s))
    assert 2 * turn_m - gone[0] < last
    np.testing.assert_allclose(there.arc_length_m, gone, atol=0.02)
    for name in ("arc_length_m", "yaw_rad", "pitch_rad", "roll_rad"):
        np.testing.assert_allclose(getattr(there, name), getattr(back, name), atol=0.02)
    assert np.all(there.speed_mps > 0.0)
    assert np.all(back.speed_mps < 0.0)


@WAYS
def test_specific_force_is_the_second_derivative_of_position_and_gravity(reverse: bool) -> None:
    time_s, of = np.arange(20.0, until_s(), 0.37), ride(reverse)

    def point_l(at: Array) -> Array:
        p_l = of.position_l(at)
        p_l[:, 2] += np.sum(p_l[:, :2] ** 2, axis=1) / (2 * 6378137.0)
        return p_l

    acceleration_l = (point_l(time_s + STEP_S) - 2 * point_l(time_s) + point_l(time_s - STEP_S)) / (
        STEP_S**2
    )
    motion = of.motion(time_s)
    turn = C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    expected = np.einsum("nvl,nl->nv", turn, acceleration_l + np.array([0.0, 0.0, GRAVITY]))
    error = np.abs(inertial(motion, GRAVITY)[0] - expected)
    assert np.percentile(error, 98) < 5e-3
    assert np.max(error) < 0.05


@WAYS
def test_velocity_of_an_antenna_on_bogies_is_the_derivative_of_its_place(reverse: bool) -> None:
    of = Carriage(Body(), ride(reverse), GRAVITY, until_s())
    time_s, lever = np.arange(20.0, until_s() - 1.0, 0.731), np.array([-3.0, 0.4, 3.2])
    low, high = (of.part(1, time_s + step).point(lever)[0] for step in (-STEP_S, STEP_S))
    velocity_l = antenna_of(of.part(1, time_s), lever)[1]
    np.testing.assert_allclose(velocity_l, (high - low) / (2 * STEP_S), atol=2e-4)


@WAYS
def test_signed_wheels_count_the_way_along_x_and_others_the_way_gone(reverse: bool) -> None:
    time_s, along = instants(), -1.0 if reverse else 1.0
    motion = ride(reverse).motion(time_s)
    signed = Wheels(reverse=reverse).measure(motion)
    unsigned = Wheels(Axle(signed=False), reverse).measure(motion)
    np.testing.assert_array_equal(np.abs(signed), unsigned)
    assert np.min(unsigned) >= 0
    unit = Axle().m_per_pulse
    way = along * (motion.arc_length_m - motion.arc_length_m[0])
    turned = motion.yaw_rad - motion.yaw_rad[0]
    for column, side in ((0, -1.0), (1, 1.0)):
        # Yaw for the turn about z: on grades and cants they differ by a share of some 1e-3.
        off = np.cumsum(signed[:, column]) * unit - way - side * turned * Axle().track_m / 2
        assert np.max(np.abs(off)) < 2 * unit + 10 * MM
    np.testing.assert_allclose(np.cumsum(signed.mean(axis=1)) * unit, way, atol=2 * unit)
    gone = ride(reverse).gone_m(time_s)
    np.testing.assert_allclose(np.cumsum(unsigned.mean(axis=1)) * unit, gone - gone[0],
                               atol=4 * unit)  # fmt: skip


def test_pulses_do_not_depend_on_the_cut_into_blocks() -> None:
    time_s = instants()
    slipped = np.clip(time_s - 20.0, 0.0, 400.0)[:, None] * [0.01, 0.02]
    whole = Wheels().measure(ride().motion(time_s), slipped)
    wheels, cuts = Wheels(), [1, 7, 900, len(time_s) // 2]
    parts = zip(np.split(time_s, cuts), np.split(slipped, cuts), strict=True)
    pieces = [wheels.measure(ride().motion(at), beyond) for at, beyond in parts]
    np.testing.assert_array_equal(whole, np.concatenate(pieces))


def test_locked_wheels_do_not_turn_on_the_way_back_either() -> None:
    back_s = float(ride().dwells_s[3, 1])
    slide = Slide(start_s=back_s + 8.0, duration_s=2.0, factor=0.0)
    of = Happenings(Scenario(events=(slide,)), ride(), np.random.default_rng(1))
    time_s = instants()
    pulses = Wheels(Axle(signed=False)).measure(ride().motion(time_s), of.slipped_m(time_s))
    locked = (time_s > back_s + 8.05) & (time_s < back_s + 9.95)
    assert not np.any(pulses[locked])
    assert np.all(pulses[(time_s > back_s + 10.5) & (time_s < back_s + 11.0)] > 0)
    missing = Wheels(Axle(signed=False)).measure(ride().motion(time_s)).sum(axis=0)
    missing = (missing - pulses.sum(axis=0)) * Axle().m_per_pulse
    lost_m = np.diff(ride().gone_m([back_s + 8.0, back_s + 10.0]))[0]
    np.testing.assert_allclose(missing, lost_m, atol=0.05)


def test_a_joint_is_felt_by_every_bogie_on_every_leg() -> None:
    rough = Roughness(joint_m=50.0, joint_mps2=(0.0, 0.0, 1.0))
    shaking = Shaking(rough, ride(), (0.0, -6.4), np.random.default_rng(1))
    stops, joints = ride().line.stops_m, np.arange(0.0, ride().line.stops_m[-1], 50.0)
    time_s = np.arange(0.0, until_s(), STEP_S)
    motion = ride().motion(time_s)
    force = np.abs(shaking.felt(motion, time_s)[0][:, 2])
    rear_m = motion.arc_length_m - 6.4
    back = (motion.speed_mps < -3.0) & (motion.arc_length_m < stops[3] - 10.0)
    for place in joints[(joints > stops[1] + 60.0) & (joints < stops[3] - 60.0)]:
        for at_m in (motion.arc_length_m, rear_m):
            row = int(np.argmin(np.where(back, np.abs(at_m - place), np.inf)))
            if abs(at_m[row] - place) < 0.05:
                assert force[row : row + 100].max() > 0.1 * abs(motion.speed_mps[row]) / 10.0


@pytest.mark.parametrize(
    ("turns", "what"),
    [((1,), "no stop 1 lies ahead"), ((99,), "has 27"), ((4, 4), "going back"), ((4, 6), "back")],
)
def test_turn_that_does_not_lie_ahead_is_refused(turns: tuple[int, ...], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        Ride(built_in_line(), Limits(turns_back=turns))


def test_one_turn_leads_back_to_the_first_stop() -> None:
    there_and_back = Ride(built_in_line(), Limits(turns_back=(3,)))
    assert float(there_and_back.motion(there_and_back.duration_s).arc_length_m) == 0.0
    assert there_and_back.farthest_m == there_and_back.line.stops_m[2]


def test_breaks_last_as_long_as_said_and_only_where_there_is_a_halt() -> None:
    limits = Limits(breaks=(Break(halt=1, duration_s=300.0), Break(halt=3, duration_s=900.0)))
    dwells = np.diff(Ride(built_in_line(), limits).dwells_s, axis=1)[:4, 0]
    np.testing.assert_allclose(dwells, [300.0, 8.0, 900.0, 8.0])
    with pytest.raises(ConfigError, match="27 halts, none 28"):
        Ride(built_in_line(), Limits(breaks=(Break(halt=28, duration_s=1.0),)))


def test_scenario_says_where_the_driver_turns_back() -> None:
    text = b"[driver]\nturns_back = [4, 2]\nturn_s = 90.0\nbreaks = [{halt = 2, duration_s = 60}]"
    driver = parse(text, "test").driver
    assert driver.turns_back == (4, 2)
    assert driver.breaks == (Break(halt=2, duration_s=60.0),)
