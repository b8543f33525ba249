"""What the kernels of the model `tram` take: parameters, situation, inertial readings, memory.

Three things, three owners: `Parameters` come out of the configuration and are frozen. `Situation`
is what depends on how the vehicle goes (its heading known or not, what drives the motion, which
wheels there are): the filter changes it, on its owner's word. `Memory` is the state with all that
the kernels leave of a step; only kernels write into it, and the filter's own methods.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import numpy as np

from tramstream.config import Vehicle, map_shift_std_m
from tramstream.estimation.kalman import Array, Indices
from tramstream.estimation.records import Records, dtype_of, one
from tramstream.processors.tram_model.states import ENTRY_COUNT, SIZE

X, Y, Z = range(3)
"""Axes of a vector resolved in the vehicle's frame `v`: forward, left, up."""
LEFT, RIGHT = range(2)
"""Slots of the two wheels; where no wheel tells its side, the first two that were read."""
EARTH_RADIUS_M = 6_371_000.0
READING_S = 0.01
"""Time that one inertial mean of the fusion horizon lasts."""
MOST_ROWS = 3
"""Most scalars that one measurement has."""
ROW_LENGTH = 10
"""Most entries that a row of H has."""


class Parameters(Protocol):
    """Constants of the model, SI; densities are one-sided, variance times seconds."""

    gravity: float
    """Normal gravity at the place, m/s²."""
    earth_curvature: float
    """One over the Earth's radius, 1/m."""
    imu_lever: Annotated[Array, (3,)]
    """From the vehicle's origin to the case of the inertial sensor, resolved in v, m."""
    antenna_lever: Annotated[Array, (3,)]
    """From the vehicle's origin to the antenna, resolved in v, m."""
    half_base: float
    """Half the distance of the two bogies' pivots; 0 where the body's axis follows the rail, m."""
    wheel_bogie: float
    """How far ahead of the body's middle the bogie of the wheels is; 0 if that is not known, m."""
    gyro_aliasing: float
    """Density of the angles' noise over the scatter of the readings, s."""
    accel_aliasing: float
    """Likewise of the speed's."""
    gyro_walk: float
    """K² of the gyroscopes' biases, (rad/s)²/s."""
    accel_walk: float
    """K² of the accelerometers' biases, (m/s²)²/s."""
    creep_density: float
    """Creep of a wheel: variance of its path a metre, m."""
    scale_walk: float
    """Variance of a wheel's scale a metre, 1/m."""
    lateral_variance: float
    """Of the lateral specific force over one reading, (m/s²)²."""
    rate_variance: float
    """Of one rate reading by the sensor's white noise, (rad/s)²."""
    side_density: float
    """Slip of the pivot to the side, m²/s."""
    heave_density: float
    """Heaving of the pivot, m²/s."""
    heave_variance: float
    """Of w = 0 at one reading, (m/s)²."""
    vertical_density: float
    """Noise of the vertical specific force, (m/s²)²/Hz; 0: it is not used."""
    clock_share: float
    """Part of the fixes' delay by which the inertial stamps are too early."""
    map_variance: float
    """Of what a map may be beside the rails as a whole, on each axis, m²; 0: it is not, or none."""


class Situation(Protocol):
    """What depends on how the vehicle goes; see `processors/tram_sources/coasting.py`."""

    heading_known: int
    """0 while it is not: positions are then the antenna's, and yaw is 0."""
    accel_density: float
    """Noise of what drives the speed, N² of the accelerometer along x, (m/s²)²/Hz."""
    rate_density: Annotated[Array, (3,)]
    """Noise of what drives the attitude, N² of the gyroscopes, (rad/s)²/Hz."""
    fix_decay: float
    """1/τ of the fixes' error; 0 before the first fix, 1/s."""
    fix_density: float
    """Driving noise of the fixes' error on each horizontal axis, m²/s."""
    fix_up_density: float
    """Driving noise of the fixes' error in height, m²/s."""
    slow_decay: float
    """1/τ of the part of the fixes' error that lasts for many minutes, 1/s."""
    slow_density: float
    """Driving noise of that part on each horizontal axis, m²/s."""
    wheel_offset: Annotated[Array, (2,)]
    """Of each wheel to the left of the vehicle's axis, m."""
    wheel_sign: Annotated[Array, (2,)]
    """−1 where a wheel counts up while the vehicle runs backwards."""


class Reading(Protocol):
    """One inertial reading, turned into v by the configured mounting."""

    angular_rate: Annotated[Array, (3,)]
    """rad/s."""
    specific_force: Annotated[Array, (3,)]
    """m/s²."""
    angular_acceleration: Annotated[Array, (3,)]
    """Smoothed, rad/s²."""
    rate_scatter: Annotated[Array, (3,)]
    """Variance of a rate, by what neighbouring readings differ, (rad/s)²."""
    force_scatter: Annotated[Array, (3,)]
    """Likewise of a specific force, (m/s²)²."""
    accelerometer: float
    """1 if there is one, 0 if the speed is left to itself."""


class Inertial(Protocol):
    """Readings as they follow each other, and what is smoothed over them."""

    before: Reading
    now: Reading
    between: Reading
    """Mean of both: what acts between them."""
    smoothed_rate: Annotated[Array, (3,)]
    """Angular rates of which the angular acceleration is the slope, rad/s."""
    steady_rate: Annotated[Array, (3,)]
    """Smoothed angular rates up to the reading before, for rows of H, rad/s."""
    straight: float
    """Readings in a row of which each lies on the straight line through the two before it."""
    read: Annotated[Array, (6,)]
    """The newest reading as the case gave it: rates, rad/s, and specific forces, m/s²."""
    repeats: Annotated[Array, (6,)]
    """How often in a row each axis has given the same number again."""
    varied: Annotated[Array, (6,)]
    """How often each axis has given another number than before."""
    longest: Annotated[Array, (6,)]
    """Most repeats in a row that each axis has ended by itself."""
    stuck: float
    """1 while an axis is taken not to live, and until all have lived for a while; else 0."""
    lived: float
    """Readings in a row in which all axes live, while `stuck`."""


class Memory(Protocol):
    """State and covariance, and what the last step and the last measurement left."""

    x: Annotated[Array, (SIZE,)]
    P: Annotated[Array, (SIZE, SIZE)]
    acceleration: float
    """v̇ of the last prediction, m/s²."""
    yaw_rate: float
    """ψ̇ of the last prediction, rad/s."""
    bogie_angle: float
    """By which the bogie of the wheels is turned to the left in the body, rad."""
    A: Annotated[Array, (SIZE, SIZE)]
    """Of the last prediction, F = I + A; only the places of `states.ENTRIES` mean anything."""
    entries: Annotated[Array, (ENTRY_COUNT,)]
    """What they are, in the order of `states.ENTRIES`."""
    scratch: Annotated[Array, (SIZE, SIZE)]
    H: Annotated[Array, (MOST_ROWS, SIZE)]
    """Rows of the last measurement; only their `columns` mean anything."""
    columns: Annotated[Indices, (MOST_ROWS, ROW_LENGTH)]
    """States that each row depends on."""
    values: Annotated[Array, (MOST_ROWS, ROW_LENGTH)]
    """Entries of H at those columns."""
    counts: Annotated[Indices, (MOST_ROWS,)]
    """How many there are."""
    y: Annotated[Array, (MOST_ROWS,)]
    """Innovations, each given the scalars before it."""
    S: Annotated[Array, (MOST_ROWS,)]
    """Their variances; negative where the innovation gate refused."""
    cross: float
    """Covariance of the two innovations of a pair."""
    R: Annotated[Array, (MOST_ROWS,)]
    """Variances of the noise that were used."""
    K: Annotated[Array, (MOST_ROWS, SIZE)]
    """Gains, each given the scalars before it; zeros where the gate refused."""
    rows: int
    """How many scalars the last measurement had."""


PARAMETERS = dtype_of(Parameters)
SITUATION = dtype_of(Situation)
READING = dtype_of(Reading)
INERTIAL = dtype_of(Inertial)
MEMORY = dtype_of(Memory)
_AHEAD = {"front": 1.0, "rear": -1.0, "": 0.0}
READING_NUMBERS = READING.itemsize // 8


def parameters(vehicle: Vehicle, gravity_mps2: float) -> Records:
    """Give the model's constants; where each comes from says the configuration."""
    record = one(PARAMETERS)
    c, ekf, imu = record[0], vehicle.ekf, vehicle.imu
    c["gravity"] = gravity_mps2
    c["earth_curvature"] = 1.0 / EARTH_RADIUS_M
    c["creep_density"] = ekf.wheel_creep_m_rtm**2
    if vehicle.gnss is not None:
        c["antenna_lever"] = vehicle.gnss.lever_arm_m
    c["half_base"] = ekf.bogie_distance_m / 2
    c["wheel_bogie"] = _AHEAD[vehicle.wheels.bogie] * ekf.bogie_distance_m / 2
    c["side_density"] = ekf.side_slip_std_m_rts**2
    c["map_variance"] = map_shift_std_m(vehicle) ** 2
    c["heave_density"] = ekf.heave_std_m_rts**2
    c["heave_variance"] = c["heave_density"] / READING_S
    c["lateral_variance"] = ekf.sway_std_mps2_rthz**2 / READING_S
    if imu is None:
        return record
    c["imu_lever"] = imu.lever_arm_m
    c["gyro_aliasing"] = imu.gyro_aliasing**2 * READING_S
    c["accel_aliasing"] = imu.accel_aliasing**2 * READING_S
    fixes = vehicle.gnss.delay_std_s**2 if vehicle.gnss is not None else 0.0
    if fixes + imu.delay_std_s > 0.0:
        c["clock_share"] = imu.delay_std_s**2 / (fixes + imu.delay_std_s**2)
    c["lateral_variance"] += imu.accel_noise_mps2_rthz**2 / READING_S
    c["rate_variance"] = imu.gyro_noise_radps_rthz**2 / READING_S
    c["vertical_density"] = ekf.vertical_std_mps2_rthz**2
    c["gyro_walk"] = imu.gyro_walk_radps2_rthz**2
    c["accel_walk"] = imu.accel_walk_mps3_rthz**2
    return record


def situation(vehicle: Vehicle) -> Records:
    """Give the situation of a vehicle whose heading is known, with its own inertial readings."""
    record = one(SITUATION)
    s, imu, half_m = record[0], vehicle.imu, vehicle.wheels.track_m / 2
    s["heading_known"] = 1
    s["wheel_offset"] = half_m, -half_m
    s["wheel_sign"] = 1.0
    if imu is None:
        s["accel_density"] = vehicle.ekf.acceleration_std_mps2_rthz**2
        s["rate_density"] = np.array([1.0, 1.0, 0.0]) * vehicle.ekf.tilt_std_rad_rts**2
    else:
        noise, force = imu.accel_noise_mps2_rthz, vehicle.ekf.force_std_mps2_rthz
        s["accel_density"] = noise**2 + force**2
        s["rate_density"] = imu.gyro_noise_radps_rthz**2
    return record
