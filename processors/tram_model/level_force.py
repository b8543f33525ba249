"""The specific force along x of a vehicle that stands: gravity on its slope, and the bias.

    f_x = −g sin θ + b_x + (mounting) + n

What a level sensor shows; with the ride's accelerations it tells pitch and bias apart (P. D.
Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
section 5.6.2: levelling; docs/theory.md, section 6.9).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import NONE, SCALAR_GATE
from tramstream.processors.tram_model.motion import force_along
from tramstream.processors.tram_model.records import (
    MEMORY,
    PARAMETERS,
    READING,
    Memory,
    Parameters,
    Reading,
)
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_COLUMNS = columns_of(Ix.PITCH, Ix.ACCEL_X, Ix.MOUNT_YAW, Ix.MOUNT_PITCH)


@compiled
def innovation(x: Array, c: Parameters, u: Reading) -> float:
    """z − h(x): what is left of the force without gravity, bias and mounting, m/s²."""
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    tilt = x[Ix.EAST] * math.cos(x[Ix.YAW]) + x[Ix.NORTH] * math.sin(x[Ix.YAW])
    gravity = c.gravity * (cp * tilt * c.earth_curvature - sp)
    left: float = force_along(x, u) - gravity
    return left


@compiled
def jacobian(x: Array, c: Parameters, h: Array) -> None:
    """Fill a row of H.

    The other axes enter by what gravity has there: their readings shake with this one, and the
    product of shaking and innovation has a mean that would turn into a false mounting.
    """
    cp = math.cos(x[Ix.PITCH])
    across, upright = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    h[Ix.PITCH], h[Ix.ACCEL_X] = -c.gravity * cp, 1.0
    h[Ix.MOUNT_YAW] = c.gravity * cp * across
    h[Ix.MOUNT_PITCH] = -c.gravity * cp * upright


@compiled
def take_reading(f: Memory, c: Parameters, u: Reading, variance: float, gate: float) -> None:
    """Take the force of a reading."""
    jacobian(f.x, c, f.H[0])
    f.y[0] = innovation(f.x, c, u)
    update_row(f, 0, _COLUMNS, variance, gate)


@compiled
def take(memory: Array, parameters: Array, u: Array, variance: float, gate: float) -> None:
    """Take the force of a reading; see `LevelForce`."""
    take_reading(
        memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], u.view(READING)[0], variance, gate
    )


class LevelForce(NamedTuple):
    """Specific force along x of a vehicle that stands."""

    reading: Array
    """Numbers of one `Reading`, v."""
    variance: float
    """(m/s²)²."""
    gate: float = SCALAR_GATE
    """Braking with locked wheels that was taken for standing is no slope."""

    @property
    def names(self) -> tuple[str, ...]:
        return ("level_force",)

    @property
    def verdicts(self) -> int:
        return NONE

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, parameters, *self)
