"""The body on its bogies and springs, against geometry and integration made independently."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tramstream import keys
from tramstream.attitude import C_vl
from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Relief, built_in_line, parse_plan, usual_cant
from tramstream.simulation.body import Body, Carriage, antenna_of, inertial_of
from tramstream.simulation.imu import inertial
from tramstream.simulation.receiver import antenna_motion
from tramstream.simulation.ride import Limits, Ride
from tramstream.simulation.scenario import Gnss, Scenario
from tramstream.simulation.simulation import Simulation, stamps_ns

Array = NDArray[np.float64]

GRAVITY = 9.81  # m/s²
EARTH_M = 6378137.0
STIFF = {"pitch_deg_per_mps2": 0.0, "roll_deg_per_mps2": 0.0}
BRISK = Limits(speed_mps=12.0, acceleration_mps2=1.2, jerk_mps3=0.8, lateral_mps2=0.8)
MICRO = 1e-6
PIVOT_M = 6.4
JOINTED = (0.0, -6.0, -13.0, -19.0)
"""Three parts on four bogies."""


@cache
def ride(reverse: bool = False, line: Line | None = None) -> Ride:
    return Ride(line or built_in_line(), BRISK, reverse)


@cache
def carriage(reverse: bool = False, **fields: Any) -> Carriage:
    return Carriage(Body(**fields), ride(reverse), GRAVITY, 200.0)


def flat_l(line: Line, arc_length_m: float) -> Array:
    """Position with the Earth laid out flat; before the line its first direction goes on."""
    inside = min(max(arc_length_m, 0.0), line.length_m)
    p_l = line.position_l(np.array([inside]))[0]
    p_l[2] += (p_l[0] ** 2 + p_l[1] ** 2) / (2 * EARTH_M)
    yaw, grade = line.yaw_rad(inside), line.grade(np.array([inside]))[0]
    level = math.cos(grade)
    direction = np.array([level * np.cos(yaw), level * np.sin(yaw), np.sin(grade)])
    return p_l + (arc_length_m - inside) * direction


def behind(line: Line, front: Array, s: float, length_m: float, way: float) -> tuple[float, Array]:
    """Where a pivot at a distance from another one is, by bisection; `way` 1 is behind it."""

    def excess(at: float) -> float:
        return float(np.linalg.norm(front - flat_l(line, at))) - length_m

    found = brentq(excess, s - way * 0.5 * length_m, s - way * 2.0 * length_m, xtol=1e-12)
    return found, flat_l(line, found)


# Geometry -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_axis_of_a_part_is_the_chord_between_its_pivots(reverse: bool, number: int) -> None:
    of = carriage(reverse, pivots_m=JOINTED, **STIFF)
    time_s = np.array([0.0, 17.0, 26.0, 33.0, 41.0, 58.0, 90.0, 133.0])
    part = of.part(number, time_s)
    motion = ride(reverse).motion(time_s)
    line, way = ride().line, -1.0 if reverse else 1.0
    for row, s in enumerate(motion.arc_length_m.tolist()):
        place = flat_l(line, s)
        cants = []
        for front_x, rear_x in pairwise(JOINTED[: number + 1]):
            front, cants = place, [*cants, way * line.cant(np.array([s]))[0]]
            s, place = behind(line, front, s, front_x - rear_x, way)
        chord = front - place
        np.testing.assert_allclose(part.pivots.p_l[row], front, atol=MICRO)
        yaw = math.atan2(chord[1], chord[0])
        assert math.remainder(part.chord.yaw_rad[row] - yaw, math.tau) == pytest.approx(0, abs=1e-9)
        pitch = -math.atan2(chord[2], math.hypot(chord[0], chord[1]))
        assert part.chord.pitch_rad[row] == pytest.approx(pitch, abs=1e-9)
        roll = (cants[-1] + way * line.cant(np.array([s]))[0]) / 2
        assert part.chord.roll_rad[row] == pytest.approx(roll, abs=1e-9)


def test_in_a_steady_curve_the_axis_is_turned_by_half_the_angle_that_the_chord_spans() -> None:
    segments, stops_m = parse_plan("| 60 L50/170 60 |")
    line = Line(segments, stops_m, LocalLevel.at_deg(50.0, 14.0, 250.0))
    of = Carriage(Body(**STIFF), ride(line=line), GRAVITY, 60.0)
    time_s = np.array([ride(line=line).time_at_s(s) for s in (110.0, 130.0, 150.0)])
    track = ride(line=line).motion(time_s)
    off = track.yaw_rad - of.part(1, time_s).chord.yaw_rad
    np.testing.assert_allclose(off, math.asin(PIVOT_M / 2 / 50.0), rtol=1e-6)
    assert np.degrees(off[0]) > 3.6  # which nobody may take for the heading of the track
    np.testing.assert_allclose(of.part(1, time_s).chord.yaw_rate_radps, track.yaw_rate_radps)


def test_yaw_is_as_continuous_as_that_of_the_track() -> None:
    time_s = np.arange(0.0, 200.0, 0.05)
    yaw = carriage(**STIFF).part(1, time_s).chord.yaw_rad
    assert np.abs(yaw - ride().motion(time_s).yaw_rad).max() < 0.3
    assert np.abs(np.diff(yaw)).max() < 0.05


# Derivatives --------------------------------------------------------------------------------------
INSTANTS_S = np.arange(20.0, 190.0, 0.731)
STEP_S = 1e-3


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("fields", [STIFF, {}, {"pivots_m": JOINTED}], ids=["stiff", "sprung", "2"])
def test_rates_and_accelerations_are_derivatives(reverse: bool, fields: dict[str, Any]) -> None:
    of, number = carriage(reverse, **fields), 2 if "pivots_m" in fields else 1
    before, at, after = (of.part(number, INSTANTS_S + step).body for step in (-STEP_S, 0.0, STEP_S))
    for name in ("roll", "pitch", "yaw"):
        low, here, high = (getattr(each, f"{name}_rad") for each in (before, at, after))
        rate = (high - low) / (2 * STEP_S)
        np.testing.assert_allclose(getattr(at, f"{name}_rate_radps"), rate, atol=2e-6)
        bend = (high - 2 * here + low) / STEP_S**2
        seen = np.abs(getattr(at, f"{name}_acceleration_radps2") - bend)
        assert np.percentile(seen, 97) < 2e-5  # but where the jerk or a node's slope changes
        assert seen.max() < 0.05


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("fields", [STIFF, {}, {"pivots_m": JOINTED}], ids=["stiff", "sprung", "2"])
def test_force_and_velocity_of_a_sensor_are_derivatives_of_its_place(
    reverse: bool, fields: dict[str, Any]
) -> None:
    of, number = carriage(reverse, **fields), 2 if "pivots_m" in fields else 1
    lever = of.lever_v(number, (-7.0, 0.4, 3.2))
    up = (0.0, 0.0, 1.0)
    before, at, after = (of.part(number, INSTANTS_S + step) for step in (-STEP_S, 0.0, STEP_S))
    low, here, high = (each.point(lever)[0] for each in (before, at, after))
    acceleration_l = (high - 2 * here + low) / STEP_S**2 + np.array([0.0, 0.0, GRAVITY])
    f_v, omega_v = inertial_of(at, GRAVITY, lever, up)
    seen = np.abs(f_v - np.einsum("nvl,nl->nv", at.body.C_vl, acceleration_l)).max(axis=1)
    assert np.percentile(seen, 97) < 2e-4
    _, velocity_l = antenna_of(at, lever)
    np.testing.assert_allclose(velocity_l, (high - low) / (2 * STEP_S), atol=1e-5)
    C = [each.body.C_vl for each in (before, after)]
    turned = np.einsum("nvl,nwl->nvw", (C[1] - C[0]) / (2 * STEP_S), at.body.C_vl)
    np.testing.assert_allclose(omega_v[:, 2], (turned[:, 0, 1] - turned[:, 1, 0]) / 2, atol=2e-6)


def test_short_stiff_body_is_the_point_that_follows_the_rail() -> None:
    of = carriage(pivots_m=(0.0, -0.002), **STIFF)
    motion = ride().motion(INSTANTS_S)
    lever = (3.0, 0.5, 3.0)
    part = of.part(1, INSTANTS_S)
    up = (0.0, 0.0, 1.0)
    f_v, omega_v = inertial_of(part, GRAVITY, np.array(lever), up)
    expected_f, expected_omega = inertial(motion, GRAVITY, lever, up)
    np.testing.assert_allclose(omega_v, expected_omega, atol=2e-5)
    np.testing.assert_allclose(f_v, expected_f, atol=2e-3)
    p_l = ride().line.position_l(motion.arc_length_m)
    expected = antenna_motion(p_l, motion, np.array(lever))
    np.testing.assert_allclose(antenna_of(part, np.array(lever)), expected, atol=2e-4)


# Springs ------------------------------------------------------------------------------------------
def test_springs_answer_as_an_oscillator_that_is_integrated() -> None:
    fields: dict[str, Any] = {"pitch_hz": 1.3, "roll_hz": 1.1, "damping": 0.2}
    of, stiff = carriage(**fields), carriage(**STIFF)
    nodes_s = np.arange(0.0, 70.0, 0.01)
    part = stiff.part(1, nodes_s)
    gravity_l = GRAVITY * ride().up_l(ride().motion(nodes_s))
    force = np.einsum("nvl,nl->nv", part.chord.C_vl, part.pivots.middle_acc_l + gravity_l)
    sprung = of.part(1, nodes_s).body
    for name, hz, sign, axis in (("pitch", 1.3, -1.0, 0), ("roll", 1.1, 1.0, 1)):
        omega, target = math.tau * hz, sign * math.radians(0.3) * force[:, axis]

        def moved(t: float, x: Array, omega: float = omega, target: Array = target) -> list[float]:
            wanted = np.interp(t, nodes_s, target)
            return [x[1], omega**2 * (wanted - x[0]) - 2 * 0.2 * omega * x[1]]

        start = [target[0], 0.0]
        found = solve_ivp(
            moved, (0.0, 69.0), start, max_step=0.01, rtol=1e-8, t_eval=nodes_s[:6900]
        )
        added = getattr(sprung, f"{name}_rad") - getattr(part.chord, f"{name}_rad")
        assert np.degrees(np.abs(added).max()) > 0.1
        np.testing.assert_allclose(added[:6900], found.y[0], atol=3e-6)


def test_braking_bows_accelerating_rears_and_curves_lean_outwards() -> None:
    segments, stops_m = parse_plan("| 200 L60/90 200 |")
    line = Line(segments, stops_m, LocalLevel.at_deg(50.0, 14.0, 250.0))
    along = Ride(line, Limits(speed_mps=6.0, acceleration_mps2=0.5, jerk_mps3=0.5))
    of = Carriage(Body(), along, GRAVITY, along.duration_s)
    bend_s = along.time_at_s(260.0)
    times = np.array([6.0, bend_s, along.duration_s - 5.0])
    body, track = of.part(1, times).body, along.motion(times)
    nodded = np.degrees(body.pitch_rad)
    assert nodded[0] == pytest.approx(-0.3 * track.acceleration_mps2[0], abs=0.02)
    assert nodded[2] == pytest.approx(-0.3 * track.acceleration_mps2[2], abs=0.02)
    assert nodded[0] < -0.1
    assert nodded[2] > 0.1
    lateral = track.speed_mps[1] ** 2 / 60.0
    assert np.degrees(body.roll_rad[1]) == pytest.approx(0.3 * lateral, rel=0.1)


def test_cant_of_60_mm_moves_an_antenna_3_m_up_by_12_cm() -> None:
    segments, stops_m = parse_plan("| 200 L60/180 200 |")
    relief = Relief(cant=usual_cant(segments))
    line = Line(segments, stops_m, LocalLevel.at_deg(50.0, 14.0, 250.0), relief=relief)
    along = Ride(line, Limits(speed_mps=2.0, lateral_mps2=3.0))
    of = Carriage(Body(**STIFF), along, GRAVITY, along.duration_s)
    time_s = np.array([along.time_at_s(290.0)])
    high, low = (antenna_of(of.part(1, time_s), np.array([0.0, 0.0, z]))[0] for z in (3.0, 0.0))
    cant = line.cant(np.array([290.0]))[0]
    moved = float(np.hypot(*(high - low)[0, :2]))
    assert moved * 0.06 / (1.5 * abs(cant)) == pytest.approx(0.12, rel=0.01)


# The ride -----------------------------------------------------------------------------------------
def test_truth_is_the_body_on_the_track_and_the_grade_beside_it() -> None:
    simulation = Simulation(built_in_line(), Scenario(body=Body(), driver=BRISK), 1, 70.0)
    messages = [each.message for each in simulation.samples() if each.key is keys.TRUTH_STATE]
    time_s = np.arange(len(messages)) / 20.0
    motion, p_l = simulation.truth(stamps_ns(time_s))
    np.testing.assert_allclose(p_l, simulation.line.position_l(motion.arc_length_m))
    roll, pitch, yaw = simulation.ride.attitude(motion)
    np.testing.assert_array_equal([each.yaw_rad for each in messages], yaw)
    np.testing.assert_array_equal([each.pitch_rad for each in messages], pitch)
    np.testing.assert_array_equal([each.roll_rad for each in messages], roll)
    grade = np.array([each.grade_rad for each in messages])
    assert np.degrees(np.abs(grade + pitch)).max() > 0.2
    point = Simulation(built_in_line(), Scenario(driver=BRISK), 1, 70.0).truth(stamps_ns(time_s))
    expected = simulation.ride.attitude(point.motion)[1]
    np.testing.assert_allclose(grade, -expected, atol=1e-12)
    track = simulation.ride.motion(time_s)
    off = track.yaw_rad - motion.yaw_rad
    np.testing.assert_allclose(motion.speed_mps, track.speed_mps * np.cos(off), atol=2e-3)
    np.testing.assert_allclose(
        np.gradient(motion.speed_mps, 0.05)[5:-5], motion.acceleration_mps2[5:-5], atol=0.03
    )


def test_sensors_of_a_part_behind_turn_later_than_those_in_front() -> None:
    of = carriage(pivots_m=JOINTED, **STIFF)
    time_s = np.arange(0.0, 100.0, 0.05)
    rates = [of.part(number, time_s).body.yaw_rate_radps for number in (1, 3)]
    shift = np.argmax(np.correlate(rates[1], rates[0], "full")) - (len(time_s) - 1)
    assert 10 < shift < 60  # of 0.05 s: 13 m at 5 to 12 m/s, and slower in curves


def test_pivots_that_do_not_descend_and_parts_that_a_body_has_not_are_refused() -> None:
    with pytest.raises(ValueError, match="descends"):
        Body(pivots_m=(0.0, 6.4))
    with pytest.raises(ValueError, match="the body has 1"):
        Scenario(body=Body(), gnss=Gnss(part=2))


def test_turn_of_the_body_is_that_of_its_angles() -> None:
    part = carriage().part(1, INSTANTS_S)
    expected = C_vl(part.body.roll_rad, part.body.pitch_rad, part.body.yaw_rad)
    np.testing.assert_array_equal(part.body.C_vl, expected)
