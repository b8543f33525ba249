"""How well the filter `tram` knows its states before the first reading."""

from __future__ import annotations

import math

import numpy as np

from tramstream.config import Vehicle, Wheels, map_shift_std_m
from tramstream.estimation.kalman import Array
from tramstream.mounting import about_axes
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.states import Ix

ROLL_STD_RAD = 0.06
"""Cant of 90 mm on 1435 mm, at the start."""
PITCH_STD_RAD = 0.06
"""Grade of 7 % with a margin, at the start."""
GYRO_SCALE_STD = 0.003
"""ADIS16465 data sheet: sensitivity tolerance."""
START_STD_M = 1000.0
"""Position before the first fix."""

PIVOT_STD_M = 3.0
"""Of the pivot of a vehicle whose body nobody has configured: half the distance between the bogies
of a tram; chosen by hand, guarded by `test_bogies_that_nobody_has_configured_are_learned`."""


def pivot_std_m(vehicle: Vehicle) -> float:
    """How well it is known at the start which point of the vehicle does not slip sideways, m."""
    ekf = vehicle.ekf
    if ekf.pivot_std_m >= 0.0:
        return ekf.pivot_std_m
    told = ekf.pivot_m != 0.0 or ekf.bogie_distance_m != 0.0
    return 0.0 if told or vehicle.imu is None or vehicle.gnss is None else PIVOT_STD_M


def first_deviations(vehicle: Vehicle) -> Array:
    """Standard deviations of all states (`Ix`) at the start, shape (32,)."""
    imu, wheels = vehicle.imu, vehicle.wheels
    std = np.zeros(len(Ix))
    std[[Ix.EAST, Ix.NORTH, Ix.UP]] = START_STD_M
    std[Ix.ROLL], std[Ix.PITCH] = ROLL_STD_RAD, PITCH_STD_RAD
    std[[Ix.GYRO_X, Ix.GYRO_Y, Ix.GYRO_Z]] = imu.gyro_bias_std_radps if imu else 0.0
    if imu is not None:
        std[[Ix.ACCEL_X, Ix.ACCEL_Y]] = imu.accel_bias_std_mps2
        if vehicle.ekf.vertical_std_mps2_rthz:
            std[Ix.ACCEL_Z] = imu.accel_bias_std_mps2
        about = about_axes(imu.mounting_std_deg)
        std[[Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = [math.radians(each) for each in about]
        std[Ix.GYRO_SCALE] = GYRO_SCALE_STD
    else:
        std[Ix.GYRO_Z] = wheels.yaw_rate_std_radps
    std[Ix.PIVOT] = pivot_std_m(vehicle)
    std[[Ix.SCALE_A, Ix.SCALE_B]] = wheels.scale_std
    std[Ix.WHEEL_DELAY] = wheels.delay_std_s
    std[[Ix.MAP_EAST, Ix.MAP_NORTH]] = map_shift_std_m(vehicle)
    if vehicle.gnss is not None:
        std[Ix.GNSS_DELAY] = math.hypot(vehicle.gnss.delay_std_s, imu.delay_std_s if imu else 0.0)
    return std


def set_wheel_constant(ekf: TramFilter, wheel: int, name: str, wheels: Wheels) -> None:
    """Begin with what `[wheels.each]` says of a wheel: its own way of a pulse, and how well known.

    Readings are in the way of a pulse that all have; the wheel's own is a scale, which counts
    1 + scale too much.
    """
    known = wheels.each.get(name)
    if known is None:
        return
    slot = Ix.SCALE_A + wheel
    ekf.x[slot, 0] = wheels.m_per_pulse / known.m_per_pulse - 1.0
    ekf.P[slot, :] = ekf.P[:, slot] = 0.0
    ekf.P[slot, slot] = known.scale_std**2
