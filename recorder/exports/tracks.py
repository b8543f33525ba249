"""Positions of a record as GPX 1.1 (phones, JOSM) and KML 2.2 (Google Earth)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from xml.sax.saxutils import escape

from tramstream.clock import S
from tramstream.recorder.exports.places import Place, lines, positions
from tramstream.recorder.exports.window import WHOLE, Window
from tramstream.recorder.reader import Record

_CONTROL = {code: None for code in range(32) if code not in (9, 10, 13)}
"""XML 1.0 has no place for these, not even escaped."""


def gpx(record: Record, window: Window = WHOLE) -> str:
    """A track a key, with a segment for each stretch without gaps.

    Heights are above the ellipsoid, as GPX leaves open; times are the vehicle clock's as UTC.
    """
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<gpx version="1.1" creator="tramstream" xmlns="http://www.topografix.com/GPX/1/1">\n'
    ]
    for topic, places in positions(record, window).items():
        parts.append(f"<trk><name>{_text(topic)}</name>\n")
        for line in lines(places):
            parts.append("<trkseg>\n")
            parts += [_point(place) for place in line]
            parts.append("</trkseg>\n")
        parts.append("</trk>\n")
    return "".join([*parts, "</gpx>\n"])


def _point(place: Place) -> str:
    height = f"<ele>{place.height_m:.3f}</ele>" if math.isfinite(place.height_m) else ""
    where = f'lat="{place.latitude_deg:.9f}" lon="{place.longitude_deg:.9f}"'
    return f"<trkpt {where}>{height}<time>{_utc(place.stamp_ns)}</time></trkpt>\n"


def kml(record: Record, window: Window = WHOLE) -> str:
    """A folder a key with its lines, laid on the ground."""
    body = "".join(
        f"<Folder><name>{_text(topic)}</name>\n{''.join(_placemarks(places))}</Folder>\n"
        for topic, places in positions(record, window).items()
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">'
        f"<Document>\n<name>{_text(record.vehicle)}</name>\n{body}</Document></kml>\n"
    )


def _placemarks(places: list[Place]) -> Iterator[str]:
    for line in lines(places):
        span = (
            f"<TimeSpan><begin>{_utc(line[0].stamp_ns)}</begin>"
            f"<end>{_utc(line[-1].stamp_ns)}</end></TimeSpan>"
        )
        corners = " ".join(f"{each.longitude_deg:.9f},{each.latitude_deg:.9f}" for each in line)
        yield (
            f"<Placemark>{span}<LineString><tessellate>1</tessellate>"
            f"<coordinates>{corners}</coordinates></LineString></Placemark>\n"
        )


def _utc(stamp_ns: int) -> str:
    seconds = datetime.fromtimestamp(stamp_ns // S, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{seconds}.{stamp_ns % S // 1_000_000:03d}Z"


def _text(name: str) -> str:
    """A name as it may stand in XML."""
    return escape(name.translate(_CONTROL))
