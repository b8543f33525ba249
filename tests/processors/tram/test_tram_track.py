"""The filter `tram` on a map: its kernel, and rides with the map in the loop."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import networks
import numpy as np
import pytest
import test_tram_kernels as held
from filterpy.kalman import ExtendedKalmanFilter
from networks import laid as laid_on
from networks import network_of, straight
from rides import LEVEL, Ride, altered, laid, reference, ridden, time_s

from tramstream import keys
from tramstream.config import Map, Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import TRACKING
from tramstream.estimation.track import OnTrack
from tramstream.events.messages import facts_of
from tramstream.graph import Graph
from tramstream.lines.line import Line, parse_plan
from tramstream.live import snapshots
from tramstream.processor import Sample
from tramstream.processors.localisation.events import MAP_UNMATCHED
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.events import MAP_FAR, MAP_REFUSED
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_model.measurement import SCALAR_GATE
from tramstream.processors.tram_model.states import SIZE, Ix
from tramstream.processors.tram_model.track import (
    NOD_RAD_PER_MPS2,
    TrackDistance,
    TrackGrade,
    TrackHeading,
    nod_variance,
)
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.proto.sync_pb2 import Snapshot, SyncFrame
from tramstream.simulation.scenario import Tunnel
from tramstream.tracks.network import BACKWARDS, FORWARDS, Network

EVENTS = keys.EVENT.at("ekf"), keys.EVENT.at("map_matcher")
STD_M = 0.05
"""Of the map of these rides; its geometry is exact."""
CITY = {
    "speed_mps": 10.0,
    "acceleration_mps2": 0.8,
    "jerk_mps3": 0.5,
    "lateral_mps2": 1.3,
    "dwell_s": 10.0,
    "first_dwell_s": 12.0,
}


# The kernel ---------------------------------------------------------------------------------------
RADIUS_M, CENTRE = 40.0, np.array([20.0, -35.0])


def beside_arc(east: float, north: float, yaw: float, bend: float = 1.0) -> tuple[float, ...]:
    """Across and heading off a circle that is run to the left (or right), in closed form.

    Returns across, heading off, the left normal (east, north) and the bend.
    """
    out = np.array([east, north]) - CENTRE
    away = math.hypot(*out)
    across = bend * (RADIUS_M - away)
    normal = -bend * out / away
    heading = math.atan2(out[1], out[0]) + bend * math.pi / 2.0
    off = math.remainder(yaw - heading, math.tau)
    k = bend / RADIUS_M
    return across, off, float(normal[0]), float(normal[1]), k / (1.0 - k * across)


def on_map(x: Array) -> tuple[float, float, float]:
    """Place and heading of a state on a map that is beside the rails."""
    return x[Ix.EAST] - x[Ix.MAP_EAST], x[Ix.NORTH] - x[Ix.MAP_NORTH], x[Ix.YAW]


def told(x: Array, bend: float, variances: Sequence[float], grade: float = math.nan) -> OnTrack:
    across, off, ne, nn, turn = beside_arc(*on_map(x), bend)
    return OnTrack(ne, nn, across, off, turn, variances[0], variances[1], grade, variances[2])


def near_arc(rng: np.random.Generator, bend: float) -> Array:
    """A state some metres beside the circle that heads along it, but for some degrees."""
    x = held.state(rng)
    angle, radius = rng.uniform(-3.0, 3.0), RADIUS_M + rng.uniform(-5.0, 5.0)
    x[Ix.EAST], x[Ix.NORTH] = CENTRE + radius * np.array([math.cos(angle), math.sin(angle)])
    x[Ix.EAST], x[Ix.NORTH] = x[Ix.EAST] + x[Ix.MAP_EAST], x[Ix.NORTH] + x[Ix.MAP_NORTH]
    x[Ix.YAW] = angle + bend * math.pi / 2.0 + rng.normal(0.0, 0.05)
    return x


def tracked(x: Array, P: Array, on_track: OnTrack, gate: float = held.INFINITE) -> Navigation:
    """A navigation that was put onto the track."""
    navigation = Navigation(held.vehicle(), LEVEL)
    navigation.ekf.x, navigation.ekf.P = x, P
    navigation.on_track(on_track, gate)
    return navigation


@pytest.mark.parametrize("grade", [0.02, math.nan])
@pytest.mark.parametrize("bend", [1.0, -1.0])
def test_track_is_filterpys_dense_update(bend: float, grade: float) -> None:
    """Two or three scalars, one after the other, are one joint measurement of the state before."""
    rng = np.random.default_rng(1)
    gravity = float(Navigation(held.vehicle(), LEVEL).ekf.parameters["gravity"][0])
    for _ in range(10):
        x, P = near_arc(rng, bend), held.covariance(rng)
        variances = rng.uniform(0.01, 1.0), rng.uniform(1e-4, 1e-2), rng.uniform(1e-4, 1e-2)
        on_track = told(x, bend, variances, grade)
        rows = 2 if math.isnan(grade) else 3
        H = np.zeros((rows, SIZE))
        H[0, [Ix.EAST, Ix.NORTH]] = on_track.normal_east, on_track.normal_north
        H[0, [Ix.MAP_EAST, Ix.MAP_NORTH]] = -H[0, [Ix.EAST, Ix.NORTH]]
        along = np.array([on_track.normal_north, -on_track.normal_east])
        H[1, [Ix.EAST, Ix.NORTH]] = -on_track.bend_per_m * along
        H[1, [Ix.MAP_EAST, Ix.MAP_NORTH]] = -H[1, [Ix.EAST, Ix.NORTH]]
        H[1, Ix.YAW] = 1.0
        z = np.array([-on_track.across_m, -on_track.yaw_off_rad])
        noise = list(variances[:rows])
        if rows == 3:
            H[2, Ix.PITCH] = 1.0  # pitch is positive downhill
            z = np.append(z, -grade - x[Ix.PITCH])
            noise[2] += nod_variance(gravity * grade)
        dense = ExtendedKalmanFilter(dim_x=SIZE, dim_z=rows)
        dense.x, dense.P = x.reshape(-1, 1).copy(), P.copy()
        dense.update(
            z.reshape(-1, 1),
            lambda _, H=H: H,
            lambda _, rows=rows: np.zeros((rows, 1)),
            np.diag(noise),
        )
        navigation = tracked(x, P, on_track)
        scale = np.sqrt(np.diag(P))
        found = navigation.ekf.P
        np.testing.assert_allclose(navigation.ekf.x[:, 0] / scale, dense.x[:, 0] / scale, atol=1e-6)
        np.testing.assert_allclose(
            found / np.outer(scale, scale), dense.P / np.outer(scale, scale), atol=1e-6
        )
        np.testing.assert_array_equal(found, found.T)
        assert len(navigation.memory.given) == rows
        assert all(verdict.accepted for verdict in navigation.memory.given)
        distance = sum(each.innovation**2 / each.variance for each in navigation.memory.given)
        expected = float(z @ np.linalg.solve(dense.S, z))
        assert distance == pytest.approx(expected, rel=1e-6)


def test_grade_of_the_map_tells_no_pitch_while_the_body_may_nod() -> None:
    """A surveyed grade of 0.1 %, a hundred times in a braking: it would be taken for no nod."""
    surveyed, rates = 100.0 * 0.001**2, {}
    for push_mps2 in (0.0, 1.0):
        ekf = held.tram_filter(np.zeros(SIZE), np.eye(SIZE) * 0.01**2)
        ekf.fields["acceleration"] = push_mps2
        for _ in range(100):
            ekf.apply(TrackGrade(0.0, surveyed))
        rates[push_mps2] = math.sqrt(ekf.variances[Ix.PITCH])
    assert rates[0.0] == pytest.approx(0.001, rel=0.01)
    assert rates[1.0] > 0.8 * NOD_RAD_PER_MPS2


def rows_of(x: Array, on_track: OnTrack) -> list[Array]:
    """Row of H of distance, heading and grade."""
    rows: list[Array] = []

    class Rows:
        def predicted(self, memory: Array) -> None: ...

        def updated(self, memory: Array) -> None:
            rows.append(navigation.ekf.H[0])

        def made_anew(self, state: int) -> None: ...

    navigation = Navigation(held.vehicle(), LEVEL)
    navigation.ekf.x, navigation.ekf.P = x, np.zeros((SIZE, SIZE))
    navigation.ekf.watcher = Rows()
    navigation.on_track(on_track)
    return rows


@pytest.mark.parametrize("bend", [1.0, -1.0])
def test_rows_of_the_track_are_the_derivatives_of_its_geometry(bend: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        x = near_arc(rng, bend)
        rows = rows_of(x, told(x, bend, (1.0, 1.0, 1.0), 0.01))
        for column in Ix:
            seen = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[column] += sign * held.STEP
                across, off, *_ = beside_arc(*on_map(moved), bend)
                seen.append((across, off, moved[Ix.PITCH]))
            slopes = np.subtract(*seen) / (2.0 * held.STEP)
            for k, slope in enumerate(slopes.tolist()):
                assert rows[k][column] == pytest.approx(slope, abs=1e-6), column.name


def test_state_is_put_onto_the_arc_when_nothing_else_is_known() -> None:
    """A sharp map and a vague state: a few updates, as each is linear, end on the circle."""
    rng = np.random.default_rng(3)
    x = near_arc(rng, 1.0)
    P = np.zeros((SIZE, SIZE))
    P[Ix.EAST, Ix.EAST] = P[Ix.NORTH, Ix.NORTH] = 25.0
    P[Ix.YAW, Ix.YAW] = 1e-10
    after = x
    for _ in range(4):
        ekf = held.tram_filter(after, P)
        on_track = told(after, 1.0, (1e-8, 1e-8, 1.0))
        n = on_track.normal_east, on_track.normal_north
        gate = held.INFINITE
        place = on_map(after)
        ekf.apply(TrackDistance(*n, on_track.across_m, on_track.across_variance, gate))
        heading = on_track.yaw_off_rad, on_track.bend_per_m, *place, on_track.yaw_variance
        ekf.apply(TrackHeading(*n, *heading, gate))
        after = ekf.x[:, 0].copy()
    across, off, *_ = beside_arc(*on_map(after))
    assert across == pytest.approx(0.0, abs=1e-3)
    assert off == pytest.approx(0.0, abs=1e-3), "its place along is what the heading says"
    assert after[Ix.YAW] == pytest.approx(x[Ix.YAW], abs=1e-4)


def test_track_beyond_the_gate_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    x, P = near_arc(rng, 1.0), np.eye(SIZE) * 1e-4
    on_track = told(x, 1.0, (1e-4, 1e-4, 1.0))._replace(across_m=9.0, yaw_off_rad=1.0)
    navigation = tracked(x, P, on_track, SCALAR_GATE)
    np.testing.assert_array_equal(navigation.ekf.x[:, 0], x)
    np.testing.assert_array_equal(navigation.ekf.P, P)
    assert not any(verdict.accepted for verdict in navigation.memory.given)


# Rides --------------------------------------------------------------------------------------------
@dataclass
class Output:
    """What a filter and its map matcher said of a ride."""

    graph: Graph
    samples: list[Sample]

    @property
    def states(self) -> list[MotionState]:
        return [each.message for each in self.samples if each.key is keys.EST_STATE]

    @property
    def matches(self) -> list[MapMatch]:
        return [each.message for each in self.samples if each.key is keys.MAP_MATCH]

    @property
    def events(self) -> list[tuple[str, dict[str, Any]]]:
        """Kind and facts."""
        told = [each.message for each in self.samples if each.key in EVENTS]
        return [(event.kind, facts_of(event)) for event in told]

    def packed(self) -> list[bytes]:
        return [each.message.SerializeToString() for each in self.samples]


def step(graph: Graph, frames: Sequence[SyncFrame]) -> Output:
    samples = []
    for number, frame in enumerate(frames):
        samples += graph.step(Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number))
    return Output(graph, samples)


def alone(vehicle: Vehicle) -> Graph:
    """The filter without a map."""
    return Graph([LocalisationFilter(vehicle)])


def matching_with(vehicle: Vehicle, path: Path, std_m: float = STD_M) -> Graph:
    """Filter and map matcher."""
    mapped = altered(vehicle, map=Map(network=str(path), std_m=std_m))
    return Graph([LocalisationFilter(mapped), MapMatcher(mapped)])


def with_map(ride: Ride, path: Path, std_m: float = STD_M) -> Graph:
    return matching_with(ride.simulation.vehicle, path, std_m)


def memory(graph: Graph) -> Snapshot:
    return Snapshot(states=snapshots.take(graph.processors))


def off(ride: Ride, states: Sequence[MotionState]) -> tuple[Array, Array]:
    """Error along and across the line, m."""
    stamps = np.array([each.stamp_ns for each in states])
    truth = ride.simulation.truth(stamps)
    geodetic = np.array(
        [
            (math.radians(s.latitude_deg), math.radians(s.longitude_deg), s.height_ellipsoid_m)
            for s in states
        ]
    )
    p_l = (ride.simulation.line.level.from_geodetic(geodetic) - truth.p_l)[:, :2]
    cos, sin = np.cos(truth.motion.yaw_rad), np.sin(truth.motion.yaw_rad)
    return cos * p_l[:, 0] + sin * p_l[:, 1], cos * p_l[:, 1] - sin * p_l[:, 0]


def way_m(ride: Ride, states: Sequence[MotionState]) -> Array:
    """True arc length at each state."""
    stamps = np.array([each.stamp_ns for each in states])
    way: Array = np.asarray(ride.simulation.truth(stamps).motion.arc_length_m)
    return way


SHORT = "| 120 L60/70 100 R80/60 80 | 120 L90/45 60 R50/60 150 |"


@cache
def short(seed: int) -> Ride:
    return ridden(laid(SHORT), altered(reference(), driver=CITY), seed)


@pytest.fixture(scope="module")
def short_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(network_of([laid(SHORT)]), tmp_path_factory.mktemp("map") / "short.net")


@cache
def mapped(seed: int, path: Path) -> Output:
    """The whole ride with a map, and with its trace kept, which changes nothing."""
    graph = with_map(short(seed), path)
    filter_of(graph).keep()
    return step(graph, short(seed).frames)


def filter_of(graph: Graph) -> LocalisationFilter:
    first = graph.processors[0]
    assert isinstance(first, LocalisationFilter)
    return first


def saved(network: Network, path: Path) -> Path:
    network.save(path)
    return path


def moving(states: Sequence[MotionState]) -> list[MotionState]:
    return [each for each in states if each.mode == TRACKING][::5]


@cache
def without_map(seed: int) -> Output:
    ride = short(seed)
    return step(alone(ride.simulation.vehicle), ride.frames)


def beyond_levels(ride: Ride, states: Sequence[MotionState]) -> float:
    """Share of states whose error is beyond a protection level."""
    levels = np.array([(each.protection_along_m, each.protection_across_m) for each in states])
    errors = np.abs(np.column_stack(off(ride, states)))
    return float(np.mean(np.any(errors > levels, axis=1)))


def test_map_that_is_two_metres_beside_the_rails_is_in_the_protection_levels(
    tmp_path: Path,
) -> None:
    """A filter that takes its map for true is beyond them, so the ride can tell."""
    ride = short(1)
    segments, stops_m = parse_plan(SHORT)
    yaw_rad = float(ride.simulation.line.yaw_rad(0.0))
    beside = Line(segments, stops_m, LEVEL, yaw_rad, (1.2, 1.6, 0.0))
    path = saved(network_of([beside]), tmp_path / "beside.net")
    share = {}
    for times in (0.0, 2.0):
        settings = Map(network=str(path), std_m=0.5, correlation_m=5.0, shift_over_std=times)
        mapped = altered(ride.simulation.vehicle, map=settings)
        graph = Graph([LocalisationFilter(mapped), MapMatcher(mapped)])
        share[times] = beyond_levels(ride, moving(step(graph, ride.frames).states))
    assert share[0.0] > 0.2
    assert share[2.0] == 0.0


def test_filter_with_the_map_is_better_than_without(short_map: Path) -> None:
    ride, said = short(1), mapped(1, short_map)
    errors = {}
    for name, output in (("with", said), ("without", without_map(1))):
        along, across = off(ride, moving(output.states))
        errors[name] = np.quantile(np.hypot(along, across), 0.9), np.sqrt(np.mean(across**2))
        print(f"{name}: P90 {errors[name][0]:.2f} m, across {errors[name][1]:.3f} m")
    assert errors["with"][0] < errors["without"][0]
    assert errors["with"][1] < 0.15 < errors["without"][1]


def test_matches_of_a_ride_are_those_of_its_states(short_map: Path) -> None:
    ride, said = short(1), mapped(1, short_map)
    assert [each.stamp_ns for each in said.samples if each.key is keys.MAP_MATCH] == [
        each.stamp_ns for each in said.samples if each.key is keys.EST_STATE
    ]
    known = [
        (match, s)
        for match, state, s in zip(
            said.matches, said.states, way_m(ride, said.states).tolist(), strict=True
        )
        if state.mode == TRACKING
    ]
    assert len(known) > 3000
    network = network_of([laid(SHORT)])
    for match, s in known[500::20]:
        assert match.state == MapMatch.ON_TRACK
        assert match.run == 0
        assert match.probability > 0.99
        assert match.chainage_m == pytest.approx(s, abs=2.0)
        place = np.radians([match.latitude_deg, match.longitude_deg])
        plan = network.plan_of(network.level.to_geodetic(laid(SHORT).position_l(match.chainage_m)))
        np.testing.assert_allclose(network.plan_of(place), plan, atol=0.01)
    assert said.events == without_map(1).events


def test_published_place_on_the_track_does_not_jump(short_map: Path) -> None:
    """100 times a second: never farther than the vehicle goes and three decimetres."""
    ride, said = short(1), mapped(1, short_map)
    rows = [
        (match.chainage_m, s)
        for match, state, s in zip(
            said.matches, said.states, way_m(ride, said.states).tolist(), strict=True
        )
        if state.mode == TRACKING and match.state == MapMatch.ON_TRACK
    ]
    steps = np.diff(np.array(rows), axis=0)
    assert (np.abs(steps[:, 0]) - np.abs(steps[:, 1])).max() < 0.3


@pytest.mark.parametrize("rear", [False, True])
def test_double_track_is_told_by_the_direction_of_travel(rear: bool, tmp_path: Path) -> None:
    """From either cab: fixes of half a metre, the opposite track 3.3 m to the left."""
    ride = reversed_ride() if rear else short(1)
    line = laid(SHORT)
    left = Line(
        line.segments,
        line.stops_m,
        LEVEL,
        float(line.yaw_rad(0.0)),
        (*networks.left_of(line, networks.PARALLEL_M), 0.0),
    )
    network = network_of([left, line], rules=[BACKWARDS, FORWARDS])
    said = step(with_map(ride, saved(network, tmp_path / "double.net")), ride.frames[:6000])
    begun = [each.mode == TRACKING for each in said.states].index(True)
    later = said.matches[begun + 500 :]
    assert {each.run for each in later} == {2}
    assert min(each.probability for each in later) > 0.9


@cache
def reversed_ride() -> Ride:
    return ridden(laid(SHORT), altered(reference(), driver=CITY, reverse=True), 1)


@pytest.mark.parametrize("gap_s", [2.0, 20.0])
def test_lost_frames_are_no_worse_with_the_map(gap_s: float, short_map: Path) -> None:
    """Nothing arrives for a while; what the matcher knew of the time before is not held on to."""
    ride = short(1)
    begin_s = time_s(ride.frames[0].stamp_ns) + 35.0
    frames = ride.between(-1.0, begin_s) + ride.between(begin_s + gap_s, begin_s + gap_s + 20.0)
    said = step(with_map(ride, short_map), frames)
    plain = step(alone(ride.simulation.vehicle), frames)
    worst = []
    for output in (said, plain):
        later = [
            each
            for each in output.states
            if begin_s + gap_s + 1.0 < time_s(each.stamp_ns) and each.mode == TRACKING
        ]
        worst.append(np.hypot(*off(ride, later)).max())
    print(f"gap of {gap_s:.0f} s: {worst[0]:.2f} m with, {worst[1]:.2f} m without the map")
    assert worst[0] < worst[1] + 0.5
    for match, state, s in zip(
        said.matches, said.states, way_m(ride, said.states).tolist(), strict=True
    ):
        since_s = time_s(state.stamp_ns) - begin_s - gap_s
        if since_s < 0.0 or state.mode != TRACKING:
            continue
        if since_s > 0.5:
            assert match.state == MapMatch.ON_TRACK, f"{since_s:.2f} s behind the gap"
        if match.state == MapMatch.ON_TRACK:
            assert match.chainage_m == pytest.approx(s, abs=3.0 + 4.0 * match.chainage_std_m)


def test_model_of_the_work_takes_the_map_too(short_map: Path) -> None:
    ride = short(1)
    vehicle = altered(ride.simulation.vehicle, ekf={"model": "kaspar2023"})
    said = step(matching_with(vehicle, short_map), ride.frames[:5000])
    plain = step(alone(vehicle), ride.frames[:5000])
    across = [
        float(np.sqrt(np.mean(off(ride, moving(output.states))[1] ** 2)))
        for output in (said, plain)
    ]
    assert across[0] < 0.5 * across[1]
    assert {each.run for each in said.matches[-1000:]} == {0}


@pytest.mark.parametrize("seed", [1, 6])
def test_flawless_ride_on_an_exact_map_is_never_off_it(seed: int, short_map: Path) -> None:
    """From the first metre with a heading on, though that heading is 3° off at first."""
    said = step(with_map(short(seed), short_map), short(seed).frames[:3500])
    known = [
        match.state
        for match, state in zip(said.matches, said.states, strict=True)
        if state.mode == TRACKING
    ]
    assert {*known} == {MapMatch.ON_TRACK}


# A tunnel -----------------------------------------------------------------------------------------
BEFORE = "| 80 L60/90 60 R50/80 60 | 80 R50/90 60 L70/70 60 "
TUNNEL_M, TUNNEL_MPS = 1200.0, 10.0
UNDERGROUND = BEFORE + "1250 R60/70 100 |"


@cache
def underground() -> tuple[Ride, float, float]:
    """A ride, where its tunnel begins, and where the curve behind it ends."""
    line = laid(UNDERGROUND)
    lengths = [each.length_m for each in line.segments]
    straight_ = lengths.index(1250.0)
    begin_m, end_m = float(line.starts_m[straight_]) + 10.0, float(line.starts_m[straight_ + 4])
    tunnel = Tunnel(start_m=begin_m, end_m=end_m + 60.0)
    chosen = altered(reference(), driver=CITY, events=(tunnel,))
    return ridden(line, chosen, 2), begin_m, end_m


def surveyed(network: Network, std_m: float, seed: int) -> Network:
    """The same rails off by so much: waves of 30 m and more, as a map of a street has them."""
    rng = np.random.default_rng(seed)
    s = np.arange(len(network.east)) * float(network.spacing_m[0])
    waves = rng.uniform(60.0, 400.0, 40)
    phase = rng.uniform(0.0, math.tau, 40)
    angle = math.tau * s[:, None] / waves + phase
    size = std_m * math.sqrt(2.0 / len(waves))
    off_m = size * np.sin(angle).sum(axis=1)
    turn = size * (math.tau / waves * np.cos(angle)).sum(axis=1)
    return replace(
        network,
        east=network.east - off_m * np.sin(network.yaw_rad),
        north=network.north + off_m * np.cos(network.yaw_rad),
        yaw_rad=network.yaw_rad + turn,
        curvature_per_m=network.curvature_per_m + np.gradient(turn, s),
    )


@pytest.mark.parametrize(("off_m", "behind_m"), [(0.0, 1.0), (0.3, 2.0)])
def test_tunnel_of_120_s_ends_within_3_m_and_the_next_curve_corrects_it(
    off_m: float, behind_m: float, tmp_path: Path
) -> None:
    ride, begin_m, curve_m = underground()
    network = network_of([laid(UNDERGROUND)])
    chosen = surveyed(network, off_m, seed=2)
    path = saved(chosen, tmp_path / "tunnel.net")
    said = step(with_map(ride, path, max(off_m, STD_M)), ride.frames)
    s, (along, across) = way_m(ride, said.states), off(ride, said.states)

    def within(start_m: float, end_m: float) -> slice:
        return slice(*np.searchsorted(s, [start_m, end_m]).tolist())

    dark = within(begin_m, begin_m + TUNNEL_M)
    behind = within(curve_m + 5.0, curve_m + 40.0)
    print(
        f"map off by {off_m} m: along {along[dark][-1]:.2f} m after {TUNNEL_M:.0f} m, "
        f"{np.abs(along[behind]).max():.2f} m behind the curve"
    )
    assert np.abs(along[dark]).max() < 3.0
    assert np.abs(across[dark]).max() < 0.5 + 3.0 * off_m
    assert np.abs(along[behind]).max() < behind_m
    claimed = np.array([each.chainage_std_m for each in said.matches])[behind]
    assert (np.abs(along[behind]) < 4.0 * claimed).all()


# Maps that do not help ----------------------------------------------------------------------------
def assert_same_states(said: Output, plain: Output) -> None:
    for key in (keys.EST_STATE, keys.EST_NOW):
        found, expected = (
            [each.message.SerializeToString() for each in output.samples if each.key is key]
            for output in (said, plain)
        )
        assert found == expected


def broken(folder: Path, how: str) -> Path:
    path = folder / "city.net"
    whole = saved(network_of([laid(SHORT)]), folder / "whole.net").read_bytes()
    if how == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif how == "no zip":
        path.write_text("a letter")
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "flipped":
        middle = len(whole) // 3
        path.write_bytes(
            whole[:middle]
            + bytes(each ^ 0xFF for each in whole[middle : middle + 64])
            + whole[middle + 64 :]
        )
    elif how == "without arrays":
        with zipfile.ZipFile(folder / "whole.net") as old, zipfile.ZipFile(path, "w") as new:
            new.writestr("names.json", old.read("names.json"))
    elif how == "folder":
        path.mkdir()
    return path


@pytest.mark.parametrize(
    "how", ["missing", "cut", "no zip", "empty", "flipped", "without arrays", "folder"]
)
def test_map_that_cannot_be_read_is_said_once_and_changes_nothing(how: str, tmp_path: Path) -> None:
    ride = short(1)
    frames = ride.frames[:2500]
    path = broken(tmp_path, how)
    said = step(with_map(ride, path), frames)
    plain = step(alone(ride.simulation.vehicle), frames)
    assert_same_states(said, plain)
    assert said.matches == []
    ((kind, facts),) = [each for each in said.events if each not in plain.events]
    assert kind == MAP_REFUSED.name
    assert str(path) in facts["reason"]
    assert "\n" not in facts["reason"]


def test_map_that_nobody_matches_with_is_said_once_and_changes_nothing() -> None:
    ride = short(1)
    chosen = Map(network="any.tracks")
    vehicle = altered(ride.simulation.vehicle, map=chosen, processors=("resampler", "ekf"))
    said = step(alone(vehicle), ride.frames[:1500])
    plain = step(alone(ride.simulation.vehicle), ride.frames[:1500])
    assert_same_states(said, plain)
    about = [each for each in said.events if each not in plain.events]
    assert about == [(MAP_UNMATCHED.name, {})]


def test_map_of_another_place_is_said_once_and_changes_nothing(tmp_path: Path) -> None:
    ride = short(1)
    away = networks.network_of(
        [laid_on(straight(500.0), (5000.0, 0.0), level=LEVEL)], source="Brno"
    )
    said = step(with_map(ride, saved(away, tmp_path / "far.net")), ride.frames)
    assert_same_states(said, without_map(1))
    ((kind, facts),) = [each for each in said.events if each not in without_map(1).events]
    assert kind == MAP_FAR.name
    assert "Brno" in facts["source"]
    assert facts["distance_m"] > facts["limit_m"]
    assert {each.state for each in said.matches} == {MapMatch.OFF_MAP}
    assert not [each for each in said.samples if each.key is keys.MAP_LOCATION]


def test_map_of_a_wrong_street_does_less_harm_than_its_distance(tmp_path: Path) -> None:
    """A track 30 m beside the ride: it is not put onto it."""
    ride = short(1)
    line = laid(SHORT)
    start = networks.left_of(line, 30.0)
    beside = Line(line.segments, line.stops_m, LEVEL, float(line.yaw_rad(0.0)), (*start, 0.0))
    said = step(with_map(ride, saved(network_of([beside]), tmp_path / "beside.net")), ride.frames)
    _, across = off(ride, moving(said.states))
    assert np.abs(across).max() < 3.0


def test_map_with_an_end_lets_the_filter_go_on(tmp_path: Path) -> None:
    """Behind the last track it goes on as without one."""
    ride = short(1)
    half = laid("| 120 L60/70 60")
    path = saved(network_of([half]), tmp_path / "half.net")
    said = step(with_map(ride, path), ride.frames)
    s = way_m(ride, said.states)
    along, across = off(ride, said.states)
    behind = s > half.length_m + 30.0
    assert np.hypot(along, across)[behind].max() < 3.0
    runs = np.array([each.run for each in said.matches])
    assert {
        each.state for each, k in zip(said.matches, s > half.length_m + 150.0, strict=True) if k
    } == {MapMatch.OFF_MAP}
    assert (runs[(s > 60.0) & (s < half.length_m - 10.0)] == 0).all()


# Memory -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("number", [500, 2500, 5000])
def test_restored_filter_with_a_map_goes_on_to_the_last_bit(number: int, short_map: Path) -> None:
    ride = short(1)
    graph, other = with_map(ride, short_map), with_map(ride, short_map)
    step(graph, ride.frames[:number])
    kept = memory(graph)
    rest = ride.frames[number : number + 2000]
    expected = step(graph, rest)
    assert snapshots.restore(kept, other.processors)
    found = step(other, rest)
    assert found.packed() == expected.packed()
    assert memory(other) == memory(graph)


def test_memory_with_a_map_is_taken_by_a_filter_without_one_and_back(short_map: Path) -> None:
    """Somebody takes the map out of the configuration, or puts it in, and restarts."""
    ride = short(1)
    before, rest = ride.frames[:2500], ride.frames[2500:3500]
    mapped, plain = with_map(ride, short_map), alone(ride.simulation.vehicle)
    step(mapped, before)
    step(plain, before)
    without = alone(ride.simulation.vehicle)
    filter_of(without).restore(snapshots.unpack(snapshots.pack(filter_of(mapped).snapshot())))
    assert len(step(without, rest).states) == len(rest)
    again = with_map(ride, short_map)
    filter_of(again).restore(snapshots.unpack(snapshots.pack(filter_of(plain).snapshot())))
    said = step(again, rest)
    assert said.matches[-1].run == 0


def test_same_ride_twice_gives_the_same_bytes(short_map: Path) -> None:
    ride = short(1)
    first, second = (step(with_map(ride, short_map), ride.frames[:3000]) for _ in range(2))
    assert first.packed() == second.packed()


# Smoother -----------------------------------------------------------------------------------------
def test_smoother_takes_the_map_and_is_not_worse_than_the_filter(short_map: Path) -> None:
    ride, said = short(1), mapped(1, short_map)
    smoothed = [each.message for each in filter_of(said.graph).smoothed()]
    begin_ns = moving(said.states)[0].stamp_ns
    errors = {}
    for name, states in (("filter", said.states), ("smoother", smoothed)):
        chosen = [each for each in states if each.stamp_ns > begin_ns and each.mode == TRACKING]
        along, across = off(ride, chosen)
        errors[name] = np.sqrt(np.mean(along**2)), np.sqrt(np.mean(across**2))
        print(f"{name}: along {errors[name][0]:.3f} m, across {errors[name][1]:.3f} m")
    assert errors["smoother"][0] < errors["filter"][0] * 1.05
    assert errors["smoother"][1] < max(errors["filter"][1] * 1.05, 0.05)


def test_tracing_does_not_change_what_the_filter_says(short_map: Path) -> None:
    ride = short(1)
    frames = ride.frames[:4000]
    plain, traced = with_map(ride, short_map), with_map(ride, short_map)
    filter_of(traced).keep()
    assert step(traced, frames).packed() == step(plain, frames).packed()


@pytest.mark.parametrize("known", [True, False])
def test_grade_of_the_map_is_taken_where_it_knows_one(
    known: bool, short_map: Path, tmp_path: Path
) -> None:
    said = mapped(1, short_map)
    if known:
        network = network_of([laid(SHORT)])
        level = np.zeros(len(network.east), np.float32)
        network = replace(network, grade_rad=level, grade_std_rad=level + np.float32(0.003))
        said = step(with_map(short(1), saved(network, tmp_path / "graded.net")), short(1).frames)
    seen = {each.measurement for state in said.states for each in state.innovations}
    assert {"track_across", "track_heading"} <= seen
    assert ("track_grade" in seen) == known
    pitch = np.array([each.pitch_rad for each in moving(said.states)])
    assert np.abs(pitch[len(pitch) // 2 :]).max() < 0.01
