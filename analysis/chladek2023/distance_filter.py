"""The distance-domain EKF of chladek2023 on filterpy, and the same for many rides side by side.

States (v, z, α), one step a cell of Δs:

    v += Δs (F/(m v) − c_d v − g (c_r + sin α)/v),    z += Δs sin α,    α stays

with c_d = ½ c_w A ρ / m. Speed and height are measured. Q is the unit matrix; of it and R only the
ratios matter. A vehicle that stands has no steps in the distance domain: v must not be 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from tramstream.analysis.chladek2023.ride import (
    CELL_M,
    GRAVITY_MPS2,
    VEHICLE,
    Array,
    Rides,
)

SINGLE_R = (1.5e6, 9e5)
"""R of speed and height for one ride,"""
SEVERAL_R = (15000.0, 9000.0)
"""and where the mean of several is taken."""
H: Array = np.eye(2, 3)


class DistanceFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF with the model of the work; `u` is the force over the cell, N."""

    def __init__(self, speed_mps: float, height_m: float, R: tuple[float, float]) -> None:
        super().__init__(dim_x=3, dim_z=2)
        self.x = np.array([[speed_mps], [height_m], [0.0]])
        self.R = np.diag(R)

    def predict(self, u: float = 0.0) -> None:
        """Go one cell on."""
        speed, _, grade = self.x.ravel().tolist()
        self.F = _jacobian(np.array(speed), np.array(grade), np.array(u))
        super().predict(u)

    def predict_x(self, u: float = 0.0) -> None:
        speed, _, grade = self.x.ravel().tolist()
        change, rise = _moved(np.array(speed), np.array(grade), np.array(u))
        self.x = self.x + np.array([[float(change)], [float(rise)], [0.0]])


def filtered(rides: Rides, R: tuple[float, float]) -> Array:
    """Slopes that filterpy's filter says of one ride at the edges of its cells, (n + 1,)."""
    speed, height = rides.measured_speed_mps[0], rides.measured_height_m[0]
    ekf = DistanceFilter(float(speed[0]), float(height[0]), R)
    said = np.zeros(len(speed))
    for cell, force in enumerate(rides.force_n[0].tolist()):
        ekf.predict(force)
        z = np.array([[speed[cell + 1]], [height[cell + 1]]])
        ekf.update(z, lambda x: H, lambda x: x[:2])
        said[cell + 1] = ekf.x[2, 0]
    return said


def filtered_together(rides: Rides, R: tuple[float, float]) -> Array:
    """Slopes of many rides, (rides, n + 1): the same filter, stepped for all of them at once."""
    count, edges = rides.measured_speed_mps.shape
    x = np.zeros((count, 3))
    x[:, 0], x[:, 1] = rides.measured_speed_mps[:, 0], rides.measured_height_m[:, 0]
    P = np.broadcast_to(np.eye(3), (count, 3, 3))
    said = np.zeros((count, edges))
    noise: Any = np.diag(R)
    z = np.stack([rides.measured_speed_mps, rides.measured_height_m], axis=2)
    for cell in range(edges - 1):
        force = rides.force_n[:, cell]
        F = _jacobian(x[:, 0], x[:, 2], force)
        change, rise = _moved(x[:, 0], x[:, 2], force)
        x[:, 0] += change
        x[:, 1] += rise
        P = F @ P @ F.swapaxes(1, 2) + np.eye(3)
        S = P[:, :2, :2] + noise
        K = np.linalg.solve(S, P[:, :2, :]).swapaxes(1, 2)
        x += (K @ (z[:, cell + 1] - x[:, :2])[:, :, None])[:, :, 0]
        P = P - K @ P[:, :2, :]
        said[:, cell + 1] = x[:, 2]
    return said


def _moved(speed_mps: Array, grade_rad: Array, force_n: Array) -> tuple[Array, Array]:
    """Change of speed and height over a cell."""
    acceleration = VEHICLE.acceleration_mps2(force_n, speed_mps, grade_rad)
    return CELL_M * acceleration / speed_mps, CELL_M * np.sin(grade_rad)


def _jacobian(speed_mps: Array, grade_rad: Array, force_n: Array) -> Array:
    """F of `_moved`, (…, 3, 3)."""
    steady = force_n / VEHICLE.mass_kg - GRAVITY_MPS2 * (VEHICLE.rolling + np.sin(grade_rad))
    F = np.broadcast_to(np.eye(3), (*np.shape(speed_mps), 3, 3)).copy()
    F[..., 0, 0] -= CELL_M * (steady / speed_mps**2 + VEHICLE.drag_per_m)
    F[..., 0, 2] = -CELL_M * GRAVITY_MPS2 * np.cos(grade_rad) / speed_mps
    F[..., 1, 2] = CELL_M * np.cos(grade_rad)
    return F


def running_means(slopes: Array) -> Array:
    """Means by position of the first ride, the first two, the first three …, (rides, n + 1)."""
    counts = np.arange(1, len(slopes) + 1)[:, None]
    means: Array = np.cumsum(slopes, axis=0) / counts
    return means
