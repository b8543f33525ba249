"""Line geometry against closed forms and against its own derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.geodesy import SEMI_MAJOR_M, LocalLevel
from tramstream.line import Line, Segment, built_in_line, curve, parse_plan

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
    tangent = (line.position_l(s + step_m) - line.position_l(s - step_m))[:, :2] / (2 * step_m)
    yaw = line.yaw_rad(s)
    # Third derivative of position: κ² ≤ 1/400 and κ' below 1/100, times step²/6.
    np.testing.assert_allclose(tangent, np.stack([np.cos(yaw), np.sin(yaw)], axis=1), atol=1e-7)


def test_chords_add_up_to_the_arc_length() -> None:
    line = built_in_line()
    position = line.position_l(np.linspace(0.0, line.length_m, 200_001))[:, :2]
    chords = np.sum(np.hypot(*np.diff(position, axis=0).T))
    # A chord of length c is shorter than its arc by c³κ²/24.
    assert chords == pytest.approx(line.length_m, abs=0.1 * MM)


def test_level_track_keeps_its_height_above_the_ellipsoid() -> None:
    line = built_in_line()
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
    geodetic = np.degrees(line.level.to_geodetic(line.position_l(s))[:, :2])
    assert np.all((geodetic > [49.9, 14.2]) & (geodetic < [50.2, 14.7]))


def test_built_in_line_has_no_corner_and_no_kink() -> None:
    line = built_in_line()
    edges = line.starts_m[1:-1]
    tiny_m = 1e-9
    np.testing.assert_allclose(
        line.curvature_per_m(edges - tiny_m), line.curvature_per_m(edges + tiny_m), atol=1e-9
    )
