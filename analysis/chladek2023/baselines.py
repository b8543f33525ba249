"""Slopes without a model of the vehicle: the three ways that chladek2023 sets out from.

They have what the work's estimators have, and the sensors that they need beside: a receiver with
the velocity noise of scenario `chladek2023`, accelerometer and gyroscope of `kaspar2023`.
"""

from __future__ import annotations

import numpy as np

from tramstream.analysis.chladek2023 import observer
from tramstream.analysis.chladek2023.ride import GRAVITY_MPS2, STEP_S, Array, Drive, Profile
from tramstream.lines import geojson
from tramstream.simulation import scenario

SETTLING_S = 8.0
"""Time constant of the complementary filter, where the speed's walk through the accelerometer and
the gyroscope's own walk err alike. Chosen by hand; the work names none."""


def velocity_ratio(
    profile: Profile, driven: Drive, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Vertical over horizontal velocity of a receiver, fix by fix; estimate and truth."""
    gnss = scenario.load("chladek2023").gnss
    assert gnss is not None
    every = round(1.0 / (gnss.rate_hz * STEP_S))
    way, speed = driven.way_m[::every, 0], driven.speed_mps[::every, 0]
    truth = np.interp(way, profile.way_m, profile.grade_rad)
    std = gnss.errors.velocity_std_mps
    up = speed * np.sin(truth) + rng.normal(0.0, std, len(speed))
    level = speed * np.cos(truth) + rng.normal(0.0, std, len(speed))
    return np.arctan2(up, level), truth


def complementary(
    profile: Profile, driven: Drive, rng: np.random.Generator, biased: bool
) -> tuple[Array, Array]:
    """Slope (f_x − dv/dt)/g, slow, and the gyroscope's pitch rate, fast; estimate and truth.

    The bias of the gyroscope is taken out at a stand. That of the accelerometer cannot be, for
    the slope on which the vehicle stands is not known; `biased` leaves it in.
    """
    imu = scenario.load("kaspar2023").imu
    assert imu is not None
    errors = imu.errors
    way, speed = driven.way_m[:, 0], driven.speed_mps[:, 0]
    truth = np.interp(way, profile.way_m, profile.grade_rad)
    count = len(way) - 1
    measured = speed + observer.walk(len(speed), rng)
    white = rng.normal(0.0, STEP_S**-0.5, (3, count))
    middle = np.sin((truth[1:] + truth[:-1]) / 2)
    force = (
        np.diff(speed) / STEP_S + GRAVITY_MPS2 * middle + errors.accel_noise_mps2_rthz * white[0]
    )
    force += errors.accel_bias_mps2[0] if biased else 0.0
    slow = (force - np.diff(measured) / STEP_S) / GRAVITY_MPS2
    bias = np.cumsum(errors.gyro_walk_radps2_rthz * white[1] * STEP_S)
    turned = np.diff(truth) + (errors.gyro_noise_radps_rthz * white[2] + bias) * STEP_S
    said = np.empty(count)
    grade, share = 0.0, STEP_S / SETTLING_S
    for step, (of_force, turn) in enumerate(zip(slow.tolist(), turned.tolist(), strict=True)):
        grade += turn + share * (of_force - grade)
        said[step] = grade
    return said, truth[1:]


def raster_slope(source: str, profile: Profile) -> Array:
    """Differences of a map's heights, as SRTM has them, at the edges of the cells."""
    track = geojson.read(source)
    height = np.interp(profile.way_m, geojson.chainage_m(track), track.geodetic[:, 2])
    slope: Array = np.arctan(np.gradient(height, profile.way_m))
    return slope
