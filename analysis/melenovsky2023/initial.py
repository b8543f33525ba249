"""Initial estimate of melenovsky2023: algorithm 1 while standing, algorithm 2 while speeding up.

docs/theory.md, section 19.5. The work's (5.6a) is taken with f_y, and z-scores are of the residuals
to the circular mean: at ±180° those of angles throw away good samples. Windows and limits are not
printed in the work; ours are named here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tramstream.analysis.mounting.drive import Drive
from tramstream.attitude import C_vl

Array = NDArray[np.float64]

MEDIAN_S = 5.0
"""Moving median."""
Z_MAX = 2.0
"""A sample whose residual is larger, in deviations, is dropped."""
LEAST_MPS2 = 0.5
"""a_min: horizontal force that tells a direction."""
MOST_RADPS = 0.03
"""ω_max: a curve presses sideways."""
STANDING_MPS = 0.5
FEWEST = 10


class Initial(NamedTuple):
    """Roll, pitch, yaw of the case, rad; NaN without samples."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    standing: int
    """Samples that were used for roll and pitch."""
    pressed: int
    """Samples that were used for yaw."""

    @property
    def C_vb(self) -> Array:
        """The same turn, (3, 3)."""
        found: Array = C_vl(self.roll_rad, self.pitch_rad, self.yaw_rad).T
        return found


def circular_mean(angles_rad: Array) -> float:
    """Direction of the sum of unit vectors."""
    return float(np.angle(np.sum(np.exp(1j * angles_rad))))


def without_outliers(angles_rad: Array, z_max: float = Z_MAX) -> Array:
    """Angles whose residual to the circular mean is not above so many deviations."""
    residual = np.angle(np.exp(1j * (angles_rad - circular_mean(angles_rad))))
    spread = float(np.sqrt(np.mean(residual**2)))
    kept: Array = angles_rad[np.abs(residual) <= z_max * max(spread, 1e-12)]
    return kept


def level(f_b: Array) -> tuple[float, float]:
    """Algorithm 1: roll and pitch out of forces at a stand, (n, 3)."""
    roll = np.arctan2(f_b[:, 1], f_b[:, 2])
    pitch = -np.arctan(f_b[:, 0] / np.hypot(f_b[:, 1], f_b[:, 2]))
    return circular_mean(without_outliers(roll)), circular_mean(without_outliers(pitch))


def heading(
    f_b: Array, accelerating: NDArray[np.bool_], roll_rad: float, pitch_rad: float
) -> float:
    """Algorithm 2: yaw out of forces while the speed changes, (n, 3)."""
    f = f_b @ C_vl(roll_rad, pitch_rad, 0.0)
    pressed = np.arctan2(f[:, 1], f[:, 0])
    return circular_mean(without_outliers(np.where(accelerating, -pressed, np.pi - pressed)))


def acceleration(speed_mps: Array, dt_s: float) -> Array:
    """Central difference of the fourth order; zero at the ends."""
    found = np.zeros_like(speed_mps)
    near, far = speed_mps[3:-1] - speed_mps[1:-3], speed_mps[4:] - speed_mps[:-4]
    found[2:-2] = (8 * near - far) / (12 * dt_s)
    return found


def initial(drive: Drive) -> Initial:
    """Both algorithms on one ride."""
    window = round(MEDIAN_S / drive.dt_s)
    f_b = median_filter(drive.inertial.f_b, size=(window, 1), mode="nearest")
    omega_b = median_filter(drive.inertial.omega_b, size=(window, 1), mode="nearest")
    count = drive.length
    velocity = [np.interp(np.arange(count), drive.fixes.node, v) for v in drive.fixes.vel_l.T]
    speed = median_filter(np.hypot(velocity[0], velocity[1]), size=window, mode="nearest")
    stands = speed < STANDING_MPS + _floor(drive)
    if stands.sum() < FEWEST:
        return Initial(np.nan, np.nan, np.nan, int(stands.sum()), 0)
    roll, pitch = level(f_b[stands])
    turn = C_vl(roll, pitch, 0.0)
    levelled, rates = f_b @ turn, omega_b @ turn
    gained = acceleration(speed, drive.dt_s)
    gained = median_filter(gained, size=window, mode="nearest")
    chosen = (
        (np.hypot(levelled[:, 0], levelled[:, 1]) >= LEAST_MPS2)
        & (np.abs(rates[:, 2]) <= MOST_RADPS)
        & ~stands
    )
    if chosen.sum() < FEWEST:
        return Initial(roll, pitch, np.nan, int(stands.sum()), int(chosen.sum()))
    yaw = heading(f_b[chosen], gained[chosen] > 0, roll, pitch)
    return Initial(roll, pitch, yaw, int(stands.sum()), int(chosen.sum()))


def _floor(drive: Drive) -> float:
    """Speed that the receiver's noise makes of a stand: the mean of a Rayleigh distribution."""
    return 1.25 * float(np.median(drive.fixes.vel_std_mps)) if len(drive.fixes.node) else 0.0
