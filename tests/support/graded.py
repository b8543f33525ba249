"""Tracks whose slopes are known, and what rides would say of them: passes made without a filter."""

from __future__ import annotations

import hashlib
import math
from functools import cache

import numpy as np
from networks import BOTH, LEVEL, laid, network_of, straight
from numpy.typing import NDArray

from tramstream.analysis.grade_map.cells import Cells, cells_of
from tramstream.analysis.grade_map.passes import Passes, Ride
from tramstream.tracks.network import Network

Array = NDArray[np.float64]

STD_RAD = 1e-3
"""What the rides state."""


@cache
def straight_track(length_m: float = 2000.0) -> Network:
    """One track, both ways."""
    return network_of([laid(straight(length_m))], rules=[BOTH])


def hills(network: Network) -> tuple[Array, Array]:
    """Slope of each cell's track as drawn, rad, and its height, m: waves of 400 m, 4 % steep."""
    cells = cells_of(network)
    grade = np.empty(cells.starts[-1])
    height = np.empty(cells.starts[-1])
    for track in range(network.track_count):
        own = slice(cells.starts[track], cells.starts[track + 1])
        at = (np.arange(own.stop - own.start) + 0.5) * cells.width_m[track]
        wave = math.tau / 400.0
        grade[own] = np.arctan(0.04 * np.sin(wave * at + track))
        height[own] = LEVEL.height_m - 0.04 / wave * (np.cos(wave * at + track) - 1.0)
    return grade, height


def passing(
    network: Network,
    seed: int,
    sign: int = 1,
    bias_rad: float = 0.0,
    std_rad: float = STD_RAD,
    vehicle: str = "",
    cells: slice = slice(None),
) -> Ride:
    """A ride over all cells one way: slopes with noise of the stated size and a bias."""
    rng = np.random.default_rng(seed)
    cut: Cells = cells_of(network)
    grade, height = hills(network)
    cell = np.arange(cut.starts[-1])[cells]
    told = grade[cell] + sign * bias_rad + std_rad * rng.standard_normal(len(cell))
    count = len(cell)
    passes = Passes(
        cell.astype(np.int32),
        np.full(count, sign, np.int8),
        told.astype(np.float32),
        np.full(count, std_rad, np.float32),
        (height[cell] + rng.standard_normal()).astype(np.float32),
        np.full(count, 1.0, np.float32),
    )
    digest = hashlib.blake2b(b"%d" % seed, digest_size=8).hexdigest()
    start_ns = 1_780_000_000_000_000_000 + seed * 86_400_000_000_000
    way_m = 5.0 * count
    return Ride(
        f"ride{seed}.mcap",
        digest,
        vehicle or f"tram{seed}",
        start_ns,
        0.0,
        0.01,
        False,
        way_m,
        0.0,
        0.0,
        0.0,
        passes,
    )
