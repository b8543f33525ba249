"""Non-holonomic constraint (NHC) upright: springs bounce, and nothing flies.

    0 = w + n, at each reading

for the speed w along z, which is a state where the vertical specific force is used (P. D. Groves,
Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., section
15.4.1; docs/theory.md, section 6.8).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import NONE
from tramstream.processors.tram_model.records import MEMORY, PARAMETERS, Memory, Parameters
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_HEAVE = columns_of(Ix.HEAVE)


@compiled
def take_constraint(f: Memory, c: Parameters) -> None:
    """Take that there is no speed along z."""
    f.H[0, Ix.HEAVE] = 1.0
    f.y[0] = -f.x[Ix.HEAVE]
    update_row(f, 0, _HEAVE, c.heave_variance, math.inf)


@compiled
def take(memory: Array, parameters: Array) -> None:
    """Take it; see `VerticalConstraint`."""
    take_constraint(memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0])


class VerticalConstraint(NamedTuple):
    """No speed along z in the mean; its variance is a parameter of the model."""

    @property
    def names(self) -> tuple[str, ...]:
        return ("vertical_constraint",)

    @property
    def verdicts(self) -> int:
        return NONE

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, parameters)
