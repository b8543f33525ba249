"""What wheels and doors say of a tenth of a second: a speed now, and for how long they stand."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.processors.segments.epoch import WHEELS, Wh
from tramstream.proto.raw_pb2 import Odometry

Array = NDArray[np.float64]

SPEED_STD_MPS = 0.03
"""Of a speed over a tenth of a second, with what its stamps jitter."""
STAMP_PART = 0.004
"""Of the speed: what a reading's stamp is off by between two epochs."""
SILENT_S = 1.0
"""Wheels that have not been read for so long are not there."""
SPAN_S = 0.08
"""Readings that are closer together wait for the next epoch."""
FASTEST_MPS = 40.0
"""Wheels that claim more have been reset."""


@dataclass
class WheelsMemory:
    """What is remembered of the wheels."""

    row: Array = field(default_factory=lambda: np.full(WHEELS, math.nan))
    path_m: float = math.nan
    """At the newest reading, and"""
    path_ns: int = 0
    from_m: float = math.nan
    """at the one from which the speed is counted."""
    from_ns: int = 0
    moved_ns: int = 0
    """When they turned last."""
    latest: Odometry | None = None
    """The newest reading that has not been looked at: one an epoch is enough."""
    names: list[str] = field(default_factory=list)
    doors_ns: int = 0
    """When the doors were open last."""
    doors_told: bool = False


class WheelReader:
    """Makes the row of `Wh` of readings."""

    def __init__(self, vehicle: Vehicle, memory: WheelsMemory) -> None:
        wheels = vehicle.wheels
        self.memory = memory
        self._m_per_pulse = {
            name: wheels.each[name].m_per_pulse if name in wheels.each else wheels.m_per_pulse
            for name in (vehicle.odometer.wheels if vehicle.odometer is not None else {})
        }
        self._default = wheels.m_per_pulse
        self._delay_ns = round(wheels.delay_s * S)
        row = memory.row
        row[Wh.DOORS] = row[Wh.REFUSED_S] = row[Wh.TAKEN] = row[Wh.DEAD] = 0.0

    def take(self, odometry: Odometry) -> None:
        """Take a reading."""
        memory, path, names, speeds = self.memory, 0.0, [], []
        for wheel in odometry.wheels[:]:
            if wheel.HasField("pulses"):
                names.append(wheel.wheel)
                path += wheel.pulses * self._m_per_pulse.get(wheel.wheel, self._default)
            elif wheel.HasField("speed_mps"):
                speeds.append(wheel.speed_mps)
        stamp_ns = odometry.stamp_ns - self._delay_ns
        if odometry.HasField("doors_open"):
            memory.doors_told = True
            if odometry.doors_open:
                memory.doors_ns = stamp_ns
        if names:
            self._take_path(path / len(names), stamp_ns, names)
        elif speeds:
            self._take_speed(sum(speeds) / len(speeds), stamp_ns)

    def _take_path(self, path_m: float, stamp_ns: int, names: list[str]) -> None:
        memory = self.memory
        span_s = (stamp_ns - memory.path_ns) / S
        way_m = path_m - memory.path_m
        fresh = memory.path_ns == 0 or not 0.0 < span_s < SILENT_S or names != memory.names
        if fresh or abs(way_m) > FASTEST_MPS * span_s:
            memory.names = names
            memory.from_m, memory.from_ns, memory.moved_ns = path_m, stamp_ns, stamp_ns
        elif way_m != 0.0:
            memory.moved_ns = stamp_ns
        memory.path_m, memory.path_ns = path_m, stamp_ns

    def _take_speed(self, speed_mps: float, stamp_ns: int) -> None:
        """A speed instead of pulses: its way since the reading before."""
        memory = self.memory
        span_s = min(max((stamp_ns - memory.path_ns) / S, 0.0), SILENT_S) if memory.path_ns else 0.0
        before = 0.0 if math.isnan(memory.path_m) else memory.path_m
        self._take_path(before + speed_mps * span_s, stamp_ns, ["speed"])

    def close(self, stamp_ns: int, change_mps2: float) -> Array:
        """The row of an epoch that ends at `stamp_ns`, with the mean change of speed in it."""
        memory, row = self.memory, self.memory.row
        if memory.latest is not None:
            self.take(memory.latest)
            memory.latest = None
        row[Wh.SPEED] = row[Wh.STILL_S] = math.nan
        row[Wh.DOORS] = 1.0 if stamp_ns - memory.doors_ns < SILENT_S * S // 2 else 0.0
        if not memory.path_ns or stamp_ns - memory.path_ns > SILENT_S * S:
            return row
        row[Wh.STILL_S] = max(stamp_ns - memory.moved_ns, 0) / S
        span_s = (memory.path_ns - memory.from_ns) / S
        if span_s < SPAN_S:
            return row
        speed = (memory.path_m - memory.from_m) / span_s
        since_s = (stamp_ns - (memory.path_ns + memory.from_ns) // 2) / S
        row[Wh.SPEED] = speed + change_mps2 * since_s
        row[Wh.STD] = math.hypot(SPEED_STD_MPS, STAMP_PART * speed)
        memory.from_m, memory.from_ns = memory.path_m, memory.path_ns
        return row
