"""A simulated day of eight hours through the filter with and without its map: does anything grow?

The day is that of `day_way`, with the sensors of scenario `city`, its IMU read four times a frame.
The same frames go to a filter without a map and to one with it. Each eighth of the day is judged by
itself and then forgotten, so that what the process holds more at its end is what the processors
keep. Their memory, with that of resampler and configuration's check, is counted as it would be
written for a restart; core time is that of filter and matcher alone.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from tramstream import config, keys
from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.consistency import NEES_SLOTS
from tramstream.analysis.evaluate.errors import errors
from tramstream.analysis.studies import matching
from tramstream.analysis.studies.matching_columns import Said
from tramstream.analysis.studies.matching_figures import TRACK
from tramstream.analysis.studies.states import SaidStates, truth_at
from tramstream.analysis.worlds.day_way import Day, day
from tramstream.analysis.worlds.study import FREE, MAPPED, SEED, base
from tramstream.clock import S
from tramstream.events.kinds import Severity
from tramstream.graph import Graph
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.processors.consistency.processor import ConfigurationCheck
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto import health_pb2
from tramstream.proto.sync_pb2 import Tick
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation
from tramstream.simulation.track_rides import NetworkRide, lay

LINES = ("7/0", "7/1")
HOURS = 8.0
HOUR_S = 3600.0
PARTS = 8
"""Judged by themselves."""
FRAME_HZ = 100.0
"""Frames a second, each of `SAMPLES` inertial samples; fewer cost less."""
SAMPLES = 4
BATCH_S = 0.05
TICK_NS = S // 10
JUDGED_NS = S // 5
"""From one judged frame to the next."""
ROUND_S, OTHER_S = 6600.0, 2500.0
"""About what a round takes with its breaks; what of a day is on the way from and to the storage."""


class Case(NamedTuple):
    """One day; plain values, so that it can go to another process."""

    network: str
    """File."""
    lines: tuple[str, ...] = LINES
    """LINE/DIRECTION, gone one after another."""
    hours: float = HOURS
    seed: int = SEED
    frame_hz: float = FRAME_HZ
    filters: tuple[str, ...] = (FREE, MAPPED)

    @property
    def day_s(self) -> float:
        return self.hours * HOUR_S

    @property
    def rounds(self) -> int:
        """As many as fit into the day; a short one ends on the way."""
        return max(int((self.day_s * (1 - 1 / PARTS) - OTHER_S) / ROUND_S), 1)


class Part(NamedTuple):
    """One filter in one part of the day; NaN and None where there is nothing to say."""

    number: int
    """From 1 on."""
    with_map: bool
    way_m: float
    standing_share: float
    states: int
    p50_m: float
    """Horizontal,"""
    p90_m: float
    max_m: float
    nees: float
    """Of the position: 2 in the mean where the covariance is right."""
    beyond_share: float | None
    """Of the time, the error along or across is beyond the published protection level."""
    protection_m: float | None
    """Mean level across."""
    right_track_share: float | None
    frames: int
    step_us: float
    """Core time a frame, which grows with the machine's load."""
    memory: dict[str, int]
    """Bytes, of each processor, at the end."""
    process_bytes: int
    """Resident, at the end: of the whole process, with the simulator and both filters."""
    raised: dict[str, int]
    """Events, warnings and worse, by kind."""

    @property
    def memory_bytes(self) -> int:
        """Of all processors."""
        return sum(self.memory.values())


class Setting(NamedTuple):
    """What a day's filters need."""

    plan: Day
    ride: NetworkRide
    simulation: Simulation


def sensors(frame_hz: float) -> Scenario:
    """Give the sensors of the worlds, the IMU read `SAMPLES` times a frame.

    Without the drift of standing fixes, which goes straight on for as long as a vehicle stands: in
    a break of half an hour they were 228 m off.
    """
    chosen = base()
    assert chosen.imu is not None
    assert chosen.gnss is not None
    rate_hz = SAMPLES * frame_hz
    imu = replace(chosen.imu, rate_hz=rate_hz, batch=max(round(BATCH_S * rate_hz), 1))
    gnss = replace(chosen.gnss, errors=replace(chosen.gnss.errors, standing_drift_mps=0.0))
    return replace(chosen, imu=imu, gnss=gnss, resampler=config.Resampler(factor=SAMPLES))


def setting(case: Case) -> Setting:
    """Lay the day's way and set up its sensors."""
    network = matching.load(case.network)
    known = {f"{line.line}/{line.direction}": line for line in network.lines}
    lines = [known[name] for name in matching.lines(network, case.lines)]
    way_rng, rails_rng = np.random.default_rng(case.seed).spawn(2)
    plan = day(network, lines, case.rounds, case.day_s, way_rng)
    ride = lay(network, plan.route, rails_rng)
    chosen = sensors(case.frame_hz)
    driver = replace(chosen.driver, turns_back=plan.turns_back, breaks=plan.breaks)
    events = (*chosen.events, *plan.events)
    chosen = replace(chosen, driver=driver, end_s=case.day_s, events=events)
    return Setting(plan, ride, Simulation(ride.line, chosen, case.seed, case.day_s))


def study(case: Case, stopped: Callable[[], bool] = lambda: False) -> Iterator[Part]:
    """Go through the day; figures come as soon as a part of it is over, or once it is `stopped`."""
    return parts(case, setting(case), stopped)


def parts(case: Case, made: Setting, stopped: Callable[[], bool] = lambda: False) -> Iterator[Part]:
    """Go through a day that is set up."""
    vehicle = made.simulation.vehicle  # as an operator knows it: of the sensors alone
    mapped = replace(vehicle, map=config.Map(network=case.network))
    shared: list[Processor] = [Resampler(vehicle), ConfigurationCheck(vehicle)]
    runs = [_Run(mapped if each == MAPPED else vehicle, shared) for each in case.filters]
    length_s = made.simulation.duration_s / PARTS
    number, time_s = 1, 0.0
    for frame in _frames(made.simulation, Graph(shared)):
        time_s = (frame.stamp_ns - EPOCH_NS) / S
        while number < PARTS and time_s >= number * length_s:
            span_s = ((number - 1) * length_s, number * length_s)
            yield from (_part(case, made, run, number, span_s) for run in runs)
            number += 1
        if stopped():
            break
        for run in runs:
            run.step(frame)
    yield from (_part(case, made, run, number, ((number - 1) * length_s, time_s)) for run in runs)


def _frames(simulation: Simulation, graph: Graph) -> Iterator[Sample]:
    """Frames as the resampler makes them; time passes as in the processors' process."""
    next_ns = 0
    for sample in simulation.samples():
        next_ns = next_ns or sample.publish_ns + TICK_NS
        while sample.publish_ns >= next_ns:
            tick = Sample(keys.SYNC_TICK, Tick(stamp_ns=next_ns), next_ns, 0, next_ns)
            yield from _released(graph, tick)
            next_ns += TICK_NS
        yield from _released(graph, sample)


def _released(graph: Graph, sample: Sample) -> Iterator[Sample]:
    return (each for each in graph.step(sample) if each.key is keys.SYNC_FRAME)


class _Run:
    """A filter on its way, and what it says in a part of the day."""

    def __init__(self, vehicle: config.Vehicle, shared: Sequence[Processor]) -> None:
        self.with_map = vehicle.map is not None
        stages: list[Processor] = [LocalisationFilter(vehicle)]
        if self.with_map:
            stages.append(MapMatcher(vehicle))
        self._graph = Graph(stages)
        self._all = [*shared, *stages]
        self._judged_ns = 0
        self.forget()

    def forget(self) -> None:
        """Begin the next part."""
        self.states, self.matches = SaidStates("tram"), Said()
        self.raised: Counter[str] = Counter()
        self.frames, self.core_s = 0, 0.0

    @property
    def memory(self) -> dict[str, int]:
        """Bytes of each processor, those that all runs share among them."""
        return {each.name: len(snapshots.pack(each.snapshot())) for each in self._all}

    def step(self, frame: Sample) -> None:
        began_s = time.thread_time()
        outputs = self._graph.step(frame)
        self.core_s += time.thread_time() - began_s
        self.frames += 1
        judged = frame.stamp_ns >= self._judged_ns + JUDGED_NS
        if judged:
            self._judged_ns = frame.stamp_ns // JUDGED_NS * JUDGED_NS
            self.matches.keep(outputs)
        for output in outputs:
            if judged and output.key is keys.EST_STATE:
                self.states.keep(output.message)
            elif isinstance(output.message, health_pb2.Event) and _warns(output.message):
                self.raised[output.message.kind] += 1


def _warns(event: health_pb2.Event) -> bool:
    return int(event.severity) in (Severity.WARNING, Severity.ERROR)


def _part(case: Case, made: Setting, run: _Run, number: int, span_s: tuple[float, float]) -> Part:
    """Judge what a filter said in a part of the day, and forget it."""
    simulation = made.simulation
    known = run.states.states(simulation.line.level)
    judged = errors(known, truth_at(simulation, known.stamp_ns))
    size = judged.horizontal_m
    nees = consistency.nees_series(judged, NEES_SLOTS["position"])
    nees = nees[np.isfinite(nees)]
    protection = consistency.protection(judged)
    track = None
    if run.with_map and len(judged):
        named = matching.Case(case.network, made.plan.route.name, case.seed)
        tallies = matching.figures(named, made.ride, simulation, run.matches).tallies
        track = tallies[TRACK].share
    time_s = np.linspace(*span_s, 1000)
    gone_m = simulation.ride.gone_m(time_s)
    nothing = float("nan")
    part = Part(
        number=number,
        with_map=run.with_map,
        way_m=float(gone_m[-1] - gone_m[0]),
        standing_share=float(np.mean(simulation.ride.motion(time_s).standing)),
        states=len(judged),
        p50_m=float(np.percentile(size, 50)) if len(size) else nothing,
        p90_m=float(np.percentile(size, 90)) if len(size) else nothing,
        max_m=float(size.max()) if len(size) else nothing,
        nees=float(nees.mean()) if len(nees) else nothing,
        beyond_share=None if protection is None else protection.exceeded_any_share,
        protection_m=None if protection is None else protection.mean_m[1],
        right_track_share=track,
        frames=run.frames,
        step_us=run.core_s / run.frames * 1e6 if run.frames else nothing,
        memory=run.memory,
        process_bytes=process_bytes(),
        raised=dict(run.raised),
    )
    run.forget()
    return part


def process_bytes() -> int:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


class Growth(NamedTuple):
    """The last part of a day over the first one that is like it; 1 where nothing grows."""

    with_map: bool
    step: float
    """Core time a frame, which grows with the machine's load."""
    memory: float
    process: float
    """Over the second part: in the first the network and kernels are loaded."""


def growth(judged: Sequence[Part], with_map: bool) -> Growth | None:
    """How much more a filter takes in the end; None of less than three parts."""
    own = [each for each in judged if each.with_map == with_map]
    if len(own) < 3:
        return None
    first, second, last = own[0], own[1], own[-1]
    return Growth(
        with_map,
        last.step_us / first.step_us,
        last.memory_bytes / first.memory_bytes,
        last.process_bytes / second.process_bytes,
    )
