"""Frames wait for the state and the match of their instant: as long, wherever these are made.

The frame of instant t is taken up when a frame of t + D (`grade.delay_s`) or later has come. So it
makes no difference whether the localiser runs in the same process, in another, or in a record: the
same states and matches have come until then. What comes for an instant that has been taken up is
late: not used, counted, named on `est/grade/late`, so that reprocessing leaves it out as well.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import isfinite, nan
from operator import attrgetter
from typing import NamedTuple, TypeVar

from tramstream.clock import S
from tramstream.estimation.localiser import HEADING_UNKNOWN
from tramstream.processor import Ledger, Sample
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import LateSample, SyncFrame

MOST = 1000
"""So many of a kind wait at a time; at 100 a second they are twenty."""
PITCH_VARIANCE = 25
"""Of the pitch, in the upper triangle that a state carries."""
UNSTATED_PITCH_STD_RAD = 0.02
"""Of a localiser's pitch that comes without a covariance."""
TRACK_GRADE = "track_grade"
"""A measurement by which a state shows that its localiser is held to the map's slope."""
Late = Mapping[tuple[str, int], LateSample]


class Frame(NamedTuple):
    """What a frame has beside the inertial mean, which comes through the localiser."""

    stamp_ns: int
    odometry: list[Odometry]
    fixes: list[GnssFix]


class State(NamedTuple):
    """What is used of a localiser's state."""

    stamp_ns: int
    speed_mps: float
    speed_std_mps: float
    acceleration_mps2: float
    pitch_rad: float
    """NaN while the vehicle goes with its heading unknown: then it is that of where it stood."""
    pitch_variance: float
    level_error_rad: float
    """By which the accelerometer shows more pitch than that; NaN if its localiser does not say."""
    level_variance: float
    """Of their sum."""
    standing: bool
    mapped: bool
    """Whether it has just taken the map's slope."""


class Place(NamedTuple):
    """Where a match says that the vehicle is."""

    stamp_ns: int
    edge: str
    run: int
    chainage_m: float
    probability: float


Row = TypeVar("Row", State, Place)
NOWHERE = Place(0, "", -1, 0.0, 0.0)
_STAMP = attrgetter("stamp_ns")


@dataclass
class WaitingMemory:
    """What is on its way."""

    frames: deque[Frame] = field(default_factory=deque)
    states: list[State] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    """Both in the order of their stamps."""
    taken_ns: int = 0
    """Stamp of the last frame that was taken up."""
    ledger: Ledger = field(default_factory=lambda: Ledger("grade", "states and matches"))


Taken = tuple[Frame, State | None, Place | None]
"""A frame, and the newest state and match since the frame before; None: there was none."""


class Waiting:
    """Frames, states and matches that wait.

    Parameters
    ----------
    delay_s : float
        D.
    mapped : bool
        Whether a state may show that its localiser takes the map's slope.
    memory : WaitingMemory
        Part of its owner's memory.
    """

    def __init__(self, delay_s: float, mapped: bool, memory: WaitingMemory) -> None:
        self.memory = memory
        self._delay_ns = int(delay_s * S)
        self._mapped = mapped
        self._recorded: dict[tuple[str, int, int], LateSample] | None = None

    def repeat(self, late: Late | None, of: tuple[str, ...]) -> None:
        """Hold for late what was late in the live run, of the keys `of`; None: by the frames."""
        self._recorded = None
        if late is not None:
            own = (each for each in late.values() if each.key in of)
            self._recorded = {(each.key, each.stamp_ns, each.source_sequence): each for each in own}

    # What comes ----------------------------------------------------------------------------------
    def take_frame(self, message: SyncFrame) -> None:
        """Let a frame wait."""
        frames, stamp_ns = self.memory.frames, message.stamp_ns
        if not frames or stamp_ns > frames[-1][0]:
            # Copies: to go through what protobuf holds takes three times as long.
            frames.append(Frame(stamp_ns, message.odometry[:], message.gnss[:]))

    def take_state(self, sample: Sample) -> LateSample | None:
        """Let a state wait; gives what names it if it is late."""
        memory = self.memory
        states = memory.states
        memory.ledger.received += 1
        if (
            self._recorded is not None
            or not memory.taken_ns < sample.stamp_ns
            or len(states) >= MOST
        ):
            late = self._late(sample, len(states))
            if late is not None:
                return late
        state = _state_of(sample.message, self._mapped)
        if state is None:
            memory.ledger.dropped += 1
        elif not states or states[-1][0] <= state[0]:
            states.append(state)
        else:
            insort(states, state, key=_STAMP)
        return None

    def take_match(self, sample: Sample) -> LateSample | None:
        """Let a match wait; gives what names it if it is late."""
        memory = self.memory
        places = memory.places
        memory.ledger.received += 1
        if (
            self._recorded is not None
            or not memory.taken_ns < sample.stamp_ns
            or len(places) >= MOST
        ):
            late = self._late(sample, len(places))
            if late is not None:
                return late
        place = _place_of(sample.message)
        if not places or places[-1][0] <= place[0]:
            places.append(place)
        else:
            insort(places, place, key=_STAMP)
        return None

    def _late(self, sample: Sample, waiting: int) -> LateSample | None:
        """What names a sample that is late, or one too many; None: it is neither."""
        memory, recorded = self.memory, self._recorded
        if recorded is not None:
            known = recorded.get((sample.key.path, sample.stamp_ns, sample.sequence))
            memory.ledger.dropped += known is not None
            return known
        if sample.stamp_ns > memory.taken_ns and waiting < MOST:
            return None
        memory.ledger.dropped += 1
        return LateSample(
            key=sample.key.path,
            source_sequence=sample.sequence,
            source_publish_ns=sample.publish_ns,
            horizon_ns=memory.taken_ns,
        )

    # What is taken up ----------------------------------------------------------------------------
    def due(self, frame_ns: int) -> list[Taken]:
        """Give what is taken up when a frame of an instant has come, in order."""
        memory, limit_ns = self.memory, frame_ns - self._delay_ns
        frames, states, places = memory.frames, memory.states, memory.places
        found = []
        while frames and frames[0][0] <= limit_ns:
            frame = frames.popleft()
            stamp_ns = memory.taken_ns = frame[0]
            state = place = None
            if states and states[0][0] <= stamp_ns:
                state = self._newest(states, stamp_ns)
            if places and places[0][0] <= stamp_ns:
                place = self._newest(places, stamp_ns)
            found.append((frame, state, place))
        return found

    def _newest(self, waiting: list[Row], stamp_ns: int) -> Row:
        """Take off what waits for a frame, one or more; the last of it counts."""
        count = 1
        while count < len(waiting) and waiting[count][0] <= stamp_ns:
            count += 1
        newest = waiting[count - 1]
        del waiting[:count]
        self.memory.ledger.delivered += count
        return newest

    @property
    def ledger(self) -> Ledger:
        """What became of all that came."""
        pending = len(self.memory.states) + len(self.memory.places)
        return replace(self.memory.ledger, pending=pending)


def _state_of(message: MotionState, mapped: bool) -> State | None:
    """Give what is used of a state; None if it is no number."""
    try:
        variance = message.covariance[PITCH_VARIANCE]
    except IndexError:
        variance = UNSTATED_PITCH_STD_RAD**2
    speed, acceleration, pitch = message.speed_mps, message.acceleration_mps2, message.pitch_rad
    if not (isfinite(speed + acceleration + pitch + variance) and variance >= 0.0):
        return None
    standing, level, std = message.standing, nan, 0.0
    if message.HasField("level_error_rad"):
        level, std = message.level_error_rad, message.level_std_rad
    if message.mode == HEADING_UNKNOWN and not standing:
        pitch = nan
    return State(
        message.stamp_ns,
        speed,
        message.speed_std_mps,
        acceleration,
        pitch,
        variance,
        level if isfinite(level + std) else nan,
        std * std,
        standing,
        mapped and _takes_slope(message),
    )


def _takes_slope(message: MotionState) -> bool:
    return any(each.accepted and each.measurement == TRACK_GRADE for each in message.innovations[:])


def _place_of(message: MapMatch) -> Place:
    if message.run < 0 or message.state != MapMatch.ON_TRACK:
        return NOWHERE._replace(stamp_ns=message.stamp_ns)
    return Place(
        message.stamp_ns, message.edge, message.run, message.chainage_m, message.probability
    )
