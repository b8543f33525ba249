"""What carries the model `tram` on while no inertial reading comes.

Speed is left to itself and may change as that of a tram does. The heading turns as the bus' own
yaw rate says where there is one; else nothing tells it but the wheels, by their difference. So its
noise is as large as a tram turns in a curve where there are two, and what fixes can follow where
there are not.

Equations: docs/theory.md, section 7.7.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.processors.tram.states import Ix, Pm

HELD_S = 0.1
"""So long an inertial reading is good for; ten of them were due."""
RATE_HELD_S = 1.0
"""So long a yaw rate of the bus, which comes less often."""
BRIDGED_S = 2.0
"""Over a shorter pause, the mean of the readings on either side is better than none."""
SPEED_STD_MPS_RTS = 1.5
"""How the speed may change unseen: 5 m/s within ten seconds."""
YAW_STD_RAD_RTS = 0.07
"""How the heading may turn unseen: 0.15 rad/s (60 m at 9 m/s) for a quarter of a second,"""
PAIR_YAW_STD_RAD_RTS = 0.2
"""and for some seconds, where two wheels tell by how much."""

_MOVING = slice(int(Pm.ACCEL_DENSITY), int(Pm.YAW_DENSITY) + 1)


class Blind:
    """Exchanges the densities of the model's noise; the parameters stay the filter's.

    Parameters
    ----------
    c : ndarray, shape (PARAMETERS,)
        As they are with inertial readings, or, for a vehicle without an IMU, with a yaw rate.
    """

    def __init__(self, vehicle: Vehicle, c: Array) -> None:
        tilt = vehicle.ekf.tilt_std_rad_rts
        self._sighted = c[_MOVING].copy()
        self._bridged = np.array([SPEED_STD_MPS_RTS, tilt, tilt, YAW_STD_RAD_RTS]) ** 2
        self._blind = self._bridged.copy()
        if vehicle.odometer is not None and len(vehicle.odometer.wheels) > 1:
            self._blind[-1] = PAIR_YAW_STD_RAD_RTS**2
        self.active = False
        """Whether the densities are others than those with readings."""

    def begin(self, c: Array) -> None:
        """Nothing tells of the motion."""
        c[_MOVING] = self._blind
        self.active = True

    def bridge(self, c: Array, pause_s: float) -> None:
        """Readings on either side of a pause tell of it, the less the longer it was."""
        c[_MOVING] = self._sighted + (pause_s / BRIDGED_S) ** 2 * self._bridged
        self.active = True

    def end(self, c: Array) -> None:
        """Readings come again."""
        if self.active:
            c[_MOVING] = self._sighted
            self.active = False

    @staticmethod
    def hold(row: Array, memory: Array) -> None:
        """Fill a row of inputs so that no rate and no force act."""
        row[:] = 0.0
        row[:3] = memory[Ix.GYRO_X : Ix.GYRO_Z + 1]

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> dict[str, Any]:
        return {"active": self.active}

    def restore(self, state: dict[str, Any]) -> None:
        self.active = state["active"]
