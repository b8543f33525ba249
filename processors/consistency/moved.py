"""Has the IMU been moved in its vehicle? Found within seconds, with the instant and the turn.

A case that is turned in the vehicle reads gravity from elsewhere while nothing that it reads of
turning, and nothing that the wheels read of driving, says why. Of twenty seconds of windows, each
half a second long, and an instant m among them, all forces are brought into the axes that the case
had then, by the gyroscopes alone (C_k), and the motion by the wheels is taken off. What is left is
gravity, one vector; a turn δ of the case at m shows as

    C_k (f_k − a_k x − v_k ω_k y) = g + b τ_k + [k ≥ m] δ × C_k f_k

with x and y ahead and to the left in the case, and b what the gyroscopes' bias does in the time τ
that the vehicle moves; at a stand it does not turn, whatever they read. δ is found
by robust least squares for every m as it comes to lie `AFTER` windows back; it is said where
δᵀ Σ⁻¹ δ is largest and beyond `LIMIT`. About the vertical it shows by braking and curves alone.

A case that is turned by hand, its gyroscopes on, feels the turn like one of the vehicle: that shows
only where the vehicle stands meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tramstream.attitude import C_bv_of
from tramstream.config import Imu, Vehicle
from tramstream.estimation.kalman import Array
from tramstream.events.kinds import Event
from tramstream.processors.consistency.events import MOUNT_CHANGED
from tramstream.processors.consistency.mounting import GRAVITY_MPS2, STILL_MPS2, WINDOW_S
from tramstream.processors.consistency.way import Course

BEFORE, AFTER = 24, 12
"""Windows to either side of the instant that is judged: 12 s and 6 s."""
COUNT = BEFORE + AFTER + 2
EVERY = 3
"""Windows between instants that are judged: a second and a half."""
CONFIRMED = 8
"""Windows without a better instant, after which it is said."""
LIMIT = 90.0
"""Of δᵀ Σ⁻¹ δ; set by tests/analysis/test_calibration_study.py (docs/calibration.md)."""
LEAST_DEG = 0.3
FLOOR_MPS2 = 0.02
"""No window is known better: springs, kerbs, what turns about other axes."""
SIZE_MPS2 = 0.4
"""By which gravity may differ before and after: the scales of the axes."""
STOPS_MPS2 = 6.0
"""A window that differs so much from gravity is a blow."""
TURN_STD_RAD = 0.5
"""Beforehand: about the vertical nothing may tell."""
SMALL_RAD = 0.02
LARGE = 4
"""Rounds of Gauss and Newton."""
PASSES = 3
CLIP = 2.0
PAUSE_S = 1.5 * WINDOW_S
STANDING = -1e12
"""Instead of when a bias was learned."""
UNLEARNED_RADPS = 0.01
"""Bias of gyroscopes that have not stood yet."""
BIAS_SHARE = 0.3
"""Of a new still window in the bias."""
BIAS_FLOOR_RADPS = 3e-5


class Change(NamedTuple):
    """The case was turned in the vehicle."""

    time_s: float
    turn_v: tuple[float, float, float]
    """Rotation vector about the vehicle's axes, rad."""
    tilt_std_rad: float
    yaw_std_rad: float
    """About the vertical; where nothing tells, `TURN_STD_RAD`."""
    score: float

    @property
    def tilt_rad(self) -> float:
        return math.hypot(*self.turn_v[:2])

    @property
    def numbers(self) -> tuple[float, ...]:
        """All of it, for a memory."""
        return (self.time_s, *self.turn_v, self.tilt_std_rad, self.yaw_std_rad, self.score)


def origin_of(vehicle: Vehicle) -> str:
    """Who said how the IMU is mounted, for a sentence."""
    known = vehicle.calibrated
    if known is None or not any(each.startswith("imu.mounting") for each in known.fields):
        return "the configuration"
    return f"the calibration of {known.made or 'an unknown day'} ({Path(known.file).name})"


@dataclass
class MovedMemory:
    """What a `Moved` remembers."""

    ends_s: list[float] = field(default_factory=list)
    means: list[list[float]] = field(default_factory=list)
    """Force and rate in the axes of the case, of each window."""
    turned: list[list[float]] = field(default_factory=list)
    """From the axes of the case in each window to those in the first of all, row by row."""
    bias: list[float] = field(default_factory=list)
    """Of the gyroscopes, at stands."""
    bias_s: float = -1e9
    biases: list[float] = field(default_factory=list)
    """When the bias was learned that each window was turned on with; below 0 for one at a stand."""
    last_mps2: list[float] = field(default_factory=list)
    best: list[float] = field(default_factory=list)
    """Time, turn, deviations and score of the best instant so far."""
    waited: int = 0
    unjudged: int = 0
    found: list[float] = field(default_factory=list)
    """The last change that was said, as `Change.numbers`; it holds until somebody calibrates."""


class Moved:
    """Takes windows; says when the case has been turned."""

    def __init__(self, imu: Imu, memory: MovedMemory) -> None:
        self.memory = memory
        self._C_bv: Array = C_bv_of(imu)
        self._lever_m = imu.lever_arm_m
        self._walk = imu.gyro_walk_radps2_rthz

    def take(self, end_s: float, mean: list[float], still: bool, path: Course) -> Change | None:
        """Take a window, and the way of the wheels up to it; gives what has been found."""
        memory = self.memory
        if memory.ends_s and not 0.0 < end_s - memory.ends_s[-1] < PAUSE_S:
            self.forget()
        self._learn_bias(end_s, mean, still)
        self._turn_on(mean, still)
        memory.ends_s.append(end_s)
        memory.means.append(mean)
        # The way is known a little later than the force: the newest window waits.
        if len(memory.ends_s) < COUNT:
            return None
        for kept in (memory.ends_s, memory.means, memory.turned, memory.biases):
            del kept[:-COUNT]
        memory.waited += 1
        memory.unjudged += 1
        if memory.unjudged >= EVERY:
            memory.unjudged = 0
            self._judge(path)
        return self._said()

    def told(self, now_s: float, origin: str) -> list[Event]:
        """What there is to say of the last change, as long as its mounting is used on."""
        if not self.memory.found:
            return []
        time_s, x, y, z, tilt_std, yaw_std, _ = self.memory.found
        return [
            MOUNT_CHANGED(
                ago_s=now_s - time_s,
                tilt_deg=math.degrees(math.hypot(x, y)),
                tilt_std_deg=math.degrees(tilt_std),
                turned_deg=math.degrees(z),
                turned_std_deg=math.degrees(yaw_std),
                origin=origin,
            )
        ]

    def forget(self) -> None:
        """Begin anew: what comes does not follow."""
        memory = self.memory
        memory.ends_s, memory.means, memory.turned = [], [], []
        memory.biases, memory.best, memory.waited = [], [], 0

    def _turn_on(self, mean: list[float], still: bool) -> None:
        """Add up what the gyroscopes turn from the middle of a window to that of the next."""
        memory = self.memory
        memory.biases.append(STANDING if still else memory.bias_s)
        if not memory.means:
            memory.turned.append(np.eye(3).ravel().tolist())
        elif still:
            memory.turned.append(memory.turned[-1])
        else:
            before = np.array(memory.turned[-1]).reshape(3, 3)
            rate = 0.5 * (np.array(memory.means[-1][3:]) + np.array(mean[3:])) - self._bias()
            memory.turned.append((before @ _exponential(rate * WINDOW_S)).ravel().tolist())

    def _bias(self) -> Array:
        return np.array(self.memory.bias) if self.memory.bias else np.zeros(3)

    def _learn_bias(self, end_s: float, mean: list[float], still: bool) -> None:
        memory = self.memory
        near = memory.last_mps2 and math.dist(mean[:3], memory.last_mps2) < STILL_MPS2
        memory.last_mps2 = mean[:3]
        if not (still and near):
            return
        if end_s - memory.bias_s > 60.0 or not memory.bias:
            memory.bias = mean[3:]
        else:
            memory.bias = [
                old + BIAS_SHARE * (new - old)
                for old, new in zip(memory.bias, mean[3:], strict=True)
            ]
        memory.bias_s = end_s

    def _judge(self, path: Course) -> None:
        memory = self.memory
        ends = np.array(memory.ends_s)
        edges = np.concatenate([[ends[0] - WINDOW_S], ends[:-1]])
        half = 0.5 * WINDOW_S
        v = (path.held(edges + half) - path.held(edges - half)) / WINDOW_S
        values = np.array(memory.means)[:-1]
        a, speed = np.diff(v) / WINDOW_S, 0.5 * (v[1:] + v[:-1])
        turned = np.array(memory.turned)[:-1].reshape(-1, 3, 3)
        C = turned[BEFORE].T @ turned
        motion = self._motion(values, a, speed)
        found = self._turn(values[:, :3], C, motion, float(ends[-1]))
        if found is None:
            return
        if found[-1] > max(LIMIT, memory.best[-1] if memory.best else 0.0):
            at_s = float(ends[BEFORE] - WINDOW_S)
            memory.best, memory.waited = [at_s, *found], 0

    def _said(self) -> Change | None:
        memory = self.memory
        if not memory.best or memory.waited < CONFIRMED:
            return None
        time_s, x, y, z, tilt_std, yaw_std, score = memory.best
        self.forget()
        return Change(time_s, (x, y, z), tilt_std, yaw_std, score)

    def _motion(self, values: Array, a: Array, speed: Array) -> Array:
        """What of the forces is the vehicle's motion by its wheels, in the axes of the case."""
        ahead, left = self._axes(values[:BEFORE, :3])
        turning = (values[:, 3:] - self._bias()) @ np.cross(ahead, left)
        x, y, _ = self._lever_m
        change = np.gradient(turning, WINDOW_S)
        along = a - turning**2 * x - change * y
        across = speed * turning - turning**2 * y + change * x
        made: Array = along[:, None] * ahead + across[:, None] * left
        return made

    def _turn(self, force: Array, C: Array, motion: Array, now_s: float) -> list[float] | None:
        """Turn about the vehicle's axes, deviations of tilt and yaw, score; None without one."""
        drift, prior = self._drift(now_s)
        R = np.eye(3)
        P = np.eye(3)
        for _ in range(LARGE):  # a large turn is not linear
            q = np.einsum("kij,kj->ki", C, force)
            pushed = np.einsum("kij,kj->ki", C, motion)
            q[BEFORE:] = q[BEFORE:] @ R
            pushed[BEFORE:] = np.einsum("kij,kj->ki", R.T @ C[BEFORE:] @ R, motion[BEFORE:])
            size = np.linalg.norm(q - pushed, axis=1)
            if np.any(np.abs(size - GRAVITY_MPS2) > STOPS_MPS2) or _scaled(size):
                return None
            x, P = _fitted(q - pushed, q, drift, prior, _vector(R))
            delta = x[-3:]
            R = R @ _exponential(delta)
            if float(np.linalg.norm(delta)) < SMALL_RAD:
                break
        delta = _vector(R)
        score = float(delta @ np.linalg.solve(P, delta))
        if math.degrees(float(np.linalg.norm(delta))) < LEAST_DEG:
            return None
        turn = self._C_bv.T @ delta
        P_v = np.diagonal(self._C_bv.T @ P @ self._C_bv)
        tilt_std, yaw_std = math.sqrt(0.5 * (P_v[0] + P_v[1])), math.sqrt(P_v[2])
        return [*turn.tolist(), tilt_std, yaw_std, score]

    def _drift(self, now_s: float) -> tuple[Array, Array]:
        """Windows in motion so far, by the older bias and by the newer, and what is known of all.

        Returns
        -------
        drift : ndarray, shape (n, 2)
        prior : ndarray, shape (12,)
            Of gravity, two drifts and the turn: one over the variance.
        """
        when = np.array(self.memory.biases[:-1])
        moving = when > 0.5 * STANDING
        old = when[moving].min() if moving.any() else STANDING
        first, second = moving & (when == old), moving & (when != old)
        drift = np.cumsum(np.stack([first, second], axis=1), axis=0)
        prior = np.zeros(12)
        for k, learned_s in enumerate((old, self.memory.bias_s)):
            age_s = now_s - learned_s
            std = self._walk * math.sqrt(max(age_s, 1.0)) if age_s < 1e6 else UNLEARNED_RADPS
            std = math.hypot(min(std, UNLEARNED_RADPS), BIAS_FLOOR_RADPS)
            prior[3 + 3 * k : 6 + 3 * k] = (GRAVITY_MPS2 * WINDOW_S * std) ** -2.0
        prior[9:] = TURN_STD_RAD**-2.0
        return drift - drift[BEFORE], prior

    def _axes(self, force: Array) -> tuple[Array, Array]:
        """Ahead and left in the case: as mounted, made level by the mean force."""
        up = force.mean(axis=0)
        up /= max(float(np.linalg.norm(up)), 1e-9)
        ahead = self._C_bv[:, 0] - up * float(up @ self._C_bv[:, 0])
        ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
        return ahead, np.cross(up, ahead)


def _fitted(y: Array, q: Array, drift: Array, prior: Array, turned: Array) -> tuple[Array, Array]:
    """Gravity, its drift and how much further than `turned`, by robust least squares.

    Returns
    -------
    x, P : ndarray, shapes (12,) and (3, 3)
        The turn comes last; P is of it alone.
    """
    count = len(y)
    A = np.zeros((count, 3, 12))
    A[:, range(3), range(3)] = 1.0
    A[:, range(3), range(3, 6)] = drift[:, :1]
    A[:, range(3), range(6, 9)] = drift[:, 1:]
    A[BEFORE:, :, 9:] = -_cross(q[BEFORE:])  # δ × q = −[q]× δ
    rows, z = A.reshape(-1, 12), y.reshape(-1)
    known = prior * np.concatenate([np.zeros(9), turned])
    weight, spread = np.ones(count), FLOOR_MPS2
    for _ in range(PASSES):
        W = rows * np.repeat(weight / spread**2, 3)[:, None]
        N = rows.T @ W + np.diag(prior)
        x = np.linalg.solve(N, W.T @ z - known)
        off = np.sqrt(((y - A @ x) ** 2).sum(axis=1))
        spread = max(float(np.median(off)) / 1.538, FLOOR_MPS2)
        weight = np.minimum(1.0, CLIP * spread / np.maximum(off, 1e-9))
    return x.astype(float), np.asarray(np.linalg.inv(N)[9:, 9:], dtype=float)


def _scaled(size: Array) -> bool:
    """Whether gravity has another size than before: an axis is dead, and nothing was turned."""
    return abs(float(np.median(size[:BEFORE])) - float(np.median(size[BEFORE:]))) > SIZE_MPS2


def _vector(R: Array) -> Array:
    """Rotation vector of a turn of less than half a circle."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(R)) - 1.0))
    vector: Array = axis * (angle / sine) if sine > 1e-12 else axis
    return vector


def _exponential(turn: Array) -> Array:
    """Rotation by a vector (Rodrigues)."""
    angle = math.sqrt(float(turn @ turn))
    K = _cross(turn[None])[0]
    one, two = (1.0, 0.5)
    if angle > 1e-9:
        one, two = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    made: Array = np.eye(3) + one * K + two * (K @ K)
    return made


def _cross(v: Array) -> Array:
    """[v]× of each row."""
    x, y, z = v.T
    o = np.zeros(len(v))
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
