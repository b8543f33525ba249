"""A place on a line as it is published."""

from __future__ import annotations

import math
from typing import NamedTuple

from tramstream.processors.segments.place import PlaceFinder, PlaceMemory
from tramstream.processors.segments.possible import Place
from tramstream.proto.estimate_pb2 import LinePlace
from tramstream.tracks.signature import STEP_M

PLACED_PROBABILITY, KEPT_PROBABILITY = 0.9, 0.5
"""A place is named when it is that sure, and no more when it is less sure than the second."""
KEEPS_M, KEEPS_AFTER_OFF_M = 80.0, 300.0
"""It must have been that sure for so long: two curves that look like another line's are common;
longer where no line has fitted before."""
PLACED_STD_M = 15.0
NONE_PROBABILITY = 0.8
"""Nothing is named where it is likelier that no line fits."""
OFF_PROBABILITY = 0.95
OFF_M, OFF_KEEPS_M = 500.0, 200.0
"""Before so much way nobody can say that no line fits: one place of many thousands is the right
one, and the others do not fit. A curve that is drawn badly is over after the second."""
LEAST_STD_M = 0.5
"""A line's chainage is no better known."""


class Said(NamedTuple):
    """The message, and what else is known of the place."""

    message: LinePlace
    destination: str
    geodetic: tuple[float, float] | None
    """Latitude and longitude, rad, where a place is named."""


def said(finder: PlaceFinder, way_m: float, state: int) -> Said:
    """Say where the vehicle is now, `way_m` along its own x.

    Parameters
    ----------
    state : int
        That was said before.
    """
    memory = finder.memory
    message = LinePlace(off_probability=memory.none, gone_m=memory.gone_m)
    places = finder.places()
    if not places:
        off = _off(memory) or state == LinePlace.OFF_LINE
        message.state = LinePlace.OFF_LINE if off else LinePlace.SEARCHING
        memory.sure_m = -1.0
        return Said(message, "", None)
    best = places[0]
    since_m = way_m - memory.way_m
    line = finder.signatures[best.line]
    at_m = _now(best, since_m)
    message.state = _state(best, memory, state)
    message.line, message.direction = line.line, line.direction
    message.chainage_m = at_m
    message.chainage_std_m = math.hypot(best.std_m, LEAST_STD_M)
    message.probability = min(best.probability, 1.0)
    message.line_probability = min(float(finder.of_lines()[best.line]), 1.0)
    message.wheel_scale, message.wheel_scale_std = best.scale, best.scale_std
    message.reversed = best.way * _direction(finder) < 0.0
    for other in places[1:]:
        of = finder.signatures[other.line]
        message.alternatives.add(
            line=of.line,
            direction=of.direction,
            chainage_m=_now(other, since_m),
            chainage_std_m=math.hypot(other.std_m, LEAST_STD_M),
            probability=other.probability,
        )
    geodetic = None
    if len(line.plan):
        row = line.plan[min(max(round(at_m / STEP_M), 0), len(line.plan) - 1)]
        message.latitude_deg, message.longitude_deg = map(math.degrees, row.tolist())
        if message.state == LinePlace.PLACED:
            geodetic = (float(row[0]), float(row[1]))
    destination = line.stop_names[-1] if line.stop_names else line.direction
    return Said(message, destination, geodetic)


def _now(place: Place, since_m: float) -> float:
    return place.at_m + place.way * since_m * (1.0 + place.scale)


def _direction(finder: PlaceFinder) -> float:
    """1 where the vehicle's last motion was along its x."""
    return finder.memory.direction


def _state(best: Place, memory: PlaceMemory, before: int) -> LinePlace.State:
    # Among all places on lines: where most do not fit, being on none of them looks likely at first.
    share = best.probability / max(1.0 - memory.none, 1e-9)
    sure = (
        share > PLACED_PROBABILITY and best.std_m < PLACED_STD_M and memory.none < NONE_PROBABILITY
    )
    if not sure:
        memory.sure_m = -1.0
    elif memory.sure_m < 0.0:
        memory.sure_m = memory.gone_m
    if _off(memory):
        return LinePlace.OFF_LINE
    keeps_m = KEEPS_AFTER_OFF_M if before == LinePlace.OFF_LINE else KEEPS_M
    if sure and memory.gone_m - memory.sure_m >= keeps_m:
        return LinePlace.PLACED
    if before == LinePlace.PLACED and share > KEPT_PROBABILITY and memory.none < OFF_PROBABILITY:
        return LinePlace.PLACED
    return LinePlace.OFF_LINE if before == LinePlace.OFF_LINE else LinePlace.SEARCHING


def _off(memory: PlaceMemory) -> bool:
    """Whether no line has fitted for long enough to be said."""
    if memory.none <= OFF_PROBABILITY:
        memory.off_m = -1.0
        return False
    if memory.off_m < 0.0:
        memory.off_m = memory.gone_m
    return memory.gone_m > OFF_M and memory.gone_m - memory.off_m >= OFF_KEEPS_M
