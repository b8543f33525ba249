"""The model `tram` as a filterpy filter: same attributes, compiled predict and update.

A filterpy user finds x, P, y, S, K, log_likelihood where they always are. `predict` and `update`
are the general calls; what the vehicle's sensors measure has methods of its own, which cost about
a microsecond each and report every innovation as a `Verdict`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tramstream.config import Vehicle
from tramstream.estimation.filterpy_base import ExtendedKalmanFilter
from tramstream.estimation.kalman import Array, update_scalar
from tramstream.estimation.localiser import OnTrack, Verdict
from tramstream.processors.tram import measurements
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.states import PARAMETERS, SIZE, Ix, Pm

EARTH_RADIUS_M = 6_371_000.0
PAIR_GATE = 30.0
"""Squared distance of a fix or a velocity that is refused: 3e-7 of honest ones."""
PAIR_KNEE = 9.0
"""From here on it is weighted down: 1 % of honest ones."""
DOUBT_STD_M = 0.3
"""A fix that is off by less than a few of these is never an outlier, however sure the filter is."""
SCALAR_GATE = 25.0
"""The same for scalars: 5 σ."""
STANDING_STD_MPS = 0.002
QUANTISATION = 1.0 / 3.0
"""Variance of a wheel's reading in pulses²: 1/12 of rounding, more at low speed (docs/theory.md,
section 3.5)."""
READING_S = 0.01
"""What one inertial mean of the fusion horizon lasts."""
LOG_2PI = math.log(2.0 * math.pi)

SPEED, GYRO_Z = int(Ix.SPEED), int(Ix.GYRO_Z)
SPEED_VARIANCE = kernels.COVARIANCE.start + SPEED * (SIZE + 1)
"""Where they are in the memory; a name of `Ix` takes longer than what is read with it."""

_COLUMNS = np.arange(SIZE)
_FIX, _VELOCITY = (
    ("gnss_east", "gnss_north", "gnss_up"),
    ("gnss_velocity_east", "gnss_velocity_north"),
)
_TRACK = ("track_across", "track_heading", "track_grade")
_PATH, _RIM = ("wheel_a", "wheel_b"), ("rim_a", "rim_b")


def parameters(vehicle: Vehicle, gravity_mps2: float) -> Array:
    """Constants of the model out of a vehicle's configuration; see `tram_states.Pm`."""
    c = np.zeros(PARAMETERS)
    c[Pm.GRAVITY] = gravity_mps2
    c[Pm.CURVATURE] = 1.0 / EARTH_RADIUS_M
    wheels = vehicle.wheels
    c[Pm.OFFSET_A], c[Pm.OFFSET_B] = wheels.track_m / 2, -wheels.track_m / 2
    c[Pm.SIGN_A] = c[Pm.SIGN_B] = 1.0
    c[Pm.SLIP_DENSITY] = vehicle.ekf.wheel_creep_m_rtm**2
    if vehicle.gnss is not None:
        c[Pm.ANTENNA_X : Pm.ANTENNA_Z + 1] = vehicle.gnss.lever_arm_m
    c[Pm.SIDE_DENSITY] = vehicle.ekf.side_slip_std_m_rts**2
    c[Pm.HEAVE_DENSITY] = vehicle.ekf.heave_std_m_rts**2
    c[Pm.HEAVE_VARIANCE] = c[Pm.HEAVE_DENSITY] / READING_S
    imu = vehicle.imu
    c[Pm.LATERAL_VARIANCE] = vehicle.ekf.sway_std_mps2_rthz**2 / READING_S
    c[Pm.STANDING_VARIANCE] = STANDING_STD_MPS**2
    if imu is None:
        c[Pm.ACCEL_DENSITY] = vehicle.ekf.acceleration_std_mps2_rthz**2
        c[Pm.ROLL_DENSITY] = c[Pm.PITCH_DENSITY] = vehicle.ekf.tilt_std_rad_rts**2
        return c
    c[Pm.IMU_X : Pm.IMU_Z + 1] = imu.lever_arm_m
    fixes = vehicle.gnss.delay_std_s**2 if vehicle.gnss is not None else 0.0
    if fixes + imu.delay_std_s > 0.0:
        c[Pm.CLOCK_SHARE] = imu.delay_std_s**2 / (fixes + imu.delay_std_s**2)
    c[Pm.ACCEL_DENSITY] = imu.accel_noise_mps2_rthz**2 + vehicle.ekf.force_std_mps2_rthz**2
    c[Pm.ROLL_DENSITY : Pm.YAW_DENSITY + 1] = imu.gyro_noise_radps_rthz**2
    c[Pm.LATERAL_VARIANCE] += imu.accel_noise_mps2_rthz**2 / READING_S
    c[Pm.READING_VARIANCE] = imu.gyro_noise_radps_rthz**2 / READING_S
    c[Pm.VERTICAL_DENSITY] = vehicle.ekf.vertical_std_mps2_rthz**2
    c[Pm.GYRO_WALK] = imu.gyro_walk_radps2_rthz**2
    c[Pm.ACCEL_WALK] = imu.accel_walk_mps3_rthz**2
    return c


class TramFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """x (28, 1) and P (28, 28) of the model `tram`, in one block of memory.

    Parameters
    ----------
    c : ndarray, shape (PARAMETERS,)
        The model's constants; the filter reads them at every step, so that they may change.
    """

    def __init__(self, c: Array) -> None:
        self.memory = np.zeros(kernels.MEMORY)
        self.numbers = self.memory.data
        """The same memory; a single number is read in a third of the time."""
        self._x = self.memory[kernels.STATE].reshape(SIZE, 1)
        self._P = self.memory[kernels.COVARIANCE].reshape(SIZE, SIZE)
        super().__init__(dim_x=SIZE, dim_z=1)
        self.parameters = c
        self.log_likelihood_sum = 0.0
        """Of all measurements since it was last set to zero."""
        self._out = np.zeros((3, 2))
        self._z = np.zeros(3)
        self._R = np.zeros(3)
        self._R[2] = DOUBT_STD_M**2

    # filterpy keeps these as plain attributes; here they are views of the block of memory.
    @property
    def x(self) -> Array:
        return self._x

    @x.setter
    def x(self, value: Any) -> None:
        self._x[:] = np.asarray(value, dtype=float).reshape(SIZE, 1)

    @property
    def P(self) -> Array:
        return self._P

    @P.setter
    def P(self, value: Any) -> None:
        self._P[:] = np.eye(SIZE) * float(value) if np.ndim(value) == 0 else value

    @property
    def log_likelihood(self) -> float:
        """Of the last measurement that `update` took."""
        y, S = np.atleast_1d(np.ravel(self.y)), np.atleast_2d(self.S)
        return float(
            -0.5 * (y @ np.linalg.solve(S, y) + math.log(np.linalg.det(S)) + len(y) * LOG_2PI)
        )

    # The general calls ---------------------------------------------------------------------------
    def predict(self, u: Array, dt: float) -> None:
        """Move on by `dt` s with the inertial reading `u`; see `tram_kernels.move`."""
        kernels.predict(self.memory, self.parameters, u, dt)

    def update(
        self,
        z: Any,
        HJacobian: Callable[..., Array],
        Hx: Callable[..., Any],
        R: Any = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
    ) -> None:
        """Take any measurement, as `filterpy.kalman.ExtendedKalmanFilter.update` does.

        Row after row, which is exact for a diagonal R; others are refused.

        Raises
        ------
        ValueError
            If R is not diagonal.
        """
        args = args if isinstance(args, tuple) else (args,)
        hx_args = hx_args if isinstance(hx_args, tuple) else (hx_args,)
        H = np.atleast_2d(HJacobian(self.x, *args))
        R = self.R if R is None else R
        R = np.asarray(R, dtype=float)
        R = np.eye(len(H)) * R if R.ndim == 0 else R
        if np.count_nonzero(R - np.diag(np.diag(R))):
            raise ValueError("R is not diagonal: decorrelate the measurement first")
        y = np.asarray(residual(np.asarray(z), Hx(self.x, *hx_args)), dtype=float).reshape(-1, 1)
        self.y, self.z = y, np.asarray(z)
        PHT = self._P @ H.T
        self.S = H @ PHT + R
        self.SI = np.linalg.inv(self.S)
        self.K = PHT @ self.SI
        before = self._x.copy()
        gain = self.memory[kernels.GAIN]
        for row, innovation, variance in zip(H, y[:, 0], np.diag(R), strict=True):
            seen = float(innovation - row @ (self._x - before)[:, 0])
            update_scalar(
                self._x[:, 0], self._P, _COLUMNS, row, SIZE, seen, variance, math.inf, gain
            )
        self.x_post, self.P_post = self._x.copy(), self._P.copy()

    # The vehicle's sensors -----------------------------------------------------------------------
    def rest(self, dt: float) -> None:
        """Let `dt` s pass for a vehicle that stands."""
        kernels.rest(self.memory, self.parameters, dt)

    def inertial(self, u: Array, steady: Array) -> Verdict | None:
        """Take the lateral specific force; a verdict only when it was refused."""
        distance = measurements.inertial(self.memory, self.parameters, u, steady, SCALAR_GATE)
        if distance >= 0.0:
            self.log_likelihood_sum -= 0.5 * distance
            return None
        self.log_likelihood_sum -= 0.5 * SCALAR_GATE
        variance = self.parameters[Pm.LATERAL_VARIANCE]
        return Verdict("lateral_force", math.sqrt(-distance * variance), variance, False)

    def stop(self) -> bool:
        """Take that the vehicle has no speed; False if its speed had to be forgotten for that."""
        return bool(measurements.stop(self.memory, self.parameters, SCALAR_GATE))

    def standing(self, u: Array) -> bool:
        """Take all that a vehicle that stands shows; see `stop`."""
        return bool(measurements.standing(self.memory, self.parameters, u, SCALAR_GATE))

    def position(self, z: Sequence[float], std: float, std_up: float) -> list[Verdict]:
        """Take the antenna's position in l, m; the deviations are those of the white part."""
        self._z[0], self._z[1], self._z[2] = z
        self._R[0], self._R[1] = std * std, std_up * std_up
        measurements.position(
            self.memory, self.parameters, self._z, self._R, PAIR_GATE, PAIR_KNEE, self._out
        )
        return self._all_judged(_FIX)

    def velocity(self, z: Sequence[float], std: float) -> list[Verdict]:
        """Take the antenna's velocity over ground (east, north), m/s."""
        self._z[0], self._z[1] = z
        measurements.velocity(
            self.memory, self.parameters, self._z, std * std, PAIR_GATE, PAIR_KNEE, self._out
        )
        return self._all_judged(_VELOCITY)

    def path(self, wheel: int, way: float, variance: float) -> Verdict:
        """Take a wheel's path since its last reading, m."""
        y, S = measurements.path(self.memory, self.parameters, wheel, way, variance, SCALAR_GATE)
        return self._judged(_PATH[wheel], y, S)

    def rim(self, wheel: int, speed: float, std: float) -> Verdict:
        """Take a wheel's speed, m/s."""
        y, S = measurements.rim(self.memory, self.parameters, wheel, speed, std * std, SCALAR_GATE)
        return self._judged(_RIM[wheel], y, S)

    def track(self, on_track: OnTrack) -> list[Verdict]:
        """Take that the vehicle is on a track, of which the state as it is is off."""
        measurements.track(self.memory, np.array(on_track), SCALAR_GATE, self._out)
        known = 2 if math.isnan(on_track.grade_rad) else 3
        return self._all_judged(_TRACK[:known])

    def tie(self, wheel: int, variance: float) -> None:
        """Count a wheel's path from here on."""
        measurements.tie(self.memory, self.parameters, wheel, variance)

    def counted(self, wheel: int) -> float:
        """Give the path since its last reading that a wheel's counter should show now, m."""
        return float(measurements.counted(self.memory, self.parameters, wheel))

    def _judged(self, name: str, y: float, S: float) -> Verdict:
        """Make a verdict of an innovation and its variance, negative where it was refused."""
        accepted = S > 0.0
        S = abs(S)
        # What is refused counts as much as the last that would not have been.
        distance = min(y * y / S, PAIR_GATE) if S > 0.0 else PAIR_GATE
        self.log_likelihood_sum -= 0.5 * (distance + math.log(S))
        return Verdict(name, y, S, accepted)

    def _all_judged(self, names: Sequence[str]) -> list[Verdict]:
        return [
            self._judged(name, *seen) for name, seen in zip(names, self._out.tolist(), strict=False)
        ]

    # Changes that are no measurement -------------------------------------------------------------
    def forget(self, slots: Sequence[Ix], stds: Sequence[float]) -> None:
        """Make states independent of all others, with new deviations; their values stay."""
        for slot, std in zip(slots, stds, strict=True):
            self._P[slot, :] = self._P[:, slot] = 0.0
            self._P[slot, slot] = std * std

    def widen(self, slot: Ix, std: float) -> None:
        """Add to a state's uncertainty; what others know of it stays."""
        self._P[slot, slot] += std * std
