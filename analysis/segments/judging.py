"""What the processor `segments` has said of a simulated ride against the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.segments.rides import Ridden
from tramstream.clock import S
from tramstream.proto.estimate_pb2 import LinePlace, SegmentEvent
from tramstream.simulation.simulation import EPOCH_NS
from tramstream.tracks.signature import Signature, curves_of_line

Array = NDArray[np.float64]

TIME_S = 1.0
"""Begin and end of a stop are right within that."""
TURN_RAD = math.radians(15.0)
RADIUS_M = 100.0
NEAR_M = 15.0
"""A turn seen is that of the truth if its middle is no further away."""


class Stops(NamedTuple):
    """Stops found, missed and invented, and how far off their times are."""

    hits: int
    missed: int
    false: int
    begin_s: Array
    end_s: Array

    @property
    def f1(self) -> float:
        return 2.0 * self.hits / max(2 * self.hits + self.missed + self.false, 1)


class Turns(NamedTuple):
    """Turns of more than 15° in truth, and what was seen of them."""

    hits: int
    missed: int
    false: int
    angle_rad: Array
    """Seen less true."""
    radius: Array
    """Seen by true, less one, of those up to 100 m."""
    true_angle_rad: Array
    true_radius_m: Array
    """Of all hits, and"""
    all_radius: Array
    """their radii's errors."""


def stops(ride: Ridden, said: Sequence[SegmentEvent]) -> Stops:
    """Judge the stops; a stand at the end of the ride never ends and is not asked for."""
    seen = [
        ((each.start_ns - EPOCH_NS) / S, (each.end_ns - EPOCH_NS) / S)
        for each in said
        if each.kind == SegmentEvent.STOP
    ]
    begin, end, hits = [], [], 0
    free = list(seen)
    dwells = ride.simulation.ride.dwells_s
    truth = [row for row in dwells.tolist() if row[1] < ride.simulation.duration_s - 3.0]
    for first, last in truth:
        found = [each for each in free if each[0] < last and each[1] > first]
        if not found:
            continue
        best = min(found, key=lambda each: abs(each[0] - first) + abs(each[1] - last))
        free.remove(best)
        begin.append(best[0] - first)
        end.append(best[1] - last)
        if max(abs(best[0] - first), abs(best[1] - last)) <= TIME_S:
            hits += 1
    return Stops(hits, len(truth) - hits, len(seen) - hits, np.array(begin), np.array(end))


def turns(ride: Ridden, said: Sequence[SegmentEvent]) -> Turns:
    """Judge the turns against the curves of the true line, in order of time."""
    simulation = ride.simulation
    line = simulation.line
    curves = curves_of_line(line)
    pivot_m = simulation.vehicle.ekf.pivot_m
    seen = []
    for each in said:
        if each.kind == SegmentEvent.TURN:
            times = np.array([each.start_ns - EPOCH_NS, each.end_ns - EPOCH_NS]) / S
            begin, end = simulation.ride.motion(times).arc_length_m.tolist()
            seen.append((begin - pivot_m, end - pivot_m, each))
    gone_m = float(simulation.ride.motion(np.array([simulation.duration_s])).arc_length_m[0])
    angle, radius, true, true_radius, every = [], [], [], [], []
    missed, used = 0, set()
    big = [each for each in curves if abs(each.angle_rad) > TURN_RAD and each.end_m < gone_m - 15.0]
    for curve in big:
        best = None
        for k, (begin, end, event) in enumerate(seen):
            shared = min(end, curve.end_m) - max(begin, curve.begin_m)
            longer = max(end - begin, curve.length_m)
            if event.angle_rad * curve.angle_rad > 0.0 and shared > 0.5 * longer:
                best = k
        if best is None:
            missed += 1
            continue
        used.add(best)
        event = seen[best][2]
        angle.append(event.angle_rad - curve.angle_rad)
        true.append(curve.angle_rad)
        true_radius.append(curve.radius_m)
        every.append(event.radius_m / curve.radius_m - 1.0)
        if curve.radius_m <= RADIUS_M:
            radius.append(every[-1])
    false = sum(
        1
        for k, (begin, end, event) in enumerate(seen)
        if k not in used
        and abs(event.angle_rad) > TURN_RAD + math.radians(2.0)
        and not any(
            min(end, curve.end_m) > max(begin, curve.begin_m)
            for curve in curves
            if curve.angle_rad * event.angle_rad > 0.0
        )
    )
    return Turns(
        len(big) - missed,
        missed,
        false,
        np.array(angle),
        np.array(radius),
        np.array(true),
        np.array(true_radius),
        np.array(every),
    )


class Found(NamedTuple):
    """How a place has been found."""

    share_3_m: float
    """Of the time after the second turn above 30° or the second stop, moving and standing."""
    share_10_m: float
    share_30_m: float
    first_m: float
    """Way until the first place was named; infinite if none was."""
    first_error_m: float
    first_right: bool
    """Whether that was on the right line and within 30 m."""
    half_right: bool
    """Whether the right line was the likeliest from half of the ride on."""
    off_m: float
    """Way until it was said that no line fits; infinite if it was not."""
    error_m: Array
    """Of the named places after the mark; infinite for another line."""
    near: float
    """Share of places that are within three stated deviations."""


def places(ride: Ridden, said: Sequence[LinePlace], lines: Sequence[Signature]) -> Found:
    """Judge the places that were said.

    A place on another line is right where that line goes over the same point: lines share tracks.
    """
    simulation = ride.simulation
    stamps = np.array([each.stamp_ns for each in said], dtype=np.int64)
    arc = simulation.ride.motion((stamps - EPOCH_NS) / S).arc_length_m
    chainage = ride.chainage_at(arc)
    mark_s = _mark_s(ride)
    by_name = {each.name: each for each in lines}
    errors, right_line = [], []
    for each, true in zip(said, chainage.tolist(), strict=True):
        right = f"{each.line}/{each.direction}".startswith(_name(ride))
        right_line.append(right)
        if not each.line:
            errors.append(math.inf)
        elif right:
            errors.append(each.chainage_m - true)
        else:
            errors.append(_elsewhere_m(by_name, ride, each, true))
    error = np.array(errors)
    time_s = (stamps - EPOCH_NS) / S
    placed = np.array([each.state == LinePlace.PLACED for each in said])
    after = time_s > mark_s
    named = np.abs(np.where(placed, error, math.inf))[after]
    first = int(np.argmax(placed)) if placed.any() else -1
    half = time_s > 0.5 * time_s[-1]
    std = np.array([each.chainage_std_m for each in said])
    both = placed & after
    off = [k for k, each in enumerate(said) if each.state == LinePlace.OFF_LINE]
    gone = [each.gone_m for each in said]
    return Found(
        _share(named, 3.0),
        _share(named, 10.0),
        _share(named, 30.0),
        gone[first] if first >= 0 else math.inf,
        float(error[first]) if first >= 0 else math.inf,
        first >= 0 and abs(float(error[first])) <= 30.0,
        bool(np.mean(np.array(right_line)[half]) > 0.95),
        gone[off[0]] if off else math.inf,
        error[both],
        float(np.mean(np.abs(error[both]) <= 3.0 * std[both])) if both.any() else 0.0,
    )


def _share(error_m: Array, limit_m: float) -> float:
    return float(np.mean(error_m <= limit_m)) if len(error_m) else 0.0


def _name(ride: Ridden) -> str:
    return ride.name if "/" in ride.name else f"{ride.name}/"


def _elsewhere_m(
    lines: dict[str, Signature], ride: Ridden, place: LinePlace, true_m: float
) -> float:
    """How far a place on another line is from the vehicle, where both go over the same track."""
    one = lines.get(f"{place.line}/{place.direction}")
    other = lines.get(ride.name)
    if one is None or other is None or not len(one.plan) or not len(other.plan):
        return math.inf
    here = one.plan[min(max(round(place.chainage_m), 0), len(one.plan) - 1)]
    there = other.plan[min(max(round(true_m), 0), len(other.plan) - 1)]
    north = (here[0] - there[0]) * 6_371_000.0
    east = (here[1] - there[1]) * 6_371_000.0 * math.cos(here[0])
    return math.hypot(north, east)


def _mark_s(ride: Ridden) -> float:
    """When the second turn above 30° or the second stop has been gone, whichever comes first."""
    simulation = ride.simulation
    line = simulation.line
    turned = [each.end_m for each in curves_of_line(line) if abs(each.angle_rad) > math.pi / 6]
    dwells = simulation.ride.dwells_s
    marks = [float(dwells[2, 0])] if len(dwells) > 2 else []
    if len(turned) > 1:
        marks.append(simulation.ride.time_at_s(turned[1]))
    return min(marks, default=math.inf)
