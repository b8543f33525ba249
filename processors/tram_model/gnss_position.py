"""The antenna's place by GNSS, and its height: two measurements of one fix.

    z = p + C_lv p_va + b − v_a τ + n

with the pivot's place p, the lever arm p_va, the error of the fixes b (a part that lasts for some
ten seconds and, horizontally, one that lasts for many minutes), the antenna's velocity v_a, and the
delay τ by which the fix's stamp is too late; n is the white part of the error (docs/theory.md,
section 6.2). East and north are gated together; the height, which jumps more often, has a gate of
its own and is linearised anew behind them.
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
from tramstream.processors.tram_model.update import columns_of, update_pair, update_row

DOUBT_STD_M = 0.3
"""A fix that is off by less than a few of these is never an outlier, however sure the filter is;
chosen by hand."""
_LEVEL = (Ix.GNSS_DELAY, Ix.SPEED, Ix.YAW, Ix.PITCH, Ix.ROLL, Ix.PIVOT)
_EAST = columns_of(Ix.EAST, Ix.GNSS_EAST, Ix.GNSS_SLOW_EAST, *_LEVEL)
_NORTH = columns_of(Ix.NORTH, Ix.GNSS_NORTH, Ix.GNSS_SLOW_NORTH, *_LEVEL)
_UP = columns_of(Ix.UP, Ix.GNSS_UP, Ix.GNSS_DELAY, Ix.SPEED, Ix.PITCH, Ix.ROLL)


@compiled
def expected(x: Array, c: Parameters, s: Situation, yaw_rate: float) -> tuple[float, float]:
    """h(x): east and north of the fix, m."""
    east, north, _, _, _ = antenna(x, c, s)
    ve, vn = antenna_velocity(x, c, s, yaw_rate)
    delay = x[Ix.GNSS_DELAY]
    return (
        x[Ix.EAST] + east + x[Ix.GNSS_EAST] + x[Ix.GNSS_SLOW_EAST] - ve * delay,
        x[Ix.NORTH] + north + x[Ix.GNSS_NORTH] + x[Ix.GNSS_SLOW_NORTH] - vn * delay,
    )


@compiled
def jacobian(x: Array, c: Parameters, s: Situation, yaw_rate: float, H: Array) -> None:
    """Fill rows 0 and 1 of H; how roll and pitch turn the lever is kept to first order."""
    east, north, _, _, _ = antenna(x, c, s)
    _, _, az = lever_arm(x, c, s)
    ve, vn = antenna_velocity(x, c, s, yaw_rate)
    cp, delay = math.cos(x[Ix.PITCH]), x[Ix.GNSS_DELAY]
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    along = cp if s.heading_known else 0.0
    h = H[0]
    h[Ix.EAST], h[Ix.GNSS_EAST], h[Ix.GNSS_SLOW_EAST], h[Ix.GNSS_DELAY] = 1.0, 1.0, 1.0, -ve
    h[Ix.SPEED], h[Ix.YAW] = -cy * cp * delay, -north + vn * delay
    h[Ix.PITCH], h[Ix.ROLL], h[Ix.PIVOT] = cy * az, sy * az, cy * along
    h = H[1]
    h[Ix.NORTH], h[Ix.GNSS_NORTH], h[Ix.GNSS_SLOW_NORTH], h[Ix.GNSS_DELAY] = 1.0, 1.0, 1.0, -vn
    h[Ix.SPEED], h[Ix.YAW] = -sy * cp * delay, east - ve * delay
    h[Ix.PITCH], h[Ix.ROLL], h[Ix.PIVOT] = sy * az, -cy * az, sy * along


@compiled
def take(
    memory: Array,
    parameters: Array,
    situation: Array,
    east: float,
    north: float,
    variance: float,
    doubt: float,
    gate: float,
    knee: float,
) -> None:
    """Take a fix; see `GnssPosition`."""
    f, c, s = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    h_east, h_north = expected(f.x, c, s, f.yaw_rate)
    jacobian(f.x, c, s, f.yaw_rate, f.H)
    f.y[0], f.y[1] = east - h_east, north - h_north
    update_pair(f, _EAST, _NORTH, variance, doubt, gate, knee)


class GnssPosition(NamedTuple):
    """The antenna's place in `l`."""

    east_m: float
    north_m: float
    variance_m2: float
    """Of the white part, on each axis."""
    doubt_m2: float = DOUBT_STD_M**2
    """What the gate adds to it."""
    gate: float = PAIR_GATE
    knee: float = PAIR_KNEE
    """Squared distance beyond which the fix is weighted down (Huber)."""

    @property
    def names(self) -> tuple[str, ...]:
        return ("gnss_east", "gnss_north")

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take(memory, parameters, situation, *self)


@compiled
def expected_height(x: Array, c: Parameters, s: Situation) -> float:
    """h(x): the antenna's height, m."""
    _, _, up, _, _ = antenna(x, c, s)
    climb = -x[Ix.SPEED] * math.sin(x[Ix.PITCH])
    height: float = x[Ix.UP] + up + x[Ix.GNSS_UP] - climb * x[Ix.GNSS_DELAY]
    return height


@compiled
def jacobian_height(x: Array, c: Parameters, s: Situation, h: Array) -> None:
    """Fill a row of H."""
    _, _, _, along, across = antenna(x, c, s)
    sp, cp, delay = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH]), x[Ix.GNSS_DELAY]
    h[Ix.UP], h[Ix.GNSS_UP], h[Ix.GNSS_DELAY] = 1.0, 1.0, x[Ix.SPEED] * sp
    h[Ix.SPEED], h[Ix.PITCH] = sp * delay, -along + x[Ix.SPEED] * cp * delay
    h[Ix.ROLL] = across


@compiled
def take_height(
    memory: Array,
    parameters: Array,
    situation: Array,
    up: float,
    variance: float,
    gate: float,
) -> None:
    """Take a height; see `GnssHeight`."""
    f, c, s = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    f.y[0] = up - expected_height(f.x, c, s)
    jacobian_height(f.x, c, s, f.H[0])
    update_row(f, 0, _UP, variance, gate)


class GnssHeight(NamedTuple):
    """The antenna's height in `l`."""

    up_m: float
    variance_m2: float
    """Of the white part."""
    gate: float = PAIR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("gnss_up",)

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take_height(memory, parameters, situation, *self)
