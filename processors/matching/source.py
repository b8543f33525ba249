"""What the map matcher follows: the state of any localiser, or a receiver's fixes, as estimates.

The message is all that is known of whoever said it. Its place is put into a level frame that is
laid anew every `LAID_M` of the way, so nobody's origin matters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tramstream import geodesy
from tramstream.clock import S
from tramstream.estimation.fixes import deviations, place_deg, unusable
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import (
    COVARIANCE,
    HEADING_UNKNOWN,
    TRACKING,
    Estimate,
    values_of,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix

LAID_M = 50.0
"""To the second order a place so far from the frame's origin is good to a thousandth of a
millimetre."""
UPPER = 28
"""Numbers of a covariance's upper triangle, as states carry it."""
TRACK = "track"
"""How measurements begin that are the map's."""
TAKEN = "track_across"
"""A measurement by which a state shows that its filter is held to the track."""
SATELLITES = "gnss"
"""How measurements begin that are the receiver's: a localiser whose states name no others follows
the fixes, and errs as long as they do."""
ALONE_S = 5.0
"""Nothing but fixes for so long: the inertial sensor and the wheels are away."""
HELD_M = 10.0
"""A filter that has taken nothing of the track for so long a way is not held to it any more."""
FIX_MOVES_MPS = 1.0
"""From this speed on the course of a fix is the vehicle's heading."""
FIX_STANDS_MPS = 0.3
"""Below this speed a vehicle that is known by fixes alone is taken to stand."""
FIX_COURSE_STD_RAD = 0.1
"""Least deviation of a heading by the course: the antenna swings out in curves."""
LEAST_STD_M = 0.005
"""Of a fix on each axis, whatever the receiver says; as `gnss.error_floor_m`."""
KEPT_S = 5.0
"""The last course is the heading for so long."""


def _places() -> NDArray[np.int64]:
    """Which of the motion's numbers, and of the triangle's behind them, each value is."""
    covariance = np.zeros((7, 7), dtype=np.int64)
    rows, columns = np.triu_indices(7)
    covariance[rows, columns] = covariance[columns, rows] = COVARIANCE + np.arange(UPPER)
    return np.concatenate([np.arange(COVARIANCE), covariance.ravel()])


_PLACES = _places()


@dataclass
class GroundMemory:
    """What a `Ground` remembers."""

    level: LocalLevel | None = None


@dataclass
class StatesMemory:
    """What `States` remember."""

    ground: GroundMemory = field(default_factory=GroundMemory)
    stamp_ns: int = 0
    way_m: float = math.inf
    """Since the filter took something of the track."""
    fixes_ns: int = 0
    """When the filter last took a fix,"""
    others_ns: int = 0
    """and when it last took anything else, but for the track."""


@dataclass
class FixesMemory:
    """What `ReceiverFixes` remember."""

    ground: GroundMemory = field(default_factory=GroundMemory)
    yaw: tuple[float, float, int] | None = None
    """The last course, its variance, and of when it is."""


class Ground:
    """The level frame near the vehicle, laid anew as it goes on."""

    def __init__(self, memory: GroundMemory | None = None) -> None:
        self.memory = GroundMemory() if memory is None else memory
        self._radii = (0.0, 0.0, 0.0, 0.0)
        if self.memory.level is not None:
            self._know(self.memory.level)

    @property
    def level(self) -> LocalLevel | None:
        """The frame; None before the first place."""
        return self.memory.level

    def lay(self, latitude_rad: float, longitude_rad: float, height_m: float) -> None:
        """Lay the frame at a place."""
        self.memory.level = level = LocalLevel(latitude_rad, longitude_rad, height_m)
        self._know(level)

    def _know(self, level: LocalLevel) -> None:
        """Find the radii of curvature where the frame is laid."""
        latitude_rad, height_m = level.latitude_rad, level.height_m
        w = math.sqrt(1.0 - geodesy.E2 * math.sin(latitude_rad) ** 2)
        meridian = geodesy.SEMI_MAJOR_M * (1.0 - geodesy.E2) / w**3 + height_m
        across = geodesy.SEMI_MAJOR_M / w + height_m
        self._radii = meridian, across, math.cos(latitude_rad), math.tan(latitude_rad)

    def put(self, latitude_deg: float, longitude_deg: float, height_m: float) -> Sequence[float]:
        """Give east, north, up of a place, and by how much yaw in the frame is less than there."""
        latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
        for _ in range(2):
            level = self.memory.level
            if level is not None:
                meridian, across, cos, tan = self._radii
                up = height_m - level.height_m
                north = latitude - level.latitude_rad
                east = math.remainder(longitude - level.longitude_rad, math.tau) * cos
                east *= (across + up) * (1.0 - north * tan)
                north = north * (meridian + up) + 0.5 * east * east * tan / across
                if max(abs(east), abs(north), abs(up)) < LAID_M:
                    up -= 0.5 * (east * east / across + north * north / meridian)
                    return east, north, up, east * tan / across
            self.lay(latitude, longitude, height_m)
        return 0.0, 0.0, 0.0, 0.0


class Source:
    """Estimates out of messages, one after the other."""

    def __init__(self, ground: GroundMemory) -> None:
        self.ground = Ground(ground)

    def take(self, message: Any) -> Estimate | None:
        """Give what a message says of the vehicle; None if it says nothing of use."""
        raise NotImplementedError

    @property
    def held(self) -> bool:
        """Whether who says it is held to the track."""
        return False

    @property
    def alone(self) -> bool:
        """Whether it follows from fixes alone, and errs as long as they do."""
        return False


class States(Source):
    """States of a localiser (`MotionState`)."""

    def __init__(self, memory: StatesMemory | None = None) -> None:
        self.memory = StatesMemory() if memory is None else memory
        super().__init__(self.memory.ground)

    def take(self, message: MotionState) -> Estimate | None:
        """Give the state in the frame near the vehicle; None if it is no number."""
        place = message.latitude_deg, message.longitude_deg, message.height_ellipsoid_m
        speed, yaw = message.speed_mps, message.yaw_rad
        if not math.isfinite(sum(place) + speed + yaw) or abs(place[0]) > 90.0:
            return None
        east, north, up, lean = self.ground.put(*place)
        numbers = [
            *(east, north, up, speed, message.roll_rad, message.pitch_rad, yaw + lean),
            message.acceleration_mps2,
            message.yaw_rate_radps,
            *(0.0, 0.0),  # its level is of no use here
        ]
        numbers += message.covariance[:]  # a copy: three times as fast as protobuf's own
        if len(numbers) != COVARIANCE + UPPER:
            numbers[COVARIANCE:] = _covariance(message)[np.triu_indices(7)].tolist()
        if not math.isfinite(sum(numbers)):
            return None
        values = np.array(numbers).take(_PLACES)
        self._notice(message, speed)
        return Estimate(message.stamp_ns, int(message.mode), values, message.standing)

    def _notice(self, message: MotionState, speed_mps: float) -> None:
        """Take note whether the filter takes what it is told of the track."""
        memory, stamp_ns = self.memory, message.stamp_ns
        if not message.standing and memory.stamp_ns:
            memory.way_m += abs(speed_mps) * min(max((stamp_ns - memory.stamp_ns) / S, 0.0), 1.0)
        memory.stamp_ns = stamp_ns
        for each in message.innovations[:]:
            name = each.measurement
            if name.startswith(SATELLITES):
                memory.fixes_ns = stamp_ns
            elif not name.startswith(TRACK):
                memory.others_ns = stamp_ns
            elif name == TAKEN and each.accepted:
                memory.way_m = 0.0

    @property
    def held(self) -> bool:
        return self.memory.way_m < HELD_M

    @property
    def alone(self) -> bool:
        memory = self.memory
        return memory.fixes_ns > 0 and memory.fixes_ns - memory.others_ns > ALONE_S * S


class ReceiverFixes(Source):
    """Fixes of a receiver (`GnssFix`): speed and heading are those over ground."""

    def __init__(self, memory: FixesMemory | None = None) -> None:
        self.memory = FixesMemory() if memory is None else memory
        super().__init__(self.memory.ground)

    @property
    def alone(self) -> bool:
        return True

    def take(self, message: GnssFix) -> Estimate | None:
        """Give the fix as an estimate; None if it is not valid."""
        if not message.valid or unusable(message, None):
            return None
        east, north, up, lean = self.ground.put(*place_deg(message))
        speed = message.speed_mps
        if message.HasField("vel_n_mps") and message.HasField("vel_e_mps"):
            speed = math.hypot(message.vel_e_mps, message.vel_n_mps)
            if speed > FIX_MOVES_MPS:
                std = max(message.speed_std_mps / speed, FIX_COURSE_STD_RAD)
                yaw = math.atan2(message.vel_n_mps, message.vel_e_mps)
                self.memory.yaw = yaw, std * std, message.stamp_ns
        level_std, up_std = deviations(message, LEAST_STD_M)
        known = self.memory.yaw
        if known is not None and not 0 <= message.stamp_ns - known[2] <= KEPT_S * S:
            known = self.memory.yaw = None
        yaw, variance, _ = known if known is not None else (0.0, math.pi**2 / 3.0, 0)
        covariance = np.diag([level_std**2] * 2 + [up_std**2, 1.0, 1.0, 1.0, variance])
        motion = (east, north, up, speed, 0.0, 0.0, yaw + lean)
        mode = HEADING_UNKNOWN if known is None else TRACKING
        values = values_of(motion, covariance, 0.0, 0.0)
        return Estimate(message.stamp_ns, mode, values, speed < FIX_STANDS_MPS)


def _covariance(state: MotionState) -> Array:
    """Covariance out of the deviations, for states that carry no other."""
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    along, across = state.along_std_m**2, state.across_std_m**2
    P = np.diag([0.0, 0.0, state.up_std_m**2, state.speed_std_mps**2, 1e-2, 1e-2, 0.0])
    P[0, 0] = cos * cos * along + sin * sin * across
    P[1, 1] = sin * sin * along + cos * cos * across
    P[0, 1] = P[1, 0] = cos * sin * (along - across)
    P[6, 6] = state.yaw_std_rad**2
    return P
