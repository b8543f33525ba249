"""Positions of a record as GeoJSON (RFC 7946: longitude, latitude, height above the ellipsoid)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream.errors import RecordError
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.recorder.reader import Record

MAX_STEP_NS = 5_000_000_000
"""A longer silence ends a line: nobody was seen to go straight through a tunnel's walls."""


class _Place(NamedTuple):
    stamp_ns: int
    longitude_deg: float
    latitude_deg: float
    height_m: float
    horizontal_std_m: float | None
    vertical_std_m: float | None


def geojson(record: Record) -> dict[str, Any]:
    """All positions: for each key lines without gaps, and a point a position.

    Keys of type foxglove.LocationFix count (what the receiver said, and what filters say); if there
    is none, raw fixes that the receiver calls valid.

    Raises
    ------
    RecordError
        If the record has no position.
    """
    for type_ in (LocationFix, GnssFix):
        name = type_.DESCRIPTOR.full_name
        topics = [info.topic for info in record.channels.values() if info.schema == name]
        features = [feature for topic in topics for feature in _features(record, topic)]
        if features:
            return {"type": "FeatureCollection", "features": features}
    raise RecordError(f"{record.paths[0]}: has no position; see `tramstream info`")


def _features(record: Record, topic: str) -> Iterator[dict[str, Any]]:
    places = list(_places(record, topic))
    common = {"key": topic, "vehicle": record.vehicle}
    for line in _lines(places):
        span = {"start_ns": line[0].stamp_ns, "end_ns": line[-1].stamp_ns}
        yield _feature("LineString", [_position(place) for place in line], {**common, **span})
    for place in places:
        values = {
            "stamp_ns": place.stamp_ns,
            "horizontal_std_m": place.horizontal_std_m,
            "vertical_std_m": place.vertical_std_m,
        }
        yield _feature("Point", _position(place), {**common, **values})


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _position(place: _Place) -> list[float]:
    """Nine decimals of a degree are a tenth of a millimetre; an unknown height is left out.

    RFC 7946, section 3.1.1: a position of two numbers has none.
    """
    level = [round(place.longitude_deg, 9), round(place.latitude_deg, 9)]
    return [*level, round(place.height_m, 4)] if math.isfinite(place.height_m) else level


def _lines(places: list[_Place]) -> Iterator[list[_Place]]:
    line: list[_Place] = []
    for place in places:
        if line and not 0 <= place.stamp_ns - line[-1].stamp_ns <= MAX_STEP_NS:
            if len(line) > 1:
                yield line
            line = []
        line.append(place)
    if len(line) > 1:
        yield line


def _places(record: Record, topic: str) -> Iterator[_Place]:
    for _, message in record.decoded(topic.__eq__):
        place = _of_fix(message) if isinstance(message, GnssFix) else _of_location(message)
        values = (place.longitude_deg, place.latitude_deg) if place else (math.nan,)
        if place is not None and all(map(math.isfinite, values)):
            yield place


def _of_fix(fix: GnssFix) -> _Place | None:
    if not fix.valid:
        return None
    return _Place(
        fix.stamp_ns,
        fix.longitude_deg,
        fix.latitude_deg,
        fix.height_ellipsoid_m if fix.HasField("height_ellipsoid_m") else math.nan,
        fix.horizontal_std_m,
        fix.vertical_std_m,
    )


def _of_location(location: Any) -> _Place | None:
    if location.latitude == 0.0 and location.longitude == 0.0:
        return None  # a receiver without a fix
    horizontal = vertical = None
    if location.position_covariance_type and len(location.position_covariance) == 9:
        east_m2, north_m2, up_m2 = location.position_covariance[::4]
        horizontal, vertical = math.sqrt(max(east_m2 + north_m2, 0)), math.sqrt(max(up_m2, 0))
    return _Place(
        location.timestamp.ToNanoseconds(),
        location.longitude,
        location.latitude,
        location.altitude,
        horizontal,
        vertical if math.isfinite(location.altitude) else None,
    )
