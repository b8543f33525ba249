"""What is read from maps: every kind of file says the same, and bad ones are told by name."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path
from typing import Any

import osmium
import pytest

from tramstream.errors import ConfigError
from tramstream.mapping.extract import read
from tramstream.mapping.osm import Extract, Member, is_stop

PLACES = {
    1: (50.08, 14.42),
    2: (50.081, 14.42),
    3: (50.082, 14.421),
    4: (50.0815, 14.43),
}
STOP = {"railway": "tram_stop", "name": "Anděl", "ref:PID": "U1Z1P"}
SWITCH = {"railway": "switch"}
WAYS = {10: ((1, 2, 3), {"railway": "tram", "oneway": "yes"}), 11: ((2, 4), {"railway": "tram"})}
ROUTE = {"type": "route", "route": "tram", "ref": "7"}


def nodes() -> list[dict[str, Any]]:
    tags = {1: STOP, 2: SWITCH}
    return [
        {"type": "node", "id": node, "lat": place[0], "lon": place[1], "tags": tags.get(node, {})}
        for node, place in PLACES.items()
    ]


def ways(geometry: bool) -> list[dict[str, Any]]:
    found = []
    for osm_id, (members, tags) in WAYS.items():
        way: dict[str, Any] = {"type": "way", "id": osm_id, "nodes": list(members), "tags": tags}
        if geometry:
            way["geometry"] = [{"lat": PLACES[n][0], "lon": PLACES[n][1]} for n in members]
        found.append(way)
    return found


def route() -> dict[str, Any]:
    members = [
        {"type": "node", "ref": 1, "role": "stop"},
        {"type": "way", "ref": 10, "role": ""},
        {"type": "way", "ref": 99, "role": ""},
    ]
    return {"type": "relation", "id": 5, "members": members, "tags": ROUTE}


def written(folder: Path, name: str, elements: Any) -> Path:
    path = folder / name
    path.write_text(json.dumps({"elements": elements}))
    return path


def xml() -> str:
    rows = ["<osm version='0.6' generator='test'>"]
    for each in nodes():
        rows.append(f"<node id='{each['id']}' version='1' lat='{each['lat']}' lon='{each['lon']}'>")
        rows += [f"<tag k='{k}' v='{v}'/>" for k, v in each["tags"].items()]
        rows.append("</node>")
    for osm_id, (members, tags) in WAYS.items():
        rows.append(f"<way id='{osm_id}' version='1'>")
        rows += [f"<nd ref='{node}'/>" for node in members]
        rows += [f"<tag k='{k}' v='{v}'/>" for k, v in tags.items()]
        rows.append("</way>")
    rows.append("<relation id='5' version='1'>")
    for member in route()["members"]:
        row = f"type='{member['type']}' ref='{member['ref']}' role='{member['role']}'"
        rows.append(f"<member {row}/>")
    rows += [f"<tag k='{k}' v='{v}'/>" for k, v in ROUTE.items()]
    return "".join([*rows, "</relation></osm>"])


def holds_everything(extract: Extract) -> None:
    assert {way.osm_id: (way.nodes, way.tags) for way in extract.ways.values()} == WAYS
    for node, place in PLACES.items():
        found = tuple(math.degrees(each) for each in extract.places[node])
        assert found == pytest.approx(place, abs=1e-9)
    assert extract.stops == {1: STOP}
    assert extract.switches == {2}
    assert extract.routes[5].tags == ROUTE
    assert extract.routes[5].members[0] == Member("node", 1, "stop")
    assert extract.missing_members() == [(5, 1, 99)]


def test_overpass_with_geometry_in_ways_and_stops_in_another_file(tmp_path: Path) -> None:
    first = written(tmp_path, "ways.json", [*ways(geometry=True), route()])
    second = written(tmp_path, "stops.json", nodes()[:2])
    holds_everything(read([first, second]))


def test_overpass_with_nodes_of_their_own_in_any_order(tmp_path: Path) -> None:
    elements = [*ways(geometry=False), route(), *nodes()]
    holds_everything(read([written(tmp_path, "a.json", elements)]))
    holds_everything(read([written(tmp_path, "b.json", elements[::-1])]))


def test_osm_files_hold_the_same(tmp_path: Path) -> None:
    plain, packed, binary = (tmp_path / f"map.{end}" for end in ("osm", "osm.gz", "osm.pbf"))
    plain.write_text(xml())
    packed.write_bytes(gzip.compress(xml().encode()))
    with osmium.SimpleWriter(str(binary)) as writer:
        for each in osmium.FileProcessor(str(plain)):
            writer.add(each)
    for path in (plain, packed, binary):
        holds_everything(read([path]))


def test_geojson_nodes_are_where_coordinates_coincide(tmp_path: Path) -> None:
    def line(*rows: tuple[float, float], **properties: Any) -> dict[str, Any]:
        geometry = {"type": "LineString", "coordinates": [list(row) for row in rows]}
        return {"type": "Feature", "geometry": geometry, "properties": properties}

    features = [
        line((14.42, 50.08), (14.43, 50.08), oneway="yes"),
        line((14.43 + 2e-9, 50.08), (14.44, 50.08), **{"@id": "way/77"}),
        line((14.0, 50.0), (14.1, 50.0), railway="rail"),
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [14.43, 50.08]},
            "properties": STOP,
        },
    ]
    path = tmp_path / "lines.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    extract = read([path])
    first, second = extract.ways.values()
    assert first.nodes[1] == second.nodes[0]
    assert len({*first.nodes, *second.nodes}) == 3
    assert all(node < 0 for node in first.nodes)
    assert first.osm_id < 0
    assert second.osm_id == 77
    assert first.tags == {"oneway": "yes", "railway": "tram"}
    assert list(extract.stops) == [first.nodes[1]]


@pytest.mark.parametrize(
    ("tags", "stop"),
    [
        ({"railway": "tram_stop"}, True),
        ({"public_transport": "stop_position", "tram": "yes"}, True),
        ({"public_transport": "stop_position", "bus": "yes"}, False),
        ({"railway": "tram_stop", "public_transport": "platform"}, False),
        ({"railway": "switch"}, False),
    ],
)
def test_where_trams_stop(tags: dict[str, str], stop: bool) -> None:
    assert is_stop(tags) is stop


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "bad.json: is no JSON"),
        ("[]", "neither an answer of Overpass nor GeoJSON"),
        ('{"elements": []}', "bad.json: has no way with railway=tram"),
        ('{"elements": [7]}', "bad.json: element: is not as Overpass writes it"),
        ('{"elements": [{"type": "node", "id": 8}]}', "node 8: is not as Overpass"),
        ('{"elements": [{"type": "node", "id": 8, "lat": 95, "lon": 0}]}', "node 8: latitude"),
        (json.dumps({"elements": ways(geometry=False)}), "way 10 has node 1, which has no coord"),
        (
            '{"elements": [{"type": "way", "id": 3, "tags": {"railway": "tram"}}]}',
            "way 3: has no nodes",
        ),
        (
            '{"elements": [{"type": "way", "id": 3, "nodes": [4, 4], "tags": '
            '{"railway": "tram"}}]}',
            "way 3: needs two nodes",
        ),
        ('{"elements": [], "remark": "runtime error: Query timed out"}', "Overpass broke off"),
        ('{"type": "LineString", "coordinates": [["a", 1]]}', "feature 0: coordinates must"),
        ('{"type": "LineString", "coordinates": [[14, 50]]}', "feature 0: needs two nodes"),
    ],
)
def test_bad_files_are_refused_with_a_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says):
        read([path])


def test_absent_and_broken_osm_files_are_refused(tmp_path: Path) -> None:
    for name in ("none.json", "none.osm.pbf"):
        with pytest.raises(ConfigError, match=f"{name}: cannot be read"):
            read([tmp_path / name])
    broken = tmp_path / "broken.osm.pbf"
    broken.write_bytes(b"no map at all")
    with pytest.raises(ConfigError, match=r"broken.osm.pbf: is no OpenStreetMap file"):
        read([broken])
    with pytest.raises(ConfigError, match="no file: has no way"):
        read([])


@pytest.mark.realdata
def test_prague_is_read_whole(data_dir: Path) -> None:
    folder = data_dir / "maps" / "prague"
    extract = read(sorted(folder.glob("*overpass.json")))
    assert len(extract.ways) == 2582
    assert len(extract.stops) > 600
    assert all("2026-02-08" in source for source in extract.sources)
