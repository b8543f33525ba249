"""Means of the inertial readings over half a second, by which the mounting is judged."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream.processors.consistency.mounting import WINDOW_S
from tramstream.proto.sync_pb2 import ImuMean

LONGEST = 1.5
"""A window that has become longer than so many holds a pause; chosen by hand."""


@dataclass
class WindowMemory:
    """What a `Window` remembers; times are seconds since any instant."""

    sums: list[float] = field(default_factory=lambda: [0.0] * 6)
    """Of the running window: force and rate in the axes of the case."""
    count: int = 0
    begin_s: float = 0.0
    path_m: float = 0.0
    """At the beginning."""


class Window:
    """Adds up readings."""

    def __init__(self, memory: WindowMemory) -> None:
        self.memory = memory

    def add(self, imu: ImuMean, time_s: float) -> bool:
        """Take a reading; whether the window is full."""
        sums = self.memory.sums
        sums[0] += imu.accel_x_mps2
        sums[1] += imu.accel_y_mps2
        sums[2] += imu.accel_z_mps2
        sums[3] += imu.gyro_x_radps
        sums[4] += imu.gyro_y_radps
        sums[5] += imu.gyro_z_radps
        self.memory.count += 1
        return time_s - self.memory.begin_s >= WINDOW_S - 1e-3

    def end(self, time_s: float, path_m: float) -> tuple[list[float] | None, float]:
        """End the window: its mean, None where that is none, and the way of the wheels in it, m."""
        memory = self.memory
        mean = [each / memory.count for each in memory.sums]
        usable = time_s - memory.begin_s < LONGEST * WINDOW_S and math.isfinite(sum(mean))
        moved_m = abs(path_m - memory.path_m)
        memory.sums[:], memory.count = [0.0] * 6, 0
        memory.begin_s, memory.path_m = time_s, path_m
        return mean if usable else None, moved_m
