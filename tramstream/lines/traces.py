"""Traces that people bring: GPX and GeoJSON, as logged by a phone or a tracker.

GPX: points of tracks, or of routes if there are no tracks; `time`, and the accuracy out of an
extension or `hdop`. GeoJSON: LineStrings with `coordTimes`, or Points with `time`. Points that
cannot be used (no place, no time where others have one, no later than the point before) are left
out and counted in the notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.input_file import parse_json, read_bytes

Array = NDArray[np.float64]

HDOP_M = 5.0
"""Error of a range as receivers in cities have it: accuracy is so much times hdop."""
_UNTIMED_NS = 1_000_000_000
_ACCURACY = ("accuracy", "hacc", "horizontalaccuracy", "accuracy_m", "horizontal_accuracy")
"""Names, without case, under which loggers put a horizontal accuracy in metres."""
_TIMES = ("coordTimes", "coordinateTimes", "times")
_MILLISECONDS = 9e9
"""A number that is larger is of milliseconds since 1970, else of seconds."""
_LATEST_NS = 2**63 - 1


@dataclass(frozen=True)
class Trace:
    """Places in the order in which they were passed."""

    name: str
    stamp_ns: NDArray[np.int64]
    """Ascending; UTC since 1970, or 1 s apart if the file has no times."""
    latitude_rad: Array
    longitude_rad: Array
    accuracy_m: Array
    """Radius that holds 68 % of the errors; NaN where it is not known."""
    timed: bool
    notes: tuple[str, ...] = ()
    """What was assumed or left out: a sentence each."""


class _Point(NamedTuple):
    latitude_deg: float
    longitude_deg: float
    stamp_ns: int | None
    accuracy_m: float


def read(path: Path) -> Trace:
    """Read a trace.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    return parse(read_bytes(path), str(path))


def parse(data: bytes, name: str) -> Trace:
    """Read the text of a trace; `name` is for the sentences."""
    is_xml = data.replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n").startswith(b"<")
    points = list(_gpx(data, name) if is_xml else _geojson(data, name))
    usable = [point for point in points if _is_place(point)]
    notes = _left_out(len(points) - len(usable), "have no place on Earth")
    if len(usable) < 2:
        raise ConfigError(f"{name}: has {len(usable) or 'no'} usable points; a trace needs two")
    timed = any(point.stamp_ns is not None for point in usable)
    if timed:
        usable, more = _in_order(usable)
        notes += more
        if len(usable) < 2:
            raise ConfigError(f"{name}: its points have no times one after the other; correct them")
    else:
        notes += ("The trace has no times: its points are taken as 1 s apart.",)
    stamps = [
        index * _UNTIMED_NS if point.stamp_ns is None else point.stamp_ns
        for index, point in enumerate(usable)
    ]
    return Trace(
        name,
        np.array(stamps, dtype=np.int64),
        np.radians([point.latitude_deg for point in usable]),
        np.radians([point.longitude_deg for point in usable]),
        np.array([point.accuracy_m for point in usable]),
        timed,
        notes,
    )


def _is_place(point: _Point) -> bool:
    return abs(point.latitude_deg) <= 90.0 and abs(point.longitude_deg) <= 180.0  # NaN is none


def _in_order(points: list[_Point]) -> tuple[list[_Point], tuple[str, ...]]:
    """Points that have a time, each later than the one before."""
    kept: list[_Point] = []
    untimed = late = 0
    last_ns = -math.inf
    for point in points:
        if point.stamp_ns is None:
            untimed += 1
        elif point.stamp_ns <= last_ns:
            late += 1
        else:
            last_ns = point.stamp_ns
            kept.append(point)
    notes = _left_out(untimed, "have no time")
    return kept, notes + _left_out(late, "are no later than the point before them")


def _left_out(count: int, why: str) -> tuple[str, ...]:
    return (f"Left out: {count} points that {why}.",) if count else ()


# GPX ----------------------------------------------------------------------------------------------
def _gpx(data: bytes, name: str) -> Iterator[_Point]:
    # No GPX has a document type; entities that blow up need one.
    if b"<!doctype" in data.replace(b"\0", b"").lower():
        raise ConfigError(f"{name}: has a document type declaration, which no GPX needs; remove it")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ConfigError(f"{name}: is no XML: {error}") from error
    if _local(root) != "gpx":
        raise ConfigError(f"{name}: is XML, but no GPX")
    elements = list(root.iter())
    points = [each for each in elements if _local(each) == "trkpt"]
    points = points or [each for each in elements if _local(each) == "rtept"]
    if not points:
        raise ConfigError(f"{name}: has no track and no route points")
    for point in points:
        found = {_local(each): (each.text or "").strip() for each in point.iter()}
        stated = next((found[key] for key in _ACCURACY if found.get(key)), "")
        hdop = found.get("hdop", "")
        yield _Point(
            _number(point.get("lat")),
            _number(point.get("lon")),
            _stamp_ns(found.get("time")),
            _accuracy(_number(stated) if stated else HDOP_M * _number(hdop)),
        )


def _local(element: ElementTree.Element) -> str:
    """Name without namespace and case."""
    return str(element.tag).rpartition("}")[2].lower()


# GeoJSON ------------------------------------------------------------------------------------------
def _geojson(data: bytes, name: str) -> Iterator[_Point]:
    try:
        document = parse_json(data)
    except ValueError as error:
        raise ConfigError(f"{name}: is neither GPX nor GeoJSON: {error}") from error
    found = False
    for feature in _features(document):
        geometry, properties = _object(feature.get("geometry")), _object(feature.get("properties"))
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        chains: list[tuple[Any, Any]] = []
        if kind == "Point":
            chains = [([coordinates], [properties.get("time", properties.get("timestamp"))])]
        elif kind == "LineString":
            chains = [(coordinates, _times(properties))]
        elif kind == "MultiLineString" and isinstance(coordinates, list):
            times = _times(properties)
            chains = list(zip(coordinates, times or [None] * len(coordinates), strict=False))
        small = {str(key).lower(): value for key, value in properties.items()}
        accuracy = next((small[key] for key in _ACCURACY if key in small), None)
        accuracy_m = _accuracy(
            _number(accuracy) if accuracy is not None else HDOP_M * _number(small.get("hdop"))
        )
        for rows, stamps in chains:
            found = True
            yield from _rows(rows, stamps, accuracy_m)
    if not found:
        raise ConfigError(f"{name}: has neither LineStrings nor Points")


def _features(document: Any) -> list[dict[str, Any]]:
    """Features of a collection, of a single feature, of a bare geometry."""
    if not isinstance(document, dict):
        return []
    if document.get("type") == "FeatureCollection":
        features = document.get("features")
        return (
            [each for each in features if isinstance(each, dict)]
            if isinstance(features, list)
            else []
        )
    return [document if document.get("type") == "Feature" else {"geometry": document}]


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _times(properties: dict[str, Any]) -> list[Any]:
    """Times of the coordinates, as the usual converters write them."""
    nested = _object(properties.get("coordinateProperties"))
    for source in (properties, nested):
        for key in _TIMES:
            if isinstance(source.get(key), list):
                return list(source[key])
    return []


def _rows(rows: Any, stamps: Any, accuracy_m: float) -> Iterator[_Point]:
    rows = rows if isinstance(rows, list) else []
    times: Iterable[Any] = stamps if isinstance(stamps, list) else []
    padded = [*times, *[None] * len(rows)]
    for row, time in zip(rows, padded, strict=False):
        pair = row[:2] if isinstance(row, list) and len(row) >= 2 else (None, None)
        yield _Point(_number(pair[1]), _number(pair[0]), _stamp_ns(time), accuracy_m)


# Values -------------------------------------------------------------------------------------------
def _number(value: Any) -> float:
    """A number; NaN for what is none."""
    try:
        return float(value) if not isinstance(value, bool) else math.nan
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _accuracy(value_m: float) -> float:
    """An accuracy; NaN for what can be none."""
    return value_m if 0.0 < value_m < math.inf else math.nan


def _stamp_ns(value: Any) -> int | None:
    """Nanoseconds since 1970 of an ISO time (UTC where it names no zone) or a number."""
    number = _number(value)
    if math.isfinite(number):
        # Before it is multiplied: what is farther off than that has no nanoseconds.
        number = min(max(number, -1.0), 1e16)
        stamp_ns = round(number * 1e6) if number > _MILLISECONDS else round(number * 1e9)
    else:
        try:
            instant = datetime.fromisoformat(str(value).strip())
        except ValueError:
            return None
        instant = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
        since = instant - datetime(1970, 1, 1, tzinfo=UTC)
        stamp_ns = (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
    return stamp_ns if 0 <= stamp_ns <= _LATEST_NS else None
