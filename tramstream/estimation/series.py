"""A ride as columns: what a filter said, what is true, what the receiver gave; interpolation.

A series is sorted by stamp without repetitions. NaN is what is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.clock import S
from tramstream.proto.estimate_pb2 import MotionState

Array = NDArray[np.float64]
Instants = NDArray[np.int64]
Flags = NDArray[np.bool_]
Rows = TypeVar("Rows", bound="Table")

MAX_GAP_S = 0.5
"""Longest interval that is interpolated. A tram that changes its acceleration by 1 m/s² in it is
off a cubic by 2 mm, off a straight line by 3 cm."""


class Slot(IntEnum):
    """Rows of `MotionState.covariance`."""

    EAST = 0
    NORTH = 1
    UP = 2
    SPEED = 3
    ROLL = 4
    PITCH = 5
    YAW = 6


class Table:
    """A dataclass of arrays with one row an instant; anything else belongs to the whole."""

    stamp_ns: Instants

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def take(self: Rows, which: NDArray[Any]) -> Rows:
        """The rows that a mask or indices choose."""
        arrays: dict[str, Any] = {
            each.name: value[which]
            for each in fields(self)  # type: ignore[arg-type]
            if isinstance(value := getattr(self, each.name), np.ndarray)
        }
        changed: Rows = replace(self, **arrays)  # type: ignore[type-var]
        return changed


@dataclass(frozen=True)
class Innovations:
    """Scalar measurements of all states, in order of processing."""

    stamp_ns: Instants
    names: tuple[str, ...]
    """What `which` counts."""
    which: NDArray[np.int64]
    value: Array
    variance: Array
    accepted: Flags


@dataclass(frozen=True)
class StateSeries(Table):
    """What a filter said: MotionState as columns."""

    stamp_ns: Instants
    geodetic: Array
    """(n, 3): latitude, longitude, ellipsoidal height; rad, rad, m."""
    p_l: Array
    """(n, 3), m."""
    speed_mps: Array
    acceleration_mps2: Array
    attitude_rad: Array
    """(n, 3): roll, pitch, yaw."""
    yaw_rate_radps: Array
    covariance: Array
    """(n, 7, 7) in the order of `Slot`; NaN where the message has none."""
    mode: NDArray[np.int64]
    standing: Flags
    protection_m: Array
    """(n, 2): along, across; NaN where the message has none."""
    innovations: Innovations

    @property
    def yaw_rad(self) -> Array:
        yaw: Array = self.attitude_rad[:, 2]
        return yaw

    @property
    def heading_known(self) -> Flags:
        known: Flags = (self.mode == MotionState.TRACKING) | (
            self.mode == MotionState.DEAD_RECKONING
        )
        return known


@dataclass(frozen=True)
class TruthSeries(Table):
    """The truth; NaN where it does not know."""

    stamp_ns: Instants
    p_l: Array
    """(n, 3), m; of the vehicle's origin."""
    speed_mps: Array
    attitude_rad: Array
    """(n, 3): roll, pitch, yaw."""
    position_std_m: Array
    """Horizontal, per axis; NaN is exact."""
    grade_rad: Array
    """Slope of the track under the origin along x of the vehicle, uphill positive."""

    @property
    def yaw_rad(self) -> Array:
        yaw: Array = self.attitude_rad[:, 2]
        return yaw

    @property
    def body_pitch_rad(self) -> Array:
        """Pitch of the body against the track, nose down positive: what its springs do."""
        pitch: Array = self.attitude_rad[:, 1] + self.grade_rad
        return pitch


@dataclass(frozen=True)
class GradeSeries(Table):
    """What a grade estimator said: the track's slope, and how the body is turned against it."""

    stamp_ns: Instants
    grade_rad: Array
    """Uphill positive along x of the vehicle."""
    grade_std_rad: Array
    body_pitch_rad: Array
    """Nose down positive."""
    body_pitch_std_rad: Array


@dataclass(frozen=True)
class FixSeries(Table):
    """GNSS fixes, valid or not, as the receiver gave them."""

    stamp_ns: Instants
    valid: Flags
    p_l: Array
    """(n, 3), m; of the antenna."""
    speed_mps: Array
    """Over ground, never negative."""
    course_yaw_rad: Array
    """Course of motion as a yaw: counter-clockwise from east."""


class Motion(NamedTuple):
    """What can be interpolated."""

    stamp_ns: Instants
    p_l: Array
    speed_mps: Array
    attitude_rad: Array


def wrapped_rad(angle_rad: ArrayLike) -> Array:
    """Angles brought into [-π, π)."""
    wrapped: Array = np.remainder(np.asarray(angle_rad) + np.pi, 2 * np.pi) - np.pi
    return wrapped


# Interpolation ------------------------------------------------------------------------------------
def interpolate_truth(
    truth: TruthSeries, stamp_ns: Instants, straight: bool = False
) -> TruthSeries:
    """Bring the truth to `stamp_ns`; rows of NaN where it is not known.

    Position is a cubic Hermite whose ends have the direction and size of the true speed along the
    true yaw (no side slip); speed and angles are linear. An interval longer than `MAX_GAP_S`, or
    without speed or yaw at an end, gives nothing but its ends. Nothing is extrapolated.

    Parameters
    ----------
    truth : TruthSeries
    stamp_ns : ndarray, shape (n,)
    straight : bool
        Use straight lines where speed or yaw is not known: good for what is metres off.
    """
    motion = interpolated(Motion(*_motion_of(truth)), stamp_ns, straight)
    left, right = bracket(truth.stamp_ns, stamp_ns)
    std = np.fmax(truth.position_std_m[left], truth.position_std_m[right])
    std[~np.isfinite(motion.p_l[:, 0])] = np.nan
    grade = linear(truth.stamp_ns, truth.grade_rad, stamp_ns)
    return TruthSeries(*motion, position_std_m=std, grade_rad=grade)


def linear(grid_ns: Instants, values: Array, stamp_ns: Instants) -> Array:
    """Bring one column to `stamp_ns` along straight lines; NaN as in `interpolate_truth`."""
    at = _between(grid_ns, stamp_ns)
    between = values[at.left] + at.u * (values[at.right] - values[at.left])
    here = np.where(at.exact, values[at.left], between)
    found: Array = np.where(at.known, here, np.nan)
    return found


def is_dense(truth: TruthSeries) -> bool:
    """Whether the truth is to be interpolated, and not the estimate.

    True where at least half of its intervals are no longer than `MAX_GAP_S` and know speed and yaw
    at both ends.
    """
    known = np.isfinite(truth.speed_mps) & np.isfinite(truth.yaw_rad)
    usable = known[1:] & known[:-1] & (np.diff(truth.stamp_ns) <= MAX_GAP_S * S)
    return len(usable) > 0 and 2 * int(usable.sum()) >= len(usable)


def _motion_of(series: TruthSeries | StateSeries) -> Motion:
    return Motion(series.stamp_ns, series.p_l, series.speed_mps, series.attitude_rad)


class _Between(NamedTuple):
    """Where stamps lie in a series; the arrays have a row a stamp."""

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    step_s: Array
    """Between left and right; 1 where they are the same."""
    u: Array
    """Share of the step that is over."""
    exact: Flags
    """The stamp is one of the series' own."""
    known: Flags
    """Exact, or in an interval short enough."""


def bracket(grid_ns: Instants, stamp_ns: Instants) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Grid points at or before, and at or after, each stamp; the ends outside the grid."""
    last = len(grid_ns) - 1
    left = np.clip(np.searchsorted(grid_ns, stamp_ns, "right") - 1, 0, last)
    return left, np.minimum(left + (grid_ns[left] < stamp_ns), last)


def nearest(grid_ns: Instants, stamp_ns: Instants) -> NDArray[np.intp]:
    """The grid point next to each stamp."""
    left, right = bracket(grid_ns, stamp_ns)
    return np.where(grid_ns[right] - stamp_ns < stamp_ns - grid_ns[left], right, left)


def _between(grid_ns: Instants, stamp_ns: Instants) -> _Between:
    left, right = bracket(grid_ns, stamp_ns)
    gap_ns = grid_ns[right] - grid_ns[left]
    exact = stamp_ns == grid_ns[left]
    inside = (stamp_ns >= grid_ns[left]) & (stamp_ns <= grid_ns[right])
    step_s = np.where(gap_ns > 0, gap_ns, S) / S
    u = (stamp_ns - grid_ns[left]) / S / step_s
    known = exact | (inside & (gap_ns <= MAX_GAP_S * S))
    return _Between(left, right, step_s, u, exact, known)


def interpolated(motion: Motion, stamp_ns: Instants, straight: bool) -> Motion:
    """See `interpolate_truth`."""
    at = _between(motion.stamp_ns, stamp_ns)

    def mixed(values: Array, change: Array) -> Array:
        """From the left end on; the end itself where the stamp is its own."""
        row = (-1, *[1] * (values.ndim - 1))
        between = values[at.left] + at.u.reshape(row) * change
        here = np.where(at.exact.reshape(row), values[at.left], between)
        found: Array = np.where(at.known.reshape(row), here, np.nan)
        return found

    def linear(values: Array) -> Array:
        return mixed(values, values[at.right] - values[at.left])

    turn = wrapped_rad(motion.attitude_rad[at.right] - motion.attitude_rad[at.left])
    return Motion(
        stamp_ns,
        linear(motion.p_l) + _bend(motion, at, straight),
        linear(motion.speed_mps),
        wrapped_rad(mixed(motion.attitude_rad, turn)),
    )


def _bend(motion: Motion, at: _Between, straight: bool) -> Array:
    """What a cubic Hermite adds to the straight line between its ends, (n, 3).

    NaN where a tangent is not known, unless `straight`. The height is straight without pitch.
    """
    _, pitch, yaw = motion.attitude_rad.T
    level = motion.speed_mps * np.cos(np.nan_to_num(pitch))
    vel_l = np.stack(
        [level * np.cos(yaw), level * np.sin(yaw), -motion.speed_mps * np.sin(pitch)], axis=1
    )
    slope = (motion.p_l[at.right] - motion.p_l[at.left]) / at.step_s[:, None]
    rise, fall = at.u * (1 - at.u) ** 2, at.u**2 * (at.u - 1)
    bend: Array = at.step_s[:, None] * (
        rise[:, None] * (vel_l[at.left] - slope) + fall[:, None] * (vel_l[at.right] - slope)
    )
    bend[:, 2] = np.nan_to_num(bend[:, 2])
    bend[at.exact] = 0.0
    if straight:
        bend[~np.isfinite(bend).all(axis=1)] = 0.0
    return bend
