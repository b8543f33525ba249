"""Speed and acceleration by the wheels, or the fixes, where no localiser says them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tramstream.clock import S
from tramstream.estimation.fixes import measures_speed
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry

SPAN_S = 0.5
"""Over which the wheels' way is a speed, and speeds an acceleration."""
FRESH_S = 1.5
"""A speed that is older is none."""
FASTEST_MPS = 40.0
"""Wheels that claim more have been reset."""
STANDS_MPS = 0.05
"""Slower is standing."""


@dataclass
class SpeedMemory:
    """What an `OwnSpeed` remembers."""

    path_m: float = math.nan
    path_ns: int = 0
    """Wheels' way at the begin of the span, and when."""
    speed_mps: float = 0.0
    speed_ns: int = 0
    acceleration_mps2: float = 0.0
    wheels_ns: int = 0
    """Of the last speed by wheels."""


class OwnSpeed:
    """Speed along x of the vehicle; by fixes alone it is taken to be forwards."""

    def __init__(self, m_per_pulse: float, memory: SpeedMemory) -> None:
        self._m_per_pulse = m_per_pulse
        self.memory = memory

    def take_wheels(self, odometry: Odometry) -> None:
        """Take a reading of the wheels."""
        pulses, speeds = [], []
        for wheel in odometry.wheels[:]:
            if wheel.HasField("pulses"):
                pulses.append(wheel.pulses)
            if wheel.HasField("speed_mps"):
                speeds.append(wheel.speed_mps)
        if speeds:
            self._know(sum(speeds) / len(speeds), odometry.stamp_ns, wheels=True)
        elif pulses:
            self._take_path(sum(pulses) / len(pulses) * self._m_per_pulse, odometry.stamp_ns)

    def _take_path(self, path_m: float, stamp_ns: int) -> None:
        memory = self.memory
        span_s = (stamp_ns - memory.path_ns) / S
        if 0.0 <= span_s < SPAN_S:
            return
        speed_mps = (path_m - memory.path_m) / span_s if span_s > 0.0 else math.nan
        memory.path_m, memory.path_ns = path_m, stamp_ns
        if span_s < 2.0 * SPAN_S:
            self._know(speed_mps, stamp_ns, wheels=True)

    def take_fix(self, fix: GnssFix) -> None:
        """Take the speed over ground of a fix, where there are no wheels."""
        known_s = (fix.stamp_ns - self.memory.wheels_ns) / S
        if fix.valid and measures_speed(fix) and not 0.0 <= known_s < FRESH_S:
            self._know(fix.speed_mps, fix.stamp_ns)

    def _know(self, speed_mps: float, stamp_ns: int, wheels: bool = False) -> None:
        memory = self.memory
        if not abs(speed_mps) < FASTEST_MPS:
            return
        span_s = (stamp_ns - memory.speed_ns) / S
        if 0.0 < span_s < FRESH_S:
            change = (speed_mps - memory.speed_mps) / span_s
            share = min(span_s / SPAN_S, 1.0)
            memory.acceleration_mps2 += share * (change - memory.acceleration_mps2)
        else:
            memory.acceleration_mps2 = 0.0
        memory.speed_mps, memory.speed_ns = speed_mps, stamp_ns
        if wheels:
            memory.wheels_ns = stamp_ns

    def at(self, stamp_ns: int) -> tuple[float, float] | None:
        """Give speed and acceleration at an instant; None if nobody says them."""
        memory = self.memory
        if not memory.speed_ns or stamp_ns - memory.speed_ns > FRESH_S * S:
            return None
        if abs(memory.speed_mps) < STANDS_MPS:
            return 0.0, 0.0
        return memory.speed_mps, memory.acceleration_mps2
