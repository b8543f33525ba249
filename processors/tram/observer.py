"""What a frame says of the motion beside the filter: does it stand, how far has it gone?"""

from __future__ import annotations

import math

from tramstream.clock import S
from tramstream.estimation.fixes import antenna_l, unusable
from tramstream.events.kinds import Event
from tramstream.processors.tram.liveness import Liveness
from tramstream.processors.tram.localiser_memory import LocaliserMemory
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter.filter import GYRO_Z, SPEED
from tramstream.processors.tram_filter.modes import RUNNING
from tramstream.processors.tram_sources.gnss import doubts, speed_over_ground
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import SyncFrame

UNSEEN_MPS = 15.0
"""How fast a vehicle moves that nobody sees."""
HEARD_S = 0.5
"""Wheels read within so long tell how far the vehicle has come."""


class Observer:
    """Reads the sensors of each frame, into the localiser's memory."""

    def __init__(
        self, memory: LocaliserMemory, liveness: Liveness, complaints: list[Event]
    ) -> None:
        self._memory = memory
        self._liveness = liveness
        self._complaints = complaints

    def observe(self, navigation: Navigation, frame: SyncFrame, gap_s: float) -> bool:
        """Read the sensors and tell whether the vehicle stands."""
        memory = self._memory
        memory.inertial = navigation.read(frame)
        standstill = memory.standstill
        counted_m = 0.0
        for reading in frame.odometry[:]:
            counted_m += self._note_wheels(navigation, reading)
        if counted_m:
            self._liveness.roll(counted_m)
        x, variances, stamp_ns = navigation.ekf.state, navigation.ekf.variances, memory.stamp_ns
        running = memory.phase is RUNNING
        speed, variance = (x[SPEED], variances[SPEED]) if running else (math.nan, 0.0)
        u = navigation.reading if memory.inertial else None
        stood = standstill.standing
        standing = standstill.step(stamp_ns, u, min(gap_s, 0.1), speed, variance, x[GYRO_Z])
        if not standing:
            # Where there is an IMU that is silent, the search begins at the place of the fixes.
            if stood and navigation.alone and (running or not navigation.readings.has_imu):
                navigation.catch_up(*standstill.gone())
            heard = stamp_ns - memory.wheels_ns < HEARD_S * S
            memory.way_m += counted_m if heard else UNSEEN_MPS * gap_s
        for fix in frame.gnss[:]:
            if fix.valid:
                self._note_fix(navigation, fix)
        return standing

    def _note_wheels(self, navigation: Navigation, reading: Odometry) -> float:
        """How far the wheels have turned since the last reading, m."""
        turned = navigation.wheels.turned(reading)
        if turned is None:
            return 0.0
        self._memory.standstill.wheels(reading.stamp_ns, turned[0])
        self._memory.wheels_ns = reading.stamp_ns
        return abs(turned[1])

    def _note_fix(self, navigation: Navigation, fix: GnssFix) -> None:
        """Take note of a fix, apart from the filter."""
        memory, standstill = self._memory, self._memory.standstill
        reason = unusable(fix, navigation.level)
        if reason is not None:
            self._complaints.append(reason)
            if unusable(fix, None) is None:
                memory.far_ns = (memory.far_ns[0] or fix.stamp_ns, fix.stamp_ns)
            return
        self._complaints += doubts(fix, navigation.level)
        memory.far_ns = (0, 0)
        std_m = navigation.accuracy_m(fix)
        speed = speed_over_ground(fix, memory.last_fix, navigation.level, std_m)
        if speed is not None:
            standstill.speed_over_ground(fix.stamp_ns, speed)
        if navigation.alone:
            east, north, _ = antenna_l(fix, navigation.level)
            standstill.place(fix.stamp_ns, east, north)
        memory.last_fix, memory.way_m = fix, 0.0
