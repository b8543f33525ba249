"""Signatures of lines: out of a network, an exact line, and a file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import LEVEL

from tramstream.errors import ConfigError
from tramstream.lines.line import Line, Segment, built_in_line, curve
from tramstream.processors.warm_up import one_track
from tramstream.tracks import signature, signature_file
from tramstream.tracks.network import LineStop, Network, RouteLine
from tramstream.tracks.signature import Signature, of_line

DEGREE = math.radians(1.0)


def network_of(line: Line, runs: tuple[int, ...]) -> Network:
    stops = (LineStop("A", 0.0), LineStop("B", 300.0))
    route = RouteLine("7", "0", "A", "B", runs, 20.0, 300.0, stops)
    return replace(one_track(line), lines=(route,))


def test_line_of_a_network_has_the_headings_of_its_tracks() -> None:
    line = built_in_line()
    (found,) = signature.of_network(network_of(line, (0,)))
    at = np.arange(301.0)
    turned = found.yaw_at(at) - found.yaw_at(0.0)
    exact = line.yaw_rad(at + 20.0) - line.yaw_rad(20.0)
    np.testing.assert_allclose(turned, exact, atol=0.01 * DEGREE)
    assert found.stop_names == ("A", "B")
    assert found.name == "7/0"


def test_line_that_goes_backwards_over_a_track_turns_the_other_way() -> None:
    line = built_in_line()
    network = network_of(line, (1,))
    (found,) = signature.of_network(network)
    length = float(network.length_m[0])
    at = np.arange(301.0)
    turned = found.yaw_at(at) - found.yaw_at(0.0)
    exact = line.yaw_rad(length - 20.0 - at) - line.yaw_rad(length - 20.0)
    np.testing.assert_allclose(turned, exact, atol=0.02 * DEGREE)
    assert np.hypot(*(found.plan[0] - found.plan[300])) > 1e-6


def test_lines_are_chosen_by_name_or_by_direction() -> None:
    network = network_of(built_in_line(), (0,))
    assert len(signature.of_network(network, ["7"])) == 1
    assert len(signature.of_network(network, ["7/0"])) == 1
    assert not signature.of_network(network, ["7/1"])


def test_body_on_bogies_turns_later_and_softer_than_the_track() -> None:
    """Its heading is that of the chord between its bogies, against exact geometry."""
    pieces = [Segment(60.0), *curve(25.0, 1.2), Segment(60.0)]
    line = Line(pieces, [0.0, 100.0], LEVEL)
    seen = of_line(line).seen_by(3.2, 6.4)
    at = np.arange(10.0, 140.0)
    front, rear = line.position_l(at)[:, :2], line.position_l(at - 6.4)[:, :2]
    chord = np.unwrap(np.arctan2(*(front - rear).T[::-1]))
    off = seen[10:140] - chord
    assert np.max(np.abs(off - off[0])) < 0.5 * DEGREE


def test_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    one = replace(of_line(built_in_line(), "7", "1"), rides=3, yaw_std_rad=0.011)
    signature_file.save(one, tmp_path / "line.signature")
    other = signature_file.load(tmp_path / "line.signature")
    np.testing.assert_array_equal(one.yaw_rad, other.yaw_rad)
    np.testing.assert_array_equal(one.stops_m, other.stops_m)
    assert (other.line, other.direction, other.rides) == ("7", "1", 3)
    assert other.stop_names == one.stop_names


def test_damaged_file_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "line.signature"
    short = Signature("7", "0", np.linspace(0.0, 1.0, 50), np.array([0.0, 40.0]))
    signature_file.save(short, path)
    whole = path.read_bytes()
    for cut in range(0, len(whole), 97):
        path.write_bytes(whole[:cut])
        with pytest.raises(ConfigError, match="signature"):
            signature_file.load(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        signature_file.load(tmp_path / "none")
    signature_file.save(replace(short, yaw_rad=np.full(50, np.nan)), path)
    with pytest.raises(ConfigError, match="damaged"):
        signature_file.load(path)
