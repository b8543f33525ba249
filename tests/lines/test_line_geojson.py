"""Lines from GeoJSON: real ones of Prague, and what is done with odd files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.lines.geojson import (
    GRADE_MAX,
    chainage_m,
    deviation_m,
    lay,
    load,
    read,
    slope,
    track,
)
from tramstream.lines.line import built_in_line
from tramstream.simulation.ride import Limits, Ride

LEVEL = LocalLevel.at_deg(50.08, 14.45, 300.0)
BRISK = Limits(acceleration_mps2=1.0, jerk_mps3=0.6, lateral_mps2=0.65)


def degrees(plan: Any, up: Any = 0.0) -> list[list[float]]:
    """Longitude and latitude of points in `l`."""
    p_l = np.column_stack([np.asarray(plan, dtype=float), np.broadcast_to(up, len(plan))])
    return np.degrees(LEVEL.to_geodetic(p_l)[:, 1::-1]).tolist()


def feature(plan: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": degrees(plan)}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def point(east: float, north: float) -> dict[str, Any]:
    geometry = {"type": "Point", "coordinates": degrees([[east, north]])[0]}
    return {"type": "Feature", "properties": {}, "geometry": geometry}


def collection(*features: dict[str, Any]) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features)}


STRAIGHT = [[0.0, 0.0], [400.0, 0.0], [1000.0, 0.0]]


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "length_m", "stops"),
    [("7/0", 12029.1, 27), ("7/1", 12068.0, 28), ("20/0", 16954.0, 33), ("20/1", 16877.0, 32)],
)
def test_real_lines_are_close_to_the_map_and_can_be_driven(
    data_dir: Path, name: str, length_m: float, stops: int
) -> None:
    # Lengths as the map states them; that of 7/1 up to where the tram changes its direction.
    mapped = read(f"{data_dir}/maps/prague/lines_7_20.geojson#{name}")
    line = lay(mapped)
    assert deviation_m(mapped, line) < 1.0
    assert line.length_m == pytest.approx(length_m, rel=1e-3)
    assert len(line.stops_m) == stops
    s = np.arange(0.0, line.length_m, 1.0)
    assert np.max(np.abs(line.curvature_per_m(s))) <= 1 / 18 + 1e-12
    assert np.max(np.abs(np.tan(line.grade(s)))) <= GRADE_MAX
    # Heights of the terrain, smoothed over 60 m: a hillside falls by several metres on that.
    heights = line.level.to_geodetic(line.position_l(s))[:, 2]
    nodes = line.level.from_geodetic(mapped.geodetic)[:, :2]
    nearest = [int(np.argmin(np.sum((line.position_l(s)[:, :2] - n) ** 2, 1))) for n in nodes[::25]]
    assert np.median(np.abs(heights[nearest] - mapped.geodetic[::25, 2])) < 2.0
    ride = Ride(line, BRISK)
    assert len(ride.dwells_s) == stops
    assert 20 * 60 < ride.duration_s < 60 * 60
    motion = ride.motion(np.arange(0.0, ride.duration_s, 0.5))
    assert np.max(np.abs(motion.speed_mps * motion.yaw_rate_radps)) <= 0.65 + 1e-6


@pytest.mark.realdata
def test_several_lines_must_be_chosen_from(data_dir: Path) -> None:
    with pytest.raises(ConfigError, match="out of: 20/0, 20/1, 7/0, 7/1"):
        load(f"{data_dir}/maps/prague/lines_7_20.geojson")


def test_bare_line_string_has_stops_at_its_ends_and_is_level() -> None:
    document = {"type": "LineString", "coordinates": degrees(STRAIGHT)}
    line = lay(track(document, "x"))
    assert line.length_m == pytest.approx(1000.0, abs=0.05)  # 300 m further down
    np.testing.assert_allclose(line.stops_m, [0.0, line.length_m])
    s = np.linspace(0.0, line.length_m, 11)
    heights = line.level.to_geodetic(line.position_l(s))[:, 2]
    # Sea level above the ellipsoid; between its nodes, 500 m apart, the map is straight in space.
    np.testing.assert_allclose(heights, 44.5, atol=0.03)


def test_line_lies_where_the_map_says() -> None:
    line = lay(track(feature(STRAIGHT), "x"))
    ends = line.level.to_geodetic(line.position_l([0.0, line.length_m]))
    geodetic = LEVEL.to_geodetic([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0]])
    # 1e-9 rad is 6 mm.
    np.testing.assert_allclose(ends[:, :2], geodetic[:, :2], atol=2e-9)
    assert float(line.yaw_rad(0.0)) == pytest.approx(0.0, abs=2e-4)  # meridians converge


def test_stops_come_from_chainages_or_points_beside_the_line() -> None:
    stops = [["A", 0.0], ["B", 350.0], ["B again", 355.0], ["C", 1000.0]]
    by_chainage = lay(track(feature(STRAIGHT, stops=stops), "x"))
    np.testing.assert_allclose(by_chainage.stops_m, [0.0, 350.0, 1000.0], atol=0.05)
    scaled = lay(track(feature(STRAIGHT, stops=[["A", 0], ["B", 50.0]], length_m=100.0), "x"))
    np.testing.assert_allclose(scaled.stops_m, [0.0, 500.0], atol=0.05)
    points = collection(feature(STRAIGHT), point(600.0, 12.0), point(20.0, -5.0), point(0.0, 80.0))
    np.testing.assert_allclose(lay(track(points, "x")).stops_m, [20.0, 600.0], atol=0.05)


def test_heights_of_nodes_give_the_grade() -> None:
    plan = np.column_stack([np.linspace(0.0, 2000.0, 41), np.zeros(41)])
    heights = 200.0 + 0.04 * plan[:, 0]
    line = lay(track(feature(plan, srtm3_m=heights.tolist()), "x"))
    s = np.arange(300.0, 1700.0, 10.0)
    east = line.position_l(s)[:, 0]
    lean = east / 6.38e6  # of the place's up against that of l, in which the line is laid
    np.testing.assert_allclose(np.tan(line.grade(s) + lean), 0.04, atol=1e-5)
    assert line.length_m == pytest.approx(2000.0 / math.cos(math.atan(0.04)), abs=0.4)
    ends = line.level.to_geodetic(line.position_l([300.0, 1700.0]))[:, 2]
    along = 300.0 * math.cos(math.atan(0.04))
    assert ends[0] == pytest.approx(200.0 + 44.5 + 0.04 * along, abs=1.0)
    assert ends[1] - ends[0] == pytest.approx(1400.0 * math.sin(math.atan(0.04)), abs=0.02)


def test_third_coordinates_are_ellipsoidal_heights() -> None:
    coordinates = [[*row, 310.0] for row in degrees(STRAIGHT)]
    line = lay(track({"type": "LineString", "coordinates": coordinates}, "x"))
    assert line.level.to_geodetic(line.position_l(500.0))[2] == pytest.approx(310.0, abs=0.01)


def test_slope_by_chainage_is_that_of_the_heights_and_not_the_earths() -> None:
    plan = np.column_stack([np.linspace(0.0, 2000.0, 41), np.zeros(41)])
    heights = 200.0 + 0.04 * plan[:, 0]
    mapped = track(feature(plan, srtm3_m=heights.tolist()), "x")
    np.testing.assert_allclose(chainage_m(mapped), plan[:, 0], atol=0.1)
    found = slope(mapped)
    np.testing.assert_allclose(np.tan(found(np.arange(300.0, 1700.0, 10.0))), 0.04, atol=1e-5)


def test_cliff_in_the_terrain_is_smoothed_to_a_grade_that_a_tram_climbs() -> None:
    plan = np.column_stack([np.linspace(0.0, 2000.0, 101), np.zeros(101)])
    heights = np.where(plan[:, 0] < 1000.0, 200.0, 240.0)
    line = lay(track(feature(plan, srtm3_m=heights.tolist()), "x"))
    steepest = np.max(np.tan(line.grade(np.arange(0.0, 2000.0))))
    assert 0.03 < steepest <= GRADE_MAX


def test_track_that_doubles_back_ends_where_it_does() -> None:
    plan = [[0.0, 0.0], [500.0, 0.0], [900.0, 0.0], [880.0, 4.0], [800.0, 4.0]]
    line = lay(track(feature(plan, stops=[["A", 0.0], ["B", 980.0]]), "x"))
    assert line.length_m == pytest.approx(900.0, abs=0.05)
    np.testing.assert_allclose(line.stops_m, [0.0, line.length_m])


def test_built_in_line_survives_the_way_through_a_file(tmp_path: Path) -> None:
    truth = built_in_line()
    s = np.arange(0.0, 2600.0, 4.0)
    geodetic = truth.level.to_geodetic(truth.position_l(s))
    coordinates = np.column_stack([np.degrees(geodetic[:, 1::-1]), geodetic[:, 2]]).tolist()
    path = tmp_path / "line.geojson"
    path.write_text(json.dumps({"type": "LineString", "coordinates": coordinates}))
    line = load(str(path))
    away = line.level.to_geodetic(line.position_l(s[:-2]))[:, :2] - geodetic[:-2, :2]
    away_m = np.hypot(away[:, 0], away[:, 1] * math.cos(geodetic[0, 0])) * 6.37e6
    assert np.max(away_m) < 2.0  # corners of the map are cut, so the way gets a little shorter
    # A grade of 7 % begins within 60 m here; smoothed, it is right in the middle of a section.
    middle = (truth.stops_m[3:6] + truth.stops_m[4:7]) / 2
    np.testing.assert_allclose(line.grade(middle), truth.grade(middle), atol=0.003)


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({}, "no LineString"),
        ([], "no LineString"),
        (collection(point(0.0, 0.0)), "no LineString"),
        (feature(STRAIGHT, srtm3_m=[1.0]), "one height for each node"),
        (feature(STRAIGHT, stops=["A", "B"]), "stops must read"),
        (feature([[0.0, 0.0], [0.001, 0.0]]), "two nodes"),
        (feature([[0.0, 0.0], [9.0, 0.0]]), "only 9 m long"),
        ({"type": "LineString", "coordinates": [[500000, 5500000], [1, 2]]}, "in degrees"),
        ({"type": "LineString", "coordinates": [["a", "b"]]}, "longitude, latitude"),
        ({"type": "LineString", "coordinates": []}, "coordinates"),
        ({"type": "LineString"}, "longitude, latitude"),
        (collection(feature(STRAIGHT, name="a"), feature(STRAIGHT, name="b")), "out of: a, b"),
    ],
)
def test_unusable_files_are_refused_with_a_sentence(document: Any, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        lay(track(document, "map.geojson"))


def test_line_is_chosen_by_name_and_direction(tmp_path: Path) -> None:
    path = tmp_path / "two.geojson"
    other = [[0.0, 0.0], [0.0, 700.0]]
    two = collection(
        feature(STRAIGHT, line="7", direction=0), feature(other, line="7", direction=1)
    )
    path.write_text(json.dumps(two))
    assert load(f"{path}#7/1").length_m == pytest.approx(700.0, abs=0.05)
    with pytest.raises(ConfigError, match="has 2 lines '7'"):
        load(f"{path}#7")
    with pytest.raises(ConfigError, match="has no lines '8'"):
        load(f"{path}#8")


def test_missing_or_broken_file_is_refused_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load(str(tmp_path / "none.geojson"))
    (tmp_path / "broken.geojson").write_text("{")
    with pytest.raises(ConfigError, match="is no GeoJSON"):
        load(str(tmp_path / "broken.geojson"))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"coordinates": [[14.4, 50.0, 1e308], [14.41, 50.0, 250.0]]}, "heights must be within"),
        ({"coordinates": [[14.4, 50.0], [14.4, 10.0]]}, "is longer than 200 km"),
        ({"length_m": 0.0}, "length_m must be a length"),
        ({"length_m": 1e308}, "length_m must be a length"),
        ({"length_m": True}, "length_m must be a length"),
        ({"stops": [["A", 1e300]]}, "property stops must read"),
    ],
)
def test_sizes_that_no_line_has_are_refused(change: dict[str, Any], says: str) -> None:
    coordinates = change.get("coordinates", [[14.4, 50.0], [14.41, 50.0]])
    properties = {name: value for name, value in change.items() if name != "coordinates"}
    line = {"type": "LineString", "coordinates": coordinates}
    document = {"type": "Feature", "properties": properties, "geometry": line}
    with pytest.raises(ConfigError, match=says):
        track(document, "f.geojson")


def test_point_of_nowhere_is_beside_no_line() -> None:
    line = {"type": "LineString", "coordinates": [[14.4, 50.0], [14.41, 50.0]]}
    point = {"type": "Point", "coordinates": [1e308, -1e308]}
    features = [{"type": "Feature", "properties": {}, "geometry": each} for each in (line, point)]
    document = {"type": "FeatureCollection", "features": features}
    assert track(document, "f.geojson").stops_m == []
