"""The simulated ride of kaspar2023 through localisation filters: the figures of the work.

A ride is simulated in memory, resampled, and each frame of it given to a filter of every model,
which is held to the truth twenty times a second. The work does not say how the errors of its fixes
hang together: besides our reading (0.95 per second, docs/theory.md, section 3.4) there are rides
with white errors, and others with one wheel, and with wheels that slip and slide.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from tramstream import keys
from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.consistency import NEES_SLOTS, Protection
from tramstream.analysis.evaluate.errors import MotionErrors, errors, fix_errors, statistics
from tramstream.analysis.studies import bound
from tramstream.analysis.studies.bound import Bound
from tramstream.analysis.studies.frames import frames
from tramstream.analysis.studies.states import SaidStates, geodetic_rad, truth_at
from tramstream.clock import S
from tramstream.config import Map, Vehicle
from tramstream.estimation.series import (
    Array,
    FixSeries,
)
from tramstream.graph import Graph
from tramstream.lines import geojson
from tramstream.lines.line import Line, built_in_line
from tramstream.processor import Sample
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.simulation import line_map, scenario
from tramstream.simulation.scenario import SIDES
from tramstream.simulation.simulation import Simulation

BUILT_IN = "built-in"
WORK = "kaspar2023"
EVERY = 5  # judged frames: at 20 Hz no error changes between one and the next

SMOOTHED = "tram smoothed"
"""The model `tram` with the whole ride known; judged where the heading is, at its 10 Hz."""
TWO, ONE, SLIP, WHITE = WITHOUT_MAP = ("two wheels", "one wheel", "slip", "white")
"""Kinds of rides: as in the work; one wheel read; wheels that slip or slide at `SKIDDING` of the
stops; errors of one fix that have nothing to do with those of the next."""
EXACT, NODES = WITH_MAP = ("exact map", "map nodes 0.2 m")
"""As in the work, with a map (`tramstream.simulation.line_map`): its nodes lie on the
rails; or each is off by `NODE_STD_M` to the east and to the north."""
KINDS = WITHOUT_MAP + WITH_MAP
NODE_STD_M = 0.2
MAP_STD_M = 0.02
"""What these maps have wrong beside their nodes: nothing; a filter wants some room."""
SKIDDING = 0.3

PUBLISHED = {
    "position_p90_map_m": 0.45,
    "position_p90_m": 0.55,
    "speed_std_mps": 0.018,
    "step_us": 93.0 / 400_000 * 1e6,
}
"""Of the work: with and without map; 93 s for 400,000 steps without."""


class Case(NamedTuple):
    """One ride; plain values, so that it can go to another process."""

    line: str = BUILT_IN
    """`built-in`, or FILE.geojson#LINE/DIRECTION."""
    kind: str = TWO
    """One of `KINDS`."""
    seed: int = 1
    duration_s: float | None = None


class Figures(NamedTuple):
    """One model on one ride; NaN and None where there is nothing to say."""

    model: str
    line: str
    kind: str
    seed: int
    steps: int
    step_us: float
    """Processor time of the filter with its message, this machine; NaN for the smoother."""
    gnss_p90_m: float
    """Horizontal, raw fixes."""
    position_p90_m: float
    along_rms_m: float
    across_rms_m: float
    speed_std_mps: float
    speed_mean_mps: float
    yaw_rms_deg: float
    nees: float
    """Of the position: 2 in the mean where the covariance is right."""
    nees_series: Array
    """The same second by second."""
    exceeded_along_share: float | None
    """Of the time that the true error is beyond the protection level."""
    exceeded_across_share: float | None


def line_of(source: str) -> Line:
    """Lay the built-in line or one from a map."""
    return built_in_line() if source == BUILT_IN else geojson.load(source)


def simulation_of(case: Case) -> Simulation:
    """Set up the ride."""
    chosen = scenario.load(WORK)
    gnss, wheels = chosen.gnss, chosen.wheels
    assert gnss is not None
    assert wheels is not None
    if case.kind == ONE:
        chosen = replace(chosen, wheels=replace(wheels, wheels=SIDES[:1]))
    elif case.kind == SLIP:
        skidding = replace(wheels, slides_per_stop=SKIDDING, slips_per_stop=SKIDDING)
        chosen = replace(chosen, wheels=skidding)
    elif case.kind == WHITE:
        chosen = replace(chosen, gnss=replace(gnss, errors=replace(gnss.errors, decay=0.0)))
    return Simulation(line_of(case.line), chosen, case.seed, case.duration_s)


def bound_of(case: Case) -> Bound:
    """What no filter can do better on rides of this kind; seeds differ in when wheels slip."""
    return bound.bound(simulation_of(case))


def study(case: Case, models: Sequence[str]) -> list[Figures]:
    """Run one ride through every model, by their names in `processors.models`; `tram` both ways."""
    simulation = simulation_of(case)
    with TemporaryDirectory() as folder:
        vehicle = _vehicle(simulation, case, Path(folder))
        runs = [_Run(name, vehicle) for name in models]
    fixes: list[GnssFix] = []
    for number, frame in enumerate(frames(simulation, fixes)):
        for run in runs:
            run.take(frame, number % EVERY == 0)
    raw = _fix_errors(simulation, fixes)
    said = [each for run in runs for each in run.said()]
    return [_figures(case, simulation, each, raw) for each in said]


def _vehicle(simulation: Simulation, case: Case, folder: Path) -> Vehicle:
    """The vehicle's configuration, with the map of its line if it has one."""
    if case.kind not in WITH_MAP:
        return simulation.vehicle
    error_m = NODE_STD_M if case.kind == NODES else 0.0
    network = line_map.network_of(simulation.line, error_m, np.random.default_rng(case.seed))
    network.save(folder / "network")
    settings = Map(network=str(folder / "network"), std_m=MAP_STD_M)
    return replace(simulation.vehicle, map=settings)


class _Run:
    """A model on its way, and the time that it took."""

    def __init__(self, model: str, vehicle: Vehicle) -> None:
        vehicle = replace(vehicle, ekf=replace(vehicle.ekf, model=model))
        self._filter = LocalisationFilter(vehicle)
        self._graph = Graph([self._filter, MapMatcher(vehicle)])
        self._smooths = model == TramLocaliser.name
        if self._smooths:
            self._filter.keep()
        self._said = SaidStates(model)
        self._elapsed_s = 0.0

    def take(self, frame: Sample, judged: bool) -> None:
        begin_s = time.thread_time()
        outputs = self._graph.step(frame)
        self._elapsed_s += time.thread_time() - begin_s
        self._said.steps += 1
        for output in outputs if judged else ():
            if output.key is keys.EST_STATE:
                self._said.keep(output.message)

    def said(self) -> Iterator[SaidStates]:
        """The filter's, and the smoother's if the model has one."""
        self._said.step_us = self._elapsed_s / max(self._said.steps, 1) * 1e6
        yield self._said
        if self._smooths:
            smoothed = SaidStates(SMOOTHED)
            for sample in self._filter.smoothed():
                smoothed.keep(sample.message)
                smoothed.steps += 1
            yield smoothed


def _fix_errors(simulation: Simulation, fixes: list[GnssFix]) -> MotionErrors:
    rows = [(fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m) for fix in fixes]
    stamp_ns = np.array([fix.stamp_ns for fix in fixes])
    unknown = np.full(len(fixes), np.nan)
    place = simulation.line.level.from_geodetic(geodetic_rad(np.array(rows)))
    valid = np.array([fix.valid for fix in fixes])
    series = FixSeries(stamp_ns, valid, place, speed_mps=unknown, course_yaw_rad=unknown)
    gnss = simulation.vehicle.gnss
    assert gnss is not None
    return fix_errors(series, truth_at(simulation, stamp_ns), gnss.lever_arm_m)


def _figures(case: Case, simulation: Simulation, said: SaidStates, raw: MotionErrors) -> Figures:
    states = said.states(simulation.line.level)
    judged = errors(states, truth_at(simulation, states.stamp_ns))
    nees = consistency.nees_series(judged, NEES_SLOTS["position"])
    second = judged.stamp_ns // S
    first_of_second = np.flatnonzero(np.diff(second, prepend=0) * np.isfinite(nees))
    protection: Protection | None = consistency.protection(judged)
    exceeded = protection.exceeded_share if protection else (None, None)

    def figure(error: Array, name: str) -> float:
        found = statistics(error, judged.stamp_ns, 0)
        return float(getattr(found, name)) if found else float("nan")

    return Figures(
        model=said.model,
        line=case.line,
        kind=case.kind,
        seed=case.seed,
        steps=said.steps,
        step_us=said.step_us,
        gnss_p90_m=float(np.percentile(raw.horizontal_m, 90)),
        position_p90_m=figure(judged.horizontal_m, "p90"),
        along_rms_m=figure(judged.along_m, "rms"),
        across_rms_m=figure(judged.across_m, "rms"),
        speed_std_mps=figure(judged.speed_mps, "std"),
        speed_mean_mps=figure(judged.speed_mps, "mean"),
        yaw_rms_deg=float(np.degrees(figure(judged.yaw_rad, "rms"))),
        nees=float(np.nanmean(nees)),
        nees_series=nees[first_of_second],
        exceeded_along_share=exceeded[0],
        exceeded_across_share=exceeded[1],
    )


@dataclass(frozen=True)
class Overall:
    """One model on all seeds of one kind of ride: means over the rides, mean squares for RMS."""

    model: str
    line: str
    kind: str
    rides: int
    step_us: float
    gnss_p90_m: float
    position_p90_m: float
    along_rms_m: float
    across_rms_m: float
    speed_std_mps: float
    yaw_rms_deg: float
    nees: float
    nees_low: float
    """Where that of a ride is in 95 % of all if the covariance is right,"""
    nees_high: float
    consistent: tuple[bool, ...]
    """whether it is, ride by ride."""
    exceeded_along_share: float | None
    exceeded_across_share: float | None


_SQUARED = ("along_rms_m", "across_rms_m", "speed_std_mps", "yaw_rms_deg")


def overall(figures: Sequence[Figures]) -> list[Overall]:
    """Sum up the seeds, in the order in which the kinds of rides come."""
    kinds: dict[tuple[str, str, str], list[Figures]] = {}
    for each in figures:
        kinds.setdefault((each.model, each.line, each.kind), []).append(each)
    return [_overall(rides) for rides in kinds.values()]


def _overall(rides: list[Figures]) -> Overall:
    def mean(name: str) -> float:
        values = np.array([getattr(each, name) for each in rides], dtype=float)
        return float(np.sqrt(np.mean(values**2)) if name in _SQUARED else values.mean())

    first = rides[0]
    series = [each.nees_series for each in rides]
    effective = len(series[0]) / consistency.autocorrelation_time(*series)
    bounds = consistency.mean_bounds(len(NEES_SLOTS["position"]), effective, len(rides))
    known = first.exceeded_along_share is not None
    return Overall(
        model=first.model,
        line=first.line,
        kind=first.kind,
        rides=len(rides),
        step_us=mean("step_us"),
        gnss_p90_m=mean("gnss_p90_m"),
        position_p90_m=mean("position_p90_m"),
        along_rms_m=mean("along_rms_m"),
        across_rms_m=mean("across_rms_m"),
        speed_std_mps=mean("speed_std_mps"),
        yaw_rms_deg=mean("yaw_rms_deg"),
        nees=mean("nees"),
        nees_low=bounds.low,
        nees_high=bounds.high,
        consistent=tuple(each.nees in bounds for each in rides),
        exceeded_along_share=mean("exceeded_along_share") if known else None,
        exceeded_across_share=mean("exceeded_across_share") if known else None,
    )


def over_filter(smoothed: Overall, filtered: Overall) -> dict[str, float]:
    """Figures of the smoother as multiples of the filter's."""
    names = [each.name for each in fields(Bound)]
    return {name: getattr(smoothed, name) / getattr(filtered, name) for name in names}


def over_bound(total: Overall, least: Bound) -> dict[str, float]:
    """Figures as multiples of the bound's; NaN where it has none."""
    names = [each.name for each in fields(least)]
    return {name: getattr(total, name) / getattr(least, name) for name in names}
