"""Heights and grades from tiles: made-up terrain, and SRTM's of Prague."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.mapping.build import build
from tramstream.mapping.elevation import GRADE_STD, Tile, lift, read, terrain_m
from tramstream.mapping.osm import Extract, OsmWay
from tramstream.tracks.network import Network

Array = NDArray[np.float64]
LEVEL = LocalLevel.at_deg(50.08, 14.45, 44.5)
STEPS = 1200


def tile(height: Callable[[Array, Array], Array]) -> Tile:
    """A tile of 50 N, 14 E whose height is a function of latitude and longitude, deg."""
    edge = np.linspace(0.0, 1.0, STEPS + 1)
    latitude, longitude = np.meshgrid(51.0 - edge, 14.0 + edge, indexing="ij")
    return Tile(50, 14, np.rint(height(latitude, longitude)).astype(">i2"))


def network(length_m: float = 3000.0, **tags: str) -> Network:
    """One straight track due east, in two ways that meet at a switch's node."""
    extract = Extract()
    for number, east in enumerate(np.linspace(0.0, length_m, 61)):
        latitude, longitude, _ = LEVEL.to_geodetic([east, 0.0, 0.0])
        extract.places[number] = (float(latitude), float(longitude))
    siding = LEVEL.to_geodetic([length_m / 2 + 60.0, 15.0, 0.0])
    extract.places[99] = (float(siding[0]), float(siding[1]))
    rails = {"railway": "tram", **tags}
    extract.ways[1] = OsmWay(1, tuple(range(61)), rails)
    extract.ways[2] = OsmWay(2, (30, 99), rails)
    return build(extract)[0]


def hilly(at: Array, track: Array, noise: Array, latitude: Array, longitude: Array) -> Array:
    """Heights of a track due east at `at`, and what the terrain is off by."""
    east = np.radians(longitude - 14.45) * math.cos(math.radians(50.08)) * 6.39e6
    return 300 + np.interp(east, at, track) + noise + 0 * latitude


def test_bilinear_is_exact_on_a_plane() -> None:
    flat = tile(lambda latitude, longitude: 1200 * (latitude - 50) + 2400 * (longitude - 14))
    rng = np.random.default_rng(0)
    degrees = np.column_stack([rng.uniform(50, 51, 200), rng.uniform(14, 15, 200)])
    found = terrain_m([flat], np.radians(degrees))
    expected = 1200 * (degrees[:, 0] - 50) + 2400 * (degrees[:, 1] - 14)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    corners = np.radians([[50.0, 14.0], [51.0, 15.0], [50.0, 15.0], [51.0, 14.0]])
    np.testing.assert_allclose(terrain_m([flat], corners), [0.0, 3600.0, 2400.0, 1200.0])


def test_outside_and_voids_are_unknown_and_the_next_tile_is_asked() -> None:
    first, second = tile(lambda a, b: 0 * a + 300), tile(lambda a, b: 0 * a + 310)
    height = first.height.copy()
    height[600, 600] = -32768
    holed = replace(first, height=height)
    places = np.radians([[50.5, 14.5], [50.5 - 0.2 / STEPS, 14.5], [50.3, 14.3], [49.9, 14.5]])
    found = terrain_m([holed], places)
    np.testing.assert_array_equal(np.isnan(found), [True, True, False, True])
    np.testing.assert_allclose(terrain_m([holed, second], places[:3]), [310.0, 310.0, 300.0])


@pytest.mark.parametrize("size", [1201, 3601])
def test_tiles_of_both_sizes_are_read(tmp_path: Path, size: int) -> None:
    data = np.zeros((size, size), dtype=">i2")
    data[0, 0], data[-1, -1] = 258, -7
    (tmp_path / "S34W059.hgt").write_bytes(data.tobytes())
    found = read(tmp_path / "S34W059.hgt")
    assert (found.south_deg, found.west_deg) == (-34, -59)
    corners = np.radians([[-33.0, -59.0], [-34.0, -58.0]])
    np.testing.assert_allclose(terrain_m([found], corners), [258.0, -7.0])


def test_bad_tiles_are_refused_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "prague.hgt").write_bytes(b"")
    (tmp_path / "N50E014.hgt").write_bytes(b"12")
    with pytest.raises(ConfigError, match="called by its south-west corner"):
        read(tmp_path / "prague.hgt")
    with pytest.raises(ConfigError, match=r"N50E014.hgt: has 2 bytes"):
        read(tmp_path / "N50E014.hgt")
    with pytest.raises(ConfigError, match=r"N51E014.hgt: cannot be read"):
        read(tmp_path / "N51E014.hgt")


def test_even_slope_is_the_grade_and_the_geoid_is_added() -> None:
    # 0.04 m/m eastwards: metres a degree of longitude at this latitude.
    per_degree = math.radians(1) * math.cos(math.radians(50.08)) * 6.39e6
    net = lift(network(), [tile(lambda a, b: 0.04 * per_degree * (b - 14.45) + 300)], 44.5)
    (main,) = [
        track for track in range(3) if net.length_m[track] > 1490 and net.from_node[track] == 0
    ]
    part = net.samples_of(main)
    inner = slice(part.start + 300, part.stop - 300)
    np.testing.assert_allclose(np.tan(net.grade_rad[inner]), 0.04, atol=0.004)
    expected = 344.5 + 0.04 * (np.arange(part.stop - part.start) * net.spacing_m[main])
    np.testing.assert_allclose(net.height[part], expected, atol=2.0)
    # Heights of runs that follow each other meet.
    other = int(net.following_of(2 * main)[0]) >> 1
    assert net.height[part.stop - 1] == pytest.approx(net.height[net.samples_of(other).start])


def test_deviation_of_grade_is_honest_where_the_model_holds() -> None:
    net = network()
    rng = np.random.default_rng(4)
    shares = []
    for _ in range(6):
        # Grade as the model has it, and terrain that is off by 4 m a pixel of 90 m.
        at = np.arange(0.0, 3100.0, 1.0)
        grade = np.zeros(len(at))
        for k in range(1, len(at)):
            grade[k] = grade[k - 1] * (1 - 1 / 250) + GRADE_STD * math.sqrt(2 / 250) * rng.normal()
        track = np.cumsum(grade)
        noise = rng.normal(0.0, 4.0, (STEPS + 1, STEPS + 1))

        lifted = lift(net, [tile(partial(hilly, at, track, noise))], 44.5)
        for number in range(net.track_count):
            part = lifted.samples_of(number)
            if lifted.length_m[number] < 1000:
                continue
            begin = net.east[part] - net.east[0]
            error = np.tan(lifted.grade_rad[part]) - np.interp(begin, at, grade)
            shares.append(np.mean((error / lifted.grade_std_rad[part]) ** 2))
    assert 0.4 < np.mean(shares) < 1.6


def test_where_no_tile_is_nothing_is_known() -> None:
    net = lift(network(), [replace(tile(lambda a, b: 0 * a), south_deg=10)], 44.5)
    for series in (net.height, net.grade_rad, net.grade_std_rad):
        assert np.all(np.isnan(series))


def test_bridge_over_a_valley_is_trusted_less() -> None:
    ground = tile(lambda a, b: 0 * a + 300)
    plain, bridge = (lift(network(**tags), [ground], 44.5) for tags in ({}, {"bridge": "yes"}))
    assert np.median(bridge.grade_std_rad) > 1.3 * np.median(plain.grade_std_rad)


@pytest.mark.realdata
def test_interpolation_agrees_with_heights_made_elsewhere(data_dir: Path) -> None:
    folder = data_dir / "maps" / "prague"
    found = read(folder / "N50E014.hgt")
    document = json.loads((folder / "lines_7_20.geojson").read_text())
    for feature in document["features"]:
        if feature["geometry"]["type"] == "LineString":
            degrees = np.array(feature["geometry"]["coordinates"])[:, 1::-1]
            away = terrain_m([found], np.radians(degrees)) - feature["properties"]["srtm3_m"]
            assert np.max(np.abs(away)) < 0.051  # they were rounded to 0.1 m
