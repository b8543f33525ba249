"""The network as the page draws it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from networks import Made, crossover, curved, town
from numpy.typing import NDArray

from tramstream.tracks.network import LineStop, RouteLine
from tramstream.web.rails import drawing

Array = NDArray[np.float64]


@pytest.mark.parametrize("made", [curved(), crossover()])
def test_drawn_tracks_lie_on_the_rails_with_few_points(made: Made) -> None:
    network = made.network
    drawn = drawing(network)["tracks"]
    assert len(drawn) == network.track_count
    for track, units in enumerate(drawn):
        geodetic = np.cumsum(np.array(units, float).reshape(-1, 2), axis=0) / 1e7
        plan = network.plan_of(np.radians(geodetic))
        part = network.samples_of(track)
        rail = np.column_stack([network.east[part], network.north[part]])
        assert len(plan) <= max(0.8 * len(rail), 3)
        np.testing.assert_allclose(plan[[0, -1]], rail[[0, -1]], atol=0.02)
        assert max(beside(place, plan) for place in rail) < 0.05


def beside(place: Array, polyline: Array) -> float:
    """Distance of a place from a polyline."""
    begins, ways = polyline[:-1], np.diff(polyline, axis=0)
    share = np.sum((place - begins) * ways, axis=1) / np.sum(ways**2, axis=1)
    nearest = begins + np.clip(share, 0, 1)[:, None] * ways
    return float(np.min(np.hypot(*(place - nearest).T)))


def test_stops_and_lines_are_told_by_name_and_chainage() -> None:
    network = town()
    line = RouteLine("7", "0", "Depot", "Park", (0,), 10.0, 50.0, (LineStop("Park", 40.0),))
    found = drawing(dataclasses.replace(network, lines=(line,)))
    assert [name for name, _, _ in found["stops"]] == [stop.name for stop in network.stops]
    for (_, latitude_deg, longitude_deg), stop in zip(found["stops"], network.stops, strict=True):
        plan = network.plan_of(np.radians([latitude_deg, longitude_deg]))
        part = network.samples_of(stop.track)
        at = round(stop.chainage_m / float(network.spacing_m[stop.track]))
        sample = part.start + min(at, part.stop - part.start - 1)
        assert np.hypot(*(plan - [network.east[sample], network.north[sample]])) < 1.0
    (told,) = found["lines"]
    assert told["stops"] == [["Park", 40.0]]
    assert (told["line"], told["destination"], told["length_m"]) == ("7", "Park", 50.0)


def test_profile_of_a_line_is_that_of_its_runs_in_the_order_in_which_they_are_gone() -> None:
    network = curved().network
    part = network.samples_of(0)
    rising = network.height.copy()
    rising[part] = np.linspace(200.0, 210.0, part.stop - part.start)
    length_m = float(network.length_m[0])
    for run, begin, end in ((0, 200.0, 210.0), (1, 210.0, 200.0)):
        line = RouteLine("7", "0", "a", "b", (run,), 0.0, length_m, ())
        found = drawing(dataclasses.replace(network, lines=(line,), height=rising))
        (told,) = found["lines"]
        assert told["heights_m"][0] == pytest.approx(begin, abs=0.1)
        assert told["heights_m"][-1] == pytest.approx(end, abs=0.1)


def test_heights_that_are_not_known_make_no_profile() -> None:
    network = curved().network
    unknown = np.full_like(network.height, np.nan)
    line = RouteLine("7", "0", "a", "b", (0,), 0.0, 20.0, ())
    found = drawing(dataclasses.replace(network, lines=(line,), height=unknown))
    assert found["lines"][0]["heights_m"] == []
