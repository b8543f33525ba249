"""Heights along the tracks that the slopes climb to: one least squares over the network.

Unknown are the heights at the ends of cells, which tracks share at nodes, and an error of each
cell's slope that changes slowly along the track (a smoother's does; Ornstein-Uhlenbeck over
`ERROR_REACH_M`). The slopes say what neighbours differ by, up to that error; rides and rasters say
heights. So loops close, heights are those that the slopes lead to, and what the slopes are off
over kilometres the heights correct. Where no ride has been, slopes are taken to be nought by
`GRADE_STD`.

Heights of a ride are off by the same for minutes, a raster's within its reach: both count by how
many independent ones there are along the track, not by how many cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tramstream.analysis.grade_map.cells import Cells, Integers, plan_at
from tramstream.mapping.elevation import (
    GRADE_STD,
    TERRAIN_REACH_M,
    Heights,
    terrain_m,
    terrain_std_m,
)
from tramstream.tracks.network import Array, Network

ERROR_REACH_M = 300.0
HEIGHT_REACH_M = 1000.0
"""Over which a ride's height is off by the same: two minutes of a receiver's slow error."""
TIGHT = 0.05
"""What a slope may be off beside its slow error, in its deviations."""
DRAWS = 32
_VAGUE_M = 1000.0


class Raised(NamedTuple):
    """Rows by cell as they were given; heights above the ellipsoid."""

    grade_rad: Array
    height_m: Array
    """In the middle of the cell; NaN where nothing tells."""
    std_m: Array


class Priors(NamedTuple):
    """Rasters with heights above the geoid."""

    tiles: Sequence[Heights]
    geoid_m: float


class _System(NamedTuple):
    """Knots and cells of the tracks that rides have been on."""

    cell: Integers
    """Numbers of all cells of these tracks."""
    begin: Integers
    end: Integers
    """Knots of each cell."""
    width_m: Array
    knots: int


def raise_heights(
    network: Network, cells: Cells, cell: Integers, measured: dict[str, Array], priors: Priors
) -> Raised:
    """Solve for heights.

    Parameters
    ----------
    cell : ndarray, shape (n,)
        Numbers of the cells that have slopes, ascending.
    measured : dict
        `grade_rad`, `std_rad`, `height_m`, `height_std_m`, one row a cell; NaN: not known.
    priors : Priors
    """
    system = _system(network, cells, cell)
    at = np.searchsorted(system.cell, cell)
    rows, wanted = _rows(network, cells, system, at, measured, priors)
    solver: Any = splu((rows.T @ rows).tocsc())
    middle = float(np.median(wanted.known)) if len(wanted.known) else 0.0
    target = wanted.value - wanted.level * middle
    found = solver.solve(rows.T @ target)
    height = found[: system.knots] + middle
    drawn = np.random.default_rng(0).standard_normal((rows.shape[0], DRAWS))
    errors = solver.solve(rows.T @ drawn)[: system.knots]
    error = (errors[system.begin] + errors[system.end]) / 2
    begin, end = height[system.begin[at]], height[system.end[at]]
    grade = np.arctan((end - begin) / system.width_m[at])
    told = _told(system, wanted.knots)[at]
    return Raised(
        grade,
        np.where(told, (begin + end) / 2, np.nan),
        np.where(told, np.sqrt(np.mean(error[at] ** 2, axis=1)), np.nan),
    )


def _system(network: Network, cells: Cells, cell: Integers) -> _System:
    tracks = np.unique(cells.track_of(cell))
    nodes = np.unique(np.concatenate([network.from_node[tracks], network.to_node[tracks]]))
    numbers, begin, end, width = [], [], [], []
    fresh = len(nodes)
    for track in tracks.tolist():
        own = np.arange(cells.starts[track], cells.starts[track + 1])
        inner = np.arange(fresh, fresh + len(own) - 1)
        fresh += len(inner)
        ends = np.searchsorted(nodes, [network.from_node[track], network.to_node[track]])
        chain = np.concatenate([ends[:1], inner, ends[1:]])
        numbers.append(own)
        begin.append(chain[:-1])
        end.append(chain[1:])
        width.append(np.full(len(own), cells.width_m[track]))
    return _System(
        np.concatenate(numbers),
        np.concatenate(begin),
        np.concatenate(end),
        np.concatenate(width),
        fresh,
    )


class _Wanted(NamedTuple):
    """Right sides of the rows."""

    value: Array
    level: Array
    """What of each row a common height adds to it."""
    known: Array
    """All heights that were given, m."""
    knots: Integers
    """At which they were."""


def _rows(
    network: Network,
    cells: Cells,
    system: _System,
    at: Integers,
    measured: dict[str, Array],
    priors: Priors,
) -> tuple[Any, _Wanted]:
    """Rows over (heights of knots, slow errors of cells), each divided by its deviation."""
    count, width = len(system.cell), system.knots + len(system.cell)
    slope, std = np.full(count, np.nan), np.full(count, np.nan)
    slope[at], std[at] = np.tan(measured["grade_rad"]), measured["std_rad"]
    known = np.isfinite(slope) & (std > 0)
    rise = _matrix(width, system, [(-1 / system.width_m, "begin"), (1 / system.width_m, "end")])
    error = _matrix(width, system, [(np.ones(count), "error")])
    tight = np.where(known, 1 / (TIGHT * np.where(known, std, 1.0)), 0.0)
    blocks = [sparse.diags(tight) @ (rise + error)]
    values = [tight * np.where(known, slope, 0.0)]
    # Gaps: level, as far as the ground is.
    gap = np.where(known, 0.0, np.sqrt(system.width_m / 250.0) / GRADE_STD)
    blocks.append(sparse.diags(gap) @ rise)
    values.append(np.zeros(count))
    blocks.append(_slow(system, std, known, error))
    values.append(np.zeros(count))
    height, height_std = (np.full(count, np.nan) for _ in range(2))
    height[at], height_std[at] = measured["height_m"], measured["height_std_m"]
    shared = np.sqrt(np.maximum(HEIGHT_REACH_M / system.width_m, 1.0))
    rides = _given(width, system, height, height_std * shared)
    terrain, terrain_std = _terrain(network, cells, system, priors)
    ground = _given(width, system, terrain, terrain_std)
    blocks += [rides[0], ground[0], sparse.eye(system.knots, width) / _VAGUE_M]
    values += [rides[1], ground[1], np.zeros(system.knots)]
    matrix = sparse.vstack(blocks).tocsr()
    level = np.concatenate([np.zeros(3 * count), rides[2], ground[2], np.zeros(system.knots)])
    told = np.concatenate([height[np.isfinite(height)], terrain[np.isfinite(terrain)]])
    has = np.isfinite(height) | np.isfinite(terrain)
    return matrix, _Wanted(np.concatenate(values), level, told, system.begin[has])


def _matrix(width: int, system: _System, parts: list[tuple[Array, str]]) -> Any:
    """One row a cell."""
    count = len(system.cell)
    columns = {
        "begin": system.begin,
        "end": system.end,
        "error": system.knots + np.arange(count),
    }
    values = np.concatenate([value for value, _ in parts])
    place = np.concatenate([columns[name] for _, name in parts])
    rows = np.tile(np.arange(count), len(parts))
    return sparse.csr_matrix((values, (rows, place)), shape=(count, width))


def _slow(system: _System, std: Array, known: Any, error: Any) -> Any:
    """Rows for the slow errors: each like the one before it on its track, within their σ."""
    count = len(system.cell)
    joined = np.zeros(count, dtype=bool)
    joined[1:] = (system.end[:-1] == system.begin[1:]) & known[1:] & known[:-1]
    joined[1:] &= system.cell[1:] == system.cell[:-1] + 1
    sigma = np.where(known, std, 1.0)
    rho = np.where(joined, np.exp(-system.width_m / ERROR_REACH_M), 0.0)
    before = np.concatenate([sigma[:1], sigma[:-1]])
    scale = 1 / (sigma * np.sqrt(1 - rho**2))
    shift = sparse.diags([np.ones(count - 1)], [-1], shape=(count, count))
    return sparse.diags(scale) @ (error - sparse.diags(rho * sigma / before) @ shift @ error)


def _given(width: int, system: _System, height: Array, std: Array) -> tuple[Any, Array, Array]:
    """Rows that give cells' middles a height; the right side and what a common height adds."""
    known = np.isfinite(height) & (std > 0)
    weight = np.where(known, 1 / np.where(known, std, 1.0), 0.0)
    half = np.full(len(weight), 0.5)
    middle = _matrix(width, system, [(half, "begin"), (half, "end")])
    return sparse.diags(weight) @ middle, weight * np.where(known, height, 0.0), weight


def _terrain(
    network: Network, cells: Cells, system: _System, priors: Priors
) -> tuple[Array, Array]:
    """Rasters' heights of cells above the ellipsoid, and what they are worth."""
    if not priors.tiles:
        return np.full(len(system.cell), np.nan), np.ones(len(system.cell))
    track = cells.track_of(system.cell)
    drawn_m = (system.cell - cells.starts[track] + 0.5) * cells.width_m[track]
    geodetic = network.geodetic_of(plan_at(network, track, drawn_m))
    sample = network.starts[track].astype(np.int64) + np.rint(
        drawn_m / network.spacing_m[track]
    ).astype(np.int64)
    std = terrain_std_m(network, priors.tiles, geodetic, sample)
    shared = np.sqrt(np.maximum(TERRAIN_REACH_M / system.width_m, 1.0))
    return terrain_m(priors.tiles, geodetic) + priors.geoid_m, std * shared


def _told(system: _System, knots: Integers) -> Any:
    """Whether each cell hangs together with a height that somebody gave."""
    ones = np.ones(len(system.begin))
    joins = sparse.csr_matrix(
        (ones, (system.begin, system.end)), shape=(system.knots, system.knots)
    )
    _, part = connected_components(joins, directed=False)
    return np.isin(part, part[knots])[system.begin]
