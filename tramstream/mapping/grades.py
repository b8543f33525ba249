"""Grades that rides measured go into a network: the one way back from records to the map.

Cells of a grade map belong to tracks by name (the map's nodes at their ends) and length, so that a
network that is built again from the same map, or a newer one, takes them wherever a track is the
same. Where the map has cells they take the place of what terrain gave; elsewhere that stays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.tracks.network import Array, Network

SAME_LENGTH = 0.01
"""A track that is longer or shorter by more than this share, and by `SAME_LENGTH_M`, is another."""
SAME_LENGTH_M = 2.0
REACH = 1.5
"""In cells: so far from the middle of one its slope is taken to go on."""
_STEP_RAD = 2.0**-16
"""What is written is rounded to, which packs: 0.0015 %."""


class TrackGrades(NamedTuple):
    """Cells of one track, ascending along it as drawn."""

    name: str
    """Of its forward run."""
    length_m: float
    """As it was when the map was made."""
    at_m: Array
    """Middle of each cell."""
    width_m: float
    grade_rad: Array
    std_rad: Array
    height_m: Array
    """Above the ellipsoid; NaN where it is not known."""


class Laid(NamedTuple):
    """What became of it."""

    network: Network
    samples: int
    """That have a measured grade."""
    unknown: tuple[str, ...]
    """Names of tracks that the network does not have, or not as they were."""


def lay(network: Network, tracks: list[TrackGrades], source: str) -> Laid:
    """Put measured grades into a network.

    Parameters
    ----------
    network : Network
    tracks : list of TrackGrades
    source : str
        What is added to what the network was built from.
    """
    numbers = {network.name_of(2 * track): track for track in range(network.track_count)}
    turned = {network.name_of(2 * track + 1): track for track in range(network.track_count)}
    grade, std, height = (
        np.array(each) for each in (network.grade_rad, network.grade_std_rad, network.height)
    )
    unknown, laid = [], 0
    for told in tracks:
        track = numbers.get(told.name)
        against = track is None
        if against:  # drawn the other way round since
            track = turned.get(told.name)
        if track is None or not _same_length(float(network.length_m[track]), told.length_m):
            unknown.append(told.name)
            continue
        part = network.samples_of(track)
        at = np.arange(part.stop - part.start) * float(network.spacing_m[track])
        if against:
            at = float(network.length_m[track]) - at
        found, near = _sampled(told, at)
        sign = -1.0 if against else 1.0
        grade[part] = np.where(near, _rounded(sign * found[0]), grade[part])
        std[part] = np.where(near, np.maximum(_rounded(found[1]), _STEP_RAD), std[part])
        high = near & np.isfinite(found[2])
        height[part] = np.where(high, np.rint(found[2] * 64) / 64, height[part])
        laid += int(np.count_nonzero(near))
    for array in (grade, std, height):
        array.flags.writeable = False
    told_source = f"{network.source}; {source}" if laid else network.source
    changed = replace(
        network, grade_rad=grade, grade_std_rad=std, height=height, source=told_source
    )
    return Laid(changed, laid, tuple(unknown))


def _same_length(now_m: float, then_m: float) -> bool:
    return abs(now_m - then_m) <= max(SAME_LENGTH_M, SAME_LENGTH * then_m)


def _sampled(told: TrackGrades, at: Array) -> tuple[list[Array], NDArray[np.bool_]]:
    """Slope, deviation and height at places, and whether a cell is near enough."""
    known = np.isfinite(told.grade_rad) & (told.std_rad > 0)
    middle = told.at_m[known]
    if not len(middle):
        return [np.full(len(at), np.nan)] * 3, np.zeros(len(at), dtype=bool)
    after = np.clip(np.searchsorted(middle, at), 1, max(len(middle) - 1, 1))
    before = np.minimum(after, len(middle)) - 1
    after = np.minimum(after, len(middle) - 1)
    away = np.minimum(np.abs(at - middle[before]), np.abs(at - middle[after]))
    columns = (told.grade_rad, told.std_rad, told.height_m)
    found = [np.interp(at, middle, column[known]) for column in columns]
    return found, away <= REACH * told.width_m


def _rounded(values: Array) -> Array:
    rounded: Array = np.rint(values / _STEP_RAD) * _STEP_RAD
    return rounded
