"""Rides in worlds that differ from what the operator has configured, with and without a map.

Each world of `worlds_table` is ridden with the sensors of scenario `city` (IMU read at 400 Hz, so
that a ride costs a quarter and a mean still has samples to scatter). The same frames go to a filter
without a map and to one with it; ten times a second both are held to the truth. Rides of one seed
differ in nothing but their world, so that ratios to the world as simulated today say what the world
does.

A fault counts as said with the first event of filter, matcher or resampler, a warning or worse,
since it began that the world as simulated today has not raised between then and there. Which words
are used is left to whoever raises it.

Where the noise of a world is what the posterior Cramér-Rao bound (`bound`) can hold (a point on the
rail, fixes with one correlation time, no faults), it stands beside the filter without a map.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from tramstream import config, keys
from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.consistency import NEES_SLOTS
from tramstream.analysis.evaluate.errors import Errors, errors
from tramstream.analysis.studies import bound, matching
from tramstream.analysis.studies.kaspar2023 import BUILT_IN, line_of
from tramstream.analysis.studies.matching_columns import Said
from tramstream.analysis.studies.matching_figures import TRACK
from tramstream.analysis.studies.states import SaidStates, truth_at
from tramstream.analysis.worlds.table import TODAY, World, changed, world_of
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.events.kinds import Severity
from tramstream.graph import Graph
from tramstream.processor import Sample
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto import health_pb2
from tramstream.proto.sync_pb2 import Tick
from tramstream.simulation import scenario
from tramstream.simulation.older_map import without
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation
from tramstream.simulation.track_rides import NetworkRide, lay, route_of
from tramstream.simulation.vehicle import configuration
from tramstream.tracks.network import Array

SCENARIO = "city"
RATE_HZ, BATCH = 400.0, 20
TICK_NS = S // 10
"""From tick to tick, as live, and from one judged frame to the next."""
DURATION_S = 300.0
SEED = 101
"""First of the seeds in docs/accuracy.md."""
FREE, MAPPED = "no map", "map"


class Case(NamedTuple):
    """One ride; plain values, so that it can go to another process."""

    world: str
    line: str = BUILT_IN
    """LINE/DIRECTION of the network; without one `built-in` or FILE.geojson#LINE/DIRECTION."""
    seed: int = SEED
    duration_s: float = DURATION_S
    network: str | None = None
    """File; without it there is no map."""

    @property
    def today(self) -> Case:
        """The same ride in the world as simulated today."""
        return self._replace(world=TODAY)


class Raised(NamedTuple):
    """An event that was said on a ride."""

    time_s: float
    source: str
    kind: str
    texts: tuple[str, ...]
    """Among its facts: which of many."""


class Figures(NamedTuple):
    """One filter on one ride; NaN and None where there is nothing to say."""

    case: Case
    with_map: bool
    duration_s: float
    states: int
    p50_m: float
    """Horizontal,"""
    p90_m: float
    moving_p90_m: float
    """Since the first departure: before it nobody sees the error of the fixes."""
    rms_m: float
    max_m: float
    max_at_s: float
    nees: float
    """Of the position: 2 in the mean where the covariance is right."""
    beyond_share: float | None
    """Of the time, the error along or across is beyond the published protection level."""
    protection_m: float | None
    """Mean level across."""
    heading_rms_deg: float
    right_track_share: float | None
    fault_s: float | None
    """When the world's fault shows."""
    raised: tuple[Raised, ...]
    bound_p90_m: float | None = None
    """Of the posterior Cramér-Rao bound since the first departure; expected, not of this ride's
    chance."""


# Rides --------------------------------------------------------------------------------------------
def base() -> Scenario:
    """The sensors of the world as simulated today."""
    chosen = scenario.load(SCENARIO)
    assert chosen.imu is not None
    return replace(chosen, imu=replace(chosen.imu, rate_hz=RATE_HZ, batch=BATCH))


def told(world: World) -> config.Vehicle:
    """What the operator has configured: of the vehicle as he takes it to be."""
    return configuration(changed(base(), world.told))


@cache
def network_ride(network: str, line: str, seed: int, world: str) -> NetworkRide:
    """Lay the truth beside an operator's line, once a process, as in the world of a name."""
    known = matching.load(network)
    (meant,) = matching.lines(known, (line,))
    (route,) = (each for each in known.lines if f"{each.line}/{each.direction}" == meant)
    rng = np.random.default_rng([seed, zlib.crc32(line.encode())])
    return lay(known, route_of(route), rng, _world(world).map_error)


def simulation_of(case: Case, ride: NetworkRide | None = None) -> Simulation:
    """Set up what is true of a ride."""
    world = _world(case.world)
    line = ride.line if ride is not None else line_of(case.line)
    chosen = changed(base(), world.true)
    duration_s = min(case.duration_s, world.duration_s or case.duration_s)
    if world.events is not None:
        without = Simulation(line, chosen, case.seed, duration_s)
        happens = world.events(without.ride, without.duration_s)
        chosen = replace(chosen, events=(*chosen.events, *happens))
    return Simulation(line, chosen, case.seed, duration_s)


def _world(name: str) -> World:
    world = world_of(name)
    if world is None:
        raise ConfigError(f"no world is called {name!r}")
    return world


def fault_s(case: Case, simulation: Simulation) -> float | None:
    """When the fault of a ride shows; None if its world has none that is to be said."""
    world = _world(case.world)
    if world.wanted.said_s is None:
        return None
    if world.moving:
        return float(simulation.ride.dwells_s[0, 1])
    added = simulation.scenario.events[len(base().events) :]
    return added[0].start_s if added else None


def study(case: Case) -> list[Figures]:
    """Run one ride through the filter without its map and, if there is one, with it."""
    world = _world(case.world)
    ride = None
    if case.network is not None:
        ride = network_ride(case.network, case.line, case.seed, _same_map(world))
    simulation = simulation_of(case, ride)
    vehicle = told(world)
    runs = [_Run(vehicle)]
    if case.network is not None:
        runs.append(_mapped(vehicle, case, world, ride))
    for frame in _frames(simulation, vehicle, runs):
        for run in runs:
            run.step(frame)
    found = [_figures(case, simulation, ride, run) for run in runs]
    if world.bound:
        found[0] = found[0]._replace(bound_p90_m=bound_p90_m(simulation))
    return found


def bound_p90_m(simulation: Simulation) -> float | None:
    """P90 of the bound since the first departure; None if the ride ends before it.

    What the bound leaves out (multipath, drifts of standing fixes, scales) makes it smaller.
    """
    begin_s = float(simulation.ride.dwells_s[0, 1])
    series = bound.series(simulation)
    moving = series.time_s >= begin_s
    return bound.horizontal_quantile_m(series.covariance[moving], 0.9) if moving.any() else None


def _mapped(vehicle: config.Vehicle, case: Case, world: World, ride: NetworkRide | None) -> _Run:
    """Set up the filter with the map that its operator has."""
    assert case.network is not None
    if world.lacks_m is None or ride is None:
        return _Run(replace(vehicle, map=config.Map(network=case.network)))
    (lacked,) = ride.spots_at([world.lacks_m]).run.tolist()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "older"
        without(ride.network, lacked >> 1).save(path)
        return _Run(replace(vehicle, map=config.Map(network=str(path))))


def _same_map(world: World) -> str:
    """Name of the world whose rails lie as those of this one: most lie as today's."""
    return world.name if world.map_error != _world(TODAY).map_error else TODAY


def _frames(
    simulation: Simulation, vehicle: config.Vehicle, runs: Sequence[_Run]
) -> Iterator[Sample]:
    """Frames as the configured resampler makes them; what it says is said to each run."""
    graph = Graph([Resampler(vehicle)])
    for sample in _ticked(simulation.samples()):
        for released in graph.step(sample):
            if released.key is keys.SYNC_FRAME:
                yield released
            else:
                for run in runs:
                    run.hear(released)


def _ticked(samples: Iterable[Sample]) -> Iterator[Sample]:
    """Let time pass as the processors' process does, for rides without inertial data."""
    next_ns = 0
    for sample in samples:
        next_ns = next_ns or sample.publish_ns + TICK_NS
        while sample.publish_ns >= next_ns:
            yield Sample(keys.SYNC_TICK, Tick(stamp_ns=next_ns), next_ns, 0, next_ns)
            next_ns += TICK_NS
        yield sample


class _Run:
    """A filter on its way, and what it says."""

    def __init__(self, vehicle: config.Vehicle) -> None:
        self.with_map = vehicle.map is not None
        stages = [LocalisationFilter(vehicle)]
        self._graph = Graph([*stages, MapMatcher(vehicle)] if self.with_map else stages)
        self.states, self.matches = SaidStates("tram"), Said()
        self.raised: list[Raised] = []
        self._judged_ns = 0

    def step(self, frame: Sample) -> None:
        outputs = self._graph.step(frame)
        for output in outputs:
            self.hear(output)
        if frame.stamp_ns >= self._judged_ns + TICK_NS:
            self._judged_ns = frame.stamp_ns // TICK_NS * TICK_NS
            self.matches.keep(outputs)
            for output in outputs:
                if output.key is keys.EST_STATE:
                    self.states.keep(output.message)

    def hear(self, sample: Sample) -> None:
        message = sample.message
        if not isinstance(message, health_pb2.Event):
            return
        if int(message.severity) in (Severity.WARNING, Severity.ERROR):
            texts = tuple(fact.text for fact in message.facts if fact.HasField("text"))
            time_s = (sample.stamp_ns - EPOCH_NS) / S
            self.raised.append(Raised(time_s, message.source, message.kind, texts))


# Judging ------------------------------------------------------------------------------------------
def _figures(case: Case, simulation: Simulation, ride: NetworkRide | None, run: _Run) -> Figures:
    known = run.states.states(simulation.line.level)
    judged = errors(known, truth_at(simulation, known.stamp_ns))
    track = None
    if ride is not None and run.with_map and len(judged):
        named = matching.Case(case.network or "", case.line, case.seed)
        tallies = matching.figures(named, ride, simulation, run.matches).tallies
        track = tallies[TRACK].share
    protection = consistency.protection(judged)
    return Figures(
        case=case,
        with_map=run.with_map,
        duration_s=simulation.duration_s,
        states=len(judged),
        **_errors(judged),
        moving_p90_m=_since(judged, float(simulation.ride.dwells_s[0, 1])),
        nees=_nees(judged),
        beyond_share=None if protection is None else protection.exceeded_any_share,
        protection_m=None if protection is None else protection.mean_m[1],
        right_track_share=track,
        fault_s=fault_s(case, simulation),
        raised=tuple(run.raised),
    )


def _since(judged: Errors, begin_s: float) -> float:
    """P90 from a time of the ride on; NaN where nothing is left."""
    size = judged.horizontal_m[judged.stamp_ns >= EPOCH_NS + begin_s * S]
    return float(np.percentile(size, 90)) if len(size) else float("nan")


def _nees(judged: Errors) -> float:
    """Mean over the ride, of the position; NaN where there is none."""
    series = consistency.nees_series(judged, NEES_SLOTS["position"])
    known = series[np.isfinite(series)]
    return float(known.mean()) if len(known) else float("nan")


def _errors(judged: Errors) -> dict[str, float]:
    size = judged.horizontal_m
    if not len(size):
        nothing = ("p50_m", "p90_m", "rms_m", "max_m", "max_at_s", "heading_rms_deg")
        return dict.fromkeys(nothing, float("nan"))
    worst = int(size.argmax())
    heading: Array = np.degrees(judged.yaw_rad[np.isfinite(judged.yaw_rad)])
    return {
        "p50_m": float(np.percentile(size, 50)),
        "p90_m": float(np.percentile(size, 90)),
        "rms_m": float(np.sqrt(np.mean(size**2))),
        "max_m": float(size[worst]),
        "max_at_s": (int(judged.stamp_ns[worst]) - EPOCH_NS) / S,
        "heading_rms_deg": float(np.sqrt(np.mean(heading**2))) if len(heading) else float("nan"),
    }


def said(figures: Figures, today: Iterable[Raised]) -> Raised | None:
    """The event that says the fault: the first that is news; None if it was never said.

    Parameters
    ----------
    figures : Figures
    today : iterable of Raised
        What the same filter said on the same ride in the world as simulated today.
    """
    if figures.fault_s is None:
        return None
    usual = [(each.time_s, each[1:]) for each in today if each.time_s >= figures.fault_s]
    for each in figures.raised:
        if each.time_s < figures.fault_s:
            continue
        if not any(time_s <= each.time_s and what == each[1:] for time_s, what in usual):
            return each
    return None
