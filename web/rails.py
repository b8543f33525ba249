"""The track network as the page draws it: tracks, stops, lines; sent once, with few points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tramstream.tracks.network import Network, RouteLine

Array = NDArray[np.float64]
TURN_RAD, REACH_M = math.radians(1.5), 40.0
"""A track is drawn with a point wherever it has turned by so much since the last one, or gone so
far: on a curve of 20 m radius the chord is 2 mm beside the rail."""
PROFILE_M = 20.0
"""Between two points of a line's height profile."""


def drawing(network: Network) -> dict[str, Any]:
    """Tracks, stops and lines of a network, in degrees, as plain data.

    Returns
    -------
    drawing : dict
        `tracks`: for each track its latitudes and longitudes, alternating, in units of 1e-7°, the
        first whole and the others as differences; `stops`: name, latitude, longitude;
        `lines`: see `_line`.
    """
    geodetic = np.degrees(network.geodetic_of(np.column_stack([network.east, network.north])))
    tracks = []
    for track in range(network.track_count):
        part = network.samples_of(track)
        spacing_m = float(network.spacing_m[track])
        kept = _kept(network.yaw_rad[part], spacing_m)
        units = np.round(geodetic[part][kept] * 1e7).astype(np.int64)
        units[1:] -= units[:-1].copy()
        tracks.append(units.ravel().tolist())
    stops = []
    for stop in network.stops:
        latitude_deg, longitude_deg = _place(network, geodetic, stop.track, stop.chainage_m)
        stops.append([stop.name, round(latitude_deg, 7), round(longitude_deg, 7)])
    return {
        "tracks": tracks,
        "stops": stops,
        "lines": [_line(network, line) for line in network.lines],
        "source": network.source,
    }


def _kept(yaw_rad: Array, spacing_m: float) -> NDArray[np.intp]:
    """Samples that a polyline needs: the ends, and where it has turned or gone far."""
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(yaw_rad)))]) / TURN_RAD
    gone = np.arange(len(yaw_rad)) * spacing_m / REACH_M
    step = np.floor(turned + gone)
    kept = np.flatnonzero(np.diff(step, prepend=-1.0) > 0)
    return np.unique(np.concatenate([[0], kept, [len(yaw_rad) - 1]]))


def _place(network: Network, geodetic: Array, track: int, chainage_m: float) -> tuple[float, float]:
    part = network.samples_of(track)
    at = chainage_m / float(network.spacing_m[track])
    samples = np.arange(part.stop - part.start)
    latitude_deg, longitude_deg = (
        float(np.interp(at, samples, geodetic[part, column])) for column in (0, 1)
    )
    return latitude_deg, longitude_deg


def _line(network: Network, line: RouteLine) -> dict[str, Any]:
    """One direction of a line: its stops by chainage, its heights every `PROFILE_M`."""
    chainages, heights = _heights(network, line.runs, line.begin_m)
    at = np.arange(0.0, line.length_m + PROFILE_M, PROFILE_M)
    known = np.isfinite(heights)
    profile: list[float] = []
    if known.mean() > 0.5:
        profile = np.round(np.interp(at, chainages[known], heights[known]), 1).tolist()
    return {
        "line": line.line,
        "direction": line.direction,
        "origin": line.origin,
        "destination": line.destination,
        "length_m": round(line.length_m, 1),
        "stops": [[stop.name, round(stop.chainage_m, 1)] for stop in line.stops],
        "profile_m": PROFILE_M,
        "heights_m": profile,
    }


def _heights(network: Network, runs: Sequence[int], begin_m: float) -> tuple[Array, Array]:
    """Chainage along a path of runs, and height there, sample by sample."""
    chainages, heights, done_m = [], [], -begin_m
    for run in runs:
        track = run >> 1
        part = network.samples_of(track)
        height = network.height[part].astype(np.float64)
        length_m = float(network.length_m[track])
        chainages.append(done_m + np.linspace(0.0, length_m, len(height)))
        heights.append(height if run % 2 == 0 else height[::-1])
        done_m += length_m
    return np.concatenate(chainages), np.concatenate(heights)
