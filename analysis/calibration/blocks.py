"""An axis at standstill in few numbers, from which its noise is estimated with nothing lost.

Samples are cut into blocks of 2^J. Within a block Haar's transform splits what the samples say into
the block's mean and one detail for each pair of neighbouring halves; of the details only sums of
squares matter, octave by octave, for within a block there is hardly anything but white noise. What
walks shows in the means, which are kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.calibration.allan import Counts, Run

Array = NDArray[np.float64]

MOST_BLOCKS = 12_000
"""Means that are kept: six hours in blocks of two seconds. Correlation times of bias are far
longer."""
FEWEST_BLOCKS = 64
SHORTEST_S = 0.5
_SLAB = 1 << 20


class Blocks(NamedTuple):
    """An axis in blocks; counts throughout."""

    block_s: float
    mean: Array
    """Of each block, shape (n,)."""
    temperature: Array
    """Of each block, °C, shape (n,); NaN where there is none."""
    restarts: NDArray[np.bool_]
    """Where a block does not follow the one before: its level is another then."""
    half_s: Array
    """Of each octave, shape (J,): the time that each of two neighbouring halves lasts."""
    squares: Array
    """Of each octave: sum of the squares of the differences of their means."""
    details: NDArray[np.int64]
    """Of each octave: how many there are."""


def block_size(runs: Sequence[Run], rate_hz: float) -> int:
    """Samples of a block: a power of two, so many that there are at most `MOST_BLOCKS`.

    Half a second if the record is long enough: what is faster is often not white (an engine, a
    sensor's own filter), which shows within blocks and is left out there.
    """
    samples = max(sum(run.end - run.start for run in runs), 1)
    least = math.ceil(math.log2(samples / MOST_BLOCKS))
    wanted = math.floor(math.log2(max(SHORTEST_S * rate_hz, 1.0)))
    room = math.floor(math.log2(max(samples / (2 * FEWEST_BLOCKS), 1.0)))
    return 1 << max(least, min(wanted, room), 0)


def blocks_of(
    counts: Counts, runs: Sequence[Run], rate_hz: float, temperature: tuple[Array, Array]
) -> Blocks:
    """Cut an axis into blocks; what is left at the end of a run is left out.

    Parameters
    ----------
    counts : ndarray, shape (n,)
    runs : sequence of Run
    rate_hz : float
    temperature : tuple of ndarray
        Sample numbers, ascending, and the temperature there, °C; both may be empty.
    """
    size = block_size(runs, rate_hz)
    levels = int(math.log2(size))
    squares, details = np.zeros(levels), np.zeros(levels, np.int64)
    means, centres, restarts = [], [], []
    for run in runs:
        whole = (run.end - run.start) // size
        slab = max(_SLAB // size, 1)
        for first in range(0, whole, slab):
            begin = run.start + first * size
            end = run.start + min(first + slab, whole) * size
            sums = counts[begin:end].astype(np.int64)
            for level in range(levels):
                half = 1 << level
                halves = sums.reshape(-1, 2)
                detail = (halves[:, 1] - halves[:, 0]) / half
                squares[level] += float(detail @ detail)
                details[level] += len(detail)
                sums = halves[:, 0] + halves[:, 1]
            means.append(sums / size)
            centres.append(np.arange(begin, end, size) + (size - 1) / 2)
            restarts.append(np.arange(first, first + len(sums)) == 0)
    none: Array = np.zeros(0)
    centre = np.concatenate([none, *centres])
    return Blocks(
        block_s=size / rate_hz,
        mean=np.concatenate([none, *means]),
        temperature=_at(centre, size, *temperature),
        restarts=np.concatenate([none.astype(bool), *restarts]),
        half_s=(1 << np.arange(levels)) / rate_hz,
        squares=squares,
        details=details,
    )


def _at(centre: Array, size: int, number: Array, value: Array) -> Array:
    """Temperature of blocks: the mean of what was read in each, else straight between."""
    if not len(number):
        return np.full(len(centre), math.nan)
    low = np.searchsorted(number, centre - size / 2)
    high = np.searchsorted(number, centre + size / 2)
    whole = np.append(0.0, np.cumsum(value))
    between: Array = np.interp(centre, number, value)
    inside = high > low
    mean = (whole[high] - whole[low]) / np.maximum(high - low, 1)
    found: Array = np.where(inside, mean, between)
    return found
