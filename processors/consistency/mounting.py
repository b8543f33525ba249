"""How the IMU is mounted, by gravity at stands and by the force of driving.

At a stand the mean specific force is gravity's answer: as mounted, it points up, within the grade
and cant of a track. From there on the readings are levelled by it (the least turn that puts it
upright), and while the wheels accelerate on straight track the level force has to have their
acceleration, in size and direction:

    f_x + i f_y = e^(iφ) a + grade,        φ: how far the case is turned about the vertical

φ is that of the regression over the moments of driving, each stretch between two stands about its
own mean, which takes the grade away. Needs nothing but IMU and wheels.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field

import numpy as np

from tramstream.attitude import C_bv_of, C_vl
from tramstream.config import Imu
from tramstream.estimation.kalman import Array
from tramstream.mounting import about_axes
from tramstream.processors.consistency.way import Course

GRAVITY_MPS2 = 9.81
"""Anywhere on rails, within the limit below."""
GRAVITY_LIMIT_MPS2 = 0.5
"""Three times the bias of `imu.accel_bias_std_mps2` as it is by default."""
TILT_LIMIT_DEG = 8.0
"""The steepest tramways have 9 % (5°), cant at a stop is 100 mm at most (4°), a bias of 0.15 m/s²
is 0.9°; by hand."""
MANY_STANDS = 8
MEAN_TILT_LIMIT_DEG = 3.0
"""Stops lean by 1° to 2°, each its own way: the mean of eight by 0.7°; by hand."""
TURN_LIMIT_DEG = 6.0
"""The filter learns what is less; by hand."""
STDS = 4.0
"""A turn is said beyond so many deviations of what is configured and of what is found."""
WINDOW_S = 0.5
STILL_WINDOWS = 4
"""A stand is judged after so many windows in which nothing turns."""
STILL_MPS2 = 0.2
"""Forces of still windows differ by less."""
STRAIGHT_RADPS = 0.01
"""A moment that turns faster is one of a curve, whose cant nobody knows."""
HARDEST_MPS2 = 5.0
LEAST_MOMENTS = 12
LEAST_DRIVE_MPS2 = 1.5
"""Root of the summed squares of the accelerations, without which nothing is said."""
LEAST_COHERENCE = 0.6
"""Share of the force that is that of the wheels' acceleration."""
BACKWARDS_RAD = math.radians(150.0)


@dataclass
class Sums:
    """Sums of a regression of complex m on real p, about their means."""

    count: int = 0
    mean_p: float = 0.0
    mean_m: complex = 0j
    pp: float = 0.0
    pm: complex = 0j
    mm: float = 0.0

    def add(self, p: float, m: complex) -> None:
        self.count += 1
        off_p, off_m = p - self.mean_p, m - self.mean_m
        self.mean_p += off_p / self.count
        self.mean_m += off_m / self.count
        share = (self.count - 1) / self.count
        self.pp += share * off_p * off_p
        self.pm += share * off_p * off_m
        self.mm += share * abs(off_m) ** 2


@dataclass
class MountingMemory:
    """What a `Mounting` remembers."""

    windows: list[tuple[float, list[float]]] = field(default_factory=list)
    """The last ones: end, mean of force and rate in the axes of the case."""
    still: int = 0
    gravity: list[float] = field(default_factory=list)
    """Sum over the still windows of this stand, in the axes of the case."""
    last_mps2: list[float] = field(default_factory=list)
    up: list[float] = field(default_factory=list)
    """Direction of gravity's answer in the axes of the case, at the last stand that was judged."""
    ups: list[float] = field(default_factory=list)
    """Sum of `up` over all stands."""
    force_mps2: float = 0.0
    bias_radps: float = 0.0
    """Of the rate about the vertical, at the last stand."""
    stands: int = 0
    here: Sums = field(default_factory=Sums)
    """Since the last stand."""
    before: Sums = field(default_factory=Sums)


@dataclass(frozen=True)
class Turn:
    """How the force of driving lies against the wheels' acceleration."""

    angle_rad: float
    std_rad: float
    size: float
    """Of the force, for one m/s² of the wheels."""
    moments: int


class Mounting:
    """Judges windows of half a second."""

    def __init__(self, imu: Imu, memory: MountingMemory) -> None:
        self.memory = memory
        self._C_bv: Array = C_bv_of(imu)
        roll, pitch, yaw = about_axes(imu.mounting_std_deg)
        self._tilt_std_deg, self._turn_std_deg = max(roll, pitch), yaw
        self._level: Array = np.eye(3)
        self._vertical = (0.0, 0.0, 1.0)
        self.restored()

    def restored(self) -> None:
        """Derive the levelling of the memory."""
        if self.memory.up:
            self._level = turn_upright(self._C_bv.T @ np.array(self.memory.up))
        x, y, z = (self._level @ self._C_bv.T)[2].tolist()
        self._vertical = (x, y, z)

    def rate(self, x_radps: float, y_radps: float, z_radps: float) -> float:
        """Rate about the vertical, less its bias, of rates about the axes of the case."""
        x, y, z = self._vertical
        return x * x_radps + y * y_radps + z * z_radps - self.memory.bias_radps

    # Stands --------------------------------------------------------------------------------------
    def take(self, end_s: float, mean: list[float], still: bool) -> bool:
        """Take a window; True if a stand has just been judged.

        Parameters
        ----------
        mean : list of float
            Specific force and rate in the axes of the case, m/s² and rad/s.
        still : bool
            Nothing says that the vehicle moves.
        """
        memory = self.memory
        memory.windows.append((end_s, mean))
        del memory.windows[:-5]
        near = memory.last_mps2 and math.dist(mean[:3], memory.last_mps2) < STILL_MPS2
        memory.last_mps2 = mean[:3]
        if not (still and near):
            memory.still, memory.gravity = 0, []
            return False
        memory.still += 1
        if memory.still == 1:  # the vehicle settles on its springs
            memory.gravity = [0.0] * 6
            return False
        memory.gravity = [a + b for a, b in zip(memory.gravity, mean, strict=True)]
        if memory.still != STILL_WINDOWS + 1:
            return False
        self._judge_stand()
        return True

    def _judge_stand(self) -> None:
        memory = self.memory
        sums = np.array(memory.gravity) / STILL_WINDOWS
        memory.force_mps2 = float(np.linalg.norm(sums[:3]))
        memory.up = (sums[:3] / max(memory.force_mps2, 1e-9)).tolist()
        memory.stands += 1
        memory.ups = [a + b for a, b in zip(memory.ups or [0.0] * 3, memory.up, strict=True)]
        self.restored()
        memory.bias_radps = 0.0
        memory.bias_radps = self.rate(*sums[3:].tolist())
        memory.before, memory.here = self._together(), Sums()

    @property
    def tilt_deg(self) -> float:
        """Between gravity and up as mounted, at the last stand."""
        return self._tilt_deg(self.memory.up)

    @property
    def mean_tilt_deg(self) -> float:
        """Between the mean of gravity over all stands and up as mounted."""
        return self._tilt_deg(self.memory.ups)

    def _tilt_deg(self, up: list[float]) -> float:
        x, y, z = (self._C_bv.T @ np.array(up or self._C_bv[:, 2])).tolist()
        return math.degrees(math.atan2(math.hypot(x, y), z))

    @property
    def mean_tilt_limit_deg(self) -> float:
        """Of the mean over `MANY_STANDS`."""
        return max(MEAN_TILT_LIMIT_DEG, STDS * self._tilt_std_deg)

    @property
    def tilt_limit_deg(self) -> float:
        return max(TILT_LIMIT_DEG, STDS * self._tilt_std_deg)

    @property
    def turn_limit_deg(self) -> float:
        return max(TURN_LIMIT_DEG, STDS * self._turn_std_deg)

    # Driving -------------------------------------------------------------------------------------
    def drive(self, path: Course) -> None:
        """Take the moment between the two windows before the last, whose way is known by now."""
        memory = self.memory
        if not memory.up or len(memory.windows) < 4:
            return
        (start, _), (middle, first), (end, second), _ = memory.windows[-4:]
        if not WINDOW_S * 1.5 < end - start < WINDOW_S * 2.5:
            return
        s = path.at(np.array([start, middle, end]))
        half = 0.5 * (end - start)
        a = float(s[2] - 2.0 * s[1] + s[0]) / half**2
        mean = [0.5 * (x + y) for x, y in zip(first, second, strict=True)]
        force = (self._level @ self._C_bv.T @ np.array(mean[:3])).tolist()
        rate = self.rate(*mean[3:])
        if math.isfinite(a) and abs(a) < HARDEST_MPS2 and abs(rate) < STRAIGHT_RADPS:
            memory.here.add(a, complex(force[0], force[1]))

    def turn(self) -> Turn | None:
        """Give how the force lies against the acceleration; None while that is not clear."""
        all_ = self._together()
        if all_.count < LEAST_MOMENTS or all_.pp < LEAST_DRIVE_MPS2**2:
            return None
        coherence = abs(all_.pm) ** 2 / (all_.pp * max(all_.mm, 1e-12))
        if coherence < LEAST_COHERENCE:
            return None
        # Moments overlap by half: each is worth half a one.
        std = math.sqrt(max(1.0 - coherence, 1e-6) / (coherence * all_.count))
        return Turn(cmath.phase(all_.pm), std, abs(all_.pm) / all_.pp, all_.count)

    def _together(self) -> Sums:
        a, b = self.memory.before, self.memory.here
        return Sums(a.count + b.count, 0.0, 0j, a.pp + b.pp, a.pm + b.pm, a.mm + b.mm)

    def mounting_deg(self, turned_rad: float = 0.0) -> tuple[float, float, float]:
        """Angles that would put gravity upright and the force of driving ahead."""
        C_bv = self._C_bv @ self._level.T @ C_vl(0.0, 0.0, turned_rad).T
        roll = math.atan2(C_bv[1, 2], C_bv[2, 2])
        pitch = -math.asin(min(max(float(C_bv[0, 2]), -1.0), 1.0))
        yaw = math.atan2(C_bv[0, 1], C_bv[0, 0])
        return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def turn_upright(up: Array) -> Array:
    """The least turn that takes a unit vector to z; half a turn about x where it points down."""
    c = float(up[2])
    if c < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([up[1], -up[0], 0.0])  # up × z
    K = np.array([[0.0, 0.0, v[1]], [0.0, 0.0, -v[0]], [-v[1], v[0], 0.0]])
    turn: Array = np.eye(3) + K + K @ K / (1.0 + c)
    return turn
