"""A map of before a track was built: a network that lacks one of its tracks.

Numbers of tracks and runs stay, so that what is matched on the older map can be held to the newer
one: the track that is lacked lies where no vehicle comes, and no run leads onto it or off it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tramstream.tracks.network import Network

AWAY_M = 1e6
"""So far to the north the track lies that is not there."""


def without(network: Network, track: int) -> Network:
    """Give the network as it was before a track was built."""
    lacked = slice(int(network.starts[track]), int(network.starts[track + 1]))
    north = network.north.copy()
    north[lacked] += AWAY_M
    runs = 2 * network.track_count
    following: list[list[int]] = [
        [onto for onto in network.following_of(run).tolist() if track not in (run >> 1, onto >> 1)]
        for run in range(runs)
    ]
    counts = [len(each) for each in following]
    arrays: dict[str, Any] = {
        "north": north,
        "following_starts": np.cumsum([0, *counts], dtype=network.following_starts.dtype),
        "following": np.array([k for each in following for k in each], network.following.dtype),
    }
    for each in arrays.values():
        each.flags.writeable = False
    lines = tuple(line for line in network.lines if track not in {run >> 1 for run in line.runs})
    return replace(network, lines=lines, **arrays)
