"""Line geometry against closed forms and against its own derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.geodesy import SEMI_MAJOR_M, LocalLevel
from tramstream.lines.line import Line, Segment, built_in_line, curve, parse_plan

MM = 1e-3  # m
NANOMETRE = 1e-9  # m
LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)


def line_of(*segments: Segment) -> Line:
    length_m = math.fsum(segment.length_m for segment in segments)
    return Line(segments, [0.0, length_m], LEVEL)


def test_straight_runs_east_at_yaw_zero() -> None:
    line = line_of(Segment(100.0))
    np.testing.assert_allclose(line.position_l(62.5)[:2], [62.5, 0.0], atol=NANOMETRE)


@given(st.floats(15.0, 2000.0), st.floats(0.1, 3.0), st.booleans())
def test_arc_is_a_circle(radius_m: float, angle_rad: float, left: bool) -> None:
    sign = 1.0 if left else -1.0
    line = line_of(Segment(radius_m * angle_rad, sign / radius_m, sign / radius_m))
    angle = np.linspace(0.0, angle_rad, 17)
    circle = radius_m * np.stack([np.sin(angle), sign * (1 - np.cos(angle))], axis=1)
    position = line.position_l(radius_m * angle)
    np.testing.assert_allclose(position[:, :2], circle, atol=1e3 * NANOMETRE)


def test_clothoid_ends_where_the_fresnel_integrals_say() -> None:
    # Abramowitz and Stegun, Handbook of Mathematical Functions, table 7.7:
    # C(1) = 0.7798934, S(1) = 0.4382591. A clothoid with κ = π s / L² is L·(C(s/L), S(s/L)).
    length_m = 40.0
    line = line_of(Segment(length_m, 0.0, math.pi / length_m))
    end = line.position_l(length_m)
    np.testing.assert_allclose(
        end[:2], [length_m * 0.7798934, length_m * 0.4382591], atol=length_m * 1e-7
    )


@given(st.floats(15.0, 1500.0), st.floats(-3.0, 3.0).filter(lambda angle: abs(angle) > 0.01))
def test_curve_turns_by_its_angle_and_is_no_tighter_than_its_radius(
    radius_m: float, angle_rad: float
) -> None:
    line = line_of(*curve(radius_m, angle_rad))
    s = np.linspace(0.0, line.length_m, 301)
    assert line.yaw_rad(line.length_m) == pytest.approx(angle_rad, abs=1e-12)
    assert np.max(np.abs(line.curvature_per_m(s))) == pytest.approx(1 / radius_m, rel=1e-9)
    assert abs(line.curvature_per_m(0.0)) + abs(line.curvature_per_m(line.length_m)) < 1e-12


def test_yaw_derivative_is_the_curvature() -> None:
    line = built_in_line()
    s = np.linspace(1.0, line.length_m - 1.0, 50_000)
    step_m = 1e-3
    derivative = (line.yaw_rad(s + step_m) - line.yaw_rad(s - step_m)) / (2 * step_m)
    # The curvature has corners: within a step of one, the difference sees half of its slope.
    corner = step_m * np.max(np.abs(np.diff(line.curvature_per_m(s)) / np.diff(s)))
    np.testing.assert_allclose(derivative, line.curvature_per_m(s), atol=corner + 1e-8)


def test_position_derivative_is_the_direction() -> None:
    line = built_in_line()
    s = np.linspace(1.0, line.length_m - 1.0, 20_000)
    step_m = 1e-3
    tangent = (line.position_l(s + step_m) - line.position_l(s - step_m)) / (2 * step_m)
    yaw, grade = line.yaw_rad(s), line.grade(s)
    direction = [np.cos(grade) * np.cos(yaw), np.cos(grade) * np.sin(yaw), np.sin(grade)]
    # Third derivative of position: κ² ≤ 1/400 and κ' below 1/100, times step²/6.
    np.testing.assert_allclose(tangent[:, :2], np.stack(direction[:2], axis=1), atol=1e-7)
    # Heights follow the Earth: at 3 km from the origin it falls away with half a milliradian.
    sunk = np.hypot(*line.position_l(s)[:, :2].T) / SEMI_MAJOR_M
    assert np.all(np.abs(tangent[:, 2] - direction[2]) <= sunk + 1e-7)


def test_height_is_the_integral_of_the_grade() -> None:
    line = built_in_line()
    s = np.linspace(0.0, line.length_m, 200_001)
    slope = np.sin(line.grade(s))
    risen = np.concatenate([[0.0], np.cumsum((slope[1:] + slope[:-1]) / 2 * np.diff(s))])
    height = line.level.to_geodetic(line.position_l(s[::100]))[:, 2]
    np.testing.assert_allclose(height - height[0], risen[::100], atol=2 * MM)
    assert np.ptp(height) > 30.0


def test_chords_add_up_to_the_arc_length() -> None:
    line = built_in_line()
    position = line.position_l(np.linspace(0.0, line.length_m, 200_001))
    position[:, 2] += np.sum(position[:, :2] ** 2, axis=1) / (2 * SEMI_MAJOR_M)
    chords = np.sum(np.linalg.norm(np.diff(position, axis=0), axis=1))
    # A chord of length c is shorter than its arc by c³κ²/24.
    assert chords == pytest.approx(line.length_m, abs=0.3 * MM)


def test_level_track_keeps_its_height_above_the_ellipsoid() -> None:
    sloping = built_in_line()
    line = Line(sloping.segments, sloping.stops_m.tolist(), sloping.level, math.radians(170.0))
    s = np.linspace(0.0, line.length_m, 500)
    height = line.level.to_geodetic(line.position_l(s))[:, 2]
    np.testing.assert_allclose(height, line.level.height_m, atol=20 * MM)
    assert np.min(line.position_l(s)[:, 2]) > -((6000.0**2) / (2 * SEMI_MAJOR_M))


def test_arc_lengths_beyond_the_ends_are_taken_to_the_ends() -> None:
    line = built_in_line()
    beyond = line.position_l([-5.0, line.length_m + 5.0])
    np.testing.assert_array_equal(beyond, line.position_l([0.0, line.length_m]))
    assert line.yaw_rad(line.length_m + 5.0) == line.yaw_rad(line.length_m)


def test_one_arc_length_and_many_give_the_same_numbers() -> None:
    line = built_in_line()
    s = np.array([10.0, 2345.6, 9000.0])
    many = line.position_l(s)
    assert many.shape == (3, 3)
    assert line.position_l(s[1]).shape == (3,)
    np.testing.assert_allclose(line.position_l(s[1]), many[1], atol=NANOMETRE)


def test_plan_is_read_as_written() -> None:
    segments, stops_m = parse_plan("| 100 R50/90 | 20 |")
    arc_m = 50 * math.pi / 2
    assert len(segments) == 5
    assert stops_m == pytest.approx([0.0, 100 + arc_m + 20, 100 + arc_m + 40])
    assert segments[2].curvature_start_per_m == pytest.approx(-1 / 50)


def test_plan_with_an_unknown_word_is_refused() -> None:
    with pytest.raises(ValueError, match="X12"):
        parse_plan("| 100 X12 |")


def test_built_in_line_is_of_the_references_kind() -> None:
    line = built_in_line()
    assert len(line.stops_m) == 27
    assert line.stops_m[0] == 0.0
    assert line.stops_m[-1] == line.length_m
    assert 11_500 < line.length_m < 12_500
    s = np.linspace(0.0, line.length_m, 100_001)
    assert np.max(np.abs(line.curvature_per_m(s))) == pytest.approx(1 / 20)
    assert np.tan(line.grade(s)).max() == pytest.approx(0.07, abs=1e-6)
    assert np.tan(line.grade(s)).min() < -0.06
    geodetic = np.degrees(line.level.to_geodetic(line.position_l(s))[:, :2])
    assert np.all((geodetic > [49.9, 14.2]) & (geodetic < [50.2, 14.7]))


def test_built_in_line_has_no_corner_and_no_kink() -> None:
    line = built_in_line()
    edges = line.starts_m[1:-1]
    tiny_m = 1e-9
    np.testing.assert_allclose(
        line.curvature_per_m(edges - tiny_m), line.curvature_per_m(edges + tiny_m), atol=1e-9
    )


def test_grade_and_cant_have_no_jump_and_no_kink() -> None:
    line = built_in_line()
    s = np.linspace(1.0, line.length_m - 1.0, 30_011)
    step_m = 1e-3
    for profile in (line.grade, line.cant):
        shape = profile.shape(s)
        derivative = (profile(s + step_m) - profile(s - step_m)) / (2 * step_m)
        # Second derivatives jump at knots: within a step of one, the difference sees half of that.
        corner = step_m * np.max(np.abs(shape.bend_per_m2))
        np.testing.assert_allclose(derivative, shape.slope_per_m, atol=corner + 1e-8)


def test_cant_leans_into_the_curve() -> None:
    line = built_in_line()
    s = np.linspace(0.0, line.length_m, 20_001)
    curvature, cant = line.curvature_per_m(s), line.cant(s)
    assert np.all(cant * curvature <= 1e-12)  # left positive; left side down is a negative roll
    assert np.max(np.abs(cant)) == pytest.approx(0.06)
    tight = np.abs(curvature) > 1 / 25
    np.testing.assert_allclose(np.abs(cant[tight]), 0.04, atol=0.021)


def test_line_without_cant_has_the_same_track() -> None:
    line = built_in_line()
    s = np.linspace(0.0, line.length_m, 101)
    bare = line.without_cant()
    assert bare.cant.flat
    assert not line.cant.flat
    np.testing.assert_array_equal(bare.position_l(s), line.position_l(s))
