"""From the fusion horizon to now: the filter's state moved on by newer inertial means."""

from __future__ import annotations

from typing import Any

import numpy as np

from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import VALUES
from tramstream.estimation.records import numbers, one
from tramstream.processors.tram.filter import TramFilter
from tramstream.processors.tram_model import axes, prediction_to_now
from tramstream.processors.tram_model.prediction_to_now import KEPT
from tramstream.processors.tram_model.records import INERTIAL, MEMORY, READING
from tramstream.proto.sync_pb2 import ImuMean

CAPACITY = 512
"""Newest means that are kept: five seconds, far more than any horizon lies behind."""
MAX_STEP_S = 0.1
"""A longer pause between means: what acted in it is not known."""


class Ahead:
    """Keeps the readings that the filter has not seen yet, in the vehicle's axes."""

    def __init__(self, vehicle: Vehicle) -> None:
        mounting = vehicle.imu.mounting_deg if vehicle.imu else (0.0, 0.0, 0.0)
        self._C_vb = np.ascontiguousarray(C_vl(*np.radians(mounting)).T)
        self._kept = np.zeros(CAPACITY, KEPT)
        self._numbers = numbers(self._kept)
        self._stamps_ns: list[int] = []
        self._begin = 0  # the first that the filter has not seen
        self._inertial = numbers(one(INERTIAL))
        self._last_ns = 0
        self._memory, self._mean = numbers(one(MEMORY)), numbers(one(READING))

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest mean; 0 before the first."""
        return self._last_ns

    def append(self, mean: ImuMean) -> None:
        """Take a mean, unless there is a newer one already, or it cannot be."""
        stamp_ns = mean.stamp_ns
        dt = (stamp_ns - self._last_ns) / S
        if dt <= 0.0:
            return
        if dt > MAX_STEP_S:
            dt = 0.0
        if len(self._stamps_ns) == CAPACITY:
            self._drop(max(self._begin, CAPACITY // 4))
        index, read = len(self._stamps_ns), axes.scalars_of(mean)
        if prediction_to_now.keep(self._numbers, index, self._inertial, self._C_vb, *read, dt):
            self._last_ns = stamp_ns
            self._stamps_ns.append(stamp_ns)

    def _drop(self, count: int) -> None:
        kept = len(self._stamps_ns) - count
        self._kept[:kept] = self._kept[count : count + kept].copy()
        del self._stamps_ns[:count]
        self._begin = max(0, self._begin - count)

    def predict(self, ekf: TramFilter, horizon_ns: int) -> Array:
        """Values of an estimate (`tramstream.estimation.localiser`) at the newest mean.

        The filter is at `horizon_ns` and knows its heading.
        """
        stamps, begin = self._stamps_ns, self._begin
        count = len(stamps)
        while begin < count and stamps[begin] <= horizon_ns:
            begin += 1
        self._begin = begin
        values = np.empty(VALUES)
        ekf.estimate_ahead(self._memory, self._numbers, begin, count, self._mean, values)
        return values

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> dict[str, Any]:
        kept = self._kept[: len(self._stamps_ns)]
        return {
            "inputs": kept["reading"].copy().view(np.float64).reshape(-1, _NUMBERS),
            "durations": kept["duration"].copy(),
            "stamps_ns": list(self._stamps_ns),
            "begin": self._begin,
            "reading": self._inertial.copy(),
            "last_ns": self._last_ns,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._stamps_ns, self._begin = list(state["stamps_ns"]), state["begin"]
        kept = self._kept[: len(self._stamps_ns)]
        inputs = np.ascontiguousarray(state["inputs"], dtype=np.float64)
        kept["reading"] = inputs.view(READING).reshape(-1)
        kept["duration"] = state["durations"]
        read = np.ravel(state["reading"])  # older versions had one number more
        self._inertial[:] = read[: len(self._inertial)]
        self._last_ns = state["last_ns"]


_NUMBERS = READING.itemsize // 8
