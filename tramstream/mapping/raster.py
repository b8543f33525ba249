"""Heights out of rasters in any coordinate system: GeoTIFF, as surveys publish terrain models.

Needs the package rasterio, which nothing else does. A raster may be far larger than memory (a city
at 1 m has 500 million pixels): blocks that are asked for are read, one after the other.

Heights are taken for those above the geoid, as tiles' are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError, MissingPackageError

Array = NDArray[np.float64]

SUFFIXES = (".tif", ".tiff", ".vrt")
BLOCK = 512
"""Pixels along each side that are read at a time."""
FINE_PIXEL_M = 10.0
FINE_STD_M, COARSE_STD_M = 0.5, 4.0
"""How far a raster's terrain is off the rails' height, with pixels below and above `FINE_PIXEL_M`:
laser scans of a street are good to some decimetres, SRTM to some metres (T. G. Farr et al.,
2007)."""


@dataclass(frozen=True)
class Raster:
    """A file with heights, looked over but not read."""

    path: Path
    pixel_m: float

    @property
    def std_m(self) -> float:
        return FINE_STD_M if self.pixel_m < FINE_PIXEL_M else COARSE_STD_M

    def at(self, latitude_rad: Array, longitude_rad: Array) -> Array:
        """Height by bilinear interpolation, m; NaN outside and beside voids.

        Raises
        ------
        ConfigError
            If the file is damaged where it is read.
        """
        rasterio = _rasterio()
        try:
            with rasterio.open(self.path) as data:
                return _heights(rasterio, data, latitude_rad, longitude_rad)
        except _damages(rasterio) as error:
            raise _no_raster(self.path) from error


def _heights(rasterio: Any, data: Any, latitude_rad: Array, longitude_rad: Array) -> Array:
    """See `Raster.at`."""
    column, row = _pixels(rasterio, data, latitude_rad, longitude_rad)
    # Between middles of pixels; the outer half of those at the rim is outside.
    inside = (row >= 0) & (column >= 0) & (row <= data.height - 1) & (column <= data.width - 1)
    i = np.clip(np.floor(np.where(inside, row, 0)), 0, data.height - 2).astype(int)
    j = np.clip(np.floor(np.where(inside, column, 0)), 0, data.width - 2).astype(int)
    blocks = (i // BLOCK) * (data.width // BLOCK + 1) + j // BLOCK
    found = np.full(len(row), np.nan)
    for block in np.unique(blocks[inside]):
        here = np.flatnonzero(inside & (blocks == block))
        found[here] = _in_block(rasterio, data, (i[here], j[here], row[here], column[here]))
    return found


def read(path: Path) -> Raster:
    """Look a raster over.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    MissingPackageError
        Without rasterio.
    """
    rasterio = _rasterio()
    try:
        with rasterio.open(path) as data:
            if data.crs is None:
                raise ConfigError(
                    f"{path}: does not say in which coordinate system it is",
                    cure="give it one, as `gdal_translate -a_srs EPSG:5514` does",
                )
            if data.width < 2 or data.height < 2:
                raise ConfigError(f"{path}: has {data.width} × {data.height} pixels, not a terrain")
            size = math.sqrt(abs(data.transform.a * data.transform.e - _shear(data.transform)))
            metres = 111_000.0 if data.crs.is_geographic else data.crs.linear_units_factor[1]
            return Raster(path, size * metres)
    except _damages(rasterio) as error:
        raise _no_raster(path) from error


def _damages(rasterio: Any) -> tuple[type[Exception], ...]:
    """What the package raises for files that are none."""
    return (
        rasterio.errors.RasterioError,
        rasterio.errors.RasterioIOError,
        rasterio._err.CPLE_BaseError,
        ValueError,
        OSError,
    )


def _no_raster(path: Path) -> ConfigError:
    return ConfigError(f"{path}: is no raster with heights, or a damaged one")


def _shear(transform: Any) -> float:
    return float(transform.b * transform.d)


def _pixels(
    rasterio: Any, data: Any, latitude_rad: Array, longitude_rad: Array
) -> tuple[Array, Array]:
    """Column and row of places, counted between middles of pixels; outside where none is."""
    x, y = rasterio.warp.transform(
        "EPSG:4326", data.crs, np.degrees(longitude_rad), np.degrees(latitude_rad)
    )
    column, row = ~data.transform @ (np.array(x), np.array(y))
    known = np.isfinite(column) & np.isfinite(row)
    return np.where(known, column - 0.5, -1.0), np.where(known, row - 0.5, -1.0)


def _in_block(rasterio: Any, data: Any, at: tuple[Any, Any, Array, Array]) -> Array:
    """Interpolate at places whose pixels lie in one block."""
    i, j, row, column = at
    top, left = int(i.min()), int(j.min())
    window = rasterio.windows.Window(left, top, int(j.max()) - left + 2, int(i.max()) - top + 2)
    pixels = data.read(1, window=window, masked=True).astype(float).filled(np.nan)
    i, j, down, right = i - top, j - left, row - i, column - j
    total = np.zeros(len(i))
    for di, dj, weight in (
        (0, 0, (1 - down) * (1 - right)),
        (0, 1, (1 - down) * right),
        (1, 0, down * (1 - right)),
        (1, 1, down * right),
    ):
        total += np.where(weight > 0, weight * pixels[i + di, j + dj], 0.0)
    return total


def _rasterio() -> Any:
    """The package, or how to get it."""
    try:
        import rasterio
        import rasterio.errors
        import rasterio.warp
        import rasterio.windows
    except ImportError as error:
        raise MissingPackageError(
            "rasterio, which reads GeoTIFF, is not installed: `pip install 'tramstream[grade-map]'`"
        ) from error
    return rasterio
