"""Lines as files and relations ask for them, and what is said of odd ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tramstream.errors import ConfigError
from tramstream.mapping.line_requests import LineRequest, of_extract, of_geojson, of_toml, read
from tramstream.mapping.osm import Extract, Member, OsmRoute

TOML = b"""
[[line]]
line = "7"
direction = "out"
stops = ["Radlick\xc3\xa1", "And\xc4\x9bl"]

[[line]]
line = "20"
stops = ["A", "B", "A"]
"""


def geojson(*properties: dict[str, Any]) -> bytes:
    features = [{"type": "Feature", "geometry": None, "properties": each} for each in properties]
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


def test_toml_gives_lines_in_order():
    assert of_toml(TOML, "lines.toml") == [
        LineRequest("7", "out", ("Radlická", "Anděl")),
        LineRequest("20", "", ("A", "B", "A")),
    ]


def test_geojson_gives_names_with_or_without_chainage():
    text = geojson(
        {"line": 7, "direction": 0, "stops": [["A", 0.0], ["B", 412.5]]},
        {"name": "a track without stops"},
        {"line": "8", "direction": "back", "stops": ["B", "A"]},
    )
    assert of_geojson(text, "lines.geojson") == [
        LineRequest("7", "0", ("A", "B")),
        LineRequest("8", "back", ("B", "A")),
    ]


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("x.toml", b'[[line]]\nline = "7"\nstop = ["A", "B"]', r"\$\.line\[0\]\.stop: unknown"),
        ("x.toml", b'[[line]]\nline = 7\nstops = ["A", "B"]', r"\$\.line\[0\]\.line"),
        ("x.toml", b'[[line]]\nline = "7"\nstops = ["A"]', "two stops"),
        ("x.toml", b"[[line", "not TOML"),
        ("x.toml", b"", "has no lines"),
        ("x.geojson", b"[[line]]", "neither TOML"),
        ("x.geojson", b"[1]", "neither TOML"),
        ("x.geojson", geojson({"line": "7"}), "has no lines"),
        ("x.geojson", geojson({"stops": ["A", "B"]}), "property line"),
        ("x.geojson", geojson({"line": "7", "stops": ["A"]}), "two names"),
        ("x.geojson", geojson({"line": "7", "stops": [1, 2]}), "line 7/"),
        ("x.geojson", geojson({"line": "7", "stops": "AB"}), "line 7/"),
    ],
)
def test_bad_file_is_refused_with_one_sentence(tmp_path: Path, name, text, told):
    (tmp_path / name).write_bytes(text)
    with pytest.raises(ConfigError, match=told) as refused:
        read(tmp_path / name)
    assert str(refused.value).startswith(str(tmp_path / name))


def test_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read(tmp_path / "no.toml")


# Relations ----------------------------------------------------------------------------------------
def extract(*routes: OsmRoute) -> Extract:
    found = Extract(routes={route.osm_id: route for route in routes})
    for node, name in ((1, "A"), (2, "B"), (3, "C"), (4, "")):
        found.node_tags[node] = {"railway": "tram_stop", "name": name}
        found.places[node] = (0.87, 0.25 + node / 1e6)
    return found


def route(osm_id: int, stops: tuple[int, ...], **tags: str) -> OsmRoute:
    members = [Member("node", stop, "stop") for stop in stops]
    platforms = [Member("way", 99, "platform"), Member("node", 98, "platform_exit_only")]
    return OsmRoute(osm_id, (*members, *platforms), {"type": "route", **tags})


def test_relation_is_a_line_towards_where_it_goes():
    requests, findings = of_extract(extract(route(5, (1, 2, 2, 3), ref="7", to="C")))
    assert findings == ()
    (request,) = requests
    assert request[:3] == ("7", "C", ("A", "B", "C"))
    assert request.places[2] == (0.87, 0.25 + 3e-6)


def test_two_relations_of_one_direction_are_told_apart_by_their_numbers():
    routes = [route(k, (1, 2), ref="7", to="B") for k in (5, 6)] + [route(8, (2, 1), ref="7")]
    requests, _ = of_extract(extract(*routes))
    assert [request.direction for request in requests] == ["B", "6", "8"]


@pytest.mark.parametrize(
    ("broken", "told"),
    [
        (route(5, (1, 2), to="B"), "neither ref nor name"),
        (route(5, (1,), ref="7"), "has 1 stops"),
        (route(5, (), ref="7", name="Tram 7"), r"relation 5 \(Tram 7\): has no stops"),
        (route(5, (1, 77), ref="7"), "stop 77 is not in the extract"),
        (route(5, (1, 4), ref="7"), "stop 4 has no name"),
    ],
)
def test_broken_relation_is_a_finding_and_the_others_are_read(broken, told):
    requests, findings = of_extract(extract(broken, route(6, (1, 2), ref="8", to="B")))
    assert [request.line for request in requests] == ["8"]
    (finding,) = findings
    assert finding.startswith("relation 5")
    with pytest.raises(ConfigError, match=told):
        raise ConfigError(finding)


def test_relation_that_leaves_the_extract_is_read_and_noted():
    whole = route(5, (1, 2), ref="7", to="B")
    cut = whole._replace(members=(*whole.members, Member("way", 12, "")))
    requests, (finding,) = of_extract(extract(cut))
    assert len(requests) == 1
    assert "way 12" in finding
