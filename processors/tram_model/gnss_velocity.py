"""The antenna's velocity over ground by GNSS, east and north.

    z = v_a − a_a τ + n

with the antenna's velocity v_a and acceleration a_a, and the delay τ by which the stamp is too late
(docs/theory.md, section 6.4; the velocity's lever arm: `lever_arm.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.lever_arm import antenna, antenna_velocity, lever_arm
from tramstream.processors.tram_model.measurement import EVERY, PAIR_GATE, PAIR_KNEE
from tramstream.processors.tram_model.records import (
    MEMORY,
    PARAMETERS,
    SITUATION,
    Parameters,
    Situation,
)
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_pair

_COLUMNS = columns_of(Ix.SPEED, Ix.YAW, Ix.GNSS_DELAY, Ix.GYRO_Z, Ix.ROLL, Ix.PITCH, Ix.PIVOT)


@compiled
def expected(
    x: Array, c: Parameters, s: Situation, acceleration: float, yaw_rate: float
) -> tuple[float, float]:
    """h(x): east and north, m/s."""
    ve, vn = antenna_velocity(x, c, s, yaw_rate)
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    ae, an = cy * acceleration - yaw_rate * vn, sy * acceleration + yaw_rate * ve
    delay = x[Ix.GNSS_DELAY]
    return ve - ae * delay, vn - an * delay


@compiled
def jacobian(
    x: Array, c: Parameters, s: Situation, acceleration: float, yaw_rate: float, H: Array
) -> None:
    """Fill rows 0 and 1 of H; the yaw rate follows the bias of the vertical gyroscope."""
    _, _, _, along, across = antenna(x, c, s)
    _, _, az = lever_arm(x, c, s)
    ve, vn = antenna_velocity(x, c, s, yaw_rate)
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    cp, delay = math.cos(x[Ix.PITCH]), x[Ix.GNSS_DELAY]
    ae, an = cy * acceleration - yaw_rate * vn, sy * acceleration + yaw_rate * ve
    # A high antenna leans with roll and pitch.
    turn = yaw_rate if s.heading_known else 0.0
    swing, sinking = yaw_rate * az, x[Ix.SPEED] * math.sin(x[Ix.PITCH])
    h = H[0]
    h[Ix.SPEED], h[Ix.YAW], h[Ix.GNSS_DELAY] = cy * cp, an * delay - vn, -ae
    h[Ix.GYRO_Z] = cy * across + sy * along
    h[Ix.ROLL], h[Ix.PITCH] = cy * swing, -cy * sinking - sy * swing
    h[Ix.PIVOT] = -sy * turn
    h = H[1]
    h[Ix.SPEED], h[Ix.YAW], h[Ix.GNSS_DELAY] = sy * cp, ve - ae * delay, -an
    h[Ix.GYRO_Z] = sy * across - cy * along
    h[Ix.ROLL], h[Ix.PITCH] = sy * swing, -sy * sinking + cy * swing
    h[Ix.PIVOT] = cy * turn


@compiled
def take(
    memory: Array,
    parameters: Array,
    situation: Array,
    east: float,
    north: float,
    variance: float,
    gate: float,
    knee: float,
) -> None:
    """Take a velocity; see `GnssVelocity`."""
    f, c, s = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    h_east, h_north = expected(f.x, c, s, f.acceleration, f.yaw_rate)
    jacobian(f.x, c, s, f.acceleration, f.yaw_rate, f.H)
    f.y[0], f.y[1] = east - h_east, north - h_north
    update_pair(f, _COLUMNS, _COLUMNS, variance, 0.0, gate, knee)


class GnssVelocity(NamedTuple):
    """The antenna's velocity over ground."""

    east_mps: float
    north_mps: float
    variance: float
    """On each axis, (m/s)²."""
    gate: float = PAIR_GATE
    knee: float = PAIR_KNEE

    @property
    def names(self) -> tuple[str, ...]:
        return ("gnss_velocity_east", "gnss_velocity_north")

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, parameters, situation, *self)
