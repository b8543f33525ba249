"""`tramstream map info`: the figures of a network, and the page to look at it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import TOWN_LINES, town

from tramstream.analysis.report.network_drawing import (
    THIN_M,
    View,
    arrow_rows,
    labels,
    thinned,
    track_rows,
)
from tramstream.analysis.report.network_page import NetworkFigure, Piece
from tramstream.cli.map_info import describe, info
from tramstream.errors import ConfigError
from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.lines import lay_lines
from tramstream.tracks.network import FORWARDS, Network, Way

MM = 1e-3  # m
EVERYWHERE = View(np.array([-1e4, -1e4]), np.array([1e4, 1e4]))
WAYS = (
    Way(0, 0.0, 250.0, 4711, {"maxspeed": "50"}),
    Way(0, 250.0, 600.0, 4712, {"maxspeed": "30", "name": "<b>Street</b>"}),
    Way(4, 0.0, 600.0, 4713, {"layer": "-1"}),
)


@pytest.fixture(scope="module")
def network() -> Network:
    requests = [
        LineRequest("9", "out", ("West", "Far", "West")),
        LineRequest("<8>", "", ("Square", "Branch end")),
    ]
    return lay_lines(town(ways=WAYS), requests)[0]


@pytest.fixture
def file(network: Network, tmp_path: Path) -> Path:
    network.save(tmp_path / "town.net")
    return tmp_path / "town.net"


# Figures ------------------------------------------------------------------------------------------
def test_figures_are_those_of_the_network(network, file, capsys):
    info(file, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    assert figures["tracks"] == len(TOWN_LINES)
    assert figures["edges"] == len(TOWN_LINES) + 1  # one track is gone both ways
    assert figures["track_m"] == pytest.approx(600 + 400 + 300 + 400 + 600 + 500 + 100 + 300)
    assert figures["edge_m"] == pytest.approx(figures["track_m"] + 500)
    assert figures["switches"] == int(network.node_switch.sum())
    assert figures["size_bytes"] == file.stat().st_size
    assert (figures["height_share"], figures["parallel_share"]) == (0.0, 0.0)
    line = figures["lines"][0]
    assert (line["line"], line["direction"], line["stops"]) == ("9", "out", 3)
    assert line["length_m"] == pytest.approx(network.lines[0].length_m)


def test_shares_are_of_length(network):
    height = np.array(network.height)
    height[network.samples_of(0)] = 230.0
    partner = np.array(network.partner)
    partner[network.samples_of(0)] = partner[network.samples_of(4)] = 1
    figures = describe(replace(network, height=height, partner=partner))
    assert figures["height_share"] == pytest.approx(600 / 3200, abs=1e-3)
    assert figures["parallel_share"] == pytest.approx(1200 / 3200, abs=1e-3)


def test_table_tells_what_the_file_holds(file, capsys):
    info(file)
    text = capsys.readouterr().out
    assert "8, 3.2 km" in text
    assert re.search(r"9 +out +West +West +2\.190 +3", text)
    assert "made by hand" in text


# Page ---------------------------------------------------------------------------------------------
def test_page_is_one_file_that_asks_no_network(file, tmp_path):
    out = tmp_path / "town.html"
    info(file, out)
    page = out.read_text()
    assert "default-src 'none'" in page
    text = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"(src|href)=[\"'](?!#)|url\(|@import|<(link|img|iframe)", text)
    assert "Branch end" in text
    assert "<8>" not in text
    assert "&lt;8&gt;" in text
    assert not list(tmp_path.glob("*.part"))


def test_page_that_exists_is_replaced_only_if_asked(file, tmp_path):
    out = tmp_path / "town.html"
    out.write_text("old")
    with pytest.raises(ConfigError, match="exists already"):
        info(file, out)
    assert out.read_text() == "old"
    info(file, out, overwrite=True)
    assert out.read_text() != "old"


def test_network_is_never_overwritten_by_its_page(file):
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="choose another"):
        info(file, file, overwrite=True)
    assert file.read_bytes() == before


def test_network_without_anything_but_tracks_is_drawn(tmp_path):
    town(stops=()).save(tmp_path / "bare.net")
    info(tmp_path / "bare.net", tmp_path / "bare.html")
    assert "No lines" in (tmp_path / "bare.html").read_text()


# What is drawn ------------------------------------------------------------------------------------
def test_thinned_line_stays_near_all_samples_and_keeps_their_chainage():
    turn = np.linspace(0, np.pi, 500)
    path = np.column_stack([200 * turn, 200 * np.cos(turn), 200 * np.sin(turn)])
    thin = thinned(path)
    assert len(thin) < 80
    for column in (1, 2):
        drawn = np.interp(path[:, 0], thin[:, 0], thin[:, column])
        assert np.abs(drawn - path[:, column]).max() < 2 * THIN_M
    np.testing.assert_allclose(200 * np.cos(thin[:, 0] / 200), thin[:, 1], atol=1e-6)


def test_row_of_a_track_says_what_the_map_says_there(network):
    rows = [row for row in track_rows(network, EVERYWHERE) if "471" in row["told"]]
    assert [row["told"] for row in rows] == [
        "way 4711, 50 km/h",
        "way 4712, 30 km/h",
        "way 4713, layer=-1",
    ]
    assert [row["chainage"] for row in rows] == [[0, 250], [250, 600], [0, 600]]
    assert rows[2]["run"] == network.name_of(9)  # gone westwards, so told westwards
    assert rows[2]["east"] == pytest.approx([600, 0], abs=MM)
    assert rows[2]["north"] == pytest.approx([100, 100], abs=MM)


def test_row_of_a_track_tells_the_lines_on_it(network):
    rows = {row["run"]: row for row in track_rows(network, EVERYWHERE)}
    name, zero_m, sign, begin_m, end_m = rows[network.name_of(9)]["lines"][0]
    assert (name, sign) == ("line 9 to West", 1)
    line = network.lines[0]
    assert end_m == pytest.approx(540.0)  # West lies 60 m before the end of the run
    assert end_m - zero_m == pytest.approx(line.length_m, abs=0.1)
    assert begin_m == 0.0
    branch = rows[network.name_of(10)]["lines"]
    assert [each[0] for each in branch] == ["line <8> to Branch end"]


def test_arrows_point_where_trams_go(network):
    arrows = arrow_rows(network, EVERYWHERE)
    street = arrows[(arrows[:, 0] > 0) & (arrows[:, 0] < 1000)]
    eastwards, westwards = (street[np.abs(street[:, 1] - north) < MM] for north in (0.0, 100.0))
    for found, heading in ((eastwards, 0.0), (westwards, np.pi)):
        assert len(found) > 10
        np.testing.assert_allclose(np.cos(found[:, 2] + np.pi / 2), np.cos(heading), atol=1e-6)
    assert not (arrows[:, 1] < -MM).any()  # the branch is gone both ways


def test_stops_of_one_name_share_a_label_where_they_are_neighbours():
    places = np.array([[0.0, 0.0], [10.0, 4.0], [5000.0, 0.0], [20.0, 0.0]])
    names, at = labels(["A", "A", "A", "B"], places)
    assert names == ["A", "A", "B"]
    np.testing.assert_allclose(at, [[5, 2], [5000, 0], [20, 0]])


def test_view_around_a_trace_leaves_far_tracks_out():
    network = town()
    trace = np.array([[10.0, 2.0], [60.0, -1.0]])
    whole, near = (
        len(track_rows(network, NetworkFigure(network, each)._view)) for each in (None, trace)
    )
    assert whole == len(TOWN_LINES)
    assert 0 < near < whole


def test_matched_path_is_coloured_by_its_probability():
    drawing = NetworkFigure(town())
    drawing.tracks()
    drawing.trace(np.array([[0.0, 1.0]]), ["12:00:00"], "fixes")
    drawing.matched(
        [Piece(0, 10.0, 600.0, 0.99), Piece(2, 0.0, 50.0, 0.6), Piece(10, 0.0, 50.0, 0.2)]
    )
    plot = drawing.finish()
    names = [item.label.value for item in plot.legend[0].items]
    assert names == [
        "one way",
        "both ways",
        "fixes",
        "sure, 0.95 and more",
        "likely, 0.5 to 0.95",
        "doubtful, less than 0.5",
    ]
    (sure,) = (item.renderers[0] for item in plot.legend[0].items if item.label.value[:4] == "sure")
    assert sure.data_source.data["chainage"] == [[10.0, 600.0]]
    (east,) = sure.data_source.data["east"]
    assert east == pytest.approx([10.0, 600.0], abs=MM)


def test_rules_have_colours_of_their_own():
    drawing = NetworkFigure(town())
    drawing.tracks()
    drawn = {item.label.value: item.renderers[0] for item in drawing._items}
    assert set(drawn) == {"one way", "both ways"}
    assert drawn["both ways"].data_source.data["rule"] == [3]
    assert FORWARDS in drawn["one way"].data_source.data["rule"]
