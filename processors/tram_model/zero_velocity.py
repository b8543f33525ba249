"""Zero-velocity update (ZUPT): a vehicle that stands has no speed along x.

    0 = v + n

P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
section 15.3; docs/theory.md, section 6.9.
"""

from __future__ import annotations

from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import NONE, SCALAR_GATE
from tramstream.processors.tram_model.records import MEMORY
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

STANDING_STD_MPS = 0.002
"""Speed that a vehicle may have that is said to stand; chosen by hand."""
_SPEED = columns_of(Ix.SPEED)


@compiled
def take(memory: Array, variance: float, gate: float) -> None:
    """Take that there is no speed; see `ZeroVelocity`."""
    f = memory.view(MEMORY)[0]
    f.H[0, Ix.SPEED] = 1.0
    f.y[0] = -f.x[Ix.SPEED]
    update_row(f, 0, _SPEED, variance, gate)


class ZeroVelocity(NamedTuple):
    """No speed along x."""

    variance: float = STANDING_STD_MPS**2
    """(m/s)²."""
    gate: float = SCALAR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("zero_velocity",)

    @property
    def verdicts(self) -> int:
        return NONE

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, self.variance, self.gate)
