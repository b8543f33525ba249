"""What one ride says of the cells that it went over: one estimate for each and direction.

States of a cell are no independent witnesses: a smoother's error changes over tens of metres. Their
mean along the way has the deviation that each of them has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.grade_map.cells import Cells, Integers, yaw_at
from tramstream.analysis.grade_map.slope import Slope, slope_of
from tramstream.clock import S
from tramstream.estimation.series import Slot, StateSeries
from tramstream.processors.matching.offline import Place
from tramstream.tracks.network import Array, Network

Singles = NDArray[np.float32]

LEAST_PROBABILITY = 0.99
"""Of the track: with less, a ride says nothing of it."""
LEAST_SHARE = 0.4
"""Of a cell's length that a ride has to have gone over."""
MOST_ALONG_STD_M = 5.0
"""Who does not know the cell within this says nothing of it."""
LONGEST_STEP_M = 5.0
LONGEST_STEP_NS = S // 2
"""Between two states, else nothing is known of what lies between."""
MOVES_MPS = 0.3
"""From here on the direction of motion is known by the speed's sign."""


class Passes(NamedTuple):
    """Rows by cell and direction, ascending; single floats, as they are kept in the file, so that a
    merge of what was kept is a merge of the same numbers."""

    cell: NDArray[np.int32]
    sign: NDArray[np.int8]
    """+1 where x of the vehicle pointed along the track as drawn."""
    grade_rad: Singles
    """Uphill positive along the track as drawn."""
    std_rad: Singles
    """Of the slope over the root of the match's probability."""
    height_m: Singles
    """Above the ellipsoid; NaN where the ride does not know."""
    height_std_m: Singles


@dataclass(frozen=True)
class Ride:
    """A ride's passes, and what is to be known of it."""

    name: str
    digest: str
    vehicle: str
    start_utc_ns: int
    """0: not known."""
    nod: float
    nod_std: float
    """κ, rad per m/s²."""
    smoothed: bool
    """Whether it was smoothed anew, and not by whoever made the record."""
    way_m: float
    off_map_m: float
    doubtful_m: float
    """Of the way: match below `LEAST_PROBABILITY`, or place along the track not known."""
    contradicting_m: float
    """Of the way: the vehicle's heading is not that of the run that it was matched to."""
    passes: Passes


class _Placed(NamedTuple):
    """States on the network, one row a state; -1 in `track` where nothing is to be said."""

    track: Integers
    drawn_m: Array
    sign: Array
    probability: Array
    off: NDArray[np.bool_]
    contradicts: NDArray[np.bool_]


class Way(NamedTuple):
    """What became of a ride's way, m."""

    whole: float
    off_map: float
    doubtful: float
    contradicting: float


def passes_of(
    network: Network,
    cells: Cells,
    states: StateSeries,
    places: Sequence[Place],
    pivot_m: float = 0.0,
) -> tuple[Passes, Way, Slope]:
    """Put the slopes of a ride on the cells of a network.

    Parameters
    ----------
    states : StateSeries
        Smoothed.
    places : sequence of Place
        Of the match, at stamps of states.
    pivot_m : float
        So far behind the vehicle's origin is the track whose slope the body has: midway between its
        bogies.
    """
    slope = slope_of(states)
    placed = _behind(network, _placed(network, states, places), pivot_m)
    gone = np.abs(states.speed_mps[1:] + states.speed_mps[:-1]) / 2 * np.diff(states.stamp_ns) / S
    gone[np.diff(states.stamp_ns) > LONGEST_STEP_NS] = 0.0
    way = Way(
        float(gone.sum()),
        float(gone[placed.off[1:]].sum()),
        float(gone[(placed.track[1:] < 0) & ~placed.off[1:] & ~placed.contradicts[1:]].sum()),
        float(gone[placed.contradicts[1:]].sum()),
    )
    return _collected(cells, states, placed, slope), way, slope


def _placed(network: Network, states: StateSeries, places: Sequence[Place]) -> _Placed:
    count = len(states)
    run, chainage = np.full(count, -1, dtype=np.int64), np.zeros(count)
    probability = np.zeros(count)
    stamps = np.array([each.stamp_ns for each in places], dtype=np.int64)
    at = np.minimum(np.searchsorted(states.stamp_ns, stamps), count - 1)
    fits = states.stamp_ns[at] == stamps
    run[at[fits]] = np.array([each.run for each in places], dtype=np.int64)[fits]
    chainage[at[fits]] = np.array([each.chainage_m for each in places])[fits]
    probability[at[fits]] = np.array([each.probability for each in places])[fits]
    off = run < 0
    track = np.where(off, 0, run >> 1)
    drawn = np.where(run % 2 == 0, chainage, network.length_m[track] - chainage)
    toward = np.cos(states.yaw_rad - yaw_at(network, track, drawn))
    sign = np.where(toward >= 0, 1.0, -1.0)
    # A run is the direction of motion; the heading is that of x, which a tram may back against.
    motion = np.where(run % 2 == 0, 1.0, -1.0) * np.sign(states.speed_mps)
    contradicts = ~off & (np.abs(states.speed_mps) > MOVES_MPS) & (motion * sign < 0)
    contradicts |= ~off & (np.abs(toward) < 0.5)
    c, s = np.cos(states.yaw_rad), np.sin(states.yaw_rad)
    P = states.covariance
    along = c * c * P[:, Slot.EAST, Slot.EAST] + s * s * P[:, Slot.NORTH, Slot.NORTH]
    along = along + 2 * c * s * P[:, Slot.EAST, Slot.NORTH]
    sure = states.heading_known & (probability >= LEAST_PROBABILITY)
    sure &= along <= MOST_ALONG_STD_M**2
    track = np.where(sure & ~off & ~contradicts, track, -1)
    return _Placed(track, drawn, sign, probability, off, contradicts)


def _behind(network: Network, placed: _Placed, pivot_m: float) -> _Placed:
    """Move places to the pivot; the first metres of a track are then still the one before."""
    drawn = placed.drawn_m - placed.sign * pivot_m
    length = network.length_m[np.maximum(placed.track, 0)]
    inside = (drawn >= 0.0) & (drawn <= length)
    return placed._replace(drawn_m=drawn, track=np.where(inside, placed.track, -1))


def _collected(cells: Cells, states: StateSeries, placed: _Placed, slope: Slope) -> Passes:
    """Means along the way, cell by cell: each step between two states counts by its length."""
    step = np.abs(np.diff(placed.drawn_m))
    track = placed.track[1:]
    good = (track >= 0) & (placed.track[:-1] == track) & (step <= LONGEST_STEP_M)
    good &= (np.diff(states.stamp_ns) <= LONGEST_STEP_NS) & (step > 0)
    good &= placed.sign[1:] == placed.sign[:-1]
    columns = np.column_stack(
        [
            placed.sign * slope.grade_rad,
            slope.std_rad**2,
            placed.probability,
            states.geodetic[:, 2],
            np.maximum(states.covariance[:, Slot.UP, Slot.UP], 0.0),
        ]
    )
    middle = ((columns[1:] + columns[:-1]) / 2)[good]
    finite = np.isfinite(middle[:, :3]).all(axis=1)
    at = cells.at(track[good], ((placed.drawn_m[1:] + placed.drawn_m[:-1]) / 2)[good])
    key = (2 * at + (placed.sign[1:][good] > 0))[finite]
    weight, middle = step[good][finite], middle[finite]
    found, group = np.unique(key, return_inverse=True)
    way = np.bincount(group, weight, len(found))
    sums = np.column_stack([np.bincount(group, weight * column, len(found)) for column in middle.T])
    with np.errstate(invalid="ignore"):
        grade, variance, probability, height, height_variance = (sums / way[:, None]).T
    cell, sign = found // 2, np.where(found % 2 == 1, 1, -1)
    wide = way >= LEAST_SHARE * cells.width_m[cells.track_of(cell)]
    wide &= (variance > 0) & (probability > 0)
    known = np.isfinite(height) & np.isfinite(height_variance)
    return Passes(
        cell[wide].astype(np.int32),
        sign[wide].astype(np.int8),
        grade[wide].astype(np.float32),
        np.sqrt(variance / probability)[wide].astype(np.float32),
        np.where(known, height, np.nan)[wide].astype(np.float32),
        np.sqrt(np.where(known, height_variance, np.nan))[wide].astype(np.float32),
    )
