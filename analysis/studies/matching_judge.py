"""Which answers of a map matcher are right: its points, its ways at switches, its probabilities.

The truth is a place on a route (`tramstream.simulation.track_rides`). An answer is

- **on the track** if its run is of the true track, in either direction, or if it is on the route
  within `NEAR_M` along it: near a node the neighbour along the way is no other track;
- **unparted** if it is not, but lies where the rails of both have not parted yet: less than
  `PARTED_M` beside the route, no farther along it. Just beyond a switch both ways are one.

A point of a ride is right if it is one of the two. A way at a switch is right if the answer some
way beyond it is on the route, or on a run that only the way taken leads to: a mistake at the next
switch counts there. Probabilities have no such tolerance: just beyond a switch half and half is
what a matcher should say, and each is right half of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tramstream.simulation.track_rides import (
    Choice,
    Flags,
    Integers,
    NetworkRide,
    Spots,
    end_node,
    plan_at,
    sampled,
)
from tramstream.tracks.network import Array, Network

NEAR_M = 15.0
PARTED_M = 1.0
"""Less than the gauge: two tracks that are nearer have rails between each other's."""
ALIKE_RAD = 0.35
"""Tracks that cross under more than this are not one, however near."""
BEYOND_M = 30.0
"""From a switch to where the way taken is asked for."""

EDGES = np.array([
    0.0, 0.01, 0.03, 0.07, 0.13, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97, 0.99, 0.999,
])  # fmt: skip
"""Where bins of probabilities begin; what is called 90 % is that between 0.87 and 0.93."""
APART_S = 5.0
"""Answers of one bin that are nearer in time are of one episode."""


class Verdicts(NamedTuple):
    """What is true of answers, one row each."""

    on_track: Flags
    onward: Flags
    """The run goes the way that the tram does."""
    unparted: Flags
    along_m: Array
    """Ahead of the truth along the route; NaN where the answer is not on it."""

    @property
    def right(self) -> Flags:
        return self.on_track | self.unparted


class Passed(NamedTuple):
    """A switch beyond which the matcher was asked for the way."""

    choice: Choice
    row: int
    """Of the answer."""
    right: bool


class Reliability(NamedTuple):
    """Bins of stated probabilities, one row each from `EDGES` on; sums, so that rides add up."""

    points: Array
    stated: Array
    """Sum of the probabilities."""
    right: Array
    episodes: Array
    """Maximal stretches of one candidate in the bin, on one ride."""


def judge(ride: NetworkRide, said: Spots, route_m: Array) -> Verdicts:
    """Hold answers to the truth.

    Parameters
    ----------
    ride : NetworkRide
    said : Spots
        Answers.
    route_m : ndarray, shape (n,)
        Where on the route the tram was at each.
    """
    along_m, onward = _along(ride, said, route_m)
    true_track = ride.spots_at(route_m).run >> 1
    on_track = (said.run >> 1 == true_track) | (np.abs(along_m) <= NEAR_M)
    unparted = np.zeros(len(on_track), dtype=np.bool_)
    off = np.flatnonzero(~on_track)
    if len(off):
        spots = Spots(said.run[off], said.chainage_m[off])
        unparted[off] = _unparted(ride, spots, route_m[off])
    return Verdicts(on_track, onward & on_track, unparted, along_m)


def _along(ride: NetworkRide, said: Spots, route_m: Array) -> tuple[Array, Flags]:
    """Answers ahead of the truth at the nearest of all times that the route has their track."""
    runs = np.array(ride.route.runs, dtype=np.int64)
    lengths = ride.network.length_m[runs >> 1]
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) - ride.route.begin_m
    along_m = np.full(len(route_m), np.nan)
    onward = np.zeros(len(route_m), dtype=np.bool_)
    for track in np.unique(said.run >> 1).tolist():
        gone = np.flatnonzero(runs >> 1 == track)
        if len(gone) == 0:
            continue
        rows = np.flatnonzero(said.run >> 1 == track)
        alike = said.run[rows, None] == runs[gone]
        chainage = said.chainage_m[rows, None]
        place = starts[gone] + np.where(alike, chainage, lengths[gone] - chainage)
        ahead = place - route_m[rows, None]
        nearest = np.argmin(np.abs(ahead), axis=1)
        along_m[rows] = ahead[np.arange(len(rows)), nearest]
        onward[rows] = alike[np.arange(len(rows)), nearest]
    return along_m, onward


def _unparted(ride: NetworkRide, said: Spots, route_m: Array) -> Flags:
    """Whether answers are beside the route where it and their tracks are still one."""
    steps = np.arange(-NEAR_M, NEAR_M + 1.0)
    at_m = np.clip(route_m[:, None] + steps, 0.0, ride.route.length_m)
    count = len(route_m)
    own = ride.spots_at(at_m.ravel())
    beside = plan_at(ride.network, own).reshape(count, -1, 2)
    offset = plan_at(ride.network, said)[:, None] - beside
    nearest = np.argmin(np.sum(offset**2, axis=2), axis=1)
    rows = np.arange(count)
    yaw = ride.network.yaw_rad
    own_yaw = sampled(ride.network, yaw, own).reshape(count, -1)[rows, nearest]
    turn = own_yaw - sampled(ride.network, yaw, said)
    off_m = np.hypot(*offset[rows, nearest].T)
    parted: Flags = (off_m > PARTED_M) | (np.abs(np.sin(turn)) > np.sin(ALIKE_RAD))
    return ~parted


# Switches -----------------------------------------------------------------------------------------
def ways(
    ride: NetworkRide,
    said: Spots,
    verdicts: Verdicts,
    route_m: Array,
    beyond_m: float = BEYOND_M,
    parted: bool = False,
) -> list[Passed]:
    """Ask for the way taken at each facing switch of the route, so far beyond it.

    If `parted`, it is asked no earlier than the rails of all ways have parted: at some switches
    that takes more than 50 m. Where the ride ends earlier it is asked there; switches less than
    half as far from the end, and such that the answers begin beyond, are left out, and so are
    interlaced tracks: which pair of rails it is that lies a hand beside the other nobody can tell,
    and nothing depends on it. `route_m` ascends.
    """
    found, least_m = [], beyond_m
    for drawn in ride.choices:
        others = tuple(each for each in drawn.others if not interlaced(ride, drawn, each))
        choice = drawn._replace(others=others)
        if not others:
            continue
        beyond_m = max(least_m, parted_m(ride, choice)) if parted else least_m
        asked_m = min(choice.route_m + beyond_m, float(route_m[-1]))
        if asked_m < choice.route_m + beyond_m / 2 or route_m[0] > choice.route_m:
            continue
        row = int(np.searchsorted(route_m, asked_m))
        run = int(said.run[row])
        found.append(Passed(choice, row, _right_way(ride, choice, run, verdicts, row, beyond_m)))
    return found


def _right_way(
    ride: NetworkRide, choice: Choice, run: int, verdicts: Verdicts, row: int, beyond_m: float
) -> bool:
    ahead_m = verdicts.along_m[row]
    if verdicts.on_track[row] and abs(ahead_m) < beyond_m:
        return True
    reach_m = beyond_m + NEAR_M
    own = reached(ride.network, choice.taken, reach_m)
    other = set().union(*(reached(ride.network, each, reach_m) for each in choice.others))
    return run in own - other


def interlaced(ride: NetworkRide, choice: Choice, other: int) -> bool:
    """Whether another way goes from the switch to where the way taken goes, and never parts."""
    network = ride.network
    if end_node(network, other) != end_node(network, choice.taken):
        return False
    return float(np.max(_off_m(ride, choice, other))) <= PARTED_M


def _off_m(ride: NetworkRide, choice: Choice, other: int) -> Array:
    """How far the rails of another way are beside the route, metre by metre to that way's end."""
    steps = np.arange(1.0, max(float(ride.network.length_m[other >> 1]), 2.0))
    beside = plan_at(ride.network, Spots(np.full(len(steps), other), steps))
    own = plan_at(ride.network, ride.spots_at(choice.route_m + steps))
    off: Array = np.hypot(*(beside - own).T)
    return off


def parted_m(ride: NetworkRide, choice: Choice) -> float:
    """How far beyond a switch the rails of all ways have parted; at a way's end at the latest."""
    farthest_m = 0.0
    for other in choice.others:
        off_m = _off_m(ride, choice, other)
        away = np.flatnonzero(off_m > PARTED_M)
        farthest_m = max(farthest_m, 1.0 + float(away[0] if len(away) else len(off_m) - 1))
    return farthest_m


def reached(network: Network, run: int, within_m: float) -> set[int]:
    """Runs that rails lead to within a way from the begin of a run, and itself."""
    begins, waiting = {run: 0.0}, [run]
    while waiting:
        last = waiting.pop()
        end_m = begins[last] + float(network.length_m[last >> 1])
        for after in network.following_of(last).tolist():
            if end_m < min(within_m, begins.get(after, np.inf)):
                begins[after] = end_m
                waiting.append(after)
    return set(begins)


# Probabilities ------------------------------------------------------------------------------------
def reliability(probability: Array, right: Flags, run: Integers, time_s: Array) -> Reliability:
    """Sort stated probabilities into bins.

    Parameters
    ----------
    probability, right, run, time_s : ndarray, shape (n,)
        Of candidates of one ride: what is said of a run at a time, and whether it was right.
    """
    bins = np.clip(np.searchsorted(EDGES, probability, side="right") - 1, 0, len(EDGES) - 1)
    order = np.lexsort((time_s, run, bins))
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (np.diff(bins[order]) != 0) | (np.diff(run[order]) != 0)
    new[1:] |= np.diff(time_s[order]) > APART_S
    size = len(EDGES)
    return Reliability(
        np.bincount(bins, minlength=size).astype(float),
        np.bincount(bins, probability, size).astype(float),
        np.bincount(bins, right, size).astype(float),
        np.bincount(bins[order], new, size).astype(float),
    )


def stretches(wrong: Flags, time_s: Array) -> list[tuple[int, int]]:
    """First and last row of each stretch of wrong answers; a gap of `APART_S` ends one."""
    rows = np.flatnonzero(wrong)
    if len(rows) == 0:
        return []
    cuts = np.flatnonzero(np.diff(time_s[rows]) > APART_S)
    firsts, lasts = np.append(0, cuts + 1), np.append(cuts, len(rows) - 1)
    return list(zip(rows[firsts].tolist(), rows[lasts].tolist(), strict=True))
