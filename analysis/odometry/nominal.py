"""The ride as wheels and gyroscope alone have it, at nodes a second apart, and each fix in it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.level import Level
from tramstream.analysis.odometry.material import MEAN_S, FixColumns
from tramstream.analysis.odometry.stated import Stated
from tramstream.analysis.odometry.ways import Way, smooth

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

NODE_S = 1.0
SLIP_M = 0.05
"""How well the force carries the way over a slip."""
HOLE_S = 0.5
"""Without inertial means for longer nothing is known of heading and way."""
CHORD_M = 40.0
"""Heading is first guessed from chords of fixes so long."""


class Slot(IntEnum):
    """Unknowns of a node."""

    EAST = 0
    NORTH = 1
    YAW = 2
    BIAS = 3
    ERROR_EAST = 4
    ERROR_NORTH = 5
    SLOW_EAST = 6
    SLOW_NORTH = 7


class Placed(NamedTuple):
    """Fixes between nodes."""

    node: NDArray[np.int64]
    """The one before."""
    time_s: Array
    turned: Array
    """Since the node, by the gyroscope."""
    step: Complex
    """Way since the node, in its direction."""
    speed: Array
    rate: Array
    acceleration: Array
    place: Complex
    velocity: Complex
    std: Array
    speed_std: Array
    apart_s: Array
    """Since the fix before."""
    leaning: Complex
    """How far the antenna is ahead and to the left more, for its height leans with slope and
    cant."""


@dataclass(frozen=True)
class Nominal:
    """Columns by node; of the steps between nodes one less."""

    time_s: Array
    dt_s: Array
    yaw: Array
    """By the gyroscope."""
    turned: Array
    step: Complex
    """Way, in the direction of the mean yaw of its two nodes."""
    way_a: Array
    way_b: Array
    upright: Array
    """Cosine of the slope."""
    standing: Flags
    broken: Flags
    slipping: Flags
    share: tuple[float, float]
    """How much of the mean way is each wheel's."""
    std: Array
    """Of the fixes near each node, as stated."""
    fixes: Placed
    tau_s: float
    slip_m: float = SLIP_M

    @property
    def wheels(self) -> int:
        return 2 if self.share[1] > 0.0 else 1

    def mean_scale(self, constants: Array) -> float:
        """x̄ of the mean of what was counted: the larger wheel counts less, so it is harmonic."""
        one, other = self.share
        return 1.0 / float(one / (1.0 + constants[0]) + other / (1.0 + constants[1])) - 1.0

    def error_stds(self, scale: float) -> tuple[Array, Array]:
        """Deviations of e and ē: what does not show within τ is taken for slow."""
        shown = scale**2
        slow = max(2.0 * (0.9 - min(shown, 0.9)), 0.03 * max(shown, 1.0))
        return max(scale, 0.3) * self.std, float(np.sqrt(slow)) * self.std

    def first_guess(self) -> Array:
        """Nodes where the fixes are, headed as their chords go."""
        x = np.zeros((len(self.time_s), len(Slot)))
        f = self.fixes
        x[:, Slot.EAST] = np.interp(self.time_s, f.time_s, f.place.real)
        x[:, Slot.NORTH] = np.interp(self.time_s, f.time_s, f.place.imag)
        x[:, Slot.YAW] = self.yaw + self._turned_against()
        return x

    def _turned_against(self) -> Array:
        """True yaw less the gyroscope's, by chords."""
        f = self.fixes
        gone = np.concatenate([[0.0], np.cumsum(np.abs(self.step))])
        nominal = np.concatenate(
            [[0.0], np.cumsum(self.step * np.exp(1j * 0.5 * (self.yaw[1:] + self.yaw[:-1])))]
        )
        cut = np.unique(np.searchsorted(gone, np.arange(0.0, gone[-1], CHORD_M)))
        near = np.abs(self.time_s[:, None][cut] - f.time_s[None, :]).min(axis=1) < 2.0
        cut = cut[near]
        if len(cut) < 3:
            return np.zeros(len(self.time_s))
        place = np.interp(self.time_s[cut], f.time_s, f.place.real) + 1j * np.interp(
            self.time_s[cut], f.time_s, f.place.imag
        )
        both = np.diff(place) * np.conj(np.diff(nominal[cut]))
        five = np.convolve(both, np.ones(5), "same")
        angle = np.unwrap(np.angle(five))
        middle = 0.5 * (self.time_s[cut][1:] + self.time_s[cut][:-1])
        return np.interp(self.time_s, middle, angle)

    def _left(self, x: Array, constants: Array) -> Complex:
        """What fixes are off the vehicle's antenna."""
        f, k = self.fixes, self.fixes.node
        turn = np.exp(1j * x[k, Slot.YAW])
        here = turn * np.exp(1j * f.turned)
        lever = constants[3] + 1j * constants[4] + f.leaning
        velocity = here * (f.speed + 1j * f.rate * lever)
        way = (1.0 + self.mean_scale(constants)) * turn * f.step
        p = x[k, Slot.EAST] + 1j * x[k, Slot.NORTH]
        off: Complex = f.place - (p + way + here * lever - velocity * constants[5])
        return off

    def fix_error(self, x: Array, constants: Array, stated: Stated) -> float:
        """Size of the fixes' error over what is stated, by how it changes along the way.

        Along, for across the gyroscope's walk lets the way follow the fixes.
        """
        k = self.fixes.node
        off = self._left(x, constants)
        count = np.maximum(np.bincount(k, minlength=len(self.time_s)), 1)
        east = np.bincount(k, off.real, len(self.time_s)) / count
        mean = east + 1j * np.bincount(k, off.imag, len(self.time_s)) / count
        there = np.bincount(k, minlength=len(self.time_s)) > 0
        there &= np.concatenate([~self.standing, [True]])
        lag = max(round(self.tau_s / NODE_S), 1)
        if len(mean) <= 2 * lag:
            return 1.0
        yaw = x[:, Slot.YAW]
        both = there[lag:] & there[:-lag] & (np.abs(yaw[lag:] - yaw[:-lag]) < 0.3)
        if both.sum() < 20:
            return 1.0
        change = ((mean[lag:] - mean[:-lag]) * np.exp(-1j * yaw[lag:])).real[both]
        expected = self.std[lag:][both] * np.sqrt(2.0 * (1.0 - np.exp(-lag * NODE_S / self.tau_s)))
        size = float(np.median(np.abs(change) / expected)) / 0.6745
        return float(np.clip(size, 0.1, 30.0))

    def off(self, x: Array, constants: Array) -> tuple[Array, Array]:
        """Instants of fixes and how far they are off what was found, m."""
        return self.fixes.time_s, np.abs(self._left(x, constants))


def nominal_of(
    way: Way,
    level: Level,
    fixes: FixColumns,
    slipping: Flags,
    tau_s: float,
    height_m: float,
) -> Nominal | None:
    """Lay out the ride; None where wheels, IMU and fixes have no minute in common.

    Parameters
    ----------
    way : Way
        One wheel, or left and right.
    level : Level
    fixes : FixColumns
        Their stamps on the wheels' clock.
    slipping : ndarray
        At each mean of `level`, whether a wheel slips.
    tau_s : float
        How long the fixes' error lasts.
    height_m : float
        Of the antenna, as configured.
    """
    t = level.time_s
    starts = [t[0], fixes.time_s[0], *(one.time_s[0] for one in way.wheels)]
    ends = [t[-1], fixes.time_s[-1], *(one.time_s[-1] for one in way.wheels)]
    first, last = max(starts), min(ends)
    if last - first < 60.0:
        return None
    nodes = np.arange(first, last, NODE_S)
    path = _Path(way, level)
    yaw, place = path.yaw(nodes), path.place(nodes)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    hole = np.concatenate([[0.0], np.cumsum(np.diff(t) > HOLE_S)])
    broken = np.diff(np.interp(nodes, t, hole)) > 0.0
    broken |= ~(way.known(nodes[1:]) & way.known(nodes[:-1]))
    slid = np.concatenate([[0.0], np.cumsum(slipping[1:] * np.diff(t))])
    a = np.diff(way.rounded_off(0, nodes))
    b = np.diff(way.rounded_off(len(way.wheels) - 1, nodes))
    two = len(way.wheels) == 2
    still = way.standing(nodes)
    standing = still[1:] & still[:-1] & (np.abs(a) + np.abs(b) < 1e-9)
    inside = (fixes.time_s > nodes[0]) & (fixes.time_s < nodes[-1])
    if inside.sum() < 30:
        return None
    placed = _placed(path, nodes, fixes, inside)
    placed = placed._replace(leaning=height_m * path.leaning(placed.time_s))
    return Nominal(
        time_s=nodes,
        dt_s=np.diff(nodes),
        yaw=yaw,
        turned=np.diff(yaw),
        step=np.diff(place) * np.exp(-1j * middle),
        way_a=a,
        way_b=b,
        upright=np.cos(np.interp(nodes[:-1], t, level.slope_rad)),
        standing=standing,
        broken=broken,
        slipping=np.diff(np.interp(nodes, t, slid)) > 0.0,
        share=(0.5, 0.5) if two else (1.0, 0.0),
        std=np.interp(nodes, placed.time_s, placed.std),
        fixes=placed,
        tau_s=tau_s,
    )


class _Path:
    """Yaw and place by wheels and gyroscope, at any instant."""

    def __init__(self, way: Way, level: Level) -> None:
        self._level = level
        t = self._t = level.time_s
        self._yaw = level.turned_rad
        turned = np.diff(self._yaw)
        left_m = sum(one.left_m for one in way.wheels) / len(way.wheels)
        gone = np.diff(way.at(t)) + left_m * turned
        slope = 0.5 * (level.slope_rad[1:] + level.slope_rad[:-1])
        # The chord of an arc is shorter by sin(x)/x of half its angle.
        chord = gone * np.cos(slope) * np.sinc(turned / (2.0 * np.pi))
        middle = 0.5 * (self._yaw[1:] + self._yaw[:-1])
        self._place = np.concatenate([[0.0], np.cumsum(chord * np.exp(1j * middle))])
        grid = np.maximum(np.diff(t), 1e-6)
        speed = np.concatenate([[0.0], gone * np.cos(slope) / grid])
        self._speed = smooth(speed, round(0.3 / MEAN_S) | 1)
        self._speed_t = t - 0.5 * MEAN_S
        self._rate = smooth(np.concatenate([[0.0], turned / grid]), round(0.3 / MEAN_S) | 1)
        acceleration = smooth(np.gradient(self._speed, t), round(0.5 / MEAN_S) | 1)
        self._acceleration = acceleration

    def yaw(self, time_s: Array) -> Array:
        found: Array = np.interp(time_s, self._t, self._yaw)
        return found

    def place(self, time_s: Array) -> Complex:
        real = np.interp(time_s, self._t, self._place.real)
        found: Complex = real + 1j * np.interp(time_s, self._t, self._place.imag)
        return found

    def leaning(self, time_s: Array) -> Complex:
        """How far a point a metre above the rail leans ahead and to the left, m."""
        ahead = -np.sin(np.interp(time_s, self._t, self._level.slope_rad))
        left: Complex = ahead - 1j * np.sin(np.interp(time_s, self._t, self._level.cant_rad))
        return left

    def motion(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Speed, rate about the vertical, acceleration."""
        return (
            np.interp(time_s, self._speed_t, self._speed),
            np.interp(time_s, self._speed_t, self._rate),
            np.interp(time_s, self._speed_t, self._acceleration),
        )


def _placed(path: _Path, nodes: Array, fixes: FixColumns, inside: Flags) -> Placed:
    time_s = fixes.time_s[inside]
    node = np.clip(np.searchsorted(nodes, time_s, side="right") - 1, 0, len(nodes) - 2)
    yaw, place = path.yaw(nodes), path.place(nodes)
    speed, rate, acceleration = path.motion(time_s)
    return Placed(
        node=node,
        time_s=time_s,
        turned=path.yaw(time_s) - yaw[node],
        step=(path.place(time_s) - place[node]) * np.exp(-1j * yaw[node]),
        speed=speed,
        rate=rate,
        acceleration=acceleration,
        place=fixes.p_l[inside, 0] + 1j * fixes.p_l[inside, 1],
        velocity=fixes.velocity_l[inside],
        std=fixes.std_m[inside],
        speed_std=fixes.speed_std_mps[inside],
        apart_s=np.concatenate([[1.0], np.diff(time_s)]),
        leaning=np.zeros(len(time_s), dtype=complex),
    )
