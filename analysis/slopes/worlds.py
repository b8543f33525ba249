"""The slope of simulated rides: what `grade` says of it, held to the truth, in several worlds.

Rides of `LINE` with the sensors of a scenario (the reference's, or those of `city` and `tram`, IMU
read at 400 Hz as in `worlds`) go through resampler, localisation filter and `grade`. Judged ten
times a second, from five minutes on and from the departure on: error of the slope in percent (100
tan), NEES (1 in the mean where the deviation is right), the springs' coefficient, the mass. Beside
it stands the localiser's pitch taken for the slope, as one would do without `grade`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.studies.kaspar2023 import line_of
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.graph import Graph
from tramstream.processor import Processor, Sample
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.resampling.resampler import Resampler
from tramstream.simulation import scenario
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation

Array = NDArray[np.float64]

LINE = "lines_7_20.geojson#20/0"
SEED = 101
"""First of the seeds in docs/accuracy.md."""
RATE_HZ, BATCH = 400.0, 20
JUDGED_NS = S // 10
SETTLED_S = 300.0
MASS_KG = 150_000.0
"""Of the simulated tram."""


class World(NamedTuple):
    """What is true, what is told, and what is missing."""

    name: str
    what: str
    scenario: str
    told: Mapping[str, Any] = MappingProxyType({})
    """Of `[grade]`."""
    change: Callable[[Scenario], Scenario] | None = None
    hear: Callable[[Sample], Sample | None] | None = None
    """What becomes of a sample on its way to the processors; None: it is not there."""
    localised: bool = True
    """Whether there is a localiser."""


HALF = {"pitch_deg_per_mps2": 0.15, "pitch_std_deg_per_mps2": 0.15}
"""The body of `tram` nods by 0.3°: unknown by half."""


def _without_height(sample: Sample) -> Sample | None:
    if sample.key is not keys.GNSS_FIX:
        return sample
    fix = type(sample.message)()
    fix.CopyFrom(sample.message)
    for name in ("height_ellipsoid_m", "height_msl_m", "vel_d_mps"):
        fix.ClearField(name)
    return sample._replace(message=fix)


def _without_force(sample: Sample) -> Sample | None:
    if sample.key is not keys.ODO_WHEELS:
        return sample
    reading = type(sample.message)()
    reading.CopyFrom(sample.message)
    reading.ClearField("motor_force_n")
    return sample._replace(message=reading)


def _biased(chosen: Scenario) -> Scenario:
    assert chosen.imu is not None
    bias_x, bias_y, bias_z = chosen.imu.errors.accel_bias_mps2
    errors = replace(chosen.imu.errors, accel_bias_mps2=(bias_x + 0.1, bias_y - 0.1, bias_z + 0.1))
    return replace(chosen, imu=replace(chosen.imu, errors=errors))


def _backwards(chosen: Scenario) -> Scenario:
    return replace(chosen, reverse=True)


def _lever(chosen: Scenario) -> Scenario:
    assert chosen.gnss is not None
    return replace(chosen, gnss=replace(chosen.gnss, lever_arm_error_m=(4.0, 1.0, 1.5)))


WORLDS = (
    World("reference", "sensors of the reference, no body", "kaspar2023"),
    World("city", "an ordinary day, no body", "city"),
    World("body", "scenario tram, springs told half as soft", "tram", HALF),
    World("body, springs twice", "told twice as soft", "tram", {
        "pitch_deg_per_mps2": 0.6, "pitch_std_deg_per_mps2": 0.3}),
    World("mass told 30 % more", "", "tram", {
        **HALF, "mass_kg": 1.3 * MASS_KG, "mass_std_kg": 0.3 * MASS_KG}),
    World("mass told 30 % less", "", "tram", {
        **HALF, "mass_kg": 0.7 * MASS_KG, "mass_std_kg": 0.3 * MASS_KG}),
    World("no force", "the bus has no motor force", "tram", HALF, hear=_without_force),
    World("no altitude", "fixes have neither height nor climb", "tram", HALF, hear=_without_height),
    World("bias 0.1 m/s²", "on each axis of the accelerometer, more", "tram", HALF, _biased),
    World("lever arm unknown", "antenna 4 m ahead of where it is told", "tram", HALF, _lever),
    World("backwards", "the rear cab leads", "tram", HALF, _backwards),
    World("fixes in the streets", "scenario matching", "matching"),
    World("no localiser", "fixes, wheels and force alone", "tram", HALF, localised=False),
)  # fmt: skip


class Case(NamedTuple):
    """One ride; plain values, so that it can go to another process."""

    world: str
    line: str
    seed: int = SEED
    duration_s: float | None = None


class Errors(NamedTuple):
    """Of a slope, over some time."""

    rms_percent: float
    p95_percent: float
    max_percent: float
    nees: float
    """NaN where nothing states a deviation."""


class Figures(NamedTuple):
    """One ride."""

    case: Case
    duration_s: float
    settled: Errors
    """From five minutes on."""
    departed: Errors
    """From the first departure on."""
    standing: Errors
    """At the stops after that."""
    pitch: Errors
    """Of the localiser's pitch taken for the slope, from five minutes on."""
    pitch_deg_per_mps2: float
    pitch_std_deg_per_mps2: float
    mass_error: float
    """Part of the mass, at the end; NaN where there is no force."""
    mass_std: float
    mass_known_s: float
    """After the first departure, when it was told within 2 % of itself; NaN: never."""
    events: tuple[str, ...]
    """Kinds that `grade` raised."""


def world_of(name: str) -> World:
    """Look up a world.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    for world in WORLDS:
        if world.name == name:
            return world
    names = ", ".join(world.name for world in WORLDS)
    raise ConfigError(f"no world is called {name!r}; there are: {names}")


def simulation_of(case: Case) -> Simulation:
    """Set up the ride."""
    world = world_of(case.world)
    chosen = scenario.load(world.scenario)
    imu = chosen.imu
    if imu is not None and imu.rate_hz > RATE_HZ:
        chosen = replace(chosen, imu=replace(imu, rate_hz=RATE_HZ, batch=BATCH))
    if world.change is not None:
        chosen = world.change(chosen)
    return Simulation(line_of(case.line), chosen, case.seed, case.duration_s)


def vehicle_of(simulation: Simulation, world: World) -> Vehicle:
    """Tell the vehicle what its world tells it."""
    settings = msgspec.convert(dict(world.told), GradeEstimator.Settings)
    return replace(simulation.vehicle, sections={"grade": msgspec.to_builtins(settings)})


def samples(simulation: Simulation, world: World) -> Iterator[Sample]:
    """Give what `grade` gets and says on a ride, and what the resampler and the localiser say."""
    vehicle = vehicle_of(simulation, world)
    stages: list[Processor] = [Resampler(vehicle), GradeEstimator(vehicle)]
    if world.localised:
        stages.insert(1, LocalisationFilter(vehicle))
    graph = Graph(stages)
    for sample in simulation.samples():
        heard = sample if world.hear is None else world.hear(sample)
        if heard is not None:
            yield from graph.step(heard)


class Said:
    """What was said on a ride, ten times a second, as columns."""

    def __init__(self) -> None:
        self.grade: list[tuple[float, ...]] = []
        self.pitch: list[tuple[float, ...]] = []
        self.learned: dict[str, tuple[float, float]] = {}
        self.known_s = math.nan
        self.events: dict[str, None] = {}

    def take(self, made: Iterable[Sample]) -> None:
        """Keep what is judged."""
        for each in made:
            if each.key is keys.EST_GRADE:
                self._grade(each)
            elif each.key is keys.EST_STATE:
                if each.stamp_ns % JUDGED_NS < S // 100:
                    said = each.message
                    variance = said.covariance[25]
                    self.pitch.append((each.stamp_ns, -said.pitch_rad, math.sqrt(variance), 0.0))
            elif each.key is keys.EST_GRADE_PARAMETERS:
                rows = each.message.parameters
                self.learned = {row.name: (row.value, row.std) for row in rows}
            elif each.key.path == keys.EVENT.at("grade").path:
                self.events[each.message.kind] = None

    def _grade(self, each: Sample) -> None:
        said = each.message
        known = said.HasField("mass_kg") and said.mass_std_kg < 0.02 * said.mass_kg
        if known and math.isnan(self.known_s):
            self.known_s = (each.stamp_ns - EPOCH_NS) / S
        if each.stamp_ns % JUDGED_NS < S // 100:
            self.grade.append((each.stamp_ns, said.grade_rad, said.grade_std_rad, said.speed_mps))


def study(case: Case) -> Figures:
    """Ride, and judge."""
    world, simulation = world_of(case.world), simulation_of(case)
    said = Said()
    said.take(samples(simulation, world))
    return figures(case, simulation, said)


def figures(case: Case, simulation: Simulation, said: Said) -> Figures:
    """Judge what was said."""
    columns, ride = np.array(said.grade).reshape(-1, 4), simulation.ride
    time_s = (columns[:, 0] - EPOCH_NS) / S
    departure_s = float(ride.dwells_s[0, 1])
    standing = np.asarray(ride.motion(time_s).standing)
    departed = time_s >= departure_s
    spring, spring_std = said.learned.get("pitch_per_mps2", (math.nan, math.nan))
    mass, mass_std = said.learned.get("mass", (math.nan, math.nan))
    error, std = _against_truth(simulation, columns)
    pitch = np.array(said.pitch).reshape(-1, 4)
    pitch_error, pitch_std = _against_truth(simulation, pitch)
    late = (pitch[:, 0] - EPOCH_NS) / S >= SETTLED_S
    return Figures(
        case=case,
        duration_s=simulation.duration_s,
        settled=errors(error, std, time_s >= SETTLED_S),
        departed=errors(error, std, departed),
        standing=errors(error, std, departed & standing),
        pitch=errors(pitch_error, pitch_std, late),
        pitch_deg_per_mps2=math.degrees(spring),
        pitch_std_deg_per_mps2=math.degrees(spring_std),
        mass_error=mass / MASS_KG - 1.0,
        mass_std=mass_std / MASS_KG,
        mass_known_s=said.known_s - departure_s,
        events=tuple(said.events),
    )


def _against_truth(simulation: Simulation, columns: Array) -> tuple[Array, Array]:
    """Error of a slope, and its deviation as stated; rad."""
    ride = simulation.ride
    motion = ride.motion((columns[:, 0] - EPOCH_NS) / S)
    error: Array = columns[:, 1] - ride.grade_rad(motion)
    return error, columns[:, 2]


def errors(error: Array, std: Array, chosen: NDArray[np.bool_]) -> Errors:
    """Sum up errors where they count."""
    if not chosen.any():
        return Errors(*[math.nan] * 4)
    size = 100.0 * np.abs(error[chosen])
    nees = float(np.mean((error[chosen] / std[chosen]) ** 2))
    rms = float(np.sqrt(np.mean(size**2)))
    return Errors(rms, float(np.percentile(size, 95)), float(size.max()), nees)
