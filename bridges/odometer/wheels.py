"""One wheel of the configuration: from values of its signal to pulses or a speed.

A free-running counter tells its way modulo its range. Over the usual interval that is no question;
over a gap it is answered by the speed before, as long as the vehicle cannot have changed it by more
than half the range, and by nothing else. An ECU that was started again counts from zero. Wherever
the way is not known, the pulses fall by `UNKNOWN_WAY`: further than any wheel runs in any pause, so
that whoever reads them begins anew there instead of believing a way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from tramstream.bridges.odometer.dbc import Field
from tramstream.clock import S
from tramstream.config import Wheel as WheelConfig

UNKNOWN_WAY = 1 << 36
"""Pulses; 63,000 km of the reference vehicle's wheel, 69 km where a pulse is a micrometre."""
MOST_PULSES = 1 << 62
"""What a message has room for, with some to fall."""
FASTEST_MPS = 40.0
"""No tram runs faster; whoever reads pulses takes what is faster for a new start, too."""
SHORTEST_S = 0.05
"""Stamps of neighbours may be as close together as they like, and mean no speed."""
GAP_S = 0.25
"""Over more than this it matters how the speed may have changed."""
CHANGE_MPS2 = 5.0
"""How fast a wheel's speed changes at most: an emergency brake has 3 m/s²; slip is more, and is
found by whoever knows the motion."""
PART, SLACK_M = 0.1, 0.5
"""How well the way over a gap is foretold: a part of it, and what stamps and counts are worth."""
SPEED_S = 0.1
"""The speed is that over the last so long."""


@dataclass
class WheelMemory:
    """What is known of one wheel."""

    total: float = 0
    """Pulses before scaling; for a counter before the DBC's too."""
    unknown: int = 0
    """How often the way was not known."""
    counter: int | None = None
    counted_ns: int = 0
    """Stamp of the counter."""
    speed_mps: float | None = None
    """Of a speed signal, as it is; of a counter what it was of late, None where not known."""
    since_total: float = 0
    since_ns: int = 0
    """Where the speed of a counter is counted from."""
    values: int = 0
    """Since the last reading."""
    seen_ns: int = 0


class UnknownWay(NamedTuple):
    """A counter that does not tell how far the wheel went."""

    wheel: str
    gap_s: float
    reason: str


class Wheel:
    """One wheel as configured, and what is known of it."""

    def __init__(
        self,
        name: str,
        config: WheelConfig,
        signal: Field,
        m_per_pulse: float,
        memory: WheelMemory,
    ) -> None:
        self.name = name
        self.kind = config.kind
        self.signal = signal
        self.memory = memory
        self._scale = config.scale
        if self.kind == "counter":
            self._scale *= signal.scale
        self._range = 1 << config.counter_bits
        self._m_per_count = abs(m_per_pulse * self._scale)

    def read(self, data: bytes) -> float | str | None:
        """Value in a frame; why there is none, or None where it is on another page."""
        if self.kind == "counter":
            return self.signal.read_counter(data)
        return self.signal.read(data, self._scale)

    def take(self, value: float, stamp_ns: int) -> UnknownWay | None:
        """Take the value of a frame."""
        memory = self.memory
        unknown = None
        if self.kind == "speed":
            memory.speed_mps = value * self._scale
        elif self.kind == "pulses":
            memory.total += value
        else:
            unknown = self._count(int(value), stamp_ns)
        memory.values += 1
        memory.seen_ns = stamp_ns
        return unknown

    def forget_counter(self) -> None:
        """What comes next is of another sender: its counter has nothing to do with this one."""
        if self.memory.counter is not None:
            self._lose_way()

    @property
    def pulses(self) -> int:
        """Since the bridge was started."""
        counted = max(-MOST_PULSES, min(MOST_PULSES, self.memory.total * self._scale))
        return round(counted) - self.memory.unknown * UNKNOWN_WAY

    def _count(self, counter: int, stamp_ns: int) -> UnknownWay | None:
        memory = self.memory
        before, gap_s = memory.counter, (stamp_ns - memory.counted_ns) / S
        unknown = None
        if before is not None:
            step, reason = self._step(before, counter, gap_s)
            if reason:
                unknown = UnknownWay(self.name, gap_s, reason)
                self._lose_way()
            else:
                memory.total += step
        if memory.counter is None:
            memory.since_total, memory.since_ns, memory.speed_mps = memory.total, stamp_ns, None
        elif (elapsed_s := (stamp_ns - memory.since_ns) / S) >= SPEED_S:
            speed_mps = (memory.total - memory.since_total) * self._m_per_count / elapsed_s
            memory.speed_mps = speed_mps if abs(speed_mps) <= FASTEST_MPS else None
            memory.since_total, memory.since_ns = memory.total, stamp_ns
        memory.counter, memory.counted_ns = counter, stamp_ns
        return unknown

    def _step(self, before: int, counter: int, gap_s: float) -> tuple[int, str]:
        """Counts since the last one, and why they are not known where they are not."""
        half, speed_mps = self._range // 2, self.memory.speed_mps
        half_m = half * self._m_per_count
        foretold_m = (speed_mps or 0.0) * gap_s
        foretold = round(foretold_m / self._m_per_count) if self._m_per_count else 0
        step = foretold + (counter - before - foretold + half) % self._range - half
        way_m = step * self._m_per_count
        if speed_mps is None:
            reach_m = FASTEST_MPS * gap_s if gap_s > GAP_S else 0.0
        else:
            reach_m = CHANGE_MPS2 * gap_s * gap_s / 2 + PART * abs(foretold_m)
        if self._m_per_count and reach_m >= half_m:
            return 0, "it may have gone round meanwhile"
        since_zero_m = counter * self._m_per_count
        round_or_anew = gap_s > GAP_S and counter < before and step >= 0
        if round_or_anew and since_zero_m <= abs(foretold_m) + reach_m + SLACK_M:
            return 0, "it may have been set anew"
        off_m = abs(way_m - foretold_m) if gap_s > GAP_S else abs(way_m)
        limit_m = reach_m + SLACK_M if gap_s > GAP_S else FASTEST_MPS * max(gap_s, SHORTEST_S)
        return (0, "it was set anew") if off_m > limit_m else (step, "")

    def _lose_way(self) -> None:
        self.memory.unknown += 1
        self.memory.counter = None
