"""What a GNSS receiver on a ride measures: position and velocity of its antenna.

The receiver is fed the truth of consecutive epochs in blocks of any size and remembers what one
block hands to the next, so that the cut into blocks does not show in what it measures.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream.attitude import C_vl, body_rates
from tramstream.clock import GPS_EPOCH_UNIX_S
from tramstream.config import NotNegative, Positive, Struct, Vector
from tramstream.simulation.ride import Motion

Array = NDArray[np.float64]

LEAP_SECONDS = 18
"""GPS time is ahead of UTC by so much since 2017."""
GPS_MINUS_UNIX_S = LEAP_SECONDS - GPS_EPOCH_UNIX_S


class Correlated(Struct, frozen=True, kw_only=True):
    """A part of the fixes' errors that lasts its own time."""

    horizontal_std_m: NotNegative = 0.0
    """Stationary, per axis."""
    vertical_std_m: NotNegative = 0.0
    time_s: Positive = 600.0
    """After which 1/e of it is left."""


class GnssErrors(Struct, frozen=True, kw_only=True):
    """Errors of the fixes; docs/theory.md, section 3.4 with its reading of the reference."""

    horizontal_std_m: NotNegative = 0.5
    """Stationary, per axis."""
    vertical_std_m: NotNegative = 1.0
    decay: Annotated[float, Meta(ge=0, lt=1)] = 0.95
    """Correlation of an axis' error with itself one second later."""
    white_horizontal_std_m: NotNegative = 0.0
    """Per axis, independent from epoch to epoch, on top."""
    white_vertical_std_m: NotNegative = 0.0
    white_dof: Annotated[float, Meta(gt=2)] | None = None
    """Degrees of freedom of Student's t that these follow, with the same deviation: the fewer, the
    heavier its tails; None: they are normal."""
    correlated: tuple[Correlated, ...] = ()
    """More parts, beside the one that `decay` is of."""
    standing_drift_mps: NotNegative = 0.0
    """Deviation of the speed, per horizontal axis, at which a fix wanders off while the antenna
    stands; drawn at each stop, and forgotten with `decay` once the antenna moves."""
    velocity_std_mps: NotNegative = 0.05
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
        self._white_std = np.array(
            [errors.white_horizontal_std_m] * 2 + [errors.white_vertical_std_m]
        )
        self._keep = errors.decay ** (1 / rate_hz)
        self._drive = self._std * math.sqrt(1 - self._keep**2)
        self._error_l: Array | None = None
        parts_rng, self._tails_rng = rng.spawn(2)
        self._parts = [_Part(each, rate_hz, parts_rng) for each in errors.correlated]
        self._wander_step = np.array([1.0, 1.0, 0.0]) * errors.standing_drift_mps / rate_hz
        self._wandered_l = np.zeros(3)
        self._wandering_l: Array | None = None  # a step of the stop that lasts

    def measure(self, p_l: ArrayLike, motion: Motion) -> Fixes:
        """Fixes of consecutive epochs.

        Parameters
        ----------
        p_l : array_like, shape (n, 3)
            True position of the vehicle's origin, m.
        motion : Motion
            At the same instants.
        """
        antenna = antenna_motion(np.asarray(p_l, dtype=float), motion, self._p_va_v)
        return self.measured(*antenna, motion.standing)

    def measured(self, antenna: Array, velocity: Array, standing: NDArray[np.bool_]) -> Fixes:
        """Fixes of consecutive epochs out of the antenna's own motion.

        Parameters
        ----------
        antenna, velocity : ndarray, shape (n, 3)
            In `l`, m and m/s.
        standing : ndarray, shape (n,)
        """
        noise = self.rng.standard_normal((len(antenna), 4, 3))
        errors = self._correlated_l(noise[:, 0])
        if np.any(self._wander_step):
            errors += self._wander_l(noise[:, 3], standing)
        errors += self._white_std * self._tailed(noise[:, 2])
        for part in self._parts:
            errors += part.next(len(errors))
        return Fixes(antenna + errors, velocity + self.errors.velocity_std_mps * noise[:, 1])

    def _correlated_l(self, noise: Array) -> Array:
        errors = np.empty_like(noise)
        for row, drawn in enumerate(noise):
            if self._error_l is None:
                self._error_l = self._std * drawn
            else:
                self._error_l = self._keep * self._error_l + self._drive * drawn
            errors[row] = self._error_l
        return errors

    def _tailed(self, noise: Array) -> Array:
        """Normal noise as Student's t of the same deviation."""
        dof = self.errors.white_dof
        if dof is None:
            return noise
        tailed: Array = noise * np.sqrt((dof - 2) / self._tails_rng.chisquare(dof, noise.shape))
        return tailed

    def _wander_l(self, noise: Array, standing: NDArray[np.bool_]) -> Array:
        wandered = np.empty_like(noise)
        for row, (drawn, stands) in enumerate(zip(noise, standing.tolist(), strict=True)):
            if not stands:
                self._wandering_l = None
                self._wandered_l = self._keep * self._wandered_l
            else:
                if self._wandering_l is None:
                    self._wandering_l = self._wander_step * drawn
                self._wandered_l = self._wandered_l + self._wandering_l
            wandered[row] = self._wandered_l
        return wandered


class _Part:
    """One more Gauss-Markov error."""

    def __init__(self, of: Correlated, rate_hz: float, rng: Generator) -> None:
        self._rng = rng
        self._std = np.array([of.horizontal_std_m, of.horizontal_std_m, of.vertical_std_m])
        self._keep = math.exp(-1 / (rate_hz * of.time_s))
        self._error_l = self._std * rng.standard_normal(3)

    def next(self, count: int) -> Array:
        """Errors of the next epochs, (count, 3)."""
        drive = self._std * math.sqrt(1 - self._keep**2)
        errors = np.empty((count, 3))
        for row, drawn in enumerate(self._rng.standard_normal((count, 3))):
            errors[row] = self._error_l
            self._error_l = self._keep * self._error_l + drive * drawn
        return errors


def antenna_motion(p_l: Array, motion: Motion, p_va_v: Array) -> tuple[Array, Array]:
    """Give position and velocity in `l` of a point fixed to the vehicle.

    p_a = p + C_lv p_va, v_a = C_lv (v + ω × p_va); docs/theory.md, section 1.4.

    Returns
    -------
    p_a_l, vel_a_l : ndarray, shape (n, 3)
    """
    turn = C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    rates = (motion.roll_rate_radps, motion.pitch_rate_radps, motion.yaw_rate_radps)
    omega_v = np.stack(body_rates(motion.roll_rad, motion.pitch_rad, rates), axis=-1)
    velocity_v = np.cross(omega_v, p_va_v)
    velocity_v[..., 0] += motion.speed_mps
    return (
        p_l + np.einsum("...vl,v->...l", turn, p_va_v),
        np.einsum("...vl,...v->...l", turn, velocity_v),
    )
