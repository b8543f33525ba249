"""What one ride says of the cells it went over, and which records are rides at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from graded import Going, hills, places_of, states_of, straight_track, write_smoothed
from networks import LEVEL, switch, town

from tramstream import config_file
from tramstream.analysis.grade_map import record
from tramstream.analysis.grade_map.cells import CELL_M, cells_of
from tramstream.analysis.grade_map.passes import Passes, Ride, Way, passes_of
from tramstream.analysis.grade_map.record import Refused, level_ground, why_anew
from tramstream.analysis.grade_map.slope import NOD_STD, nod_of, slope_of
from tramstream.config import Map, Vehicle
from tramstream.recorder.identity import ENTRY, identity_of
from tramstream.recorder.reader import open_record
from tramstream.tracks.grades import GRADES_ENTRY
from tramstream.tracks.network import Network

CELL_ERROR_RAD = 5e-4
"""Of a mean over a cell by steps of a metre, where the slope changes by 0.3 % over it."""


def gone(network: Network, going: Going, **changed: float) -> tuple[Passes, Way]:
    states = states_of(network, going)
    places = [place._replace(**changed) for place in places_of(network, going, states)]
    passes, way, _ = passes_of(network, cells_of(network), states, places)
    return passes, way


def error(network: Network, passes: Passes) -> np.ndarray:
    return passes.grade_rad - hills(network)[0][passes.cell]


# Cells --------------------------------------------------------------------------------------------
def test_cells_divide_every_track_evenly() -> None:
    network = town()
    cells = cells_of(network)
    counts = np.diff(cells.starts)
    np.testing.assert_allclose(counts * cells.width_m, network.length_m)
    assert np.abs(cells.width_m - CELL_M).max() < CELL_M / 2
    track = np.repeat(np.arange(network.track_count), 2)
    ends = np.column_stack([0 * network.length_m, network.length_m]).ravel()
    found = cells.at(track, ends).reshape(-1, 2)
    np.testing.assert_array_equal(found[:, 0], cells.starts[:-1])
    np.testing.assert_array_equal(found[:, 1], cells.starts[1:] - 1)
    np.testing.assert_array_equal(cells.track_of(found.ravel()), track)


@pytest.mark.parametrize("backing", [False, True])
@pytest.mark.parametrize("run", [0, 1])
def test_slope_is_the_tracks_whichever_way_tram_goes_and_looks(run: int, backing: bool) -> None:
    network = straight_track()
    passes, way = gone(network, Going((run,), backing=backing))
    assert len(passes.cell) in range(98, 102)
    assert set(passes.sign) == {1 if (run == 0) != backing else -1}
    assert np.abs(error(network, passes)).max() < CELL_ERROR_RAD
    assert way.contradicting == way.off_map == 0.0
    np.testing.assert_allclose(passes.height_m, hills(network)[1][passes.cell], atol=0.1)


def test_ride_over_several_tracks_meets_the_cells_of_each() -> None:
    network = switch().network
    passes, _ = gone(network, Going((0, 4), length_m=420.0))
    assert set(cells_of(network).track_of(passes.cell).tolist()) == {0, 2}
    assert np.abs(error(network, passes)).max() < 4 * CELL_ERROR_RAD


def test_rules_of_the_map_do_not_tell_the_direction() -> None:
    """A wrong one-way tag: the tram goes against it, and what is uphill stays uphill."""
    network = town()  # track 0 is one way, as it is drawn
    passes, way = gone(network, Going((1,)))
    assert set(passes.sign) == {-1}
    assert np.abs(error(network, passes)).max() < CELL_ERROR_RAD
    assert way.contradicting == 0.0


def test_match_to_the_run_the_other_way_says_nothing() -> None:
    """The heading is not that of the run: which is wrong cannot be told."""
    network = straight_track()
    going = Going((0,))
    states = states_of(network, going)
    length = float(network.length_m[0])
    turned = [
        place._replace(run=1, chainage_m=length - place.chainage_m)
        for place in places_of(network, going, states)
    ]
    passes, way, _ = passes_of(network, cells_of(network), states, turned)
    assert len(passes.cell) == 0
    assert way.contradicting == pytest.approx(way.whole)


def test_nothing_below_the_least_probability_counts() -> None:
    passes, way = gone(straight_track(), Going((0,)), probability=0.985)
    assert len(passes.cell) == 0
    assert way.doubtful == pytest.approx(way.whole)


def test_probability_is_a_weight() -> None:
    sure, _ = gone(straight_track(), Going((0,)))
    less, _ = gone(straight_track(), Going((0,)), probability=0.99)
    np.testing.assert_allclose(less.std_rad**2, sure.std_rad**2 / 0.99, rtol=1e-5)


def test_states_off_the_map_say_nothing_of_it() -> None:
    passes, way = gone(straight_track(), Going((0,)), run=-1)
    assert len(passes.cell) == 0
    assert way.off_map == pytest.approx(way.whole)


def test_states_of_a_cell_are_no_more_sure_together_than_each_of_them() -> None:
    passes, _ = gone(straight_track(), Going((0,)))
    assert float(passes.std_rad.min()) >= 5e-4


# The body's nod -----------------------------------------------------------------------------------
@pytest.mark.parametrize("nod", [0.0, 0.005])
def test_nod_is_found_and_taken_out(nod: float) -> None:
    """0.3 deg per m/s² under 1 m/s²: 0.5 % of slope that is none."""
    network = straight_track()
    going = Going((0,), nod=nod, stop_every_m=160.0, length_m=1800.0)
    states = states_of(network, going)
    slope = slope_of(states)
    assert abs(slope.nod.value - nod) < 3 * slope.nod.std
    assert slope.nod.std < NOD_STD / 10
    passes, _ = gone(network, going)
    assert float(np.sqrt(np.mean(error(network, passes) ** 2))) < 1e-3


def test_nod_of_a_ride_that_never_accelerates_is_not_known() -> None:
    network = straight_track()
    found = nod_of(states_of(network, Going((0,), length_m=100.0)))
    assert found.std > NOD_STD / 2


# Records ------------------------------------------------------------------------------------------
def vehicle(network: str = "") -> Vehicle:
    return Vehicle(vehicle="4711", map=Map(network=network) if network else None)


@pytest.mark.parametrize(
    ("metadata", "anew"),
    [
        ({GRADES_ENTRY: "none"}, ""),
        ({GRADES_ENTRY: "1f2e"}, "held to the grades 1f2e"),
        ({}, "does not say to which grades"),
        ({"config": config_file.to_json(vehicle())}, ""),
        ({"config": config_file.to_json(vehicle("a.net"))}, "does not say to which grades"),
    ],
)
def test_states_count_as_they_are_where_no_grades_were_in_them(tmp_path, metadata, anew) -> None:
    going = Going((0,), length_m=60.0)
    path = write_smoothed(tmp_path / "a.mcap", states_of(straight_track(), going), metadata)
    text = metadata.get("config")
    with open_record(path) as opened:
        told = why_anew(opened, msgspec.json.decode(text, type=Vehicle) if text else None)
    assert anew in told
    assert bool(told) == bool(anew)


def test_ride_is_known_by_its_content_and_by_what_it_was_made_from(tmp_path: Path) -> None:
    states = states_of(straight_track(), Going((0,), length_m=60.0))
    one = write_smoothed(tmp_path / "a.mcap", states)
    other = write_smoothed(tmp_path / "b.mcap", states, seed=1)
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(one.read_bytes())
    digests = []
    for path in (one, other, copy):
        with open_record(path) as opened:
            digests.append(identity_of(opened))
    assert digests[0] == digests[2] != digests[1]
    made = write_smoothed(tmp_path / "made.mcap", states, {ENTRY: digests[0]})
    with open_record(made) as opened:
        assert identity_of(opened) == digests[0]


def test_network_for_smoothing_has_no_grades() -> None:
    network = straight_track()
    level = np.zeros(len(network.east), np.float32)
    steep = replace(network, grade_rad=level + np.float32(0.03), grade_std_rad=level + 1)
    assert np.isnan(level_ground(steep).grade_rad).all()
    assert level_ground(steep).height_m == LEVEL.height_m


def test_refusal_says_which_record_and_why() -> None:
    assert Refused("a.mcap", "", "why")._asdict()["why"] == "why"


def test_ride_that_was_held_to_grades_is_smoothed_anew_without_them(tmp_path, monkeypatch) -> None:
    """The processors get the network without grades, whatever the record's own one had."""
    network = straight_track()
    level_net = tmp_path / "level.net"
    level_ground(network).save(level_net)
    going = Going((0,), length_m=200.0)
    metadata = {GRADES_ENTRY: "1f2e", "config": config_file.to_json(vehicle("steep.net"))}
    path = write_smoothed(tmp_path / "a.mcap", states_of(network, going), metadata, inertial=True)
    asked = {}

    def rerun(source: Path, out: Path, config: Vehicle, **wishes: bool) -> SimpleNamespace:
        asked.update(wishes, source=source, network=config.map.network)
        write_smoothed(out, states_of(network, going))
        return SimpleNamespace(damaged="")

    monkeypatch.setattr(record, "rerun", rerun)
    ride = record.ride_of(path, level_net)
    assert isinstance(ride, Ride), ride
    assert ride.smoothed
    assert asked == {"fresh": True, "smooth": True, "source": path, "network": str(level_net)}
    assert np.abs(error(network, ride.passes)).max() < CELL_ERROR_RAD
