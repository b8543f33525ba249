"""The tracks of a network cut into cells of about 5 m: what a grade map has a row for.

Cells belong to the *track* as it is drawn, whichever way a tram goes on it: run 2 k and run 2 k + 1
meet the same cells, and what is uphill for the one is downhill for the other.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.tracks.network import Array, Network

Integers = NDArray[np.int64]

CELL_M = 5.0
"""Grades of tram tracks change over some tens of metres (vertical curves of 1000 m and more), and a
smoothed state is known to a metre or two along the track."""


class Cells(NamedTuple):
    """See the module. Cells of a track lie together, from where it is drawn from."""

    starts: Integers
    """First cell of each track, and the number of all: shape (tracks + 1,)."""
    width_m: Array
    """Of the cells of each track."""

    def at(self, track: Integers, drawn_m: Array) -> Integers:
        """Number of the cell in which places lie, `drawn_m` along tracks as drawn."""
        counts = np.diff(self.starts)[track]
        within = np.floor(drawn_m / self.width_m[track]).astype(np.int64)
        return self.starts[track] + np.clip(within, 0, counts - 1)

    def track_of(self, cell: Integers) -> Integers:
        """Tracks on which cells lie."""
        return np.searchsorted(self.starts, cell, side="right") - 1


def cells_of(network: Network) -> Cells:
    """Cut all tracks of a network."""
    counts = np.maximum(np.rint(network.length_m / CELL_M), 1).astype(np.int64)
    return Cells(np.concatenate([[0], np.cumsum(counts)]), network.length_m / counts)


def plan_at(network: Network, track: Integers, drawn_m: Array) -> Array:
    """East, north of places on tracks as drawn, m, shape (n, 2)."""
    last = np.diff(network.starts)[track] - 1
    along = network.starts[track] + np.clip(drawn_m / network.spacing_m[track], 0.0, last)
    number = np.arange(len(network.east))
    return np.column_stack(
        [np.interp(along, number, network.east), np.interp(along, number, network.north)]
    )


def yaw_at(network: Network, track: Integers, drawn_m: Array) -> Array:
    """Heading of tracks as drawn at places on them, rad."""
    last = np.diff(network.starts)[track] - 1
    nearest = np.rint(np.clip(drawn_m / network.spacing_m[track], 0.0, last)).astype(np.int64)
    yaw: Array = network.yaw_rad[network.starts[track] + nearest]
    return yaw


def digest_of(network: Network) -> str:
    """Short name of where tracks lie; grades, lines and stops do not count."""
    found = hashlib.blake2b(digest_size=8)
    for values, kind in (
        (network.starts, "<i4"),
        (network.from_node, "<i4"),
        (network.to_node, "<i4"),
        (network.node_id, "<i8"),
        (np.rint(network.length_m * 1e3), "<i8"),
        (np.rint(network.east * 1e2), "<i8"),
        (np.rint(network.north * 1e2), "<i8"),
    ):
        found.update(np.asarray(values).astype(kind).tobytes())
    return found.hexdigest()
