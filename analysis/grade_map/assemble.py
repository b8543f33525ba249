"""Rides on a network become a grade map: merged, raised, dated; the same rides, the same map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.grade_map.cells import Cells, Integers, cells_of, digest_of, plan_at
from tramstream.analysis.grade_map.heights import Priors, raise_heights
from tramstream.analysis.grade_map.merge import Merged, merge
from tramstream.analysis.grade_map.passes import Passes, Ride
from tramstream.analysis.grade_map.verdicts import Rows, grouped
from tramstream.errors import ConfigError
from tramstream.tracks.network import Array, Network

HEIGHT_FLOOR_M = 0.3
"""Of a height of however many rides: antenna, reference frame, the receiver's own habits."""


class RideEntry(msgspec.Struct, frozen=True, kw_only=True):
    """What a map keeps of a ride beside its passes."""

    name: str
    digest: str
    vehicle: str
    start_utc_ns: int
    nod_rad_per_mps2: float
    nod_std_rad_per_mps2: float
    smoothed_anew: bool
    way_m: float
    off_map_m: float
    doubtful_m: float
    contradicting_m: float
    bias_rad: float = 0.0
    scatter: float | None = None
    """None: too few others have been where it was."""
    out: str = ""
    """Why it is rejected; empty where it is in use."""


class LinePart(msgspec.Struct, frozen=True):
    """An operator's line over the tracks of a map."""

    line: str
    direction: str
    destination: str
    runs: tuple[tuple[int, float], ...]
    """Each with the length of its track."""
    begin_m: float
    length_m: float


@dataclass(frozen=True)
class GradeMap:
    """One row a cell, ascending; passes lie cell after cell, in order of rides and signs."""

    network: str
    """Digest of the network whose cells these are."""
    source: str
    """What that network was built from."""
    cell_m: float
    rides: tuple[RideEntry, ...]
    lines: tuple[LinePart, ...]
    columns: dict[str, NDArray[Any]]
    """See `file.COLUMNS`."""
    track: tuple[str, ...]
    """Of each row, the name of the track's forward run."""
    passes: dict[str, NDArray[Any]]
    """`ride` (index of `rides`), `sign`, `grade_rad`, `std_rad`, `height_m`, `height_std_m`."""
    starts: Integers
    """First pass of each row, and the number of all."""

    def __len__(self) -> int:
        return len(self.track)


def rides_of(found: GradeMap, network: Network) -> list[Ride]:
    """Take the rides out of a map again, as they were put in.

    Raises
    ------
    ConfigError
        If the map is of another network.
    """
    cells = cells_of(network)
    if found.network != digest_of(network):
        raise ConfigError(
            f"the grade map was made over another network ({found.source})",
            cure="give --net the one that it was made with, or make it anew with --overwrite",
        )
    track, within = found.columns["track_number"], found.columns["cell"]
    if len(track) and (track.max() >= network.track_count):
        raise ConfigError("the grade map has cells that its network has not", cure="make it anew")
    number = (cells.starts[track] + within).astype(np.int32)
    of_pass = np.repeat(number, np.diff(found.starts))
    order, bounds = grouped(found.passes["ride"], len(found.rides))
    names = ("sign", "grade_rad", "std_rad", "height_m", "height_std_m")
    columns = [of_pass[order], *(found.passes[name][order] for name in names)]
    return [
        Ride(
            entry.name,
            entry.digest,
            entry.vehicle,
            entry.start_utc_ns,
            entry.nod_rad_per_mps2,
            entry.nod_std_rad_per_mps2,
            entry.smoothed_anew,
            entry.way_m,
            entry.off_map_m,
            entry.doubtful_m,
            entry.contradicting_m,
            Passes(*(column[bounds[k] : bounds[k + 1]] for column in columns)),
        )
        for k, entry in enumerate(found.rides)
    ]


def assemble(network: Network, rides: Sequence[Ride], priors: Priors) -> GradeMap:
    """Make the map of some rides, each of another digest, in whatever order."""
    rides = sorted(rides, key=lambda ride: ride.digest)
    cells = cells_of(network)
    table = {
        name: np.concatenate([getattr(ride.passes, name) for ride in rides])
        for name in Passes._fields
    }
    of_ride = np.repeat(np.arange(len(rides)), [len(ride.passes.cell) for ride in rides])
    rows = Rows(
        of_ride,
        table["cell"].astype(np.int64),
        table["sign"].astype(float),
        table["grade_rad"].astype(float),
        table["std_rad"].astype(float),
    )
    merged = merge(rows, [ride.vehicle for ride in rides])
    measured = {"grade_rad": merged.grade_rad, "std_rad": merged.std_rad}
    index = merged.row_cell
    measured |= _heights(table, merged.row_used, index, len(merged.cell))
    raised = raise_heights(network, cells, merged.cell, measured, priors)
    known = merged.passes > 0
    columns = _places(network, cells, merged.cell)
    columns |= {
        "grade_rad": np.where(known, raised.grade_rad, np.nan),
        "grade_std_rad": merged.std_rad,
        "height_ellipsoid_m": raised.height_m,
        "height_std_m": raised.std_m,
        "chi2": merged.chi2,
        "passes": merged.passes.astype(np.int32),
    }
    columns |= _counts(rides, of_ride, table["sign"], index, merged)
    order, starts = grouped(index, len(merged.cell))
    passes: dict[str, NDArray[Any]] = {"ride": of_ride[order].astype(np.int32)}
    passes |= {name: table[name][order] for name in Passes._fields if name != "cell"}
    return GradeMap(
        digest_of(network),
        network.source,
        float(np.median(cells.width_m)),
        tuple(_entry(ride, merged, k) for k, ride in enumerate(rides)),
        _lines(network, columns["track_number"]),
        columns,
        tuple(network.name_of(2 * track) for track in columns["track_number"].tolist()),
        passes,
        starts,
    )


def _entry(ride: Ride, merged: Merged, k: int) -> RideEntry:
    scatter = float(merged.scatter[k])
    return RideEntry(
        name=ride.name,
        digest=ride.digest,
        vehicle=ride.vehicle,
        start_utc_ns=ride.start_utc_ns,
        nod_rad_per_mps2=ride.nod,
        nod_std_rad_per_mps2=ride.nod_std,
        smoothed_anew=ride.smoothed,
        way_m=ride.way_m,
        off_map_m=ride.off_map_m,
        doubtful_m=ride.doubtful_m,
        contradicting_m=ride.contradicting_m,
        bias_rad=float(merged.bias_rad[k]),
        scatter=scatter if np.isfinite(scatter) else None,
        out=merged.out[k],
    )


def _heights(
    table: dict[str, NDArray[Any]], used: NDArray[np.bool_], index: Integers, count: int
) -> dict[str, Array]:
    """Mean height of each cell, and its deviation."""
    height, std = table["height_m"].astype(float), table["height_std_m"].astype(float)
    known = used & np.isfinite(height) & (std > 0)
    weight = std[known] ** -2.0
    total = np.bincount(index[known], weight, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(index[known], weight * height[known], count) / total
        deviation = np.sqrt(1 / total + HEIGHT_FLOOR_M**2)
    return {
        "height_m": mean,
        "height_std_m": np.where(total > 0, deviation, np.nan),
    }


def _places(network: Network, cells: Cells, cell: Integers) -> dict[str, NDArray[Any]]:
    """Where cells lie: on which part of which track, between which places."""
    track = cells.track_of(cell)
    within = cell - cells.starts[track]
    from_m, to_m = (cells.width_m[track] * (within + k) for k in (0, 1))
    begin, end = (
        np.degrees(network.geodetic_of(plan_at(network, track, at))) for at in (from_m, to_m)
    )
    osm_way = np.zeros(len(cell), dtype=np.int64)
    middle = (from_m + to_m) / 2
    first = np.searchsorted(track, np.arange(network.track_count))
    last = np.searchsorted(track, np.arange(network.track_count), side="right")
    for way in network.ways:
        part = slice(first[way.track], last[way.track])
        inside = (middle[part] >= way.from_m) & (middle[part] <= way.to_m)
        osm_way[part] = np.where(inside, way.osm_id, osm_way[part])
    return {
        "track_number": track.astype(np.int32),
        "cell": within.astype(np.int32),
        "from_m": from_m,
        "to_m": to_m,
        "track_m": network.length_m[track],
        "from_latitude_deg": begin[:, 0],
        "from_longitude_deg": begin[:, 1],
        "to_latitude_deg": end[:, 0],
        "to_longitude_deg": end[:, 1],
        "osm_way": osm_way,
    }


def _counts(
    rides: Sequence[Ride],
    of_ride: Integers,
    sign: NDArray[np.int8],
    index: Integers,
    merged: Merged,
) -> dict[str, NDArray[Any]]:
    """How many rides are in a cell, which ways they went, and when."""
    count, used = len(merged.cell), merged.row_used
    # A ride that went both ways has two rows of a cell, one after the other.
    again = (np.diff(index[used], prepend=-1) == 0) & (np.diff(of_ride[used], prepend=-1) == 0)
    stamps = np.array([ride.start_utc_ns for ride in rides], dtype=np.int64)[of_ride]
    dated = used & (stamps > 0)
    first = np.full(count, np.iinfo(np.int64).max)
    last = np.zeros(count, dtype=np.int64)
    np.minimum.at(first, index[dated], stamps[dated])
    np.maximum.at(last, index[dated], stamps[dated])
    return {
        "rides": np.bincount(index[used][~again], minlength=count).astype(np.int32),
        "forwards": np.bincount(index[used & (sign > 0)], minlength=count).astype(np.int32),
        "backwards": np.bincount(index[used & (sign < 0)], minlength=count).astype(np.int32),
        "left_out": np.bincount(index[~used], minlength=count).astype(np.int32),
        "first_utc_ns": np.where(last > 0, first, 0),
        "last_utc_ns": last,
    }


def _lines(network: Network, tracks: NDArray[Any]) -> tuple[LinePart, ...]:
    """Lines that go over tracks of the map."""
    on = set(np.unique(tracks).tolist())
    return tuple(
        LinePart(
            line.line,
            line.direction,
            line.destination,
            tuple((run, float(network.length_m[run >> 1])) for run in line.runs),
            line.begin_m,
            line.length_m,
        )
        for line in network.lines
        if any(run >> 1 in on for run in line.runs)
    )
