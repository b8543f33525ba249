"""A ride for the timetable and the driver's desk: dwells, passages, comfort, energy by section.

All of it comes from the ordered stream alone, by the processor `segments`: no receiver is needed. A
section goes from the end of one stop to the end of the next; names are those of the line that the
place was found on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.processor import Sample
from tramstream.processors.segments.kernels import Ix
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.proto.estimate_pb2 import LinePlace, SegmentEvent
from tramstream.tracks.signature import Signature

Array = NDArray[np.float64]

LOOK_NS = S // 10
SMOOTH = 5
"""Looks over which acceleration is taken: half a second, as passengers feel it."""
NAMED_M = 60.0
"""A stand that is so near a stop of the line is there."""
JOULES_PER_KWH = 3.6e6
SHORTEST_M = 20.0
"""Less between two stands is no section: a vehicle that moves up."""


class Section(NamedTuple):
    """From one departure to the next arrival, and the stand there."""

    begin: str
    """Name of the stop, or how far along the ride it is."""
    end: str
    depart_ns: int
    arrive_ns: int
    dwell_s: float
    """At its end; NaN where the record ends before the departure."""
    doors: bool
    way_m: float
    travel_s: float
    mean_mps: float
    top_mps: float
    most_acceleration_mps2: float
    most_braking_mps2: float
    most_jerk_mps3: float
    rms_jerk_mps3: float
    most_lateral_mps2: float
    traction_kwh: float
    """Work of the motors along the way; NaN where the vehicle bus tells no force."""
    braked_kwh: float


class Passage(NamedTuple):
    """A stop of the line, passed or stood at."""

    line: str
    stop: str
    chainage_m: float
    passed_ns: int
    stood_s: float
    """0: it did not stop there."""


@dataclass
class Told:
    """What a record shows."""

    sections: list[Section] = field(default_factory=list)
    passages: list[Passage] = field(default_factory=list)
    events: list[SegmentEvent] = field(default_factory=list)
    places: list[LinePlace] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    """Kinds of what the processor had to say."""


class _Row(NamedTuple):
    stamp_ns: int
    gone_m: float
    speed_mps: float
    yaw_rad: float
    force_n: float


def read(vehicle: Vehicle, frames: Iterable[Sample], lines: Sequence[Signature] = ()) -> Told:
    """Go over a ride's frames."""
    finder = SegmentFinder(vehicle, lines)
    told, rows = Told(), []
    force, looked_ns = math.nan, 0
    memory = finder.memory.motion
    way_m = 0.0
    for frame in frames:
        for made in finder.step(frame):
            if made.key is keys.EST_SEGMENT:
                told.events.append(made.message)
            elif made.key is keys.MAP_PLACE:
                told.places.append(made.message)
            elif made.key.quantity == "event":
                told.said.append(made.message.kind)
        for odometry in frame.message.odometry:
            if odometry.HasField("motor_force_n"):
                force = odometry.motor_force_n
        if frame.stamp_ns - looked_ns >= LOOK_NS:
            looked_ns = frame.stamp_ns
            way_m = max(way_m, finder.gone_m)
            x = memory.x
            rows.append(_Row(frame.stamp_ns, way_m, float(x[Ix.SPEED]), float(x[Ix.YAW]), force))
    known = finder.lines
    told.sections = _sections(told, rows, known)
    told.passages = _passages(told, known)
    return told


# Sections -----------------------------------------------------------------------------------------
def _sections(told: Told, rows: list[_Row], lines: Sequence[Signature]) -> list[Section]:
    stands = [each for each in told.events if each.kind == SegmentEvent.STOP]
    halts = [each for each in told.events if each.kind == SegmentEvent.HALT]
    if halts and (not stands or halts[-1].start_ns > stands[-1].end_ns):
        stands.append(halts[-1])
    table = np.array(rows, dtype=float) if rows else np.zeros((0, 5))
    stamps = np.array([row.stamp_ns for row in rows], dtype=np.int64)
    found = []
    for k in range(len(stands) - 1):
        one, other = stands[k], stands[k + 1]
        first, last = np.searchsorted(stamps, [one.end_ns, other.start_ns])
        way = other.start_m - one.end_m
        if last - first < 2 * SMOOTH or way < SHORTEST_M:
            continue
        names = (_name(told, one, lines), _name(told, other, lines))
        found.append(_section(names, one, other, table[first : last + 1], way))
    return found


def _section(
    names: tuple[str, str], one: SegmentEvent, other: SegmentEvent, rows: Array, way_m: float
) -> Section:
    dt_s = LOOK_NS / S
    speed, yaw, force = rows[:, 2], np.unwrap(rows[:, 3]), rows[:, 4]
    change = (speed[SMOOTH:] - speed[:-SMOOTH]) / (SMOOTH * dt_s)
    jerk = (change[SMOOTH:] - change[:-SMOOTH]) / (SMOOTH * dt_s)
    turning = (yaw[SMOOTH:] - yaw[:-SMOOTH]) / (SMOOTH * dt_s)
    lateral = np.abs(turning * speed[SMOOTH // 2 : len(turning) + SMOOTH // 2])
    power = force * speed
    lasted_s = (other.start_ns - one.end_ns) / S
    stood = other.kind == SegmentEvent.STOP
    return Section(
        *names,
        one.end_ns,
        other.start_ns,
        (other.end_ns - other.start_ns) / S if stood else math.nan,
        other.doors_opened,
        way_m,
        lasted_s,
        way_m / lasted_s,
        float(np.abs(speed).max()),
        float(change.max()),
        float(-change.min()),
        float(np.abs(jerk).max(initial=0.0)),
        float(np.sqrt(np.mean(jerk**2))) if len(jerk) else 0.0,
        float(lateral.max(initial=0.0)),
        float(np.sum(np.maximum(power, 0.0)) * dt_s / JOULES_PER_KWH),
        float(-np.sum(np.minimum(power, 0.0)) * dt_s / JOULES_PER_KWH),
    )


def _name(told: Told, stand: SegmentEvent, lines: Sequence[Signature]) -> str:
    """Name of the stop at a stand, where the place was known then; else how far it is."""
    place = _place_at(told, stand.start_ns)
    for line in lines:
        if place is None or line.name != f"{place.line}/{place.direction}" or not len(line.stops_m):
            continue
        nearest = int(np.argmin(np.abs(line.stops_m - place.chainage_m)))
        if abs(line.stops_m[nearest] - place.chainage_m) < NAMED_M:
            return line.stop_names[nearest]
    return f"{stand.start_m:.0f} m"


def _place_at(told: Told, stamp_ns: int) -> LinePlace | None:
    placed = [each for each in told.places if each.state == LinePlace.PLACED]
    if not placed:
        return None
    best = min(placed, key=lambda each: abs(each.stamp_ns - stamp_ns))
    return best if abs(best.stamp_ns - stamp_ns) < 3 * S else None


def _passages(told: Told, lines: Sequence[Signature]) -> list[Passage]:
    """Times at which the stops of the line were passed, between two places by a straight line."""
    placed = [each for each in told.places if each.state == LinePlace.PLACED]
    stands = [each for each in told.events if each.kind == SegmentEvent.STOP]
    found: list[Passage] = []
    for one, other in pairwise(placed):
        if (one.line, one.direction) != (other.line, other.direction):
            continue
        line = next((e for e in lines if e.name == f"{one.line}/{one.direction}"), None)
        if line is None or other.stamp_ns - one.stamp_ns > 2 * S:
            continue
        for name, at in zip(line.stop_names, line.stops_m.tolist(), strict=True):
            if one.chainage_m < at <= other.chainage_m:
                share = (at - one.chainage_m) / (other.chainage_m - one.chainage_m)
                passed = one.stamp_ns + round(share * (other.stamp_ns - one.stamp_ns))
                if not any(each.stop == name for each in found[-3:]):
                    stood = [e for e in stands if e.start_ns - 20 * S < passed < e.end_ns + 20 * S]
                    stood_s = (stood[0].end_ns - stood[0].start_ns) / S if stood else 0.0
                    found.append(Passage(line.name, name, at, passed, stood_s))
    return found
