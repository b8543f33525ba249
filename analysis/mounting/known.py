"""What the aligner knows before a ride: from the configuration, and from the readings' scatter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tramstream.analysis.mounting.drive import Array, Drive
from tramstream.analysis.mounting.solve import Known
from tramstream.analysis.mounting.states import Arms, Noise, Prior
from tramstream.config import Imu as ImuSection
from tramstream.config import Vehicle

CROSS_LEVEL_DEG = 0.3
CROSS_LEVEL_M = 50.0
"""How far straight track is from level across, and over which way that is one and the same error:
5 mm of 1.435 m, as track gauges find in service."""
SIDE_MPS, UP_MPS = 0.003, 0.006
"""Least deviations of the speed across at one node: what a bogie plays between the rails."""
ROLL_RAD = 1e-3
LEAN_RAD_PER_MPS2 = 0.15
"""Roll in a curve, a lateral acceleration: a track of 150 mm of cant has 0.1 rad for 0.65 m/s², and
springs add a tenth of that. So straight track tells what is upright, and curves hardly do."""
STILL_MPS = 0.01
PIVOT_STD_M = 3.0
"""Where nobody said where the pivot is; as the localisation filter takes it."""
WHITE_TAU_S = 0.5
"""Errors of fixes that last less are new in each."""
_THIRD = math.sqrt(20.0)
"""Deviation of a third difference of white noise."""
_MAD = 0.6745


class Settings(NamedTuple):
    """What the command line may say."""

    cross_level_deg: float = CROSS_LEVEL_DEG
    cross_level_m: float = CROSS_LEVEL_M
    adapt: bool = True


def known_of(vehicle: Vehicle, drive: Drive, settings: Settings) -> Known:
    """Gather noise, priors and lever arms of a vehicle for one ride."""
    imu = vehicle.imu or ImuSection(device="")
    side = vehicle.ekf.side_slip_std_m_rts / math.sqrt(drive.dt_s)
    up = vehicle.ekf.heave_std_m_rts / math.sqrt(drive.dt_s)
    gnss = vehicle.gnss
    tau_s = gnss.error_tau_s if gnss is not None else WHITE_TAU_S
    lasting = np.zeros(3)
    if tau_s > WHITE_TAU_S and len(drive.fixes.node):
        lasting = np.nan_to_num(np.nanmedian(drive.fixes.p_std_m, axis=0)) / WHITE_SHARE
    noise = Noise(
        accel=white_noise(drive.inertial.f_b, imu.accel_noise_mps2_rthz, drive.dt_s),
        gyro=white_noise(drive.inertial.omega_b, imu.gyro_noise_radps_rthz, drive.dt_s),
        accel_walk=imu.accel_walk_mps3_rthz,
        gyro_walk=imu.gyro_walk_radps2_rthz,
        fix_error_m=lasting,
        fix_error_tau_s=tau_s,
        cross_level_rad=max(math.radians(settings.cross_level_deg), 1e-7),
        cross_level_m=settings.cross_level_m,
        side_mps=max(side, SIDE_MPS),
        up_mps=max(up, UP_MPS),
        roll_rad=ROLL_RAD,
        lean_rad_per_mps2=LEAN_RAD_PER_MPS2,
        still_mps=STILL_MPS,
    )
    return Known(noise, _prior(vehicle, imu), arms_of(vehicle, imu), settings.adapt)


WHITE_SHARE = 0.05
"""Of the error that neighbouring fixes share: how much of it is new in each."""


def _prior(vehicle: Vehicle, imu: ImuSection) -> Prior:
    ekf, gnss = vehicle.ekf, vehicle.gnss
    pivot = ekf.pivot_std_m
    if pivot < 0:
        pivot = 0.0 if ekf.pivot_m or ekf.bogie_distance_m else PIVOT_STD_M
    return Prior(
        accel_bias_mps2=imu.accel_bias_std_mps2,
        gyro_bias_radps=imu.gyro_bias_std_radps,
        wheel_scale=vehicle.wheels.scale_std,
        pivot_m=pivot,
        delay_s=math.hypot(imu.delay_std_s, gnss.delay_std_s if gnss is not None else 0.0),
    )


def arms_of(vehicle: Vehicle, imu: ImuSection) -> Arms:
    """Antenna and pivot from the IMU, in vehicle axes."""
    case = np.array(imu.lever_arm_m, dtype=float)
    antenna = np.array(vehicle.gnss.lever_arm_m if vehicle.gnss is not None else case, dtype=float)
    return Arms(antenna - case, np.array([-vehicle.ekf.pivot_m, 0.0, 0.0]) - case)


def white_noise(readings: Array, configured: float, dt_s: float) -> Array:
    """White noise of each axis of the case: as configured, or as the means scatter if that is more.

    Third differences forget speed, acceleration and jerk, their median forgets jolts. What shakes
    an axis all the time is noise to it.

    Returns
    -------
    density : ndarray, shape (3,)
        Of the quantity over √Hz.
    """
    third = np.diff(readings[:-1], 3, axis=0)
    if not len(third):
        return np.full(3, configured)
    scatter = np.median(np.abs(third), axis=0) / (_MAD * _THIRD)
    found: Array = np.maximum(scatter * math.sqrt(dt_s), configured)
    return found
