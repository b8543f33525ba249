"""Grades of a map in a network: where they are, which way they point, what they leave alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graded import hills, passing, straight_track
from networks import BOTH, laid, network_of, straight

from tramstream.analysis.grade_map.assemble import assemble
from tramstream.analysis.grade_map.cells import cells_of
from tramstream.analysis.grade_map.heights import Priors
from tramstream.analysis.grade_map.summary import track_grades
from tramstream.mapping.grades import Laid, TrackGrades, lay
from tramstream.tracks.grades import NO_GRADES, digest_in
from tramstream.tracks.network import Network, load


def told(cells: slice = slice(None)) -> list[TrackGrades]:
    network = straight_track()
    rides = [passing(network, k, 1 - 2 * (k % 2), noise_rad=1e-4, cells=cells) for k in range(4)]
    return track_grades(assemble(network, rides, Priors((), 0.0)))


def put(network: Network, tracks: list[TrackGrades]) -> Laid:
    return lay(network, tracks, "grades of 4 rides (a.parquet)")


def true_slope(network: Network) -> np.ndarray:
    cells = cells_of(network)
    middle = (np.arange(cells.starts[-1]) + 0.5) * cells.width_m[0]
    at = np.arange(len(network.east)) * float(network.spacing_m[0])
    return np.interp(at, middle, hills(network)[0])


def test_every_sample_has_its_cells_slope_and_deviation() -> None:
    found = put(straight_track(), told())
    assert (found.samples, found.unknown) == (len(found.network.east), ())
    np.testing.assert_allclose(found.network.grade_rad, true_slope(found.network), atol=1.5e-3)
    assert np.all(found.network.grade_std_rad > 0)
    assert np.isfinite(found.network.height).all()
    assert "grades of 4 rides" in found.network.source


def test_what_the_map_does_not_cover_stays_as_it_was() -> None:
    network = straight_track()
    level = np.full(len(network.east), 0.01, np.float32)
    terrain = replace(network, grade_rad=level, grade_std_rad=level * 2, height=level + 300)
    found = put(terrain, told(slice(100, 200))).network
    np.testing.assert_array_equal(found.grade_rad[:490], level[:490])
    np.testing.assert_array_equal(found.grade_std_rad[1010:], level[1010:] * 2)
    np.testing.assert_allclose(found.grade_rad[505:995], true_slope(network)[505:995], atol=1.5e-3)


def test_track_that_is_drawn_the_other_way_now_has_the_same_hills() -> None:
    line = laid(straight(2000.0))
    end = line.position_l(2000.0)[:2]
    turned = network_of([laid(straight(2000.0), end.tolist(), 0.35 + np.pi)], rules=[BOTH])
    turned = replace(turned, node_id=turned.node_id[::-1].copy())
    found = put(turned, told()).network
    np.testing.assert_allclose(found.grade_rad, -true_slope(straight_track())[::-1], atol=1.5e-3)


@pytest.mark.parametrize("length_m", [1900.0, 2100.0])
def test_track_of_another_length_is_another_track(length_m: float) -> None:
    found = put(straight_track(length_m), told())
    assert (found.samples, len(found.unknown)) == (0, 1)
    assert np.isnan(found.network.grade_rad).all()
    assert "grades of" not in found.network.source


def test_network_with_them_is_saved_and_its_records_will_say_so(tmp_path: Path) -> None:
    found = put(straight_track(), told()).network
    found.save(tmp_path / "a.net")
    np.testing.assert_array_equal(load(tmp_path / "a.net").grade_rad, found.grade_rad)
    assert digest_in(tmp_path / "a.net") != NO_GRADES
