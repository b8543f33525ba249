"""The contract of processors, held to all of ours and to one of a package of somebody else."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest
from installed import COMFORT, install, put_on_path
from msgspec.structs import replace

from tramstream import keys
from tramstream.config import Map, Vehicle
from tramstream.graph import Graph
from tramstream.lines.line import built_in_line
from tramstream.processor import Processor, Sample
from tramstream.processors.consistency.processor import ConfigurationCheck
from tramstream.processors.distance.processor import DistanceFilter
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.resampling.resampler import Resampler
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.processors.warm_up import one_track
from tramstream.recorder.reprocess.contract import ProcessorContract
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation
from tramstream.tracks.signature import of_line

LOW_MPS2 = 0.01
"""Limit that even a vehicle that stands exceeds again and again."""


@cache
def ride() -> Simulation:
    """A departure and a curve."""
    return Simulation(built_in_line(), scenario.load("city"), seed=1, duration_s=40.0)


@cache
def sent() -> tuple[Sample, ...]:
    return tuple(ride().samples())


class Contract(ProcessorContract):
    def samples(self) -> Iterable[Sample]:
        return sent()


class TestResampler(Contract):
    def make(self) -> list[Processor]:
        return [Resampler(ride().vehicle)]


class TestDistanceFilter(Contract):
    def make(self) -> list[Processor]:
        return [Resampler(ride().vehicle), DistanceFilter(ride().vehicle)]

    def others(self) -> list[Processor]:
        return [LocalisationFilter(ride().vehicle)]


class TestLocalisationFilter(Contract):
    def make(self) -> list[Processor]:
        return [Resampler(ride().vehicle), LocalisationFilter(ride().vehicle)]

    def others(self) -> list[Processor]:
        return [DistanceFilter(ride().vehicle)]


class TestMapMatcher(Contract):
    """With the filter that it corrects: they feed each other."""

    @pytest.fixture(autouse=True)
    def _mapped(self, tmp_path: Path) -> None:
        network = tmp_path / "line.tracks"
        one_track(ride().line).save(network)
        self.vehicle = replace(ride().vehicle, map=Map(network=str(network), std_m=0.1))

    def make(self) -> list[Processor]:
        made = (Resampler, LocalisationFilter, MapMatcher)
        return [each(self.vehicle) for each in made]

    def others(self) -> list[Processor]:
        return [DistanceFilter(self.vehicle)]

    def test_filter_takes_what_the_matcher_says(self) -> None:
        graph = Graph(self.make())
        said = [each for sample in sent() for each in graph.step(sample)]
        assert not [each for each in said if each.key is keys.EST_LATE]
        taken = [
            each
            for state in said
            if state.key is keys.EST_STATE
            for each in state.message.innovations
            if each.measurement == "track_across"
        ]
        assert len(taken) > 10
        assert all(each.accepted for each in taken)


class TestGradeEstimator(Contract):
    """Behind the filter and the matcher that feed each other; it feeds back into nothing."""

    @pytest.fixture(autouse=True)
    def _mapped(self, tmp_path: Path) -> None:
        network = tmp_path / "line.tracks"
        one_track(ride().line).save(network)
        self.vehicle = replace(ride().vehicle, map=Map(network=str(network), std_m=0.1))

    def make(self) -> list[Processor]:
        made = (Resampler, LocalisationFilter, MapMatcher, GradeEstimator)
        return [each(self.vehicle) for each in made]

    def others(self) -> list[Processor]:
        return [DistanceFilter(self.vehicle)]

    def test_nothing_is_late_among_processors_of_one_process(self) -> None:
        graph = Graph(self.make())
        said = [each for sample in sent() for each in graph.step(sample)]
        assert not [each for each in said if each.key is keys.EST_GRADE_LATE]
        slopes = [each.message for each in said if each.key is keys.EST_GRADE]
        assert slopes[-1].run == 0
        assert slopes[-1].edge
        last = slopes[-1].inputs
        assert {"accelerometer", "odometry", "gnss_height", "motor_force"} <= set(last)


class TestSegmentFinder(Contract):
    """With a line to look for, so that its particles are memory too."""

    def make(self) -> list[Processor]:
        return [Resampler(ride().vehicle), SegmentFinder(ride().vehicle, [of_line(ride().line)])]

    def others(self) -> list[Processor]:
        return [DistanceFilter(ride().vehicle)]


class TestConfigurationCheck(Contract):
    """Of a vehicle that is configured wrongly: else it has nothing to say."""

    def vehicle(self) -> Vehicle:
        vehicle = ride().vehicle
        wheels = replace(vehicle.wheels, m_per_pulse=3.6 * vehicle.wheels.m_per_pulse)
        assert vehicle.imu is not None
        return replace(vehicle, wheels=wheels, imu=replace(vehicle.imu, mounting_deg=(0, 20, 0)))

    def make(self) -> list[Processor]:
        return [Resampler(self.vehicle()), ConfigurationCheck(self.vehicle())]

    def others(self) -> list[Processor]:
        return [DistanceFilter(ride().vehicle)]


class TestForeignProcessor(Contract):
    @pytest.fixture(autouse=True)
    def _installed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        put_on_path(install(COMFORT, tmp_path / "site"), monkeypatch)
        self.module = importlib.import_module("comfort")

    def make(self) -> list[Processor]:
        comfort = self.module.Comfort(ride().vehicle)
        comfort.settings = comfort.Settings(limit_mps2=LOW_MPS2)
        return [Resampler(ride().vehicle), comfort]

    def test_its_events_are_among_what_is_tested(self) -> None:
        (kind,) = self.module.Comfort.events
        key = keys.EVENT.at("comfort").path
        graph = Graph(self.make())
        made = [each for sample in sent() for each in graph.step(sample)]
        told = [each.message for each in made if each.key.path == key]
        assert {event.kind for event in told} == {kind.name}
        assert len(told) > 1
        assert all(event.unsaid > 0 for event in told[1:])

    def others(self) -> list[Processor]:
        return [LocalisationFilter(ride().vehicle)]
