"""Zero angular rate update (ZARU): the gyroscopes of a vehicle that stands show their biases.

    ω = b_g + n, axis by axis

P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
section 15.3.2; docs/theory.md, section 6.9. Left out: the Earth's rotation, which the biases take
up, and the small angles of the mounting, by which a bias would have to be turned.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import NONE
from tramstream.processors.tram_model.records import MEMORY, READING, Memory, Reading
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_BIASES = (columns_of(Ix.GYRO_X), columns_of(Ix.GYRO_Y), columns_of(Ix.GYRO_Z))


@compiled
def take_reading(f: Memory, u: Reading, roll: float, pitch: float, yaw: float) -> None:
    """Take a reading of all three gyroscopes; `roll`, `pitch`, `yaw` are their variances."""
    variances = (roll, pitch, yaw)
    for axis in range(3):
        f.H[axis, Ix.GYRO_X + axis] = 1.0
        f.y[axis] = u.angular_rate[axis] - f.x[Ix.GYRO_X + axis]
        update_row(f, axis, _BIASES[axis], variances[axis], math.inf)


@compiled
def take(memory: Array, u: Array, roll: float, pitch: float, yaw: float) -> None:
    """Take a reading; see `ZeroAngularRate`."""
    take_reading(memory.view(MEMORY)[0], u.view(READING)[0], roll, pitch, yaw)


class ZeroAngularRate(NamedTuple):
    """No rate about any axis."""

    reading: Array
    """Numbers of one `Reading`, v."""
    roll_variance: float
    """Of the reading on each axis, (rad/s)²."""
    pitch_variance: float
    yaw_variance: float

    @property
    def names(self) -> tuple[str, ...]:
        return ("zero_angular_rate_x", "zero_angular_rate_y", "zero_angular_rate_z")

    @property
    def verdicts(self) -> int:
        return NONE

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, *self)
