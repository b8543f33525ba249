"""The smooth line along a polyline: against the line that the polyline was drawn from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.lines.fit import RADIUS_MIN_M, Course, deviation_m, fit
from tramstream.lines.line import Line, Relief, built_in_line
from tramstream.lines.profile import Profile

LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)


def laid(course: Course) -> Line:
    length_m = sum(segment.length_m for segment in course.segments)
    start_l = (*course.start, 0.0)
    return Line(course.segments, [0.0, length_m], LEVEL, course.yaw_start_rad, start_l)


def drawn(until_m: float, step_m: float) -> NDArray[np.float64]:
    """Nodes of a map of the built-in line."""
    line = built_in_line()
    return line.position_l(np.arange(0.0, until_m, step_m))[:, :2]


def test_fit_finds_the_line_that_was_drawn() -> None:
    truth = built_in_line()
    course = fit(drawn(3000.0, 2.0), truth.grade)
    start_l = (*course.start, 0.0)
    relief = Relief(truth.grade)
    line = Line(course.segments, [0.0, 1.0], LEVEL, course.yaw_start_rad, start_l, relief)
    s = np.arange(0.0, line.length_m, 5.0)
    away = line.position_l(s)[:, :2] - truth.position_l(s)[:, :2]
    # Clothoids of 10 m are the sharpest that there are: the fit rounds them a little.
    assert np.max(np.linalg.norm(away, axis=1)) < 0.5
    difference = line.curvature_per_m(s) - truth.curvature_per_m(s)
    assert np.sqrt(np.mean(difference**2)) < 0.002


def test_fit_is_close_to_nodes_and_smooth() -> None:
    points = drawn(3000.0, 8.0)
    line = laid(fit(points, Profile.level()))
    s = np.arange(0.0, line.length_m, 1.0)
    assert deviation_m(points, line.position_l(s)[:, :2]) < 0.6
    np.testing.assert_allclose(line.position_l(0.0)[:2], points[0], atol=0.3)
    np.testing.assert_allclose(line.position_l(line.length_m)[:2], points[-1], atol=0.6)
    curvature = line.curvature_per_m(s)
    assert np.max(np.abs(curvature)) <= 1 / RADIUS_MIN_M + 1e-12
    # A map's corner of a few degrees every 8 m would be a change of 1/20 m within a metre.
    assert np.max(np.abs(np.diff(curvature))) < 0.005
    edges = line.starts_m[1:-1]
    np.testing.assert_allclose(
        line.curvature_per_m(edges - 1e-9), line.curvature_per_m(edges + 1e-9), atol=1e-9
    )


def test_fit_does_not_follow_the_noise_of_a_map() -> None:
    points = drawn(2000.0, 10.0)
    noisy = points + np.random.default_rng(8).normal(0.0, 0.3, points.shape)
    line, clean = laid(fit(noisy, Profile.level())), laid(fit(points, Profile.level()))
    s = np.arange(20.0, min(line.length_m, clean.length_m) - 20.0, 5.0)
    away = deviation_m(points, line.position_l(np.arange(0.0, line.length_m))[:, :2])
    assert away < 1.5
    difference = line.curvature_per_m(s * line.length_m / clean.length_m) - clean.curvature_per_m(s)
    # Noise of 0.3 m every 10 m, followed, would bend by 4·0.3/10² = 0.012 a node.
    assert np.std(difference) < 0.006


def test_fit_of_a_straight_is_straight() -> None:
    points = np.array([[0.0, 0.0], [300.0, 100.0], [900.0, 300.0]])
    course = fit(points, Profile.level())
    line = laid(course)
    assert line.length_m == pytest.approx(np.hypot(900.0, 300.0), abs=1e-3)
    assert np.max(np.abs(line.curvature_per_m(np.arange(0.0, line.length_m)))) < 1e-7
    assert course.yaw_start_rad == pytest.approx(np.arctan2(100.0, 300.0))


def test_way_up_a_slope_is_longer_than_the_plan() -> None:
    points = np.array([[0.0, 0.0], [1000.0, 0.0]])
    slope = Profile([0.0, 2000.0], [0.08, 0.08])
    length_m = sum(segment.length_m for segment in fit(points, slope).segments)
    assert length_m == pytest.approx(1000.0 / np.cos(0.08), abs=1e-3)


def test_chainage_beside_the_line_runs_with_it() -> None:
    points = drawn(1500.0, 8.0)
    course = fit(points, Profile.level())
    assert np.all(np.diff(course.arc_length_m) > 0)
    assert np.all(np.diff(course.chainage_m) >= 0)
    assert np.max(np.abs(course.chainage_m - course.arc_length_m)) < 3.0


def test_hairpin_that_no_tram_can_follow_is_refused() -> None:
    points = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 0.5], [0.0, 0.5]])
    with pytest.raises(ConfigError, match="radius 18 m"):
        fit(points, Profile.level())
