"""Many rides merged: what comes out is true, as sure as it says, and the same in any order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graded import BIAS_RAD, NOISE_RAD, STD_RAD, hills, passing, straight_track
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import town

from tramstream.analysis.grade_map import file
from tramstream.analysis.grade_map.assemble import GradeMap, assemble, rides_of
from tramstream.analysis.grade_map.heights import Priors
from tramstream.analysis.grade_map.passes import Ride
from tramstream.analysis.grade_map.verdicts import VEHICLE_BIAS_STD_RAD, medians
from tramstream.errors import ConfigError

NOTHING = Priors((), 0.0)
GEOID_M = 44.5
SAME = 1e-9
"""Whatever the order of rides, rad and m."""
PITCH_OFF_RAD = 0.0175
"""An IMU that is mounted 1 deg off in pitch."""


def made(*rides: Ride, length_m: float = 2000.0) -> GradeMap:
    return assemble(straight_track(length_m), rides, NOTHING)


def errors(found: GradeMap, length_m: float = 2000.0) -> np.ndarray:
    network = straight_track(length_m)
    grade, _ = hills(network)
    return found.columns["grade_rad"] - grade[found.columns["cell"]]


def assert_same(one: GradeMap, other: GradeMap) -> None:
    assert one.track == other.track
    assert [ride.digest for ride in one.rides] == [ride.digest for ride in other.rides]
    assert [ride.out for ride in one.rides] == [ride.out for ride in other.rides]
    for name, column in one.columns.items():
        np.testing.assert_allclose(column, other.columns[name], rtol=0, atol=SAME, err_msg=name)
    for name, column in one.passes.items():
        np.testing.assert_array_equal(column, other.passes[name])


# Truth --------------------------------------------------------------------------------------------
def test_rides_both_ways_find_the_slopes_as_well_as_they_say() -> None:
    """Biases as wide as is said of them, one vehicle a ride: NEES over two dozen maps."""
    nees = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        spread = float(np.hypot(BIAS_RAD, VEHICLE_BIAS_STD_RAD))
        rides = [
            passing(straight_track(), 10 * seed + k, 1 - 2 * (k % 2), spread * rng.normal())
            for k in range(4)
        ]
        found = made(*rides)
        nees.append(float(np.mean((errors(found) / found.columns["grade_std_rad"]) ** 2)))
    assert 0.7 < np.mean(nees) < 1.4


def test_bias_of_a_vehicle_that_goes_both_ways_is_no_slope() -> None:
    """What is uphill for the one way is downhill for the other; the accelerometer's bias is not."""
    bias = 2 * VEHICLE_BIAS_STD_RAD
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2), bias, vehicle="1") for k in range(6)]
    found = made(*rides)
    assert abs(float(np.mean(errors(found)))) < 0.1 * bias
    told = [ride.bias_rad for ride in found.rides]
    np.testing.assert_allclose(told, bias, atol=0.2 * bias)


def test_bias_of_a_vehicle_that_goes_one_way_is_owned_up_to() -> None:
    """No number of its rides makes a slope better known than its mounting is."""
    rides = [passing(straight_track(), k, vehicle="1") for k in range(12)]
    assert float(np.median(made(*rides).columns["grade_std_rad"])) > VEHICLE_BIAS_STD_RAD


def test_states_of_one_ride_are_one_witness() -> None:
    one = made(passing(straight_track(), 1))
    assert float(one.columns["grade_std_rad"].min()) >= STD_RAD
    assert set(one.columns["passes"]) == {1}


def test_slope_is_that_of_the_track_as_drawn() -> None:
    """A ride against it gives the same map as one along it."""
    along, against = (made(passing(straight_track(), 3, sign, noise_rad=1e-5)) for sign in (1, -1))
    np.testing.assert_allclose(errors(along), 0.0, atol=5e-5)
    np.testing.assert_allclose(errors(against), 0.0, atol=5e-5)
    assert set(against.columns["backwards"]) == {1}


def test_counts_days_and_chi2_are_of_the_rides_in_use() -> None:
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2)) for k in range(8)]
    found = made(*rides)
    columns = found.columns
    assert set(columns["rides"]) == {8}
    assert (set(columns["forwards"]), set(columns["backwards"])) == ({4}, {4})
    assert set(columns["first_utc_ns"]) == {rides[0].start_utc_ns}
    assert set(columns["last_utc_ns"]) == {rides[-1].start_utc_ns}
    assert float(np.sum(columns["chi2"]) / np.sum(columns["passes"] - 1)) == pytest.approx(
        1, abs=0.2
    )


# Order --------------------------------------------------------------------------------------------
@given(st.permutations(range(5)))
@settings(max_examples=10, deadline=None)
def test_map_does_not_depend_on_the_order_of_rides(order: list[int]) -> None:
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2)) for k in range(4)]
    rides.append(passing(straight_track(), 4, bias_rad=PITCH_OFF_RAD))
    assert_same(made(*rides), made(*(rides[k] for k in order)))


@given(st.integers(1, 5))
@settings(max_examples=5, deadline=None)
def test_map_that_rides_are_added_to_is_the_one_made_at_once(tmp_path_factory, first: int) -> None:
    network, path = straight_track(), tmp_path_factory.mktemp("map") / "map.parquet"
    rides = [passing(network, k, 1 - 2 * (k % 2)) for k in range(5)]
    rides.append(passing(network, 5, bias_rad=PITCH_OFF_RAD))
    file.write(made(*rides[:first]), path)
    added = assemble(network, [*rides_of(file.read(path), network), *rides[first:]], NOTHING)
    assert_same(made(*rides), added)


def test_ride_that_was_rejected_comes_back_when_others_bear_it_out() -> None:
    """Two who are wrong together reject one who is right, until the right ones are more."""
    network = straight_track()
    wrong = [passing(network, k, bias_rad=PITCH_OFF_RAD) for k in range(2)]
    right = [passing(network, k) for k in range(2, 6)]
    assert [ride.name for ride in made(*wrong, right[0]).rides if ride.out] == [right[0].name]
    found = made(*wrong, *right)
    assert {ride.name for ride in found.rides if ride.out} == {ride.name for ride in wrong}
    assert_same(found, made(*right, *wrong))


# Outliers -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("bias", [PITCH_OFF_RAD, -PITCH_OFF_RAD, 0.0102])
def test_ride_with_a_wrong_mounting_or_accelerometer_is_named_and_out(sign, bias) -> None:
    """1 deg of pitch, and 0.1 m/s² of bias, among two good rides."""
    rides = [passing(straight_track(), 1), passing(straight_track(), 2, -1)]
    found = made(*rides, passing(straight_track(), 3, sign, bias))
    (out,) = (ride for ride in found.rides if ride.out)
    assert out.name == "ride3.mcap"
    assert "mounting of the IMU in pitch" in out.out
    assert out.bias_rad == pytest.approx(bias, abs=2e-3)
    assert set(found.columns["passes"]) == {2}
    assert float(np.std(errors(found))) < STD_RAD


def test_of_two_rides_that_contradict_each_other_none_is_out() -> None:
    found = made(passing(straight_track(), 1), passing(straight_track(), 2, bias_rad=PITCH_OFF_RAD))
    assert not any(ride.out for ride in found.rides)


def test_ride_that_scatters_is_out_and_named() -> None:
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2)) for k in range(4)]
    wild = passing(straight_track(), 9, noise_rad=10 * NOISE_RAD)
    stated = wild.passes._replace(std_rad=rides[0].passes.std_rad)
    found = made(*rides, replace(wild, passes=stated))
    (out,) = (ride for ride in found.rides if ride.out)
    assert (out.name, "scatter" in out.out) == ("ride9.mcap", True)


def test_ride_that_claims_too_much_counts_by_what_it_is_worth() -> None:
    """Thrice the error that it states: it stays, and its σ is what it scatters by."""
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2)) for k in range(4)]
    boasting = passing(straight_track(), 9, noise_rad=3 * NOISE_RAD)
    stated = boasting.passes._replace(std_rad=rides[0].passes.std_rad)
    found = made(*rides, replace(boasting, passes=stated))
    (own,) = (ride for ride in found.rides if ride.name == "ride9.mcap")
    assert not own.out
    assert own.scatter == pytest.approx(3, abs=0.4)
    columns = found.columns
    assert float(np.sum(columns["chi2"]) / np.sum(columns["passes"] - 1)) == pytest.approx(
        1, abs=0.2
    )


def test_stretch_of_a_ride_on_the_wrong_track_is_left_out_alone() -> None:
    """A detour that was matched to the street beside: 150 m that no other ride bears out."""
    rides = [passing(straight_track(), k, 1 - 2 * (k % 2)) for k in range(4)]
    passes = rides[0].passes
    grade = passes.grade_rad.copy()
    grade[100:130] += np.float32(0.03)
    rides[0] = replace(rides[0], passes=passes._replace(grade_rad=grade))
    found = made(*rides)
    assert not any(ride.out for ride in found.rides)
    np.testing.assert_array_equal(np.flatnonzero(found.columns["left_out"]), np.arange(100, 130))
    assert float(np.abs(errors(found)).max()) < 5 * STD_RAD


# Heights ------------------------------------------------------------------------------------------
def test_heights_are_those_that_the_slopes_climb_to() -> None:
    network = straight_track()
    found = made(*(passing(network, k, 1 - 2 * (k % 2)) for k in range(6)))
    height, grade = found.columns["height_ellipsoid_m"], found.columns["grade_rad"]
    climbs = (np.tan(grade[1:]) + np.tan(grade[:-1])) / 2 * 5.0
    np.testing.assert_allclose(np.diff(height), climbs, atol=1e-6)
    _, true = hills(network)
    error = height - true
    assert float(np.mean((error / found.columns["height_std_m"]) ** 2)) < 4.0
    assert float(np.abs(error).max()) < 3.0


def test_heights_close_where_tracks_join() -> None:
    """A ring of tracks: whichever way round, a node has one height."""
    network = town()
    found = assemble(network, [passing(network, k, 1 - 2 * (k % 2)) for k in range(4)], NOTHING)
    columns = found.columns
    half = np.tan(columns["grade_rad"]) * (columns["to_m"] - columns["from_m"]) / 2
    ends: dict[int, list[float]] = {}
    for track in range(network.track_count):
        own = np.flatnonzero(columns["track_number"] == track)
        for node, row, sign in (
            (network.from_node[track], own[0], -1),
            (network.to_node[track], own[-1], 1),
        ):
            height = columns["height_ellipsoid_m"][row] + sign * half[row]
            ends.setdefault(int(node), []).append(float(height))
    assert any(len(heights) > 2 for heights in ends.values())
    for heights in ends.values():
        np.testing.assert_allclose(heights, heights[0], atol=1e-6)


def test_without_heights_there_are_slopes_and_no_heights() -> None:
    ride = passing(straight_track(), 1)
    unknown = np.full(len(ride.passes.cell), np.nan, np.float32)
    passes = ride.passes._replace(height_m=unknown, height_std_m=unknown)
    found = made(replace(ride, passes=passes))
    assert np.isfinite(found.columns["grade_rad"]).all()
    assert np.isnan(found.columns["height_ellipsoid_m"]).all()


class Terrain:
    """What a survey says of the ground under the straight track, above the geoid."""

    std_m = 0.5

    def at(self, latitude_rad: np.ndarray, longitude_rad: np.ndarray) -> np.ndarray:
        network = straight_track()
        plan = network.plan_of(np.column_stack([latitude_rad, longitude_rad]))
        height = hills(network)[1]
        middle = (np.arange(len(height)) + 0.5) * 5.0
        return np.interp(np.hypot(*plan.T), middle, height) - GEOID_M


def test_raster_gives_heights_that_rides_do_not_and_corrects_their_bias() -> None:
    """One ride, 0.2 % off all along, climbs 4 m too much; the ground knows better."""
    ride = passing(straight_track(), 1, bias_rad=2e-3)
    unknown = np.full(len(ride.passes.cell), np.nan, np.float32)
    ride = replace(ride, passes=ride.passes._replace(height_m=unknown, height_std_m=unknown))
    found = assemble(straight_track(), [ride], Priors([Terrain()], GEOID_M))
    error = found.columns["height_ellipsoid_m"] - hills(straight_track())[1]
    assert float(np.abs(error).max()) < 1.5
    assert float(np.abs(error / found.columns["height_std_m"]).max()) < 4.0
    assert abs(float(np.mean(errors(found)))) < 5e-4
    assert abs(float(np.mean(errors(made(ride))))) > 1.5e-3


# Medians, files -----------------------------------------------------------------------------------
@given(st.lists(st.tuples(st.integers(0, 6), st.floats(-1, 1)), max_size=60))
def test_medians_are_numpys(rows: list[tuple[int, float]]) -> None:
    group = np.array([each for each, _ in rows], dtype=np.int64)
    value = np.array([each for _, each in rows])
    found = medians(group, value, 7)
    for k in range(7):
        own = value[group == k]
        if len(own):
            assert found[k] == pytest.approx(float(np.median(own)))
        else:
            assert np.isnan(found[k])


def test_file_gives_the_same_map_again(tmp_path: Path) -> None:
    found = made(*(passing(straight_track(), k) for k in range(3)))
    file.write(found, tmp_path / "map.parquet")
    again = file.read(tmp_path / "map.parquet")
    assert_same(found, again)
    assert again.rides == found.rides
    np.testing.assert_array_equal(again.starts, found.starts)


@pytest.mark.parametrize("keep", [0, 10, 1000, -1])
def test_damaged_file_is_refused_in_one_sentence(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "map.parquet"
    file.write(made(passing(straight_track(), 1)), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ConfigError, match="is no grade map, or a damaged one"):
        file.read(path)


def test_table_of_others_is_refused(tmp_path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "other.parquet")
    with pytest.raises(ConfigError, match="is no grade map"):
        file.read(tmp_path / "other.parquet")


def test_map_of_another_network_is_refused() -> None:
    found = made(passing(straight_track(), 1))
    with pytest.raises(ConfigError, match="another network"):
        rides_of(found, straight_track(900.0))
