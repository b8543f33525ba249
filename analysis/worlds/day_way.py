"""The way of a day's service on a network: out of storage, rounds of two lines, and back.

The tram stands at night on a storage track among parallel ones, goes to the first line's begin on
the shortest legal way, then over both directions again and again, each time with a break at the
terminus, and in the end back. Once the driver turns back on the line with the other cab, as where a
track is closed, and turns back again two stops later. The longest break, in the middle of the day,
has the sensors switched off.

Rails are laid anew for each round: no two passes lie alike beside the map.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from tramstream.errors import ConfigError
from tramstream.simulation.event_kinds import AnyEvent, GnssRateLost, ImuLost
from tramstream.simulation.speed_plan import Break
from tramstream.simulation.track_rides import Route
from tramstream.tracks.network import Network, RouteLine

BEGIN_M = 10.0
"""Of the storage track, behind the tram in the morning."""
NIGHT_S = 300.0
"""Of standing on the storage track before the departure."""
BREAK_S = (600.0, 1800.0)
"""At termini, drawn evenly."""
OFF_AFTER_S, OFF_MARGIN_S = 120.0, 300.0
"""Sensors are switched off so long after the arrival, and on again so long before the departure."""
OFF_SHARE = 1.0 / 8.0
"""Of the day: an hour of eight."""
TURNS_AT = (12, 10)
"""Stops of the first round's second line where the driver turns back."""


class Day(NamedTuple):
    """What is gone and when the tram stands for long."""

    route: Route
    turns_back: tuple[int, ...]
    """Numbers of the route's stops."""
    breaks: tuple[Break, ...]
    off_halt: int
    """At which sensors are switched off; as `Break.halt`."""
    off_s: float
    """So long."""

    @property
    def events(self) -> tuple[AnyEvent, ...]:
        """What switches IMU and receiver off."""
        at: dict[str, Any] = {
            "stop": self.off_halt,
            "after_s": OFF_AFTER_S,
            "duration_s": self.off_s,
        }
        return (ImuLost(**at), GnssRateLost(**at))


def storage(network: Network, near: int, least_m: float = 60.0, beside: int = 4) -> int:
    """Give the run of a track among parallel ones from which a run is reached on the shortest way.

    Parameters
    ----------
    network : Network
    near : int
        The run.
    least_m : float
        Shorter tracks hold no tram.
    beside : int
        So many other tracks pass within `_AMONG_M` of its middle.

    Raises
    ------
    ConfigError
        If the network has none.
    """
    middles = (network.starts[:-1] + network.starts[1:]) // 2
    points = np.column_stack([network.east, network.north])
    of = np.searchsorted(network.starts, np.arange(len(points)), side="right") - 1
    found = []
    for run in network.edges.tolist():
        track = run >> 1
        if network.length_m[track] < least_m:
            continue
        close = np.hypot(*(points - points[middles[track]]).T) < _AMONG_M
        if len(np.unique(of[close])) <= beside:
            continue
        try:
            out_m, _ = way(network, run, near)
        except ConfigError:
            continue
        found.append((out_m, run))
    if not found:
        raise ConfigError("the network has no storage track from which a tram comes to the line")
    nearest: int = min(found)[1]
    return nearest


_AMONG_M = 18.0


def way(network: Network, first: int, last: int) -> tuple[float, tuple[int, ...]]:
    """Shortest legal way from one run to another, both included, and its length without the first.

    Raises
    ------
    ConfigError
        If there is none.
    """
    legal = set(network.edges.tolist())
    waiting: list[tuple[float, int, tuple[int, ...]]] = [(0.0, first, (first,))]
    seen: set[int] = set()
    while waiting:
        gone_m, run, runs = heapq.heappop(waiting)
        if run == last:
            return gone_m, runs
        if run in seen:
            continue
        seen.add(run)
        for after in network.following_of(run).tolist():
            if after in legal:
                length_m = float(network.length_m[after >> 1])
                heapq.heappush(waiting, (gone_m + length_m, after, (*runs, after)))
    raise ConfigError(f"no legal way leads from run {first} to run {last}")


def day(
    network: Network, lines: Sequence[RouteLine], rounds: int, day_s: float, rng: Generator
) -> Day:
    """Plan a day.

    Parameters
    ----------
    network : Network
    lines : sequence of RouteLine
        Gone one after another in each round.
    rounds : int
    day_s : float
        Length of the whole day.
    rng : Generator
        Of the breaks.
    """
    home = storage(network, lines[0].runs[0])
    runs: list[int] = [home]
    begins: list[int] = []
    gone = list(lines) * rounds
    for line in gone:
        runs += way(network, runs[-1], line.runs[0])[1][1:]
        begins.append(len(runs) - 1)
        runs += line.runs[1:]
    runs += way(network, runs[-1], home)[1][1:]
    starts_m = np.concatenate([[0.0], np.cumsum(network.length_m[np.array(runs) >> 1])]) - BEGIN_M
    stops_m = [0.0]
    termini: list[int] = []
    for line, begin in zip(gone, begins, strict=True):
        stops_m += [float(starts_m[begin]) + line.begin_m + stop.chainage_m for stop in line.stops]
        termini.append(len(stops_m))
    length_m = float(starts_m[-1]) - BEGIN_M
    stops_m.append(length_m)
    assert all(b > a for a, b in pairwise(stops_m))
    route = Route("day", tuple(runs), BEGIN_M, length_m, tuple(stops_m))
    return _timed(route, termini, day_s, rng)


def _timed(route: Route, termini: Sequence[int], day_s: float, rng: Generator) -> Day:
    """Turns and breaks of a route whose lines end at the stops of these numbers."""
    turns_back = tuple(termini[0] + number for number in TURNS_AT)
    again = 2 * (turns_back[0] - turns_back[1])
    halts = [number + (again if number > turns_back[0] else 0) for number in termini]
    off_s = OFF_SHARE * day_s
    breaks_s = rng.uniform(*BREAK_S, len(halts)).tolist()
    middle = (len(halts) - 1) // 2
    breaks_s[middle] = OFF_AFTER_S + off_s + OFF_MARGIN_S
    breaks = [Break(halt=1, duration_s=NIGHT_S)]
    breaks += [Break(halt=at, duration_s=s) for at, s in zip(halts, breaks_s, strict=True)]
    return Day(route, turns_back, tuple(breaks), halts[middle], off_s)
