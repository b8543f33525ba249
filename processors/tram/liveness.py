"""Sensors that do not live: wheels that stand and fixes that stay while the vehicle moves.

A counter that has not changed for seconds, while the other wheel has turned or GNSS has seen a fast
vehicle, is dead or frozen. It is left out of all frames, as though the wheel were not there, until
it changes again. A fix at the very place of the one before, while wheels, the filter or the fix's
own velocity say that the vehicle has moved on, is a repeated one, and is left out. (An IMU that
repeats itself: `tram_model/axes.py`.)

Equations: docs/theory.md, section 7.9.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.processors.tram.events import FIXES_FROZEN, WHEEL_DEAD, WHEEL_LIVES
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.proto.sync_pb2 import SyncFrame

LOOK_S = 0.25
"""So often wheels are looked at; chosen by hand."""
STILL_S = 3.0
"""A counter that stands for so long, while its vehicle moves, is dead: longer than wheels stay
locked; chosen by hand, guarded by `tests/processors/tram/test_liveness.py`."""
LONG_S, FAST_S = 6.0, 2.0
"""No wheel is locked for the first of these; then a receiver that measures velocity need see a fast
vehicle for the second only; chosen by hand."""
OTHERS_M = 6.0
"""Way of the other wheel meanwhile: 2 m/s; chosen by hand."""
FROZEN_M = 2.0
"""A vehicle that has gone so far is elsewhere, to the last digit of any receiver; chosen by hand:
the coarsest, NMEA of four digits, tell 0.2 m."""


@dataclass
class WheelLife:
    """What is known of one counter."""

    mark: int
    """What it showed last: pulses, or the time at which its speed was not 0."""
    since_ns: int
    """When it was seen to change last."""
    others: int = 0
    """Most pulses that another one has counted since; of speeds, none."""
    dead: bool = False


@dataclass
class LivenessMemory:
    """What `Liveness` remembers."""

    wheels: dict[str, WheelLife] = field(default_factory=dict)
    due_ns: int = 0
    """When wheels are looked at next."""
    dead: int = 0
    """How many of them are dead."""
    place: tuple[float, float] = (0.0, 0.0)
    """Latitude and longitude of the last fix, degrees."""
    place_ns: int = 0
    """Since when fixes have been there; 0 before the first."""
    fix_ns: int = 0
    """Of the last one."""
    measures: bool = False
    """Whether the receiver measures velocity: places alone may wander while a vehicle stands."""
    gone_m: float = 0.0
    """How far the vehicle has gone meanwhile."""


class Liveness:
    """Leaves out of frames what does not live."""

    def __init__(self, m_per_pulse: float, memory: LivenessMemory | None = None) -> None:
        self._m_per_pulse = m_per_pulse
        self.memory = LivenessMemory() if memory is None else memory
        self.found: list[Event] = []
        """What there is to say; whoever says it clears it."""

    @property
    def wheels_dead(self) -> bool:
        """Whether no wheel lives, of those that were read."""
        memory = self.memory
        return 0 < memory.dead == len(memory.wheels)

    def honest(self, frame: SyncFrame, fast_s: float, speed_mps: float) -> SyncFrame:
        """Give the frame without what does not live: itself where all does.

        Parameters
        ----------
        fast_s : float
            For how long GNSS has seen a fast vehicle.
        speed_mps : float
            As the filter knows it; 0 where it is not sure.
        """
        memory = self.memory
        if frame.stamp_ns >= memory.due_ns and frame.odometry:
            memory.due_ns = frame.stamp_ns + int(LOOK_S * S)
            self._look_at_wheels(frame.odometry[-1], fast_s)
        gnss = frame.gnss
        frozen = (
            [each.stamp_ns for each in gnss if self._is_frozen(each, speed_mps)] if gnss else []
        )
        if not (memory.dead or frozen):
            return frame
        left = SyncFrame()
        left.CopyFrom(frame)
        for number in reversed(range(len(left.gnss))):
            if left.gnss[number].stamp_ns in frozen:
                del left.gnss[number]
        if memory.dead:
            self._leave_out_wheels(left)
        return left

    # Wheels --------------------------------------------------------------------------------------
    def _look_at_wheels(self, reading: Odometry, fast_s: float) -> None:
        stamp_ns, wheels = reading.stamp_ns, self.memory.wheels
        before = {name: each.mark for name, each in wheels.items()}
        marks = {each.wheel: _mark(each, stamp_ns) for each in reading.wheels}
        for name, mark in marks.items():
            if mark is None:
                continue
            wheel = wheels.setdefault(name, WheelLife(mark, stamp_ns))
            if mark != wheel.mark:
                wheel.mark, wheel.since_ns, wheel.others = mark, stamp_ns, 0
                if wheel.dead:
                    wheel.dead = False
                    self.found.append(WHEEL_LIVES(key=keys.ODO_WHEELS.path, wheel=name))
                continue
            wheel.others += _most(before, marks, name)
            others_m = wheel.others * self._m_per_pulse
            still_s = (stamp_ns - wheel.since_ns) / S
            sooner = still_s > LONG_S and self.memory.measures
            enough_s = FAST_S if sooner else STILL_S
            if still_s < STILL_S or (others_m < OTHERS_M and fast_s < enough_s):
                continue
            wheel.dead = True
            facts = {"wheel": name, "still_s": still_s, "others_m": others_m, "fast_s": fast_s}
            self.found.append(WHEEL_DEAD(key=keys.ODO_WHEELS.path, **facts))
        self.memory.dead = sum(each.dead for each in wheels.values())

    def _leave_out_wheels(self, frame: SyncFrame) -> None:
        wheels = self.memory.wheels
        for number in reversed(range(len(frame.odometry))):
            reading = frame.odometry[number]
            for each in reversed(range(len(reading.wheels))):
                wheel = wheels.get(reading.wheels[each].wheel)
                if wheel is not None and wheel.dead:
                    del reading.wheels[each]
            if not reading.wheels and not reading.HasField("yaw_rate_radps"):
                del frame.odometry[number]

    # Fixes ---------------------------------------------------------------------------------------
    def roll(self, way_m: float) -> None:
        """Hear how far the wheels have turned."""
        self.memory.gone_m += way_m

    def _is_frozen(self, fix: GnssFix, speed_mps: float) -> bool:
        memory = self.memory
        if not fix.valid:
            return False
        dt_s = min((fix.stamp_ns - memory.fix_ns) / S, 1.0) if memory.fix_ns else 0.0
        memory.fix_ns = fix.stamp_ns
        memory.measures = fix.HasField("vel_e_mps")
        place = fix.latitude_deg, fix.longitude_deg
        if place != memory.place:
            memory.place, memory.place_ns, memory.gone_m = place, fix.stamp_ns, 0.0
            return False
        memory.gone_m += max(abs(speed_mps), fix.speed_mps) * dt_s
        if memory.gone_m < FROZEN_M:
            return False
        still_s = (fix.stamp_ns - memory.place_ns) / S
        facts = {"still_s": still_s, "gone_m": memory.gone_m, "limit_m": FROZEN_M}
        self.found.append(FIXES_FROZEN(key=keys.GNSS_FIX.path, **facts))
        return True


def _mark(reading: WheelReading, stamp_ns: int) -> int | None:
    """What a wheel shows that changes while it turns; None if it shows nothing."""
    if reading.HasField("pulses"):
        return int(reading.pulses)
    if not reading.HasField("speed_mps"):
        return None
    return stamp_ns if reading.speed_mps != 0.0 else 0


def _most(before: Mapping[str, int], now: Mapping[str, int | None], name: str) -> int:
    """Most that a counter other than `name` has counted."""
    counted = 0
    for other, mark in now.items():
        if other != name and mark is not None and other in before:
            counted = max(counted, abs(mark - before[other]))
    return counted
