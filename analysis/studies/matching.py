"""Simulated rides on a track network through the localisation filter with its map.

A ride follows an operator's line or a detour of it, on rails that are a little beside the map, with
the sensors of scenario `matching`. It goes through resampler and filter in memory; ten times a
second the match is held to the truth (`matching_judge`). On the same rides the nearest track of
each fix, and on some that of a filter without the map, is held to it in the same way.

Rides of one seed on two lines have nothing in common: all chance hangs on seed and route.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.spatial import cKDTree

from tramstream import config
from tramstream.analysis.studies import matching_judge as judge
from tramstream.analysis.studies.frames import frames
from tramstream.analysis.studies.matching_columns import NO_RUN, Columns, Said
from tramstream.analysis.studies.matching_figures import (
    BESIDE,
    DIRECTION,
    MOVING,
    NEAREST_FIX,
    NEAREST_STATE,
    STANDING,
    STRICT,
    SWITCHES,
    TRACK,
    TWO_SIGMA,
    Figures,
    Mistake,
    Tally,
)
from tramstream.analysis.studies.matching_judge import Reliability, Verdicts
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.graph import Graph
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.simulation import scenario
from tramstream.simulation.detours import detour
from tramstream.simulation.simulation import EPOCH_NS, Simulation
from tramstream.simulation.track_rides import (
    ERROR_STD_M,
    Flags,
    Integers,
    MapError,
    NetworkRide,
    Spots,
    lay,
    route_of,
    sampled,
)
from tramstream.tracks import network as networks
from tramstream.tracks.network import Array, Network, RouteLine

SCENARIO = "matching"
EVERY = 10
"""Judged frames: 10 Hz."""
DETOUR = "detour"
PLAIN, SLOW, GYRO = KINDS = ("plain", "slow", "gyro")
"""Of rides: as the scenario says; errors of the fixes that last ten times as long, as beside high
houses, which nobody tells the filter; gyroscopes whose bias walks as that of the work."""
SLOW_DECAY = 0.995
GYRO_WALK_RADPS2_RTHZ = 0.00007563
"""K of kaspar2023 (docs/theory.md, section 3.9)."""
_TRIES = 20
"""Detours are drawn anew where no tram can follow them."""
_ALONG_EVERY = 10
"""Judged points: once a second."""


class Case(NamedTuple):
    """One ride; plain values, so that it can go to another process."""

    network: str
    """File."""
    line: str
    """LINE/DIRECTION."""
    seed: int = 1
    detour: bool = False
    duration_s: float | None = None
    free: bool = False
    """Also through a filter without the map, for nearest-track matching of its positions."""
    kind: str = PLAIN
    """One of `KINDS`."""
    map_error_m: float = ERROR_STD_M

    @property
    def route(self) -> str:
        """What its figures are summed up by."""
        route = DETOUR if self.detour else self.line
        return route if self.kind == PLAIN else f"{route}, {self.kind}"


@cache
def load(path: str) -> Network:
    """Read a network once a process."""
    return networks.load(Path(path))


def lines(network: Network, chosen: Sequence[str] = ()) -> list[str]:
    """Names of the lines that are meant by LINE/DIRECTION or LINE; all if nothing is said.

    Raises
    ------
    ConfigError
        For a line that the network does not have.
    """
    names = [f"{line.line}/{line.direction}" for line in network.lines]
    if not names:
        raise ConfigError("the network has no lines; build it with them (`tramstream map build`)")
    found: list[str] = []
    for each in chosen or names:
        meant = [name for name in names if each in (name, name.split("/")[0])]
        if not meant:
            raise ConfigError(f"the network has no line {each!r}; it has {', '.join(names)}")
        found += [name for name in meant if name not in found]
    return found


def ride_of(case: Case) -> NetworkRide:
    """Lay the truth.

    Raises
    ------
    ConfigError
        If no tram can follow the line, or none of many detours.
    """
    network = load(case.network)
    line = _line(network, case.line)
    rng = np.random.default_rng(_words(case))
    error = MapError(case.map_error_m)
    if not case.detour:
        return lay(network, route_of(line), rng, error)
    for attempt in range(_TRIES):
        try:
            return lay(network, detour(network, line, rng), rng, error)
        except ConfigError:
            if attempt == _TRIES - 1:
                raise
    raise AssertionError


def simulation_of(case: Case, ride: NetworkRide) -> Simulation:
    """Set up the ride's sensors."""
    chosen = scenario.load(SCENARIO)
    imu, gnss = chosen.imu, chosen.gnss
    assert imu is not None
    assert gnss is not None
    if case.kind == SLOW:
        chosen = replace(chosen, gnss=replace(gnss, errors=replace(gnss.errors, decay=SLOW_DECAY)))
    elif case.kind == GYRO:
        errors = replace(imu.errors, gyro_walk_radps2_rthz=GYRO_WALK_RADPS2_RTHZ)
        chosen = replace(chosen, imu=replace(imu, errors=errors))
    seed = int(np.random.SeedSequence(_words(case)).generate_state(1)[0])
    return Simulation(ride.line, chosen, seed, case.duration_s)


def vehicle_of(case: Case, simulation: Simulation) -> config.Vehicle:
    """What the filter is told of the ride's sensors, without the map."""
    vehicle = simulation.vehicle
    if case.kind == SLOW and vehicle.gnss is not None:
        usual = config.Gnss(device="").error_tau_s
        vehicle = replace(vehicle, gnss=replace(vehicle.gnss, error_tau_s=usual))
    return vehicle


def _words(case: Case) -> list[int]:
    """What all chance of a ride hangs on; kinds differ in nothing but their sensors."""
    way = DETOUR if case.detour else case.line
    return [case.seed, zlib.crc32(f"{way} {case.line}".encode())]


def _line(network: Network, name: str) -> RouteLine:
    (line,) = (each for each in network.lines if f"{each.line}/{each.direction}" == name)
    return line


# One ride -----------------------------------------------------------------------------------------
def study(case: Case) -> Figures:
    """Run one ride through the filter with its map, and judge."""
    ride = ride_of(case)
    simulation = simulation_of(case, ride)
    vehicle = vehicle_of(case, simulation)
    mapped = replace(vehicle, map=config.Map(network=case.network))
    localisation = Graph([LocalisationFilter(mapped), MapMatcher(mapped)])
    free = LocalisationFilter(vehicle) if case.free else None
    fixes: list[GnssFix] = []
    said, said_freely, elapsed_s, number = Said(), Said(), 0.0, 0
    for number, frame in enumerate(frames(simulation, fixes)):
        begin_s = time.thread_time()
        outputs = localisation.step(frame)
        elapsed_s += time.thread_time() - begin_s
        outputs_freely = free.step(frame) if free is not None else []
        if number % EVERY == 0:
            said.keep(outputs)
            said_freely.keep(outputs_freely)
    found = figures(case, ride, simulation, said, elapsed_s / (number + 1) * 1e6)
    nearest = _nearest(ride, simulation, said_freely.columns(), fixes)
    return found._replace(tallies={**found.tallies, **nearest})


# Judging ------------------------------------------------------------------------------------------
def figures(
    case: Case,
    ride: NetworkRide,
    simulation: Simulation,
    said: Said,
    step_us: float = float("nan"),
) -> Figures:
    """Hold what was said to the truth; nearest-track matching is not in it."""
    whole = said.columns()
    first = int(np.argmax(whole.answered))  # without any answer all points are wrong
    points = whole.since(first)
    motion = simulation.ride.motion(points.time_s)
    route_m = ride.route_at(motion.arc_length_m)
    verdicts = _verdicts(ride, points.spots, route_m)
    beyond = [
        judge.ways(ride, points.spots, verdicts, route_m, way, parted)
        for way, parted in ((judge.BEYOND_M, False), (judge.BEYOND_M / 2, False),
                            (judge.BEYOND_M, True))
    ]  # fmt: skip
    beside = _beside(ride, route_m)
    right, on_route = verdicts.right, np.isfinite(verdicts.along_m) & verdicts.on_track
    headed = verdicts.on_track & points.headed
    within = np.abs(verdicts.along_m[on_route]) <= 2.0 * points.std_m[on_route]
    tallies = {
        TRACK: _tally(right),
        STANDING: _tally(right[motion.standing]),
        MOVING: _tally(right[~motion.standing]),
        BESIDE: _tally(right[beside]),
        STRICT: _tally(verdicts.on_track),
        DIRECTION: _tally(verdicts.onward[headed]),
        **{
            name: Tally(sum(each.right for each in passed), len(passed))
            for name, passed in zip(SWITCHES, beyond, strict=True)
        },
        TWO_SIGMA: _tally(within),
        **dict.fromkeys((NEAREST_FIX, NEAREST_STATE), Tally(0, 0)),
    }
    best, candidates = _reliabilities(ride, points, verdicts, route_m)
    return Figures(
        route=case.route,
        seed=case.seed,
        length_m=float(route_m[-1] - route_m[0]),
        duration_s=float(simulation.duration_s),
        starting_s=float(points.time_s[0] - whole.time_s[0]),
        step_us=step_us,
        tallies=tallies,
        along_m=verdicts.along_m[::_ALONG_EVERY][on_route[::_ALONG_EVERY]],
        best=best,
        candidates=candidates,
        mistakes=_mistakes(ride, points, ~right, motion.standing, route_m, beyond[0]),
    )


def _tally(right: Flags) -> Tally:
    return Tally(int(np.sum(right)), len(right))


def _verdicts(ride: NetworkRide, said: Spots, route_m: Array) -> Verdicts:
    """Of all points; without an answer nothing is right."""
    rows = np.flatnonzero(said.run != NO_RUN)
    count = len(route_m)
    flags = np.zeros((3, count), dtype=np.bool_)
    along_m = np.full(count, np.nan)
    if len(rows):
        found = judge.judge(ride, Spots(said.run[rows], said.chainage_m[rows]), route_m[rows])
        flags[:, rows] = found.on_track, found.onward, found.unparted
        along_m[rows] = found.along_m
    return Verdicts(flags[0], flags[1], flags[2], along_m)


def _beside(ride: NetworkRide, route_m: Array) -> Flags:
    """Where the true track has a parallel neighbour."""
    partner = sampled(ride.network, ride.network.partner, ride.spots_at(route_m))
    beside: Flags = partner != 0
    return beside


def _reliabilities(
    ride: NetworkRide, points: Columns, verdicts: Verdicts, route_m: Array
) -> tuple[Reliability, Reliability]:
    """Of the most probable runs, and of all candidates.

    Of several candidates that are all right (the end of one run and the begin of the next; both
    directions before the matcher knows its own) the likeliest counts; the rest is the same answer.
    """
    rows, of = np.flatnonzero(points.answered), points.other_row
    others = _verdicts(ride, points.others, route_m[of])
    right = np.where(points.headed, verdicts.onward, verdicts.on_track)
    other_right = np.where(points.headed[of], others.onward, others.on_track)
    kept = ~(_again(of, other_right) | (other_right & right[of]))
    best = judge.reliability(
        points.probability[rows], right[rows], points.spots.run[rows], points.time_s[rows]
    )
    candidates = judge.reliability(
        np.append(points.probability[rows], points.other_probability[kept]),
        np.append(right[rows], other_right[kept]),
        np.append(points.spots.run[rows], points.others.run[kept]),
        np.append(points.time_s[rows], points.time_s[of][kept]),
    )
    return best, candidates


def _again(row: Integers, right: Flags) -> Flags:
    """Which right alternatives have another right one before them, of the same point."""
    again = np.zeros(len(row), dtype=np.bool_)
    found = np.flatnonzero(right)
    again[found[1:]] = row[found[1:]] == row[found[:-1]]
    return again


def _nearest(
    ride: NetworkRide,
    simulation: Simulation,
    points: Columns,
    fixes: Sequence[GnssFix],
) -> dict[str, Tally]:
    """Nearest-track matching of every valid fix, and of positions of a filter."""
    tree = cKDTree(np.column_stack([ride.network.east, ride.network.north]))
    valid = [fix for fix in fixes if fix.valid]
    degrees = np.array([(fix.latitude_deg, fix.longitude_deg) for fix in valid]).reshape(-1, 2)
    time_s = (np.array([fix.stamp_ns for fix in valid], dtype=np.int64) - EPOCH_NS) / S
    found = {}
    for name, geodetic, at_s in (
        (NEAREST_FIX, np.radians(degrees), time_s),
        (NEAREST_STATE, points.geodetic, points.time_s),
    ):
        said = _nearest_track(ride.network, tree, geodetic)
        route_m = ride.route_at(simulation.ride.motion(at_s).arc_length_m)
        found[name] = _tally(_verdicts(ride, said, route_m).right)
    return found


def _nearest_track(network: Network, tree: cKDTree, geodetic: Array) -> Spots:
    """The nearest sample of any track, as a point of the track forwards."""
    if len(geodetic) == 0:
        return Spots(np.zeros(0, dtype=np.int64), np.zeros(0))
    _, sample = tree.query(network.plan_of(geodetic))
    track = np.searchsorted(network.starts, sample, side="right") - 1
    return Spots(2 * track, (sample - network.starts[track]) * network.spacing_m[track])


def _mistakes(
    ride: NetworkRide,
    points: Columns,
    wrong: Flags,
    standing: Flags,
    route_m: Array,
    passed: Sequence[judge.Passed],
) -> tuple[Mistake, ...]:
    """Stretches on a wrong track, and switches with a wrong way, in the order of time."""
    rows = [("track", *rows) for rows in judge.stretches(wrong, points.time_s)]
    rows += [("switch", each.row, each.row) for each in passed if not each.right]
    true = ride.spots_at(route_m).run
    return tuple(
        Mistake(
            kind=kind,
            start_s=float(points.time_s[first]),
            end_s=float(points.time_s[last]),
            route_m=float(route_m[first]),
            standing=bool(standing[first]),
            true=ride.network.name_of(int(true[first])),
            true_run=int(true[first]),
            said=_name(ride.network, int(points.spots.run[first])),
            said_run=int(points.spots.run[first]),
            probability=float(points.probability[first]),
        )
        for kind, first, last in sorted(rows, key=lambda row: row[1])
    )


def _name(network: Network, run: int) -> str:
    return "" if run == NO_RUN else network.name_of(run)
