"""What the model `tram` says: an `Estimate` out of its memory, with or without a heading."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tramstream.kernels import Array
from tramstream.localisation import Estimate, Mode, Verdict
from tramstream.processors import tram_kernels as kernels
from tramstream.processors.tram_states import MOTION, SIZE, Ix

NO_HEADING_STD_RAD = math.pi / math.sqrt(3.0)
"""Of an angle that may be any."""


def estimate_of(
    m: Array, stamp_ns: int, mode: Mode, standing: bool, verdicts: list[Verdict]
) -> Estimate:
    east, north, up, speed, roll, pitch, yaw = m[MOTION].tolist()
    P = m[kernels.COVARIANCE].reshape(SIZE, SIZE)
    return Estimate(
        stamp_ns=stamp_ns,
        mode=mode,
        p_l=(east, north, up),
        speed_mps=speed,
        acceleration_mps2=float(m[kernels.ACCELERATION]),
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=math.remainder(yaw, math.tau),
        yaw_rate_radps=float(m[kernels.YAW_RATE]),
        standing=standing,
        covariance=P[MOTION, MOTION].copy(),
        verdicts=verdicts,
    )


def without_heading(estimate: Estimate) -> Estimate:
    """Say of a vehicle that stands that its heading is not known."""
    covariance = estimate.covariance
    covariance[Ix.YAW, :] = covariance[:, Ix.YAW] = 0.0
    covariance[Ix.YAW, Ix.YAW] = NO_HEADING_STD_RAD**2
    return replace(estimate, yaw_rad=0.0, yaw_rate_radps=0.0, acceleration_mps2=0.0)


def at_fix(
    estimate: Estimate,
    p_l: tuple[float, float, float],
    std_m: float,
    speed_mps: float,
    age_s: float,
) -> Estimate:
    """Say of a vehicle that moves, with its heading unknown: where the last fix was."""
    covariance = estimate.covariance
    covariance[:3, :] = covariance[:, :3] = 0.0
    covariance[:3, :3] = np.eye(3) * (std_m**2 + (speed_mps * age_s) ** 2)
    covariance[Ix.SPEED, :] = covariance[:, Ix.SPEED] = 0.0
    covariance[Ix.SPEED, Ix.SPEED] = max(1.0, speed_mps) ** 2
    return replace(without_heading(estimate), p_l=p_l, speed_mps=speed_mps)
