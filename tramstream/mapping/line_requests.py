"""What lines an operator runs: their stops in order, as files say.

Three kinds of file: GeoJSON features with the properties `line`, `direction` and `stops`, a list of
names or of [name, chainage]; TOML with `[[line]]` tables of `line`, `direction` and `stops`; and
the route relations of an extract of OpenStreetMap. Only names and their order are used: the network
itself says where the line runs (`network_lines.lay_lines`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from msgspec import Struct, field

from tramstream.errors import ConfigError
from tramstream.input_file import parse_json, read_bytes
from tramstream.mapping.osm import Extract, OsmRoute
from tramstream.strict_toml import decode_toml


class LineRequest(NamedTuple):
    """One direction of a line: what it is called, and where it stops."""

    line: str
    direction: str
    stops: tuple[str, ...]
    """Names, in order."""
    places: tuple[tuple[float, float], ...] = ()
    """Latitude, longitude, rad, of each stop, where the file says which of its name is meant."""

    @property
    def name(self) -> str:
        """As sentences call it."""
        return f"line {self.line}, direction {self.direction or '(none)'}"


class _Line(Struct, frozen=True, forbid_unknown_fields=True):
    line: str
    stops: tuple[str, ...]
    direction: str = ""


class _Lines(Struct, frozen=True, forbid_unknown_fields=True):
    lines: tuple[_Line, ...] = field(name="line", default=())


def read(path: Path) -> list[LineRequest]:
    """Read a TOML or GeoJSON file of lines.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    data = read_bytes(path)
    found = of_toml(data, str(path)) if path.suffix == ".toml" else of_geojson(data, str(path))
    if not found:
        raise ConfigError(f"{path}: has no lines; see docs/map.md, Lines and stops")
    return found


def of_toml(data: bytes, name: str) -> list[LineRequest]:
    """Lines of a TOML text; `name` is for the sentence."""
    lines = decode_toml(data, _Lines, name).lines
    requests = [LineRequest(each.line, each.direction, each.stops) for each in lines]
    for index, each in enumerate(requests):
        if len(each.stops) < 2:
            raise ConfigError(f"{name}: $.line[{index}].stops: a line needs two stops at least")
    return requests


def of_geojson(data: bytes, name: str) -> list[LineRequest]:
    """Lines of a GeoJSON text: features that have `stops`; others are passed over."""
    try:
        document = parse_json(data)
        features = document.get("features", [document])
        properties = [each.get("properties") or {} for each in features]
    except (ValueError, AttributeError, TypeError) as error:
        raise ConfigError(f"{name}: is neither TOML (*.toml) nor GeoJSON of lines") from error
    return [_request(each, name) for each in properties if "stops" in each]


def _request(properties: dict[str, Any], name: str) -> LineRequest:
    line, direction = str(properties.get("line", "")), str(properties.get("direction", ""))
    if not line:
        raise ConfigError(f"{name}: a feature has stops, but no property line that names it")
    stops = properties["stops"]
    names = [each if isinstance(each, str) else _first(each) for each in _sequence(stops)]
    if len(names) < 2 or None in names:
        raise ConfigError(
            f"{name}: line {line}/{direction}: property stops must be a list of two names or more, "
            "or of [name, chainage]"
        )
    return LineRequest(line, direction, tuple(each for each in names if each is not None))


def _sequence(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _first(value: Any) -> str | None:
    """The name in [name, chainage]."""
    return value[0] if isinstance(value, list) and value and isinstance(value[0], str) else None


# Relations ----------------------------------------------------------------------------------------
def of_extract(extract: Extract) -> tuple[list[LineRequest], tuple[str, ...]]:
    """Lines of the route relations of an extract.

    The direction of a line is where it goes to, or the number of the relation where the map does
    not say that, or says it of two.

    Returns
    -------
    requests : list of LineRequest
    findings : tuple of str
        One sentence for each relation that is broken.
    """
    requests: dict[tuple[str, str], LineRequest] = {}
    findings = []
    for route in extract.routes.values():
        try:
            request = _of_route(extract, route)
        except ConfigError as error:
            findings.append(f"relation {route.osm_id}{_called(route)}: {error}")
            continue
        if (request.line, request.direction) in requests or not request.direction:
            request = request._replace(direction=str(route.osm_id))
        requests[request.line, request.direction] = request
    for osm_id, count, one in extract.missing_members():
        findings.append(
            f"relation {osm_id}{_called(extract.routes[osm_id])}: {count} of its ways are not in "
            f"the extract or no tram tracks, e.g. way {one}; its line may end there"
        )
    return list(requests.values()), tuple(findings)


def _of_route(extract: Extract, route: OsmRoute) -> LineRequest:
    stops: list[int] = []
    for member in route.members:
        # Platforms lie beside the rails; of a stop that is listed twice one is enough.
        if member.kind != "node" or member.role.startswith("platform"):
            continue
        if (member.role.startswith("stop") or member.osm_id in extract.stops) and (
            stops[-1:] != [member.osm_id]
        ):
            stops.append(member.osm_id)
    line = route.tags.get("ref") or route.tags.get("name", "")
    if not line:
        raise ConfigError("has neither ref nor name; the map must say which line it is")
    if len(stops) < 2:
        raise ConfigError(f"has {len(stops) or 'no'} stops; it needs two members with role stop")
    for stop in stops:
        if stop not in extract.stops:
            raise ConfigError(f"its stop {stop} is not in the extract; extract the stops as well")
        if not extract.stops[stop].get("name"):
            raise ConfigError(f"its stop {stop} has no name; name it in the map")
    return LineRequest(
        line,
        route.tags.get("to", ""),
        tuple(extract.stops[stop]["name"] for stop in stops),
        tuple(extract.places[stop] for stop in stops),
    )


def _called(route: OsmRoute) -> str:
    names = [route.tags[key] for key in ("ref", "name") if route.tags.get(key)]
    return f" ({names[-1]})" if names else ""
