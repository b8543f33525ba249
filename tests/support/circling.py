"""A tram on a circle, in closed form: truth, states with errors put in, fixes."""

from __future__ import annotations

import numpy as np

from tramstream.clock import S
from tramstream.estimation.series import (
    FixSeries,
    Innovations,
    Slot,
    StateSeries,
    TruthSeries,
    wrapped_rad,
)
from tramstream.proto.estimate_pb2 import MotionState

START_NS = 1_790_000_000 * S
RADIUS_M, SPEED_MPS = 50.0, 10.0
NO_INNOVATIONS = Innovations(*(np.empty(0, dtype=np.int64), (), *[np.empty(0)] * 4))


def stamps(time_s: np.ndarray) -> np.ndarray:
    return START_NS + np.round(np.asarray(time_s) * S).astype(np.int64)


def motion(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and yaw, yaw within ±π."""
    angle = SPEED_MPS / RADIUS_M * np.asarray(time_s)
    p_l = RADIUS_M * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=1)
    return p_l, wrapped_rad(angle)


def truth(time_s: np.ndarray, std_m: float = np.nan) -> TruthSeries:
    p_l, yaw = motion(time_s)
    attitude = np.zeros((len(yaw), 3))
    attitude[:, 2] = yaw
    return TruthSeries(
        stamps(time_s),
        p_l,
        np.full(len(yaw), SPEED_MPS),
        attitude,
        np.full(len(yaw), std_m),
        np.zeros(len(yaw)),
    )


def along_across(yaw: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """East, north, up of components along and across."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.stack([cosine * along - sine * across, sine * along + cosine * across, 0 * yaw], 1)


def states(
    time_s: np.ndarray,
    p_l: np.ndarray | float = 0.0,
    speed_mps: np.ndarray | float = 0.0,
    yaw_rad: np.ndarray | float = 0.0,
    covariance: np.ndarray | None = None,
    mode: int = MotionState.TRACKING,
) -> StateSeries:
    """States that are off by what is given."""
    position, yaw = motion(time_s)
    n = len(yaw)
    attitude = np.zeros((n, 3))
    attitude[:, 2] = wrapped_rad(yaw + yaw_rad)
    if covariance is None:
        covariance = np.eye(len(Slot))
    return StateSeries(
        stamp_ns=stamps(time_s),
        geodetic=np.zeros((n, 3)),
        p_l=position + p_l,
        speed_mps=np.full(n, SPEED_MPS) + speed_mps,
        acceleration_mps2=np.zeros(n),
        attitude_rad=attitude,
        yaw_rate_radps=np.full(n, SPEED_MPS / RADIUS_M),
        covariance=np.broadcast_to(covariance, (n, len(Slot), len(Slot))).copy(),
        mode=np.full(n, mode, dtype=np.int64),
        standing=np.zeros(n, dtype=bool),
        protection_m=np.full((n, 2), np.nan),
        innovations=NO_INNOVATIONS,
    )


def fixes(time_s: np.ndarray, p_l: np.ndarray | float = 0.0) -> FixSeries:
    position, yaw = motion(time_s)
    n = len(yaw)
    return FixSeries(
        stamps(time_s), np.ones(n, dtype=bool), position + p_l, np.full(n, SPEED_MPS), yaw
    )
