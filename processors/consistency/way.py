"""The wheels' way and the IMU's turning as short histories, ten points a second.

Wheels are taken as they are configured, right or wrong: it is the configuration that is judged. Of
several wheels the mean counts, so one that slips shifts it and does not lead it astray.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.proto.raw_pb2 import Odometry, WheelReading

EVERY_S = 0.1
"""Between points of a history."""
MOST = 1200
"""Points of a history: two minutes of driving."""
DROPPED = 200
"""Points that are forgotten together."""
PAUSE_S = 0.5
"""A wheel that was not read for longer begins anew; nothing is interpolated over it."""
RESET = 10.0
"""A wheel that is so many times faster than a moment ago, and ten metres a second, has been
reset."""
RESET_MPS = 10.0
STANDING_S = 5.0
"""Of a stand so much is kept: its instants tell nothing, but the departure does."""

Points = list[tuple[float, float]]


@dataclass
class WayMemory:
    """What a `Way` remembers; times are seconds since `origin_ns`."""

    origin_ns: int = 0
    pulses: dict[str, int] = field(default_factory=dict)
    """Of each wheel when it was read last."""
    read_s: float = -1e9
    path_m: float = 0.0
    speed_mps: float = 0.0
    moved_s: float = -1e9
    """When the wheels turned last."""
    path: Points = field(default_factory=list)
    turned: Points = field(default_factory=list)
    """Yaw by the gyroscopes as they are mounted, since the start."""
    yaw_rad: float = 0.0


class Way:
    """Adds up what wheels and the gyroscope say."""

    def __init__(self, vehicle: Vehicle, memory: WayMemory) -> None:
        self.memory = memory
        self._m_per_pulse = vehicle.wheels.m_per_pulse
        self._delay_s = vehicle.wheels.delay_s
        odometer = vehicle.odometer
        half = 0.5 * vehicle.wheels.track_m
        place = {"left": half, "right": -half}
        self._left_m = {
            name: place.get(wheel.side or name, 0.0)
            for name, wheel in (odometer.wheels if odometer is not None else {}).items()
        }

    def time_s(self, stamp_ns: int) -> float:
        """Time since the first frame."""
        if not self.memory.origin_ns:
            self.memory.origin_ns = stamp_ns
        return (stamp_ns - self.memory.origin_ns) / S

    @property
    def wheels_left_m(self) -> float:
        """How far to the left of the middle the wheels that are read stand in the mean."""
        read = [self._left_m.get(name, 0.0) for name in self.memory.pulses]
        return sum(read) / len(read) if read else 0.0

    @property
    def least_m(self) -> float:
        """Way that wheels which stand may show."""
        return 2.0 * self._m_per_pulse

    def read(self, reading: Odometry) -> None:
        """Take a reading of the wheels."""
        memory = self.memory
        time_s = self.time_s(reading.stamp_ns) - self._delay_s
        dt_s = time_s - memory.read_s
        if dt_s <= 0.0:
            return
        ways = [self._way(wheel, dt_s) for wheel in reading.wheels[:]]
        known = [way for way in ways if way is not None]
        if not known:
            return
        paused = dt_s > PAUSE_S
        memory.read_s = time_s
        way_m = sum(known) / len(known)
        limit_m = RESET * (abs(memory.speed_mps) + RESET_MPS) * dt_s
        if not paused and abs(way_m) <= limit_m:
            memory.path_m += way_m
            memory.speed_mps = way_m / dt_s
            if abs(way_m) > 0.0:
                memory.moved_s = time_s
        if time_s - memory.moved_s < STANDING_S:
            _add(memory.path, time_s, memory.path_m)

    def _way(self, wheel: WheelReading, dt_s: float) -> float | None:
        """Way of one wheel since it was read last; None if it was not."""
        name, kept = wheel.wheel, self.memory.pulses
        if wheel.HasField("pulses"):
            before = kept.get(name)
            kept[name] = wheel.pulses
            return None if before is None else (kept[name] - before) * self._m_per_pulse
        if wheel.HasField("speed_mps"):
            kept.setdefault(name, 0)
            return wheel.speed_mps * dt_s
        return None

    def turn(self, time_s: float, rate_radps: float, dt_s: float) -> None:
        """Take the rate about the vertical."""
        memory = self.memory
        memory.yaw_rad += rate_radps * dt_s
        if time_s - memory.moved_s < STANDING_S:
            _add(memory.turned, time_s, memory.yaw_rad)


def _add(points: Points, time_s: float, value: float) -> None:
    if not points or time_s - points[-1][0] >= EVERY_S - 1e-6:
        points.append((time_s, value))
        if len(points) > MOST:
            del points[:DROPPED]


class Course:
    """A history as a function of time, NaN where it has a gap."""

    def __init__(self, points: Points | Array) -> None:
        rows = np.asarray(points, dtype=float).reshape(-1, 2)
        self._time_s, self._value = rows[:, 0], rows[:, 1]

    def __len__(self) -> int:
        return len(self._time_s)

    def at(self, time_s: Array) -> Array:
        """Value at times."""
        if len(self) < 2:
            return np.full(np.shape(time_s), np.nan)
        found: Array = np.interp(time_s, self._time_s, self._value, left=np.nan, right=np.nan)
        right = np.clip(np.searchsorted(self._time_s, time_s), 1, len(self) - 1)
        found[self._time_s[right] - self._time_s[right - 1] > PAUSE_S] = np.nan
        return found

    def held(self, time_s: Array) -> Array:
        """Value at times where a gap is a stand: nothing has changed meanwhile."""
        if not len(self):
            return np.zeros(np.shape(time_s))
        found: Array = np.interp(time_s, self._time_s, self._value)
        return found

    def rate(self, time_s: Array, over_s: float = 0.4) -> Array:
        """Change a second at times, over a short span about them."""
        half = 0.5 * over_s
        change: Array = (self.at(time_s + half) - self.at(time_s - half)) / over_s
        return change
