"""Networks from small maps whose answer is plain, and all of Prague."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import passing_loop
from numpy.typing import NDArray
from prague import Prague

from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.mapping.build import Options, build
from tramstream.mapping.osm import Extract, OsmWay
from tramstream.mapping.survey import Report
from tramstream.tracks import network
from tramstream.tracks.network import BACKWARDS, FORWARDS, PARTNER_LEFT, PARTNER_RIGHT, Network

LEVEL = LocalLevel.at_deg(50.08, 14.45, 44.5)
Plan = list[tuple[float, float]]


class Sheet:
    """A map drawn in metres."""

    def __init__(self) -> None:
        self.extract = Extract(sources=["sheet"])
        self._numbers: dict[tuple[float, float], int] = {}

    def way(self, plan: Plan | NDArray[np.float64], **tags: str) -> int:
        """Draw a way; nodes at the same place are one. Gives its number."""
        nodes = []
        for east, north in plan:
            place = (round(float(east), 3), round(float(north), 3))
            node = self._numbers.setdefault(place, len(self._numbers) + 1)
            nodes.append(node)
            latitude, longitude, _ = LEVEL.to_geodetic([*place, 0.0])
            self.extract.places[node] = (float(latitude), float(longitude))
        osm_id = 100 + len(self.extract.ways)
        tags = {key.replace("__", ":"): value for key, value in tags.items()}
        self.extract.ways[osm_id] = OsmWay(osm_id, tuple(nodes), {"railway": "tram", **tags})
        return osm_id

    def node(self, east: float, north: float) -> int:
        return self._numbers[east, north]

    def built(self, **options: Any) -> tuple[Network, Report]:
        return build(self.extract, Options(**options))


def straight(*norths_and_ends: float, step_m: float = 20.0) -> Plan:
    """A way due east at a north, from one east to another."""
    north, begin, end = norths_and_ends
    count = max(round(abs(end - begin) / step_m), 1)
    return [(float(east), north) for east in np.linspace(begin, end, count + 1)]


def kinds(report: Report) -> list[str]:
    return [finding.kind for finding in report.findings]


@pytest.fixture(scope="module")
def double() -> tuple[Sheet, Network, Report]:
    """Double track, right-hand traffic, 3.3 m apart; a stretch of single track further on."""
    sheet = Sheet()
    sheet.way(straight(0.0, 0.0, 400.0), oneway="yes", maxspeed="50")
    sheet.way(straight(3.3, 400.0, 0.0), oneway="yes", maxspeed="30")
    sheet.way([(400.0, 0.0), (420.0, 0.0), (430.0, 0.4), (440.0, 1.2), (460.0, 3.3)], oneway="yes")
    sheet.way([(460.0, 3.3), (400.0, 3.3)], oneway="yes")
    sheet.way(straight(3.3, 460.0, 700.0))
    return sheet, *sheet.built()


def test_tracks_lie_where_the_map_has_them(double: tuple[Sheet, Network, Report]) -> None:
    sheet, net, report = double
    assert report.counts["nodes"] == len(net.node_id) == 4
    assert report.counts["tracks"] == net.track_count == 3
    assert report.counts["edges"] == len(net.edges) == 4
    assert sorted(net.rules.tolist()) == [FORWARDS, FORWARDS, FORWARDS | BACKWARDS]
    assert report.lengths["track_km"] == pytest.approx(0.46 + 0.46 + 0.24, abs=0.001)
    assert report.lengths["edge_km"] == pytest.approx(0.46 + 0.46 + 0.48, abs=0.001)
    places = np.array(list(sheet.extract.places.values()))
    samples = np.column_stack([net.east, net.north])
    away = [np.min(np.hypot(*(samples - place).T)) for place in net.plan_of(places)]
    assert max(away) < 0.6  # half the spacing, and a bit
    back = net.geodetic_of(samples[::50])
    np.testing.assert_allclose(net.plan_of(back), samples[::50], atol=1e-6)


def test_samples_are_even_and_continuous(double: tuple[Sheet, Network, Report]) -> None:
    _, net, _ = double
    for track in range(net.track_count):
        part = net.samples_of(track)
        steps = np.hypot(np.diff(net.east[part]), np.diff(net.north[part]))
        np.testing.assert_allclose(steps, net.spacing_m[track], atol=1e-3)
        assert net.spacing_m[track] <= network.SAMPLE_M
        assert np.max(np.abs(np.diff(net.yaw_rad[part]))) < 0.1


def test_runs_part_and_meet_at_the_switch(double: tuple[Sheet, Network, Report]) -> None:
    _, net, _ = double
    single = int(np.flatnonzero(net.rules == FORWARDS | BACKWARDS)[0])
    assert len(net.following_of(2 * single + 1)) == 2  # towards the switch
    assert int(np.sum(net.node_switch)) == 1
    switch = net.from_node[single]
    assert net.node_switch[switch] == 1
    others = [track for track in range(3) if track != single]
    (inbound,) = [track for track in others if net.to_node[track] == switch]
    assert net.following_of(2 * inbound).tolist() == [2 * single]
    assert net.name_of(2 * inbound).endswith(f"-{net.node_id[switch]}")


def test_partners_are_on_the_side_where_they_are(double: tuple[Sheet, Network, Report]) -> None:
    _, net, report = double
    start = net.plan_of([LEVEL.latitude_rad, LEVEL.longitude_rad])[0]
    for track in np.flatnonzero(net.rules == FORWARDS):
        part = net.samples_of(int(track))
        beside = (net.east[part] > start + 5) & (net.east[part] < start + 395)
        # Right-hand traffic: the other track is on the left of either.
        assert set(net.partner[part][beside].tolist()) == {PARTNER_LEFT}
    assert not np.any(net.partner & PARTNER_RIGHT)
    # 0.4 km and half of the 60 m to the switch, twice; single track has no other beside it.
    assert report.lengths["opposite_share"] == pytest.approx(0.9 / 1.4, abs=0.03)


def test_ways_tell_their_tags_from_where_to_where(double: tuple[Sheet, Network, Report]) -> None:
    _, net, _ = double
    for track in range(net.track_count):
        parts = [way for way in net.ways if way.track == track]
        assert parts[0].from_m == 0.0
        assert parts[-1].to_m == pytest.approx(net.length_m[track])
        for before, after in pairwise(parts):
            assert before.to_m == after.from_m
    (fast,) = [way for way in net.ways if way.tags.get("maxspeed") == "50"]
    assert fast.to_m - fast.from_m == pytest.approx(400.0, abs=0.1)
    assert fast.tags == {"railway": "tram", "oneway": "yes", "maxspeed": "50"}


def test_network_survives_its_file(double: tuple[Sheet, Network, Report], tmp_path: Path) -> None:
    _, net, _ = double
    net.save(tmp_path / "net")
    found = network.load(tmp_path / "net")
    np.testing.assert_allclose(found.east, net.east, atol=1e-3)
    np.testing.assert_allclose(found.yaw_rad, net.yaw_rad, atol=1e-6)
    np.testing.assert_array_equal(found.across_std_m, net.across_std_m)
    assert found.ways == net.ways
    assert found.node_std_m == net.node_std_m


def test_tracks_between_the_same_nodes_have_names_of_their_own() -> None:
    loop = passing_loop()
    assert loop.network.name_of(loop.run("right")) == loop.network.name_of(loop.run("left")) + "/2"


@pytest.mark.realdata
def test_runs_of_prague_are_told_apart_by_their_names(prague: Prague) -> None:
    net = prague.network
    names = {net.name_of(run) for run in range(2 * net.track_count)}
    assert len(names) == 2 * net.track_count


def test_one_network_is_one_file(double: tuple[Sheet, Network, Report], tmp_path: Path) -> None:
    """Whatever the clock says: a file can be compared with `cmp`."""
    _, net, _ = double
    net.save(tmp_path / "first")
    network.load(tmp_path / "first").save(tmp_path / "second")
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


def test_curve_goes_on_over_a_node_without_a_step() -> None:
    # The circle is one track in three pieces: sidings leave it, so that it has nodes.
    sheet = Sheet()
    angle = np.linspace(-0.5, 2.0, 51)
    circle = np.column_stack([25 * np.sin(angle), 25 * (1 - np.cos(angle))])
    sheet.way(circle, oneway="yes")
    for index in (15, 30):
        yaw = angle[index]
        away = np.array([[0.0, 0.0], [8.0, 0.0], [30.0, -1.0]])
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        sheet.way(circle[index] + away @ turn, oneway="yes")
    net, report = sheet.built(node_std_m=0.02)
    assert net.track_count == 5
    arcs = [
        track
        for track in range(5)
        if abs(np.median(net.curvature_per_m[net.samples_of(track)])) > 0.03
    ]
    assert len(arcs) == 3
    for track in arcs:
        inner = net.curvature_per_m[net.samples_of(track)][4:-4]
        np.testing.assert_allclose(inner[5:-5], 1 / 25, rtol=0.1)
    for track in arcs:
        for other in net.following_of(2 * track):
            if other >> 1 in arcs:
                end, begin = net.samples_of(track).stop - 1, net.samples_of(other >> 1).start
                assert (
                    math.hypot(net.east[end] - net.east[begin], net.north[end] - net.north[begin])
                    < 0.03
                )
                turn = net.yaw_rad[end] - net.yaw_rad[begin]
                assert abs(math.remainder(turn, 2 * math.pi)) < math.radians(2.0)
    assert report.fit["jump_p95_m"] < 0.2


def test_deviation_near_a_switch_holds_the_kink_that_the_map_draws() -> None:
    sheet = Sheet()
    sheet.way(straight(0.0, -100.0, 100.0, step_m=10.0), oneway="yes")
    kinked = [(0.0, 0.0), (9.0, 3.3), (20.0, 8.0), (60.0, 26.0)]  # 20 deg at the switch
    sheet.way(kinked, oneway="yes")
    net, _ = sheet.built(node_std_m=0.05)
    (branch,) = [way.track for way in net.ways if way.osm_id == 101]
    std = net.yaw_std_rad[net.samples_of(branch)]
    start = abs(math.remainder(float(net.yaw_rad[net.samples_of(branch)][0]), 2 * math.pi))
    assert start > math.radians(3.0)
    assert std[0] >= start / 2 - 1e-3
    assert std[15] < std[0] / 2


def test_curve_keeps_to_an_outline_that_is_drawn_as_a_track() -> None:
    """As the map of Prague has three: a strip of grass, 76 m by 7 m, tagged as a tram's track."""
    sheet = Sheet()
    sheet.way([(0.0, 0.0), (76.0, 0.0), (76.0, 7.0), (30.0, 7.0), (0.0, 7.0), (0.0, 0.0)])
    sheet.way(straight(40.0, 0.0, 400.0), oneway="yes")
    net, _ = sheet.built(node_std_m=0.1)
    (ring,) = {way.track for way in net.ways if way.osm_id == 100}
    at = net.samples_of(ring)
    corner = net.plan_of([sheet.extract.places[sheet.node(0.0, 0.0)]])[0]
    east, north = net.east[at] - corner[0], net.north[at] - corner[1]
    outside = np.hypot(east - np.clip(east, 0, 76), north - np.clip(north, 0, 7))
    inside = np.minimum(np.minimum(east, 76 - east), np.minimum(north, 7 - north))
    assert np.max(np.maximum(outside, inside)) < 1.0


def test_yards_are_left_out_unless_wanted() -> None:
    sheet = Sheet()
    sheet.way(straight(0.0, 0.0, 200.0), oneway="yes")
    sheet.way(straight(0.0, 200.0, 300.0), service="yard")
    net, report = sheet.built()
    assert (net.track_count, report.counts["ways_left_out"]) == (1, 1)
    (end,) = report.of_kind("dead_end")
    assert "left out" in end.text
    assert sheet.built(yards=True)[0].track_count == 2
    only = Sheet()
    only.way(straight(0.0, 0.0, 100.0), service="yard")
    with pytest.raises(ConfigError, match="--yards"):
        only.built()


def test_findings_name_what_they_are_about() -> None:
    sheet = Sheet()
    first = sheet.way(straight(0.0, 0.0, 200.0), oneway="yes")
    torn = sheet.way(straight(0.2, 203.0, 400.0), oneway="yes")
    against = sheet.way(straight(0.2, 500.0, 400.0), oneway="yes", maxspeed="fast")
    kinked = sheet.way([(0.0, 90.0), (60.0, 90.0), (60.0, 150.0)])
    contrary = sheet.way(
        straight(300.0, 0.0, 90.0), oneway="yes", railway__preferred_direction="backward"
    )
    _, report = sheet.built()
    (gap,) = report.of_kind("gap")
    assert gap.ways == (first, torn) or gap.ways == (torn, first)
    assert "3.0 m" in gap.text
    nowhere = {finding.nodes for finding in report.of_kind("one_way") if finding.nodes}
    assert nowhere == {(sheet.node(400.0, 0.2),)}
    assert [f.ways for f in report.of_kind("one_way") if not f.nodes] == [(contrary,)]
    (kink,) = report.of_kind("kink")
    assert kink.ways == (kinked,)
    assert kink.nodes == (sheet.node(60.0, 90.0),)
    (tag,) = report.of_kind("tag")
    assert tag.ways == (against,)
    assert "maxspeed=fast" in tag.text
    ends = {finding.nodes for finding in report.of_kind("dead_end")}
    assert (sheet.node(200.0, 0.0),) in ends
    assert (sheet.node(400.0, 0.2),) in ends


def test_sound_map_has_only_its_ends_to_tell(double: tuple[Sheet, Network, Report]) -> None:
    assert set(kinds(double[2])) == {"dead_end"}


# Prague -------------------------------------------------------------------------------------------
@pytest.mark.realdata
def test_prague_has_the_published_figures(prague: Prague) -> None:
    net, told = prague.network, prague.told
    counts = told["counts"]
    assert len(net.node_id) == counts["nodes"] == 941
    assert len(net.edges) == counts["edges"] == 1630
    assert counts["segments"] == 21817
    assert told["opposite_share"] == pytest.approx(0.945, abs=0.015)
    assert told["track_km"] == pytest.approx(312.35, rel=0.003)


@pytest.mark.realdata
def test_curves_of_prague_are_as_good_as_they_say(prague: Prague) -> None:
    net, told = prague.network, prague.told
    assert 0.02 < told["node_std_m"] < 0.2
    for place in ("curves", "bends", "straights"):
        assert told[f"left_out_normalised_{place}"] == pytest.approx(1.0, abs=0.25)
    assert told["jump_p95_m"] < 0.2
    assert told["turn_median_rad"] < math.radians(0.5)
    assert np.all(np.isfinite(net.yaw_std_rad))
    # Prague's steepest track has 9 %; the terrain beside it has walls.
    assert np.nanpercentile(np.abs(np.tan(net.grade_rad)), 99.9) < 0.12
    assert np.all(net.grade_std_rad > 0.002)


@pytest.mark.realdata
def test_prague_loses_no_legal_way_on(prague: Prague) -> None:
    # Where an edge ends although another leaves, the map draws a corner of a right angle or the
    # like: a stub in a depot, and two rings that meet head on.
    ends = [each["text"] for each in prague.of_kind("dead_end")]
    assert sum("angles that no tram takes" in text for text in ends) <= 14


@pytest.mark.realdata
def test_prague_is_small(prague: Prague) -> None:
    assert prague.path.stat().st_size < 5e6
