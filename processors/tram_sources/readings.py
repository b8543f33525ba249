"""What drives the motion of the model `tram`: the IMU, where it lives and is believed, or else.

An IMU may be silent, say what cannot be, repeat itself (`tram_model/axes.py`) or contradict all
others (`divergence.py`). Each time the filter goes on with what `modes.py` says instead.

Equations: docs/theory.md, sections 7.7 and 7.9.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tramstream import keys
from tramstream.attitude import C_bv_of
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.records import numbers, one
from tramstream.events.kinds import Event
from tramstream.processors.tram_filter import modes
from tramstream.processors.tram_filter.events import (
    DRAWN_STRAIGHT,
    IMPOSSIBLE_READING,
    IMU_LIVES,
    IMU_STUCK,
)
from tramstream.processors.tram_filter.filter import GYRO_Z, TramFilter
from tramstream.processors.tram_filter.modes import (
    HELD_S,
    Drive,
    drive_by_reading,
    drive_without_reading,
)
from tramstream.processors.tram_model import axes
from tramstream.processors.tram_model.axes import STUCK, TAKEN
from tramstream.processors.tram_model.records import INERTIAL, READING_S, X, Z
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.coasting import MotionNoise, NoiseMemory
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

STUCK_STD_MPS2, STUCK_STD_RAD = 0.5, 0.01
"""How far a force, and what an angle has become, are off by an axis that has just been found stuck,
beside what it has told; chosen by hand, guarded by `tests/processors/tram/test_liveness.py`."""
AXES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


FOR_GOOD_NS = 1 << 62
"""An instant that no ride sees; chosen by hand."""
ABSENT, BELIEVED, FOUND_STUCK, DRAWN = range(4)
"""What became of a frame's inertial reading: none or not believed, taken, just found stuck, drawn
through a gap. Plain numbers, for it is asked a hundred times a second."""


@dataclass
class ReadingsMemory:
    """What `Readings` remember."""

    inertial: Array
    """Numbers of `records.Inertial`."""
    noise: NoiseMemory = field(default_factory=NoiseMemory)
    read_ns: int = 0
    rate_ns: int = 0
    stuck: bool = False
    """Whether the IMU is left out, as one that does not live."""
    out_ns: int = 0
    """Until when it is left out, as one that contradicts all others."""


class Readings:
    """The inertial readings, and what stands for them.

    Parameters
    ----------
    complaints : list of Event
        Gets what there is to say.
    """

    def __init__(self, vehicle: Vehicle, complaints: list[Event]) -> None:
        self._complaints = complaints
        self.inertial = one(INERTIAL)
        """See `records.Inertial`."""
        self.numbers: Array = numbers(self.inertial)
        self.now: Array = numbers(self.inertial["now"])
        """The newest one as plain numbers: rates, specific forces, angular accelerations, 1."""
        self.between: Array = numbers(self.inertial["between"])
        """What acts between the last two, as plain numbers."""
        self.memory = ReadingsMemory(self.numbers)
        self._now, self._straight = self.inertial["now"], self.inertial["straight"].data
        imu = vehicle.imu
        self._C_vb = np.ascontiguousarray(C_bv_of(imu).T)
        self._noise = MotionNoise(vehicle, self.memory.noise)
        self.has_imu = imu is not None
        """Whether one is configured."""

    def read(self, frame: SyncFrame, ekf: TramFilter) -> int:
        """Take over the frame's inertial reading, or the bus' yaw rate."""
        became = self._read_imu(frame.imu, ekf) if frame.HasField("imu") else ABSENT
        if became != ABSENT:
            return became
        rates = [each for each in frame.odometry if each.HasField("yaw_rate_radps")]
        turns = bool(rates) and abs(rates[-1].yaw_rate_radps) < axes.FASTEST_RADPS
        ages_ns = frame.stamp_ns - self.memory.read_ns, frame.stamp_ns - self.memory.rate_ns
        drive = drive_without_reading(*ages_ns, turns)
        if drive is Drive.YAW_RATE:
            self._read_rate(rates[-1], ekf)
        elif drive is modes.COASTING:
            self._coast(ekf)
        return became

    @property
    def coasting(self) -> bool:
        """Whether nothing tells of the motion."""
        return self.memory.noise.drive is modes.COASTING

    def leave_out(self, ekf: TramFilter, until_ns: int) -> None:
        """Do without the IMU until then."""
        self.memory.out_ns = until_ns
        self.memory.noise.without_imu = until_ns == FOR_GOOD_NS
        self._coast(ekf)

    def _read_imu(self, mean: ImuMean, ekf: TramFilter) -> int:
        memory = self.memory
        stamp_ns = mean.stamp_ns
        if stamp_ns < memory.out_ns:
            return ABSENT
        dt = (stamp_ns - memory.read_ns) / S if memory.read_ns else 0.0
        drive = modes.INERTIAL
        if dt > HELD_S:
            drive = drive_by_reading(dt, bool(self._now["accelerometer"][0] != 0.0))
        lasts = 0.0 if drive is modes.COASTING else dt
        became = axes.take_reading(self.numbers, self._C_vb, *axes.scalars_of(mean), lasts)
        if became != TAKEN:
            if became == STUCK:
                return self._find_stuck(mean, ekf)
            self._complaints.append(IMPOSSIBLE_READING(key=keys.IMU_BATCH.path))
            return ABSENT
        if memory.stuck:
            memory.stuck = False
            self._complaints.append(IMU_LIVES(key=keys.IMU_BATCH.path))
        memory.read_ns = stamp_ns
        if drive is modes.INERTIAL and self._straight[0] >= axes.STRAIGHT_READINGS:
            if self._straight[0] == axes.STRAIGHT_READINGS:
                self._complaints.append(DRAWN_STRAIGHT(key=keys.IMU_BATCH.path))
            self._noise.follow_line(ekf, self.inertial["between"])
            return DRAWN
        if drive is modes.INERTIAL:
            self._noise.inertial(ekf)
        elif drive is modes.BRIDGED:
            self._noise.bridge(ekf, dt)
        else:
            self._hold("between", ekf)
            self._noise.coast(ekf)
        return BELIEVED

    def _find_stuck(self, mean: ImuMean, ekf: TramFilter) -> int:
        """Go on without an IMU that does not live, and doubt what it has told meanwhile."""
        repeats = self.inertial["repeats"][0]
        axis = int(repeats.argmax())
        facts = {"axis": AXES[axis], "readings": int(repeats[axis])}
        value = axes.scalars_of(mean)[axis]
        self._complaints.append(IMU_STUCK(key=keys.IMU_BATCH.path, value=value, **facts))
        if self.memory.stuck:
            return ABSENT
        self.memory.stuck = True
        lasted_s = float(repeats[axis]) * READING_S
        push = abs(float(self._now["specific_force"][0, X])) + STUCK_STD_MPS2
        rates: list[float] = np.abs(self._now["angular_rate"][0]).tolist()
        ekf.widen(Ix.SPEED, lasted_s * push)
        for angle, rate in zip((Ix.ROLL, Ix.PITCH, Ix.YAW), rates, strict=True):
            ekf.widen(angle, lasted_s * rate + STUCK_STD_RAD)
        self._coast(ekf)
        return FOUND_STUCK

    def _coast(self, ekf: TramFilter) -> None:
        """Go on with nothing that tells of the motion."""
        self._hold("now", ekf)
        self._hold("between", ekf)
        self._noise.coast(ekf)

    def _hold(self, which: str, ekf: TramFilter) -> None:
        """Fill a reading so that no rate and no force act."""
        reading = self.inertial[which]
        numbers(reading)[:] = 0.0
        reading["angular_rate"] = ekf.state[Ix.GYRO_X : Ix.GYRO_Z + 1]

    def _read_rate(self, reading: Odometry, ekf: TramFilter) -> None:
        """Let the bus' own yaw rate stand for a gyroscope."""
        # The bias that the filter knows is not that of this sensor, where there is an IMU.
        memory = self.memory
        bias = ekf.state[GYRO_Z] if self.has_imu else 0.0
        for held in ("now", "between"):
            self._hold(held, ekf)
            self.inertial[held]["angular_rate"][0, Z] = reading.yaw_rate_radps + bias
        interval_s = None
        if memory.rate_ns:
            interval_s = min(max((reading.stamp_ns - memory.rate_ns) / S, 0.01), 1.0)
        self._noise.yaw_rate(ekf, interval_s)
        memory.rate_ns = reading.stamp_ns
