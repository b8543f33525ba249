"""A wheel's speed, where the bus gives one instead of a counter.

    z = σ (v_r − v̇ τ − d ω_z) (1 + k) + n

with the speed v_r of its bogie (v where there is none), the wheel's offset d to the left of the
axis, its scale error k, the sign σ by which it counts, and the delay τ of the bus (docs/theory.md,
section 6.6).
"""

from __future__ import annotations

from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import EVERY, SCALAR_GATE
from tramstream.processors.tram_model.motion import bogie_speed
from tramstream.processors.tram_model.records import LEFT, MEMORY, PARAMETERS, SITUATION, Situation
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

_LEFT = columns_of(Ix.SPEED, Ix.SCALE_A, Ix.GYRO_Z, Ix.WHEEL_DELAY)
_RIGHT = columns_of(Ix.SPEED, Ix.SCALE_B, Ix.GYRO_Z, Ix.WHEEL_DELAY)
_NAMES = (("rim_a",), ("rim_b",))


@compiled
def _true_speed(
    rolling: float, x: Array, s: Situation, wheel: int, acceleration: float, yaw_rate: float
) -> float:
    """Speed of a wheel of the true radius as the bus tells it now; `rolling`: its bogie's, m/s."""
    late = rolling - acceleration * x[Ix.WHEEL_DELAY] - s.wheel_offset[wheel] * yaw_rate
    speed: float = s.wheel_sign[wheel] * late
    return speed


@compiled
def expected(
    rolling: float, x: Array, s: Situation, wheel: int, acceleration: float, yaw_rate: float
) -> float:
    """h(x), m/s."""
    true = _true_speed(rolling, x, s, wheel, acceleration, yaw_rate)
    speed: float = true * (1.0 + x[Ix.SCALE_A + wheel])
    return speed


@compiled
def jacobian(
    rolling: float,
    x: Array,
    s: Situation,
    wheel: int,
    acceleration: float,
    yaw_rate: float,
    h: Array,
) -> None:
    """Fill a row of H; the yaw rate follows the bias of the vertical gyroscope."""
    sign, offset, counted = s.wheel_sign[wheel], s.wheel_offset[wheel], 1.0 + x[Ix.SCALE_A + wheel]
    h[Ix.SPEED] = sign * counted
    h[Ix.SCALE_A + wheel] = _true_speed(rolling, x, s, wheel, acceleration, yaw_rate)
    h[Ix.GYRO_Z] = sign * offset * counted
    h[Ix.WHEEL_DELAY] = -sign * acceleration * counted


@compiled
def take(
    memory: Array,
    parameters: Array,
    situation: Array,
    wheel: int,
    speed: float,
    variance: float,
    gate: float,
) -> None:
    """Take a wheel's speed; see `WheelSpeed`."""
    f, s = memory.view(MEMORY)[0], situation.view(SITUATION)[0]
    rolling = bogie_speed(parameters.view(PARAMETERS)[0], f.x[Ix.SPEED], f.yaw_rate)
    f.y[0] = speed - expected(rolling, f.x, s, wheel, f.acceleration, f.yaw_rate)
    jacobian(rolling, f.x, s, wheel, f.acceleration, f.yaw_rate, f.H[0])
    update_row(f, 0, _LEFT if wheel == LEFT else _RIGHT, variance, gate)


class WheelSpeed(NamedTuple):
    """A wheel's speed."""

    wheel: int
    """`LEFT` or `RIGHT`."""
    speed_mps: float
    variance: float
    """(m/s)²."""
    gate: float = SCALAR_GATE

    @property
    def verdicts(self) -> int:
        return EVERY

    @property
    def names(self) -> tuple[str, ...]:
        return _NAMES[self.wheel]

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, parameters, situation, *self)
