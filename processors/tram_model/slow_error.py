"""That the part of the fixes' error which lasts for minutes is smaller than it was taken to be.

    0 = b + n,    on each horizontal axis

Whoever took b for N(0, σ²) and learns that it is N(0, s²) with s < σ has only to take 0 for a
measurement of b with the variance 1/(1/s² − 1/σ²): that is the same as to have known it from the
beginning (docs/theory.md, section 6.3).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import NONE
from tramstream.processors.tram_model.records import MEMORY
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_EAST = columns_of(Ix.GNSS_SLOW_EAST)
_NORTH = columns_of(Ix.GNSS_SLOW_NORTH)


@compiled
def take(memory: Array, variance: float) -> None:
    """Take both axes; see `SlowError`."""
    f = memory.view(MEMORY)[0]
    f.y[0], f.H[0][Ix.GNSS_SLOW_EAST] = -f.x[Ix.GNSS_SLOW_EAST], 1.0
    update_row(f, 0, _EAST, variance, math.inf)
    f.y[1], f.H[1][Ix.GNSS_SLOW_NORTH] = -f.x[Ix.GNSS_SLOW_NORTH], 1.0
    update_row(f, 1, _NORTH, variance, math.inf)


class SlowError(NamedTuple):
    """That the slow error is 0 but for so much."""

    variance_m2: float

    @property
    def names(self) -> tuple[str, ...]:
        return ("slow_error_east", "slow_error_north")

    @property
    def verdicts(self) -> int:
        return NONE

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, *self)
