"""The equations of `batch`: residuals, derivatives and weights, and their normal equations."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from tramstream.analysis.odometry.nominal import NODE_S, Nominal, Slot
from tramstream.analysis.odometry.stated import (
    ANTENNA_STD_M,
    DELAY_STD_S,
    GYRO_SCALE_STD,
    SCALE_STD,
    SLOW_S,
    TRACK_STD,
    Stated,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PER_NODE = len(Slot)
BAND = 2 * PER_NODE - 1


class Constant(IntEnum):
    """What does not change within a ride."""

    SCALE_A = 0
    SCALE_B = 1
    GYRO_SCALE = 2
    AHEAD = 3
    LEFT = 4
    DELAY = 5
    TRACK = 6


CONSTANTS = len(Constant)
PRIOR_STD = np.array(
    [SCALE_STD, SCALE_STD, GYRO_SCALE_STD, ANTENNA_STD_M, ANTENNA_STD_M, DELAY_STD_S, TRACK_STD]
)
TAILS = 5.0
"""Degrees of freedom of Student's t, as which residuals are weighed."""
ROBUST_FROM = 3
BROKEN_M = 1e4
"""Nothing is known of the way where readings are missing."""
STANDING_RAD = 2e-5
"""A vehicle that stands does not turn; by so much the rail lets it, after a second."""
FIRST_P_M = 1e5


class Rows:
    """Equations as they are gathered."""

    def __init__(self, robust: bool) -> None:
        self._robust = robust
        self._count = 0
        self._row: list[NDArray[np.int64]] = []
        self._column: list[NDArray[np.int64]] = []
        self._value: list[Array] = []
        self._constants: list[Array] = []
        self._residual: list[Array] = []
        self._weight: list[Array] = []
        self._squares, self._judged = 0.0, 0

    def add(
        self,
        node: NDArray[np.int64],
        derivatives: Mapping[int, Array],
        constants: Mapping[int, Array],
        residual: Array,
        weight: Array,
    ) -> None:
        """Add one equation a row; a slot of the node after `node` is `PER_NODE` more."""
        rows = np.arange(self._count, self._count + len(node))
        self._count += len(node)
        for slot, values in derivatives.items():
            self._row.append(rows)
            self._column.append(node * PER_NODE + slot)
            self._value.append(np.broadcast_to(values, rows.shape))
        border = np.zeros((len(node), CONSTANTS))
        for constant, values in constants.items():
            border[:, constant] = values
        self._constants.append(border)
        self._residual.append(residual)
        self._weight.append(weight)

    def weighed(self, squares: Array, std: Array, dimensions: int) -> Array:
        """Weights of residuals of known deviation by Student's t; `squares` are of all axes."""
        normal = squares / std**2
        if not self._robust:
            return 1.0 / std**2
        share = (TAILS + dimensions) / (TAILS + normal)
        self._squares += float((share * normal).sum())
        self._judged += dimensions * len(normal)
        weight: Array = share / std**2
        return weight

    def pair(
        self,
        node: NDArray[np.int64],
        derivatives: Mapping[int, Complex],
        constants: Mapping[int, Complex],
        residual: Complex,
        std: tuple[Array, Array, Complex],
    ) -> None:
        """Add equations of complex numbers, each of two reals.

        `std` are the deviations along and across a direction, and that direction.
        """
        along, across, direction = std
        turned = residual * np.conj(direction)
        normal = (turned.real / along) ** 2 + (turned.imag / across) ** 2
        share = self.weighed(normal, np.ones(len(normal)), 2)
        for part, deviation in ((np.real, along), (np.imag, across)):
            self.add(
                node,
                {slot: part(value * np.conj(direction)) for slot, value in derivatives.items()},
                {name: part(value * np.conj(direction)) for name, value in constants.items()},
                part(turned),
                share / deviation**2,
            )

    @property
    def misfit(self) -> float:
        return float(np.sqrt(self._squares / max(self._judged, 1)))

    def normal(self, size: int) -> tuple[Array, Array, Array, Array, Array]:
        """Band (lower), border, corner and the two right-hand sides."""
        at = (np.concatenate(self._row), np.concatenate(self._column))
        J = coo_matrix((np.concatenate(self._value), at), shape=(self._count, size)).tocsr()
        C = np.concatenate(self._constants)
        w = np.concatenate(self._weight)
        r = np.concatenate(self._residual)
        WC = C * w[:, None]
        N = (J.T @ J.multiply(w[:, None]).tocsr()).tocoo()
        band = np.zeros((BAND + 1, size))
        lower = N.row >= N.col
        np.add.at(band, (N.row[lower] - N.col[lower], N.col[lower]), N.data[lower])
        return band, J.T @ WC, C.T @ WC, J.T @ (w * r), WC.T @ r


def rows_of(
    nominal: Nominal, stated: Stated, x: Array, constants: Array, scale: float, round_: int = 99
) -> Rows:
    """All equations at nodes `x` and `constants`; derivatives are of what is expected."""
    rows = Rows(round_ >= ROBUST_FROM)
    _motion(rows, nominal, stated, x, constants)
    _turning(rows, nominal, stated, x, constants)
    _walks(rows, nominal, stated, x, scale)
    _fixes(rows, nominal, stated, x, constants, scale)
    _velocities(rows, nominal, x, constants)
    _priors(rows, nominal, stated, x, constants)
    return rows


def _motion(rows: Rows, n: Nominal, stated: Stated, x: Array, c: Array) -> None:
    k = np.arange(len(n.time_s) - 1)
    p = x[:, Slot.EAST] + 1j * x[:, Slot.NORTH]
    yaw = 0.5 * (x[:-1, Slot.YAW] + x[1:, Slot.YAW])
    turn = np.exp(1j * yaw)
    way = turn * n.step
    scaled = (1.0 + n.mean_scale(c)) * way
    one = np.ones(len(k), dtype=complex)
    half = 0.5j * scaled
    gone = np.abs(n.step)
    along = np.sqrt(stated.creep**2 * gone / n.wheels + stated.reading**2 / n.wheels)
    along = np.where(n.broken, BROKEN_M, np.where(n.slipping, along + n.slip_m, along))
    across = np.where(n.broken, BROKEN_M, stated.side * np.sqrt(n.dt_s * (gone > 0.0) + 0.01))
    rows.pair(
        k,
        {
            Slot.EAST: -one,
            Slot.NORTH: -1j * one,
            Slot.YAW: -half,
            PER_NODE + Slot.EAST: one,
            PER_NODE + Slot.NORTH: 1j * one,
            PER_NODE + Slot.YAW: -half,
        },
        {Constant.SCALE_A: -way * n.share[0], Constant.SCALE_B: -way * n.share[1]},
        -(p[1:] - p[:-1] - scaled),
        (along, across, turn),
    )


def _turning(rows: Rows, n: Nominal, stated: Stated, x: Array, c: Array) -> None:
    k = np.arange(len(n.time_s) - 1)
    one = np.ones(len(k))
    d_yaw = np.diff(x[:, Slot.YAW])
    read = n.turned
    r = d_yaw - read * (1.0 + c[Constant.GYRO_SCALE]) + x[:-1, Slot.BIAS] * n.dt_s
    std = np.where(n.broken, 10.0, stated.gyro_noise * np.sqrt(n.dt_s))
    rows.add(
        k,
        {Slot.YAW: -one, PER_NODE + Slot.YAW: one, Slot.BIAS: n.dt_s},
        {Constant.GYRO_SCALE: -read},
        -r,
        rows.weighed(r**2, std, 1),
    )
    still = np.flatnonzero(n.standing)
    rows.add(
        still,
        {Slot.YAW: -one[still], PER_NODE + Slot.YAW: one[still]},
        {},
        -d_yaw[still],
        np.full(len(still), 1.0 / (STANDING_RAD**2 * NODE_S)),
    )
    if n.wheels < 2:
        return
    good = np.flatnonzero(~n.broken & ~n.standing & ~n.slipping)
    a, b = n.way_a[good], n.way_b[good]
    lever = stated.track_m * n.upright[good]
    r = (1.0 + c[Constant.TRACK]) * lever * d_yaw[good]
    r -= b * (1.0 + c[Constant.SCALE_B]) - a * (1.0 + c[Constant.SCALE_A])
    gone = np.abs(a + b)
    std = np.sqrt(stated.creep**2 * gone + 2.0 * stated.reading**2)
    rows.add(
        good,
        {Slot.YAW: -lever, PER_NODE + Slot.YAW: lever},
        {Constant.SCALE_A: a, Constant.SCALE_B: -b, Constant.TRACK: lever * d_yaw[good]},
        -r,
        rows.weighed(r**2, std, 1),
    )


def _walks(rows: Rows, n: Nominal, stated: Stated, x: Array, scale: float) -> None:
    k = np.arange(len(n.time_s) - 1)
    one = np.ones(len(k))
    r = np.diff(x[:, Slot.BIAS])
    std = stated.gyro_walk * np.sqrt(n.dt_s)
    rows.add(k, {Slot.BIAS: -one, PER_NODE + Slot.BIAS: one}, {}, -r, 1.0 / std**2)
    fast, slow = n.error_stds(scale)
    for slots, tau_s, size in (
        ((Slot.ERROR_EAST, Slot.ERROR_NORTH), stated.error_tau_s, fast),
        ((Slot.SLOW_EAST, Slot.SLOW_NORTH), SLOW_S, slow),
    ):
        # At a stand the surroundings stand still too: the error walks, and does not decay.
        keep = np.where(n.standing, 1.0, np.exp(-n.dt_s / tau_s))
        std = size[:-1] * np.sqrt(2.0 * n.dt_s / tau_s)
        squares = sum((x[1:, s] - keep * x[:-1, s]) ** 2 for s in slots)
        weight = rows.weighed(np.asarray(squares), std, 2)
        for slot in slots:
            r = x[1:, slot] - keep * x[:-1, slot]
            rows.add(k, {slot: -keep, PER_NODE + slot: one}, {}, -r, weight)


def _fixes(rows: Rows, n: Nominal, stated: Stated, x: Array, c: Array, scale: float) -> None:
    f = n.fixes
    k = f.node
    turn = np.exp(1j * x[k, Slot.YAW])
    here = turn * np.exp(1j * f.turned)
    lever = c[Constant.AHEAD] + 1j * c[Constant.LEFT] + f.leaning
    way = turn * f.step
    scaled = (1.0 + n.mean_scale(c)) * way
    velocity = here * (f.speed + 1j * f.rate * lever)
    expected = (
        x[k, Slot.EAST] + 1j * x[k, Slot.NORTH] + scaled + here * lever
        + x[k, Slot.ERROR_EAST] + x[k, Slot.SLOW_EAST]
        + 1j * (x[k, Slot.ERROR_NORTH] + x[k, Slot.SLOW_NORTH])
        - velocity * c[Constant.DELAY]
    )  # fmt: skip
    one = np.ones(len(k), dtype=complex)
    white = np.maximum(stated.white_share * f.std * max(scale, 1.0), 0.01)
    white = white * np.sqrt(np.maximum(1.0, 0.2 / np.maximum(f.apart_s, 1e-3)))
    rows.pair(
        k,
        {
            Slot.EAST: one,
            Slot.NORTH: 1j * one,
            Slot.YAW: 1j * (scaled + here * lever - velocity * c[Constant.DELAY]),
            Slot.ERROR_EAST: one,
            Slot.ERROR_NORTH: 1j * one,
            Slot.SLOW_EAST: one,
            Slot.SLOW_NORTH: 1j * one,
        },
        {
            Constant.SCALE_A: way * n.share[0],
            Constant.SCALE_B: way * n.share[1],
            Constant.AHEAD: here * (1.0 - 1j * f.rate * c[Constant.DELAY]),
            Constant.LEFT: 1j * here * (1.0 - 1j * f.rate * c[Constant.DELAY]),
            Constant.DELAY: -velocity,
        },
        f.place - expected,
        (white, white, one),
    )


def _velocities(rows: Rows, n: Nominal, x: Array, c: Array) -> None:
    f = n.fixes
    which = np.flatnonzero(np.isfinite(f.velocity) & (np.abs(f.speed) > 0.5))
    if not len(which):
        return
    k = f.node[which]
    here = np.exp(1j * (x[k, Slot.YAW] + f.turned[which]))
    lever = c[Constant.AHEAD] + 1j * c[Constant.LEFT] + f.leaning[which]
    v, w, a = f.speed[which], f.rate[which], f.acceleration[which]
    scaled = (1.0 + n.mean_scale(c)) * v
    change = here * (a + 1j * w * scaled - w**2 * lever)
    expected = here * (scaled + 1j * w * lever) - change * c[Constant.DELAY]
    std = np.maximum(f.speed_std[which], 0.03)
    std = std * np.sqrt(np.maximum(1.0, 0.2 / np.maximum(f.apart_s[which], 1e-3)))
    rows.pair(
        k,
        {Slot.YAW: 1j * expected},
        {
            Constant.SCALE_A: here * v * n.share[0],
            Constant.SCALE_B: here * v * n.share[1],
            Constant.AHEAD: here * 1j * w,
            Constant.LEFT: -here * w,
            Constant.DELAY: -change,
        },
        f.velocity[which] - expected,
        (std, std, here),
    )


def _priors(rows: Rows, n: Nominal, stated: Stated, x: Array, c: Array) -> None:
    first = np.zeros(1, dtype=np.int64)
    fast, slow = n.error_stds(1.0)
    stds = {
        Slot.YAW: 10.0,
        Slot.BIAS: stated.gyro_bias,
        Slot.ERROR_EAST: fast[0],
        Slot.ERROR_NORTH: fast[0],
        Slot.SLOW_EAST: slow[0],
        Slot.SLOW_NORTH: slow[0],
    }
    for slot, std in stds.items():
        target = x[0, slot] if slot is Slot.YAW else 0.0
        rows.add(
            first, {slot: np.ones(1)}, {}, np.array([target - x[0, slot]]), np.ones(1) / std**2
        )
    for slot in (Slot.EAST, Slot.NORTH):
        rows.add(first, {slot: np.ones(1)}, {}, np.zeros(1), np.full(1, 1.0 / FIRST_P_M**2))
    for constant, std in zip(Constant, PRIOR_STD.tolist(), strict=True):
        unused = constant is Constant.SCALE_B and n.wheels < 2
        weight = 1.0 / (1e-9 if unused else std) ** 2
        rows.add(first, {}, {constant: np.ones(1)}, np.array([-c[constant]]), np.full(1, weight))
