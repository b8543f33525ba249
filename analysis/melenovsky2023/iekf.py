"""The iterated EKF of melenovsky2023: 22 states, among them the mounting as three Euler angles.

The filter is filterpy's; model and Jacobians are compiled. Errata are mended (docs/theory.md,
section 16.2): Euler rates are those of section 1.3, the accelerometer has its row, and ‖Δx‖/‖x‖ is
scaled by the deviations, for metres and radians cannot be added. a_y and a_z are free states: that
is the work's, and why its yaw comes from curves alone in second order.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from tramstream.analysis.mounting.drive import Drive
from tramstream.attitude import C_vl
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]

P, V, A, EULER, OMEGA, PSI, Z_F, Z_W = 0, 3, 4, 7, 10, 13, 16, 19
"""First slots of position, speed, acceleration, attitude, rate, mounting and walks."""
SIZE, MEASURED = 22, 11
COURSE = 4
"""Row of the course among: position (3), speed, course, force (3), rate (3)."""
MOST_ITERATIONS = 30
SETTLED = 1e-6
COURSE_FROM_MPS = 2.0
"""A slower vehicle's course is noise."""


class Tuning(NamedTuple):
    """Process noise and start, as the work has them."""

    share_j: float = 0.75
    """α_j, within [0.5, 1]."""
    share_e: float = 0.75
    most_mps2: float = 1.0
    most_mps: float = 15.0
    least_radius_m: float = 20.0
    level_rad: float = math.radians(5.0)
    mounting_rad: float = math.radians(5.0)
    walk: float = 0.1
    """Of both walks at the start, SI."""


class Sensors(NamedTuple):
    """Noise of what is measured."""

    accel: float
    gyro: float
    accel_walk: float
    gyro_walk: float


@compiled
def _turn(roll: float, pitch: float, yaw: float) -> Array:
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2] = cp * cy, cp * sy, -sp
    C[1, 0], C[1, 1], C[1, 2] = -cr * sy + cy * sr * sp, cr * cy + sr * sp * sy, cp * sr
    C[2, 0], C[2, 1], C[2, 2] = sr * sy + cr * cy * sp, -cy * sr + cr * sp * sy, cp * cr
    return C


@compiled
def predicted(x: Array, T: float) -> Array:
    """f(x): a step of the motion."""
    out = x.copy()
    roll, pitch, yaw = x[EULER], x[EULER + 1], x[EULER + 2]
    way = T * (x[V] + x[A] * T / 2)
    out[P] += way * math.cos(pitch) * math.cos(yaw)
    out[P + 1] += way * math.cos(pitch) * math.sin(yaw)
    out[P + 2] -= way * math.sin(pitch)
    out[V] += T * x[A]
    turning = math.sin(roll) * x[OMEGA + 1] + math.cos(roll) * x[OMEGA + 2]
    out[EULER] += T * (x[OMEGA] + math.tan(pitch) * turning)
    out[EULER + 1] += T * (math.cos(roll) * x[OMEGA + 1] - math.sin(roll) * x[OMEGA + 2])
    out[EULER + 2] += T * turning / math.cos(pitch)
    return out


@compiled
def measured(x: Array, gravity: float) -> Array:
    """h(x): position, speed, course as a yaw, force and rate of the case."""
    out = np.empty(MEASURED)
    out[:3] = x[P : P + 3]
    out[3], out[COURSE] = x[V], x[EULER + 2]
    C_vl_ = _turn(x[EULER], x[EULER + 1], x[EULER + 2])
    C_bv = _turn(x[PSI], x[PSI + 1], x[PSI + 2])
    for i in range(3):
        force, rate = x[Z_F + i], x[Z_W + i]
        for j in range(3):
            force += C_bv[i, j] * (x[A + j] + C_vl_[j, 2] * gravity)
            rate += C_bv[i, j] * x[OMEGA + j]
        out[5 + i], out[8 + i] = force, rate
    return out


@compiled
def transition(x: Array, T: float) -> Array:
    """Jacobian of `predicted`, by differences."""
    F = np.empty((SIZE, SIZE))
    for j in range(SIZE):
        low, high = x.copy(), x.copy()
        low[j] -= 1e-6
        high[j] += 1e-6
        F[:, j] = (predicted(high, T) - predicted(low, T)) / 2e-6
    return F


@compiled
def sensitivity(x: Array, gravity: float) -> Array:
    """Jacobian of `measured`, by differences."""
    H = np.empty((MEASURED, SIZE))
    for j in range(SIZE):
        low, high = x.copy(), x.copy()
        low[j] -= 1e-6
        high[j] += 1e-6
        H[:, j] = (measured(high, gravity) - measured(low, gravity)) / 2e-6
    return H


class Iterated(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's filter with the work's iterated update."""

    x: Any
    P: Any
    R: Any

    def iterate(self, z: Array, rows: NDArray[np.int64], gravity: float) -> int:
        """Update with the rows of a measurement until it settles; how many iterations it took."""
        prior, R = self.x.copy(), self.R[np.ix_(rows, rows)]
        scale = 1 / np.sqrt(np.maximum(np.diag(self.P), 1e-18))
        number = 0
        for number in range(1, MOST_ITERATIONS + 1):
            H = sensitivity(self.x, gravity)[rows]
            y = z[rows] - measured(self.x, gravity)[rows]
            course = rows == COURSE
            y[course] = np.angle(np.exp(1j * y[course]))
            S = H @ self.P @ H.T + R
            self.K = np.linalg.solve(S, H @ self.P).T
            new = prior + self.K @ (y - H @ (prior - self.x))
            step = 100 / (number + 99) * (new - self.x)
            self.x = self.x + step
            size = float(np.linalg.norm(self.x * scale))
            moved = float(np.linalg.norm(step * scale)) / max(size, 1e-12)
            if moved <= SETTLED:
                break
        self.y, self.S = y, S
        self.P = self.P - self.K @ S @ self.K.T
        self.P = (self.P + self.P.T) / 2
        return number


def process_noise(T: float, tuning: Tuning, sensors: Sensors) -> Array:
    """Q of a step: the discrete Wiener model of acceleration, as the work has it."""
    jerk = tuning.share_j * tuning.most_mps2 * T
    turn = tuning.share_e * tuning.most_mps / (tuning.least_radius_m * T)
    Q = np.zeros((SIZE, SIZE))
    Q[V : A + 1, V : A + 1] = jerk * np.array([[T**2, T], [T, 1.0]])
    for i in range(3):
        Q[P + i, P + i] = jerk * T**4 / 4
        Q[EULER + i, EULER + i] = turn * T**4 / 4
        Q[OMEGA + i, OMEGA + i] = turn * T**2
        Q[Z_F + i, Z_F + i] = sensors.accel_walk**2 * T
        Q[Z_W + i, Z_W + i] = sensors.gyro_walk**2 * T
    Q[A + 1, A + 1] = Q[A + 2, A + 2] = jerk
    return Q


class Course(NamedTuple):
    """What the filter said along the ride."""

    psi_rad: Array
    """(n, 3): roll, pitch, yaw of the case after each step."""
    psi_std_rad: Array

    @property
    def C_vb(self) -> Array:
        """The last, (3, 3)."""
        found: Array = C_vl(*self.psi_rad[-1]).T
        return found


def run(drive: Drive, psi_rad: Array, sensors: Sensors, tuning: Tuning | None = None) -> Course:
    """Filter a ride that begins at a stand."""
    tuning = tuning or Tuning()
    T = drive.dt_s
    kf = _begin(drive, psi_rad, tuning)
    kf.Q = process_noise(T, tuning, sensors)
    fixes = drive.fixes
    R = np.zeros(MEASURED)
    R[5:8], R[8:11] = sensors.accel**2 / T, sensors.gyro**2 / T
    found, std = np.zeros((2, drive.length, 3))
    z = np.zeros(MEASURED)
    row = 0
    inertial = np.arange(5, MEASURED)
    for k in range(drive.length - 1):
        z[5:8], z[8:11] = drive.inertial.f_b[k], drive.inertial.omega_b[k]
        rows = inertial
        if row < len(fixes.node) and fixes.node[row] == k:
            velocity = fixes.vel_l[row]
            yaw = kf.x[EULER + 2]  # along it the noise has no sign, as the work's speed
            z[:3], z[3] = fixes.p_l[row], velocity[0] * math.cos(yaw) + velocity[1] * math.sin(yaw)
            z[COURSE] = math.atan2(velocity[1], velocity[0])
            R[:3] = fixes.p_std_m[row] ** 2
            R[3] = fixes.vel_std_mps[row, 0] ** 2
            R[COURSE] = R[3] / max(z[3], 0.1) ** 2
            told = [0, 1, 2, 3] if z[3] < COURSE_FROM_MPS else [0, 1, 2, 3, COURSE]
            rows = np.concatenate([told, inertial])
            row += 1
        kf.R = np.diag(R)
        kf.iterate(z, rows, drive.gravity_mps2)
        found[k] = kf.x[PSI : PSI + 3]
        std[k] = np.sqrt(np.maximum(np.diag(kf.P)[PSI : PSI + 3], 0.0))
        F = transition(kf.x, T)
        kf.x = predicted(kf.x, T)
        kf.P = F @ kf.P @ F.T + kf.Q
    found[-1], std[-1] = found[-2], std[-2]
    return Course(found, std)


def _begin(drive: Drive, psi_rad: Array, tuning: Tuning) -> Iterated:
    kf = Iterated(SIZE, MEASURED)
    x, variance = np.zeros(SIZE), np.zeros(SIZE)
    x[:3] = drive.fixes.p_l[0]
    variance[:3] = drive.fixes.p_std_m[0] ** 2
    variance[EULER : EULER + 3] = tuning.level_rad**2
    moving = np.hypot(drive.fixes.vel_l[:, 0], drive.fixes.vel_l[:, 1])
    first = int(np.argmax(moving > 3 * COURSE_FROM_MPS))
    x[EULER + 2] = math.atan2(drive.fixes.vel_l[first, 1], drive.fixes.vel_l[first, 0])
    x[PSI : PSI + 3] = psi_rad
    variance[PSI : PSI + 3] = tuning.mounting_rad**2
    variance[Z_F:] = tuning.walk**2
    kf.x, kf.P = x, np.diag(variance)
    return kf
