"""Five theses that a right mounting makes true, each with its figure: the verdict's last checks.

After melenovsky2023, section 7.4.1, in our words: its text is not part of this repository. Forces
and rates of the whole ride are turned into vehicle axes and averaged over two seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tramstream.analysis.mounting.coarse import FAST_MPS, Coarse
from tramstream.analysis.mounting.drive import Array, Drive
from tramstream.analysis.mounting.solve import Solution


class Thesis(NamedTuple):
    """One statement about the vehicle, and whether it holds."""

    text: str
    value: float
    """NaN where the ride does not tell."""
    low: float
    high: float
    unit: str

    @property
    def holds(self) -> bool:
        return math.isnan(self.value) or self.low <= self.value <= self.high

    @property
    def asked(self) -> bool:
        return not math.isnan(self.value)


STAND_DEG = 3.0
"""How far a stand may be from level: stops on 5 % of grade are few."""
SLOPE = 0.15
"""How far a slope may be from 1: springs nod and lean by a twentieth."""
LEAST_CURVE = 0.5
"""What cant leaves of a curve's force, at least."""
ACROSS = 0.1
"""Of what braking presses to the side: six degrees of yaw."""
ABOUT = 0.1
"""Of what a curve turns about the other two axes."""
TOLD_MPS2 = 0.1
"""Deviation of acceleration, or of a curve's force, without which a slope tells nothing."""


def theses(drive: Drive, found: Coarse, solution: Solution) -> list[Thesis]:
    """State and measure all five."""
    kin = found.kinematics
    f_v = (kin.f_b - solution.point.accel_bias) @ solution.C_vb.T
    omega_v = (kin.omega_b - solution.point.gyro_bias) @ solution.C_vb.T
    sign = np.where(found.reverse, -1.0, 1.0)
    moving = kin.moving
    a = (sign * kin.acceleration_mps2)[moving]
    curve = (sign * kin.speed_mps * omega_v[:, 2])[moving]
    pressed = _slopes(f_v[moving], np.stack([a, curve], axis=1))
    told = np.array([np.std(a) > TOLD_MPS2, np.std(curve) > TOLD_MPS2]) if len(a) else [False] * 2
    stand = drive.standing
    tilt = math.nan
    if stand.sum() > 50:
        mean = f_v[stand].mean(axis=0)
        tilt = math.degrees(math.atan2(math.hypot(mean[0], mean[1]), mean[2]))
    turning = kin.moving & (kin.speed_mps > FAST_MPS)
    about = math.nan
    if turning.sum() > 50 and float(np.std(omega_v[turning, 2])) > 0.01:
        others = _slopes(omega_v[turning, :2], omega_v[turning, 2:])
        about = float(np.hypot(*others[0]))
    return [
        Thesis("at a stand the force points up", tilt, 0.0, STAND_DEG, "°"),
        Thesis(
            "speeding up presses forwards, once", _if(told[0], pressed[0, 0]),
            1 - SLOPE, 1 + SLOPE, "",
        ),
        Thesis(
            "speeding up presses to no side", _if(told[0], pressed[0, 1]), -ACROSS, ACROSS, ""
        ),
        Thesis(
            "a curve presses to its outside, v·ω_z", _if(told[1], pressed[1, 1]),
            LEAST_CURVE, 1 + SLOPE, "",
        ),
        Thesis("a curve turns about the up axis alone", about, 0.0, ABOUT, ""),
    ]  # fmt: skip


def _if(told: bool, value: float) -> float:
    return float(value) if told else math.nan


def _slopes(values: Array, causes: Array) -> Array:
    """Slopes of values, in columns, against causes, in rows."""
    if len(causes) < 20:
        return np.full((causes.shape[1], values.shape[1]), np.nan)
    A = np.concatenate([causes, np.ones((len(causes), 1))], axis=1)
    found: Array = np.linalg.lstsq(A, values, rcond=None)[0][:-1]
    return found
