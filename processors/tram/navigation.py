"""One frame of the fusion horizon through the model `tram`, once the filter runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fixes import deviations, unusable
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import DEAD_RECKONING, TRACKING, Verdict
from tramstream.geodesy import LocalLevel, normal_gravity_mps2
from tramstream.processors.tram import axes as frames
from tramstream.processors.tram.coasting import BRIDGED_S, HELD_S, RATE_HELD_S, Blind
from tramstream.processors.tram.filter import READING_S, TramFilter, parameters
from tramstream.processors.tram.gnss import Fixes
from tramstream.processors.tram.states import PARAMETERS, Ix, Pm
from tramstream.processors.tram.wheels import WheelPair
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

ROLL_STD_RAD = 0.06
"""Cant of 90 mm on 1435 mm, at the start."""
PITCH_STD_RAD = 0.06
"""Grade of 7 % with a margin, at the start."""
GYRO_SCALE_STD = 0.003
"""ADIS16465 data sheet: sensitivity tolerance."""
START_STD_M = 1000.0
"""Position before the first fix."""
LEAVING_STD_MPS = 0.01
BLIND_LEAVING_STD_MPS = 0.3
"""Speed that standing may hide in its last moment, with wheels and without."""
LEAST_STEP_S = 1e-6
LONGEST_STEP_S = 0.1
"""Through a pause the filter goes in steps: what a step adds to the speed moves the next one."""
ASTRAY_S = 0.5
"""A measurement so far outside of its frame has a stamp that is wrong."""
LOST_S = 5.0
"""Without an accepted fix for so long it is dead reckoning."""


class Navigation:
    """Filter, wheels and fixes of a vehicle whose place is known."""

    filter_type: type[TramFilter] = TramFilter

    def __init__(self, vehicle: Vehicle, level: LocalLevel) -> None:
        self.level = level
        gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
        self.ekf = self.filter_type(parameters(vehicle, gravity))
        self.wheels = WheelPair(vehicle)
        self.fixes = Fixes(vehicle)
        self.stamp_ns = 0
        self.inputs = np.zeros((4, 10))
        """Inertial reading before, now, and what acts between them."""
        self.reading, self._between = self.inputs[1], self.inputs[2]
        self._shaking, self._steady = self.inputs[3, 3:6], self.inputs[3, 6:9]
        self.complaints: list[str] = []
        self.given: list[Verdict] = []
        """Of what was taken since the last frame."""
        imu = vehicle.imu
        mounting = imu.mounting_deg if imu else (0.0, 0.0, 0.0)
        self._C_vb = np.ascontiguousarray(C_vl(*np.radians(mounting)).T)
        self._read_ns = 0
        self._blind = Blind(vehicle, self.ekf.parameters)
        self._has_imu = imu is not None
        self._still_floor = np.zeros(2)
        self._aliasing = imu.gyro_aliasing**2 if imu is not None else 0.0
        if imu is not None:
            rate, force = imu.gyro_noise_radps_rthz, imu.accel_noise_mps2_rthz
            self._still_floor = np.array([rate**2, force**2])
        self._yaw_rate_variance = vehicle.wheels.yaw_rate_std_radps**2
        self._rate_ns = 0
        self.stood = False
        """Whether the vehicle stood in the last frame."""
        self._begin(vehicle)

    def _begin(self, vehicle: Vehicle) -> None:
        """First values and deviations of all states but the position's."""
        imu, wheels = vehicle.imu, vehicle.wheels
        std = np.zeros(len(Ix))
        std[[Ix.EAST, Ix.NORTH, Ix.UP]] = START_STD_M
        std[Ix.ROLL], std[Ix.PITCH] = ROLL_STD_RAD, PITCH_STD_RAD
        std[[Ix.GYRO_X, Ix.GYRO_Y, Ix.GYRO_Z]] = imu.gyro_bias_std_radps if imu else 0.0
        if imu is not None:
            std[[Ix.ACCEL_X, Ix.ACCEL_Y]] = imu.accel_bias_std_mps2
            if vehicle.ekf.vertical_std_mps2_rthz:
                std[Ix.ACCEL_Z] = imu.accel_bias_std_mps2
            std[[Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = math.radians(imu.mounting_std_deg)
            std[Ix.GYRO_SCALE] = GYRO_SCALE_STD
        else:
            std[Ix.GYRO_Z] = wheels.yaw_rate_std_radps
        std[Ix.PIVOT] = vehicle.ekf.pivot_std_m
        std[[Ix.SCALE_A, Ix.SCALE_B]] = wheels.scale_std
        std[Ix.WHEEL_DELAY] = wheels.delay_std_s
        if vehicle.gnss is not None:
            std[Ix.GNSS_DELAY] = math.hypot(
                vehicle.gnss.delay_std_s, imu.delay_std_s if imu else 0.0
            )
        self.ekf.P = np.diag(std**2)
        self.ekf.memory[Ix.WHEEL_DELAY] = wheels.delay_s
        self.ekf.memory[Ix.PIVOT] = vehicle.ekf.pivot_m

    # Readings ------------------------------------------------------------------------------------
    def read(self, frame: SyncFrame) -> bool:
        """Take over the frame's inertial reading, or the bus' yaw rate; False without a reading."""
        if frame.HasField("imu") and self._read_imu(frame.imu):
            return True
        if frame.stamp_ns - self._read_ns < HELD_S * S:
            return False
        rates = [each for each in frame.odometry if each.HasField("yaw_rate_radps")]
        if rates and abs(rates[-1].yaw_rate_radps) < frames.FASTEST_RADPS:
            self._read_rate(rates[-1])
        elif frame.stamp_ns - self._rate_ns > RATE_HELD_S * S:
            for row in self.inputs[1:3]:
                self._blind.hold(row, self.ekf.memory)
            self._blind.begin(self.ekf.parameters)
        return False

    def _read_imu(self, mean: ImuMean) -> bool:
        stamp_ns = mean.stamp_ns
        dt = (stamp_ns - self._read_ns) / S if self._read_ns else 0.0
        pause = dt > HELD_S
        anew = pause and (dt > BRIDGED_S or self.inputs[1, 9] == 0.0)
        lasts = 0.0 if anew else dt
        if not frames.read(self.inputs, self._C_vb, *frames.reading(mean), lasts):
            self.complaints.append("an inertial reading that cannot be was left out")
            return False
        self._read_ns = stamp_ns
        if anew:
            self._blind.hold(self.inputs[2], self.ekf.memory)
            self._blind.begin(self.ekf.parameters)
        elif pause:
            self._blind.bridge(self.ekf.parameters, dt)
        else:
            if self._blind.active:
                self._blind.end(self.ekf.parameters)
            if self._aliasing:
                self._shaken()
        return True

    def _shaken(self) -> None:
        """Shaking that the readings do not resolve is white noise to the angles, axis by axis."""
        white, share = self._still_floor[0], self._aliasing * READING_S
        densities = self.ekf.parameters[Pm.ROLL_DENSITY : Pm.YAW_DENSITY + 1]
        np.multiply(self._shaking, share, out=densities)
        densities += white

    def _read_rate(self, reading: Odometry) -> None:
        """The bus' own yaw rate stands for a gyroscope; its white noise lasts one interval."""
        c, bias = self.ekf.parameters, float(self.ekf.memory[Ix.GYRO_Z])
        for row in self.inputs[1:3]:
            self._blind.hold(row, self.ekf.memory)
        if self._has_imu:  # the bias that the filter knows is not that of this sensor
            self._blind.begin(c)
        else:
            self._blind.end(c)
            bias = 0.0
        self.inputs[1:3, 2] = reading.yaw_rate_radps + bias
        if self._rate_ns:
            interval = min(max((reading.stamp_ns - self._rate_ns) / S, 0.01), 1.0)
            c[Pm.YAW_DENSITY] = self._yaw_rate_variance * interval
        self._rate_ns = reading.stamp_ns

    # One frame -----------------------------------------------------------------------------------
    def run(self, frame: SyncFrame, standing: bool, noise: Array | None) -> list[Verdict]:
        """Go to the frame's stamp with all that is in it; `read` has been called.

        Parameters
        ----------
        standing : bool
            Whether the vehicle stands.
        noise : ndarray, shape (6,), or None
            Variance that rates and specific forces scatter by, if they are there.
        """
        ekf = self.ekf
        if self.stood and not standing:
            ekf.widen(Ix.SPEED, LEAVING_STD_MPS if self.wheels.known else BLIND_LEAVING_STD_MPS)
        self.stood = standing
        verdicts, self.given = self.given, []
        frame_ns, gnss, odometry = frame.stamp_ns, frame.gnss, frame.odometry
        if gnss or odometry:
            measurements: list[Any] = sorted((*gnss, *odometry), key=_stamp)
            for measurement in measurements:
                stamp_ns = measurement.stamp_ns
                if not self._of(stamp_ns, frame_ns):
                    continue
                self._advance(min(stamp_ns, frame_ns), standing)
                verdicts += self._measure(measurement, standing)
        self._advance(frame_ns, standing)
        if noise is None:
            if standing:
                ekf.stop()
            return verdicts
        if standing:
            self._stand(self.reading, noise)
        verdict = ekf.inertial(self.reading, self._steady)
        if verdict is not None:
            verdicts.append(verdict)
        return verdicts

    def _advance(self, stamp_ns: int, standing: bool) -> None:
        dt = (stamp_ns - self.stamp_ns) / S
        if dt < LEAST_STEP_S:
            return
        if standing:
            self.ekf.rest(dt)
        else:
            while dt > LONGEST_STEP_S:
                self.ekf.predict(self._between, LONGEST_STEP_S)
                dt -= LONGEST_STEP_S
            self.ekf.predict(self._between, dt)
        self.stamp_ns = stamp_ns

    def _of(self, stamp_ns: int, frame_ns: int) -> bool:
        """Whether a measurement belongs where it is: behind the last frame, not beyond this one."""
        fits = max(self.stamp_ns - stamp_ns, stamp_ns - frame_ns) < ASTRAY_S * S
        if not fits:
            self.complaints.append("a measurement that is not of its frame's time was left out")
        return fits

    def _stand(self, u: Array, noise: Array) -> None:
        c = self.ekf.parameters
        rate, force = self._still_floor.tolist()
        a, b, d, x, _, _ = noise.tolist()
        # The floor is the white noise of a 10 ms mean; shaking comes on top of it.
        c[Pm.STILL_ROLL_VARIANCE] = max(a, 100.0 * rate)
        c[Pm.STILL_PITCH_VARIANCE] = max(b, 100.0 * rate)
        c[Pm.STILL_YAW_VARIANCE] = max(d, 100.0 * rate)
        c[Pm.STILL_FORCE_VARIANCE] = max(x, 100.0 * force)
        self.ekf.standing(u)

    def _measure(self, measurement: Any, standing: bool) -> list[Verdict]:
        if isinstance(measurement, GnssFix):
            if not measurement.valid or unusable(measurement, self.level):
                return []
            verdicts, sentence = self.fixes.take(measurement, self.ekf, self.level, standing)
            if sentence:
                self.complaints.append(sentence)
            return verdicts
        if not self.wheels.known:
            self.wheels.meet(measurement, self.ekf)
        return self.wheels.take(measurement, self.ekf)

    # Changes of the situation --------------------------------------------------------------------
    def face(self, yaw_rad: float, std_rad: float, vehicle: Vehicle) -> None:
        """Set the heading; the position, until now the antenna's, becomes the vehicle's."""
        ekf, c = self.ekf, self.ekf.parameters
        ekf.memory[Ix.YAW] = yaw_rad
        ekf.forget((Ix.YAW,), (std_rad,))
        if vehicle.gnss is None:
            return
        ax, ay, az = vehicle.gnss.lever_arm_m
        c[Pm.ANTENNA_X], c[Pm.ANTENNA_Y], c[Pm.ANTENNA_Z] = ax, ay, az
        ax += float(ekf.memory[Ix.PIVOT])
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        ekf.memory[Ix.EAST] -= east
        ekf.memory[Ix.NORTH] -= north
        ekf.memory[Ix.UP] -= az
        # An error of the heading moves the vehicle about the antenna.
        for slot, moved in ((Ix.EAST, north), (Ix.NORTH, -east)):
            ekf.P[slot, :] += moved * ekf.P[Ix.YAW, :]
        for slot, moved in ((Ix.EAST, north), (Ix.NORTH, -east)):
            ekf.P[:, slot] += moved * ekf.P[:, Ix.YAW]

    def unface(self) -> None:
        """While the heading is unknown, the position is the antenna's."""
        self.ekf.parameters[Pm.ANTENNA_X : Pm.ANTENNA_Z + 1] = 0.0
        self.ekf.memory[Ix.YAW] = 0.0
        self.ekf.forget((Ix.YAW,), (0.0,))

    def mode(self, stamp_ns: int) -> int:
        """What the place rests on at `stamp_ns`, once the heading is known."""
        since_ns = stamp_ns - self.fixes.accepted_ns
        return DEAD_RECKONING if since_ns > LOST_S * S else TRACKING

    def begin(self) -> None:
        """Go on with a heading that is known again without having been sought."""

    def accuracy_m(self, fix: GnssFix) -> float:
        """Deviation of a fix on each horizontal axis."""
        return self.accuracies_m(fix)[0]

    def accuracies_m(self, fix: GnssFix) -> tuple[float, float]:
        """Deviation of a fix on each horizontal axis, and of its height."""
        return deviations(fix, self.fixes.floor_m)

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> dict[str, Any]:
        return {
            "memory": self.ekf.memory.copy(),
            "parameters": self.ekf.parameters.copy(),
            "stamp_ns": self.stamp_ns,
            "inputs": self.inputs.copy(),
            "read_ns": self._read_ns,
            "rate_ns": self._rate_ns,
            "blind": self._blind.snapshot(),
            "stood": self.stood,
            "wheels": self.wheels.snapshot(),
            "fixes": self.fixes.snapshot(),
            "given": [tuple(each) for each in self.given],
        }

    def restore(self, state: dict[str, Any]) -> None:
        self.ekf.memory[:] = state["memory"]
        self.ekf.parameters = np.array(state["parameters"]).reshape(PARAMETERS)
        self.stamp_ns, self._read_ns = state["stamp_ns"], state["read_ns"]
        self.inputs[:] = state["inputs"]
        self._rate_ns, self.stood = state["rate_ns"], state["stood"]
        self._blind.restore(state["blind"])
        self.wheels.restore(state["wheels"])
        self.fixes.restore(state["fixes"])
        self.given = [Verdict(*each) for each in state["given"]]


_stamp: Callable[[Any], int] = attrgetter("stamp_ns")
