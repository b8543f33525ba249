"""Is the IMU mounted as it is configured? If not, by more than the filter learns, it is left out.

Gravity at the first stand and the force of the first departures against the wheels' acceleration
say it, as they do to `processors/consistency`, which tells people. It is judged here again, by the
frames alone, so that a ride that is made again from its record comes out the same. What is judged
holds for as long as $.imu.mounting_deg is what it was.

Equations: docs/theory.md, section 7.9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

from tramstream import keys
from tramstream.config import Vehicle
from tramstream.events.kinds import Event
from tramstream.processors.consistency.mounting import (
    BACKWARDS_RAD,
    STDS,
    Mounting,
    MountingMemory,
)
from tramstream.processors.consistency.way import Course, Way, WayMemory
from tramstream.processors.consistency.windows import Window, WindowMemory
from tramstream.processors.tram_filter.events import MOUNTING_WRONG
from tramstream.proto.sync_pb2 import SyncFrame

RECENT = 40
"""Points of the way that a moment of driving needs: four seconds; by hand."""
_KEY = keys.IMU_BATCH.path


class Judged(Enum):
    """What is known of the mounting."""

    OPEN = "open"
    RIGHT = "right"
    WRONG = "wrong"


OPEN, RIGHT, WRONG = Judged.OPEN, Judged.RIGHT, Judged.WRONG
"""Asked for with every frame: a member is looked up in an enumeration eight times as long."""


@dataclass
class WitnessMemory:
    """What a `MountingWitness` remembers."""

    judged: Judged = OPEN
    mounting_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """What is judged: as it is configured."""
    way: WayMemory = field(default_factory=WayMemory)
    mounting: MountingMemory = field(default_factory=MountingMemory)
    window: WindowMemory = field(default_factory=WindowMemory)
    stands: bool = True
    """Whether the vehicle has stood since the window began."""


class MountingWitness:
    """Judges until it is sure, once."""

    def __init__(self, vehicle: Vehicle, memory: WitnessMemory) -> None:
        self.memory = memory
        self._way = Way(vehicle, memory.way)
        self._window = Window(memory.window)
        self._mounting = Mounting(vehicle.imu, memory.mounting) if vehicle.imu else None
        self._configured = vehicle.imu.mounting_deg if vehicle.imu else (0.0, 0.0, 0.0)
        self._begin()

    def _begin(self) -> None:
        self.memory.mounting_deg = self._configured
        if self._mounting is None:
            self.memory.judged = RIGHT

    def restored(self) -> bool:
        """Go on with a memory that has been put back; whether it was of another mounting."""
        other = self.memory.mounting_deg != self._configured
        if other:
            self.memory.judged = OPEN
            self.memory.mounting.up = []
            self._begin()
        if self._mounting is not None:
            self._mounting.restored()
        return other

    def step(self, frame: SyncFrame, standing: bool) -> Event | None:
        """Take a frame; gives what there is to say once the mounting is found to be wrong."""
        memory, mounting = self.memory, self._mounting
        if memory.judged is not OPEN or mounting is None:
            return None
        for reading in frame.odometry:
            self._way.read(reading)
        memory.stands = memory.stands and standing
        if not frame.HasField("imu"):
            return None
        time_s = self._way.time_s(frame.stamp_ns)
        if not self._window.add(frame.imu, time_s):
            return None
        mean, _ = self._window.end(time_s, memory.way.path_m)
        still, memory.stands = memory.stands, True
        if mean is None:
            memory.mounting.windows.clear()
            return None
        if mounting.take(time_s, mean, still):
            return self._judge_stand(mounting)
        if memory.mounting.still:
            return None
        mounting.drive(Course(memory.way.path[-RECENT:]))
        return self._judge_drive(mounting)

    def _judge_stand(self, mounting: Mounting) -> Event | None:
        tilt_deg, limit_deg = mounting.tilt_deg, mounting.tilt_limit_deg
        return self._convict(tilt_deg, limit_deg) if tilt_deg > limit_deg else None

    def _judge_drive(self, mounting: Mounting) -> Event | None:
        turn = mounting.turn()
        if turn is None:
            return None
        turned, limit_rad = abs(turn.angle_rad), math.radians(mounting.turn_limit_deg)
        if turned + STDS * turn.std_rad < limit_rad:
            self.memory.judged = RIGHT
        if turned > BACKWARDS_RAD:  # more likely the wheels' sign, or the other cab
            return None
        if turned > max(limit_rad, STDS * turn.std_rad):
            return self._convict(math.degrees(turned), mounting.turn_limit_deg)
        return None

    def _convict(self, off_deg: float, limit_deg: float) -> Event:
        self.memory.judged = WRONG
        return MOUNTING_WRONG(key=_KEY, off_deg=off_deg, limit_deg=limit_deg)
