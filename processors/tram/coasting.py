"""What carries the model `tram` on while no inertial reading comes.

Speed is left to itself and may change as that of a tram does. The heading turns as the bus' own
yaw rate says where there is one; else nothing tells it but the wheels, by their difference. So its
noise is as large as a tram turns in a curve where there are two, and what fixes can follow where
there are not.

Equations: docs/theory.md, section 7.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.processors.tram.filter import TramFilter
from tramstream.processors.tram.modes import BRIDGED_S, Drive
from tramstream.processors.tram_model.records import situation

SPEED_STD_MPS_RTS = 1.5
"""How the speed may change unseen: 5 m/s within ten seconds."""
YAW_STD_RAD_RTS = 0.07
"""How the heading may turn unseen: 0.15 rad/s (60 m at 9 m/s) for a quarter of a second."""
PAIR_YAW_STD_RAD_RTS = 0.2
"""How the heading may turn unseen for some seconds, where two wheels tell by how much."""


@dataclass
class NoiseMemory:
    """What `MotionNoise` remembers."""

    drive: Drive = Drive.INERTIAL


class MotionNoise:
    """Noise of speed and attitude, by what drives them; told to the filter when that changes.

    Which drive it is, decides `modes.py`.
    """

    def __init__(self, vehicle: Vehicle, memory: NoiseMemory | None = None) -> None:
        s, tilt = situation(vehicle)[0], vehicle.ekf.tilt_std_rad_rts
        self._inertial = np.array([s["accel_density"], *s["rate_density"]])
        self._bridged = np.array([SPEED_STD_MPS_RTS, tilt, tilt, YAW_STD_RAD_RTS]) ** 2
        self._coasting = self._bridged.copy()
        if vehicle.odometer is not None and len(vehicle.odometer.wheels) > 1:
            self._coasting[-1] = PAIR_YAW_STD_RAD_RTS**2
        self._has_imu = vehicle.imu is not None
        self._yaw_rate_variance = vehicle.wheels.yaw_rate_std_radps**2
        self.memory = NoiseMemory() if memory is None else memory

    def inertial(self, ekf: TramFilter) -> None:
        """Go on with a reading."""
        if self.memory.drive is not Drive.INERTIAL:
            self._tell(ekf, Drive.INERTIAL, self._inertial)

    def bridge(self, ekf: TramFilter, pause_s: float) -> None:
        """Go on with the readings on either side of a pause: they tell the less, the longer."""
        longer = (pause_s / BRIDGED_S) ** 2
        self._tell(ekf, Drive.BRIDGED, self._inertial + longer * self._bridged)

    def coast(self, ekf: TramFilter) -> None:
        """Go on with nothing that tells of the motion."""
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
