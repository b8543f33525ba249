"""The path that a wheel has counted since its last reading.

    z = s − σ v τ (1 + k) + n

with the path s that the filter has integrated for that wheel (a state, which counts from each
reading on), its scale error k, the sign σ by which it counts, and the delay τ of the bus
(docs/theory.md, section 6.5). A path never loses a pulse to rounding, as a speed made of
pulses would.
"""

from __future__ import annotations

from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import EVERY, SCALAR_GATE
from tramstream.processors.tram_model.records import LEFT, MEMORY, SITUATION, Situation
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, make_anew, update_row

_LEFT = columns_of(Ix.PATH_A, Ix.WHEEL_DELAY, Ix.SPEED, Ix.SCALE_A)
_RIGHT = columns_of(Ix.PATH_B, Ix.WHEEL_DELAY, Ix.SPEED, Ix.SCALE_B)
_NAMES = (("wheel_a",), ("wheel_b",))


@compiled
def expected(x: Array, s: Situation, wheel: int) -> float:
    """h(x): what the wheel's counter should show since its last reading, m."""
    v, scale = s.wheel_sign[wheel] * x[Ix.SPEED], x[Ix.SCALE_A + wheel]
    shown: float = x[Ix.PATH_A + wheel] - v * x[Ix.WHEEL_DELAY] * (1.0 + scale)
    return shown


@compiled
def jacobian(x: Array, s: Situation, wheel: int, h: Array) -> None:
    """Fill a row of H."""
    sign, delay = s.wheel_sign[wheel], x[Ix.WHEEL_DELAY]
    v, counted = sign * x[Ix.SPEED], 1.0 + x[Ix.SCALE_A + wheel]
    h[Ix.PATH_A + wheel], h[Ix.WHEEL_DELAY] = 1.0, -v * counted
    h[Ix.SPEED], h[Ix.SCALE_A + wheel] = -sign * delay * counted, -v * delay


@compiled
def take(
    memory: Array, situation: Array, wheel: int, way: float, variance: float, gate: float
) -> None:
    """Take a path, and count from here on; see `WheelPath`."""
    f, s = memory.view(MEMORY)[0], situation.view(SITUATION)[0]
    f.y[0] = way - expected(f.x, s, wheel)
    jacobian(f.x, s, wheel, f.H[0])
    update_row(f, 0, _LEFT if wheel == LEFT else _RIGHT, variance, gate)
    f.x[Ix.PATH_A + wheel] -= way


class WheelPath(NamedTuple):
    """A wheel's path since its last reading."""

    wheel: int
    """`LEFT` or `RIGHT`."""
    path_m: float
    variance_m2: float
    gate: float = SCALAR_GATE

    @property
    def verdicts(self) -> int:
        return EVERY

    @property
    def names(self) -> tuple[str, ...]:
        return _NAMES[self.wheel]

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        # What comes a hundred times a second is called without an asterisk.
        take(memory, situation, self.wheel, self.path_m, self.variance_m2, self.gate)


@compiled
def begin(memory: Array, situation: Array, wheel: int, variance: float) -> None:
    """Count a wheel's path from here on, whatever came before: a slip, a pause, a new counter.

    What the wheel has gone and its late counter does not show yet, belongs to it.
    """
    f, sign = memory.view(MEMORY)[0], situation.view(SITUATION)[0].wheel_sign[wheel]
    x, P, slot = f.x, f.P, Ix.PATH_A + wheel
    v, delay = x[Ix.SPEED], x[Ix.WHEEL_DELAY]
    make_anew(P, slot, 0.0)
    x[slot] = sign * v * delay * (1.0 + x[Ix.SCALE_A + wheel])
    P[slot, slot] = (
        variance + v * v * P[Ix.WHEEL_DELAY, Ix.WHEEL_DELAY] + delay**2 * P[Ix.SPEED, Ix.SPEED]
    )


@compiled
def shown(memory: Array, situation: Array, wheel: int) -> float:
    """Give h(x) of a wheel, m."""
    return expected(memory.view(MEMORY)[0].x, situation.view(SITUATION)[0], wheel)
