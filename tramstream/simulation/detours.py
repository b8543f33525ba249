"""Detours: routes that leave an operator's line at switches, as on a day when a street is closed.

At a facing switch of the line a detour takes another way half of the time, off the line any with
equal chance but for those it has gone already; where it meets the line again it follows that until
the next switch. It goes only where trams are meant to go, and neither into depots nor into ends
of track as long as there is another way: lines have switches, but take the same way through each on
every ride, and a matcher could seem right for a wrong reason.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from tramstream.errors import ConfigError
from tramstream.simulation.track_rides import Route
from tramstream.tracks.network import Array, Network, RouteLine

LENGTH_M = 5000.0
SHORTEST_M = 1000.0
"""A detour that ends earlier is drawn anew."""
LEAVES_SHARE = 0.5
"""Of the line's facing switches."""
GONE_WEIGHT = 0.25
"""Chance of a run against that of one that has been gone once less."""
ONWARD_M = 500.0
"""A way that goes on for so long ends nowhere near."""
BEGINS_SHARE = 0.7
"""Of the line's runs: a detour begins on one of the first."""
END_M = 20.0
"""Of the first and the last run: a detour begins beyond the node and ends before it. On it an
answer on the run before would be as good, which is not on the route."""
STOPS_APART_M = 60.0
_TRIES = 50


def detour(
    network: Network,
    line: RouteLine,
    rng: Generator,
    name: str = "detour",
    length_m: float = LENGTH_M,
) -> Route:
    """Draw a detour that begins on a line.

    Parameters
    ----------
    network : Network
    line : RouteLine
    rng : Generator
    name : str
        Of the route.
    length_m : float
        At which it ends, on the run where it gets so long.

    Raises
    ------
    ConfigError
        If none of `SHORTEST_M` or half of `length_m` is found that leaves the line.
    """
    onward_m = _onward_m(network)
    shortest_m = min(SHORTEST_M, length_m / 2)
    begins = _begins(network, line)
    for _ in range(_TRIES):
        first = int(rng.choice(begins))
        runs = _walk(network, line.runs[first:], onward_m, rng, length_m)
        lengths = network.length_m[np.array(runs) >> 1]
        begin_m = line.begin_m if first == 0 else min(END_M, float(lengths[0]) / 2)
        whole_m = float(np.sum(lengths)) - begin_m - min(END_M, float(lengths[-1]) / 2)
        left = tuple(runs) != line.runs[first : first + len(runs)]
        if left and whole_m >= shortest_m:
            stops_m = _stops_m(network, runs, begin_m, whole_m)
            return Route(name, tuple(runs), begin_m, whole_m, stops_m)
    raise ConfigError(
        f"no detour of {shortest_m:.0f} m leaves line {line.line}/{line.direction}; has the "
        "network another legal way?"
    )


def _begins(network: Network, line: RouteLine) -> list[int]:
    """On which of a line's runs a detour may begin: long ones among the first, or its first."""
    lengths = network.length_m[np.array(line.runs) >> 1]
    among = lengths[: max(int(BEGINS_SHARE * len(line.runs)), 1)]
    return np.flatnonzero(among >= 2 * END_M).tolist() or [0]


def _walk(
    network: Network, line: tuple[int, ...], onward_m: Array, rng: Generator, length_m: float
) -> list[int]:
    """Runs of a detour from the first run of a rest of a line."""
    runs, gone_m, on = [line[0]], float(network.length_m[line[0] >> 1]), 0
    gone: dict[int, int] = {line[0]: 1}
    while gone_m < length_m:
        ways = _ways(network, runs[-1], onward_m)
        if not ways:
            break
        planned = line[on + 1] if 0 <= on < len(line) - 1 and runs[-1] == line[on] else None
        others = [way for way in ways if way != planned]
        if planned in ways and (not others or rng.uniform() >= LEAVES_SHARE):
            run = planned
        else:
            weights = GONE_WEIGHT ** np.array([gone.get(way, 0) for way in others], dtype=float)
            run = others[int(rng.choice(len(others), p=weights / np.sum(weights)))]
        assert run is not None
        runs.append(run)
        gone[run] = gone.get(run, 0) + 1
        gone_m += float(network.length_m[run >> 1])
        on = line.index(run) if run in line else -1
    return runs


def _ways(network: Network, run: int, onward_m: Array) -> list[int]:
    """Where a tram may go on, without ends of track if it can."""
    legal = [way for way in network.following_of(run).tolist() if onward_m[way] > 0.0]
    far = [way for way in legal if onward_m[way] >= ONWARD_M]
    return far or legal


def _onward_m(network: Network) -> Array:
    """Of each run, how far a tram can go from its begin, up to `ONWARD_M`; 0: it may not."""
    yards = {way.track for way in network.ways if way.tags.get("service") == "yard"}
    allowed = [run for run in network.edges.tolist() if run >> 1 not in yards]
    onward_m = np.zeros(2 * network.track_count)
    changed = True
    while changed:
        changed = False
        for run in allowed:
            after = max((onward_m[way] for way in network.following_of(run).tolist()), default=0.0)
            reach_m = min(float(network.length_m[run >> 1]) + after, ONWARD_M)
            if reach_m > onward_m[run]:
                onward_m[run], changed = reach_m, True
    return onward_m


def _stops_m(
    network: Network, runs: list[int], begin_m: float, length_m: float
) -> tuple[float, ...]:
    """Stops along a route: both its ends, and between them those of the map."""
    found, start_m = [], -begin_m
    for run in runs:
        whole_m = float(network.length_m[run >> 1])
        for stop in network.stops:
            if stop.track == run >> 1:
                along_m = stop.chainage_m if run % 2 == 0 else whole_m - stop.chainage_m
                found.append(start_m + along_m)
        start_m += whole_m
    stops = [0.0]
    for stop_m in sorted(found):
        if stop_m - stops[-1] >= STOPS_APART_M and length_m - stop_m >= STOPS_APART_M:
            stops.append(stop_m)
    return (*stops, length_m)
