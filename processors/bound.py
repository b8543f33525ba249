"""The posterior Cramér-Rao bound of a simulated ride: what no filter can do better.

For Gaussian noise the recursion of Tichavský et al. along the true trajectory is the covariance of
an extended Kalman filter that is linearised at the truth and told the true noise. So the kernels of
the model `tram` are run at the true states, with the scenario's own figures in place of what a
configuration allows for: no creep of wheels, no sway, no jitter that the scenario does not have; no
gate, no white share of the fixes' error. The error of the fixes decays while standing as it does
while running, and a vehicle that stands is known to, at once. What a filter cannot know better
than its configuration tells (mounting, delays, scales, biases at switching on, grade and cant at
the start) begins with the same deviations as in the filter; nothing is known of the heading.

One thing more than the filter does: the noise of the vertical gyroscope, which turns the heading,
is in the expected lateral force too, and what that force tells of it is taken.

Left out, all of which only makes the bound smaller: multipath, slipping wheels and drifts of
standing fixes are not there, nor are errors of lever arms, of scales with temperature and across
axes; pulses are rounded to Gaussian noise of the same variance. The unstable bias is taken for a
walk with its driving noise, as in the filter: at the times between two stops they are the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tramstream.errors import ConfigError
from tramstream.geodesy import normal_gravity_mps2
from tramstream.inertial import inertial, instability_density
from tramstream.kernels import Array, compiled, predict_covariance
from tramstream.processors import tram_frames as frames
from tramstream.processors import tram_kernels as kernels
from tramstream.processors import tram_measurements as measurements
from tramstream.processors.alignment import ENOUGH_RAD
from tramstream.processors.tram_navigation import Navigation
from tramstream.processors.tram_states import COLUMNS, MOTION, ROWS, SIZE, Ix, Pm
from tramstream.receiver import antenna_motion
from tramstream.ride import Motion
from tramstream.scenario import SIDES, Gnss, Imu
from tramstream.simulation import Simulation

STEP_S = 0.01
"""One step of the fusion horizon; measurements fall on the nearest."""
EVERY = 5
"""Steps from one row of a series to the next."""
_HEADING_STD_RAD = 1.0
"""Of a heading that may be any: who takes the antenna for the vehicle's origin is off by the lever
arm, as much as this deviation makes of it."""
_STANDING_STD_MPS = 1e-6
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
    """Bound of a ride; the seed does not matter, but where chance takes fixes away.

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
    c, m = navigation.ekf.parameters, navigation.ekf.memory
    _set_noise(c, gnss, imu)
    P = navigation.ekf.P
    P[Ix.YAW, Ix.YAW] = _HEADING_STD_RAD**2
    P[Ix.GNSS_EAST, Ix.GNSS_EAST] = P[Ix.GNSS_NORTH, Ix.GNSS_NORTH] = (
        gnss.errors.horizontal_std_m**2
    )
    P[Ix.GNSS_UP, Ix.GNSS_UP] = gnss.errors.vertical_std_m**2
    constants, wheels = _wheels(simulation, m, c)
    count = 2 * int(simulation.duration_s / STEP_S) + 1
    halves = np.arange(count, dtype=np.float64) * (STEP_S / 2)
    motion = simulation.ride.motion(halves)
    steps = _steps(simulation, halves, motion, gnss, wheels > 0)
    if not np.any(steps.fix >= 0):
        raise ConfigError("a bound needs a fix, and this ride is over before there is one")
    first = int(np.argmax(steps.fix >= 0))
    rows = np.empty((len(range(first, len(steps.fix), EVERY)), 3 + SIZE))
    _recursion(m, c, steps, constants, first, rows)
    shown = slice(2 * first, None, 2 * EVERY)
    return Series(
        time_s=halves[shown],
        covariance=rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2),
        std=np.sqrt(np.maximum(rows[:, 3:], 0.0)),
        yaw_rad=motion.yaw_rad[shown],
    )


class _Steps(NamedTuple):
    """The truth and what is measured; instants are the even rows of what has halves."""

    states: Array
    """(2n − 1, 7): the motion of `tram_states.MOTION`, without the place."""
    inputs: Array
    """(2n − 1, 10): see `tram_kernels.move`."""
    change: Array
    """(n, 2): v̇, ψ̇."""
    standing: NDArray[np.bool_]
    """(n,): all through the step that ends here."""
    fix: NDArray[np.int64]
    """(n,): row of `antenna`, or −1."""
    antenna: Array
    """(fixes, 6): from the origin, and its velocity, both in l."""
    reading: NDArray[np.bool_]
    """(n,): whether the wheels are read."""


class _Constants(NamedTuple):
    """Variances of what is measured."""

    wheels: int
    pulse: float
    """Of a path, m²."""
    wheel_stamp: float
    """s²."""
    fix: float
    """White, each horizontal axis, m²."""
    fix_up: float
    fix_stamp: float
    velocity: float
    """(m/s)²; negative if there is none."""


def _set_noise(c: Array, gnss: Gnss, imu: Imu) -> None:
    """Put the scenario's noise in place of the configuration's."""
    errors, scales = imu.errors, imu.scales
    gyro = errors.gyro_noise_radps_rthz**2 + scales.gyro_radps**2 / 12 / imu.rate_hz
    accel = errors.accel_noise_mps2_rthz**2 + scales.accel_mps2**2 / 12 / imu.rate_hz
    c[Pm.SLIP_DENSITY] = c[Pm.SCALE_WALK] = c[Pm.SIDE_DENSITY] = c[Pm.HEAVE_DENSITY] = 0.0
    c[Pm.ACCEL_DENSITY] = accel
    c[Pm.ROLL_DENSITY] = c[Pm.PITCH_DENSITY] = c[Pm.YAW_DENSITY] = gyro
    c[Pm.LATERAL_VARIANCE] = c[Pm.STILL_FORCE_VARIANCE] = accel / STEP_S
    for slot in (Pm.STILL_ROLL_VARIANCE, Pm.STILL_PITCH_VARIANCE, Pm.STILL_YAW_VARIANCE):
        c[slot] = gyro / STEP_S
    c[Pm.STANDING_VARIANCE] = _STANDING_STD_MPS**2
    c[Pm.GYRO_WALK] = errors.gyro_walk_radps2_rthz**2 + instability_density(
        errors.gyro_instability_radps, errors.gyro_instability_time_s
    )
    c[Pm.ACCEL_WALK] = errors.accel_walk_mps3_rthz**2 + instability_density(
        errors.accel_instability_mps2, errors.accel_instability_time_s
    )
    decay = gnss.errors.decay
    c[Pm.GNSS_DECAY] = -math.log(decay) if decay > 0.0 else _FORGETS / STEP_S
    renewed = (1.0 - math.exp(-2.0 * c[Pm.GNSS_DECAY] * STEP_S)) / STEP_S
    c[Pm.GNSS_DENSITY] = gnss.errors.horizontal_std_m**2 * renewed
    c[Pm.GNSS_UP_DENSITY] = gnss.errors.vertical_std_m**2 * renewed


def _wheels(simulation: Simulation, m: Array, c: Array) -> tuple[_Constants, int]:
    """Set sides and true scales of the wheels; what is measured with which variance."""
    gnss, section = simulation.scenario.gnss, simulation.scenario.wheels
    assert gnss is not None
    count, pulse, stamp = 0, 0.0, 0.0
    if section is not None:
        axle = section.axle
        count, stamp = len(section.wheels), section.timing.stamp_jitter_s**2
        pulse = axle.m_per_pulse**2 / 12
        for slot, side in enumerate(sorted(section.wheels, key=SIDES.index)):
            radius_m = axle.radius_m + axle.radius_error_m[SIDES.index(side)]
            c[Pm.OFFSET_A + slot] = (0.5 - SIDES.index(side)) * axle.track_m
            m[Ix.SCALE_A + slot] = axle.radius_m / radius_m - 1.0
            P = m[kernels.COVARIANCE].reshape(SIZE, SIZE)
            P[Ix.PATH_A + slot, Ix.PATH_A + slot] = pulse
    errors = gnss.errors
    constants = _Constants(
        wheels=count,
        pulse=pulse,
        wheel_stamp=stamp,
        fix=errors.white_horizontal_std_m**2,
        fix_up=errors.white_vertical_std_m**2,
        fix_stamp=gnss.timing.stamp_jitter_s**2,
        velocity=errors.velocity_std_mps**2 if gnss.velocity else -1.0,
    )
    return constants, count


def _steps(
    simulation: Simulation, halves: Array, motion: Motion, gnss: Gnss, wheels: bool
) -> _Steps:
    imu, section = simulation.scenario.imu, simulation.scenario.wheels
    assert imu is not None
    level = simulation.line.level
    gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
    inputs = np.zeros((len(halves), 10))
    force, rate = inertial(motion, gravity, imu.lever_arm_m)
    inputs[:, :3], inputs[:, 3:6], inputs[:, 9] = rate, force, 1.0
    states = np.zeros((len(halves), MOTION.stop))
    states[:, Ix.SPEED], states[:, Ix.ROLL] = motion.speed_mps, motion.roll_rad
    states[:, Ix.PITCH], states[:, Ix.YAW] = motion.pitch_rad, motion.yaw_rad
    count = len(halves) // 2 + 1
    standing = motion.standing[::2].copy()
    standing[1:] &= motion.standing[1::2]
    epochs = np.arange(int(simulation.duration_s * gnss.rate_hz) + 1) / gnss.rate_hz
    epochs = epochs[~simulation.happenings.gnss_lost(epochs)]
    antenna = antenna_motion(
        np.zeros((len(epochs), 3)), simulation.ride.motion(epochs), np.array(gnss.lever_arm_m)
    )
    fix = np.full(count, -1)
    fix[_nearest(epochs, count)] = np.arange(len(epochs))
    reading = np.zeros(count, dtype=np.bool_)
    if wheels and section is not None:
        readings = np.arange(int(simulation.duration_s * section.rate_hz) + 1) / section.rate_hz
        reading[_nearest(readings, count)] = True
    return _Steps(
        states=states,
        inputs=inputs,
        change=np.stack([motion.acceleration_mps2, motion.yaw_rate_radps], axis=1)[::2].copy(),
        standing=standing,
        fix=fix,
        antenna=np.concatenate(antenna, axis=1),
        reading=reading,
    )


def _nearest(time_s: Array, count: int) -> NDArray[np.int64]:
    return np.minimum(np.rint(time_s / STEP_S).astype(np.int64), count - 1)


# Compiled -----------------------------------------------------------------------------------------
@compiled
def _recursion(
    m: Array, c: Array, steps: _Steps, constants: _Constants, first: int, rows: Array
) -> None:
    """Covariance from the first fix on; `rows` get ee, en, nn of the place, and all variances.

    The state is set to the truth before each function that linearises at it, so that their
    innovations do nothing.
    """
    x, P = m[kernels.STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    truth = x.copy()
    R, out = np.zeros(3), np.zeros((3, 2))
    work = np.zeros((1 + MOTION.stop, MOTION.stop))
    for k in range(first, len(steps.fix)):
        if k > first:
            if steps.standing[k]:
                _rest(m, c)
            else:
                truth[: MOTION.stop] = steps.states[2 * k - 1]
                x[:] = truth
                values = m[kernels.ENTRY_VALUES]
                kernels.transition(x, c, steps.inputs[2 * k - 1], STEP_S, values)
                scratch = m[kernels.SCRATCH].reshape((SIZE, SIZE))
                predict_covariance(P, ROWS, COLUMNS, values, kernels.ENTRY_COUNT, scratch)
                kernels.add_noise(x, P, c, STEP_S)
        truth[: MOTION.stop] = steps.states[2 * k]
        u = steps.inputs[2 * k]
        m[kernels.ACCELERATION], m[kernels.YAW_RATE] = steps.change[k]
        x[:] = truth
        if steps.standing[k]:
            kernels.standing(m, c, u)
            x[:] = truth
        _lateral(m, c, u, steps.standing[k])
        if steps.reading[k]:
            stamp = constants.wheel_stamp * x[Ix.SPEED] ** 2
            for wheel in range(constants.wheels):
                measurements.path(m, c, wheel, 0.0, constants.pulse + stamp, math.inf, out[0])
                x[:] = truth
        if steps.fix[k] >= 0:
            antenna = steps.antenna[steps.fix[k]]
            R[0] = constants.fix + constants.fix_stamp * x[Ix.SPEED] ** 2
            R[1] = constants.fix_up
            measurements.position(m, c, antenna[:3], R, math.inf, math.inf, out)
            x[:] = truth
            if constants.velocity > 0.0 and not steps.standing[k]:
                variance = constants.velocity
                measurements.velocity(m, c, antenna[3:], variance, math.inf, math.inf, out)
                x[:] = truth
        if (k - first) % EVERY == 0:
            _publish(m, c, work, rows[(k - first) // EVERY])


@compiled
def _rest(m: Array, c: Array) -> None:
    """`tram_kernels.rest`, with errors of fixes that go on decaying."""
    P = m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    keep = math.exp(-c[Pm.GNSS_DECAY] * STEP_S)
    for slot in range(Ix.GNSS_EAST, Ix.GNSS_UP + 1):
        for other in range(SIZE):
            P[slot, other] *= keep
        for other in range(SIZE):
            P[other, slot] *= keep
    kernels.rest(m, c, STEP_S)


@compiled
def _lateral(m: Array, c: Array, u: Array, standing: bool) -> None:
    """Take the lateral specific force; its noise is that of the last step's turning as well.

    y = Hδ + n_f + v n_ω, and n_ω has turned heading, roll and paths in the step: M = E[δ v n_ω].
    Then S = HPHᵀ + 2HM + R and K = (PHᵀ + M)/S. H is that of `tram_kernels.inertial`, which with a
    gate that lets nothing pass does no more than to tell it.

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, Wiley 2001, section 8.3.
    """
    x, P, K = m[kernels.STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE)), m[kernels.GAIN]
    kernels.inertial(m, c, u, u, -1.0)
    h, columns, count = kernels.row(m, 0), m[kernels.H_COLUMNS], int(m[kernels.SEEN][2])
    variance = c[Pm.LATERAL_VARIANCE]
    K[:] = 0.0
    if not standing:
        sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
        cp, tp = math.cos(x[Ix.PITCH]), math.tan(x[Ix.PITCH])
        turned = x[Ix.SPEED] * c[Pm.YAW_DENSITY]
        variance += x[Ix.SPEED] * turned / STEP_S
        K[Ix.ROLL], K[Ix.PITCH], K[Ix.YAW] = turned * tp * cr, -turned * sr, turned * cr / cp
        K[Ix.PATH_A] = -turned * c[Pm.SIGN_A] * c[Pm.OFFSET_A] * (1.0 + x[Ix.SCALE_A])
        K[Ix.PATH_B] = -turned * c[Pm.SIGN_B] * c[Pm.OFFSET_B] * (1.0 + x[Ix.SCALE_B])
    for k in range(count):
        variance += h[k] * K[int(columns[k])]  # HM; the other one comes with HK below
    for k in range(count):
        K += h[k] * P[int(columns[k])]
    for k in range(count):
        variance += h[k] * K[int(columns[k])]
    for i in range(SIZE):
        for j in range(i + 1):
            P[i, j] -= K[i] * K[j] / variance
            P[j, i] = P[i, j]


@compiled
def _publish(m: Array, c: Array, work: Array, row: Array) -> None:
    """What the filter would say of its place, and of its states."""
    P = m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    frames.origin(m, c[Pm.CLOCK_SHARE], work[0], work[1:])
    row[0], row[1], row[2] = work[1, 0], work[1, 1], work[2, 1]
    for i in range(SIZE):
        row[3 + i] = P[i, i]
