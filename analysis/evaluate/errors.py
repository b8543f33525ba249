"""Errors of an estimate against the truth: series in, errors and their statistics out.

Truth and estimate seldom share their stamps. Which of them is interpolated follows from how dense
the truth is (`series.is_dense`): where at least half of its intervals can be interpolated well, the
truth is brought to the estimate's stamps, otherwise the estimate to the truth's. Nothing is
extrapolated or carried over a gap longer than `series.MAX_GAP_S`; what has no counterpart is left
out and counted.

Error is estimate minus truth. Along and across are the components of the horizontal error along x
and y (left) of the vehicle, turned by the true yaw, or the estimate's where the truth has none.
States of mode STARTING are not judged; those of HEADING_UNKNOWN by their position alone.

NaN is what is not known, as in `tramstream.estimation.series`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.estimation.series import (
    Array,
    FixSeries,
    Instants,
    Motion,
    Slot,
    StateSeries,
    Table,
    TruthSeries,
    interpolate_truth,
    interpolated,
    is_dense,
    nearest,
    wrapped_rad,
)
from tramstream.proto.estimate_pb2 import MotionState

COURSE_SPEED_MPS = 1.0
"""Below this a receiver's course is noise and not judged as a heading."""


@dataclass(frozen=True)
class MotionErrors(Table):
    """Estimate minus truth; one row an instant that both know."""

    stamp_ns: Instants
    p_l: Array
    """(n, 3): east, north, up, m."""
    along_m: Array
    across_m: Array
    horizontal_m: Array
    speed_mps: Array
    attitude_rad: Array
    """(n, 3): roll, pitch, yaw, each within ±π."""

    @property
    def up_m(self) -> Array:
        up: Array = self.p_l[:, 2]
        return up

    @property
    def yaw_rad(self) -> Array:
        yaw: Array = self.attitude_rad[:, 2]
        return yaw


@dataclass(frozen=True)
class Errors(MotionErrors):
    """Errors of an estimate beside what it said of them."""

    covariance: Array
    """(n, 7, 7) in the order of `Slot`, the truth's own variance added."""
    protection_m: Array
    """(n, 2): along, across."""
    mode: NDArray[np.int64]
    truth: TruthSeries
    """At the same stamps."""
    at_truth: bool
    """Whether the estimate was brought to the truth's stamps."""
    left_out: dict[str, int]
    """`without_truth`, `starting`: not judged. `heading_unknown`: speed and heading not judged."""

    def take(self, which: NDArray[Any]) -> Errors:
        return replace(super().take(which), truth=self.truth.take(which))


@dataclass(frozen=True)
class Statistics:
    """Figures of one kind of error; percentiles and maximum are of its absolute value."""

    count: int
    mean: float
    std: float
    """About the mean, divisor n: rms² = mean² + std²."""
    rms: float
    p50: float
    p90: float
    p95: float
    p99: float
    max: float
    max_at_s: float


# Errors -------------------------------------------------------------------------------------------
def errors(states: StateSeries, truth: TruthSeries) -> Errors:
    """Subtract the truth from the estimate, see the top of the module."""
    at_truth = not is_dense(truth)
    if at_truth:
        truth_at, states = truth, _states_at(states, truth.stamp_ns)
        known = np.isfinite(states.p_l[:, 0])
    else:
        truth_at = interpolate_truth(truth, states.stamp_ns)
        known = np.isfinite(truth_at.p_l[:, 0])
    judged = known & (states.mode != MotionState.STARTING)
    left_out = {
        "without_truth": int((~known).sum()),
        "starting": int((known & ~judged).sum()),
        "heading_unknown": int((judged & ~states.heading_known).sum()),
    }
    if not judged.all():
        states, truth_at = states.take(judged), truth_at.take(judged)
    heading = states.heading_known
    yaw = np.where(heading, states.yaw_rad, np.nan)
    speed = np.where(heading, states.speed_mps - truth_at.speed_mps, np.nan)
    turn = wrapped_rad(states.attitude_rad - truth_at.attitude_rad)
    motion = _resolved(
        states.stamp_ns,
        states.p_l - truth_at.p_l,
        speed,
        np.where(heading[:, None], turn, np.nan),
        np.where(np.isfinite(truth_at.yaw_rad), truth_at.yaw_rad, yaw),
    )
    return Errors(
        **{each.name: getattr(motion, each.name) for each in fields(motion)},
        covariance=_with_truth_variance(states.covariance, truth_at.position_std_m),
        protection_m=states.protection_m,
        mode=states.mode,
        truth=truth_at,
        at_truth=at_truth,
        left_out=left_out,
    )


def fix_errors(fixes: FixSeries, truth: TruthSeries, lever_arm_v: ArrayLike) -> MotionErrors:
    """Subtract the truth at the antenna from the valid fixes, at their epochs.

    The course stands for the yaw where the true speed is `COURSE_SPEED_MPS` or more. The speed is
    held to that of the vehicle's origin: what turning adds to the antenna's stays in the error.

    Parameters
    ----------
    fixes : FixSeries
    truth : TruthSeries
    lever_arm_v : array_like, shape (3,)
        Antenna from the vehicle's origin, p_va_v, m. Where it is not 0, fixes at which the true yaw
        is not known are left out; unknown roll and pitch count as 0.
    """
    fixes = fixes.take(fixes.valid)
    truth = interpolate_truth(truth, fixes.stamp_ns, straight=True)
    p_l = truth.p_l
    if np.any(lever_arm_v):
        roll, pitch, yaw = truth.attitude_rad.T
        turn = C_vl(np.nan_to_num(roll), np.nan_to_num(pitch), yaw)
        p_l = p_l + np.einsum("nij,i->nj", turn, np.asarray(lever_arm_v, dtype=float))
    known = np.isfinite(p_l[:, 0])
    fixes, truth, p_l = fixes.take(known), truth.take(known), p_l[known]
    backwards = np.where(truth.speed_mps < 0, np.pi, 0.0)
    turn = np.full((len(fixes), 3), np.nan)
    turn[:, 2] = wrapped_rad(fixes.course_yaw_rad + backwards - truth.yaw_rad)
    turn[~(np.abs(truth.speed_mps) >= COURSE_SPEED_MPS)] = np.nan
    return _resolved(
        fixes.stamp_ns,
        fixes.p_l - p_l,
        fixes.speed_mps - np.abs(truth.speed_mps),
        turn,
        np.where(np.isfinite(truth.yaw_rad), truth.yaw_rad, fixes.course_yaw_rad),
    )


def _resolved(
    stamp_ns: Instants, p_l: Array, speed_mps: Array, attitude_rad: Array, yaw_rad: Array
) -> MotionErrors:
    """Errors with their components along and across the direction `yaw_rad`."""
    (east, north, _), cosine, sine = p_l.T, np.cos(yaw_rad), np.sin(yaw_rad)
    return MotionErrors(
        stamp_ns=stamp_ns,
        p_l=p_l,
        along_m=cosine * east + sine * north,
        across_m=cosine * north - sine * east,
        horizontal_m=np.hypot(east, north),
        speed_mps=speed_mps,
        attitude_rad=attitude_rad,
    )


def _states_at(states: StateSeries, stamp_ns: Instants) -> StateSeries:
    """States brought to `stamp_ns`; what is no motion is that of the nearest state."""
    attitude = np.where(states.heading_known[:, None], states.attitude_rad, np.nan)
    motion = Motion(states.stamp_ns, states.p_l, states.speed_mps, attitude)
    return replace(
        states.take(nearest(states.stamp_ns, stamp_ns)),
        **interpolated(motion, stamp_ns, True)._asdict(),
    )


def _with_truth_variance(covariance: Array, std_m: Array) -> Array:
    """Covariance of the difference: the truth's own error is independent of the estimate's."""
    if not np.isfinite(std_m).any():
        return covariance
    total = covariance.copy()
    for slot in (Slot.EAST, Slot.NORTH):
        total[:, slot, slot] += np.nan_to_num(std_m) ** 2
    return total


# Statistics ---------------------------------------------------------------------------------------
def statistics(error: Array, stamp_ns: Instants, origin_ns: int) -> Statistics | None:
    """Figures of `error` without its NaN, None if nothing is left; times count from `origin_ns`."""
    known = np.isfinite(error)
    if not known.any():
        return None
    error, stamp_ns = error[known], stamp_ns[known]
    size = np.abs(error)
    worst = int(size.argmax())
    p50, p90, p95, p99 = np.percentile(size, (50, 90, 95, 99)).tolist()
    return Statistics(
        count=len(error),
        mean=float(error.mean()),
        std=float(error.std()),
        rms=float(np.sqrt(np.mean(error**2))),
        p50=p50,
        p90=p90,
        p95=p95,
        p99=p99,
        max=float(size[worst]),
        max_at_s=int(stamp_ns[worst] - origin_ns) / S,
    )


def summary(errors: MotionErrors, origin_ns: int) -> dict[str, Statistics | None]:
    """Statistics by quantity: along_m, across_m, horizontal_m, up_m, speed_mps, and roll_deg,
    pitch_deg, yaw_deg of the body."""
    columns = {
        "along_m": errors.along_m,
        "across_m": errors.across_m,
        "horizontal_m": errors.horizontal_m,
        "up_m": errors.up_m,
        "speed_mps": errors.speed_mps,
        "roll_deg": np.degrees(errors.attitude_rad[:, 0]),
        "pitch_deg": np.degrees(errors.attitude_rad[:, 1]),
        "yaw_deg": np.degrees(errors.yaw_rad),
    }
    return {
        name: statistics(column, errors.stamp_ns, origin_ns) for name, column in columns.items()
    }
