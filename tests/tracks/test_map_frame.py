"""The filter's frame against the network's plan: linear maps against the exact conversion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from networks import laid as laid_line
from networks import network_of, straight

from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.memory.stage import assign, copied
from tramstream.tracks.map_frame import MOVED_M, MapFrame
from tramstream.tracks.network import Network
from tramstream.tracks.rails import Search

MM = 1e-3  # m
PLACE = LocalLevel.at_deg(50.08, 14.42, 250.0)
FAR_M = 15e3
HEIGHTS = (-400.0, 0.0, 400.0)
"""Of the vehicle above either origin."""
TURN = 11
"""Of `MapFrame.numbers`: what turns a direction of `l` into one of the plan."""
AZIMUTHS = tuple(math.radians(each) for each in (10.0, 100.0, 190.0, 280.0))


def origin(azimuth: float, height_m: float, way_m: float = FAR_M) -> LocalLevel:
    """An origin so far from `PLACE`."""
    offset = way_m * math.cos(azimuth), way_m * math.sin(azimuth), 0.0
    latitude, longitude, _ = PLACE.to_geodetic(offset).tolist()
    return LocalLevel(latitude, longitude, height_m)


def network_at(level: LocalLevel) -> Network:
    return network_of([laid_line(straight(10.0), level=level)])


def linear(frame: MapFrame, p_l: np.ndarray) -> np.ndarray:
    """The plan as kernels compute it."""
    n = frame.numbers
    return n[:6].reshape(2, 3) @ (p_l - n[6:9]) + n[9:11]


@pytest.mark.parametrize("height_m", HEIGHTS)
@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_plan_is_the_exact_one_within_2_mm_far_from_both_origins(
    azimuth: float, height_m: float
) -> None:
    """The vehicle is 15 km from both, on different sides, at other heights than both."""
    network = network_at(origin(azimuth, PLACE.height_m + height_m))
    level = origin(azimuth + 2.0, PLACE.height_m - height_m)
    frame = MapFrame(network, level)
    rng = np.random.default_rng(1)
    start = level.from_geodetic([PLACE.latitude_rad, PLACE.longitude_rad, PLACE.height_m])
    for step in rng.uniform(-4.0 * MOVED_M, 4.0 * MOVED_M, (20, 3)):
        laid = start + step * (1.0, 1.0, 0.1)
        frame.follow(*laid)
        # Until it moves farther than that the map stays where it was laid.
        moved = laid + rng.uniform(-1.0, 1.0, 3) * (MOVED_M * 0.99, MOVED_M * 0.99, 0.0)
        frame.follow(*moved)
        exact = network.plan_of(level.to_geodetic(moved))
        np.testing.assert_allclose(linear(frame, moved), exact, atol=2 * MM)


def test_climb_between_two_layings_moves_the_plan_by_less_than_2_mm() -> None:
    """8 % over `MOVED_M`, or a height that wanders: verticals at both places are 2 mrad apart."""
    network, level = network_at(origin(0.0, 250.0)), origin(2.0, 250.0)
    frame = MapFrame(network, level)
    start = level.from_geodetic([PLACE.latitude_rad, PLACE.longitude_rad, PLACE.height_m])
    frame.follow(*start)
    moved = np.add(start, (70.0, -70.0, 8.0))
    frame.follow(*moved)
    exact = network.plan_of(level.to_geodetic(moved))
    np.testing.assert_allclose(linear(frame, moved), exact, atol=2 * MM)


@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_rotation_is_that_of_the_meridians(azimuth: float) -> None:
    """Directions in both frames differ by their convergences at the place of the vehicle."""
    network, level = network_at(origin(azimuth, 100.0)), origin(azimuth + 2.0, 500.0)
    frame = MapFrame(network, level)
    geodetic = np.array([PLACE.latitude_rad, PLACE.longitude_rad, PLACE.height_m])
    frame.follow(*level.from_geodetic(geodetic))
    longitude = PLACE.longitude_rad
    expected = convergence_rad(network.level, longitude) - convergence_rad(level, longitude)
    # What both tangent planes tilt against each other turns a direction by their product.
    assert frame.numbers[TURN] == pytest.approx(float(expected), abs=1e-5)


def test_equal_origins_turn_nothing() -> None:
    frame = MapFrame(network_at(PLACE), PLACE)
    frame.follow(0.0, 0.0, 0.0)
    np.testing.assert_allclose(frame.numbers, [1, 0, 0, 0, 1, *[0] * 7], atol=1e-9)


@pytest.mark.parametrize("height_m", HEIGHTS)
def test_geodetic_place_is_that_of_the_plan(height_m: float) -> None:
    network = network_at(origin(1.0, PLACE.height_m))
    level = origin(3.0, PLACE.height_m - height_m)
    frame = MapFrame(network, level)
    here = level.from_geodetic([PLACE.latitude_rad, PLACE.longitude_rad, PLACE.height_m])
    frame.follow(*here)
    rng = np.random.default_rng(2)
    for step in rng.uniform(-1.0, 1.0, (20, 2)):
        plan = linear(frame, here) + step * MOVED_M
        back = network.plan_of(np.radians(frame.geodetic_deg(*plan.tolist())))
        np.testing.assert_allclose(back, plan, atol=2 * MM)


def test_restored_frame_is_the_same_to_the_last_bit() -> None:
    network, level = network_at(PLACE), origin(1.0, 300.0)
    frame = MapFrame(network, level)
    rng = np.random.default_rng(3)
    for place in rng.uniform(-500.0, 500.0, (10, 3)):
        frame.follow(*place)
    other = MapFrame(network, level, copied(frame.memory))
    for place in rng.uniform(-500.0, 500.0, (10, 3)):
        np.testing.assert_array_equal(other.numbers, frame.numbers)
        assert other.geodetic_deg(10.0, 20.0) == frame.geodetic_deg(10.0, 20.0)
        frame.follow(*place)
        other.follow(*place)


def test_frame_that_was_nowhere_yet_is_restored() -> None:
    network = network_at(PLACE)
    frame = MapFrame(network, PLACE)
    assign(frame.memory, MapFrame(network, PLACE).memory)
    frame.follow(5.0, 6.0, 7.0)
    assert np.isfinite(frame.numbers).all()


def test_place_beside_a_track_keeps_its_distance_from_it() -> None:
    """A track 15 km from the network's origin, a vehicle 2.5 m left of it, a filter elsewhere."""
    level = origin(0.5, 250.0)
    offset = level.from_geodetic([PLACE.latitude_rad, PLACE.longitude_rad, PLACE.height_m])
    network = network_of([laid_line(straight(50.0), offset[:2].tolist(), 0.0, level)])
    frame = MapFrame(network, origin(2.5, 650.0))
    plan = np.array([offset[0] + 20.0, offset[1] + 2.5])
    geodetic = [*network.geodetic_of(plan).tolist(), 600.0]
    p_l = frame.level.from_geodetic(geodetic)
    frame.follow(*p_l)
    (near,) = Search(network).near(*linear(frame, p_l).tolist(), 10.0)
    assert near.across_m == pytest.approx(2.5, abs=1 * MM)
    assert near.chainage_m == pytest.approx(20.0, abs=5 * MM)
