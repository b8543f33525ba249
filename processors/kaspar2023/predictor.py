"""From the fusion horizon to now for the model kaspar2023: its state moved on by newer means.

Acceleration and rates are what the means say with the errors that the filter has learned, which is
what the filter, too, makes of them: their process noise is large. The covariance is moved on in one
step.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from tramstream.clock import S
from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.filter import Kaspar2023Filter
from tramstream.processors.kaspar2023.model import STEP_S

CAPACITY = 512
"""Newest means that are kept: five seconds, far more than any horizon lies behind."""


@compiled
def _follow(x: Array, z: Array, dt_s: Array, gravity_mps2: float) -> None:
    """Move x on, in place, through readings z (n, 4) that end steps of `dt_s` (n,)."""
    for k in range(z.shape[0]):
        model.move(x, dt_s[k])
        model.take_reading(x, z[k], gravity_mps2)


@dataclass
class AheadMemory:
    """The readings that the filter has not seen yet."""

    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=CAPACITY))
    readings: deque[list[float]] = field(default_factory=lambda: deque(maxlen=CAPACITY))


class Ahead:
    """Keeps the readings that the filter has not seen yet, and a filter to try them on."""

    def __init__(self, Q: Array, memory: AheadMemory) -> None:
        self._Q = Q
        self._filter = Kaspar2023Filter(Q)
        self.memory = memory
        self._stamps, self._readings = self.memory.stamps, self.memory.readings

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest mean; 0 before the first."""
        return self._stamps[-1] if self._stamps else 0

    def append(self, stamp_ns: int, reading: list[float]) -> None:
        """Take (f_x, ω_v) of a mean; they come in order."""
        self._stamps.append(stamp_ns)
        self._readings.append(reading)

    def predict(
        self, kalman: Kaspar2023Filter, stamp_ns: int, gravity_mps2: float
    ) -> Kaspar2023Filter:
        """Give the filter as it would be at the newest mean; `kalman` is at `stamp_ns`."""
        while self._stamps and self._stamps[0] <= stamp_ns:
            self._stamps.popleft()
            self._readings.popleft()
        ahead = self._filter
        ahead.x, ahead.P = kalman.x, kalman.P  # neither filter edits them in place
        if self._stamps:
            stamps = np.array((stamp_ns, *self._stamps))
            dt_s = np.diff(stamps) / S
            lag_s = float(dt_s.sum())
            ahead.Q = self._Q * max(1.0, lag_s / STEP_S)
            ahead.predict(dt_s=lag_s)
            x = kalman.x.copy()
            _follow(x, np.array(self._readings), dt_s, gravity_mps2)
            ahead.x = x
        return ahead
