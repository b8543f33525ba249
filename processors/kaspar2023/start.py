"""How well each state of kaspar2023 is known of a vehicle that stands somewhere."""

from __future__ import annotations

import numpy as np

from tramstream.config import Vehicle
from tramstream.estimation.localiser import Array
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.model import SIZE, Ix
from tramstream.processors.kaspar2023.wheels import MESSAGE_S

START_SPEED_STD_MPS = 0.1
"""The vehicle stands at first; where it does not, the wheels soon say so."""
START_PITCH_STD_RAD = 0.05
"""Trams climb 7 to 8 % at most."""
SCALE_STD = 0.01
"""Of the inertial axes before anything is learned; 1 % bounds the ADIS16465's data sheet."""


def start_std(vehicle: Vehicle) -> Array:
    """Deviations of all states of a vehicle that stands, place and heading being arbitrary."""
    imu, wheels = vehicle.imu, vehicle.wheels
    assert imu is not None  # the localiser has looked
    std = np.zeros(SIZE)
    std[Ix.SPEED] = START_SPEED_STD_MPS
    std[Ix.ACCELERATION] = model.LARGE_ACCELERATION_MPS2
    std[Ix.PITCH] = START_PITCH_STD_RAD
    std[Ix.RATE_X : Ix.RATE_Z + 1] = model.LARGE_RATE_RADPS
    std[Ix.ACCEL_SCALE : Ix.GYRO_SCALE_Z + 1] = SCALE_STD
    std[Ix.ACCEL_WALK] = imu.accel_bias_std_mps2
    std[Ix.GYRO_WALK_X : Ix.GYRO_WALK_Z + 1] = imu.gyro_bias_std_radps
    std[Ix.WHEEL_LEFT] = std[Ix.WHEEL_RIGHT] = wheels.scale_std * MESSAGE_S / wheels.m_per_pulse
    return std
