"""What a map says of rails: ways, the nodes they run through, stops, switches and tram routes.

One `Extract` comes from any number of files, each of one of these kinds:

- Overpass JSON (`out geom`, or ways with separate node elements);
- OpenStreetMap's own `.osm`, `.osm.gz`, `.osm.bz2`, `.osm.pbf` (`osm_file`, read with osmium);
- GeoJSON LineStrings; their properties are tags. Nodes are where coordinates coincide to 1e-7 deg,
  and have negative numbers.

Only rails of trams are kept (`RAILS`), and nodes that matter to a tram. What is missing from a way
is an error; what is missing from a route is noted, since routes leave every extract's border.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite, radians
from pathlib import Path
from typing import Any, NamedTuple

from tramstream.errors import ConfigError
from tramstream.input_file import parse_json, read_bytes

RAILS = ("tram", "light_rail")
"""Values of tag `railway` that make a way a track."""
ROUTES = ("tram", "light_rail")
"""Values of tag `route` that make a relation a line."""
NODES = (
    "tram_stop",
    "stop",
    "halt",
    "switch",
    "crossing",
    "tram_crossing",
    "level_crossing",
    "tram_level_crossing",
    "railway_crossing",
    "buffer_stop",
)
"""Values of tag `railway` that make a node matter."""
_PER_DEGREE = 10_000_000
"""OpenStreetMap's own resolution; GeoJSON's coordinates are rounded to it."""


class OsmWay(NamedTuple):
    """A way as the map draws it."""

    osm_id: int
    nodes: tuple[int, ...]
    tags: dict[str, str]


class Member(NamedTuple):
    """A member of a relation."""

    kind: str
    """"node", "way" or "relation"."""
    osm_id: int
    role: str


class OsmRoute(NamedTuple):
    """A relation of type route, members in the map's order."""

    osm_id: int
    members: tuple[Member, ...]
    tags: dict[str, str]


@dataclass
class Extract:
    """Rails of a map. Filled by the readers, then only looked at."""

    ways: dict[int, OsmWay] = field(default_factory=dict)
    """By number, in the order of the files."""
    places: dict[int, tuple[float, float]] = field(default_factory=dict)
    """Latitude, longitude, rad, of nodes on ways and of nodes that matter, by number."""
    node_tags: dict[int, dict[str, str]] = field(default_factory=dict)
    """Of nodes that matter: stops, switches, crossings, ends of track."""
    routes: dict[int, OsmRoute] = field(default_factory=dict)
    """Relations type=route of trams, by number."""
    sources: list[str] = field(default_factory=list)
    """Each file with the map's own date, if it has one."""

    @property
    def stops(self) -> dict[int, dict[str, str]]:
        """Tags of the nodes where trams stop, by number."""
        return {node: tags for node, tags in self.node_tags.items() if is_stop(tags)}

    @property
    def switches(self) -> set[int]:
        """Nodes that the map calls a switch."""
        return {node for node, tags in self.node_tags.items() if tags.get("railway") == "switch"}

    def missing_members(self) -> list[tuple[int, int, int]]:
        """Number of each route that lacks ways, how many, and one of them."""
        found = []
        for route in self.routes.values():
            missing = [
                member.osm_id
                for member in route.members
                if member.kind == "way"
                and not member.role.startswith(("platform", "stop"))
                and member.osm_id not in self.ways
            ]
            if missing:
                found.append((route.osm_id, len(missing), missing[0]))
        return found


def is_stop(tags: Mapping[str, str]) -> bool:
    """Whether a node's tags say that trams stop on the rails there."""
    if tags.get("railway") in ("tram_stop", "stop", "halt"):
        return tags.get("public_transport") != "platform"
    tram = tags.get("tram") == "yes" or tags.get("light_rail") == "yes"
    return tags.get("public_transport") == "stop_position" and tram


def read_json(path: Path, extract: Extract) -> None:
    try:
        document = parse_json(read_bytes(path))
    except ValueError as error:
        raise ConfigError(f"{path}: is no JSON: {error}") from error
    elements = document.get("elements") if isinstance(document, dict) else None
    if isinstance(elements, list):
        _overpass(document, path, extract)
    elif isinstance(document, dict) and "type" in document:
        _geojson(document, path, extract)
    else:
        raise ConfigError(f"{path}: is neither an answer of Overpass nor GeoJSON")


# Overpass -----------------------------------------------------------------------------------------
def _overpass(document: dict[str, Any], path: Path, extract: Extract) -> None:
    date = (document.get("osm3s") or {}).get("timestamp_osm_base", "")
    extract.sources.append(f"{path.name} (OpenStreetMap{f' of {date}' if date else ''}, ODbL)")
    if str(document.get("remark", "")).startswith("runtime error"):
        raise ConfigError(f"{path}: Overpass broke off: {document['remark']}; ask it again")
    for element in document["elements"]:
        where = f"{path}: element"
        try:
            kind, osm_id = str(element["type"]), int(element["id"])
            where = f"{path}: {kind} {osm_id}"
            tags = {str(key): str(value) for key, value in (element.get("tags") or {}).items()}
            if kind == "node":
                place(extract, osm_id, float(element["lat"]), float(element["lon"]), where)
                keep_node(extract, osm_id, tags)
            elif kind == "way" and tags.get("railway") in RAILS:
                _overpass_way(element, tags, where, extract)
            elif kind == "relation" and is_route(tags):
                members = tuple(
                    Member(str(each["type"]), int(each["ref"]), str(each.get("role", "")))
                    for each in element.get("members", ())
                )
                extract.routes[osm_id] = OsmRoute(osm_id, members, tags)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise ConfigError(
                f"{where}: is not as Overpass writes it ({type(error).__name__}: {error})"
            ) from error


def _overpass_way(
    element: dict[str, Any], tags: dict[str, str], where: str, extract: Extract
) -> None:
    if "nodes" not in element:
        raise ConfigError(f"{where}: has no nodes; ask Overpass for `out geom`, not `out tags`")
    nodes = tuple(int(node) for node in element["nodes"])
    geometry = element.get("geometry")
    if geometry is not None:
        if len(geometry) != len(nodes):
            raise ConfigError(f"{where}: has {len(nodes)} nodes but {len(geometry)} coordinates")
        for node, point in zip(nodes, geometry, strict=True):
            if point is not None:  # Overpass leaves out what lies outside the box asked for
                place(extract, node, float(point["lat"]), float(point["lon"]), where)
    keep_way(extract, OsmWay(int(element["id"]), nodes, tags), where)


# GeoJSON ------------------------------------------------------------------------------------------
def _geojson(document: dict[str, Any], path: Path, extract: Extract) -> None:
    extract.sources.append(path.name)
    if document["type"] == "FeatureCollection":
        features = document.get("features") or []
    else:
        features = [document if document["type"] == "Feature" else {"geometry": document}]
    for number, feature in enumerate(features):
        where = f"{path}: feature {number}"
        try:
            geometry = feature.get("geometry") or {}
            tags = _tags(feature.get("properties") or {})
            kind = geometry.get("type")
            coordinates: Any = geometry.get("coordinates")
            if kind == "Point":
                node = _node_at(extract, coordinates, where)
                keep_node(extract, node, tags)
            elif kind in ("LineString", "MultiLineString"):
                if tags.setdefault("railway", "tram") not in RAILS:
                    continue
                for chain in [coordinates] if kind == "LineString" else coordinates:
                    nodes = tuple(_node_at(extract, each, where) for each in chain)
                    osm_id = _way_id(tags, extract)
                    keep_way(extract, OsmWay(osm_id, nodes, tags), where)
        except (TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
            raise ConfigError(
                f"{where}: coordinates must read [[longitude, latitude], …]"
            ) from error


def _tags(properties: Mapping[str, Any]) -> dict[str, str]:
    """Properties that may be tags: words and numbers."""
    return {
        str(key): str(value)
        for key, value in properties.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool)
    }


def _way_id(tags: Mapping[str, str], extract: Extract) -> int:
    """OpenStreetMap's number where an export has it (`@id`: way/4052175), else a negative one."""
    kind, _, digits = tags.get("@id", "").partition("/")
    if kind == "way" and digits.isdecimal() and int(digits) not in extract.ways:
        return int(digits)
    return -1 - len(extract.ways)


def _node_at(extract: Extract, row: Iterable[float], where: str) -> int:
    """Number of the node at a longitude and latitude: made of these, so it is the same in all
    files, and negative."""
    longitude_deg, latitude_deg = (float(each) for each in tuple(row)[:2])
    x, y = round((longitude_deg + 180) * _PER_DEGREE), round((latitude_deg + 90) * _PER_DEGREE)
    node = -1 - (y * 360 * _PER_DEGREE + x)
    place(extract, node, y / _PER_DEGREE - 90, x / _PER_DEGREE - 180, where)
    return node


# Into the extract ---------------------------------------------------------------------------------
def place(
    extract: Extract, node: int, latitude_deg: float, longitude_deg: float, where: str
) -> None:
    """Note where a node lies."""
    if not (isfinite(latitude_deg) and abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise ConfigError(f"{where}: latitude and longitude must be in degrees")
    extract.places[node] = (radians(latitude_deg), radians(longitude_deg))


def keep_node(extract: Extract, node: int, tags: dict[str, str]) -> None:
    """Note a node's tags if they matter to a tram."""
    if tags.get("railway") in NODES or is_stop(tags):
        extract.node_tags[node] = tags


def keep_way(extract: Extract, way: OsmWay, where: str) -> None:
    """Note a track."""
    if len(set(way.nodes)) < 2:
        raise ConfigError(f"{where}: needs two nodes at least")
    extract.ways[way.osm_id] = way


def is_route(tags: Mapping[str, str]) -> bool:
    """Whether a relation's tags make it one direction of a line."""
    return tags.get("type") == "route" and tags.get("route") in ROUTES
