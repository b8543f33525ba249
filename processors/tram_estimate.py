"""What the model `tram` says: an `Estimate` out of its memory, with or without a heading."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from tramstream.kernels import Array
from tramstream.localisation import HEADING_UNKNOWN, Estimate, Verdict
from tramstream.processors import tram_frames as frames
from tramstream.processors import tram_kernels as kernels
from tramstream.processors.tram_states import Ix

NO_HEADING_STD_RAD = math.pi / math.sqrt(3.0)
"""Of an angle that may be any."""


def estimate_of(
    m: Array, share: float, stamp_ns: int, mode: int, standing: bool, verdicts: list[Verdict]
) -> Estimate:
    """Give the motion of the vehicle's origin out of the filter's memory; see `origin`."""
    motion, covariance = np.empty(7), np.empty((7, 7))
    known = mode != HEADING_UNKNOWN
    frames.origin(m, share if known else 0.0, motion, covariance)
    accel, rate = m[kernels.ACCELERATION : kernels.YAW_RATE + 1].tolist()
    return Estimate(stamp_ns, mode, motion, covariance, accel, rate, standing, verdicts)


def without_heading(estimate: Estimate, lever_m: float = 0.0) -> Estimate:
    """Say of a vehicle that its heading is not known, and so not where it is about its antenna."""
    motion, covariance = estimate.motion.copy(), estimate.covariance.copy()
    covariance[:2, :2] += np.eye(2) * lever_m**2
    motion[Ix.YAW] = 0.0
    covariance[Ix.YAW, :] = covariance[:, Ix.YAW] = 0.0
    covariance[Ix.YAW, Ix.YAW] = NO_HEADING_STD_RAD**2
    return replace(
        estimate, motion=motion, covariance=covariance, yaw_rate_radps=0.0, acceleration_mps2=0.0
    )


def at_fix(
    estimate: Estimate,
    p_l: tuple[float, float, float],
    std_m: float,
    speed_mps: float,
    age_s: float,
) -> Estimate:
    """Say of a vehicle that moves, with its heading unknown: where the last fix was."""
    moved = without_heading(estimate)
    covariance = moved.covariance
    moved.motion[:4] = (*p_l, speed_mps)
    covariance[:4, :] = covariance[:, :4] = 0.0
    variance = std_m**2 + (speed_mps * age_s) ** 2
    covariance[:4, :4] = np.diag([variance, variance, variance, max(1.0, speed_mps) ** 2])
    return moved


def plain(estimate: Estimate) -> dict[str, Any]:
    """Fields of an estimate as plain data, without the verdicts that led to it."""
    fields = {each: getattr(estimate, each) for each in Estimate.__slots__ if each != "verdicts"}
    fields["mode"] = int(estimate.mode)
    fields["motion"], fields["covariance"] = estimate.motion.copy(), estimate.covariance.copy()
    return fields
