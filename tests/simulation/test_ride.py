"""The speed profile keeps its limits, and its derivatives fit together."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.lines.line import Line, Segment, built_in_line, parse_plan
from tramstream.simulation.ride import Limits, Ride

MM = 1e-3  # m
MICROMETRE = 1e-6  # m
ROUNDING = 1e-9  # of speeds and accelerations, SI
LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)
STEP_S = 0.01


@cache
def built_in() -> Ride:
    return Ride(built_in_line())


def instants(ride: Ride) -> NDArray[np.float64]:
    return np.arange(0.0, ride.duration_s + 20.0, STEP_S)


def straight(length_m: float, limits: Limits | None = None) -> Ride:
    return Ride(Line([Segment(length_m)], [0.0, length_m], LEVEL), limits)


def test_integral_of_speed_is_the_arc_length() -> None:
    ride = built_in()
    time = instants(ride)
    motion = ride.motion(time)
    middle = ride.motion(time[:-1] + STEP_S / 2).speed_mps
    # Simpson's rule is exact for a parabola; where the jerk jumps it errs by j·dt³/24 at most.
    simpson = STEP_S / 6 * (motion.speed_mps[:-1] + 4 * middle + motion.speed_mps[1:])
    np.testing.assert_allclose(
        np.cumsum(simpson), motion.arc_length_m[1:] - motion.arc_length_m[0], atol=MM
    )


def test_acceleration_is_the_derivative_of_speed_and_jerk_is_bounded() -> None:
    ride = built_in()
    motion = ride.motion(instants(ride))
    jerk = np.diff(motion.acceleration_mps2) / STEP_S
    assert np.max(np.abs(jerk)) <= ride.limits.jerk_mps3 + 1e-9
    mean = (motion.acceleration_mps2[:-1] + motion.acceleration_mps2[1:]) / 2
    derivative = np.diff(motion.speed_mps) / STEP_S
    np.testing.assert_allclose(derivative, mean, atol=ride.limits.jerk_mps3 * STEP_S)


def test_limits_of_speed_acceleration_and_lateral_acceleration_are_kept() -> None:
    ride = built_in()
    motion = ride.motion(instants(ride))
    assert np.min(motion.speed_mps) >= -ROUNDING
    assert np.max(motion.speed_mps) <= ride.limits.speed_mps + ROUNDING
    assert np.max(np.abs(motion.acceleration_mps2)) <= ride.limits.acceleration_mps2 + ROUNDING
    lateral = np.abs(motion.speed_mps * motion.yaw_rate_radps)
    assert np.max(lateral) <= ride.limits.lateral_mps2 + ROUNDING


def test_limits_are_used_to_the_full_somewhere() -> None:
    ride = built_in()
    motion = ride.motion(instants(ride))
    assert np.max(motion.speed_mps) == pytest.approx(ride.limits.speed_mps, abs=0.01)
    assert np.max(motion.acceleration_mps2) == pytest.approx(0.5)
    assert np.min(motion.acceleration_mps2) == pytest.approx(-0.5)
    assert np.max(motion.speed_mps * motion.yaw_rate_radps) == pytest.approx(0.1)


def test_heading_derivative_is_curvature_times_speed() -> None:
    ride = built_in()
    time = instants(ride)
    motion = ride.motion(time)
    expected = ride.line.curvature_per_m(motion.arc_length_m) * motion.speed_mps
    np.testing.assert_allclose(motion.yaw_rate_radps, expected, atol=1e-15)
    derivative = np.diff(motion.yaw_rad) / STEP_S
    mean = (expected[:-1] + expected[1:]) / 2
    np.testing.assert_allclose(derivative, mean, atol=1e-4)  # rad/s: yaw acceleration times step


def test_every_stop_is_reached_exactly_and_kept_for_the_dwell() -> None:
    ride = built_in()
    arrival, departure = ride.dwells_s.T
    assert len(arrival) == len(ride.line.stops_m) == 27
    dwell = np.full(27, ride.limits.dwell_s)
    dwell[0], dwell[-1] = ride.limits.first_dwell_s, np.inf
    np.testing.assert_allclose(departure - arrival, dwell)
    for instant in (arrival, np.minimum(departure, 1e5) - MICROMETRE):
        motion = ride.motion(instant)
        np.testing.assert_array_equal(motion.arc_length_m, ride.line.stops_m)
        assert np.all(motion.standing)
        assert not np.any(motion.speed_mps)
        assert not np.any(motion.acceleration_mps2)


def test_dwells_of_chance_lie_between_the_limits_and_differ() -> None:
    limits = Limits(dwell_s=20.0, dwell_max_s=60.0)
    ride, again, other = (
        Ride(built_in_line(), limits, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    dwell = np.diff(ride.dwells_s, axis=1)[1:-1, 0]
    assert np.all((dwell >= 20.0) & (dwell < 60.0))
    assert np.mean(dwell) == pytest.approx(40.0, abs=4 * 40.0 / math.sqrt(12 * len(dwell)))
    np.testing.assert_array_equal(ride.dwells_s, again.dwells_s)
    assert np.all(ride.dwells_s[2:-1] != other.dwells_s[2:-1])
    shortest = np.diff(Ride(built_in_line(), limits).dwells_s, axis=1)[1:-1, 0]
    np.testing.assert_allclose(shortest, 20.0)


def test_motion_has_no_jump_where_phases_meet() -> None:
    ride = built_in()
    edges = ride.phases.t0[1:]
    tiny_s = 1e-9
    before, after = ride.motion(edges - tiny_s), ride.motion(edges + tiny_s)
    np.testing.assert_allclose(before.arc_length_m, after.arc_length_m, atol=MICROMETRE)
    np.testing.assert_allclose(before.speed_mps, after.speed_mps, atol=1e-7)
    np.testing.assert_allclose(before.acceleration_mps2, after.acceleration_mps2, atol=1e-6)


def test_long_straight_takes_the_time_of_the_closed_form() -> None:
    # A change of v takes v/a + a/j over v/2 times that; the rest runs at full speed.
    limits = Limits(first_dwell_s=0.0)
    change_s = 15.0 / 0.5 + 0.5 / 0.2
    length_m = 15.0 * change_s + 300.0
    assert straight(length_m, limits).duration_s == pytest.approx(2 * change_s + 300.0 / 15.0)


def test_short_straight_takes_the_time_of_the_closed_form() -> None:
    # Too short for full acceleration: four phases of duration t at full jerk, s = 2 j t³.
    limits = Limits(first_dwell_s=0.0)
    duration_s = 4 * (1.0 / (2 * 0.2)) ** (1 / 3)
    assert straight(1.0, limits).duration_s == pytest.approx(duration_s)


words = st.one_of(
    st.floats(1.0, 400.0).map(lambda length: f"{length:.3f}"),
    st.tuples(st.sampled_from("LR"), st.floats(18.0, 900.0), st.floats(2.0, 170.0)).map(
        lambda curve: f"{curve[0]}{curve[1]:.3f}/{curve[2]:.3f}"
    ),
)
plans = st.lists(st.one_of(words, words, st.just("50 | 50")), min_size=1, max_size=8)


@given(plans)
@settings(max_examples=40)
def test_any_plan_gives_a_ride_within_the_limits(words: list[str]) -> None:
    segments, stops_m = parse_plan(f"| {' '.join(words)} |")
    ride = Ride(Line(segments, stops_m, LEVEL))
    time = np.linspace(0.0, ride.duration_s + 1.0, 4001)
    motion = ride.motion(time)
    assert np.all(np.diff(motion.arc_length_m) >= -ROUNDING)
    assert np.max(motion.speed_mps) <= 15.0 + ROUNDING
    assert np.max(np.abs(motion.acceleration_mps2)) <= 0.5 + 1e-6
    assert np.max(np.abs(motion.speed_mps * motion.yaw_rate_radps)) <= 0.1 + 1e-6
    assert motion.arc_length_m[-1] == stops_m[-1]
    edges = ride.phases.t0[1:]
    gap_m = ride.motion(edges).arc_length_m - ride.motion(edges - 1e-9).arc_length_m
    np.testing.assert_allclose(gap_m, 0.0, atol=MICROMETRE)


def test_first_minute_shows_departure_curve_braking_and_stop() -> None:
    ride = built_in()
    minute = ride.motion(np.arange(0.0, 60.0, STEP_S))
    assert minute.standing[0]
    assert ride.dwells_s[0, 1] == pytest.approx(2.0)
    assert np.max(np.abs(minute.yaw_rate_radps)) > 0.02
    assert np.min(minute.acceleration_mps2) < -0.4
    assert 40.0 < ride.dwells_s[1, 0] < ride.dwells_s[1, 1] < 60.0


def test_doors_are_open_only_while_standing() -> None:
    ride = built_in()
    time = instants(ride)
    opened = ride.doors_open(time)
    assert np.all(ride.motion(time).standing[opened])
    assert np.count_nonzero(np.diff(opened.astype(int)) == 1) == 26  # not in the short first dwell
    assert not ride.doors_open(-1.0)


def test_time_before_the_start_and_after_the_end_is_standstill() -> None:
    ride = built_in()
    motion = ride.motion([-10.0, 1e6])
    np.testing.assert_array_equal(motion.arc_length_m, [0.0, ride.line.length_m])
    assert np.all(motion.standing)


def test_truth_message_holds_the_motion_in_its_units() -> None:
    ride = built_in()
    truth = ride.truth(25.0, 123)
    motion = ride.motion(25.0)
    assert truth.stamp_ns == 123
    assert truth.arc_length_m == motion.arc_length_m
    assert truth.speed_mps == motion.speed_mps
    assert not truth.standing
    turned = convergence_rad(ride.line.level, math.radians(truth.longitude_deg))
    expected = float(motion.yaw_rad - turned)
    assert math.isclose(math.cos(truth.yaw_rad), math.cos(expected))
    geodetic = [
        math.radians(truth.latitude_deg),
        math.radians(truth.longitude_deg),
        truth.height_ellipsoid_m,
    ]
    np.testing.assert_allclose(
        ride.line.level.from_geodetic(geodetic), ride.position_l(25.0), atol=MICROMETRE
    )


def test_reversed_ride_is_the_same_with_the_vehicle_turned_round() -> None:
    forward, backward = built_in(), Ride(built_in_line(), reverse=True)
    time = np.arange(0.0, forward.duration_s, 1.7)
    one, other = forward.motion(time), backward.motion(time)
    np.testing.assert_array_equal(other.arc_length_m, one.arc_length_m)
    np.testing.assert_array_equal(other.speed_mps, -one.speed_mps)
    np.testing.assert_array_equal(other.acceleration_mps2, -one.acceleration_mps2)
    np.testing.assert_allclose(np.cos(other.yaw_rad - one.yaw_rad), -1.0, atol=ROUNDING)
    np.testing.assert_array_equal(other.yaw_rate_radps, one.yaw_rate_radps)
    np.testing.assert_array_equal(other.pitch_rad, -one.pitch_rad)
    np.testing.assert_array_equal(other.roll_rad, -one.roll_rad)
    assert np.min(one.pitch_rad) == pytest.approx(-math.atan(0.07), abs=1e-4)  # uphill: nose up


def test_time_at_an_arc_length_is_when_the_ride_gets_there() -> None:
    ride = built_in()
    for arc_length_m in (0.1, 131.0, 777.7, 5000.0, ride.line.length_m - 0.01):
        time_s = ride.time_at_s(arc_length_m)
        assert float(ride.motion(time_s).arc_length_m) == pytest.approx(
            arc_length_m, abs=MICROMETRE
        )
    arrival = ride.dwells_s[3, 0]
    # The speed goes to zero with its square: a nanometre before the stop is a centisecond away.
    assert ride.time_at_s(float(ride.line.stops_m[3])) == pytest.approx(arrival, abs=0.05)
    assert ride.time_at_s(1e9) == pytest.approx(ride.duration_s)


def test_rates_of_attitude_are_derivatives() -> None:
    ride = built_in()
    time, step_s = np.arange(10.0, 3000.0, 0.73), 1e-3
    before, motion, after = (ride.motion(time + shift) for shift in (-step_s, 0.0, step_s))
    for name in ("yaw", "pitch", "roll"):
        rate = getattr(motion, f"{name}_rate_radps")
        change = getattr(after, f"{name}_rad") - getattr(before, f"{name}_rad")
        np.testing.assert_allclose(change / (2 * step_s), rate, atol=2e-5)
        bend = getattr(after, f"{name}_rate_radps") - getattr(before, f"{name}_rate_radps")
        acceleration = getattr(motion, f"{name}_acceleration_radps2")
        error = np.abs(bend / (2 * step_s) - acceleration)
        assert np.percentile(error, 98) < 1e-4  # the rest lies across corners
