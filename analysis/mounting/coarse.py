"""Coarse alignment: two axes of the vehicle in the case, and a trajectory to begin with.

Up is the direction of the mean specific force. Forward is where accelerating and turning press:
f_h = s' x + s ω_z (up × x), two numbers by least squares, with no angle in them and so no
singularity. `s` is the receiver's speed, which has no sign: stretches between halts in which the
force points the other way are rides in reverse.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, uniform_filter1d

from tramstream.analysis.mounting.drive import NODE_S, Array, Drive, Flags
from tramstream.analysis.mounting.states import Point
from tramstream.attitude import C_vl

AVERAGE_S = 2.0
"""Means over which speed and force are compared: fixes of 0.5 m/s at 10 Hz are good to 0.1 m/s."""
MOVING_MPS = 1.5
FAST_MPS = 3.0
"""A course is a course from here on."""
COURSE_S = 20.0
"""Means of the difference between course and summed-up rate: a gyroscope's bias turns it slowly."""
GRADE_S = 8.0
SURE = 4.0
"""A stretch goes in reverse if it says so by so many deviations."""


class Kinematics(NamedTuple):
    """What fixes and inertial readings say at each node, averaged alike."""

    f_b: Array
    omega_b: Array
    vel_l: Array
    p_l: Array
    speed_mps: Array
    """Over ground, not negative."""
    acceleration_mps2: Array
    moving: Flags


class Coarse(NamedTuple):
    """What was found."""

    C_vb: Array
    """(3, 3); NaN if nothing was."""
    std_rad: float
    """Of yaw, as the scatter of the force says."""
    size: float
    """Of the force over that of the acceleration: 1 if all axes say what they should."""
    rate_size: float
    """Of the rate about up over that of the course: 1."""
    handed: float
    """Cosine between forward as braking says it and as curves say it: −1 in a left-handed frame."""
    reverse: Flags
    """(n,): nodes at which the vehicle goes backwards."""
    kinematics: Kinematics


def _averaged(values: Array, nodes: int) -> Array:
    found: Array = uniform_filter1d(values, nodes, axis=0, mode="nearest")
    return found


def kinematics_of(drive: Drive) -> Kinematics:
    """Bring fixes to nodes; without a receiver's velocity by differences of places."""
    fixes, count, dt = drive.fixes, drive.length, drive.dt_s
    node_s = np.arange(count) * dt
    fix_s = fixes.node * dt + fixes.late_s

    def at_nodes(values: Array) -> Array:
        columns = []
        for column in values.T:
            some = np.isfinite(column)
            columns.append(
                np.interp(node_s, fix_s[some], column[some]) if some.any() else np.zeros(count)
            )
        return np.stack(columns, axis=1)

    window = max(round(AVERAGE_S / dt), 1)
    p_l = at_nodes(fixes.p_l)
    told = np.isfinite(fixes.vel_l[:, 0])
    if told.sum() > len(told) / 2:
        vel_l = _averaged(at_nodes(fixes.vel_l), window)
    else:
        vel_l = np.gradient(_averaged(p_l, window), dt, axis=0)
        vel_l = _averaged(vel_l, max(window // 2, 1))
    speed = np.hypot(vel_l[:, 0], vel_l[:, 1])
    acceleration = _averaged(np.gradient(speed, dt), max(window // 2, 1))
    return Kinematics(
        _averaged(drive.inertial.f_b, window),
        _averaged(drive.inertial.omega_b, window),
        vel_l,
        p_l,
        speed,
        acceleration,
        (speed > MOVING_MPS) & ~drive.standing,
    )


def coarse(drive: Drive) -> Coarse:
    """Find up, then forward."""
    kin = kinematics_of(drive)
    mean = drive.inertial.f_b[:-1].mean(axis=0)
    up = mean / np.linalg.norm(mean)
    first = np.eye(3)[int(np.argmin(np.abs(up)))]
    e1 = np.cross(up, first)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(up, e1)
    omega = drive.inertial.omega_b.copy()
    if drive.standing.sum() > 50:
        omega = omega - omega[drive.standing].mean(axis=0)
    turning = _averaged(omega @ up, max(round(AVERAGE_S / drive.dt_s), 1))
    rows = np.flatnonzero(kin.moving)[:: max(round(0.5 / drive.dt_s), 1)]
    nothing = np.zeros(drive.length, bool)
    if len(rows) < 20:
        return Coarse(np.full((3, 3), np.nan), np.inf, 0.0, 0.0, 0.0, nothing, kin)
    force = np.stack([kin.f_b @ e1, kin.f_b @ e2], axis=1)
    sign, handed = _directions(kin, force, turning)
    a, c = (sign * kin.acceleration_mps2)[rows], (sign * kin.speed_mps * turning)[rows]
    zero, one = np.zeros(len(rows)), np.ones(len(rows))
    A = np.concatenate([np.stack([a, -c, one, zero], axis=1), np.stack([c, a, zero, one], axis=1)])
    b = np.concatenate([force[rows, 0], force[rows, 1]])
    (m1, m2, *_), *_ = np.linalg.lstsq(A, b, rcond=None)
    residual = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    size = float(np.hypot(m1, m2))
    x = (m1 * e1 + m2 * e2) / max(size, 1e-12)
    C_vb = np.stack([x, np.cross(up, x), up])
    told = float(np.sum(a**2 + c**2)) / (2 * AVERAGE_S)
    std = float(np.std(residual)) / max(np.sqrt(told) * size, 1e-9)
    rate_size = _rate_size(kin, turning, rows, drive.dt_s)
    return Coarse(C_vb, std, size, rate_size, handed, sign < 0, kin)


def _rate_size(kin: Kinematics, turning: Array, rows: NDArray[np.int64], dt_s: float) -> float:
    """Slope of the rate about up against that of the course, where it goes fast."""
    course = np.unwrap(np.arctan2(kin.vel_l[:, 1], kin.vel_l[:, 0]))
    reach = max(round(2.0 / dt_s), 1)
    fast = rows[(kin.speed_mps[rows] > FAST_MPS) & (rows > reach) & (rows < len(course) - reach)]
    if len(fast) < 20:
        return np.nan
    rate = (course[fast + reach] - course[fast - reach]) / (2 * reach * dt_s)
    rate = rate - np.median(rate)
    fine = np.abs(rate) < 1.0
    if np.sum(rate[fine] ** 2) * 0.5 < 0.02:
        return np.nan
    felt = _averaged(turning, 2 * reach)[fast]
    return float(np.sum(rate[fine] * (felt - felt.mean())[fine]) / np.sum(rate[fine] ** 2))


def _directions(kin: Kinematics, force: Array, turning: Array) -> tuple[Array, float]:
    """Which way the vehicle goes, and whether braking and curves agree which way that is.

    Returns
    -------
    sign : ndarray, shape (n,)
        1 where it goes the way that it goes mostly, −1 where it goes the other way.
    handed : float
        Mean cosine between the two over all stretches between halts; 0 where one tells nothing.
    """
    stretches, count = label(kin.moving)
    sums = np.zeros((count, 2, 2))  # forward as acceleration has it, and as curves have it
    weight, scatter = np.zeros(count), np.zeros(count)
    for number in range(count):
        inside = stretches == number + 1
        a, c = kin.acceleration_mps2[inside], (kin.speed_mps * turning)[inside]
        f1, f2 = (force[inside] - force[inside].mean(axis=0)).T
        a, c = a - a.mean(), c - c.mean()
        weight[number] = np.sum(a**2 + c**2) + 1e-9
        sums[number] = [[np.sum(a * f1), np.sum(a * f2)], [np.sum(c * f2), -np.sum(c * f1)]]
        said = sums[number].sum(axis=0)
        unsaid = np.sum(f1**2 + f2**2) - float(said @ said) / weight[number]
        left = max(float(unsaid), 0.0) / (2 * len(a))
        scatter[number] = np.sqrt(left * weight[number] * 2 * AVERAGE_S / NODE_S) + 1e-9
    along = sums.sum(axis=1)
    scaled = along / weight[:, None] ** 0.5
    projected = along @ np.linalg.eigh(scaled.T @ scaled)[1][:, 1]
    if projected.sum() < 0:
        projected = -projected
    sign = np.ones(len(kin.moving))
    for back in np.flatnonzero(projected < -SURE * scatter).tolist():
        sign[stretches == back + 1] = -1.0
    sizes = np.linalg.norm(sums, axis=2)
    agree = float(np.sum(sums[:, 0] * sums[:, 1]))
    return sign, agree / max(float(np.sum(sizes[:, 0] * sizes[:, 1])), 1e-9)


def trajectory(drive: Drive, found: Coarse) -> Point:
    """A ride upright on the fixes, heading along their course: good to some degrees."""
    kin, dt, count = found.kinematics, drive.dt_s, drive.length
    turning = (drive.inertial.omega_b @ found.C_vb.T)[:, 2]
    summed = np.concatenate([[0.0], np.cumsum(turning[:-1]) * dt])
    course = np.arctan2(kin.vel_l[:, 1], kin.vel_l[:, 0]) + np.pi * found.reverse
    fast = np.flatnonzero(kin.speed_mps > min(FAST_MPS, 0.5 * float(kin.speed_mps.max())))
    weight = np.zeros(count)
    weight[fast] = kin.speed_mps[fast] ** 2
    off = weight * np.exp(1j * (course - summed))
    window = max(round(COURSE_S / dt), 1)
    mixed = _averaged(off.real, window) + 1j * _averaged(off.imag, window)
    heading = summed + np.interp(np.arange(count), fast, np.unwrap(np.angle(mixed[fast])))
    forward = np.where(found.reverse, -1.0, 1.0) * kin.speed_mps
    rising = _averaged(kin.vel_l[:, 2], max(round(GRADE_S / dt), 1))
    slope = np.arctan2(rising[fast], np.where(found.reverse, -1, 1)[fast] * kin.speed_mps[fast])
    slope = np.where(np.abs(slope) > np.pi / 2, slope - np.pi * np.sign(slope), slope)
    pitch = -np.interp(np.arange(count), fast, slope)
    C_lv = np.swapaxes(C_vl(np.zeros(count), pitch, heading), -1, -2)
    zero = np.zeros((count, 3))
    return Point(
        p_l=kin.p_l.copy(),
        vel_l=C_lv[:, :, 0] * forward[:, None],
        C_lb=C_lv @ found.C_vb,
        accel_bias=zero.copy(),
        gyro_bias=zero.copy(),
        fix_error=zero.copy(),
        cross_level=np.zeros(count),
        C_vb=found.C_vb.copy(),
        constants=np.zeros(3),
    )
