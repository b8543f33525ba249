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
    m: Array, share: float, stamp_ns: int, mode: Mode, standing: bool, verdicts: list[Verdict]
) -> Estimate:
    """Give the motion of the vehicle's origin at the true time of `stamp_ns`.

    The filter's own position is the pivot's, at the time that the inertial stamps mean: `share` of
    the fixes' delay is theirs.
    """
    east, north, up, speed, roll, pitch, yaw = m[MOTION].tolist()
    P = m[kernels.COVARIANCE].reshape(SIZE, SIZE)
    covariance = P[MOTION, MOTION].copy()
    pivot, early = float(m[Ix.PIVOT]), float(m[Ix.GNSS_DELAY]) * share
    if mode != Mode.HEADING_UNKNOWN and (pivot != 0.0 or early != 0.0):
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead = pivot - early * speed
        east, north = east + ahead * cos, north + ahead * sin
        T = np.zeros((len(covariance), SIZE))
        T[:, MOTION] = np.eye(len(covariance))
        T[Ix.EAST, Ix.YAW], T[Ix.NORTH, Ix.YAW] = -ahead * sin, ahead * cos
        T[Ix.EAST, Ix.PIVOT], T[Ix.NORTH, Ix.PIVOT] = cos, sin
        T[Ix.EAST, Ix.GNSS_DELAY] = -share * speed * cos
        T[Ix.NORTH, Ix.GNSS_DELAY] = -share * speed * sin
        covariance = T @ P @ T.T
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
        covariance=covariance,
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
