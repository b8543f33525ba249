"""The slope ahead: the map's on the likely way; behind it, or without a map, the last one known.

Where rails branch, the way that turns least is gone on: slopes of branches part slowly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processors.grade.kernels import BEND_LENGTH_M, BEND_STD_PER_M
from tramstream.processors.grade.stopping import PIECE_M, PIECES
from tramstream.tracks.network import Network

Array = NDArray[np.float64]
LEAST_PROBABILITY = 0.9
"""A less likely track's slope is not looked at."""
BRANCHES = 50
"""A way of so many tracks is long enough for any braking."""
_MIDDLES = PIECE_M * np.arange(0.5, PIECES, dtype=np.float64)
_FADED = BEND_LENGTH_M * (1.0 - np.exp(-_MIDDLES / BEND_LENGTH_M))


class Ahead(NamedTuple):
    """Slopes of pieces of `PIECE_M` ahead, uphill positive in the direction of motion."""

    slopes: Array
    stds: Array
    """Of the mean slope from the vehicle to the end of each piece."""
    mapped_m: float
    """The map's so far; behind that the last one."""

    def std_at(self, distance_m: float) -> float:
        """Deviation of the mean slope of a way."""
        return float(self.stds[min(int(distance_m / PIECE_M), PIECES - 1)])

    def mean_to(self, distance_m: float) -> float:
        """Mean slope of a way."""
        count = min(max(int(distance_m / PIECE_M + 0.5), 1), PIECES)
        return float(self.slopes[:count].mean())


def known_now(slope_rad: float, variance: float, bend_per_m: float) -> Ahead:
    """Go on with the slope of now: its bend is forgotten, and it walks.

    Parameters
    ----------
    slope_rad, bend_per_m : float
        In the direction of motion.
    variance : float
        Of the slope.
    """
    slopes = slope_rad + bend_per_m * _FADED
    return Ahead(slopes, np.sqrt(variance + _WALKED), 0.0)


def _walked() -> Array:
    """Variance that the mean slope of a way has by what the slope may become on it.

    A third of that at its end, 2 σ² L (s − L (1 − exp(−s/L))) of a bend that forgets itself in L.
    """
    variance = BEND_STD_PER_M**2 * BEND_LENGTH_M
    walked: Array = 2.0 * variance * (_MIDDLES - _FADED) / 3.0
    return walked


_WALKED = _walked()


class WayAhead:
    """Slopes of a network's rails.

    Parameters
    ----------
    network : Network
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._spacing = network.spacing_m

    def of(self, run: int, chainage_m: float, here: Ahead) -> Ahead:
        """Put the map's slopes into those that are known from the vehicle alone.

        Parameters
        ----------
        run : int
            In the direction of motion.
        here : Ahead
            See `known_now`.
        """
        slopes, stds = here.slopes.copy(), here.stds.copy()
        network, piece = self._network, 0
        if not 0 <= run < 2 * network.track_count:
            return here
        begin_m = -chainage_m
        for _ in range(BRANCHES):
            end_m = begin_m + float(network.length_m[run >> 1])
            last = min(int(np.searchsorted(_MIDDLES, end_m)), PIECES)
            if last > piece:
                found, errors = self._sampled(run, _MIDDLES[piece:last] - begin_m)
                known = ~np.isnan(found)
                count = len(known) if known.all() else int(np.argmin(known))
                slopes[piece : piece + count] = found[:count]
                stds[piece : piece + count] = errors[:count]
                piece += count
                if count < len(known):
                    break
            following = network.following_of(run)
            if piece == PIECES or not len(following):
                break
            run, begin_m = self._straightest(run, following), end_m
        if 0 < piece < PIECES:
            slopes[piece:] = slopes[piece - 1]
            rest = _WALKED[: PIECES - piece]
            stds[piece:] = np.sqrt(stds[piece - 1] ** 2 + rest)
        return Ahead(slopes, stds, piece * PIECE_M)

    def _sampled(self, run: int, chainage_m: Array) -> tuple[Array, Array]:
        """Slope along a run, and its deviation, at chainages of it."""
        track = run >> 1
        backwards = run & 1
        along = self._network.length_m[track] - chainage_m if backwards else chainage_m
        first, end = self._network.starts[track : track + 2]
        at = first + np.rint(along / self._spacing[track]).astype(np.int64)
        at = np.clip(at, first, end - 1)
        slope = self._network.grade_rad[at].astype(np.float64)
        std = self._network.grade_std_rad[at].astype(np.float64)
        return (-slope if backwards else slope), std

    def _straightest(self, run: int, following: NDArray[np.int32]) -> int:
        if len(following) == 1:
            return int(following[0])
        yaw = self._yaw(run, at_end=True)
        turns = [
            abs(math.remainder(self._yaw(int(each), at_end=False) - yaw, math.tau))
            + abs(self._bend(int(each)))
            for each in following
        ]
        return int(following[int(np.argmin(turns))])

    def _yaw(self, run: int, at_end: bool) -> float:
        """Of a run in its own direction, at its end or begin."""
        first, end = self._network.starts[run >> 1 : (run >> 1) + 2]
        drawn_end = at_end != bool(run & 1)
        yaw = float(self._network.yaw_rad[end - 1 if drawn_end else first])
        return yaw + math.pi if run & 1 else yaw

    def _bend(self, run: int) -> float:
        """How much a run turns over its first ten metres: branches part with the same heading."""
        first, end = (int(each) for each in self._network.starts[run >> 1 : (run >> 1) + 2])
        count = min(int(10.0 / self._spacing[run >> 1]), end - 1 - first)
        a, b = (end - 1, end - 1 - count) if run & 1 else (first, first + count)
        return float(self._network.yaw_rad[b] - self._network.yaw_rad[a])
