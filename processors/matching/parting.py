"""How sure one may be of a track just beyond a switch, whatever the weights of hypotheses say.

Where rails part, a map is at its worst: nodes are joined by kinks, frogs are a few metres off, and
what the heading of a whole branch is wrong by is one error, not one a metre. Slowly gone, as in a
depot, a branch that the map has wrong gathers certainty metre by metre: 0.6 at the points, 0.9996
fifteen metres on, on the wrong track. Two tracks of a switch are a gauge apart after 10 to 15 m; by
then nothing but such headings has told them apart. So what is said of a run is no surer than

    1 − `WRONG_SHARE` exp(−(d/`PARTING_M`)²),        d: way since the last switch that parts

What is taken off goes to the other runs, as their weights are. Only
what is said changes (`map/matcher/match`), not the hypotheses, nor the track that a filter is told.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from tramstream.tracks.network import FORWARDS, Array, Network

WRONG_SHARE, PARTING_M = 0.2, 20.0
"""By eleven rides into Prague's storage tracks with the sensors of scenario `matching`: of what was
said with 0.9 and more 94, 87, 88, 88, 97, 100 % were right 3, 6, 10, 15, 20, 30 m beyond a switch,
where 98 to 100 % were stated. On six rides more all was right where 91 to 95 % is now stated."""
FAR_M = 100.0
"""A switch that is farther back takes nothing off."""


def beyond_switch_m(network: Network) -> Array:
    """Shortest way from a switch that parts to the beginning of each run; `FAR_M` without one."""
    runs = 2 * network.track_count
    legal = [
        [each for each in network.following_of(run).tolist() if _legal(network, each)]
        for run in range(runs)
    ]
    found = np.full(runs, FAR_M)
    waiting: list[tuple[float, int]] = []
    for ways in legal:
        if len(ways) > 1:
            waiting += [(0.0, run) for run in ways]
            found[ways] = 0.0
    heapq.heapify(waiting)
    while waiting:
        way_m, run = heapq.heappop(waiting)
        end_m = way_m + float(network.length_m[run >> 1])
        for following in legal[run]:
            if end_m < found[following]:
                found[following] = end_m
                heapq.heappush(waiting, (end_m, following))
    return found


def _legal(network: Network, run: int) -> bool:
    """Whether trams are meant to go there."""
    return bool(network.rules[run >> 1] & (FORWARDS << (run & 1)))


def surest(beyond_m: float) -> float:
    """The most that may be said of a run so far beyond the switch."""
    return (
        1.0 if beyond_m >= FAR_M else 1.0 - WRONG_SHARE * math.exp(-((beyond_m / PARTING_M) ** 2))
    )
