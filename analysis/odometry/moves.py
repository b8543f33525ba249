"""Whether the IMU was moved within a ride: the live check's detector over the whole of a record."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.material import Ride, WheelWay
from tramstream.analysis.odometry.ways import Way, gathered
from tramstream.mounting import matrix_of
from tramstream.processors.consistency.moved import Change, Moved, MovedMemory
from tramstream.processors.consistency.way import Course

Array = NDArray[np.float64]

SPAN_S = 26.0
"""Of the way that the detector is shown."""


def changes_in(
    ride: Ride,
    start_s: float = 0.0,
    end_s: float = math.inf,
    wheels: tuple[WheelWay, ...] | None = None,
) -> list[Change]:
    """All instants at which the case was turned, between two of the ride.

    Parameters
    ----------
    ride : Ride
    start_s, end_s : float
    wheels : tuple of WheelWay, optional
        On the IMU's clock; by default as they are.
    """
    if ride.vehicle.imu is None or not len(ride.imu.time_s):
        return []
    way = Way(wheels or ride.wheels)
    first, last = way.span
    time_s = np.arange(first, last, 0.1)
    gone = way.at(time_s)
    detector = Moved(ride.vehicle.imu, MovedMemory())
    found = []
    for at_s, mean, still in gathered(ride.imu, way):
        if not start_s < at_s < min(end_s, last):
            continue
        low, high = np.searchsorted(time_s, [at_s - SPAN_S, at_s + 1e-6]).tolist()
        rows = np.stack([time_s[low:high], gone[low:high]], axis=1)
        change = detector.take(at_s, mean, still, Course(rows))
        if change is not None:
            found.append(change)
    return found


def moved_at(ride: Ride, at_s: float, turn_b: Array) -> Ride:
    """The ride with its IMU turned from an instant on: rotation vector in its case, rad."""
    half = 0.5 * float(np.linalg.norm(turn_b))
    x, y, z = (turn_b * (0.5 * np.sinc(half / np.pi))).tolist()
    R = np.array(matrix_of((math.cos(half), x, y, z)))
    later = ride.imu.time_s > at_s
    imu = ride.imu
    force, rate = imu.force_mps2.copy(), imu.rate_radps.copy()
    force[later] = force[later] @ R  # what is read turns the other way: Rᵀ f
    rate[later] = rate[later] @ R
    return replace(ride, imu=replace(imu, force_mps2=force, rate_radps=rate))
