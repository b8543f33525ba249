"""Positions of a record: what every map format is made from.

Keys of type foxglove.LocationFix count (what the receiver said, and what filters say); if there is
none, raw fixes that the receiver calls valid.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.recorder.exports.window import Window
from tramstream.recorder.reader import Record

MAX_STEP_NS = 5 * S
"""A longer silence ends a line: nobody was seen to go straight through a tunnel's walls."""


class Place(NamedTuple):
    """One position, of frame and datum WGS84."""

    stamp_ns: int
    longitude_deg: float
    latitude_deg: float
    height_m: float
    """Above the ellipsoid; NaN where nobody says it."""
    horizontal_std_m: float | None
    vertical_std_m: float | None


def positions(record: Record, window: Window) -> dict[str, list[Place]]:
    """All positions by key.

    Raises
    ------
    RecordError
        If the record has no position on the keys that are meant.
    """
    for type_ in (LocationFix, GnssFix):
        name = type_.DESCRIPTOR.full_name
        topics = [info.topic for info in record.channels.values() if info.schema == name]
        found = {topic: list(_places(record, topic, window)) for topic in topics}
        found = {topic: places for topic, places in found.items() if places}
        if found:
            return found
    raise RecordError(f"{record.paths[0]}: has no position{window.told}; see `tramstream info`")


def lines(places: list[Place]) -> Iterator[list[Place]]:
    """Positions that follow each other without a long silence, two at least."""
    line: list[Place] = []
    for place in places:
        if line and not 0 <= place.stamp_ns - line[-1].stamp_ns <= MAX_STEP_NS:
            if len(line) > 1:
                yield line
            line = []
        line.append(place)
    if len(line) > 1:
        yield line


def _places(record: Record, topic: str, window: Window) -> Iterator[Place]:
    for _, message in window.decoded(record, topic):
        place = _of_fix(message) if isinstance(message, GnssFix) else _of_location(message)
        values = (place.longitude_deg, place.latitude_deg) if place else (math.nan,)
        if place is not None and all(map(math.isfinite, values)):
            yield place


def _of_fix(fix: GnssFix) -> Place | None:
    if not fix.valid:
        return None
    return Place(
        fix.stamp_ns,
        fix.longitude_deg,
        fix.latitude_deg,
        fix.height_ellipsoid_m if fix.HasField("height_ellipsoid_m") else math.nan,
        fix.horizontal_std_m,
        fix.vertical_std_m,
    )


def _of_location(location: Any) -> Place | None:
    if location.latitude == 0.0 and location.longitude == 0.0:
        return None  # a receiver without a fix
    horizontal = vertical = None
    if location.position_covariance_type and len(location.position_covariance) == 9:
        east_m2, north_m2, up_m2 = location.position_covariance[::4]
        horizontal, vertical = math.sqrt(max(east_m2 + north_m2, 0)), math.sqrt(max(up_m2, 0))
    return Place(
        location.timestamp.ToNanoseconds(),
        location.longitude,
        location.latitude,
        location.altitude,
        horizontal,
        vertical if math.isfinite(location.altitude) else None,
    )
