"""The place on a line out of no idea, on exact headings: cheap, without a vehicle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.lines.line import built_in_line
from tramstream.processors.segments.place import PlaceFinder, PlaceMemory
from tramstream.tracks.signature import Signature, of_line

Array = NDArray[np.float64]

NOISE_RAD = 0.004


def line() -> Signature:
    return of_line(built_in_line(), "7")


def other() -> Signature:
    """Another line of the same kind: the first, mirrored and run from its end."""
    one = line()
    return replace(one, line="20", yaw_rad=one.yaw_rad[::-1].copy(), plan=one.plan[::-1].copy())


def finder(*lines: Signature) -> PlaceFinder:
    return PlaceFinder(lines, (0.0, 0.0), 0.03, 1.0, PlaceMemory())


def ride(
    found: PlaceFinder, of: Signature, begin_m: float, end_m: float, scale: float = 0.0
) -> Array:
    """Errors of the likeliest place on the line gone, m, each 40 m; NaN on another line."""
    rng = np.random.default_rng(3)
    errors = []
    for at in np.arange(begin_m, end_m, 1.0).tolist():
        way = (at - begin_m) / (1.0 + scale)
        yaw = float(of.yaw_at(at)) + NOISE_RAD * float(rng.standard_normal())
        if not found.go(way, yaw, 1e-6 * way, 0.0) or found.memory.steps % 10:
            continue
        places = found.places()
        right = bool(places) and found.signatures[places[0].line].name == of.name
        errors.append(places[0].at_m - at if right else math.nan)
    return np.array(errors)


@pytest.mark.parametrize("scale", [-0.03, 0.0, 0.03])
def test_place_is_found_from_nothing_with_wheels_of_any_size(scale: float) -> None:
    found = finder(line(), other())
    errors = ride(found, line(), 1500.0, 2500.0, scale)
    assert np.max(np.abs(errors[-6:])) < 3.0
    best = found.places()[0]
    assert best.probability > 0.95
    assert best.scale == pytest.approx(scale, abs=0.006)


def test_ride_on_no_line_is_said_within_two_kilometres() -> None:
    """And not forced onto one that looks alike."""
    rng = np.random.default_rng(5)
    found = finder(line())
    yaw, curvature = 0.0, 0.0
    for at in range(2000):
        if at % 40 == 0:
            curvature = float(rng.choice([0.0, 0.0, 1.0, -1.0])) / float(rng.uniform(25.0, 120.0))
        yaw += curvature
        found.go(float(at), yaw, 1e-6, 0.0)
    assert found.memory.none > 0.95


def test_line_is_found_again_after_a_detour() -> None:
    found = finder(line())
    first = ride(found, line(), 1000.0, 1800.0)
    assert abs(first[-1]) < 10.0
    way, yaw = found.memory.way_m, found.memory.yaw_rad
    rng = np.random.default_rng(9)
    for at in range(1500):
        if at % 30 == 0:
            curvature = float(rng.choice([0.0, 1.0, -1.0])) / float(rng.uniform(25.0, 90.0))
        yaw += curvature
        found.go(way + at, yaw, 1e-6, 0.0)
    assert found.memory.none > 0.5
    way, begin = found.memory.way_m, float(line().yaw_at(5000.0))
    turned = line().yaw_at(np.arange(5000.0, 7000.0)) - begin
    for k, each in enumerate(turned.tolist()):
        found.go(way + k, yaw + each, 1e-6, 0.0)
    assert abs(found.places()[0].at_m - 7000.0) < 6.0


def test_same_ride_gives_the_same_place_bit_by_bit() -> None:
    one, two = finder(line()), finder(line())
    np.testing.assert_array_equal(ride(one, line(), 0.0, 700.0), ride(two, line(), 0.0, 700.0))


def test_landmark_places_where_headings_tell_nothing() -> None:
    straight = replace(line(), yaw_rad=np.zeros(3001), plan=np.zeros((0, 2)))
    found = finder(straight)
    ride(found, straight, 1000.0, 1200.0)
    found.pass_landmark([0], 1200.0, 3.0, 0.99)
    errors = ride_on(found, straight, 1200.0, 1300.0)
    assert abs(errors) < 6.0
    assert found.places()[0].probability > 0.5


def ride_on(found: PlaceFinder, of: Signature, begin_m: float, end_m: float) -> float:
    """Go on where a ride has ended; the error at the end."""
    way, yaw = found.memory.way_m, found.memory.yaw_rad
    for at in np.arange(begin_m, end_m, 1.0).tolist():
        found.go(way + at - begin_m, yaw, 1e-6, 0.0)
    return found.places()[0].at_m - end_m


def test_stands_at_stops_tell_the_place_on_a_straight_line() -> None:
    """Three stops whose distances are like no others."""
    stops = np.array([200.0, 700.0, 1030.0, 1800.0, 2260.0, 2500.0])
    straight = replace(line(), yaw_rad=np.zeros(3001), plan=np.zeros((0, 2)), stops_m=stops)
    found = finder(straight)
    way = 0.0
    found.go(way, 0.0, 1e-9, 0.0)
    for begin, end in ((700.0, 1030.0), (1030.0, 1800.0), (1800.0, 2260.0)):
        found.stand(doors=True)
        for _ in range(round((end - begin) / 2.0)):
            way += 2.0
            found.go(way, 0.0, 1e-9 * way, 0.0)
    found.stand(doors=True)
    best = found.places()[0]
    assert abs(best.at_m - 2260.0) < 10.0
