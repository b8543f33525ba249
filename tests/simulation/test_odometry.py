"""Wheels against the way that they roll, and the motor's force against Newton's law."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from motions import motion_of, standing

from tramstream.lines.line import built_in_line
from tramstream.simulation.imu import inertial
from tramstream.simulation.ride import Ride
from tramstream.simulation.wheels import Axle, Wheels, motor_force_n

MM = 1e-3  # m


@cache
def ride() -> Ride:
    return Ride(built_in_line())


@pytest.mark.parametrize("radius_error_m", [(0.0, 0.0), (0.012, 0.016)])
def test_pulses_add_up_to_the_way_of_each_wheel(radius_error_m: tuple[float, float]) -> None:
    axle = Axle(radius_error_m=radius_error_m)
    time = np.arange(0.0, ride().duration_s + 1, 0.02)
    motion = ride().motion(time)
    pulses = Wheels(axle).measure(motion)
    assert np.min(pulses) >= 0
    assert np.max(pulses) < 65536
    # The turn about the vehicle's own z, from the rates: Simpson's rule over steps of 20 ms.
    rate = inertial(motion, 9.81)[1][:, 2]
    middle = inertial(ride().motion(time[:-1] + 0.01), 9.81)[1][:, 2]
    turned = np.cumsum((rate[:-1] + 4 * middle + rate[1:]) * 0.02 / 6)
    turned = np.concatenate([[0.0], turned])
    for column, side in ((0, -1.0), (1, 1.0)):
        way = motion.arc_length_m + side * turned * axle.track_m / 2
        scale = axle.m_per_pulse * (1 + radius_error_m[column] / axle.radius_m)
        behind = way - np.cumsum(pulses[:, column]) * scale
        assert np.min(behind) > -0.1 * MM
        assert np.max(behind) < scale + 0.1 * MM


def test_mean_of_both_wheels_is_the_arc_length_to_one_pulse() -> None:
    motion = ride().motion(np.arange(0.0, ride().duration_s + 1, 0.02))
    pulses = Wheels().measure(motion)
    travelled = np.cumsum(pulses.mean(axis=1)) * Axle().m_per_pulse
    np.testing.assert_allclose(travelled, motion.arc_length_m, atol=Axle().m_per_pulse)


def test_pulses_of_a_turning_wheel_follow_the_speed_difference() -> None:
    # docs/theory.md, section 8.3: c = (v ∓ ω_z l/2) k, here per 0.02 s on a circle of 20 m at
    # 1.4 m/s
    speed, radius, step_s = 1.4, 20.0, 0.02
    time = np.arange(0.0, 10.0, step_s)
    motion = motion_of(
        len(time),
        arc_length_m=speed * time,
        speed_mps=speed,
        yaw_rad=speed / radius * time,
        yaw_rate_radps=speed / radius,
    )
    pulses = Wheels().measure(motion)[1:]
    for column, side in ((0, -1.0), (1, 1.0)):
        expected = speed * (1 + side * 1.435 / 2 / radius) * step_s / Axle().m_per_pulse
        assert np.mean(pulses[:, column]) == pytest.approx(expected, abs=1 / len(pulses))


def test_pulses_do_not_depend_on_the_cut_into_blocks() -> None:
    time = np.arange(0.0, 40.0, 0.02)
    whole = Wheels().measure(ride().motion(time))
    wheels = Wheels()
    pieces = [wheels.measure(ride().motion(part)) for part in np.split(time, [1, 7, 900])]
    np.testing.assert_array_equal(whole, np.concatenate(pieces))


def test_motor_force_is_newtons_law_with_chladeks_resistance() -> None:
    motion = motion_of(speed_mps=10.0, acceleration_mps2=0.5, pitch_rad=-0.05)
    level = 150_000 * 0.5 + 0.5 * 1.05 * 14.484 * 1.201 * 100 + 150_000 * 9.80665 * 0.00005
    uphill = 150_000 * 9.80665 * math.sin(0.05)
    assert motor_force_n(motion) == pytest.approx(level + uphill)
    backwards = motion_of(speed_mps=-10.0, acceleration_mps2=-0.5, pitch_rad=0.05)
    assert motor_force_n(backwards) == pytest.approx(-level - uphill)
    assert not np.any(motor_force_n(standing(3)))


def test_motor_force_without_the_weight_stays_within_chladeks_motor() -> None:
    motion = ride().motion(np.arange(0.0, ride().duration_s, 0.1))
    force = motor_force_n(motion)
    # On the level; on slopes of up to 7 % track brakes and other motors than chladek's help.
    weight = 150_000 * 9.80665 * np.sin(motion.pitch_rad) * ~motion.standing
    assert np.min(force + weight) > -1.2966e5
    assert np.max(force + weight) < 1.4314e5


def test_wheels_of_a_reversed_vehicle_count_down_or_up() -> None:
    time = np.arange(0.0, ride().duration_s + 1, 0.02)
    forward = Wheels().measure(ride().motion(time))
    motion = Ride(built_in_line(), reverse=True).motion(time)
    signed = Wheels(reverse=True).measure(motion)
    unsigned = Wheels(Axle(signed=False), reverse=True).measure(motion)
    np.testing.assert_array_equal(signed, -unsigned)
    # The left wheel of the reversed vehicle rolls where the right one did.
    total = np.cumsum(unsigned, axis=0)
    np.testing.assert_allclose(total[:, ::-1], np.cumsum(forward, axis=0), atol=1)


def test_pulses_of_a_slip_remain_in_the_count() -> None:
    time = np.arange(0.0, 60.0, 0.02)
    motion = ride().motion(time)
    slipped = np.zeros((len(time), 2))
    slipped[:, 0] = np.clip(time - 20.0, 0.0, 2.0) * 0.7
    extra = np.cumsum(Wheels().measure(motion, slipped) - Wheels().measure(motion), axis=0)
    assert extra[-1, 0] * Axle().m_per_pulse == pytest.approx(1.4, abs=2 * Axle().m_per_pulse)
    assert not np.any(extra[:, 1])
    assert not np.any(extra[time < 20.0])
