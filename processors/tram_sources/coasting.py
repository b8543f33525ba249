"""What carries the model `tram` on while no inertial reading comes.

Speed is left to itself and may change as that of a vehicle does. The heading turns as the bus' own
yaw rate says where there is one; else nothing tells it but the wheels, by their difference, and the
fixes, by the way between them. So its noise in a pause is as large as a tram turns in a curve. A
vehicle that has no IMU at all goes through every corner like that, those of streets too: it may
turn by so much a metre of way, and not at all while it stands.

Equations: docs/theory.md, section 7.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.records import Records
from tramstream.processors.tram_filter.filter import SPEED, TramFilter
from tramstream.processors.tram_filter.modes import BRIDGED_S, INERTIAL, Drive
from tramstream.processors.tram_model.records import X, Y, Z, situation
from tramstream.processors.tram_model.states import Ix

SPEED_STD_MPS_RTS = 1.5
"""How the speed may change unseen: 5 m/s within ten seconds."""
YAW_STD_RAD_RTS = 0.2
"""How the heading may turn unseen in a pause: by 0.25 rad in 1.5 s; reckoned by hand."""
YAW_STD_RAD_RTM = 0.2
"""How the heading of a vehicle without an IMU may turn: by 0.8 rad along the 16 m of a street
corner of 10 m; reckoned by hand, guarded by `tests/processors/tram/test_fixes_alone.py`."""
YAW_FLOOR_RAD_RTS = 0.02
"""The same of one whose speed is taken to be none; chosen by hand."""


@dataclass
class NoiseMemory:
    """What `MotionNoise` remembers."""

    drive: Drive = Drive.INERTIAL
    without_imu: bool = False
    """Whether the IMU is left out for good: what follows is no pause."""


class MotionNoise:
    """Noise of speed and attitude, by what drives them; told to the filter when that changes.

    Which drive it is, decides `modes.py`.
    """

    def __init__(self, vehicle: Vehicle, memory: NoiseMemory | None = None) -> None:
        s, tilt = situation(vehicle)[0], vehicle.ekf.tilt_std_rad_rts
        self._inertial = np.array([s["accel_density"], *s["rate_density"]])
        self._bridged = np.array([SPEED_STD_MPS_RTS, tilt, tilt, YAW_STD_RAD_RTS]) ** 2
        self._coasting = self._bridged.copy()
        self._has_imu = vehicle.imu is not None
        self._yaw_rate_variance = vehicle.wheels.yaw_rate_std_radps**2
        self.memory = NoiseMemory() if memory is None else memory

    def inertial(self, ekf: TramFilter) -> None:
        """Go on with a reading."""
        if self.memory.drive is not INERTIAL:
            self._tell(ekf, INERTIAL, self._inertial)

    def bridge(self, ekf: TramFilter, pause_s: float) -> None:
        """Go on with the readings on either side of a pause: they tell the less, the longer."""
        longer = (pause_s / BRIDGED_S) ** 2
        self._tell(ekf, Drive.BRIDGED, self._inertial + longer * self._bridged)

    def follow_line(self, ekf: TramFilter, between: Records) -> None:
        """Go on with readings that were drawn straight through a gap: their turn is what leads.

        Either end is one reading of a case that shakes. It tells how the vehicle turns, which is
        much, and not how it nods or brakes.
        """
        x, rate = ekf.state, between["angular_rate"][0]
        turn = float(rate[Z]) - x[Ix.GYRO_Z]
        # Roll and pitch stay: a body that leans and turns has rates about all its axes.
        rate[Y] = x[Ix.GYRO_Y] + math.tan(x[Ix.ROLL]) * turn
        rate[X] = x[Ix.GYRO_X] - math.tan(x[Ix.PITCH]) / math.cos(x[Ix.ROLL]) * turn
        between["angular_acceleration"], between["accelerometer"] = 0.0, 0.0
        self._tell(ekf, Drive.BRIDGED, self._bridged)

    def coast(self, ekf: TramFilter) -> None:
        """Go on with nothing that tells of the motion."""
        if not self._has_imu or self.memory.without_imu:
            turning = YAW_STD_RAD_RTM * YAW_STD_RAD_RTM * abs(ekf.state[SPEED])
            self._coasting[-1] = turning + YAW_FLOOR_RAD_RTS * YAW_FLOOR_RAD_RTS
        self._tell(ekf, Drive.COASTING, self._coasting)

    def yaw_rate(self, ekf: TramFilter, interval_s: float | None) -> None:
        """Go on with the bus' own yaw rate, whose white noise lasts one interval, where known."""
        densities = (self._coasting if self._has_imu else self._inertial).copy()
        if interval_s is not None:
            densities[-1] = self._yaw_rate_variance * interval_s
        self._tell(ekf, Drive.YAW_RATE, densities)

    def _tell(self, ekf: TramFilter, drive: Drive, densities: Array) -> None:
        self.memory.drive = drive
        ekf.set_motion_noise(float(densities[0]), densities[1:])
