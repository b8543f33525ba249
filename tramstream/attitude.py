"""Attitude: yaw, pitch and roll, the turns that they make, and the rates that belong to them.

Rotations z, then y', then x'' (docs/theory.md, section 1.2): yaw counter-clockwise from east,
pitch positive nose down, roll positive right side down. The mounting of an IMU, Ψ = roll, pitch,
yaw of the case, is the same turn: `C_bv(Ψ)` is `C_vl` of these angles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream import mounting
from tramstream.config import Imu

Array = NDArray[np.float64]


def C_vl(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Array:
    """Turn of components in `l` into those in `v`; docs/theory.md, section 1.2.

    Parameters
    ----------
    roll_rad, pitch_rad, yaw_rad : array_like, shape () or (n,)

    Returns
    -------
    C_vl : ndarray, shape (3, 3) or (n, 3, 3)
    """
    roll, pitch, yaw = np.broadcast_arrays(roll_rad, pitch_rad, yaw_rad)
    sin_r, cos_r = np.sin(roll), np.cos(roll)
    sin_p, cos_p = np.sin(pitch), np.cos(pitch)
    sin_y, cos_y = np.sin(yaw), np.cos(yaw)
    rows = [
        [cos_p * cos_y, cos_p * sin_y, -sin_p],
        [
            -cos_r * sin_y + cos_y * sin_r * sin_p,
            cos_r * cos_y + sin_r * sin_p * sin_y,
            cos_p * sin_r,
        ],
        [
            sin_r * sin_y + cos_r * cos_y * sin_p,
            -cos_y * sin_r + cos_r * sin_p * sin_y,
            cos_p * cos_r,
        ],
    ]
    matrix: Array = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    return matrix


def C_bv_of(imu: Imu | None) -> Array:
    """Turn of components in `v` into those in the case, as configured; as it is without an IMU.

    Returns
    -------
    C_bv : ndarray, shape (3, 3)
    """
    if imu is not None and imu.mounting_q_bv:
        return np.array(mounting.matrix_of(mounting.unit(imu.mounting_q_bv)))
    return C_vl(*np.radians(imu.mounting_deg if imu is not None else (0.0, 0.0, 0.0)))


def body_rates(
    roll_rad: Array, pitch_rad: Array, rates: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Angular rate in `v` of the rates of roll, pitch and yaw; docs/theory.md, section 1.3.

    Returns
    -------
    omega_x, omega_y, omega_z : ndarray
        rad/s.
    """
    roll_rate, pitch_rate, yaw_rate = rates
    sin_r, cos_r = np.sin(roll_rad), np.cos(roll_rad)
    level = yaw_rate * np.cos(pitch_rad)
    return (
        roll_rate - yaw_rate * np.sin(pitch_rad),
        pitch_rate * cos_r + level * sin_r,
        level * cos_r - pitch_rate * sin_r,
    )


def euler_rates(
    roll_rad: Array, pitch_rad: Array, omega_v: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Rates of roll, pitch and yaw of an angular rate in `v`; docs/theory.md, section 1.3.

    Returns
    -------
    roll_rate, pitch_rate, yaw_rate : ndarray
        rad/s; nothing at a pitch of ±90°.
    """
    omega_x, omega_y, omega_z = omega_v
    sin_r, cos_r = np.sin(roll_rad), np.cos(roll_rad)
    turning = sin_r * omega_y + cos_r * omega_z
    return (
        omega_x + np.tan(pitch_rad) * turning,
        cos_r * omega_y - sin_r * omega_z,
        turning / np.cos(pitch_rad),
    )
