"""Geometry of the rails: against the lines that they were sampled from, and against brute force."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from networks import (
    LEVEL,
    Array,
    Made,
    arc,
    crossover,
    curved,
    double,
    ladder,
    laid,
    made,
    network_of,
    passing_loop,
    straight,
    switch,
)
from numpy.typing import NDArray

from tramstream.lines.line import Line, built_in_line
from tramstream.tracks.network import Network
from tramstream.tracks.rails import (
    Search,
    beside,
    nearest_sample,
    place,
    rails_of,
    sample_at,
    views_of,
)

MM = 1e-3  # m
MRAD = 1e-3
POINTS = 300
FINE_M = 0.1
TIGHT = arc(20.0, 2.0)
"""No tram's curve is tighter."""


def city() -> Made:
    """A line of 12 km with curves of 20 m and more, level."""
    line = built_in_line()
    start = line.position_l(0.0)[:2].tolist()
    return made({"line": laid(line.segments, start, float(line.yaw_rad(0.0)), line.level)})


def plan_of(line: Line, network: Network, s: Array) -> Array:
    """Exact places of a line in the plan."""
    return network.plan_of(line.level.to_geodetic(line.position_l(s)))


@pytest.mark.parametrize(
    "case", [curved(), city(), made({"tight": laid(TIGHT)})], ids=["curved", "city", "tight"]
)
def test_place_is_that_of_the_line_within_a_millimetre(case: Made) -> None:
    (line,) = case.lines.values()
    rails = rails_of(case.network)
    s = np.random.default_rng(1).uniform(0.0, line.length_m, 10 * POINTS)
    found = np.array([place(rails, 0, each) for each in s.tolist()])
    off = np.hypot(*(found[:, :2] - plan_of(line, case.network, s)).T)
    assert off.max() < MM
    np.testing.assert_allclose(found[:, 2], line.yaw_rad(s), atol=1 * MRAD)
    # A sample away from where a curve begins abruptly, curvature is the line's.
    assert np.quantile(np.abs(found[:, 3] - line.curvature_per_m(s)), 0.9) < 1e-6


def test_place_goes_on_straight_beyond_the_ends() -> None:
    case = made({"arc": laid(arc(50.0, 1.0))})
    rails = rails_of(case.network)
    length = float(case.network.length_m[0])
    for run in (0, 1):
        for end, beyond in ((0.0, -7.0), (length, length + 7.0)):
            e, n, yaw, _ = place(rails, run, end)
            e2, n2, yaw2, curvature = place(rails, run, beyond)
            way = beyond - end
            np.testing.assert_allclose(
                (e2 - e, n2 - n), (way * math.cos(yaw), way * math.sin(yaw)), atol=MM
            )
            assert yaw2 == pytest.approx(yaw, abs=1e-9)
            assert curvature == 0.0


def test_runs_backwards_mirror_runs_forwards() -> None:
    rails = rails_of(curved().network)
    length = float(curved().network.length_m[0])
    for s in np.linspace(-5.0, length + 5.0, POINTS).tolist():
        e, n, yaw, k = place(rails, 0, s)
        back_e, back_n, back_yaw, back_k = place(rails, 1, length - s)
        np.testing.assert_allclose((back_e, back_n), (e, n), atol=1e-9)
        assert math.cos(back_yaw - yaw) == pytest.approx(-1.0)
        assert back_k == pytest.approx(-k, abs=1e-12)
        assert abs(sample_at(rails, 1, length - s) - sample_at(rails, 0, s)) <= 1
        assert nearest_sample(views_of(rails), 0, s) == sample_at(rails, 0, s)


def test_across_is_left_of_the_run_whichever_way_it_goes() -> None:
    rails = rails_of(curved().network)
    length = float(curved().network.length_m[0])
    rng = np.random.default_rng(2)
    for s, way in zip(rng.uniform(1, length - 1, 50), rng.uniform(-8, 8, 50), strict=True):
        e, n, yaw, _ = place(rails, 0, s)
        e, n = e - way * math.sin(yaw), n + way * math.cos(yaw)
        found, across, heading, k = beside(rails, 0, s + 1.0, e, n)
        assert (found, across) == pytest.approx((s, way), abs=MM)
        assert beside(rails, 1, length - s - 1.0, e, n)[:2] == pytest.approx(
            (length - s, -way), abs=MM
        )
        assert place(rails, 0, found)[2:] == pytest.approx((heading, k), abs=1e-3)


def test_beside_finds_the_foot_that_brute_force_finds() -> None:
    (line,) = curved().lines.values()
    rails = rails_of(curved().network)
    fine = np.arange(0.0, line.length_m, 0.01)
    points = plan_of(line, curved().network, fine)
    rng = np.random.default_rng(3)
    for _ in range(100):
        near = int(rng.integers(3000, len(fine) - 3000))
        east, north = (points[near] + rng.uniform(-8.0, 8.0, 2)).tolist()
        around = slice(near - 3000, near + 3000)
        away = np.hypot(points[around, 0] - east, points[around, 1] - north)
        k = int(away.argmin())
        guess = fine[near] + rng.uniform(-5.0, 5.0)
        s, across, _, _ = beside(rails, 0, guess, east, north)
        assert s == pytest.approx(float(fine[around][k]), abs=10 * MM)
        assert abs(across) == pytest.approx(float(away[k]), abs=1 * MM)


@cache
def fine_points(case: Callable[[], Made]) -> tuple[Array, NDArray[np.int64]]:
    """Places every few centimetres of all tracks, and whose they are."""
    network = case().network
    rails = rails_of(network)
    rows, track = [], []
    for k, length in enumerate(network.length_m.tolist()):
        for s in np.linspace(0.0, length, math.ceil(length / FINE_M) + 1).tolist():
            rows.append(place(rails, 2 * k, s)[:2])
            track.append(k)
    return np.array(rows), np.array(track)


@pytest.mark.parametrize("case", [switch, double, crossover, passing_loop, ladder])
@pytest.mark.parametrize("radius_m", [4.0, 15.0, 60.0])
def test_search_finds_what_brute_force_finds(case: Callable[[], Made], radius_m: float) -> None:
    network, (points, track) = case().network, fine_points(case)
    rails, search, rng = rails_of(network), Search(network), np.random.default_rng(4)
    for _ in range(40):
        at = points[rng.integers(len(points))] + rng.normal(0.0, radius_m / 2.0, 2)
        nearest = np.full(network.track_count, np.inf)
        np.minimum.at(nearest, track, np.hypot(*(points - at).T))
        found = search.near(*at.tolist(), radius_m)
        tracks = [each.track for each in found]
        assert len(tracks) == len(set(tracks))
        assert {*np.flatnonzero(nearest < radius_m - FINE_M)} <= {*tracks}
        assert {*tracks} <= {*np.flatnonzero(nearest < radius_m + FINE_M)}
        assert search.away_m(*at.tolist()) == pytest.approx(float(nearest.min()), abs=4.1)
        for each in found:
            e, n, yaw, _ = place(rails, 2 * each.track, each.chainage_m)
            away = math.hypot(*(at - (e, n)))
            assert away == pytest.approx(nearest[each.track], abs=FINE_M)
            assert math.remainder(yaw - each.yaw_rad, math.tau) == pytest.approx(0.0, abs=MRAD)


@pytest.mark.parametrize("case", [switch, ladder])
def test_search_names_the_nearest_track_first(case: Callable[[], Made]) -> None:
    """Also where a track ends: what lies far behind its end, in its direction, is far."""
    network = case().network
    rails, search, rng = rails_of(network), Search(network), np.random.default_rng(5)
    points, _ = fine_points(case)
    for _ in range(40):
        at = points[rng.integers(len(points))] + rng.normal(0.0, 3.0, 2)
        away = [
            math.hypot(*(at - place(rails, 2 * each.track, each.chainage_m)[:2]))
            for each in search.near(*at.tolist(), 40.0)
        ]
        assert away == sorted(away)


def test_search_finds_nothing_where_nothing_is() -> None:
    search = Search(double().network)
    assert search.near(5e3, 5e3, 100.0) == []
    assert search.away_m(5e3, 5e3) > 6e3


def test_network_of_one_short_track_is_found() -> None:
    network = network_of([laid(straight(1.0))])
    (only,) = Search(network).near(0.5, 0.2, 2.0)
    assert only.track == 0
    assert 0.0 <= only.chainage_m <= 1.0


def test_network_keeps_its_places_through_both_conversions() -> None:
    network = network_of([laid(straight(1.0), level=LEVEL)])
    plan = np.random.default_rng(5).uniform(-15e3, 15e3, (50, 2))
    np.testing.assert_allclose(network.plan_of(network.geodetic_of(plan)), plan, atol=0.01 * MM)
