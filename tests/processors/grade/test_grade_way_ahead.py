"""The slope ahead: the map's on the likely way, turned as the run is; behind it the last one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import LEVEL, laid, network_of, straight, switch
from slopes import Found, Slopes

from tramstream.config import Map
from tramstream.processors.grade.stopping import PIECE_M, PIECES
from tramstream.processors.grade.way_ahead import WayAhead, known_now
from tramstream.tracks.network import Network

HERE = known_now(0.01, 1e-8, 0.0)


def sloped(network: Network, slopes: list[float], known_to: float = 1.0) -> Network:
    """Each track of one slope, as it is drawn; the share behind `known_to` is not known."""
    grade = np.zeros(len(network.east), np.float32)
    for track, slope in enumerate(slopes):
        part = network.samples_of(track)
        count = part.stop - part.start
        grade[part] = slope
        grade[part][round(known_to * count) :] = np.nan
    return replace(network, grade_rad=grade, grade_std_rad=np.full_like(grade, 0.002))


def one(length_m: float = 300.0, slope: float = 0.03, known_to: float = 1.0) -> Network:
    return sloped(network_of([laid(straight(length_m))]), [slope], known_to)


def test_map_is_taken_forwards_and_turned_backwards() -> None:
    way = WayAhead(one())
    for run, slope in ((0, 0.03), (1, -0.03)):
        ahead = way.of(run, 100.0, HERE)
        count = int(200.0 / PIECE_M)
        np.testing.assert_allclose(ahead.slopes[:count], slope, rtol=1e-6)
        np.testing.assert_allclose(ahead.stds[:count], 0.002, rtol=1e-6)
        assert ahead.mapped_m == pytest.approx(200.0, abs=PIECE_M)
        assert (np.diff(ahead.stds[count:]) > 0.0).all(), "nobody knows what comes behind"


def test_slope_that_the_map_does_not_know_is_the_last_one_known() -> None:
    ahead = WayAhead(one(known_to=0.5)).of(0, 100.0, HERE)
    assert ahead.mapped_m == pytest.approx(50.0, abs=PIECE_M)
    np.testing.assert_allclose(ahead.slopes, 0.03, rtol=1e-6)
    unknown = WayAhead(one(known_to=0.0)).of(0, 100.0, HERE)
    assert unknown.mapped_m == 0.0
    np.testing.assert_array_equal(unknown.slopes, HERE.slopes)


def test_way_goes_on_over_the_straighter_branch() -> None:
    made = switch()
    count = made.network.track_count
    network = sloped(made.network, [0.01 * (track + 1) for track in range(count)])
    way = WayAhead(network)
    for run in range(2 * count):
        following = network.following_of(run)
        if len(following) < 2:
            continue
        ahead = way.of(run, float(network.length_m[run >> 1]) - 1.0, HERE)
        bends = [
            abs(float(network.curvature_per_m[network.samples_of(int(f) >> 1)].max()))
            for f in following
        ]
        straighter = int(following[int(np.argmin(bends))])
        slope = 0.01 * ((straighter >> 1) + 1) * (-1.0 if straighter & 1 else 1.0)
        assert ahead.slopes[1] == pytest.approx(slope, rel=1e-5)
        return
    raise AssertionError("a switch has two ways")


def test_run_that_the_network_does_not_have_is_no_way() -> None:
    assert WayAhead(one()).of(99, 0.0, HERE) is HERE


def test_bend_of_now_is_forgotten_ahead_and_certainty_too() -> None:
    ahead = known_now(0.0, 1e-8, 5e-4)
    assert 0.0 < ahead.slopes[0] < ahead.slopes[20] < 5e-4 * 60.0
    assert ahead.stds[0] < 5e-4
    assert 0.005 < ahead.std_at(100.0) < 0.02
    assert ahead.std_at(1e6) == ahead.stds[PIECES - 1]


def test_matched_vehicle_stops_on_the_maps_slope(tmp_path: Path) -> None:
    path = tmp_path / "one.tracks"
    one(length_m=4000.0, slope=-0.05).save(path)
    ride = Slopes(duration_s=40.0, matched=True)
    told: Any = {"map": Map(network=str(path))}

    class Mapped(Slopes):
        @property
        def vehicle(self) -> Any:
            from msgspec.structs import replace as with_

            return with_(ride.vehicle, **told)

    moving = [e for e in Found(Mapped(duration_s=40.0, matched=True)).stops if e.speed_mps > 11.9]
    assert moving
    for each in moving:
        assert each.mapped_m == PIECE_M * PIECES
        expected = each.speed_mps**2 / 2.0 / (1.0 - 9.81 * np.sin(0.05))
        assert each.stops[0].distance_m == pytest.approx(expected, rel=1e-4)
    assert LEVEL.height_m == 250.0
