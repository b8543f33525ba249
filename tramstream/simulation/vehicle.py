"""The vehicle around simulated sensors: its configuration, and fixes as its receiver words them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tramstream import config
from tramstream.clock import S
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.simulation.imu import instability_density
from tramstream.simulation.receiver import GPS_MINUS_UNIX_S
from tramstream.simulation.scenario import Gnss, Imu, Scenario, Wheels, stated_std_m

Array = NDArray[np.float64]

DEVICE = "simulated"
WEEK_MS = 604_800_000
NO_ACCURACY_M = 4_294_967.295
"""What a u-blox receiver states without a fix: its largest number."""
SATELLITES = 18
WINDOW_HZ = 100.0
"""Rate of the resampler unless the scenario says otherwise."""
_LEAST_NOISE = 1e-9
"""A configuration knows no sensor without noise."""
_LEAST_TAU_S = 0.01
"""Of errors that are independent from fix to fix."""
_BIAS_MARGIN = 1.5


def configuration(scenario: Scenario) -> config.Vehicle:
    """Give the configuration of a vehicle with these sensors: what its owner knows of them.

    Noise figures are those of an Allan analysis. Biases, misalignment, lever-arm errors, wheel
    wear and wrong stamps are for the filter to find.
    """
    resampler = scenario.resampler
    if resampler is None:
        rate_hz = scenario.imu.rate_hz if scenario.imu is not None else WINDOW_HZ
        resampler = config.Resampler(factor=max(round(rate_hz / WINDOW_HZ), 1))
    return config.Vehicle(
        vehicle=scenario.vehicle,
        gnss=_gnss(scenario.gnss) if scenario.gnss is not None else None,
        imu=_imu(scenario.imu) if scenario.imu is not None else None,
        odometer=_odometer(scenario.wheels) if scenario.wheels is not None else None,
        wheels=_wheels(scenario.wheels) if scenario.wheels is not None else config.Wheels(),
        resampler=resampler,
        ekf=scenario.ekf,
    )


def _gnss(section: Gnss) -> config.Gnss:
    decay = section.errors.decay
    tau_s = max(-1 / math.log(decay), _LEAST_TAU_S) if decay > 0 else _LEAST_TAU_S
    return config.Gnss(
        device=DEVICE,
        receiver_delay_s=section.timing.latency_s,
        lever_arm_m=section.lever_arm_m,
        error_tau_s=tau_s,
    )


def _imu(section: Imu) -> config.Imu:
    errors = section.errors
    # An unstable bias walks with its driving noise for times below its correlation time.
    gyro = instability_density(errors.gyro_instability_radps, errors.gyro_instability_time_s)
    accel = instability_density(errors.accel_instability_mps2, errors.accel_instability_time_s)
    default = config.Imu(device=DEVICE)
    return config.Imu(
        device=DEVICE,
        rate_hz=section.rate_hz,
        batch=section.batch,
        lever_arm_m=section.lever_arm_m,
        mounting_deg=section.mounting_deg,
        mounting_std_deg=section.mounting_std_deg,
        gyro_noise_radps_rthz=max(errors.gyro_noise_radps_rthz, _LEAST_NOISE),
        gyro_walk_radps2_rthz=math.hypot(errors.gyro_walk_radps2_rthz, gyro**0.5, _LEAST_NOISE),
        accel_noise_mps2_rthz=max(errors.accel_noise_mps2_rthz, _LEAST_NOISE),
        accel_walk_mps3_rthz=math.hypot(errors.accel_walk_mps3_rthz, accel**0.5, _LEAST_NOISE),
        gyro_bias_std_radps=max(
            default.gyro_bias_std_radps, _BIAS_MARGIN * max(map(abs, errors.gyro_bias_radps))
        ),
        accel_bias_std_mps2=max(
            default.accel_bias_std_mps2, _BIAS_MARGIN * max(map(abs, errors.accel_bias_mps2))
        ),
    )


def _odometer(section: Wheels) -> config.Odometer:
    """Signals of the simulated tram's DBC."""
    return config.Odometer(
        interface="virtual",
        channel=DEVICE,
        dbc="tram.dbc",
        wheels={
            side: config.Wheel(message="WHEELS", signal=f"PULSES_{side.upper()}", kind="pulses")
            for side in section.wheels
        },
        doors_open=config.Signal(message="DOORS", signal="DOORS_OPEN") if section.doors else None,
        motor_force_n=(
            config.Signal(message="DRIVE", signal="MOTOR_FORCE") if section.motor_force else None
        ),
    )


def _wheels(section: Wheels) -> config.Wheels:
    return config.Wheels(
        m_per_pulse=section.axle.m_per_pulse,
        track_m=section.axle.track_m,
        bogie=section.bogie,
        delay_s=section.stated_delay_s,
        stamp_std_s=section.timing.stamp_jitter_s,
    )


class FixWriter:
    """Words fixes as the GNSS bridge does, NAV-PVT's or, without velocity, NMEA's.

    Without a fix the receiver repeats its last position and says that it is not valid.
    """

    def __init__(self, section: Gnss, geoid_m: float) -> None:
        self._velocity = section.velocity
        self._speed_std_mps = section.errors.velocity_std_mps
        self._geoid_m = geoid_m
        horizontal, vertical = stated_std_m(section)
        self._stds_m = (math.sqrt(2) * horizontal, vertical)
        self._last: Array | None = None

    def fix(self, geodetic: Array, velocity: Array, epoch_ns: int, lost: bool) -> GnssFix:
        """Word one epoch; stamp and sequence are the caller's.

        Parameters
        ----------
        geodetic : ndarray, shape (3,)
            Latitude, longitude, ellipsoidal height; rad, rad, m.
        velocity : ndarray, shape (3,)
            East, north, up of the place; m/s.
        epoch_ns : int
            True instant, as Unix time.
        lost : bool
            Whether the receiver has no fix.
        """
        gps_ns = epoch_ns + GPS_MINUS_UNIX_S * S
        message = GnssFix(
            source="NAV-PVT" if self._velocity else "NMEA",
            itow_ms=gps_ns // 1_000_000 % WEEK_MS,
            gps_time_ns=gps_ns,
            utc_ns=epoch_ns,
        )
        if not lost:
            self._last = geodetic
        if self._last is not None:
            latitude, longitude, height_m = self._last.tolist()
            message.latitude_deg = math.degrees(latitude)
            message.longitude_deg = math.degrees(longitude)
            message.height_ellipsoid_m = height_m
            message.height_msl_m = height_m - self._geoid_m
        if lost:
            message.fix_type = GnssFix.NO_FIX
            message.invalid_llh = True
            message.horizontal_std_m = message.vertical_std_m = NO_ACCURACY_M
            return message
        message.fix_type, message.valid = GnssFix.FIX_3D, True
        message.satellites_used, message.pdop = SATELLITES, 1.3
        message.horizontal_std_m, message.vertical_std_m = self._stds_m
        if self._velocity:
            east, north, up = velocity.tolist()
            speed = math.hypot(east, north)
            message.vel_n_mps, message.vel_e_mps, message.vel_d_mps = north, east, -up
            message.speed_mps, message.speed_std_mps = speed, self._speed_std_mps
            message.course_deg = math.degrees(math.atan2(east, north)) % 360
            message.course_std_deg = math.degrees(math.atan2(self._speed_std_mps, speed))
        return message
