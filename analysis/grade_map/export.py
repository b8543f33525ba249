"""A grade map for others: GeoJSON, OSM with `incline`, railML with gradients in per mille.

OSM and railML know stretches of one slope. A track is cut into those with as few as keep every cell
within `TOLERANCE` of its stretch's mean.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, NamedTuple
from xml.etree import ElementTree as Xml

import numpy as np

from tramstream.analysis.grade_map.assemble import GradeMap
from tramstream.analysis.grade_map.summary import percent, std_percent

TOLERANCE = 0.25
"""%, of a stretch of one slope."""
SIGMAS = 3.0
"""A cell that is off by less than so many of its deviations is no reason to cut."""
RAILML = "https://www.railml.org/schemas/2013"


class Stretch(NamedTuple):
    """Cells of one track that follow each other, with one slope."""

    first: int
    last: int
    """Rows of the map, the last one included."""
    grade_percent: float
    """Uphill positive along the track as drawn."""


def geojson(made: GradeMap) -> str:
    """One line a cell, with all that is known of it."""
    return json.dumps(
        {"type": "FeatureCollection", "features": list(_features(made))},
        ensure_ascii=False,
        allow_nan=False,
    )


def _features(made: GradeMap) -> Iterator[dict[str, Any]]:
    columns = made.columns
    grade = percent(columns["grade_rad"])
    std = std_percent(columns["grade_rad"], columns["grade_std_rad"])
    for row in np.flatnonzero(np.isfinite(grade)).tolist():
        properties = {
            "track": made.track[row],
            "from_m": round(float(columns["from_m"][row]), 2),
            "to_m": round(float(columns["to_m"][row]), 2),
            "grade_percent": round(float(grade[row]), 4),
            "grade_std_percent": round(float(std[row]), 4),
            "height_ellipsoid_m": _number(columns["height_ellipsoid_m"][row]),
            "height_std_m": _number(columns["height_std_m"][row]),
            "rides": int(columns["rides"][row]),
            "chi2": round(float(columns["chi2"][row]), 3),
        }
        ends = [
            [
                round(float(columns[f"{end}_longitude_deg"][row]), 8),
                round(float(columns[f"{end}_latitude_deg"][row]), 8),
            ]
            for end in ("from", "to")
        ]
        yield {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": ends},
            "properties": properties,
        }


def _number(value: Any) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def osm(made: GradeMap) -> str:
    """OSM XML of new ways with `incline`, each with the map's way that it lies on.

    Not for upload as it is: an editor merges tags of these ways into those that are there.
    """
    columns = made.columns
    root = Xml.Element("osm", version="0.6", generator="tramstream", upload="false")
    nodes: dict[tuple[str, str], int] = {}
    ways = []
    for number, part in enumerate(stretches(made, by_way=True), 1):
        way = Xml.Element("way", id=str(-number), version="1", visible="true")
        rows = range(part.first, part.last + 1)
        ends = [(row, "from") for row in rows] + [(part.last, "to")]
        for row, end in ends:
            place = (
                f"{columns[f'{end}_latitude_deg'][row]:.7f}",
                f"{columns[f'{end}_longitude_deg'][row]:.7f}",
            )
            Xml.SubElement(way, "nd", ref=str(-nodes.setdefault(place, len(nodes) + 1)))
        tags = {
            "railway": "tram",
            "incline": f"{part.grade_percent:.1f}%",
            "incline:accuracy": f"{_std(made, part):.2f}%",
            "source:incline": "tramstream grade-map",
        }
        if columns["osm_way"][part.first]:
            tags["tramstream:way"] = str(int(columns["osm_way"][part.first]))
        for key, value in tags.items():
            Xml.SubElement(way, "tag", k=key, v=value)
        ways.append(way)
    for (latitude, longitude), number in nodes.items():
        Xml.SubElement(root, "node", id=str(-number), version="1", lat=latitude, lon=longitude)
    root.extend(ways)
    return _text(root)


def railml(made: GradeMap) -> str:
    """railML 2.2: tracks with their gradient changes, slopes in per mille along the track."""
    columns = made.columns
    root = Xml.Element("railml", xmlns=RAILML, version="2.2")
    metadata = Xml.SubElement(root, "metadata")
    latest = int(columns["last_utc_ns"].max(initial=0))
    if latest:
        day = datetime.fromtimestamp(latest / 1e9, UTC)
        Xml.SubElement(metadata, "source").text = f"rides until {day:%Y-%m-%d}"
    tracks = Xml.SubElement(Xml.SubElement(root, "infrastructure", id="grades"), "tracks")
    found: dict[int, list[Stretch]] = {}
    for part in stretches(made):
        found.setdefault(int(columns["track_number"][part.first]), []).append(part)
    for number, parts in found.items():
        name = made.track[parts[0].first]
        track = Xml.SubElement(tracks, "track", id=f"t{number}", name=name)
        topology = Xml.SubElement(track, "trackTopology")
        Xml.SubElement(topology, "trackBegin", id=f"t{number}b", pos="0.000")
        end = float(columns["to_m"][parts[-1].last])
        Xml.SubElement(topology, "trackEnd", id=f"t{number}e", pos=f"{end:.3f}")
        changes = Xml.SubElement(Xml.SubElement(track, "trackElements"), "gradientChanges")
        for k, part in enumerate(parts):
            Xml.SubElement(
                changes,
                "gradientChange",
                id=f"t{number}g{k}",
                pos=f"{columns['from_m'][part.first]:.3f}",
                slope=f"{10 * part.grade_percent:.2f}",
            )
    return _text(root)


def _text(root: Xml.Element) -> str:
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _std(made: GradeMap, part: Stretch) -> float:
    """Deviation of a stretch's slope, %: its cells' errors are much the same one."""
    rows = slice(part.first, part.last + 1)
    std = std_percent(made.columns["grade_rad"][rows], made.columns["grade_std_rad"][rows])
    return float(np.mean(std))


# Stretches ----------------------------------------------------------------------------------------
def stretches(made: GradeMap, by_way: bool = False) -> list[Stretch]:
    """Cut all tracks; `by_way` also where another way of the map begins."""
    columns = made.columns
    grade = percent(columns["grade_rad"])
    std = std_percent(columns["grade_rad"], columns["grade_std_rad"])
    found: list[Stretch] = []
    first = -1
    low, high = -np.inf, np.inf
    for row in range(len(made)):
        if not np.isfinite(grade[row]):
            first = _close(found, grade, first, row)
            continue
        reach = max(TOLERANCE, SIGMAS * float(std[row]))
        if first >= 0 and (
            _parts(columns, row, by_way)
            or max(low, grade[row] - reach) > min(high, grade[row] + reach)
        ):
            first = _close(found, grade, first, row)
        if first < 0:
            first, low, high = row, -np.inf, np.inf
        low, high = max(low, grade[row] - reach), min(high, grade[row] + reach)
    _close(found, grade, first, len(made))
    return found


def _parts(columns: dict[str, Any], row: int, by_way: bool) -> bool:
    """Whether a row does not go on where the one before it ends."""
    same = columns["track_number"][row] == columns["track_number"][row - 1]
    follows = columns["cell"][row] == columns["cell"][row - 1] + 1
    one_way = columns["osm_way"][row] == columns["osm_way"][row - 1]
    return not (same and follows and (one_way or not by_way))


def _close(found: list[Stretch], grade: Any, first: int, row: int) -> int:
    """Keep the stretch that ends before `row`, if there is one."""
    if first >= 0:
        found.append(Stretch(first, row - 1, float(np.mean(grade[first:row]))))
    return -1
