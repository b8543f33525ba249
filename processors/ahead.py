"""From the fusion horizon to now: the filter's state moved on by newer inertial means."""

from __future__ import annotations

from typing import Any

import numpy as np

from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.kernels import Array
from tramstream.processors import tram_frames as frames
from tramstream.processors import tram_kernels as kernels
from tramstream.processors.tram_filter import TramFilter
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
        self._inputs = np.zeros((CAPACITY, 10))
        self._durations = np.zeros(CAPACITY)
        self._stamps_ns: list[int] = []
        self._begin = 0  # the first that the filter has not seen
        self._reading = np.zeros((4, 10))
        self._last_ns = 0
        self._memory = np.zeros(kernels.MEMORY)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest mean; 0 before the first."""
        return self._last_ns

    def append(self, mean: ImuMean) -> None:
        """Take a mean, unless there is a newer one already, or it cannot be."""
        dt = (mean.stamp_ns - self._last_ns) / S
        readings = frames.readings(mean)
        if readings is None or dt <= 0.0:
            return
        if dt > MAX_STEP_S:
            dt = 0.0
        frames.read(self._reading, self._C_vb, *readings, dt)
        self._last_ns = mean.stamp_ns
        if len(self._stamps_ns) == CAPACITY:
            self._drop(max(self._begin, CAPACITY // 4))
        index = len(self._stamps_ns)
        self._inputs[index] = self._reading[2]
        self._durations[index] = dt
        self._stamps_ns.append(mean.stamp_ns)

    def _drop(self, count: int) -> None:
        kept = len(self._stamps_ns) - count
        self._inputs[:kept] = self._inputs[count : count + kept].copy()
        self._durations[:kept] = self._durations[count : count + kept].copy()
        del self._stamps_ns[:count]
        self._begin = max(0, self._begin - count)

    def predict(self, ekf: TramFilter, horizon_ns: int) -> Array:
        """Memory of the filter (`tram_kernels`) as it would be at the newest mean."""
        stamps, begin = self._stamps_ns, self._begin
        count = len(stamps)
        while begin < count and stamps[begin] <= horizon_ns:
            begin += 1
        self._begin = begin
        kernels.ahead_of(
            ekf.memory,
            self._memory,
            ekf.parameters,
            self._inputs,
            self._durations,
            begin,
            count,
        )
        return self._memory

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> dict[str, Any]:
        count = len(self._stamps_ns)
        return {
            "inputs": self._inputs[:count].copy(),
            "durations": self._durations[:count].copy(),
            "stamps_ns": list(self._stamps_ns),
            "begin": self._begin,
            "reading": self._reading.copy(),
            "last_ns": self._last_ns,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._stamps_ns, self._begin = list(state["stamps_ns"]), state["begin"]
        count = len(self._stamps_ns)
        self._inputs[:count] = state["inputs"]
        self._durations[:count] = state["durations"]
        self._reading = np.array(state["reading"])
        self._last_ns = state["last_ns"]
