"""Simulated rides as the aligner takes them, straight from the truth at ten nodes a second.

The scenario's truth is worked out once (`World`); a seed adds its noise. So a ride of 40 minutes
costs a tenth of a second, and hundreds of mountings and seeds can be tried. The Earth is flat here:
up is up everywhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from tramstream.analysis.mounting.drive import NODE_S, Array, Drive, Fixes, Flags, Inertial
from tramstream.analysis.mounting.states import Point
from tramstream.attitude import C_vl
from tramstream.geodesy import normal_gravity_mps2
from tramstream.lines.line import Line, built_in_line
from tramstream.simulation.body import Attitude, Carriage, inertial_of
from tramstream.simulation.imu import inertial, instability_density
from tramstream.simulation.receiver import Gnss
from tramstream.simulation.ride import Motion, Ride
from tramstream.simulation.scenario import Scenario

PARTS = (0.0, 0.5, 1.0)
SIMPSON = (1 / 6, 4 / 6, 1 / 6)
"""Weights of a step's beginning, middle and end for its mean."""
LEVEL = np.array([0.0, 0.0, 1.0])


class World(NamedTuple):
    """The truth of a scenario's ride, without noise and mounting."""

    scenario: Scenario
    f_v: Array
    """(n, 3): mean from each node to the next."""
    omega_v: Array
    p_l: Array
    vel_l: Array
    C_lv: Array
    way_m: Array
    """(n,): gone so far."""
    speed_mps: Array
    """Along x of the vehicle."""
    wheel_m: Array
    """(n + 1,): way half a step before each node, and half a step after the last."""
    standing: Flags
    gravity_mps2: float


class CrossLevel(NamedTuple):
    """How far a track's rails are from level across: random, and as long as stated."""

    std_rad: float = 0.0
    length_m: float = 50.0


def world(
    scenario: Scenario,
    duration_s: float,
    cross: CrossLevel | None = None,
    seed: int = 0,
    line: Line | None = None,
) -> World:
    """Drive a scenario on a line for so long; default: the built-in one."""
    line = line or built_in_line()
    line = line if scenario.track.cant else line.without_cant()
    rng = np.random.default_rng(seed)
    ride = Ride(line, scenario.driver, scenario.reverse, rng)
    gravity = float(normal_gravity_mps2(line.level.latitude_rad, line.level.height_m))
    time_s: Array = np.arange(round(duration_s / NODE_S) + 1, dtype=float) * NODE_S
    carriage = None
    if scenario.body is not None:
        carriage = Carriage(scenario.body, ride, gravity, duration_s + 1.0)
    motion = ride.motion(time_s)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.arc_length_m)))])
    tilt = _cross_level(way, cross or CrossLevel(), rng)
    rate = np.append(np.diff(tilt), 0.0) / NODE_S
    f_v, omega_v = np.zeros((2, len(time_s), 3))
    for part, weight in zip(PARTS, SIMPSON, strict=True):
        at = ride.motion(time_s + part * NODE_S)
        if carriage is None:
            at = _tilted(at, tilt + part * NODE_S * rate, rate)
            force, turning = inertial(at, gravity, (0.0, 0.0, 0.0), LEVEL)
        else:
            body = carriage.part(1, time_s + part * NODE_S)
            up = np.broadcast_to(LEVEL, (len(time_s), 3))
            force, turning = inertial_of(body, gravity, np.zeros(3), up)
        f_v += weight * force
        omega_v += weight * turning
    attitude: Motion | Attitude = _tilted(motion, tilt, rate)
    C_lv = np.swapaxes(C_vl(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad), -1, -2)
    vel_l = C_lv[:, :, 0] * motion.speed_mps[:, None]
    speed = motion.speed_mps
    if carriage is not None:
        body = carriage.part(1, time_s)
        C_lv = np.swapaxes(body.body.C_vl, -1, -2)
        vel_l = body.point(np.zeros(3))[1]
    steps = (vel_l[:-1] + vel_l[1:]) / 2 * NODE_S
    p_l = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    halves = np.append(time_s, time_s[-1] + NODE_S) - NODE_S / 2
    wheel = ride.motion(halves).arc_length_m * ride.direction
    return World(
        scenario, f_v, omega_v, p_l, vel_l, C_lv, way, speed, wheel, motion.standing, gravity
    )


def _tilted(motion: Motion, roll_rad: Array, rate_radps: Array) -> Motion:
    return motion._replace(
        roll_rad=motion.roll_rad + roll_rad, roll_rate_radps=motion.roll_rate_radps + rate_radps
    )


def _cross_level(way_m: Array, cross: CrossLevel, rng: Generator) -> Array:
    """Draw a first-order Gauss-Markov process of the way."""
    tilt = np.zeros(len(way_m))
    if cross.std_rad == 0.0:
        return tilt
    keep = np.exp(-np.diff(way_m) / cross.length_m)
    drawn = rng.standard_normal(len(way_m)) * cross.std_rad
    tilt[0] = drawn[0]
    for k, kept in enumerate(keep.tolist()):
        tilt[k + 1] = kept * tilt[k] + math.sqrt(1 - kept * kept) * drawn[k + 1]
    return tilt


class Drawn(NamedTuple):
    """A seed's ride and its truth."""

    drive: Drive
    truth: Point


def draw(of: World, C_bv: Array, rng: Generator, bias: bool = False) -> Drawn:
    """Add a seed's noise, with an IMU that is mounted so.

    Parameters
    ----------
    of : World
    C_bv : ndarray, shape (3, 3)
    rng : Generator
    bias : bool
        Draw the bias at switching on from the configuration's deviations, instead of the
        scenario's.
    """
    scenario = of.scenario
    assert scenario.imu is not None
    sensor, count = scenario.imu.errors, len(of.standing)
    density = [
        _white(sensor.gyro_noise_radps_rthz, scenario.imu.scales.gyro_radps, scenario.imu.rate_hz),
        _white(sensor.accel_noise_mps2_rthz, scenario.imu.scales.accel_mps2, scenario.imu.rate_hz),
    ]
    gyro_bias = _walk(
        rng, count, sensor.gyro_walk_radps2_rthz,
        (sensor.gyro_instability_radps, sensor.gyro_instability_time_s),
    )  # fmt: skip
    accel_bias = _walk(
        rng, count, sensor.accel_walk_mps3_rthz,
        (sensor.accel_instability_mps2, sensor.accel_instability_time_s),
    )  # fmt: skip
    if bias:
        gyro_bias += rng.standard_normal(3) * BIAS_STD[0]
        accel_bias += rng.standard_normal(3) * BIAS_STD[1]
    else:
        gyro_bias += sensor.gyro_bias_radps
        accel_bias += sensor.accel_bias_mps2
    noise = rng.standard_normal((2, count, 3)) / math.sqrt(NODE_S)
    inertial_ = Inertial(
        f_b=of.f_v @ C_bv.T + accel_bias + density[1] * noise[1],
        omega_b=of.omega_v @ C_bv.T + gyro_bias + density[0] * noise[0],
    )
    zero = np.zeros((count, 3))
    drive = Drive(
        dt_s=NODE_S,
        start_ns=0,
        inertial=inertial_,
        fixes=_fixes(of, rng),
        wheel_mps=_wheels(of),
        wheel_std_mps=0.01,
        standing=of.standing.copy(),
        up_l=np.broadcast_to(LEVEL, (count, 3)).copy(),
        gravity_mps2=of.gravity_mps2,
    )
    truth = Point(
        of.p_l, of.vel_l, of.C_lv @ C_bv.T, accel_bias, gyro_bias, zero,
        np.zeros(count), C_bv.T.copy(), np.zeros(3),
    )  # fmt: skip
    return Drawn(drive, truth)


BIAS_STD = (0.01, 0.15)
"""What the configuration says of gyroscopes and accelerometers at switching on, SI."""


def _white(density: float, unit: float, rate_hz: float) -> float:
    """White noise with the rounding to counts."""
    return math.hypot(density, unit * math.sqrt(1 / (12 * rate_hz)))


def _walk(rng: Generator, count: int, walk: float, unstable: tuple[float, float]) -> Array:
    """Draw random walk and unstable bias of three axes at nodes."""
    found: Array = np.cumsum(rng.standard_normal((count, 3)), axis=0) * walk * math.sqrt(NODE_S)
    flat, time_s = unstable
    if flat > 0:
        std = math.sqrt(instability_density(flat, time_s) * time_s / 2)
        keep = math.exp(-NODE_S / time_s)
        drive = std * math.sqrt(1 - keep**2) * rng.standard_normal((count, 3))
        drive[0] = std * rng.standard_normal(3)
        for k in range(1, count):
            drive[k] += keep * drive[k - 1]
        found = found + drive
    return found


def _fixes(of: World, rng: Generator) -> Fixes:
    section = of.scenario.gnss
    assert section is not None
    every = max(round(1 / (section.rate_hz * NODE_S)), 1)
    node = np.arange(0, len(of.standing), every)
    receiver = Gnss(rng, section.rate_hz, section.errors)
    found = receiver.measured(of.p_l[node], of.vel_l[node], of.standing[node])
    errors = section.errors
    std = np.array([errors.horizontal_std_m, errors.horizontal_std_m, errors.vertical_std_m])
    white = std if errors.decay == 0 else np.maximum(WHITE_SHARE * std, 0.005)
    velocity = found.vel_l if section.velocity else np.full((len(node), 3), np.nan)
    shape = (len(node), 3)
    return Fixes(
        node,
        np.zeros(len(node)),
        found.p_l,
        np.broadcast_to(white, shape).copy(),
        velocity,
        np.full(shape, errors.velocity_std_mps),
    )


WHITE_SHARE = 0.05
"""Of a fix's error that lasts: how much is new in each."""


def _wheels(of: World) -> Array:
    section = of.scenario.wheels
    if section is None:
        return np.full(len(of.standing), np.nan)
    pulses = np.floor(of.wheel_m / section.axle.m_per_pulse)
    found: Array = np.diff(pulses) * section.axle.m_per_pulse / NODE_S
    return found


def off_rad(C_vb: Array, truth: Array) -> Array:
    """The turn from an estimate to the truth, about the vehicle's axes."""
    found: Array = Rotation.from_matrix(truth @ C_vb.T).as_rotvec()
    return found
