"""Which rails join which: small maps whose answer is plain, and Prague counted another way."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tramstream.mapping.extract import read
from tramstream.mapping.osm import OsmWay
from tramstream.mapping.topology import Topology, contract, join
from tramstream.tracks.network import BACKWARDS, FORWARDS

BOTH = FORWARDS | BACKWARDS


def way(osm_id: int, *nodes: int, **tags: str) -> OsmWay:
    return OsmWay(osm_id, nodes, {"railway": "tram", **tags})


def test_ways_are_joined_where_nothing_parts() -> None:
    (chain,) = contract([way(1, 1, 2, 3, oneway="yes"), way(2, 3, 4, oneway="yes")])
    assert chain.nodes == (1, 2, 3, 4)
    assert chain.ways == (1, 1, 2)
    assert chain.rules == FORWARDS


def test_track_used_both_ways_is_one_track() -> None:
    (chain,) = contract([way(1, 1, 2, 3)])
    assert chain.rules == BOTH
    (pair,) = contract([way(1, 1, 2, oneway="yes"), way(2, 2, 1, oneway="yes")])
    assert pair.rules == BOTH


@pytest.mark.parametrize("oneway", ["-1", "reverse"])
def test_one_way_against_its_drawing_is_drawn_as_it_is_used(oneway: str) -> None:
    (chain,) = contract([way(1, 1, 2, 3, oneway=oneway)])
    assert chain.nodes == (3, 2, 1)
    assert chain.rules == FORWARDS


@pytest.mark.parametrize("oneway", ["no", "reversible", "alternating", "nonsense"])
def test_other_values_of_oneway_mean_both(oneway: str) -> None:
    (chain,) = contract([way(1, 1, 2, oneway=oneway)])
    assert chain.rules == BOTH


def test_rules_change_at_a_node() -> None:
    chains = contract([way(1, 1, 2, 3, oneway="yes"), way(2, 3, 4, 5)])
    assert [(chain.nodes, chain.rules) for chain in chains] == [
        ((1, 2, 3), FORWARDS),
        ((3, 4, 5), BOTH),
    ]


def test_switch_parts_three_tracks() -> None:
    chains = contract([way(1, 1, 2, 3, 4, 5, oneway="yes"), way(2, 3, 6, oneway="yes")])
    assert {chain.nodes for chain in chains} == {(1, 2, 3), (3, 4, 5), (3, 6)}


def test_ring_that_nothing_joins_is_a_track_from_its_first_node() -> None:
    for tags in ({"oneway": "yes"}, {}):
        (chain,) = contract([way(1, 1, 2, 3, **tags), way(2, 3, 4, 1, **tags)])
        assert chain.nodes[0] == chain.nodes[-1]
        assert len(chain.nodes) == 5


def test_loop_from_a_switch_back_to_it_is_one_track() -> None:
    chains = contract([way(1, 9, 1), way(2, 1, 2, 3, 4, 1, oneway="yes")])
    assert {chain.nodes for chain in chains} == {(9, 1), (1, 2, 3, 4, 1)}


def test_two_tracks_between_the_same_nodes_stay_two() -> None:
    chains = contract([way(1, 8, 1), way(2, 1, 2, 5), way(3, 1, 3, 5), way(4, 5, 9)])
    assert len(chains) == 4
    assert {(1, 2, 5), (1, 3, 5)} <= {chain.nodes for chain in chains}


# Runs that follow runs ----------------------------------------------------------------------------
def joined(plan: dict[int, tuple[float, float]], *ways: OsmWay) -> Topology:
    return join(contract(ways), plan)


def names(topology: Topology) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Pairs of runs, each by the nodes that it goes from and to."""
    return {
        (topology.run_ends(run), topology.run_ends(other))
        for run, ahead in enumerate(topology.following)
        for other in ahead
    }


def test_switch_lets_runs_part_but_not_turn_back() -> None:
    plan = {1: (-20.0, 0.0), 2: (0.0, 0.0), 3: (20.0, 0.0), 4: (15.0, 5.0)}
    topology = joined(plan, way(1, 1, 2), way(2, 2, 3), way(3, 2, 4))
    assert names(topology) == {
        ((1, 2), (2, 3)),
        ((1, 2), (2, 4)),
        ((3, 2), (2, 1)),
        ((4, 2), (2, 1)),
    }
    (stem,) = [run for run in range(6) if topology.run_ends(run) == (1, 2)]
    assert topology.run_ends(topology.following[stem][0]) == (2, 3)  # straightest first
    assert topology.turn_rad[stem, topology.following[stem][1]] == pytest.approx(math.atan(1 / 3))


def test_rails_are_followed_whatever_the_rules() -> None:
    plan = {1: (-20.0, 0.0), 2: (0.0, 0.0), 3: (20.0, 0.0)}
    topology = joined(plan, way(1, 1, 2, oneway="yes"), way(2, 2, 3))
    assert ((3, 2), (2, 1)) in names(topology)


@pytest.mark.parametrize("angle_deg", [30.0, 40.0, 60.0, 90.0])
def test_tracks_that_cross_at_a_node_are_no_switch(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    east, north = 20 * math.cos(angle), 20 * math.sin(angle)
    plan = {1: (-20.0, 0.0), 2: (20.0, 0.0), 3: (-east, -north), 4: (east, north), 5: (0.0, 0.0)}
    topology = joined(plan, way(1, 1, 5, 2), way(2, 3, 5, 4))
    assert names(topology) == {
        ((1, 5), (5, 2)),
        ((2, 5), (5, 1)),
        ((3, 5), (5, 4)),
        ((4, 5), (5, 3)),
    }


def test_direction_is_taken_over_metres_since_nodes_are_noisy() -> None:
    # The last node before the switch lies 0.3 m beside the track, 0.3 m from the switch.
    plan = {1: (-20.0, 0.0), 2: (-0.3, 0.3), 3: (0.0, 0.0), 4: (20.0, 0.0), 5: (20.0, 5.0)}
    topology = joined(plan, way(1, 1, 2, 3), way(2, 3, 4), way(3, 3, 5))
    assert {((1, 3), (3, 4)), ((1, 3), (3, 5))} <= names(topology)


def test_loop_may_follow_itself_but_never_its_own_reverse() -> None:
    plan = {k: (30 * math.cos(k * 0.4), 30 * math.sin(k * 0.4)) for k in range(16)}
    ring = tuple(range(15))
    topology = joined(plan, way(1, *ring, 15, 0, oneway="yes"))
    assert topology.following == ((0,), (1,))


# Prague -------------------------------------------------------------------------------------------
@pytest.mark.realdata
def test_prague_has_the_published_counts(data_dir: Path) -> None:
    extract = read([data_dir / "maps" / "prague" / "prague_tram_ways_overpass.json"])
    ways = [each for each in extract.ways.values() if each.tags.get("service") != "yard"]
    chains = contract(ways)
    assert len({chain.nodes[0] for chain in chains} | {chain.nodes[-1] for chain in chains}) == 941
    assert sum(chain.rules.bit_count() for chain in chains) == 1630
    segments = sum(len(chain.ways) * chain.rules.bit_count() for chain in chains)
    assert segments == 21817
    # Counted from the ways: every stretch between two nodes, once for each direction of use.
    used = set()
    for each in ways:
        for a, b in zip(each.nodes, each.nodes[1:], strict=False):
            used |= {(a, b)} if each.tags.get("oneway") == "yes" else {(a, b), (b, a)}
    assert segments == len(used)
