"""Heights and grades of a network from SRTM tiles (`.hgt`), with what they are worth.

Other rasters (`mapping.raster`) do as well.

Terrain is not track: a pixel is 90 m (SRTM3) or 30 m wide and off by metres, streets have houses,
rails have bridges and cuttings. So heights are smoothed along the rails and over their nodes: grade
is taken to vary around nought by `GRADE_STD` over `GRADE_REACH_M` (Ornstein-Uhlenbeck), terrain to
be off by `TERRAIN_STD_M` over `TERRAIN_REACH_M`, more where a way is a bridge or the like. Heights
at knots are the solution of one sparse system for the whole network; grade's deviation comes from
solutions for drawn errors of terrain and grade, and holds as far as these figures do.

Tiles give heights above the geoid (EGM96); `geoid_m` is added to have them above the ellipsoid. It
differs by about a metre over a city's 50 km.

Equations: docs/theory.md, section 10.5.

References
----------
T. G. Farr et al., "The Shuttle Radar Topography Mission", Reviews of Geophysics 45 (2007) RG2004:
tiles, and errors of 3 to 5 m. G. Papandreou, A. L. Yuille, "Gaussian sampling by local
perturbations", NIPS 2010: deviations from perturbed solutions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from tramstream.errors import ConfigError
from tramstream.input_file import read_bytes
from tramstream.mapping import raster
from tramstream.tracks.network import Network

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

KNOT_M = 15.0
GRADE_STD = 0.03
GRADE_REACH_M = 250.0
TERRAIN_STD_M = 4.0
TERRAIN_REACH_M = 90.0
OFF_GROUND = 5.0
"""So many times larger is the error where rails are not on the ground."""
_OFF_GROUND_TAGS = ("bridge", "tunnel", "cutting", "embankment")
DRAWS = 48
"""Deviations from so many draws are good to a tenth."""
_VOID = -32768
_SIZES = (1201, 3601)
_EDGE = 1e-6
"""Pixels; degrees that were radians are not what they were."""
_VAGUE_M = 1000.0
"""Where no tile is, a height may be anything."""


class Heights(Protocol):
    """Anything that knows heights above the geoid."""

    @property
    def std_m(self) -> float:
        """How far its terrain is off the rails' height."""
        ...

    def at(self, latitude_rad: Array, longitude_rad: Array) -> Array:
        """Heights of places, m; NaN where it knows none."""
        ...


@dataclass(frozen=True)
class Tile:
    """One degree of latitude and longitude."""

    south_deg: int
    west_deg: int
    height: NDArray[np.int16]
    """Above the geoid, m; first row in the north; shape (n, n), edges included."""

    @property
    def std_m(self) -> float:
        return TERRAIN_STD_M

    def at(self, latitude_rad: Array, longitude_rad: Array) -> Array:
        """Height above the geoid by bilinear interpolation, m; NaN outside and beside voids."""
        steps = self.height.shape[0] - 1
        row = (self.south_deg + 1 - np.degrees(latitude_rad)) * steps
        column = (np.degrees(longitude_rad) - self.west_deg) * steps
        middle = steps / 2
        inside = np.maximum(np.abs(row - middle), np.abs(column - middle)) < middle + _EDGE
        row, column = np.clip(row, 0, steps), np.clip(column, 0, steps)
        i = np.clip(np.floor(row), 0, steps - 1).astype(np.int64)
        j = np.clip(np.floor(column), 0, steps - 1).astype(np.int64)
        down, right = row - i, column - j
        total, void = np.zeros(len(row)), ~inside
        for di, dj, weight in (
            (0, 0, (1 - down) * (1 - right)),
            (0, 1, (1 - down) * right),
            (1, 0, down * (1 - right)),
            (1, 1, down * right),
        ):
            value = self.height[i + di, j + dj]
            total += weight * value
            void |= (value == _VOID) & (weight > 0)
        return np.where(void, np.nan, total)


def read(path: Path) -> Heights:
    """Read a tile, or look over a raster in any coordinate system.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    if path.suffix.lower() in raster.SUFFIXES:
        return raster.read(path)
    return read_tile(path)


def read_tile(path: Path) -> Tile:
    """Read an SRTM tile; see `read`."""
    name = re.fullmatch(r"([NS])(\d{2})([EW])(\d{3})", path.name.split(".")[0].upper())
    if name is None:
        raise ConfigError(f"{path}: a tile is called by its south-west corner, like N50E014.hgt")
    data = read_bytes(path, 2 * _SIZES[-1] ** 2)
    size = math.isqrt(len(data) // 2)
    if size not in _SIZES or len(data) != 2 * size * size:
        raise ConfigError(
            f"{path}: has {len(data)} bytes; unpacked, SRTM3 has {2 * 1201**2} and SRTM1 "
            f"{2 * 3601**2}"
        )
    south = int(name[2]) * (1 if name[1] == "N" else -1)
    west = int(name[4]) * (1 if name[3] == "E" else -1)
    return Tile(south, west, np.frombuffer(data, dtype=">i2").reshape(size, size))


def terrain_m(tiles: Sequence[Heights], geodetic: Array) -> Array:
    """Height of the terrain above the geoid, from the first tile that has it; else NaN.

    Parameters
    ----------
    geodetic : ndarray, shape (n, 2)
        Latitude, longitude, rad.
    """
    found = np.full(len(geodetic), np.nan)
    for tile in tiles:
        found = np.where(np.isnan(found), tile.at(geodetic[:, 0], geodetic[:, 1]), found)
    return found


def terrain_std_m(
    network: Network, tiles: Sequence[Heights], geodetic: Array, sample: Integers
) -> Array:
    """How far the terrain of `terrain_m` is off the rails at places, m: more off the ground.

    Parameters
    ----------
    sample : ndarray, shape (n,)
        Of the network, next to each place.
    """
    std = np.full(len(geodetic), np.nan)
    for tile in tiles:
        here = np.isnan(std) & np.isfinite(tile.at(geodetic[:, 0], geodetic[:, 1]))
        std[here] = tile.std_m
    deviation: Array = std * _off_ground(network)[sample]
    return deviation


def lift(network: Network, tiles: Sequence[Heights], geoid_m: float) -> Network:
    """Give a network heights and grades; see the module."""
    knots = _knots(network)
    geodetic = network.geodetic_of(np.column_stack([network.east, network.north])[knots.sample])
    terrain = terrain_m(tiles, geodetic)
    terrain_std = terrain_std_m(network, tiles, geodetic, knots.sample)
    height, grade, grade_std = _solved(network, knots, terrain, terrain_std)
    counts = np.diff(network.starts)
    samples = (np.empty(len(network.east), dtype=np.float32) for _ in range(3))
    heights, grades, stds = samples
    for track in range(network.track_count):
        chosen = network.samples_of(track)
        chainage = np.arange(counts[track]) * network.spacing_m[track]
        first, last = knots.intervals[track], knots.intervals[track + 1]
        at = np.linspace(0.0, network.length_m[track], last - first + 1)
        middle = (at[1:] + at[:-1]) / 2
        numbers = np.append(knots.begin[first:last], knots.end[last - 1])
        known = np.where(np.isnan(terrain[numbers]), np.nan, height[numbers])
        heights[chosen] = np.interp(chainage, at, known) + geoid_m
        unknown = np.isnan(heights[chosen])
        for out, value in ((grades, grade), (stds, grade_std)):
            out[chosen] = np.interp(chainage, middle, value[first:last])
            out[chosen][unknown] = np.nan
    for array in (heights, grades, stds):
        array.flags.writeable = False
    return replace(network, height=heights, grade_rad=grades, grade_std_rad=stds)


class _Knots(NamedTuple):
    """Places of unknown height, about `KNOT_M` apart along tracks; nodes are the first ones."""

    sample: Integers
    """Of each knot, the sample next to it."""
    intervals: Integers
    """First interval of each track, and the number of all."""
    begin: Integers
    end: Integers
    """Knots of each interval."""
    length_m: Array
    """Of each interval."""


def _knots(network: Network) -> _Knots:
    nodes = len(network.node_id)
    sample = [0] * nodes
    intervals, begin, end, length = [0], [], [], []
    number = nodes
    for track, length_m in enumerate(network.length_m.tolist()):
        count = max(round(length_m / KNOT_M), 1)
        first, last = int(network.starts[track]), int(network.starts[track + 1]) - 1
        chain = [int(network.from_node[track]), *range(number, number + count - 1)]
        chain.append(int(network.to_node[track]))
        sample[chain[0]], sample[chain[-1]] = first, last
        sample.extend(first + round(k * (last - first) / count) for k in range(1, count))
        number += count - 1
        begin += chain[:-1]
        end += chain[1:]
        length += [max(length_m, 0.1) / count] * count
        intervals.append(len(begin))
    return _Knots(*map(np.array, (sample, intervals, begin, end, length)))


def _solved(
    network: Network, knots: _Knots, terrain: Array, terrain_std: Array
) -> tuple[Array, Array, Array]:
    """Heights of knots, grade of intervals and its deviation; m, rad, rad.

    Least squares of four kinds of rows, each divided by its deviation: terrain, no grade, no change
    of grade from an interval to the next, and a vague height.
    """
    count, spans = len(knots.sample), len(knots.length_m)
    rise = sparse.csr_matrix(
        (
            np.concatenate([-1 / knots.length_m, 1 / knots.length_m]),
            (np.tile(np.arange(spans), 2), np.concatenate([knots.begin, knots.end])),
        ),
        shape=(spans, count),
    )
    before, after, sign = _neighbours(network, knots)
    change = rise[after] - sparse.diags(sign) @ rise[before]
    apart = (knots.length_m[before] + knots.length_m[after]) / 2
    q = 2 * GRADE_STD**2 / GRADE_REACH_M
    level = sparse.diags(np.sqrt(knots.length_m / q) / GRADE_REACH_M) @ rise
    smooth = sparse.diags(1 / np.sqrt(q * apart)) @ change
    seen = ~np.isnan(terrain)
    weight = np.where(seen, 1 / (np.where(seen, terrain_std, 1.0) * _shared(knots)), 0.0)
    rows = sparse.vstack([sparse.diags(weight), level, smooth, sparse.eye(count) / _VAGUE_M])
    rows = rows.tocsr()
    solver: Any = splu((rows.T @ rows).tocsc())
    middle = float(np.mean(terrain[seen])) if np.any(seen) else 0.0
    wanted = np.zeros(rows.shape[0])
    wanted[:count] = weight * np.where(seen, terrain - middle, 0.0)
    height = solver.solve(rows.T @ wanted)
    drawn = np.random.default_rng(0).standard_normal((rows.shape[0], DRAWS))
    errors = rise @ solver.solve(rows.T @ drawn)
    slope = rise @ height
    # A track alone that is shorter than its reach would know less of its grade than of any other's.
    deviation = np.minimum(np.sqrt(np.mean(errors**2, axis=1)), GRADE_STD)
    return height + middle, np.arctan(slope), deviation / (1 + slope**2)


def _neighbours(network: Network, knots: _Knots) -> tuple[Integers, Integers, Array]:
    """Intervals that rails join, each pair once, and -1 where they are drawn against each other."""
    inner = np.setdiff1d(np.arange(1, len(knots.length_m)), knots.intervals)
    counts = np.diff(network.following_starts)
    runs, ahead = np.repeat(np.arange(len(counts)), counts), network.following.astype(np.int64)
    chosen = runs < (ahead ^ 1)  # the same joint seen from the other side is left out
    runs, ahead = runs[chosen], ahead[chosen]
    first, last = knots.intervals[:-1], knots.intervals[1:] - 1
    end = np.where(runs % 2 == 0, last[runs >> 1], first[runs >> 1])
    begin = np.where(ahead % 2 == 0, first[ahead >> 1], last[ahead >> 1])
    sign = np.where((runs + ahead) % 2 == 0, 1.0, -1.0)
    return (
        np.concatenate([inner - 1, end]),
        np.concatenate([inner, begin]),
        np.concatenate([np.ones(len(inner)), sign]),
    )


def _off_ground(network: Network) -> Array:
    """By how much larger terrain's error is at each sample of a network."""
    factor = np.ones(len(network.east))
    for way in network.ways:
        if any(
            way.tags.get(tag, "no") not in ("no", "building_passage") for tag in _OFF_GROUND_TAGS
        ):
            spacing, first = float(network.spacing_m[way.track]), int(network.starts[way.track])
            begin, end = round(way.from_m / spacing), round(way.to_m / spacing)
            factor[first + begin : first + end + 1] = OFF_GROUND
    return factor


def _shared(knots: _Knots) -> Array:
    """How much less a knot's terrain tells: neighbours within a pixel are not independent."""
    span = np.zeros(len(knots.sample))
    for side in (knots.begin, knots.end):
        np.add.at(span, side, knots.length_m / 2)
    shared: Array = np.sqrt(np.maximum(TERRAIN_REACH_M / np.maximum(span, 0.05), 1.0))
    return shared
