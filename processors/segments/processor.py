"""Stops, turns, areas and the place on a line as a processor: frames in, nothing of a filter.

It stands beside the localiser: `est/segments/event` says each stop and each turn when it has
ended, `map/line/place` twice a second which line fits and where on it the vehicle is, found with no
idea where it began. Landmarks (`raw/landmark/passed`) are one more source, taken with the frame
that follows them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.events import declared
from tramstream.processor import Processor, Sample
from tramstream.processors.segments import areas
from tramstream.processors.segments import events as own_events
from tramstream.processors.segments.areas import Areas, AreasMemory
from tramstream.processors.segments.epoch import REFUSED_S, Wh
from tramstream.processors.segments.events import (
    GYRO_STUCK,
    LINES_UNREAD,
    MOUNTING_CONTRADICTS,
    NO_LINE_FITS,
    PLACED,
    WHEELS_REFUSED,
)
from tramstream.processors.segments.kernels import Ix
from tramstream.processors.segments.ledger import Ledger, LedgerMemory
from tramstream.processors.segments.lines import signatures_of
from tramstream.processors.segments.motion import CONTRADICTS_RAD, Epoch, Motion, MotionMemory
from tramstream.processors.segments.place import PlaceFinder, PlaceMemory
from tramstream.processors.segments.said import Said, said
from tramstream.processors.segments.settings import SegmentsSettings
from tramstream.proto.estimate_pb2 import LinePlace
from tramstream.proto.raw_pb2 import Landmark
from tramstream.tracks.signature import Signature

SAID_EVERY_NS = S // 2
STAND_S = 8.0
"""A stand of so long may be at a stop; where doors open, it is looked at when they do."""
INERTIAL_SCALE_STD = 0.005
"""Of a way by the IMU alone: its accelerometer's scale, and γ."""
STUCK_S = 20.0
"""Seconds of motion in which no gyroscope gives the very same number."""
MOVING_MPS = 3.0


@dataclass
class SegmentsMemory:
    """What the processor remembers."""

    motion: MotionMemory = field(default_factory=MotionMemory)
    ledger: LedgerMemory = field(default_factory=LedgerMemory)
    place: PlaceMemory = field(default_factory=PlaceMemory)
    areas: AreasMemory = field(default_factory=AreasMemory)
    landmarks: list[Landmark] = field(default_factory=list)
    """That are later than the last frame."""
    said_ns: int = 0
    state: int = LinePlace.SEARCHING
    counted: bool = False
    """Whether the stand that goes on has been looked at for a stop."""
    told_unread: bool = False
    rate_z: float = math.nan
    """The yaw rate of the case, and"""
    same_s: float = 0.0
    """for how long it has been the very same while moving."""
    slipped: bool = False


class SegmentFinder(Processor):
    """What a ride shows of the line that it goes along; see the module."""

    name = "segments"
    Settings = SegmentsSettings
    settings: SegmentsSettings
    inputs = (keys.SYNC_FRAME, keys.LANDMARK)
    outputs = (keys.EST_SEGMENT, keys.MAP_PLACE)
    events = declared(own_events)
    pacing = (keys.SYNC_FRAME,)
    Memory = SegmentsMemory
    memory: SegmentsMemory

    def __init__(self, vehicle: Vehicle, lines: Sequence[Signature] = ()) -> None:
        """Follow a vehicle; `lines` are looked for beside those that its configuration names."""
        super().__init__(vehicle)
        settings, memory = self.settings, self.memory
        self._motion = Motion(vehicle, settings, memory.motion)
        self._ledger = Ledger(self._motion, math.radians(settings.least_turn_deg), memory.ledger)
        self._areas = Areas(settings.areas, memory.areas)
        self._fenced = bool(settings.areas)
        read = signatures_of(vehicle, settings)
        self._unread = read.unread
        self._finder: PlaceFinder | None = None
        known = [*lines, *read.signatures]
        if known:
            body = (vehicle.ekf.pivot_m, vehicle.ekf.bogie_distance_m)
            wheeled = vehicle.odometer is not None and settings.wheels
            scale_std = settings.scale_std if wheeled else INERTIAL_SCALE_STD
            self._finder = PlaceFinder(known, body, scale_std, settings.heading_noise, memory.place)

    def step(self, sample: Sample) -> list[Sample]:
        message = sample.message
        if type(message) is Landmark:
            self.memory.landmarks.append(message)
            return []
        epoch = self._motion.take(message)
        made: list[Sample] = []
        if self._fenced and message.gnss:
            made += self._borders(areas.of_fixes(message), "gnss", message.stamp_ns)
        if epoch is None:
            return made
        for event in self._ledger.take(epoch):
            made.append(self.emit(keys.EST_SEGMENT, event, epoch.stamp_ns))
        made += self._place(epoch)
        return made + self._troubles(epoch)

    @property
    def gone_m(self) -> float:
        """Way gone, whichever way."""
        return self._motion.gone_m

    @property
    def lines(self) -> tuple[Signature, ...]:
        """Lines that are looked for."""
        return self._finder.signatures if self._finder is not None else ()

    # Place ---------------------------------------------------------------------------------------
    def _place(self, epoch: Epoch) -> list[Sample]:
        finder, memory, motion = self._finder, self.memory, self._motion
        if finder is None or not memory.motion.aligned:
            return []
        x = memory.motion.x
        yaw_variance = float(memory.motion.P[Ix.YAW, Ix.YAW])
        finder.go(float(x[Ix.WAY]), float(x[Ix.YAW]), yaw_variance, motion.doubt)
        self._look_at_stand(finder)
        self._pass_landmarks(finder, epoch.stamp_ns)
        if 0 <= epoch.stamp_ns - memory.said_ns < SAID_EVERY_NS:
            return []
        memory.said_ns = epoch.stamp_ns
        found = said(finder, float(x[Ix.WAY]), memory.state)
        made = [self.emit(keys.MAP_PLACE, found.message, epoch.stamp_ns)]
        made += self._changes(found, epoch.stamp_ns)
        if found.geodetic is not None:
            made += self._borders(found.geodetic, "place", epoch.stamp_ns)
        return made

    def _look_at_stand(self, finder: PlaceFinder) -> None:
        memory = self.memory
        stood_s, doors = self._ledger.halted_s, memory.ledger.doors
        if stood_s == 0.0:
            memory.counted = False
        elif not memory.counted and (stood_s > STAND_S or doors):
            memory.counted = True
            finder.stand(doors)

    def _pass_landmarks(self, finder: PlaceFinder, stamp_ns: int) -> None:
        memory = self.memory
        due = [each for each in memory.landmarks if each.stamp_ns <= stamp_ns]
        if not due:
            return
        memory.landmarks = [each for each in memory.landmarks if each.stamp_ns > stamp_ns]
        for mark in due:
            lines = [
                k
                for k, line in enumerate(finder.signatures)
                if mark.line in ("", line.line) and mark.direction in ("", line.direction)
            ]
            std_m = max(mark.chainage_std_m, 1.0)
            probability = min(mark.probability or 1.0, 0.999)
            finder.pass_landmark(lines, mark.chainage_m, std_m, probability)

    def _changes(self, found: Said, stamp_ns: int) -> list[Sample]:
        memory, message = self.memory, found.message
        before, memory.state = memory.state, message.state
        if message.state == before:
            return []
        if message.state == LinePlace.PLACED:
            event = PLACED(
                line=message.line,
                destination=found.destination,
                chainage_m=message.chainage_m,
                std_m=message.chainage_std_m,
                gone_m=message.gone_m,
            )
            return self.raise_event(event, stamp_ns)
        if message.state == LinePlace.OFF_LINE and self._finder is not None:
            lines = len(self._finder.signatures)
            event = NO_LINE_FITS(lines=lines, gone_m=message.gone_m)
            return self.raise_event(event, stamp_ns)
        return []

    def _borders(
        self, geodetic: tuple[float, float] | None, source: str, stamp_ns: int
    ) -> list[Sample]:
        if geodetic is None:
            return []
        passed = self._areas.take(*geodetic, self._motion.gone_m, stamp_ns, source)
        return [self.emit(keys.EST_SEGMENT, each, stamp_ns) for each in passed]

    def restored(self) -> None:
        if self._finder is not None:
            self._finder.forget()

    # Troubles ------------------------------------------------------------------------------------
    def _troubles(self, epoch: Epoch) -> list[Sample]:
        memory, motion, made = self.memory, self._motion, []
        stamp_ns = epoch.stamp_ns
        if self._unread is not None and not memory.told_unread:
            memory.told_unread = True
            reason, advice = self._unread
            made += self.raise_event(LINES_UNREAD(reason=reason, advice=advice), stamp_ns)
        if epoch.contradicts_rad:
            tilt, limit = math.degrees(epoch.contradicts_rad), math.degrees(CONTRADICTS_RAD)
            event = MOUNTING_CONTRADICTS(tilt_deg=tilt, limit_deg=limit)
            made += self.raise_event(event, stamp_ns)
            motion.look_for_mounting()
        refused_s = float(memory.motion.wheels.row[Wh.REFUSED_S])
        if refused_s > REFUSED_S and not memory.slipped:
            event = WHEELS_REFUSED(refused_s=refused_s, limit_s=REFUSED_S)
            made += self.raise_event(event, stamp_ns)
        memory.slipped = refused_s > REFUSED_S
        return made + self._stuck(stamp_ns) + self.overdue_events(stamp_ns)

    def _stuck(self, stamp_ns: int) -> list[Sample]:
        memory, rate = self.memory, self._motion.rate_z
        same = rate == memory.rate_z and abs(memory.motion.x[Ix.SPEED]) > MOVING_MPS
        before, memory.rate_z = memory.same_s, rate
        memory.same_s = before + 0.1 if same else 0.0
        if before <= STUCK_S < memory.same_s:
            return self.raise_event(GYRO_STUCK(still_s=memory.same_s), stamp_ns)
        return []
