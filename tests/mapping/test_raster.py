"""Heights out of GeoTIFF in any coordinate system, held to a plane whose height is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from rasterio.warp import transform

from tramstream.errors import ConfigError
from tramstream.mapping import elevation, raster

KROVAK, UTM33, WGS84 = "EPSG:5514", "EPSG:32633", "EPSG:4326"
NO_DATA = -9999.0
DEG = np.pi / 180


def tiff(path: Path, crs: str, pixel: float, size: int = 700, hole: bool = False) -> Path:
    """A plane that rises by 1 % of the coordinates to the east and 2 % to the north."""
    x, y = transform(WGS84, crs, [14.42], [50.08])
    left, top = x[0] - pixel * size / 2, y[0] + pixel * size / 2
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    scale = 1.0 if crs != WGS84 else 1e5
    height = 200 + scale * (0.01 * (column - size / 2) - 0.02 * (row - size / 2)) * pixel
    if hole:
        height[size // 2 - 2 : size // 2 + 2, size // 2 - 2 : size // 2 + 2] = NO_DATA
    profile = {"driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "float32"}
    profile |= {"crs": crs, "transform": from_origin(left, top, pixel, pixel), "nodata": NO_DATA}
    with rasterio.open(path, "w", **profile) as out:
        out.write(height.astype(np.float32), 1)
    return path


def places(crs: str, away: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude and longitude, rad, of places around the middle, and the plane's height there."""
    rng = np.random.default_rng(0)
    x, y = transform(WGS84, crs, [14.42], [50.08])
    east, north = rng.uniform(-away, away, (2, 200))
    longitude, latitude = transform(crs, WGS84, x[0] + east, y[0] + north)
    scale = 1.0 if crs != WGS84 else 1e5
    height = 200 + scale * (0.01 * east + 0.02 * north)
    return np.array(latitude) * DEG, np.array(longitude) * DEG, height


@pytest.mark.parametrize(
    ("crs", "pixel", "std_m"),
    [(KROVAK, 1.0, 0.5), (UTM33, 2.0, 0.5), (UTM33, 30.0, 4.0), (WGS84, 3e-4, 4.0)],
)
def test_plane_is_found_in_any_coordinate_system(tmp_path, crs, pixel, std_m) -> None:
    """Prague's terrain is in S-JTSK; blocks of 512 pixels are crossed."""
    found = elevation.read(tiff(tmp_path / "a.tif", crs, pixel))
    assert found.std_m == std_m
    latitude, longitude, height = places(crs, 340 * pixel)
    np.testing.assert_allclose(found.at(latitude, longitude), height, atol=0.02)


def test_outside_and_beside_voids_is_unknown(tmp_path: Path) -> None:
    found = raster.read(tiff(tmp_path / "a.tif", UTM33, 2.0, hole=True))
    latitude, longitude, _ = places(UTM33, 0.1)
    assert np.isnan(found.at(latitude, longitude)).all()
    away = np.array([48.0, 50.08, -89.0]) * DEG
    assert np.isnan(found.at(away, np.array([14.42, 20.0, 170.0]) * DEG)).all()


def test_raster_without_coordinate_system_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "width": 4, "height": 4, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", **profile, transform=from_origin(0, 0, 1, 1)) as out:
        out.write(np.zeros((4, 4), np.float32), 1)
    with pytest.raises(ConfigError, match="does not say in which coordinate system"):
        elevation.read(path)


@pytest.mark.parametrize("content", [b"", b"II*\0 no tiff", b"\x00" * 500])
def test_file_that_is_no_raster_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="is no raster with heights"):
        elevation.read(path)
    with pytest.raises(ConfigError, match="is no raster with heights"):
        elevation.read(tmp_path / "absent.tif")
