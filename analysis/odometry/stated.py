"""What is known beforehand: noise of the sensors as the configuration has it, and wide priors."""

from __future__ import annotations

from typing import NamedTuple

from tramstream.config import Vehicle
from tramstream.processors.tram_sources.fix_noise import WHITE_SHARE

SLOW_S = 600.0
"""How long the slow part of the fixes' error lasts (docs/theory.md, section 6.3)."""
SCALE_STD = 0.15
"""Of a wheel; nothing that is configured in earnest is further off."""
GYRO_SCALE_STD = 0.01
ANTENNA_STD_M = 15.0
DELAY_STD_S = 2.0
"""About what the search for clocks has found."""
TRACK_STD = 0.003
"""Of the distance of the wheels' treads, as a part: they run on cones."""
CREEP_M_RTM = 0.00002
SIDE_M_RTS = 0.001
"""Way to the side after a second, which walks: the rail is not where the axis points."""
SPEED_READING = 0.01
"""Deviation of the way of a wheel that gives a speed, m after a second."""


class Stated(NamedTuple):
    """Deviations in SI."""

    error_tau_s: float
    gyro_noise: float
    gyro_walk: float
    gyro_bias: float
    creep: float
    """Of one wheel, m after a metre."""
    side: float
    reading: float
    """Of the way between two nodes by one wheel's readings, m. Rounding does not add up, for the
    remainder is carried on: little of it is left to be taken for a walk."""
    track_m: float
    white_share: float = WHITE_SHARE


def stated_of(vehicle: Vehicle) -> Stated:
    """Of a configuration."""
    imu, gnss, wheels = vehicle.imu, vehicle.gnss, vehicle.wheels
    odometer = vehicle.odometer
    speeds = odometer is not None and all(each.kind == "speed" for each in odometer.wheels.values())
    return Stated(
        error_tau_s=gnss.error_tau_s if gnss is not None else 20.0,
        gyro_noise=imu.gyro_noise_radps_rthz if imu is not None else 1e-3,
        gyro_walk=imu.gyro_walk_radps2_rthz if imu is not None else 1e-4,
        gyro_bias=imu.gyro_bias_std_radps if imu is not None else 0.01,
        creep=max(vehicle.ekf.wheel_creep_m_rtm, CREEP_M_RTM),
        side=max(vehicle.ekf.side_slip_std_m_rts, SIDE_M_RTS),
        reading=SPEED_READING if speeds else 0.1 * wheels.m_per_pulse,
        track_m=wheels.track_m,
    )
