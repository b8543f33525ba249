"""Rides on a network: where the line lies, what is beside what, and where detours go."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from networks import junctions as network

from tramstream.simulation.detours import detour
from tramstream.simulation.older_map import without
from tramstream.simulation.track_rides import (
    MapError,
    NetworkRide,
    Route,
    Spots,
    lay,
    plan_at,
    route_of,
    spots,
)
from tramstream.tracks.network import load

CM = 0.01  # m
BRANCHING = Route("branch", (0, 4), 10.0, 550.0, (0.0, 550.0))
CROSSING = Route("crossover", (0, 2, 12, 8), 10.0, 1100.0, (0.0, 1100.0))


def laid(route: Route, seed: int = 1, error: MapError | None = None) -> NetworkRide:
    return lay(network(), route, np.random.default_rng(seed), error)


def beside_m(ride: NetworkRide, route_m: np.ndarray) -> np.ndarray:
    """From the map's point of the route to the line at the same place, m, (n, 2)."""
    position = ride.line.position_l(ride.arc_length_at(route_m))
    geodetic = ride.line.level.to_geodetic(position)
    return network().plan_of(geodetic) - plan_at(network(), ride.spots_at(route_m))


def test_points_of_a_route_lie_on_its_runs_in_both_directions() -> None:
    at = spots(network(), CROSSING, [0.0, 289.9, 290.1, 889.9, 900.0, 1100.0])
    np.testing.assert_array_equal(at.run, [0, 0, 2, 2, 12, 8])
    np.testing.assert_allclose(at.chainage_m[:3], [10.0, 299.9, 0.1], atol=1e-9)
    there, back = Spots(np.array([4]), np.array([60.0])), Spots(np.array([5]), np.zeros(1))
    back.chainage_m[0] = network().length_m[2] - 60.0
    np.testing.assert_allclose(plan_at(network(), there), plan_at(network(), back), atol=1e-9)


@pytest.mark.parametrize("route", [BRANCHING, CROSSING, route_of(network().lines[0])])
def test_line_without_error_lies_on_the_map_and_knows_where(route: Route) -> None:
    ride = laid(route, error=MapError(0.0))
    assert ride.line.length_m == pytest.approx(route.length_m, abs=0.3)
    route_m = np.linspace(0.0, route.length_m, 200)
    off = beside_m(ride, route_m)
    assert np.max(np.hypot(*off.T)) < 30 * CM  # the fit cuts corners where curves begin
    stops = ride.route_at(ride.line.stops_m)
    np.testing.assert_allclose(stops, route.stops_m, atol=30 * CM)


def test_line_is_as_far_beside_the_map_as_the_error_says() -> None:
    route_m = np.arange(0.0, 1100.0, 5.0)
    across = np.array([beside_m(laid(CROSSING, seed), route_m) for seed in range(12)])
    size = np.hypot(across[..., 0], across[..., 1])
    assert np.sqrt(np.mean(size**2)) == pytest.approx(0.4, rel=0.2)
    north = across[:, route_m < 800.0, 1]  # the straight goes east
    assert np.max(np.abs(across[:, route_m < 800.0, 0])) < 10 * CM
    assert np.std(north) == pytest.approx(0.4, rel=0.2)
    near = np.mean(north[:, 1:] * north[:, :-1]) / np.var(north)
    far = np.mean(north[:, 24:] * north[:, :-24]) / np.var(north)
    assert near > 0.95
    assert abs(far) < 0.25


def test_truth_moves_along_the_route_and_never_back() -> None:
    ride = laid(CROSSING)
    route_m = ride.route_at(np.linspace(0.0, ride.line.length_m, 5000))
    assert np.all(np.diff(route_m) >= 0.0)
    assert route_m[0] == pytest.approx(0.0, abs=CM)
    assert route_m[-1] == pytest.approx(CROSSING.length_m, abs=10 * CM)
    order = [CROSSING.runs.index(run) for run in ride.spots_at(route_m).run.tolist()]
    assert order == sorted(order)
    assert set(order) == {0, 1, 2, 3}


def test_choices_are_the_facing_switches_of_the_route() -> None:
    first, second = laid(CROSSING).choices
    nodes = network().to_node
    assert (first.route_m, first.node, first.run, first.taken) == (290.0, nodes[0], 0, 2)
    assert (first.others, second.others) == ((4,), (6,))
    assert (second.route_m, second.node) == (890.0, nodes[1])
    trailing = Route("trailing", (9, 13, 3), 0.0, 500.0, (0.0, 500.0))
    assert [each.node for each in laid(trailing).choices] == [network().from_node[4]]


def test_same_generator_gives_the_same_line() -> None:
    one, again, other = (laid(CROSSING, seed) for seed in (3, 3, 4))
    at = np.linspace(0.0, 1000.0, 50)
    np.testing.assert_array_equal(one.line.position_l(at), again.line.position_l(at))
    assert np.max(np.abs(one.line.position_l(at) - other.line.position_l(at))) > 10 * CM


def test_detours_go_where_trams_may_and_take_other_ways_than_the_line() -> None:
    line = network().lines[0]
    rng = np.random.default_rng(5)
    routes = [detour(network(), line, rng, length_m=1100.0) for _ in range(40)]
    legal = set(network().edges.tolist())
    for route in routes:
        assert set(route.runs) <= legal
        for run, after in zip(route.runs, route.runs[1:], strict=False):
            assert after in network().following_of(run)
        assert route.begin_m >= 10.0
        assert route.stops_m[0] == 0.0
        assert route.stops_m[-1] == route.length_m
        assert np.all(np.diff(route.stops_m) >= 60.0)
        assert 12 in route.runs  # the only legal way off the line
    assert not any(4 in route.runs for route in routes)  # ends 340 m on, the other way does not
    assert any(len(route.stops_m) > 2 for route in routes)


ALONG_M = np.linspace(20.0, 1130.0, 60)
MAIN = Route("main", (0, 2, 6), 10.0, 1150.0, (0.0, 1150.0))


def test_rails_lie_as_far_to_the_left_of_the_map_as_it_is_wrong() -> None:
    ride = laid(MAIN, error=MapError(0.0, beside_m=2.0))
    yaw = ride.line.yaw_rad(ride.arc_length_at(ALONG_M))
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    across = np.sum(beside_m(ride, ALONG_M) * left, axis=1)
    np.testing.assert_allclose(across, 2.0, atol=10 * CM)  # the line is fitted to its points


def test_map_in_another_datum_is_as_far_off_everywhere() -> None:
    ride = laid(MAIN, error=MapError(0.0, east_m=1.0, north_m=-3.0))
    yaw = ride.line.yaw_rad(ride.arc_length_at(ALONG_M))
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    off = beside_m(ride, ALONG_M) - (1.0, -3.0)
    np.testing.assert_allclose(np.sum(off * left, axis=1), 0.0, atol=10 * CM)


def test_turned_map_is_turned_everywhere() -> None:
    turned, straight = (laid(MAIN, error=MapError(0.0, turned_rad=rad)) for rad in (0.01, 0.0))
    change = turned.line.yaw_rad(ALONG_M) - straight.line.yaw_rad(ALONG_M)
    assert np.median(change) == pytest.approx(0.01, abs=0.001)


def test_rails_that_were_laid_anew_leave_the_map_and_come_back_to_it() -> None:
    error = MapError(0.0, moved_m=4.0, moved_from_m=300.0, moved_to_m=600.0)
    route_m = np.array([100.0, 290.0, 320.0, 350.0, 450.0, 550.0, 580.0, 610.0, 750.0])
    north = beside_m(laid(CROSSING, error=error), route_m)[:, 1]  # the straight goes east
    np.testing.assert_allclose(north[[0, 1, 3, 4, 5, 7, 8]], [0, 0, 4, 4, 4, 0, 0], atol=10 * CM)
    np.testing.assert_allclose(north[[2, 6]], 2.0, atol=30 * CM)


def test_older_map_lacks_a_track_and_keeps_all_numbers(tmp_path: Path) -> None:
    without(network(), 1).save(tmp_path / "older")
    older = load(tmp_path / "older")
    assert older.track_count == network().track_count
    assert 2 not in older.following_of(0)
    assert 4 in older.following_of(0)
    assert not older.following_of(2).size
    assert not older.following_of(3).size
    ends = older.samples_of(0).stop, older.samples_of(1).stop
    there = np.hypot(older.east - network().east, older.north - network().north)
    assert np.all(there[ends[0] : ends[1]] > 1e5)
    assert np.all(there[: ends[0]] < CM)
    assert np.all(there[ends[1] :] < CM)
    assert not any(run >> 1 == 1 for line in older.lines for run in line.runs)
