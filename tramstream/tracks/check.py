"""Whether the arrays of a network fit together: compiled code does not look again.

A file may come from anybody, and a number that points beyond the end of an array would be read from
wherever that is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PER_TRACK = {"length_m": "f8", "rules": "i1", "from_node": "i4", "to_node": "i4"}
_PER_NODE = {"node_id": "i8", "node_switch": "i1"}
_PER_SAMPLE = {
    "east": "f8",
    "north": "f8",
    "yaw_rad": "f8",
    "curvature_per_m": "f8",
    "across_std_m": "f4",
    "yaw_std_rad": "f4",
    "height": "f4",
    "grade_rad": "f4",
    "grade_std_rad": "f4",
    "partner": "i1",
}
_PLACES = {"starts": "i4", "following_starts": "i4", "following": "i4"}
KINDS = {**_PER_TRACK, **_PER_NODE, **_PER_SAMPLE, **_PLACES}
"""Every array of a network and what its numbers are, as numpy names it."""
_MAY_BE_UNKNOWN = ("height", "grade_rad", "grade_std_rad")
_FAR_M = 1e7
"""Nothing lies farther from the plan's origin."""
_LIMITS = {
    "length_m": _FAR_M,
    "east": _FAR_M,
    "north": _FAR_M,
    "yaw_rad": 1e6,
    "curvature_per_m": 10.0,
    "across_std_m": _FAR_M,
    "yaw_std_rad": 1e3,
    "height": 1e5,
    "grade_rad": 10.0,
    "grade_std_rad": 1e3,
}
"""Sizes that no rail has: beyond them sums and squares are no numbers any more."""
_SPACING_M = (1e-6, 1e3)
"""Of the samples of a track, least and most: how many fit between two places is counted."""


def doubt_of(arrays: Mapping[str, NDArray[Any]]) -> str:
    """What does not fit together; empty if all does."""
    if set(arrays) != set(KINDS):
        return "arrays are missing"
    for name, kind in KINDS.items():
        if arrays[name].dtype != np.dtype(kind) or arrays[name].ndim != 1:
            return f"{name} is of another kind"
    tracks, nodes = len(arrays["length_m"]), len(arrays["node_id"])
    starts, following_starts = arrays["starts"], arrays["following_starts"]
    lengths = dict.fromkeys(_PER_TRACK, tracks) | dict.fromkeys(_PER_NODE, nodes)
    lengths |= {"starts": tracks + 1, "following_starts": 2 * tracks + 1}
    lengths |= dict.fromkeys(_PER_SAMPLE, int(starts[-1]) if len(starts) else -1)
    for name, length in lengths.items():
        if len(arrays[name]) != length:
            return f"{name} has {len(arrays[name])} numbers, not {length}"
    counts = np.diff(starts.astype(np.int64))  # 32 bits would run over
    if not tracks or starts[0] != 0 or np.any(counts < 2):
        return "starts do not rise"
    if following_starts[0] != 0 or np.any(np.diff(following_starts.astype(np.int64)) < 0):
        return "following_starts do not rise"
    if following_starts[-1] != len(arrays["following"]):
        return "following_starts end elsewhere than following"
    for name, limit in (("following", 2 * tracks), ("from_node", nodes), ("to_node", nodes)):
        if not are_below(arrays[name], limit):
            return f"{name} points beyond what there is"
    for name, kind in KINDS.items():
        known = kind[0] != "f" or name in _MAY_BE_UNKNOWN or np.all(np.isfinite(arrays[name]))
        if not known:
            return f"{name} holds what is no number"
    for name, largest in _LIMITS.items():
        if np.any(np.abs(arrays[name]) > largest):  # NaN is not
            return f"{name} is larger than any rail's"
    spacing_m = arrays["length_m"] / (counts - 1)
    if np.any(spacing_m < _SPACING_M[0]) or np.any(spacing_m > _SPACING_M[1]):
        return "length_m does not fit the samples"
    return ""


def are_below(numbers: NDArray[Any] | Iterable[int], limit: int) -> bool:
    """Whether all are places in something that has `limit` of them."""
    found = numbers if isinstance(numbers, np.ndarray) else list(numbers)
    return len(found) == 0 or bool(min(found) >= 0 and max(found) < limit)


def are_lengths(values: Iterable[float]) -> bool:
    """Whether all are finite, and none is larger than anything on Earth."""
    return all(math.isfinite(value) and abs(value) <= _FAR_M for value in values)
