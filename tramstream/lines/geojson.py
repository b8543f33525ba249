"""A line from a GeoJSON file: `FILE.geojson`, `FILE.geojson#7` or `FILE.geojson#7/0`.

Any LineString will do. What follows the # chooses among several: property `line` (also `ref` or
`name`), then `direction`. Stops come from property `stops`, [[name, chainage in m], …], or from
Point features within `STOP_NEAR_M` of the track, else there is one at either end. Heights above the
geoid come from property `srtm3_m`, one a node, else from the third coordinate (above the ellipsoid,
RFC 7946), else the track is level. Terrain is not track: heights are smoothed until no grade is
steeper than `GRADE_MAX`. Where a track doubles back on itself the vehicle would change direction;
the line is the longest part without that.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.geodesy import PRAGUE_GEOID_M, LocalLevel
from tramstream.input_file import parse_json, read_bytes
from tramstream.lines import fit as line_fit
from tramstream.lines.fit import Course, fit
from tramstream.lines.line import Line, Relief, usual_cant
from tramstream.lines.profile import Profile

Array = NDArray[np.float64]

STOP_NEAR_M = 30.0
GRADE_MAX = 0.08
_REVERSAL_RAD = 2.0
"""No tram turns by so much at a node."""
_SAME_M = 0.05
"""Nodes closer than that are one."""
_SHORTEST_M = 50.0
_LONGEST_M = 200_000.0
"""The longest tramway of the world has 68 km; a fit across a continent takes all memory."""
_HIGHEST_M = 10_000.0
_HEIGHT_STEP_M = 10.0
_SMOOTH_M = 60.0
"""Deviation of the Gaussian that smooths heights; SRTM3 has a pixel every 90 m."""
_ROUNDS_MAX = 500
"""Where it is still too steep, heights are smoothed again; a wall would take for ever."""
_GRADE_KNOT_M = 20.0
_STOPS_APART_M = 20.0


@dataclass(frozen=True)
class Track:
    """One LineString as a map has it."""

    name: str
    geodetic: Array
    """Latitude, longitude, ellipsoidal height of the nodes; rad, rad, m."""
    stops_m: list[float] | None
    """Chainages, None if the map has no stops."""
    length_m: float | None
    """By whose chainages; None: the length of the nodes' chain."""


class Laid(NamedTuple):
    """A line, and where beside the map's chain of nodes its points lie."""

    line: Line
    arc_length_m: Array
    """Of points of the line, and"""
    chainage_m: Array
    """the chainage beside them, as the track counts it."""


def load(source: str, geoid_m: float = PRAGUE_GEOID_M) -> Line:
    """Read a track and lay a line along it; see `read`."""
    return lay(read(source, geoid_m))


def read(source: str, geoid_m: float = PRAGUE_GEOID_M) -> Track:
    """Read one track of a map.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it, or how to choose among its lines.
    """
    name, _, chosen = source.partition("#")
    try:
        document = parse_json(read_bytes(Path(name)))
    except ValueError as error:
        raise ConfigError(f"{name}: is no GeoJSON: {error}") from error
    return track(document, name, chosen, geoid_m)


def track(document: Any, name: str, chosen: str = "", geoid_m: float = PRAGUE_GEOID_M) -> Track:
    """Pick one LineString of a GeoJSON document; see `read`."""
    features = _features(document)
    lines = [each for each in features if _geometry(each).get("type") == "LineString"]
    if not lines:
        raise ConfigError(f"{name}: has no LineString")
    fitting = [each for each in lines if _is_chosen(each, chosen)] if chosen else lines
    if len(fitting) != 1:
        choices = ", ".join(_label(each) or "(unnamed)" for each in lines)
        raise ConfigError(
            f"{name}: has {len(fitting) or 'no'} lines{f' {chosen!r}' if chosen else ''}; choose "
            f"one with {name}#LINE/DIRECTION out of: {choices}"
        )
    feature = fitting[0]
    properties = feature.get("properties") or {}
    label = _label(feature) or name
    geodetic = _geodetic(_geometry(feature), properties, f"{name}: line {label}", geoid_m)
    stops = properties.get("stops")
    stops_m = None
    if isinstance(stops, list):
        try:
            stops_m = [float(stop[1]) for stop in stops]
            if not all(abs(each) <= _LONGEST_M for each in stops_m):  # NaN is not
                raise ValueError
        except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
            raise ConfigError(
                f"{name}: line {label}: property stops must read [[name, chainage], …]"
            ) from error
    if not stops_m:
        stops_m = _points_beside(features, geodetic)
    length_m = properties.get("length_m")
    if length_m is not None and not _is_length(length_m):
        raise ConfigError(f"{name}: line {label}: property length_m must be a length, m")
    return Track(label, geodetic, stops_m, None if length_m is None else float(length_m))


def lay(mapped: Track) -> Line:
    """Lay a smooth line along a mapped track."""
    return lay_beside(mapped).line


def lay_beside(mapped: Track) -> Laid:
    """Lay a smooth line along a mapped track, and tell which point is beside which."""
    middle, ends = mapped.geodetic[len(mapped.geodetic) // 2], mapped.geodetic[:, 2]
    level = LocalLevel(float(middle[0]), float(middle[1]), float(np.mean(ends)))
    p_l = level.from_geodetic(mapped.geodetic)
    points = p_l[:, :2]
    chainage = _chainage(points)
    scale = 1.0 if mapped.length_m is None else chainage[-1] / mapped.length_m
    part = _longest_part(points)
    points, begin_m = points[part], chainage[part][0]
    chainage = chainage[part] - begin_m
    if chainage[-1] < _SHORTEST_M:
        raise ConfigError(f"line {mapped.name}: is only {chainage[-1]:.0f} m long")
    slope, up = _slope(chainage, p_l[part, 2], mapped.geodetic[part, 2] - level.height_m)
    grade = _along_arc(slope, fit(points, Profile.level())) if not slope.flat else slope
    course = fit(points, grade)
    ends_m = [0.0, float(chainage[-1])]
    stops_m = [stop * scale - begin_m for stop in mapped.stops_m] if mapped.stops_m else ends_m
    line = Line(
        course.segments,
        _stops(stops_m, course),
        level,
        course.yaw_start_rad,
        (*course.start, up),
        Relief(grade, usual_cant(course.segments)),
    )
    return Laid(line, course.arc_length_m, (course.chainage_m + begin_m) / scale)


def slope(mapped: Track) -> Profile:
    """Slope angle of a mapped track against its chainage in plan, as `lay` has it, from its first
    node to its last; nothing is fitted, and the Earth is flat."""
    heights = mapped.geodetic[:, 2]
    return _slope(chainage_m(mapped), heights, heights)[0]


def chainage_m(mapped: Track) -> Array:
    """Of the nodes of a mapped track, along their chain in plan."""
    level = LocalLevel(*(float(number) for number in mapped.geodetic[0]))
    return _chainage(level.from_geodetic(mapped.geodetic)[:, :2])


def deviation_m(mapped: Track, line: Line) -> float:
    """Largest distance of the line, looked at every metre, from the map's edges in plan."""
    points = line.level.from_geodetic(mapped.geodetic)[:, :2]
    points = points[_longest_part(points)]
    count = int(line.length_m) + 2
    return line_fit.deviation_m(
        points, line.position_l(np.linspace(0, line.length_m, count))[:, :2]
    )


# Reading ------------------------------------------------------------------------------------------
def _features(document: Any) -> list[dict[str, Any]]:
    """Features of a collection, of a single feature, of a bare geometry."""
    if not isinstance(document, dict):
        return []
    if document.get("type") == "FeatureCollection":
        features = document.get("features")
        return [each for each in features if isinstance(each, dict)] if features else []
    if document.get("type") == "Feature":
        return [document]
    return [{"type": "Feature", "geometry": document}]


def _geometry(feature: dict[str, Any]) -> dict[str, Any]:
    geometry = feature.get("geometry")
    return geometry if isinstance(geometry, dict) else {}


def _names(feature: dict[str, Any]) -> list[str]:
    """What a feature may be called by: its line, and its line and direction."""
    properties = feature.get("properties") or {}
    names = [str(properties[key]) for key in ("line", "ref", "name") if properties.get(key)]
    if "direction" in properties:
        names = [f"{name}/{properties['direction']}" for name in names] + names
    return names


def _is_chosen(feature: dict[str, Any], chosen: str) -> bool:
    return chosen in _names(feature)


def _label(feature: dict[str, Any]) -> str:
    names = _names(feature)
    return names[0] if names else ""


def _geodetic(
    geometry: dict[str, Any], properties: dict[str, Any], where: str, geoid_m: float
) -> Array:
    """Nodes as latitude, longitude, ellipsoidal height; neighbours that are one are joined."""
    try:
        rows = [[float(number) for number in row] for row in geometry["coordinates"]]
        degrees = np.array([row[:2] for row in rows])
        if degrees.ndim != 2 or degrees.shape[1] != 2 or not np.all(np.isfinite(degrees)):
            raise ValueError
    except (TypeError, ValueError, KeyError) as error:
        raise ConfigError(f"{where}: coordinates must read [[longitude, latitude], …]") from error
    if np.any(np.abs(degrees) > [180.0, 90.0]):
        raise ConfigError(f"{where}: coordinates must be longitude and latitude in degrees")
    height = np.full(len(rows), geoid_m)
    heights = properties.get("srtm3_m")
    if heights is not None:
        try:
            height = np.array([float(each) for each in heights]) + geoid_m
        except (TypeError, ValueError):
            height = np.full(1, np.nan)
        if len(height) != len(rows) or not np.all(np.isfinite(height)):
            raise ConfigError(f"{where}: property srtm3_m must hold one height for each node")
    elif rows and all(len(row) > 2 for row in rows):
        height = np.array([row[2] for row in rows])
    geodetic = np.column_stack([np.radians(degrees[:, ::-1]), height])
    if len(geodetic) == 0:
        raise ConfigError(f"{where}: has no coordinates")
    if not np.all(np.abs(height) <= _HIGHEST_M):
        raise ConfigError(f"{where}: heights must be within {_HIGHEST_M:.0f} m")
    level = LocalLevel(float(geodetic[0, 0]), float(geodetic[0, 1]), float(height[0]))
    plan = level.from_geodetic(geodetic)[:, :2]
    kept = [0]
    for index in range(1, len(plan)):
        if np.hypot(*(plan[index] - plan[kept[-1]])) > _SAME_M:
            kept.append(index)
    if len(kept) < 2:
        raise ConfigError(f"{where}: needs two nodes at least")
    if not np.hypot(*np.diff(plan[kept], axis=0).T).sum() <= _LONGEST_M:
        raise ConfigError(
            f"{where}: is longer than {_LONGEST_M / 1000:.0f} km; are its nodes right?"
        )
    return geodetic[kept]


def _is_length(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return bool(number and _SAME_M <= value <= _LONGEST_M)


def _points_beside(features: list[dict[str, Any]], geodetic: Array) -> list[float]:
    """Chainages of the Point features near a chain of nodes."""
    level = LocalLevel(*(float(number) for number in geodetic[0]))
    plan = level.from_geodetic(geodetic)[:, :2]
    chainage, edges = _chainage(plan), np.diff(plan, axis=0)
    found = []
    for feature in features:
        geometry = _geometry(feature)
        if geometry.get("type") != "Point":
            continue
        try:
            longitude_deg, latitude_deg = (float(each) for each in geometry["coordinates"][:2])
            if not (abs(longitude_deg) <= 360.0 and abs(latitude_deg) <= 90.0):
                continue
        except (KeyError, TypeError, ValueError):
            continue  # a point of nowhere is beside no line
        point = level.from_geodetic(
            [np.radians(latitude_deg), np.radians(longitude_deg), level.height_m]
        )[:2]
        squares = np.sum(edges**2, axis=1)
        share = np.clip(np.sum((point - plan[:-1]) * edges, axis=1) / squares, 0, 1)
        away = np.hypot(*(plan[:-1] + share[:, None] * edges - point).T)
        nearest = int(np.argmin(away))
        if away[nearest] <= STOP_NEAR_M:
            found.append(float(chainage[nearest] + share[nearest] * np.sqrt(squares[nearest])))
    return sorted(found)


# Laying -------------------------------------------------------------------------------------------
def _chainage(plan: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(plan, axis=0).T))])


def _longest_part(plan: Array) -> slice:
    """Nodes of the longest part on which the track does not double back."""
    yaw = np.arctan2(*np.diff(plan, axis=0).T[::-1])
    turn = np.abs(np.angle(np.exp(1j * np.diff(yaw))))
    cuts = [0, *(np.flatnonzero(turn > _REVERSAL_RAD) + 1).tolist(), len(plan) - 1]
    chainage = _chainage(plan)
    begin, end = max(pairwise(cuts), key=lambda c: chainage[c[1]] - chainage[c[0]])
    return slice(begin, end + 1)


def _slope(chainage: Array, up: Array, heights: Array) -> tuple[Profile, float]:
    """Slope angle in `l` against chainage, smooth and nowhere too steep, and up at its start.

    Heights are smoothed. What is left of `up` without them is the Earth's curvature, which is as
    smooth as it is.
    """
    count = max(round(chainage[-1] / _HEIGHT_STEP_M), 2)
    at = np.linspace(0.0, chainage[-1], count + 1)
    step_m = at[1]
    fall = np.interp(at, chainage, up - heights)
    smooth = _smoothed(np.interp(at, chainage, heights), step_m)
    for _ in range(_ROUNDS_MAX):
        grade = np.gradient(smooth, at)
        steep = np.abs(grade) > GRADE_MAX
        if not np.any(steep):
            break
        around = np.clip(2 * _smoothed(steep.astype(float), step_m), 0, 1)
        smooth = smooth + around * (_smoothed(smooth, step_m) - smooth)
    grade = np.clip(np.gradient(smooth, at), -GRADE_MAX, GRADE_MAX) + np.gradient(fall, at)
    knots = np.linspace(0.0, chainage[-1], max(round(chainage[-1] / _GRADE_KNOT_M), 2) + 1)
    return Profile.through(knots, np.arctan(np.interp(knots, at, grade))), float(
        smooth[0] + fall[0]
    )


def _smoothed(values: Array, step_m: float) -> Array:
    """Mean weighted by a Gaussian of `_SMOOTH_M`; the end values go on beyond the ends."""
    reach = round(4 * _SMOOTH_M / step_m)
    weights = np.exp(-((np.arange(-reach, reach + 1) * step_m / _SMOOTH_M) ** 2) / 2)
    smooth: Array = np.convolve(
        np.pad(values, reach, mode="edge"), weights / weights.sum(), "valid"
    )
    return smooth


def _along_arc(slope: Profile, level_course: Course) -> Profile:
    """Turn slope against chainage into slope against the way along the rail.

    `level_course` is the same line laid without slopes: its arc length is the plan's.
    """
    plan_m, chainage = level_course.arc_length_m, level_course.chainage_m
    stretch = 1 / np.cos(slope(chainage))
    steps = np.diff(plan_m) * (stretch[1:] + stretch[:-1]) / 2
    arc_length = np.concatenate([[0.0], np.cumsum(steps)])
    return Profile.through(np.interp(slope.knots_m, chainage, arc_length), slope.values)


def _stops(stops_m: list[float], course: Course) -> list[float]:
    """Arc lengths of stops from their chainages, in order, none twice."""
    end_m = sum(segment.length_m for segment in course.segments)
    placed = np.interp(sorted(stops_m), course.chainage_m, course.arc_length_m)
    stops: list[float] = []
    for stop in np.clip(placed, 0.0, end_m).tolist():
        if not stops or stop - stops[-1] > _STOPS_APART_M:
            stops.append(stop)
    return stops if len(stops) > 1 else [0.0, end_m]
