"""What an IMU on a ride measures: specific force and angular rate of its case, in counts.

docs/theory.md, section 1.4 gives the truth, section 3.1 the errors of an axis:
(1 + scale)·truth + bias + z_b + z_k + white noise, rounded to counts. Bias instability z_b and
random walk z_k are drawn ten times a second and run straight between: white noise hides what is
faster. The Earth's rotation and the change of gravity with height (3e-6 m/s² a metre) are left out.

A sensor is fed the truth of consecutive instants in blocks of any size and remembers what one block
hands to the next, so that the cut into blocks does not show in what it measures.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream.attitude import body_rates
from tramstream.config import NotNegative, Positive, Struct, Vector
from tramstream.simulation.ride import Motion

Array = NDArray[np.float64]

STANDARD_GRAVITY_MPS2 = 9.80665
REFERENCE_DEGC = 25.0
"""Where the temperature coefficients have no effect."""
DRIFT_RATE_HZ = 10.0
ORIGIN: Vector = (0.0, 0.0, 0.0)
UPRIGHT: Vector = (0.0, 0.0, 1.0)


def inertial(
    motion: Motion, gravity_mps2: float, p_va_v: Vector = ORIGIN, up_l: ArrayLike = UPRIGHT
) -> tuple[Array, Array]:
    """Give specific force and angular rate of a point fixed to the vehicle, resolved in `v`.

    docs/theory.md, section 1.4: f = a_v + g C_vl u with a_v = (v̇, v ω_z, −v ω_y), which is the
    acceleration of a point that moves along x only; away from the origin ω̇ × r + ω × (ω × r) more.

    Parameters
    ----------
    motion : Motion
    gravity_mps2 : float
    p_va_v : array_like, shape (3,)
        The point, from the vehicle's origin, m.
    up_l : array_like, shape (3,) or (n, 3)
        u, the place's up in `l`.

    Returns
    -------
    f_v : ndarray, shape (n, 3)
        m/s².
    omega_v : ndarray, shape (n, 3)
        rad/s.
    """
    roll, pitch = motion.roll_rad, motion.pitch_rad
    rates = (motion.roll_rate_radps, motion.pitch_rate_radps, motion.yaw_rate_radps)
    omega_v = np.stack(body_rates(roll, pitch, rates), axis=-1)
    f_v = np.empty_like(omega_v)
    east, north, up = np.moveaxis(gravity_mps2 * np.asarray(up_l, dtype=float), -1, 0)
    cos_y, sin_y = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
    along, across = cos_y * east + sin_y * north, cos_y * north - sin_y * east
    upright = np.sin(pitch) * along + np.cos(pitch) * up
    f_v[:, 0] = motion.acceleration_mps2 + np.cos(pitch) * along - np.sin(pitch) * up
    f_v[:, 1] = motion.speed_mps * omega_v[:, 2] + np.cos(roll) * across + np.sin(roll) * upright
    f_v[:, 2] = -motion.speed_mps * omega_v[:, 1] - np.sin(roll) * across + np.cos(roll) * upright
    if any(p_va_v):
        lever = np.array(p_va_v)
        f_v += np.cross(angular_acceleration_v(motion), lever)
        f_v += np.cross(omega_v, np.cross(omega_v, lever))
    return f_v, omega_v


class Turning(Protocol):
    """Attitude and its derivatives, one row an instant: a `Motion` has them."""

    @property
    def roll_rad(self) -> Array: ...
    @property
    def pitch_rad(self) -> Array: ...
    @property
    def roll_rate_radps(self) -> Array: ...
    @property
    def pitch_rate_radps(self) -> Array: ...
    @property
    def yaw_rate_radps(self) -> Array: ...
    @property
    def roll_acceleration_radps2(self) -> Array: ...
    @property
    def pitch_acceleration_radps2(self) -> Array: ...
    @property
    def yaw_acceleration_radps2(self) -> Array: ...


def angular_acceleration_v(motion: Turning) -> Array:
    """Derivative of `body_rates` in time, rad/s²."""
    sin_r, cos_r = np.sin(motion.roll_rad), np.cos(motion.roll_rad)
    sin_p, cos_p = np.sin(motion.pitch_rad), np.cos(motion.pitch_rad)
    roll_rate, pitch_rate = motion.roll_rate_radps, motion.pitch_rate_radps
    level = motion.yaw_rate_radps * cos_p
    level_change = (
        motion.yaw_acceleration_radps2 * cos_p - motion.yaw_rate_radps * pitch_rate * sin_p
    )
    return np.stack(
        [
            motion.roll_acceleration_radps2
            - motion.yaw_acceleration_radps2 * sin_p
            - level * pitch_rate,
            (motion.pitch_acceleration_radps2 + level * roll_rate) * cos_r
            + (level_change - pitch_rate * roll_rate) * sin_r,
            (level_change - pitch_rate * roll_rate) * cos_r
            - (motion.pitch_acceleration_radps2 + level * roll_rate) * sin_r,
        ],
        axis=-1,
    )


class ImuErrors(Struct, frozen=True, kw_only=True):
    """Errors of the inertial axes; docs/theory.md, section 3.9 unless said otherwise."""

    gyro_bias_radps: Vector = (0.0052359, 0.0052359, 0.0052359)
    gyro_noise_radps_rthz: NotNegative = 0.00011344
    """N: deviation of the mean over one second."""
    gyro_instability_radps: NotNegative = 0.000029088
    """B."""
    gyro_instability_time_s: Positive = 100.0
    """T_b, of which the work says nothing; nor does it of the accelerometer's."""
    gyro_walk_radps2_rthz: NotNegative = 0.00007563
    """K."""
    gyro_scale: Vector = (0.0, 0.0, 0.0)
    """Each axis reads so much more than the truth, as a share of it."""
    gyro_cross_axis: float = 0.0
    """Share of each of the other two axes that an axis reads."""
    gyro_scale_per_degc: float = 0.0001
    """Change of scale a degree; 0.01 % in docs/theory.md, section 3.9."""
    gyro_bias_radps_per_degc: float = 0.0
    gyro_radps_per_mps2: Vector = (0.0, 0.0, 0.0)
    """What each axis reads of the specific force along itself (g-sensitivity)."""
    accel_bias_mps2: Vector = (0.1, 0.1, 0.1)
    accel_noise_mps2_rthz: NotNegative = 0.00022563
    accel_instability_mps2: NotNegative = 0.000035316
    accel_instability_time_s: Positive = 100.0
    accel_walk_mps3_rthz: NotNegative = 9e-7
    accel_scale: Vector = (0.0, 0.0, 0.0)
    accel_cross_axis: float = 0.0
    accel_scale_per_degc: float = 0.0001
    accel_bias_mps2_per_degc: float = 0.0
    temperature_degc: float = REFERENCE_DEGC
    """In the end."""
    temperature_start_degc: float | None = None
    """At switching on; None: as in the end."""
    temperature_time_s: Positive = 900.0
    """Of the exponential from start to end."""
    temperature_course: tuple[tuple[NotNegative, float], ...] = ()
    """Instead of that: seconds since switching on and °C, straight between."""


class ImuScales(Struct, frozen=True, kw_only=True):
    """Unit of one count and where counts end; the defaults are the ADIS16465-1's
    (docs/theory.md, section 3.2)."""

    gyro_radps: Positive = math.radians(0.00625)
    accel_mps2: Positive = 0.25e-3 * STANDARD_GRAVITY_MPS2
    temperature_degc: Positive = 0.1
    gyro_range_radps: Positive | None = None
    """To either side; None: what sixteen bits hold."""
    accel_range_mps2: Positive | None = None


class ImuCounts(NamedTuple):
    """What the registers hold, one row a sample: (n, 3), (n, 3), (n,)."""

    gyro: NDArray[np.int32]
    accel: NDArray[np.int32]
    temperature: NDArray[np.int32]


class Imu:
    """Inertial sensor with the errors of docs/theory.md, section 3.1, rounded and saturated."""

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
        self._rate_hz = rate_hz
        unit = np.repeat([scales.gyro_radps, scales.accel_mps2], 3)
        noise = np.repeat([errors.gyro_noise_radps_rthz, errors.accel_noise_mps2_rthz], 3)
        self._bias = np.array([*errors.gyro_bias_radps, *errors.accel_bias_mps2]) / unit
        self._noise = noise * math.sqrt(rate_hz) / unit
        self._gyro = _response(errors.gyro_scale, errors.gyro_cross_axis) / scales.gyro_radps
        self._accel = _response(errors.accel_scale, errors.accel_cross_axis) / scales.accel_mps2
        self._sensitivity = np.array(errors.gyro_radps_per_mps2) / scales.gyro_radps
        per_degc = [errors.gyro_bias_radps_per_degc, errors.accel_bias_mps2_per_degc]
        self._bias_per_degc = np.repeat(per_degc, 3) / unit
        scale_per_degc = [errors.gyro_scale_per_degc, errors.accel_scale_per_degc]
        self._scale_per_degc = np.repeat(scale_per_degc, 3)
        ends = [
            _ends(scales.gyro_range_radps, scales.gyro_radps),
            _ends(scales.accel_range_mps2, scales.accel_mps2),
        ]
        self._low, self._high = np.repeat(np.array(ends, dtype=float), 3, axis=0).T
        self._drift = _Drift(rng.spawn(1)[0], rate_hz, errors, unit)
        self._count = 0

    def measure(self, f_b: ArrayLike, omega_b: ArrayLike) -> ImuCounts:
        """Counts of consecutive samples.

        Parameters
        ----------
        f_b : array_like, shape (n, 3)
            Specific force of the case, m/s².
        omega_b : array_like, shape (n, 3)
            Angular rate of the case, rad/s.
        """
        f_b, omega_b = np.asarray(f_b, dtype=float), np.asarray(omega_b, dtype=float)
        values = np.empty((len(f_b), 6))
        values[:, :3] = omega_b @ self._gyro.T
        values[:, 3:] = f_b @ self._accel.T
        if np.any(self._sensitivity):
            values[:, :3] += f_b * self._sensitivity
        temperature_degc = self._temperature_degc(len(values))
        warmer = temperature_degc[:, None] - REFERENCE_DEGC
        if np.any(warmer):
            values *= 1 + warmer * self._scale_per_degc
            values += warmer * self._bias_per_degc
        values += self._bias
        values += self._drift.next(len(values))
        white = self.rng.standard_normal(values.shape)
        white *= self._noise
        values += white
        np.rint(values, out=values)
        np.clip(values, self._low, self._high, out=values)
        counts = values.astype(np.int32)
        temperature = np.rint(temperature_degc / self.scales.temperature_degc).astype(np.int32)
        self._count += len(values)
        return ImuCounts(counts[:, :3], counts[:, 3:], temperature)

    def _temperature_degc(self, count: int) -> Array:
        end_degc, start_degc = self.errors.temperature_degc, self.errors.temperature_start_degc
        if self.errors.temperature_course:
            time_s = np.arange(self._count, self._count + count) / self._rate_hz
            at_s, course_degc = np.transpose(self.errors.temperature_course)
            course: Array = np.interp(time_s, at_s, course_degc)
            return course
        if start_degc is None or start_degc == end_degc:
            return np.full(count, end_degc)
        time_s = np.arange(self._count, self._count + count) / self._rate_hz
        cooling: Array = np.exp(-time_s / self.errors.temperature_time_s)
        return end_degc + (start_degc - end_degc) * cooling


def _ends(range_: float | None, unit: float) -> tuple[int, int]:
    """Smallest and largest count."""
    if range_ is None:
        return -32768, 32767
    largest = min(int(range_ / unit), 2**31 - 1)  # what a message holds
    return -largest, largest


def _response(scale: Vector, cross_axis: float) -> Array:
    """Reading of three axes per truth, shape (3, 3)."""
    response: Array = np.diag(1 + np.array(scale) - cross_axis) + cross_axis
    return response


def instability_density(instability: float, time_s: float) -> float:
    """S_b of docs/theory.md, section 3.1: density of what drives the Gauss-Markov process."""
    return 2 * instability**2 * math.log(2) / (math.pi * 0.4365**2 * time_s)


class _Drift:
    """z_b + z_k of six axes in counts, drawn at `DRIFT_RATE_HZ` and run straight between."""

    def __init__(self, rng: Generator, rate_hz: float, errors: ImuErrors, unit: Array) -> None:
        self._rng = rng
        self._step = max(round(rate_hz / DRIFT_RATE_HZ), 1)
        period_s = self._step / rate_hz
        walk = np.repeat([errors.gyro_walk_radps2_rthz, errors.accel_walk_mps3_rthz], 3)
        self._walk_step = walk * math.sqrt(period_s) / unit
        time_s = np.array([errors.gyro_instability_time_s, errors.accel_instability_time_s])
        flat = (errors.gyro_instability_radps, errors.accel_instability_mps2)
        density = [instability_density(b, t) for b, t in zip(flat, time_s.tolist(), strict=True)]
        std = np.sqrt(np.array(density) * time_s / 2)  # stationary
        self._keep = np.repeat(np.exp(-period_s / time_s), 3)
        self._drive = np.repeat(std, 3) * np.sqrt(1 - self._keep**2) / unit
        self._unstable = rng.standard_normal(6) * np.repeat(std, 3) / unit
        self._walked = np.zeros(6)
        self._nodes = self._unstable[None]
        self._first_node = self._count = 0

    def next(self, count: int) -> Array:
        """Drift of the next samples, shape (count, 6)."""
        if count == 0:
            return np.zeros((0, 6))
        number = np.arange(self._count, self._count + count)
        node, past = np.divmod(number, self._step)
        self._extend(int(node[0]), int(node[-1]) + 2)
        self._count += count
        node -= self._first_node
        start = self._nodes[node]
        drift: Array = (self._nodes[node + 1] - start) * (past / self._step)[:, None]
        drift += start
        return drift

    def _extend(self, first: int, end: int) -> None:
        """Draw nodes up to `end` and forget those before `first`."""
        missing = end - self._first_node - len(self._nodes)
        noise = self._rng.standard_normal((max(missing, 0), 2, 6))
        rows = [self._nodes[first - self._first_node :]]
        for walk, drive in noise:
            self._walked = self._walked + self._walk_step * walk
            self._unstable = self._keep * self._unstable + self._drive * drive
            rows.append((self._walked + self._unstable)[None])
        self._nodes, self._first_node = np.concatenate(rows), first
