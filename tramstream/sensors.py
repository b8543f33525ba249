"""What the sensors of a ride would measure: inertial counts, wheel pulses, GNSS positions.

Each sensor is fed the truth of consecutive instants in blocks of any size and remembers what one
block hands to the next (remainders, correlated errors, its generator's state), so that the cut into
blocks does not show in what it measures. Motion is planar: the level vehicle turns about the
vertical only, the IMU sits at the vehicle's origin with its axes along the vehicle's, and the
Earth's rotation is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream.ride import Motion

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

STANDARD_GRAVITY_MPS2 = 9.80665

# IMU ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """Errors of the inertial axes; theory.md section 3 unless said otherwise.

    Bias instability, random walk and scale are still to come.
    """

    gyro_bias_radps: Vector = (0.0052359, 0.0052359, 0.0052359)
    gyro_noise_radps_rthz: float = 0.00011344
    """N: deviation of the mean over one second."""
    accel_bias_mps2: Vector = (0.1, 0.1, 0.1)
    accel_noise_mps2_rthz: float = 0.00022563
    temperature_degc: float = 25.0


@dataclass(frozen=True, slots=True)
class ImuScales:
    """Unit of one count; the defaults are those of the ADIS16465-1 (theory.md section 2)."""

    gyro_radps: float = math.radians(0.00625)
    accel_mps2: float = 0.25e-3 * STANDARD_GRAVITY_MPS2
    temperature_degc: float = 0.1


class ImuCounts(NamedTuple):
    """What the registers hold, one row a sample: (n, 3), (n, 3), (n,)."""

    gyro: NDArray[np.int16]
    accel: NDArray[np.int16]
    temperature: NDArray[np.int16]


def inertial(motion: Motion, gravity_mps2: float) -> tuple[Array, Array]:
    """Give specific force and angular rate of a level vehicle, resolved in `v`.

    theory.md section 1 with pitch and roll 0: f = (v̇, v ω_z, g).

    Returns
    -------
    f_v : ndarray, shape (n, 3)
        m/s².
    omega_v : ndarray, shape (n, 3)
        rad/s.
    """
    count = len(motion.speed_mps)
    f_v = np.empty((count, 3))
    f_v[:, 0] = motion.acceleration_mps2
    f_v[:, 1] = motion.speed_mps * motion.yaw_rate_radps
    f_v[:, 2] = gravity_mps2
    omega_v = np.zeros((count, 3))
    omega_v[:, 2] = motion.yaw_rate_radps
    return f_v, omega_v


class Imu:
    """Inertial sensor: bias, white noise, rounding to counts, saturation at 16 bits."""

    def __init__(
        self,
        rng: Generator,
        rate_hz: float,
        errors: ImuErrors | None = None,
        scales: ImuScales | None = None,
    ) -> None:
        self.rng = rng
        self.errors = errors = errors or ImuErrors()
        self.scales = scales = scales or ImuScales()
        unit = np.repeat([scales.gyro_radps, scales.accel_mps2], 3)
        noise = np.repeat([errors.gyro_noise_radps_rthz, errors.accel_noise_mps2_rthz], 3)
        self._per_unit = 1 / unit
        self._bias = np.array([*errors.gyro_bias_radps, *errors.accel_bias_mps2]) / unit
        self._noise = noise * math.sqrt(rate_hz) / unit

    def measure(self, f_b: ArrayLike, omega_b: ArrayLike) -> ImuCounts:
        """Counts of consecutive samples.

        Parameters
        ----------
        f_b : array_like, shape (n, 3)
            Specific force of the case, m/s².
        omega_b : array_like, shape (n, 3)
            Angular rate of the case, rad/s.
        """
        truth = np.hstack([np.asarray(omega_b), np.asarray(f_b)])
        values = truth * self._per_unit + self._bias
        values += self.rng.standard_normal(truth.shape) * self._noise
        counts = np.clip(np.rint(values), -32768, 32767).astype(np.int16)
        degrees = round(self.errors.temperature_degc / self.scales.temperature_degc)
        temperature = np.full(len(counts), degrees, dtype=np.int16)
        return ImuCounts(counts[:, :3], counts[:, 3:], temperature)


# Odometry -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Axle:
    """The two measured wheels and their encoders: theory.md sections 2 and 3."""

    pulses_per_turn: int = 2048
    radius_m: float = 0.3
    radius_error_m: tuple[float, float] = (0.0, 0.0)
    """Left and right: how much larger the wheel really is. The reference has 0.012 and 0.016."""
    track_m: float = 1.435

    @property
    def m_per_pulse(self) -> float:
        """What a pulse means to whoever knows nothing of the radius errors."""
        return math.tau * self.radius_m / self.pulses_per_turn


class Wheels:
    """Encoders of left and right wheel: whole pulses since the last message, the rest carried."""

    def __init__(self, axle: Axle | None = None) -> None:
        self.axle = axle = axle or Axle()
        radius = axle.radius_m + np.array(axle.radius_error_m)
        self._pulses_per_m = axle.pulses_per_turn / (math.tau * radius)
        self._start: tuple[float, float] | None = None  # arc length and yaw of the first instant
        self._counted = np.zeros((1, 2), dtype=np.int64)

    def measure(self, motion: Motion) -> NDArray[np.int64]:
        """Pulses since the instant before, left and right, for each instant; shape (n, 2).

        The first instant ever is where counting starts. The way of a wheel is that of the axle's
        middle and half the track times the turned angle: the integral of v ∓ ω_z l/2.
        """
        if self._start is None:
            self._start = float(motion.arc_length_m[0]), float(motion.yaw_rad[0])
        way = motion.arc_length_m - self._start[0]
        lever = (motion.yaw_rad - self._start[1]) * (self.axle.track_m / 2)
        turned = np.stack([way - lever, way + lever], axis=1) * self._pulses_per_m
        counted = np.concatenate([self._counted, np.floor(turned).astype(np.int64)])
        counted = np.maximum.accumulate(counted)  # rounding at standstill is no pulse backwards
        self._counted = counted[-1:]
        return np.diff(counted, axis=0)


@dataclass(frozen=True, slots=True)
class Resistance:
    """Longitudinal model of chladek2023 (theory.md section 5) on level track."""

    mass_kg: float = 150_000.0
    drag_coefficient: float = 1.05
    frontal_area_m2: float = 14.484
    rolling_coefficient: float = 0.00005
    air_density_kgpm3: float = 1.201


def motor_force_n(motion: Motion, resistance: Resistance | None = None) -> Array:
    """Force of motors and brakes that makes the vehicle move as it does; none while standing."""
    model = resistance or Resistance()
    drag = 0.5 * model.drag_coefficient * model.frontal_area_m2 * model.air_density_kgpm3
    rolling = model.mass_kg * STANDARD_GRAVITY_MPS2 * model.rolling_coefficient
    force = model.mass_kg * motion.acceleration_mps2 + drag * motion.speed_mps**2 + rolling
    return np.where(motion.standing, 0.0, force)


# GNSS ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GnssErrors:
    """Errors of the fixes; theory.md section 3 and its reading of the reference."""

    horizontal_std_m: float = 0.5
    """Stationary, per axis."""
    vertical_std_m: float = 1.0
    decay: float = 0.95
    """Correlation of an axis' error with itself one second later."""
    velocity_std_mps: float = 0.05
    """Per axis, white; the speed accuracy that u-blox states for the ZED-F9P (UBX-17051259)."""


class Fixes(NamedTuple):
    """Measured position and velocity of the antenna in `l`, one row an epoch: (n, 3) each."""

    p_l: Array
    vel_l: Array


class Gnss:
    """GNSS receiver: a first-order Gauss-Markov error on each axis, white noise on velocity."""

    def __init__(
        self,
        rng: Generator,
        rate_hz: float,
        errors: GnssErrors | None = None,
        p_va_v: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        self.rng = rng
        self.errors = errors = errors or GnssErrors()
        self._p_va_v = np.array(p_va_v)
        self._std = np.array(
            [errors.horizontal_std_m, errors.horizontal_std_m, errors.vertical_std_m]
        )
        self._keep = errors.decay ** (1 / rate_hz)
        self._drive = self._std * math.sqrt(1 - self._keep**2)
        self._error_l: Array | None = None

    def measure(self, p_l: ArrayLike, motion: Motion) -> Fixes:
        """Fixes of consecutive epochs.

        Parameters
        ----------
        p_l : array_like, shape (n, 3)
            True position of the vehicle's origin, m.
        motion : Motion
            At the same instants.
        """
        antenna, velocity = antenna_motion(np.asarray(p_l, dtype=float), motion, self._p_va_v)
        white = self.rng.standard_normal((len(antenna), 2, 3))
        errors = np.empty_like(antenna)
        for row, noise in enumerate(white[:, 0]):
            if self._error_l is None:
                self._error_l = self._std * noise
            else:
                self._error_l = self._keep * self._error_l + self._drive * noise
            errors[row] = self._error_l
        return Fixes(antenna + errors, velocity + self.errors.velocity_std_mps * white[:, 1])


def antenna_motion(p_l: Array, motion: Motion, p_va_v: Array) -> tuple[Array, Array]:
    """Give position and velocity in `l` of a point fixed to the level vehicle.

    p_a = p + C_lv p_va, v_a = C_lv (v + ω × p_va); theory.md section 1.

    Returns
    -------
    p_a_l, vel_a_l : ndarray, shape (n, 3)
    """
    cos, sin = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
    forward = motion.speed_mps - motion.yaw_rate_radps * p_va_v[1]
    left = motion.yaw_rate_radps * p_va_v[0]

    def resolved_l(x_v: Array, y_v: Array, z_v: Array) -> Array:
        return np.stack([cos * x_v - sin * y_v, sin * x_v + cos * y_v, z_v], axis=-1)

    lever_l = resolved_l(*(np.full_like(cos, component) for component in p_va_v))
    return p_l + lever_l, resolved_l(forward, left, np.zeros_like(cos))
