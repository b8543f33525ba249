"""The slope of the track as a processor: frames, a localiser's states and matches in, slopes out.

`est/grade/state` says the slope of the track under the vehicle with its deviation, how the body
nods against it, where on the network that is, and which inputs tell of it now; where the vehicle
bus has the motor force, the mass too. `est/grade/stopping` says how far the vehicle goes until it
stands, on the slope ahead.

It knows nothing of the localiser but its messages (`[grade] source`), and feeds back into nothing:
a slope of today is tomorrow's map only by way of the network's file. States and matches are waited
for in event time (`waiting.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.estimation.followed import followed
from tramstream.estimation.localiser import Verdict
from tramstream.events import Event, declared
from tramstream.keys import Key
from tramstream.machine.kernels import bound
from tramstream.processor import Ledger, Processor, Sample
from tramstream.processors.grade import events as own_events
from tramstream.processors.grade import in_use
from tramstream.processors.grade.events import (
    MASS_KNOWN,
    PITCH_CONTRADICTS,
    SUSPENSION_CONTRADICTS,
)
from tramstream.processors.grade.filter import FilterMemory, GradeFilter
from tramstream.processors.grade.in_use import InUse, InUseMemory
from tramstream.processors.grade.kernels import Ix
from tramstream.processors.grade.said import Of
from tramstream.processors.grade.settings import GradeSettings
from tramstream.processors.grade.stopping import stop
from tramstream.processors.grade.waiting import (
    NOWHERE,
    Frame,
    Late,
    Place,
    State,
    Waiting,
    WaitingMemory,
)
from tramstream.processors.grade.way_ahead import (
    LEAST_PROBABILITY,
    Ahead,
    WayAhead,
    known_now,
)
from tramstream.proto.estimate_pb2 import (
    FilterParameters,
    GradeStopping,
    Parameter,
    StoppingDistance,
)
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import LateSample, SyncFrame
from tramstream.tracks import network as networks

_MATCH = keys.MAP_MATCH.path
STOPPING_EVERY_NS = S // 2
MATCHED_NS = S // 2
"""A match that is older says nothing of now."""
KNOWN_PART = 0.02
"""A mass that is known by that is told."""
STDS = 3.0
"""What is off by more of its own and the setting's deviations contradicts."""
HOLDS_S = 30
"""A localiser that finds its mounting in the first departure moves its pitch by as much."""
LEAST_OFF_RAD = math.radians(0.5)
"""A pitch that is less off is not worth saying."""


@dataclass
class GradeMemory:
    """What the slope's processor remembers."""

    waiting: WaitingMemory = field(default_factory=WaitingMemory)
    filter: FilterMemory = field(default_factory=FilterMemory)
    in_use: InUseMemory = field(default_factory=InUseMemory)
    place: Place = NOWHERE
    """The last match."""
    forced: bool = False
    """Whether the motor force has told anything."""
    second: int = 0
    stopped_ns: int = 0
    """Of the last distances to stop."""
    told: list[str] = field(default_factory=list)
    """Kinds of what has been said."""
    held: dict[str, int] = field(default_factory=dict)
    """For how many seconds what contradicts has done so."""


class GradeEstimator(Processor):
    """The slope of the track, apart from the body's pitch; see the module.

    Raises
    ------
    ConfigError
        If `[grade] source` is a key of something that is no state.
    """

    name = "grade"
    Settings = GradeSettings
    settings: GradeSettings
    inputs: tuple[Key, ...] = (keys.SYNC_FRAME, keys.EST_STATE, keys.MAP_MATCH)
    outputs = (
        keys.EST_GRADE,
        keys.EST_STOPPING,
        keys.EST_GRADE_PARAMETERS,
        keys.EST_GRADE_LATE,
    )
    events = declared(own_events)
    pacing = (keys.SYNC_FRAME,)
    Memory = GradeMemory
    memory: GradeMemory

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        settings, memory = self.settings, self.memory
        self._source = followed("grade.source", settings.source)
        self._source_path = self._source.path
        self.inputs = (keys.SYNC_FRAME, self._source, keys.MAP_MATCH)
        mapped = vehicle.map is not None or vehicle.ekf.track == "always"
        self._waiting = Waiting(settings.delay_s, mapped, memory.waiting)
        self._filter = GradeFilter(vehicle, settings, memory.filter)
        self._in_use = InUse(memory.in_use)
        self._way = _way_of(vehicle)
        self._stop = bound(stop, known_now(0.0, 1.0, 0.0).slopes, 0.5, 0.5, 0.5)
        self._late_recorded: Late | None = None

    def step(self, sample: Sample) -> list[Sample]:
        path = sample.key.path
        if path == self._source_path:
            late = self._waiting.take_state(sample)
        elif path == _MATCH:
            late = self._waiting.take_match(sample)
        else:
            return self._take_frame(sample.message)
        return [] if late is None else self._name_late(late, sample)

    def _take_frame(self, frame: SyncFrame) -> list[Sample]:
        self._waiting.take_frame(frame)
        made: list[Sample] = []
        for taken in self._waiting.due(frame.stamp_ns):
            made += self._take(*taken)
        return made

    def _name_late(self, late: LateSample, sample: Sample) -> list[Sample]:
        named = LateSample()
        named.CopyFrom(late)
        if self._late_recorded is not None:  # with the number that it had live
            self._next_sequence[keys.EST_GRADE_LATE.path] = late.sequence
        return [self.emit(keys.EST_GRADE_LATE, named, sample.stamp_ns)]

    # A frame -------------------------------------------------------------------------------------
    def _take(self, frame: Frame, state: State | None, place: Place | None) -> list[Sample]:
        stamp_ns, odometry, fixes = frame
        memory, filter_, uses = self.memory, self._filter, self._in_use
        if state is not None:
            uses.use(in_use.ACCELEROMETER, stamp_ns)
            if state.mapped:
                uses.use(in_use.MAP, stamp_ns)
        if odometry:
            uses.use(in_use.ODOMETRY, stamp_ns)
            for reading in odometry:
                filter_.take_odometry(reading)
        if place is None:
            place = memory.place
        else:
            memory.place = place
        if place.run < 0 or not stamp_ns - place.stamp_ns < MATCHED_NS:
            place = NOWHERE
        known = filter_.step(stamp_ns, state, place)
        verdicts = self._hear(odometry, fixes) if odometry or fixes else ()
        if not known:
            return []
        names = uses.names(stamp_ns)
        message = filter_.said.message(memory.forced, place.edge, place.run, names)
        for name, value, variance, accepted in verdicts:
            message.innovations.add(
                measurement=name, value=value, variance=variance, accepted=accepted
            )
        made = [self.emit(keys.EST_GRADE, message, stamp_ns)]
        if not 0 <= stamp_ns - memory.stopped_ns < STOPPING_EVERY_NS:
            memory.stopped_ns = stamp_ns
            made.append(self.emit(keys.EST_STOPPING, self._stopping(), stamp_ns))
        second = stamp_ns // S
        if second != memory.second:
            memory.second = second
            made += self._each_second(stamp_ns)
        return made

    def _hear(self, odometry: list[Odometry], fixes: list[GnssFix]) -> list[Verdict]:
        """Take force and fixes of a frame; what they told, accepted or not."""
        memory, found = self.memory, []
        for reading in odometry:
            if reading.HasField("motor_force_n"):
                verdict = self._filter.take_force(reading.motor_force_n)
                if verdict is not None:
                    memory.forced = memory.forced or verdict.accepted
                    found.append(verdict)
        for fix in fixes:
            found += self._filter.take_fix(fix)
        for verdict in found:
            if verdict.accepted:
                self._in_use.use(verdict.measurement, memory.filter.stamp_ns)
        return found

    # Distances to stop ---------------------------------------------------------------------------
    def _stopping(self) -> GradeStopping:
        """Distances to stop from now on."""
        now = self.memory.filter.state
        forwards, speed = -1.0 if now.speed_mps < 0.0 else 1.0, abs(now.speed_mps)
        ahead = self._ahead(forwards)
        message = GradeStopping(speed_mps=now.speed_mps, mapped_m=ahead.mapped_m)
        longest_m = 0.0
        for deceleration in self.settings.decelerations_mps2:
            reaction_s = self.settings.reaction_s
            distance, by_speed, by_slope = self._stop(ahead.slopes, speed, deceleration, reaction_s)
            level_m = speed * reaction_s + 0.5 * speed * speed / deceleration
            told = StoppingDistance(deceleration_mps2=deceleration, level_m=level_m)
            if math.isfinite(distance):
                longest_m = max(longest_m, distance)
                told.distance_m = distance
                std = ahead.std_at(distance)
                told.distance_std_m = math.hypot(by_speed * now.speed_std_mps, by_slope * std)
            message.stops.append(told)
        message.grade_ahead_rad = ahead.mean_to(longest_m)
        return message

    def _ahead(self, forwards: float) -> Ahead:
        # The slope seen in the direction of motion turns its sign with it, its bend does not.
        numbers = self._filter.said.numbers
        slope, variance, bend = (float(numbers[k]) for k in (Of.SLOPE, Of.VARIANCE, Of.BEND))
        here = known_now(forwards * slope, variance, bend)
        place = self.memory.place
        if self._way is None or place.run < 0 or place.probability < LEAST_PROBABILITY:
            return here
        if self.memory.filter.stamp_ns - place.stamp_ns > MATCHED_NS:
            return here
        return self._way.of(place.run, place.chainage_m, here)

    # Once a second -------------------------------------------------------------------------------
    def _each_second(self, stamp_ns: int) -> list[Sample]:
        message = FilterParameters(model=self.name, parameters=self._learned())
        made = [self.emit(keys.EST_GRADE_PARAMETERS, message, stamp_ns)]
        for event in (*self._in_use.silent(stamp_ns), *self._contradictions()):
            made += self.raise_event(event, stamp_ns)
        return made + self.overdue_events(stamp_ns)

    def _learned(self) -> list[Parameter]:
        scale = self.settings.mass_kg
        rows = [
            ("pitch_per_mps2", Ix.SPRING, 1.0, "rad s²/m"),
            ("pitch_offset", Ix.OFFSET, 1.0, "rad"),
            ("fix_height_error", Ix.FIX_ERROR, 1.0, "m"),
        ]
        if self.memory.forced:
            rows += [("mass", Ix.MASS, scale, "kg"), ("rolling_resistance", Ix.ROLLING, 1.0, "1")]
        found = []
        for name, index, factor, unit in rows:
            value, std = self._filter.value(index)
            found.append(Parameter(name=name, value=value * factor, std=std * factor, unit=unit))
        return found

    def _contradictions(self) -> list[Event]:
        """Give what is to be said once of what has been learned."""
        settings, value, found = self.settings, self._filter.value, []
        spring, spring_std = (math.degrees(each) for each in value(Ix.SPRING))
        told = settings.pitch_deg_per_mps2
        limit = STDS * math.hypot(spring_std, settings.pitch_std_deg_per_mps2)
        if self._holds(SUSPENSION_CONTRADICTS.name, abs(spring - told) > limit):
            found.append(SUSPENSION_CONTRADICTS(pitch_deg=spring, told_deg=told, limit_deg=limit))
        offset, offset_std = value(Ix.OFFSET)
        stated = math.sqrt(self.memory.filter.state.pitch_variance)
        limit = max(LEAST_OFF_RAD, STDS * math.hypot(offset_std, stated))
        if self._holds(PITCH_CONTRADICTS.name, abs(offset) > limit):
            degrees = {"offset_deg": math.degrees(offset), "limit_deg": math.degrees(limit)}
            found.append(PITCH_CONTRADICTS(**degrees))
        mass, mass_std = (each * settings.mass_kg for each in value(Ix.MASS))
        known = self.memory.forced and mass_std < KNOWN_PART * mass
        if self._holds(MASS_KNOWN.name, known):
            found.append(MASS_KNOWN(mass_kg=mass, mass_std_kg=mass_std))
        return found

    def _holds(self, kind: str, holds: bool) -> bool:
        """Whether something has held for long enough to be told, and has not been told."""
        memory = self.memory
        memory.held[kind] = memory.held.get(kind, 0) + 1 if holds else 0
        if memory.held[kind] < HOLDS_S or kind in memory.told:
            return False
        memory.told.append(kind)
        return True

    # Hosts ---------------------------------------------------------------------------------------
    @property
    def late_recorded(self) -> Late | None:
        """See `tramstream.processor.Ordering`."""
        return self._late_recorded

    @late_recorded.setter
    def late_recorded(self, late: Late | None) -> None:
        self._late_recorded = late
        self._waiting.repeat(late, (self._source.path, keys.MAP_MATCH.path))

    def ledgers(self) -> list[Ledger]:
        return [self._waiting.ledger]

    def restored(self) -> None:
        self._in_use.forget()


def _way_of(vehicle: Vehicle) -> WayAhead | None:
    """Give the network's slopes; None without a network. The map matcher says if it is unread."""
    if vehicle.map is None:
        return None
    try:
        return WayAhead(networks.load(Path(vehicle.map.network)))
    except ConfigError:
        return None
