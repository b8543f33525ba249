"""The posterior Cramér-Rao bound of a simulated ride: what no filter can do better.

For Gaussian noise the recursion of Tichavský et al. along the true trajectory is the covariance of
an extended Kalman filter that is linearised at the truth and told the true noise. So the kernels of
the model `tram` are run at the true states, with the scenario's own figures in place of what a
configuration allows for: no creep of wheels, no sway, no jitter that the scenario does not have; no
gate, no white share of the fixes' error. The error of the fixes decays while standing as it does
while running, and a vehicle that stands is known to, at once. What a filter cannot know better
than its configuration tells (mounting, delays, scales, biases at switching on, grade and cant at
the start) begins with the same deviations as in the filter; nothing is known of the heading.

Two things more than the filter does on rails: the vertical force is used, and the noise of the
vertical gyroscope, which turns the heading, is known to be in the expected lateral force as well.

A wheel that slips tells nothing, and is known to slip. Left out, all of which only makes the bound
smaller: multipath and drifts of standing fixes, errors of lever arms, of scales with temperature
and across axes. Rounding of pulses is taken for Gaussian noise of its variance; the unstable bias
for a walk with its driving noise, as in the filter: from one stop to the next they are the same.

Equations: docs/theory.md, section 15.

References
----------
P. Tichavský, C. H. Muravchik, A. Nehorai, "Posterior Cramér-Rao bounds for discrete-time nonlinear
filtering", IEEE Transactions on Signal Processing 46 (1998) 1386-1396.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tramstream.analysis.studies.bound_kernels import (
    EVERY,
    NOT_READ,
    READ,
    SLIPPED,
    STEP_S,
    Steps,
    Variances,
    recursion,
)
from tramstream.errors import ConfigError
from tramstream.estimation.kalman import Array
from tramstream.estimation.records import Records, numbers
from tramstream.geodesy import normal_gravity_mps2
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter.alignment import ENOUGH_RAD
from tramstream.processors.tram_model.records import READING
from tramstream.processors.tram_model.states import MOTION, SIZE, Ix
from tramstream.simulation.imu import inertial, instability_density
from tramstream.simulation.receiver import antenna_motion
from tramstream.simulation.ride import Motion
from tramstream.simulation.scenario import SIDES, Gnss, Imu, Scenario, Side, Wheels
from tramstream.simulation.simulation import Simulation

_HEADING_STD_RAD = 1.0
"""Of a heading that may be any: who takes the antenna for the vehicle's origin is off by the lever
arm, as much as this deviation makes of it."""
_NO_SPEED_STD_MPS = 1e-6
"""Zero, but for arithmetic."""
_FORGETS = 1e3
"""Times per step that an error without memory forgets."""
_ANGLES = (np.arange(32) + 0.5) / 32 * (math.pi / 2)


@dataclass(frozen=True)
class Bound:
    """Expected figures of the best filter; names are those of `kaspar2023_study.Figures`."""

    position_p90_m: float
    along_rms_m: float
    across_rms_m: float
    speed_std_mps: float
    yaw_rms_deg: float


class Series(NamedTuple):
    """The bound along the ride, one row every `EVERY` steps from the first fix on."""

    time_s: Array
    """Of the ride."""
    covariance: Array
    """(n, 2, 2): of the vehicle's origin, east and north, m²."""
    std: Array
    """(n, SIZE): of each state of the model `tram`."""
    yaw_rad: Array
    """The truth."""

    @property
    def heading_known(self) -> NDArray[np.bool_]:
        """Whether a filter could be running; before, speed and heading are not judged."""
        known: NDArray[np.bool_] = np.logical_or.accumulate(self.std[:, Ix.YAW] < ENOUGH_RAD)
        return known


def bound(simulation: Simulation) -> Bound:
    """Bound of a ride; the seed does not matter, but for wheels that slip by chance.

    Raises
    ------
    ConfigError
        For a scenario without IMU, or a ride without a fix.
    """
    return figures(series(simulation))


def figures(found: Series) -> Bound:
    """Figures over all instants: errors are Gaussian at each, and all are thrown together."""
    cos, sin = np.cos(found.yaw_rad), np.sin(found.yaw_rad)
    ee, en, nn = found.covariance[:, 0, 0], found.covariance[:, 0, 1], found.covariance[:, 1, 1]
    along = cos * cos * ee + 2.0 * cos * sin * en + sin * sin * nn
    known = found.heading_known
    return Bound(
        position_p90_m=horizontal_quantile_m(found.covariance, 0.9),
        along_rms_m=_root_mean(along),
        across_rms_m=_root_mean(ee + nn - along),
        speed_std_mps=_root_mean(found.std[known, Ix.SPEED] ** 2),
        yaw_rms_deg=math.degrees(_root_mean(found.std[known, Ix.YAW] ** 2)),
    )


def _root_mean(variances: Array) -> float:
    return math.sqrt(float(variances.mean())) if len(variances) else math.nan


def horizontal_quantile_m(covariance: Array, share: float) -> float:
    """Length that `share` of all errors stay below, drawn from N(0, C) for each C alike.

    An error is √λ₁ ρ cos t, √λ₂ ρ sin t along the axes of its ellipse, t uniform, ρ Rayleigh.

    Parameters
    ----------
    covariance : ndarray, shape (n, 2, 2)
    """
    half = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2
    apart = np.hypot((covariance[:, 0, 0] - covariance[:, 1, 1]) / 2, covariance[:, 0, 1])
    least = np.maximum(half - apart, 0.0)
    cos2 = np.cos(_ANGLES) ** 2
    variances = np.outer(half + apart, cos2) + np.outer(least, 1.0 - cos2)

    def excess(length: float) -> float:
        return 1.0 - share - float(np.exp(-(length**2) / (2.0 * variances)).mean())

    longest = math.sqrt(-2.0 * math.log(1.0 - share) * float(variances.max()))
    return float(brentq(excess, 0.0, longest, xtol=1e-6))


# Along the ride -----------------------------------------------------------------------------------
def series(simulation: Simulation) -> Series:
    """Run the recursion along the true trajectory; see `bound`."""
    gnss, imu = simulation.scenario.gnss, simulation.scenario.imu
    if gnss is None or imu is None:
        raise ConfigError("a bound needs a scenario with GNSS and an IMU")
    level = simulation.line.level
    navigation = Navigation(simulation.vehicle, level)
    ekf = navigation.ekf
    parameters, situation = ekf.parameters.copy(), ekf.situation
    _set_noise(parameters, situation, gnss, imu)
    P = ekf.P
    P[Ix.YAW, Ix.YAW] = _HEADING_STD_RAD**2
    P[Ix.ACCEL_Z, Ix.ACCEL_Z] = P[Ix.ACCEL_Y, Ix.ACCEL_Y]
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] = P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] = (
        gnss.errors.horizontal_std_m**2
    )
    P[Ix.GNSS_UP, Ix.GNSS_UP] = gnss.errors.vertical_std_m**2
    if simulation.scenario.wheels is not None:
        _set_wheels(navigation, simulation.scenario.wheels)
    halves = np.arange(2 * int(simulation.duration_s / STEP_S) + 1, dtype=np.float64)
    halves *= STEP_S / 2.0
    motion = simulation.ride.motion(halves)
    steps = _steps(simulation, halves, motion)
    if not np.any(steps.fix >= 0):
        raise ConfigError("a bound needs a fix, and this ride is over before there is one")
    first = int(np.argmax(steps.fix >= 0))
    rows = np.empty((len(range(first, len(steps.fix), EVERY)), 3 + SIZE))
    variances = _variances(simulation.scenario, gnss, imu)
    given = numbers(parameters), numbers(situation)
    recursion(ekf.memory, *given, steps, variances, first, rows)
    shown = slice(2 * first, None, 2 * EVERY)
    return Series(
        time_s=halves[shown],
        covariance=rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2),
        std=np.sqrt(np.maximum(rows[:, 3:], 0.0)),
        yaw_rad=motion.yaw_rad[shown],
    )


def _set_noise(c: Records, s: Records, gnss: Gnss, imu: Imu) -> None:
    """Put the scenario's noise into `Parameters` and `Situation`, for the configuration's."""
    errors = imu.errors
    gyro, accel = _white(imu)
    for name in ("creep_density", "scale_walk", "side_density", "heave_density"):
        c[name] = 0.0
    c["lateral_variance"] = accel / STEP_S
    c["vertical_density"] = accel
    c["heave_variance"] = _NO_SPEED_STD_MPS**2
    c["gyro_walk"] = errors.gyro_walk_radps2_rthz**2 + instability_density(
        errors.gyro_instability_radps, errors.gyro_instability_time_s
    )
    c["accel_walk"] = errors.accel_walk_mps3_rthz**2 + instability_density(
        errors.accel_instability_mps2, errors.accel_instability_time_s
    )
    s["accel_density"], s["rate_density"] = accel, gyro
    decay = -math.log(gnss.errors.decay) if gnss.errors.decay > 0.0 else _FORGETS / STEP_S
    renewed = (1.0 - math.exp(-2.0 * decay * STEP_S)) / STEP_S
    s["fix_decay"] = decay
    s["fix_density"] = gnss.errors.horizontal_std_m**2 * renewed
    s["fix_up_density"] = gnss.errors.vertical_std_m**2 * renewed


def _white(imu: Imu) -> tuple[float, float]:
    """Densities of the white noise of gyroscopes and accelerometers, (rad/s)²/Hz, (m/s²)²/Hz."""
    errors, scales = imu.errors, imu.scales
    gyro = errors.gyro_noise_radps_rthz**2 + scales.gyro_radps**2 / 12 / imu.rate_hz
    accel = errors.accel_noise_mps2_rthz**2 + scales.accel_mps2**2 / 12 / imu.rate_hz
    return gyro, accel


def _set_wheels(navigation: Navigation, section: Wheels) -> None:
    """Set sides and true scales of the wheels; they have been read once."""
    axle, ekf = section.axle, navigation.ekf
    for slot, side in enumerate(_sides(section)):
        radius_m = axle.radius_m + axle.radius_error_m[SIDES.index(side)]
        ekf.set_wheel(slot, (0.5 - SIDES.index(side)) * axle.track_m)
        ekf.set_states(Ix(Ix.SCALE_A + slot), (axle.radius_m / radius_m - 1.0,))
        ekf.P[Ix.PATH_A + slot, Ix.PATH_A + slot] = axle.m_per_pulse**2 / 12


def _sides(section: Wheels) -> list[Side]:
    return sorted(section.wheels, key=SIDES.index)


def _variances(scenario: Scenario, gnss: Gnss, imu: Imu) -> Variances:
    wheels, errors = scenario.wheels, gnss.errors
    gyro, accel = _white(imu)
    return Variances(
        pulse=wheels.axle.m_per_pulse**2 / 12 if wheels else 0.0,
        wheel_stamp=wheels.timing.stamp_jitter_s**2 if wheels else 0.0,
        fix=errors.white_horizontal_std_m**2,
        fix_up=errors.white_vertical_std_m**2,
        fix_stamp=gnss.timing.stamp_jitter_s**2,
        velocity=errors.velocity_std_mps**2 if gnss.velocity else -1.0,
        standing=_NO_SPEED_STD_MPS**2,
        still_rate=gyro / STEP_S,
        still_force=accel / STEP_S,
    )


def _steps(simulation: Simulation, halves: Array, motion: Motion) -> Steps:
    """Sample the truth, and lay what is measured on the steps."""
    gnss, imu = simulation.scenario.gnss, simulation.scenario.imu
    assert gnss is not None
    assert imu is not None
    level = simulation.line.level
    gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
    inputs = np.zeros(len(halves), READING)
    inputs["specific_force"], inputs["angular_rate"] = inertial(motion, gravity, imu.lever_arm_m)
    inputs["accelerometer"] = 1.0
    states = np.zeros((len(halves), MOTION.stop))
    states[:, Ix.SPEED], states[:, Ix.ROLL] = motion.speed_mps, motion.roll_rad
    states[:, Ix.PITCH], states[:, Ix.YAW] = motion.pitch_rad, motion.yaw_rad
    count = len(halves) // 2 + 1
    standing = motion.standing[::2].copy()
    standing[1:] &= motion.standing[1::2]
    epochs = _instants(simulation, gnss.rate_hz)
    epochs = epochs[~simulation.happenings.gnss_lost(epochs)]
    antenna = antenna_motion(
        np.zeros((len(epochs), 3)), simulation.ride.motion(epochs), np.array(gnss.lever_arm_m)
    )
    fix = np.full(count, -1)
    fix[_nearest(epochs, count)] = np.arange(len(epochs))
    return Steps(
        states=states,
        inputs=inputs,
        change=np.stack([motion.acceleration_mps2, motion.yaw_rate_radps], axis=1)[::2].copy(),
        standing=standing,
        fix=fix,
        antenna=np.concatenate(antenna, axis=1),
        wheels=_readings(simulation, count),
    )


def _readings(simulation: Simulation, count: int) -> NDArray[np.int64]:
    """What each step brings of each wheel."""
    section = simulation.scenario.wheels
    if section is None:
        return np.full((count, 0), NOT_READ)
    sides = _sides(section)
    instants = _instants(simulation, section.rate_hz)
    found = np.full((len(instants), len(sides)), READ)
    for skid in simulation.happenings.skids:
        touched = instants > skid.start_s
        touched[1:] &= instants[:-1] < skid.end_s
        for slot, side in enumerate(sides):
            if side in skid.wheels:
                found[touched, slot] = SLIPPED
    readings = np.full((count, len(sides)), NOT_READ)
    readings[_nearest(instants, count)] = found
    return readings


def _instants(simulation: Simulation, rate_hz: float) -> Array:
    instants: Array = np.arange(int(simulation.duration_s * rate_hz) + 1) / rate_hz
    return instants


def _nearest(time_s: Array, count: int) -> NDArray[np.int64]:
    return np.minimum(np.rint(time_s / STEP_S).astype(np.int64), count - 1)
