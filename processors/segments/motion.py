"""The vehicle's motion out of frames, a tenth of a second at a time: see `kernels` and `epoch`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.attitude import C_bv_of
from tramstream.clock import S
from tramstream.config import Imu, Vehicle
from tramstream.machine.kernels import bound
from tramstream.processors.segments import epoch as epochs
from tramstream.processors.segments import kernels, standing, turns
from tramstream.processors.segments.alignment import Alignment, AlignmentMemory, Found, tilt_rad
from tramstream.processors.segments.epoch import GOING, SLIPS, STANDS, TURNED, Go, Wh
from tramstream.processors.segments.kernels import EPOCH_S, GRAVITY, NOISES, STATES, SUMS, Ix, Sum
from tramstream.processors.segments.settings import SegmentsSettings
from tramstream.processors.segments.standing import St
from tramstream.processors.segments.wheels import WheelReader, WheelsMemory
from tramstream.proto.sync_pb2 import SyncFrame

Array = NDArray[np.float64]

PAUSE_S = 1.0
"""Inertial data that come after a longer pause tell nothing of what was in between."""
CONTRADICTS_RAD = math.radians(15.0)
"""No track is so steep: a vertical that is further off is another mounting."""
LEAST_TURNED_STD_RAD = math.radians(3.0)
OWN_TURNED_STD_RAD = math.radians(5.0)
SPEED_STD_MPS = 15.0
"""Before anything is known."""
TILT_STD_RAD = 0.1
BIAS_STD_RADPS = 0.001
"""Of gyroscopes after an alignment on the run."""


@dataclass
class MotionMemory:
    """What a `Motion` remembers."""

    x: Array = field(default_factory=lambda: np.zeros(STATES))
    P: Array = field(default_factory=lambda: np.zeros((STATES, STATES)))
    sums: Array = field(default_factory=lambda: np.zeros(SUMS))
    standing: Array = field(default_factory=lambda: np.zeros(standing.ROWS))
    turns: Array = field(default_factory=lambda: np.zeros(turns.ROWS))
    going: Array = field(default_factory=lambda: np.zeros(GOING))
    mounting: Array = field(default_factory=lambda: np.eye(4, 3))
    """C_vb, and below it the case from the point that does not slip sideways, m."""
    wheels: WheelsMemory = field(default_factory=WheelsMemory)
    alignment: AlignmentMemory = field(default_factory=AlignmentMemory)
    begun_ns: int = 0
    """Stamp of the first frame, from which times are counted."""
    stamp_ns: int = 0
    own: bool = False
    """Whether the mounting is found on the run."""
    aligned: bool = False
    """Whether the mounting is known, and the motion followed."""
    checked: bool = False
    """Whether gravity has been compared with the mounting."""


class Epoch(NamedTuple):
    """What a tenth of a second has shown."""

    stamp_ns: int
    standing: bool
    slips: bool
    turned: bool
    """A turn has ended: see `Motion.turn`."""
    contradicts_rad: float
    """Tilt by which gravity contradicts the mounting; 0: it does not."""


class Motion:
    """Follows the vehicle's motion; what it holds of it is `memory`."""

    def __init__(self, vehicle: Vehicle, settings: SegmentsSettings, memory: MotionMemory) -> None:
        self.memory = memory
        imu = vehicle.imu if vehicle.imu is not None else Imu(device="")
        self._imu = imu
        self._settings = settings
        self.scale_std = settings.scale_std
        """Of the wheels' way, as a part of it."""
        memory.own = settings.mounting == "own"
        self._wheels = WheelReader(vehicle, memory.wheels)
        pivot_m = vehicle.ekf.pivot_m
        memory.mounting[3] = np.array(imu.lever_arm_m) + np.array([pivot_m, 0.0, 0.0])
        self._noise = np.zeros(NOISES)
        self._noise[kernels.Noise.FORCE] = math.hypot(
            imu.accel_noise_mps2_rthz, vehicle.ekf.force_std_mps2_rthz
        )
        self._noise[kernels.Noise.GYRO] = imu.gyro_noise_radps_rthz
        self._noise[kernels.Noise.GYRO_WALK] = imu.gyro_walk_radps2_rthz
        self._noise[kernels.Noise.FORCE_WALK] = imu.accel_walk_mps3_rthz
        bogies_m = vehicle.ekf.bogie_distance_m
        self._noise[kernels.Noise.SMEAR_M2] = bogies_m**2 + float(turns.WINDOW_M**2)
        self.rate_z = 0.0
        """Yaw rate of the case at the end of the last epoch, rad/s."""
        self.turn = np.zeros(turns.TURN)
        """The last turn that ended, a row of `turns.Turn`."""
        work = np.zeros((2 * STATES + 3, STATES))
        x, P, sums = memory.x, memory.P, memory.sums
        still, triple = memory.standing, (0.0, 0.0, 0.0)
        self._advance = bound(
            kernels.advance, x, sums, still, memory.mounting, 0.01, triple, triple
        )
        self._epoch = bound(
            epochs.epoch,
            *(x, P, sums, memory.standing, memory.turns, memory.going, memory.wheels.row),
            *(self._noise, 0.1, self.turn, work),
        )
        self._work = work
        if not memory.own:
            self._begin(C_bv_of(imu).T)

    # Beginning -----------------------------------------------------------------------------------
    def _begin(self, C_vb: Array, found: Found | None = None) -> None:
        memory, imu = self.memory, self._imu
        memory.mounting[:3] = C_vb
        memory.aligned = True
        memory.x[Ix.SPEED :] = 0.0
        stds = np.zeros(STATES)
        stds[Ix.SPEED] = SPEED_STD_MPS
        stds[Ix.PITCH] = stds[Ix.ROLL] = TILT_STD_RAD
        stds[Ix.GYRO_X : Ix.GYRO_Z + 1] = imu.gyro_bias_std_radps
        stds[Ix.FORCE_X : Ix.FORCE_Y + 1] = imu.accel_bias_std_mps2
        stated = imu.mounting_std_deg
        yaw_deg = stated if isinstance(stated, float | int) else stated[2]
        stds[Ix.TURNED] = max(math.radians(yaw_deg), LEAST_TURNED_STD_RAD)
        if found is not None:
            memory.x[Ix.SPEED] = found.speed_mps
            memory.x[Ix.GYRO_X : Ix.GYRO_Z + 1] = found.bias_v
            stds[Ix.SPEED] = 0.2 * found.speed_mps
            stds[Ix.GYRO_X : Ix.GYRO_Z + 1] = BIAS_STD_RADPS
            stds[Ix.PITCH] = stds[Ix.ROLL] = imu.accel_bias_std_mps2 / GRAVITY
            stds[Ix.TURNED] = OWN_TURNED_STD_RAD
            memory.standing[St.STANDING] = 0.0
        way = memory.P[Ix.WAY, Ix.WAY]
        memory.P[:] = np.diag(stds**2)
        memory.P[Ix.WAY, Ix.WAY] = way

    def look_for_mounting(self) -> None:
        """Forget the mounting, and find it on the run."""
        memory = self.memory
        memory.own, memory.aligned = True, False
        memory.mounting[:3] = np.eye(3)
        memory.x[Ix.SPEED :] = 0.0

    # Frames --------------------------------------------------------------------------------------
    def take(self, frame: SyncFrame) -> Epoch | None:
        """Take a frame; what an epoch has shown, where one ends with it."""
        memory = self.memory
        readings = frame.odometry
        if readings and self._settings.wheels:
            memory.wheels.latest = readings[-1]
        if not frame.HasField("imu"):
            return None
        imu, stamp_ns = frame.imu, frame.stamp_ns
        dt_s = (stamp_ns - memory.stamp_ns) / S
        if not 0.0 < dt_s < PAUSE_S:
            self._after_pause(stamp_ns)
            return None
        memory.stamp_ns = stamp_ns
        lasted_s = self._advance(
            *(memory.x, memory.sums, memory.standing, memory.mounting, dt_s),
            (imu.gyro_x_radps, imu.gyro_y_radps, imu.gyro_z_radps),
            (imu.accel_x_mps2, imu.accel_y_mps2, imu.accel_z_mps2),
        )
        if lasted_s < EPOCH_S - 1e-3:
            return None
        if not memory.aligned:
            return self._align(stamp_ns)
        self.rate_z = imu.gyro_z_radps
        scatter = imu.accel_x_std_mps2**2 + imu.accel_y_std_mps2**2 + imu.accel_z_std_mps2**2
        memory.sums[Sum.SCATTER] = scatter * memory.sums[Sum.COUNT]
        return self._close(stamp_ns)

    def _after_pause(self, stamp_ns: int) -> None:
        memory = self.memory
        if not memory.begun_ns:
            memory.begun_ns = stamp_ns
        else:
            away_s = abs(stamp_ns - memory.stamp_ns) / S
            memory.P[Ix.SPEED, Ix.SPEED] += SPEED_STD_MPS**2
            memory.P[Ix.YAW, Ix.YAW] += 1.0
            memory.P[Ix.WAY, Ix.WAY] += (SPEED_STD_MPS * away_s) ** 2
        memory.stamp_ns = stamp_ns
        memory.sums[:] = 0.0

    def _align(self, stamp_ns: int) -> Epoch | None:
        memory = self.memory
        mean = memory.sums / memory.sums[Sum.COUNT]
        memory.sums[:] = 0.0
        memory.x[Ix.WAY :] = 0.0
        alignment = Alignment(memory.alignment)
        found = alignment.take(
            mean[Sum.RATE_X : Sum.RATE_Z + 1], mean[Sum.FORCE_X : Sum.FORCE_Z + 1]
        )
        if found is None:
            return None
        self._begin(found.C_vb, found)
        return None

    def _close(self, stamp_ns: int) -> Epoch:
        memory = self.memory
        sums, x = memory.sums, memory.x
        change = sums[Sum.FORCE_X] / sums[Sum.COUNT] + GRAVITY * math.sin(x[Ix.PITCH])
        row = self._wheels.close(stamp_ns, change)
        force_z = sums[Sum.FORCE_Z] / sums[Sum.COUNT]
        now_s = (stamp_ns - memory.begun_ns) / S
        found = self._epoch(
            *(x, memory.P, sums, memory.standing, memory.turns, memory.going, row),
            *(self._noise, now_s, self.turn, self._work),
        )
        contradicts = 0.0
        if found & STANDS and not memory.checked:
            memory.checked = True
            tilt = math.acos(min(max(force_z / GRAVITY, -1.0), 1.0))
            if self._settings.mounting == "auto" and not memory.own and tilt > CONTRADICTS_RAD:
                contradicts = tilt
        return Epoch(
            stamp_ns, bool(found & STANDS), bool(found & SLIPS), bool(found & TURNED), contradicts
        )

    # What it says --------------------------------------------------------------------------------
    def stamp_of(self, time_s: float) -> int:
        """Stamp of a time since the first frame."""
        return self.memory.begun_ns + round(time_s * S)

    @property
    def gone_m(self) -> float:
        """Way gone, whichever way."""
        return float(self.memory.going[Go.GONE_M])

    @property
    def wheeled(self) -> bool:
        """Whether the wheels tell the way now."""
        row = self.memory.wheels.row
        refused = row[Wh.REFUSED_S] > epochs.REFUSED_S or row[Wh.DEAD] > 0.5
        return not math.isnan(row[Wh.STILL_S]) and not refused

    @property
    def doubt(self) -> float:
        """Deviation of the way's scale that changes: of an integrated speed, as a part of it."""
        if self.wheeled:
            return 0.0
        return min(self.std(Ix.SPEED) / max(abs(float(self.memory.x[Ix.SPEED])), 1.0), 0.3)

    @property
    def backwards(self) -> bool:
        """Whether it goes against x of the vehicle, or did before it stood."""
        return bool(self.memory.going[Go.DIRECTION] < 0.0)

    @property
    def gyro_noise(self) -> float:
        """Density of the gyroscopes, rad/s/√Hz."""
        return float(self._noise[kernels.Noise.GYRO])

    def std(self, state: Ix) -> float:
        """Deviation of a state."""
        return math.sqrt(max(float(self.memory.P[state, state]), 0.0))


__all__ = ["Epoch", "Motion", "MotionMemory", "tilt_rad"]
