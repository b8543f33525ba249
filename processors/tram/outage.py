"""Sensors that fall silent: what is said of it, and where a vehicle stood before it.

A vehicle that stood when everything fell silent most likely stands there yet, with the heading that
it had. So its navigation is kept (`Parked`), and resumed when wheels that have not turned
say so, or, where wheels cannot tell, when the fixes are where they were.

Equations: docs/theory.md, section 7.7.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fixes import antenna_l, unusable
from tramstream.events.kinds import Event
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.processors.tram_filter.events import NO_FIX, NO_IMU, NO_WHEELS, SLIPPING
from tramstream.processors.tram_model.states import Ix
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import SyncFrame

REPEAT_S = 10.0
"""The same is said again only after so long."""
SILENT_S = {NO_IMU: 1.0, NO_WHEELS: 5.0, NO_FIX: 60.0}
"""So long a silence is said."""
_KEYS = {NO_IMU: keys.IMU_BATCH, NO_WHEELS: keys.ODO_WHEELS, NO_FIX: keys.GNSS_FIX}
_IMU, _WHEELS, _FIXES = (kind.name for kind in SILENT_S)
SLIPPING_S = 4.0
ROLLED_PULSES = 3
"""A wheel may rock by so much while its vehicle stands."""
SAME_PLACE_M = 10.0
SAME_PLACE_SIGMA = 4.0
"""A fix no further away than this is of the same place: the track leads one way there."""


FAR_S = 10.0
FAR_LATEST_S = 120.0
"""Fixes far from where the ride began for so long, or for as long as the ride has lasted if that is
between the two: it was the first fix that was wrong."""


@dataclass
class SilenceMemory:
    """What `Silence` remembers, by what does not come."""

    last_ns: dict[str, int] = field(default_factory=dict)
    said_ns: dict[str, int] = field(default_factory=dict)
    second: int = 0


class Silence:
    """Notices what does not come; says so again and again while it lasts."""

    def __init__(self, vehicle: Vehicle, memory: SilenceMemory | None = None) -> None:
        expected = {NO_IMU: vehicle.imu, NO_WHEELS: vehicle.odometer, NO_FIX: vehicle.gnss}
        self._expected = [kind for kind, section in expected.items() if section is not None]
        self.memory = SilenceMemory() if memory is None else memory

    def note(self, frame: SyncFrame) -> bool:
        """Take note of what a frame brings; whether it is time to look for what does not come."""
        memory = self.memory
        stamp_ns, last_ns = frame.stamp_ns, memory.last_ns
        if frame.HasField("imu"):
            last_ns[_IMU] = stamp_ns
        if frame.odometry:
            last_ns[_WHEELS] = stamp_ns
        for fix in frame.gnss[:]:  # a copy: three times as fast as protobuf's own
            if fix.valid:
                last_ns[_FIXES] = stamp_ns
        second, memory.second = memory.second, stamp_ns // S
        return second != memory.second

    def missing(self, stamp_ns: int, slipping_s: float) -> list[Event]:
        """Give what there is to say."""
        found = []
        for kind in self._expected:
            silence_s = (stamp_ns - self.memory.last_ns.setdefault(kind.name, stamp_ns)) / S
            if silence_s > SILENT_S[kind]:
                facts = {"silence_s": silence_s, "limit_s": SILENT_S[kind]}
                found.append(kind(key=_KEYS[kind].path, **facts))
        if slipping_s > SLIPPING_S:
            facts = {"slipping_s": slipping_s, "limit_s": SLIPPING_S}
            found.append(SLIPPING(key=keys.ODO_WHEELS.path, **facts))
        due = [each for each in found if self._due(each.kind.name, stamp_ns)]
        self.memory.said_ns.update({each.kind.name: stamp_ns for each in due})
        return due

    def _due(self, kind: str, stamp_ns: int) -> bool:
        said_ns = self.memory.said_ns.get(kind)
        return said_ns is None or stamp_ns - said_ns >= REPEAT_S * S


@dataclass
class Parked:
    """The navigation of a vehicle that stood when everything fell silent. It is its own memory."""

    _navigation: NavigationMemory
    _counters: dict[str, int]

    @classmethod
    def of(cls, navigation: Navigation) -> Parked:
        """Keep a navigation as it is."""
        return cls(navigation.kept(), navigation.wheels.counters())

    def moved(
        self,
        readings: Iterable[Odometry],
        fixes: Iterable[GnssFix],
        navigation: Navigation,
        standing: bool,
    ) -> bool | None:
        """Whether the vehicle has moved since, by new readings; None while nobody can tell."""
        counters = {
            each.wheel: each.pulses
            for reading in readings
            for each in reading.wheels
            if each.HasField("pulses")
        }
        turned = [counters[each] - old for each, old in self._counters.items() if each in counters]
        if turned and all(abs(each) <= ROLLED_PULSES for each in turned):
            return False
        if turned and min(turned) > 0:  # or else they have begun to count anew
            return True
        usable = [fix for fix in fixes if fix.valid and not unusable(fix, navigation.level)]
        if not usable or not standing:
            return None
        x = self._navigation.filter.x
        east, north, _ = antenna_l(usable[-1], navigation.level)
        away_m = math.hypot(east - float(x[Ix.EAST]), north - float(x[Ix.NORTH]))
        reach_m = SAME_PLACE_SIGMA * navigation.accuracy_m(usable[-1]) + SAME_PLACE_M
        return away_m > reach_m

    def resume(self, navigation: Navigation, stamp_ns: int) -> None:
        """Let the vehicle have stood all the time until `stamp_ns`."""
        navigation.forget_heading()  # whatever it went through meanwhile has ended
        navigation.go_back(self._navigation)
        navigation.announce_heading()
        navigation.ekf.rest((stamp_ns - self._navigation.filter.stamp_ns) / S)
        navigation.fixes.renew(navigation.ekf)
        navigation.ekf.set_time(stamp_ns)


def first_fix_was_wrong(far_ns: tuple[int, int], begun_ns: int) -> bool:
    """Whether the first fix of a ride was wrong, by all that came later.

    Parameters
    ----------
    far_ns : tuple of 2 int
        First and last of those fixes in a row that are far away.
    begun_ns : int
        When the ride began.
    """
    first_ns, last_ns = far_ns
    before_s = (first_ns - begun_ns) / S
    return last_ns - first_ns > max(FAR_S, min(before_s, FAR_LATEST_S)) * S
