"""Positions of a record as GeoJSON (RFC 7946: longitude, latitude, height above the ellipsoid)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from tramstream.recorder.exports.places import Place, lines, positions
from tramstream.recorder.exports.window import WHOLE, Window
from tramstream.recorder.reader import Record


def geojson(record: Record, window: Window = WHOLE) -> dict[str, Any]:
    """All positions: for each key lines without gaps, and a point a position.

    Raises
    ------
    RecordError
        If the record has no position.
    """
    features = [
        feature
        for topic, places in positions(record, window).items()
        for feature in _features(record.vehicle, topic, places)
    ]
    return {"type": "FeatureCollection", "features": features}


def _features(vehicle: str, topic: str, places: list[Place]) -> Iterator[dict[str, Any]]:
    common = {"key": topic, "vehicle": vehicle}
    for line in lines(places):
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


def _position(place: Place) -> list[float]:
    """Nine decimals of a degree are a tenth of a millimetre; an unknown height is left out.

    RFC 7946, section 3.1.1: a position of two numbers has none.
    """
    level = [round(place.longitude_deg, 9), round(place.latitude_deg, 9)]
    return [*level, round(place.height_m, 4)] if math.isfinite(place.height_m) else level
