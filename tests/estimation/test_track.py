"""The track as a circle, and where a filter was a moment ago."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.clock import S
from tramstream.estimation.track import LocalTrack, Pose, Trail, TrailMemory, in_level
from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.proto.estimate_pb2 import TrackGeometry

UM = 1e-6
LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)


def track(curvature: float, yaw: float = 0.7) -> LocalTrack:
    nan = math.nan
    return LocalTrack(0, 100.0, -50.0, yaw, curvature, nan, 0.1, 0.01, 0.0, 40.0, 30.0)


def on_circle(circle: LocalTrack, way: float, left: float) -> tuple[float, float, float]:
    """East, north and heading of a place `left` of the circle, `way` along it; by its centre."""
    k = circle.curvature_per_m
    yaw = circle.yaw_rad + k * way
    if k == 0.0:
        east = circle.east + way * math.cos(yaw)
        north = circle.north + way * math.sin(yaw)
    else:
        centre = (
            circle.east - math.sin(circle.yaw_rad) / k,
            circle.north + math.cos(circle.yaw_rad) / k,
        )
        east, north = centre[0] + math.sin(yaw) / k, centre[1] - math.cos(yaw) / k
    return east - left * math.sin(yaw), north + left * math.cos(yaw), yaw


@pytest.mark.parametrize("curvature", [0.0, 1e-7, 1 / 20.0, -1 / 20.0, 1 / 500.0])
@pytest.mark.parametrize("way", [-25.0, 0.0, 3.0, 35.0])
@pytest.mark.parametrize("left", [-4.0, 0.0, 2.0])
def test_circle_tells_its_own_distance_heading_and_bend(
    curvature: float, way: float, left: float
) -> None:
    circle = track(curvature)
    east, north, yaw = on_circle(circle, way, left)
    told = circle.told(east, north, yaw + 0.03)
    assert told is not None
    assert told.across_m == pytest.approx(left, abs=10 * UM)
    assert told.yaw_off_rad == pytest.approx(0.03, abs=1e-7)
    assert told.normal_east == pytest.approx(-math.sin(yaw), abs=1e-7)
    assert told.normal_north == pytest.approx(math.cos(yaw), abs=1e-7)
    assert told.bend_per_m == pytest.approx(curvature / (1.0 - curvature * left), abs=1e-9)


@pytest.mark.parametrize(
    ("way", "known"), [(-30.1, False), (-29.9, True), (39.9, True), (41, False)]
)
@pytest.mark.parametrize("curvature", [0.0, 1 / 60.0])
def test_circle_tells_nothing_where_it_does_not_stand_for_the_track(
    way: float, known: bool, curvature: float
) -> None:
    circle = track(curvature)
    assert (circle.told(*on_circle(circle, way, 1.0)) is not None) == known


def test_message_is_the_same_place_and_heading_in_a_level_far_away() -> None:
    here = LocalLevel.at_deg(50.2, 14.7, 300.0)
    message = TrackGeometry(
        stamp_ns=5,
        latitude_deg=50.2,
        longitude_deg=14.7,
        yaw_rad=1.0,
        across_variance_m2=1.0,
        yaw_variance_rad2=1.0,
        ahead_m=9.0,
    )
    found = in_level(message, LEVEL, 300.0)
    assert found is not None
    expected = LEVEL.from_geodetic((here.latitude_rad, here.longitude_rad, 300.0))
    np.testing.assert_allclose((found.east, found.north), expected[:2], atol=UM)
    # A metre along the track, by way of the Earth.
    ahead = here.to_geodetic((math.cos(1.0), math.sin(1.0), 0.0))
    moved = LEVEL.from_geodetic(ahead) - expected
    assert found.yaw_rad == pytest.approx(math.atan2(moved[1], moved[0]), abs=1e-5)
    assert found.yaw_rad == 1.0 + float(convergence_rad(LEVEL, here.longitude_rad))
    assert math.isnan(found.grade_rad)


@pytest.mark.parametrize(
    "change", [{"latitude_deg": math.nan}, {"across_variance_m2": 0.0}, {"ahead_m": math.inf}]
)
def test_message_that_is_no_number_is_left_out(change: dict[str, float]) -> None:
    fields = {"across_variance_m2": 1.0, "yaw_variance_rad2": 1.0, **change}
    assert in_level(TrackGeometry(**fields), LEVEL, 0.0) is None


def driven(trail: Trail, steps: int, update: Pose = (0.0, 0.0, 0.0, 0.0)) -> list[Pose]:
    """A metre east a step, and after each an update; where the filter was after each of them."""
    now, poses = (0.0, 0.0, 0.0, 0.0), []
    for k in range(1, steps + 1):
        after = (now[0] + 1.0, now[1], now[2] + 0.01, now[3] - 0.001)
        trail.carry(now, after)
        trail.pass_by(k * S // 100)
        now = tuple(a + b for a, b in zip(after, update, strict=True))  # type: ignore[assignment]
        poses.append(now)
    return poses


def test_trail_without_updates_gives_where_the_filter_was() -> None:
    trail = Trail(0.2)
    poses = driven(trail, 60)
    for k in (35, 50, 60):
        assert trail.at(k * S // 100, poses[-1]) == pytest.approx(poses[k - 1], abs=1e-12)
    between = trail.at(50 * S // 100 + S // 400, poses[-1])
    assert between is not None
    assert between[0] == pytest.approx(50.25, abs=1e-9)


def test_updates_since_then_have_moved_what_is_known_of_then() -> None:
    trail = Trail(0.2)
    update = (0.0, 0.5, 0.002, 0.0)
    poses = driven(trail, 60, update)
    then = trail.at(50 * S // 100, poses[-1])
    assert then is not None
    ten = [10.0 * each for each in update]
    assert then == pytest.approx([a + b for a, b in zip(poses[49], ten, strict=True)], abs=1e-9)


def test_trail_knows_nothing_of_the_future_or_of_long_ago() -> None:
    trail = Trail(0.2)
    assert trail.at(S, (0.0, 0.0, 0.0, 0.0)) is None
    poses = driven(trail, 60)
    assert trail.at(61 * S // 100, poses[-1]) is None
    assert trail.at(29 * S // 100, poses[-1]) is None
    assert trail.at(30 * S // 100, poses[-1]) is not None


def test_restored_trail_goes_on_to_the_last_bit() -> None:
    trail, other = Trail(0.2), Trail(0.2)
    poses = driven(trail, 60, (0.0, 0.1, 0.0, 0.0))
    assign(other.memory, from_plain(TrailMemory, to_plain(trail.memory)))
    assert other.at(45 * S // 100, poses[-1]) == trail.at(45 * S // 100, poses[-1])
    assert other.memory == trail.memory
