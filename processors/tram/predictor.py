"""From the fusion horizon to now: the filter's state moved on by newer inertial means."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tramstream.attitude import C_bv_of
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import VALUES
from tramstream.estimation.records import numbers, one
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model import axes, prediction_to_now
from tramstream.processors.tram_model.prediction_to_now import KEPT
from tramstream.processors.tram_model.records import INERTIAL, MEMORY, READING
from tramstream.proto.sync_pb2 import ImuMean

CAPACITY = 512
"""Newest means that are kept: five seconds, far more than any horizon lies behind."""
MAX_STEP_S = 0.1
"""A longer pause between means: what acted in it is not known."""


class Means:
    """Readings in one block, those that the filter has seen first; kept are those that it has not.

    Attributes
    ----------
    numbers : ndarray
        Of `KEPT` records.
    stamps_ns : list of int
    begin : int
        The first that the filter has not seen.
    """

    def __init__(self) -> None:
        self._kept = np.zeros(CAPACITY, KEPT)
        self.numbers = numbers(self._kept)
        self.stamps_ns: list[int] = []
        self.begin = 0

    def drop(self, count: int) -> None:
        """Forget the oldest."""
        kept = len(self.stamps_ns) - count
        self._kept[:kept] = self._kept[count : count + kept].copy()
        del self.stamps_ns[:count]
        self.begin = max(0, self.begin - count)

    def to_plain(self) -> list[Any]:
        return [self._kept[self.begin : len(self.stamps_ns)].copy(), self.stamps_ns[self.begin :]]

    @classmethod
    def from_plain(cls, plain: Any) -> Means:
        """Raises TypeError if `plain` is not what `to_plain` gives."""
        fits = isinstance(plain, list) and len(plain) == 2 and isinstance(plain[0], np.ndarray)
        if not fits or plain[0].dtype != KEPT or not plain[0].shape == (len(plain[1]),):
            raise TypeError("memory of another version: not readings and their stamps")
        if len(plain[1]) > CAPACITY:
            raise TypeError("memory of another version: more readings than there is room for")
        means = cls()
        means._kept[: len(plain[1])] = plain[0]
        means.stamps_ns = list(plain[1])
        return means


@dataclass
class AheadMemory:
    """What `Ahead` remembers."""

    means: Means = field(default_factory=Means)
    inertial: Array = field(default_factory=lambda: numbers(one(INERTIAL)))
    last_ns: int = 0


class Ahead:
    """Keeps the readings that the filter has not seen yet, in the vehicle's axes."""

    def __init__(self, vehicle: Vehicle, memory: AheadMemory | None = None) -> None:
        self._C_vb = np.ascontiguousarray(C_bv_of(vehicle.imu).T)
        self.memory = AheadMemory() if memory is None else memory
        self._means = self.memory.means
        self._memory, self._mean = numbers(one(MEMORY)), numbers(one(READING))

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest mean; 0 before the first."""
        return self.memory.last_ns

    def append(self, mean: ImuMean) -> None:
        """Take a mean, unless there is a newer one already, or it cannot be."""
        stamp_ns, memory, means = mean.stamp_ns, self.memory, self._means
        dt = (stamp_ns - memory.last_ns) / S
        if dt <= 0.0:
            return
        if dt > MAX_STEP_S:
            dt = 0.0
        if len(means.stamps_ns) == CAPACITY:
            means.drop(max(means.begin, CAPACITY // 4))
        index, read = len(means.stamps_ns), axes.scalars_of(mean)
        if prediction_to_now.keep(means.numbers, index, memory.inertial, self._C_vb, *read, dt):
            memory.last_ns = stamp_ns
            means.stamps_ns.append(stamp_ns)

    def predict(self, ekf: TramFilter, horizon_ns: int) -> Array:
        """Values of an estimate (`tramstream.estimation.localiser`) at the newest mean.

        The filter is at `horizon_ns` and knows its heading.
        """
        means = self._means
        stamps, begin = means.stamps_ns, means.begin
        count = len(stamps)
        while begin < count and stamps[begin] <= horizon_ns:
            begin += 1
        means.begin = begin
        values = np.empty(VALUES)
        ekf.estimate_ahead(self._memory, means.numbers, begin, count, self._mean, values)
        return values
