"""Non-holonomic constraint (NHC) across the track, told by the lateral specific force.

    f_y = v ω_z + g cos θ sin φ + (lever of the case) + b_y + n

The vehicle's pivot has no speed to the side, so what the accelerometer reads there is curve and
cant alone. That there is no such speed is in the motion already; this is its derivative (P. D.
Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
section 15.4.1, has the constraint itself; docs/theory.md, section 6.7, this form).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import REFUSED, SCALAR_GATE
from tramstream.processors.tram_model.motion import rates
from tramstream.processors.tram_model.records import (
    INERTIAL,
    MEMORY,
    PARAMETERS,
    Memory,
    Parameters,
    Reading,
    X,
    Y,
    Z,
)
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_COLUMNS = columns_of(
    Ix.SPEED,
    Ix.ROLL,
    Ix.PITCH,
    Ix.GYRO_Z,
    Ix.ACCEL_Y,
    Ix.MOUNT_ROLL,
    Ix.MOUNT_YAW,
    Ix.GYRO_SCALE,
    Ix.MOUNT_PITCH,
)


@compiled
def innovation(x: Array, c: Parameters, u: Reading) -> float:
    """z − h(x), m/s²."""
    wx, wy, wz = rates(x, u.angular_rate)
    sr, cp = math.sin(x[Ix.ROLL]), math.cos(x[Ix.PITCH])
    rx, ry, rz = c.imu_lever[X] + x[Ix.PIVOT], c.imu_lever[Y], c.imu_lever[Z]
    turn, force = u.angular_acceleration, u.specific_force
    lever = wx * wy * rx - (wx * wx + wz * wz) * ry + wy * wz * rz + turn[Z] * rx - turn[X] * rz
    tilt = x[Ix.NORTH] * math.cos(x[Ix.YAW]) - x[Ix.EAST] * math.sin(x[Ix.YAW])
    expected = x[Ix.SPEED] * wz + c.gravity * (cp * sr + tilt * c.earth_curvature) + lever
    read = force[Y] + x[Ix.MOUNT_YAW] * force[X] - x[Ix.MOUNT_ROLL] * force[Z] - x[Ix.ACCEL_Y]
    left: float = read - expected
    return left


@compiled
def jacobian(x: Array, c: Parameters, steady_rate: Array, acceleration: float, h: Array) -> None:
    """Fill a row of H with the steady rates before the reading.

    The reading's own rates would carry the noise of the gyroscope that the innovation carries too,
    and their product has a mean that turns into a false scale, or, without wheels, into a speed
    that shrinks. Vibration shares even the reading before.
    """
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    g, v, scale = c.gravity, x[Ix.SPEED], 1.0 - x[Ix.GYRO_SCALE]
    wx, _, wz = rates(x, steady_rate)
    h[Ix.SPEED], h[Ix.ROLL], h[Ix.PITCH] = wz, g * cp * cr, -g * sp * sr
    h[Ix.GYRO_Z], h[Ix.ACCEL_Y] = -v * scale, 1.0
    # Forces as the motion has them: read ones shake with the innovation's own.
    h[Ix.MOUNT_ROLL], h[Ix.MOUNT_YAW] = g * cp * cr, g * sp - acceleration
    h[Ix.GYRO_SCALE], h[Ix.MOUNT_PITCH] = -v * (steady_rate[Z] - x[Ix.GYRO_Z]), -v * wx


@compiled
def take_reading(f: Memory, c: Parameters, u: Reading, steady_rate: Array, gate: float) -> None:
    """Take the force of a reading."""
    f.y[0] = innovation(f.x, c, u)
    jacobian(f.x, c, steady_rate, f.acceleration, f.H[0])
    v = f.x[Ix.SPEED]
    # Midway between bogies the speed to the side comes and goes with the ends of a transition.
    shoved = v * u.angular_acceleration[Z] * c.half_base / 6.0
    swaying = max(c.lateral_variance, u.force_scatter[Y])
    # A pivot that is not known yet pushes where the turning changes; that shakes, and teaches none.
    pushed = u.angular_acceleration[Z] * u.angular_acceleration[Z] * f.P[Ix.PIVOT, Ix.PIVOT]
    variance = swaying + v * v * c.rate_variance + shoved * shoved + pushed
    update_row(f, 0, _COLUMNS, variance, gate)


@compiled
def take(memory: Array, parameters: Array, inertial: Array, gate: float) -> None:
    """Take the newest reading; see `LateralForce`."""
    i = inertial.view(INERTIAL)[0]
    take_reading(memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], i.now, i.steady_rate, gate)


class LateralForce(NamedTuple):
    """Specific force along y of a vehicle that does not slip sideways."""

    inertial: Array
    """Numbers of one `Inertial`."""
    gate: float = SCALAR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("lateral_force",)

    @property
    def verdicts(self) -> int:
        return REFUSED

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        # What comes a hundred times a second is called without an asterisk.
        take(memory, parameters, self.inertial, self.gate)
