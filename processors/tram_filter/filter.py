"""The filter `tram`: it owns state, covariance, time and situation, and nobody else writes them.

`predict` moves it on, `apply` takes any measurement (`tram_model`), and the methods below them are
all other ways to change it. Names are those of filterpy: x, P, F, and after each `apply` y, S, K,
H, R and `log_likelihood`, as `filterpy.kalman.ExtendedKalmanFilter.update` leaves them, the scalars
of a measurement taken together. They are made when they are asked for, out of what the kernels
leave. It is no subclass: filterpy's Q, B, z and `update(z, HJacobian, Hx)` would not be what runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tramstream.clock import S as NS_PER_S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import Estimate, Verdict
from tramstream.estimation.records import Records, frozen, numbers, one
from tramstream.processors.tram_filter.estimate import estimate_of
from tramstream.processors.tram_model import map_shift, motion, prediction_to_now, wheel_path
from tramstream.processors.tram_model.measurement import (
    EVERY,
    NONE,
    PAIR_GATE,
    REFUSED,
    SCALAR_GATE,
    Measurement,
)
from tramstream.processors.tram_model.records import MEMORY, parameters, situation
from tramstream.processors.tram_model.states import COLUMNS, ROWS, SIZE, Ix
from tramstream.processors.tram_model.zero_velocity import STANDING_STD_MPS, ZeroVelocity

SPEED, GYRO_Z = int(Ix.SPEED), int(Ix.GYRO_Z)
"""A name of `Ix` takes longer to look up than what is read with it."""
LEAST_STEP_S = 1e-6
LONGEST_STEP_S = 0.1
"""Through a pause the filter goes in steps: what a step adds to the speed moves the next one."""
LOG_2PI = math.log(2.0 * math.pi)
_ZERO_VELOCITY = ZeroVelocity()


class Watcher(Protocol):
    """Whoever wants to know what the filter does, as a smoother does."""

    def predicted(self, memory: Array) -> None:
        """Learn that state and covariance have moved on."""

    def updated(self, memory: Array) -> None:
        """Learn that a measurement was applied, or refused."""

    def made_anew(self, state: int) -> None:
        """Learn that a state has become independent of all that was before."""


@dataclass
class FilterMemory:
    """What the next step needs of a `TramFilter`: views of its records; parameters are settings."""

    x: Array
    P: Array
    acceleration: Array
    """Shape (1,); m/s²."""
    yaw_rate: Array
    """Shape (1,); rad/s."""
    situation: Records
    """See `records.Situation`."""
    stamp_ns: int = 0
    """Time of the state, vehicle clock."""


class TramFilter:
    """x (32, 1) and P (32, 32) of the model `tram`.

    Parameters
    ----------
    vehicle : Vehicle
    gravity_mps2 : float
        At the place.
    """

    def __init__(self, vehicle: Vehicle, gravity_mps2: float) -> None:
        constants = parameters(vehicle, gravity_mps2)
        self.parameters = frozen(constants)
        """The model's constants; see `records.Parameters`."""
        self._map_variance = float(constants["map_variance"][0])
        self.situation = situation(vehicle)
        """How the vehicle goes; see `records.Situation`."""
        self.fields = one(MEMORY)
        """State, covariance, and what the last step left; see `records.Memory`."""
        # What kernels take: the same as plain numbers.
        self.wheel_signs = self.situation["wheel_sign"][0].data
        """1 or −1 for each wheel, by which way it counts; to be read."""
        self._c, self._s = numbers(constants), numbers(self.situation)
        self.memory = numbers(self.fields)
        self._x: Array = self.fields["x"][0]
        self._P: Array = self.fields["P"][0]
        self.state = self._x.data
        """x, to be read: one number takes a third of the time that numpy takes."""
        self.variances = self._P.diagonal().data
        """Diagonal of P, likewise."""
        self._y, self._S = self.fields["y"][0].data, self.fields["S"][0].data
        motion_of = self.fields["acceleration"], self.fields["yaw_rate"]
        self.remembered = FilterMemory(self._x, self._P, *motion_of, self.situation)
        self.log_likelihood_sum: float | None = None
        """Of all measurements since it was last set, without what all hypotheses share; None while
        no hypotheses are compared."""
        self.watcher: Watcher | None = None

    @property
    def stamp_ns(self) -> int:
        """Time of the state, vehicle clock."""
        return self.remembered.stamp_ns

    # What a filterpy user reads ------------------------------------------------------------------
    @property
    def x(self) -> Array:
        return self._x.reshape(SIZE, 1)

    @x.setter
    def x(self, value: Any) -> None:
        self._x[:] = np.asarray(value, dtype=float).reshape(SIZE)

    @property
    def P(self) -> Array:
        return self._P

    @P.setter
    def P(self, value: Any) -> None:
        self._P[:] = np.eye(SIZE) * float(value) if np.ndim(value) == 0 else value

    @property
    def F(self) -> Array:
        """Transition of the last prediction."""
        F = np.eye(SIZE)
        F[ROWS, COLUMNS] += self.fields["A"][0][ROWS, COLUMNS]
        return F

    @property
    def H(self) -> Array:
        """Rows of the last measurement, as they were linearised."""
        f = self.fields[0]
        H = np.zeros((int(f["rows"]), SIZE))
        for k, count in enumerate(f["counts"][: len(H)]):
            H[k, f["columns"][k, :count]] = f["values"][k, :count]
        return H

    @property
    def R(self) -> Array:
        """Noise of the last measurement, as it was used."""
        return np.diag(self.fields["R"][0, : self.fields["rows"][0]])

    @property
    def y(self) -> Array:
        """Innovations of the last measurement, before it was taken."""
        y: Array = self._unit_lower() @ self.fields["y"][0, : self.fields["rows"][0]]
        return y.reshape(-1, 1)

    @property
    def S(self) -> Array:
        """Covariance of the last innovations."""
        f, L = self.fields[0], self._unit_lower()
        S: Array = L @ np.diag(np.abs(f["S"][: len(L)])) @ L.T
        if self.refused and len(S) == 2:
            S[0, 1] = S[1, 0] = f["cross"]
        return S

    @property
    def K(self) -> Array:
        """Gain of the last measurement; zeros where the innovation gate refused it."""
        L = self._unit_lower()
        K: Array = np.linalg.solve(L.T, self.fields["K"][0, : len(L)]).T
        return K

    @property
    def refused(self) -> bool:
        """Whether the innovation gate refused the last measurement."""
        return bool(self._S[0] < 0.0)

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the density of the last innovations."""
        y, S = self.y, self.S
        distance = float((y.T @ np.linalg.solve(S, y))[0, 0])
        return -0.5 * (distance + math.log(np.linalg.det(S)) + len(y) * LOG_2PI)

    def _unit_lower(self) -> Array:
        """L of S = L D Lᵀ, D being the variances of the scalars, each given those before it."""
        H, K = self.H, self.fields["K"][0]
        L = np.eye(len(H))
        for k in range(len(H)):
            L[k, :k] = K[:k] @ H[k]
        return L

    # Prediction ----------------------------------------------------------------------------------
    def predict(self, u: Array, dt: float) -> None:
        """Move on by `dt` s with the numbers of one inertial `Reading`."""
        motion.predict(self.memory, self._c, self._s, u, dt)
        if self.watcher is not None:
            self.watcher.predicted(self.memory)

    def rest(self, dt: float) -> None:
        """Let `dt` s pass for a vehicle that stands."""
        motion.rest(self.memory, self._c, self._s, dt)

    def go_to(self, stamp_ns: int, u: Array, standing: bool) -> None:
        """Go to an instant, which lies in no past, with the numbers of one inertial `Reading`."""
        dt = (stamp_ns - self.remembered.stamp_ns) / NS_PER_S
        if dt < LEAST_STEP_S:
            return
        if standing:
            self.rest(dt)
        else:
            while dt > LONGEST_STEP_S:
                self.predict(u, LONGEST_STEP_S)
                dt -= LONGEST_STEP_S
            self.predict(u, dt)
        self.remembered.stamp_ns = stamp_ns

    def estimate_ahead(
        self, ahead: Array, kept: Array, begin: int, end: int, mean: Array, values: Array
    ) -> None:
        """Fill the values of an estimate after newer readings; see `prediction_to_now`."""
        given = self.memory, ahead, self._c, self._s, kept, begin, end, mean
        prediction_to_now.estimate_ahead(*given, values)

    def estimate(
        self, stamp_ns: int, mode: int, standing: bool, verdicts: list[Verdict]
    ) -> Estimate:
        """Give the motion of the vehicle's origin."""
        return estimate_of(self.memory, self._c, stamp_ns, mode, standing, verdicts)

    # Measurements --------------------------------------------------------------------------------
    def apply(self, measurement: Measurement) -> list[Verdict]:
        """Take a measurement, or refuse it; gives what is published of its innovations."""
        measurement.update(self.memory, self._c, self._s)
        if self.watcher is not None:
            self.watcher.updated(self.memory)
        kind = measurement.verdicts
        if self.log_likelihood_sum is not None and kind != NONE:
            self.log_likelihood_sum += self._log_likelihood(kind, len(measurement.names))
        if kind == EVERY:
            return self._verdicts(measurement.names)
        return self._verdicts(measurement.names[:1]) if kind == REFUSED and self.refused else []

    def _verdicts(self, names: tuple[str, ...]) -> list[Verdict]:
        """Give what is published of the last innovations; the gate left its word in S's sign."""
        y, S = self._y, self._S
        if len(names) == 1:
            variance = S[0]
            return [Verdict(names[0], y[0], abs(variance), variance > 0.0)]
        return [Verdict(name, y[k], abs(S[k]), S[k] > 0.0) for k, name in enumerate(names)]

    def _log_likelihood(self, kind: int, rows: int) -> float:
        """What the last innovations tell of a hypothesis, without what all of them share.

        Refused ones count as much as the last that would not have been. Of those that are published
        when they are refused, the variance is the same for all hypotheses.
        """
        total = 0.0
        for y, S in zip(self._y[:rows], self._S[:rows], strict=True):
            if kind == REFUSED:
                total -= 0.5 * (y * y / S if S > 0.0 else SCALAR_GATE)
            else:
                variance = abs(S)
                distance = min(y * y / variance, PAIR_GATE) if variance > 0.0 else PAIR_GATE
                total -= 0.5 * (distance + math.log(variance))
        return total

    def zero_velocity(self) -> bool:
        """Take that the vehicle has no speed; False if its speed had to be forgotten for that."""
        self.apply(_ZERO_VELOCITY)
        if self.refused:
            self.reset(Ix.SPEED, 0.0, STANDING_STD_MPS)
            return False
        return True

    # Changes that are no measurement -------------------------------------------------------------
    def forget(self, states: Sequence[Ix], stds: Sequence[float]) -> None:
        """Make states independent of all others, with new deviations; their values stay."""
        for state, std in zip(states, stds, strict=True):
            self._P[state, :] = self._P[:, state] = 0.0
            self._P[state, state] = std * std
        if self.watcher is not None:
            for state in states:
                self.watcher.made_anew(state)

    def reset(self, state: Ix, value: float, std: float) -> None:
        """Give a state a value of its own that nothing before has told."""
        self._x[state] = value
        self.forget((state,), (std,))

    def widen(self, state: Ix, std: float) -> None:
        """Add to a state's uncertainty; what others know of it stays."""
        self._P[state, state] += std * std

    def on_map(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Where a map that is beside the rails as a whole has a place."""
        return east_m - self.state[Ix.MAP_EAST], north_m - self.state[Ix.MAP_NORTH]

    def walk_map(self) -> None:
        """Let the map lie otherwise beside the rails, as it may after a metre of way."""
        limit = self._map_variance
        for state in (Ix.MAP_EAST, Ix.MAP_NORTH):
            if self.variances[state] < limit * (1.0 - map_shift.WALK):
                self._P[state, state] += map_shift.WALK * limit

    def exchange(self, state: Ix, other: Ix, std: float) -> None:
        """Take that so much may belong to one state rather than to the other: their sum stays."""
        for k in (state, other):
            self._P[k, k] += std * std
        self._P[state, other] -= std * std
        self._P[other, state] -= std * std

    def shift(self, state: Ix, by: float) -> None:
        """Add to a state; its uncertainty stays."""
        self._x[state] += by

    def set_time(self, stamp_ns: int) -> None:
        """Let the state be that of another instant, without anything having passed."""
        self.remembered.stamp_ns = stamp_ns

    def set_states(self, first: Ix, values: Sequence[float]) -> None:
        """Give neighbouring states new values; their uncertainty stays."""
        self._x[first : first + len(values)] = values

    def restart_path(self, wheel: int, variance: float) -> None:
        """Count a wheel's path from here on; see `wheel_path.begin`."""
        wheel_path.begin(self.memory, self._s, wheel, variance)
        if self.watcher is not None:
            self.watcher.made_anew(Ix.PATH_A + wheel)

    def expected_path(self, wheel: int) -> float:
        """Give the path since its last reading that a wheel's counter should show now, m."""
        return float(wheel_path.shown(self.memory, self._s, wheel))

    # The situation -------------------------------------------------------------------------------
    @property
    def heading_known(self) -> bool:
        """Whether the state has a heading; without one its position is the antenna's."""
        return bool(self.situation["heading_known"][0])

    def set_heading(self, yaw_rad: float, std_rad: float) -> None:
        """Set the heading; the position, until now the antenna's, becomes the pivot's."""
        self.reset(Ix.YAW, yaw_rad, std_rad)
        self.situation["heading_known"] = 1
        ax, ay, az = self.parameters["antenna_lever"][0].tolist()
        ax += self.state[Ix.PIVOT]
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        x, P = self._x, self._P
        x[Ix.EAST] -= east
        x[Ix.NORTH] -= north
        x[Ix.UP] -= az
        # An error of the heading moves the pivot about the antenna, one of its place along x.
        moved = ((Ix.EAST, north, -cos), (Ix.NORTH, -east, -sin))
        for state, by_yaw, by_pivot in moved:
            P[state, :] += by_yaw * P[Ix.YAW, :] + by_pivot * P[Ix.PIVOT, :]
        for state, by_yaw, by_pivot in moved:
            P[:, state] += by_yaw * P[:, Ix.YAW] + by_pivot * P[:, Ix.PIVOT]

    def forget_heading(self) -> None:
        """Go on without a heading: the position is the antenna's from here on."""
        self.situation["heading_known"] = 0
        self.reset(Ix.YAW, 0.0, 0.0)

    def set_motion_noise(self, accel_density: float, rate_density: Sequence[float] | Array) -> None:
        """Set the noise of what drives speed and attitude; see `records.Situation`."""
        self.situation["accel_density"] = accel_density
        self.situation["rate_density"] = rate_density

    def set_fix_error(self, decay: float, density: float, up_density: float) -> None:
        """Set how the error of the fixes goes on; see `records.Situation`."""
        s = self.situation
        s["fix_decay"], s["fix_density"], s["fix_up_density"] = decay, density, up_density

    def set_slow_fix_error(self, decay: float, density: float) -> None:
        """Set how the part of it that lasts for minutes goes on; see `records.Situation`."""
        self.situation["slow_decay"], self.situation["slow_density"] = decay, density

    def set_wheel(self, wheel: int, offset_m: float) -> None:
        """Set how far a wheel stands to the left of the axis."""
        self.situation["wheel_offset"][0, wheel] = offset_m

    def wheel_offsets_m(self) -> list[float]:
        """How far each wheel stands to the left of the axis."""
        offsets: list[float] = self.situation["wheel_offset"][0].tolist()
        return offsets

    def set_wheel_sign(self, wheel: int, sign: float) -> None:
        """Set which way a wheel counts."""
        self.situation["wheel_sign"][0, wheel] = sign
