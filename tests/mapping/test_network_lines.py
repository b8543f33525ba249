"""Stops and lines on small networks, whose lengths are known, and on that of Prague."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import (
    BOTH,
    RING_M,
    TOWN_LINES,
    TOWN_M,
    TOWN_STOPS,
    after,
    arc,
    between,
    network_of,
    straight,
    town,
)
from prague import Prague

from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.lines import lay_lines, path_of, place_stops
from tramstream.mapping.osm import Extract, OsmWay
from tramstream.tracks.linear_reference import references
from tramstream.tracks.network import FORWARDS, Network, RouteLine, Stop, Way

MM = 1e-3
FIRST = between((0.0, 0.0), (100.0, 0.0))
"""A track of 100 m."""


def lay(network: Network, *stops: str) -> RouteLine:
    (line,), findings = asked(network, *stops)
    assert findings == ()
    return line


def asked(network: Network, *stops: str) -> tuple[tuple[RouteLine, ...], tuple[str, ...]]:
    found, findings = lay_lines(network, [LineRequest("9", "out", stops)])
    return found.lines, findings


def chainages(line: RouteLine) -> list[float]:
    return [stop.chainage_m for stop in line.stops]


# Paths --------------------------------------------------------------------------------------------
def test_line_follows_the_tracks_that_trams_may_go():
    line = lay(town(), "West", "Square", "Far", "Square", "West")
    assert line.runs == (0, 2, 4, 6, 9)
    assert (line.begin_m, line.origin, line.destination) == (50.0, "West", "West")
    assert line.length_m == pytest.approx(550 + 400 + 300 + 400 + 540, abs=MM)
    assert chainages(line) == pytest.approx([0, 250, 1100, 550 + 400 + 300 + 400 + 290, 2190])
    assert [stop.name for stop in line.stops] == ["West", "Square", "Far", "Square", "West"]


def test_track_gone_against_its_drawing_is_measured_from_where_trams_enter_it():
    line = lay(town(), "Square", "West")
    assert (line.runs, line.begin_m, line.length_m) == ((9,), 600 - 310, 310 - 60)


def test_path_is_shortest_in_total_and_not_stop_by_stop():
    """Twin is nearer on the main track; with Branch end after it the branch is the shorter way."""
    line = lay(town(), "Square", "Twin", "Branch end")
    assert line.runs == (0, 10)
    assert chainages(line) == pytest.approx([0, 300 + 200, 300 + 450])


def test_track_of_both_ways_is_gone_back():
    line = lay(town(), "Branch end", "West")
    assert line.runs == (11, 12, 9)
    assert line.length_m == pytest.approx(450 + 100 + 540)


def test_line_that_ends_where_it_began_goes_round():
    line = lay(town(), "Far", "West", "Far")
    assert line.length_m == pytest.approx(RING_M)
    assert line.runs == (4, 6, 9, 14, 0, 2, 4)


def test_double_stop_is_made_at_both_places():
    stops = [*TOWN_STOPS, Stop("Square", 0, 340.0)]
    assert chainages(lay(town(stops), "West", "Square", "Square", "Far")) == pytest.approx(
        [0, 250, 290, 1100]
    )


@pytest.mark.parametrize("joint", [Stop("Joint", 0, 600.0), Stop("Joint", 5, 0.0)])
def test_stop_where_tracks_join_lies_on_all_of_them(joint):
    network = town([*TOWN_STOPS, joint])
    assert lay(network, "West", "Joint", "Far").runs == (0, 2, 4)
    assert lay(network, "West", "Joint", "Branch end").runs == (0, 10)
    begins = lay(network, "Joint", "Far")
    assert (begins.runs, begins.begin_m, begins.length_m) == ((2, 4), 0.0, 550.0)
    ends = lay(network, "West", "Joint")
    assert (ends.runs, ends.length_m) == ((0,), 550.0)


def test_place_of_a_stop_chooses_among_those_of_its_name():
    network = town([*TOWN_STOPS, Stop("Far", 1, 300.0)])
    near = lay(network, "West", "Far")
    assert near.length_m == pytest.approx(850)
    plan = np.array([[50.0, 0.0], [1100.0, 50.0]])
    places = tuple(map(tuple, network.geodetic_of(plan).tolist()))
    request = LineRequest("9", "out", ("West", "Far"), places)
    assert lay_lines(network, [request])[0].lines[0].length_m == pytest.approx(1100)


def test_line_laid_again_takes_the_place_of_the_old_one():
    requests = [LineRequest("9", way, ("West", "Square")) for way in ("out", "back")]
    network, _ = lay_lines(town(), requests)
    network, _ = lay_lines(network, [LineRequest("9", "out", ("West", "Far"))])
    assert [(each.direction, each.destination) for each in network.lines] == [
        ("back", "Square"),
        ("out", "Far"),
    ]


# Names --------------------------------------------------------------------------------------------
def test_stop_of_the_very_name_comes_before_one_that_differs_in_accents():
    stops = [Stop("Náměstí", 0, 100.0), Stop("Namesti", 0, 200.0), Stop("Far", 2, 150.0)]
    network = town(stops)
    assert lay(network, "Namesti", "Far").begin_m == 200.0
    assert lay(network, "Náměstí", "Far").begin_m == 100.0
    loose = lay(network, "NÁMĚSTÍ", "Far")  # either would do; the nearer one is taken
    assert (loose.begin_m, loose.origin) == (200.0, "Namesti")


def test_dashes_and_blanks_do_not_matter():
    network = town([Stop("Zborov – Strašnické divadlo", 0, 100.0), Stop("Far", 2, 150.0)])
    assert lay(network, "Zborov - Strašnické  divadlo", "Far").begin_m == 100.0


def test_unknown_stop_is_a_finding_and_the_other_lines_are_laid():
    requests = [LineRequest("9", "out", ("West", "Sqare")), LineRequest("8", "", ("West", "Far"))]
    network, (finding,) = lay_lines(town(), requests)
    assert [each.line for each in network.lines] == ["8"]
    assert finding.startswith("line 9, direction out: stop 'Sqare' is not on the network")
    assert "near: Square" in finding


def test_line_that_leaves_the_network_is_a_finding_with_its_stops():
    network = network_of([FIRST, between((300.0, 0.0), (500.0, 0.0))])
    network = replace(network, stops=(Stop("Here", 0, 50.0), Stop("There", 1, 50.0)))
    _, (finding,) = asked(network, "Here", "There")
    assert "between stops 'Here' and 'There' it leaves the network" in finding


def test_absurd_detour_is_a_finding():
    around = after(FIRST, [*straight(8900.0), *arc(5.0, math.pi), *straight(8910.0)])
    network = network_of([FIRST, around], [(0, 2)])
    stops = Stop("Here", 0, 95.0), Stop("Beside", 1, around.length_m - 5.0)
    network = replace(network, stops=stops)
    _, (finding,) = asked(network, "Here", "Beside")
    assert "goes 17.8 km round, for 0.0 km" in finding


def test_stop_where_no_tram_may_go_is_a_finding():
    stops = Stop("A", 0, 9.0), Stop("B", 0, 90.0)
    network = replace(network_of([FIRST], rules=[0]), stops=stops)
    _, (finding,) = asked(network, "A", "B")
    assert "stop 'A' lies on a track where no tram is meant to go" in finding


# Paths as points ----------------------------------------------------------------------------------
def test_path_is_as_long_as_it_says_and_begins_and_ends_where_it_says():
    network = town()
    line = lay(network, "West", "Far", "West")
    path = path_of(network, line.runs, line.begin_m, line.length_m)
    assert path[[0, -1], 0].tolist() == [0.0, line.length_m]
    np.testing.assert_allclose(path[[0, -1], 1:], [[50, 0], [60, 100]], atol=MM)
    steps = np.hypot(*np.diff(path[:, 1:], axis=0).T)
    np.testing.assert_allclose(steps, np.diff(path[:, 0]), atol=2 * MM)  # chords
    assert (np.diff(path[:, 0]) > 0).all()


@pytest.mark.parametrize("track", range(len(TOWN_LINES)))
def test_run_back_is_the_run_reversed(track):
    network = town()
    length_m = float(network.length_m[track])
    out, back = (path_of(network, [2 * track + k], 0.0, length_m) for k in (0, 1))
    np.testing.assert_allclose(back[::-1, 1:], out[:, 1:], atol=MM)


# References ---------------------------------------------------------------------------------------
def test_references_are_the_inverse_of_lines():
    network, _ = lay_lines(
        town(),
        [
            LineRequest("9", "out", ("West", "Far", "West")),
            LineRequest("8", "out", ("Square", "Branch end")),
            LineRequest("8", "back", ("Branch end", "Square")),
        ],
    )
    known = references(network)
    for index, line in enumerate(network.lines):
        at_m = -line.begin_m
        for run in line.runs:
            length_m = float(network.length_m[run >> 1])
            for chainage_m in np.linspace(0.0, length_m, 7):
                wanted = at_m + chainage_m
                found = [
                    each.chainage_m for each in known.at(run, chainage_m) if each.line == index
                ]
                assert found == (
                    [pytest.approx(wanted, abs=MM)] if 0 <= wanted <= line.length_m else []
                )
            at_m += length_m


def test_line_that_passes_twice_has_two_references():
    network, _ = lay_lines(town(), [LineRequest("9", "", ("Far", "West") * 2 + ("Far",))])
    found = references(network).at(0, 300.0)
    assert found[1].chainage_m - found[0].chainage_m == pytest.approx(RING_M)


def test_run_without_lines_has_no_reference():
    assert references(town()).at(3, 10.0) == []
    assert references(lay_lines(town(), [])[0]).at(15, 0.0) == []


# Stops --------------------------------------------------------------------------------------------
TOWN_WAYS = tuple(
    Way(track, 0.0, length_m, 1000 + track, {}) for track, length_m in enumerate(TOWN_M)
)


def extract_of(network: Network, stops: dict[int, tuple[float, float, dict[str, str]]]) -> Extract:
    """Stops at places of the plan; node 1 is a node of the way of track 4."""
    extract = Extract()
    for node, (east, north, tags) in stops.items():
        extract.places[node] = tuple(network.geodetic_of([east, north]).tolist())
        extract.node_tags[node] = {"railway": "tram_stop", **tags}
    extract.ways[1004] = OsmWay(1004, (1, 2), {})
    return extract


def test_stop_lies_on_the_way_that_has_its_node_else_on_the_nearest_track():
    network = town((), TOWN_WAYS)
    stops = {
        1: (250.0, 99.0, {"name": "On its way", "ref:PID": "U1", "local_ref": "A"}),
        5: (700.0, -6.0, {"name": "Beside", "local_ref": "B"}),
        6: (700.0, 40.0, {"name": "Too far"}),
        7: (1100.0, 55.0, {"ref": "77"}),
    }
    placed = place_stops(network, extract_of(network, stops)).stops
    assert [stop[:2] for stop in placed] == [("Beside", 1), ("77", 2), ("On its way", 4)]
    assert [stop.chainage_m for stop in placed] == pytest.approx([100, 155, 250], abs=MM)
    assert [stop.ref for stop in placed] == ["B", "77", "U1"]


def test_stop_of_a_way_that_the_network_left_out_is_left_out():
    network = town((), [way._replace(osm_id=9) for way in TOWN_WAYS])
    stops = {1: (250.0, 104.0, {"name": "Depot"}), 9: (300.0, 104.0, {"name": "Beside"})}
    assert [stop.name for stop in place_stops(network, extract_of(network, stops)).stops] == [
        "Beside"
    ]


def test_stop_of_a_way_without_a_number_lies_on_it():
    network = town((), [way._replace(osm_id=0) for way in TOWN_WAYS])
    stops = {1: (250.0, 100.5, {"name": "On it"})}
    assert place_stops(network, extract_of(network, stops)).stops[0][:2] == ("On it", 4)


def test_stop_between_two_tracks_lies_on_the_nearer_one():
    network = network_of([FIRST, between((100.0, 3.3), (0.0, 3.3))], rules=[FORWARDS, BOTH])
    stops = {8: (30.0, 1.0, {"name": "A"}), 9: (30.0, 2.4, {"name": "B"})}
    placed = place_stops(network, extract_of(network, stops)).stops
    assert [(stop.name, stop.track) for stop in placed] == [("A", 0), ("B", 1)]
    assert [stop.chainage_m for stop in placed] == pytest.approx([30, 70], abs=MM)


# Prague -------------------------------------------------------------------------------------------
@pytest.mark.realdata
def test_real_lines_run_where_their_operator_says(data_dir: Path, prague: Prague):
    """The file's chainages are on a sphere of 6371 km, 0.04 % short."""
    network = prague.network
    document = json.loads((data_dir / "maps/prague/lines_7_20.geojson").read_bytes())
    for line, feature in zip(network.lines, document["features"], strict=True):
        told = feature["properties"]
        assert (line.line, line.direction) == (told["line"], str(told["direction"]))
        assert line.length_m == pytest.approx(told["length_m"], rel=5e-3)
        path = path_of(network, line.runs, line.begin_m, line.length_m)
        drawn = network.plan_of(np.radians(feature["geometry"]["coordinates"])[:, ::-1])
        last = len(told["stops"]) - 1
        if (line.line, line.direction) == ("7", "1"):
            # The file ends with a turn back that no rails allow, to the stop where trams depart.
            last -= 1
        end_m = line.stops[last].chainage_m
        away = np.array([distance_m(drawn, place) for place in path[path[:, 0] <= end_m, 1:][::10]])
        assert away.max() < 3.0  # the file goes straight from node to node
        for stop, (name, chainage_m) in zip(line.stops[: last + 1], told["stops"], strict=False):
            assert stop.name == name
            assert stop.chainage_m == pytest.approx(chainage_m, rel=6e-4, abs=1.0)


def distance_m(chain: np.ndarray, place: np.ndarray) -> float:
    """Of a place from a chain of nodes."""
    edges = np.diff(chain, axis=0)
    share = np.clip(np.sum((place - chain[:-1]) * edges, axis=1) / np.sum(edges**2, axis=1), 0, 1)
    return float(np.min(np.hypot(*(chain[:-1] + share[:, None] * edges - place).T)))


@pytest.mark.realdata
def test_real_stops_are_on_their_tracks(prague: Prague):
    network = prague.network
    names = {stop.name for stop in network.stops}
    assert {"Anděl", "Malostranská", "Depo Hostivař"} <= names
    assert len(network.stops) > 640
    for stop in network.stops:
        assert 0.0 <= stop.chainage_m <= network.length_m[stop.track]
