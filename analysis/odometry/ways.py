"""The wheels' way as a function of time: of several wheels the mean, where each goes its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry.material import MEAN_S, Inertial, WheelWay
from tramstream.processors.consistency.mounting import WINDOW_S
from tramstream.processors.consistency.way import Course

Array = NDArray[np.float64]

PAUSE_S = 1.0
"""Nothing is known of the way between two readings that are further apart."""
ROUNDED_S = 0.4
STAND_S = 1.0
"""So long no wheel must turn for a stand."""


@dataclass(frozen=True)
class Way:
    """Ways of one or two wheels on a common clock."""

    wheels: tuple[WheelWay, ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last instant at which all wheels were read."""
        first = max(float(one.time_s[0]) for one in self.wheels)
        return first, min(float(one.time_s[-1]) for one in self.wheels)

    def of(self, wheel: int, time_s: Array) -> Array:
        """Way of one wheel at times, m; level beyond its readings."""
        one = self.wheels[wheel]
        found: Array = np.interp(time_s, one.time_s, one.way_m)
        return found

    def rounded_off(self, wheel: int, time_s: Array) -> Array:
        """Way of one wheel, the mean over `ROUNDED_S`, in which the rounding to pulses cancels."""
        about = np.linspace(-0.5, 0.5, 21) * ROUNDED_S
        total: Array = sum((self.of(wheel, time_s + each) for each in about), np.zeros(1))
        return total / len(about)

    def at(self, time_s: Array) -> Array:
        """Mean way of all wheels."""
        total: Array = sum((self.of(k, time_s) for k in range(len(self.wheels))), np.zeros(1))
        return total / len(self.wheels)

    def speed(self, time_s: Array, over_s: float = 0.4) -> Array:
        """Mean speed over a short span about times."""
        inside = np.clip(time_s, self.span[0] + 0.5 * over_s, self.span[1] - 0.5 * over_s)
        ahead, behind = self.at(inside + 0.5 * over_s), self.at(inside - 0.5 * over_s)
        change: Array = (ahead - behind) / over_s
        return change

    def standing(self, time_s: Array) -> NDArray[np.bool_]:
        """Whether no wheel turns within `STAND_S` about times."""
        half = 0.5 * STAND_S
        still = np.ones(len(time_s), dtype=bool)
        for k in range(len(self.wheels)):
            least_m = max(0.3 * self.wheels[k].m_per_pulse, 1e-6)
            still &= np.abs(self.of(k, time_s + half) - self.of(k, time_s - half)) < least_m
        return still

    def known(self, time_s: Array) -> NDArray[np.bool_]:
        """Whether all wheels were read about times."""
        good = np.ones(len(time_s), dtype=bool)
        for one in self.wheels:
            right = np.clip(np.searchsorted(one.time_s, time_s), 1, len(one.time_s) - 1)
            good &= one.time_s[right] - one.time_s[right - 1] < PAUSE_S
            good &= (time_s >= one.time_s[0]) & (time_s <= one.time_s[-1])
        return good

    def course(self) -> Course:
        """The mean way as the check of the configuration keeps it: ten points a second."""
        time_s = np.arange(*self.span, 0.1)
        return Course(list(zip(time_s.tolist(), self.at(time_s).tolist(), strict=True)))

    def shifted(self, by_s: float) -> Way:
        """The same with all stamps earlier by so much."""
        return Way(tuple(_moved(one, by_s) for one in self.wheels))


def _moved(one: WheelWay, by_s: float) -> WheelWay:
    return WheelWay(one.name, one.time_s - by_s, one.way_m, one.left_m, one.m_per_pulse)


def gathered(imu: Inertial, way: Way) -> Iterator[tuple[float, list[float], bool]]:
    """Windows of half a second: end, mean force and rate in the case, whether it stands."""
    size = round(WINDOW_S / MEAN_S)
    count = len(imu.time_s) // size
    values = np.concatenate([imu.force_mps2, imu.rate_radps], axis=1)[: count * size]
    mean = values.reshape(count, size, 6).mean(axis=1)
    time_s = imu.time_s[: count * size].reshape(count, size)
    whole = time_s[:, -1] - time_s[:, 0] < 1.5 * WINDOW_S
    end_s = time_s[:, -1] + 0.5 * MEAN_S
    still = way.standing(end_s - 0.5 * WINDOW_S)
    for k in np.flatnonzero(whole).tolist():
        yield float(end_s[k]), mean[k].tolist(), bool(still[k])


def smooth(values: Array, window: int) -> Array:
    """Moving mean of an odd number of values, the ends repeated."""
    half = window // 2
    padded = np.concatenate([np.full(half + 1, values[0]), values, np.full(half, values[-1])])
    total = np.cumsum(padded)
    found: Array = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return found
