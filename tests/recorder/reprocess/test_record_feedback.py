"""Filter and map matcher feed each other: together, apart, repeated, killed: the same bits."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest
from networks import network_of
from rides import altered, laid, reference
from scripted import START_NS, VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import config_file, keys
from tramstream.clock import S
from tramstream.config import MATCHER, Map, Vehicle
from tramstream.keys import Key
from tramstream.live import registry
from tramstream.live.host import Memory, ProcessorNode
from tramstream.processor import Sample
from tramstream.processors.localisation.events import TRACK_UNHEARD
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import Rerun, rerun, vehicle_of
from tramstream.simulation.simulation import EPOCH_NS, Simulation
from tramstream.transport.bus import Envelope, LocalBus, Subscription

PLAN = "| 120 L60/70 100 R80/60 80 |"
CITY = {
    "speed_mps": 10.0,
    "acceleration_mps2": 0.8,
    "jerk_mps3": 0.5,
    "lateral_mps2": 1.3,
    "dwell_s": 6.0,
    "first_dwell_s": 6.0,
}
RIDE_S = 32.0
HELD_S = 20.0, 20.5
"""The matcher stands still."""
DEAD_S = 20.0, 21.5
"""The matcher is dead."""
COMPARED = (keys.EST_STATE, keys.EST_NOW, keys.MAP_MATCH, keys.MAP_TRACK)
STATIONS = 5
"""So many messages go by before the matcher's process is heard of, at most."""


@cache
def simulation() -> Simulation:
    chosen = altered(reference(), driver=CITY)
    return Simulation(laid(PLAN), chosen, seed=1, duration_s=RIDE_S)


@cache
def sent() -> tuple[Sample, ...]:
    return tuple(simulation().samples())


def vehicle(folder: Path, apart: bool) -> Vehicle:
    network = folder / "line.tracks"
    if not network.exists():
        network_of([laid(PLAN)]).save(network)
    return altered(
        simulation().vehicle,
        vehicle=VEHICLE,
        map=Map(network=str(network), std_m=0.1),
        separate=(MATCHER,) if apart else (),
    )


class Process:
    """A node whose loop is led by the hand."""

    def __init__(self, name: str, chosen: Vehicle, bus: LocalBus, folder: Path) -> None:
        names = registry.joint(chosen) if name == registry.PROCESSORS else [name]
        processors = [registry.make_processor(each, chosen) for each in names]
        memory = Memory(
            folder / f"{name}.snapshot",
            config_file.digest(chosen),
            ticks=name == registry.PROCESSORS,
        )
        node = ProcessorNode(name, VEHICLE, bus, Script(), processors, (), memory)
        self.node = node
        self._subscriptions: list[Subscription] = [
            bus.subscribe(keys.full(VEHICLE, each), self._deliver) for each in node.expressions()
        ]
        self.loses: Callable[[Envelope], bool] = lambda envelope: False
        node.begin()

    def _deliver(self, envelope: Envelope) -> None:
        if not self.loses(envelope):
            self.node.ring.put(envelope.topic, envelope)

    def work(self) -> None:
        self.node.drain()
        self.node._run_timers()

    def kill(self) -> None:
        for each in self._subscriptions:
            each.close()

    def end(self) -> None:
        self.work()
        self.kill()
        self.node.finish()


@dataclass
class Ride:
    """What was heard of a ride, and its record."""

    path: Path
    ear: Ear
    reports: dict[str, int] = field(default_factory=dict)

    def said(self, key: Key) -> list[tuple[int, bytes]]:
        topic = key.on(VEHICLE)
        return [(e.sequence, e.payload) for e in self.ear.envelopes if e.topic == topic]


@contextmanager
def recorded(path: Path, bus: LocalBus, chosen: Vehicle) -> Iterator[None]:
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(chosen)}
    with RecordFile(path, VEHICLE, metadata) as record:

        def write(envelope: Envelope) -> None:
            key = keys.find(keys.split(envelope.topic)[1])
            assert key is not None
            times = envelope.arrival_ns, envelope.publish_ns, envelope.sequence
            record.append(envelope.topic, key, envelope.payload, *times)

        bus.subscribe("tram/**", write)
        yield


def ridden(
    folder: Path,
    apart: bool = True,
    held_s: tuple[float, float] = (0.0, 0.0),
    dead_s: tuple[float, float] = (0.0, 0.0),
    loses: Callable[[Envelope], bool] | None = None,
) -> Ride:
    """Ride with the matcher in the filter's process or in one of its own."""
    folder.mkdir(mode=0o700, exist_ok=True)
    chosen = vehicle(folder, apart)
    clock = ManualClock()
    clock.advance((EPOCH_NS - START_NS) / S)
    bus = LocalBus(clock)
    ride = Ride(folder / "ride.mcap", Ear(bus))
    sender = Sender(bus)
    with recorded(ride.path, bus, chosen):
        filters = Process(registry.PROCESSORS, chosen, bus, folder)
        if loses is not None:
            filters.loses = loses
        matcher = Process(MATCHER, chosen, bus, folder) if apart else None
        for number, sample in enumerate(sent()):
            clock.advance(max(0.0, (sample.publish_ns - clock.now_ns()) / S))
            time_s = (sample.publish_ns - EPOCH_NS) / S
            message = type(sample.message)()
            message.CopyFrom(sample.message)
            sender.send(sample.key, message)
            filters.work()
            if matcher is not None and dead_s[0] < time_s < dead_s[1]:
                matcher.kill()
                matcher = None
            elif matcher is None and apart and time_s > dead_s[1]:
                matcher = Process(MATCHER, chosen, bus, folder)
            if matcher is not None and not held_s[0] < time_s < held_s[1]:
                if number % STATIONS == 0:
                    matcher.work()
                filters.work()
        for each in (matcher, filters):
            if each is not None:
                each.end()
    return ride


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    return ridden(tmp_path_factory.mktemp("together") / "ride", apart=False)


@pytest.fixture(scope="module")
def asunder(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    return ridden(tmp_path_factory.mktemp("apart") / "ride")


def repeated(ride: Ride, cores: int, monkeypatch: pytest.MonkeyPatch, out: Path) -> Rerun:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cores)))
    result = rerun(ride.path, out / f"again{cores}.mcap", None, check=True)
    assert result.comparison is not None
    assert result.comparison.differences == []
    assert result.identical
    assert result.comparison.unrecorded == 0
    return result


def accepted(ride: Ride) -> int:
    """How often the filter was put onto the track."""
    return sum(
        each.measurement == "track_across" and each.accepted
        for state in ride.ear.heard(keys.EST_STATE)
        for each in state.innovations
    )


def test_matcher_of_its_own_gives_the_bits_of_one_in_the_filters_process(
    together: Ride, asunder: Ride
) -> None:
    assert accepted(together) > 50
    for key in COMPARED:
        assert together.said(key), key.path
        assert asunder.said(key) == together.said(key), key.path
    assert asunder.said(keys.EST_LATE) == []


@pytest.mark.parametrize("cores", [1, 2])
def test_ride_with_the_matcher_apart_or_not_is_repeated(
    together: Ride,
    asunder: Ride,
    cores: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for ride, name in ((together, "together"), (asunder, "apart")):
        (tmp_path / name).mkdir()
        repeated(ride, cores, monkeypatch, tmp_path / name)


@pytest.mark.parametrize("cores", [1, 2])
def test_geometry_that_comes_late_is_named_and_left_out_again(
    asunder: Ride, cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The matcher stands still for half a second."""
    ride = ridden(tmp_path / "held", held_s=HELD_S)
    late = ride.ear.heard(keys.EST_LATE)
    assert len(late) >= 2
    assert {each.key for each in late} == {keys.MAP_TRACK.path}
    delay_ns = round(0.2 * S)
    assert all(each.horizon_ns >= each.stamp_ns + delay_ns for each in late)
    assert ride.said(keys.EST_STATE) != asunder.said(keys.EST_STATE)
    repeated(ride, cores, monkeypatch, tmp_path)


@pytest.mark.parametrize("cores", [1, 2])
def test_matcher_that_is_killed_goes_on_from_its_memory_and_the_ride_is_repeated(
    asunder: Ride, cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ride = ridden(tmp_path / "killed", dead_s=DEAD_S)
    first, second = ride.ear.heard(keys.MEMORY.at(MATCHER))
    assert first.session != second.session
    lost_s = [
        (b.stamp_ns - a.stamp_ns) / S
        for a, b in zip(
            ride.ear.heard(keys.MAP_MATCH)[:-1], ride.ear.heard(keys.MAP_MATCH)[1:], strict=True
        )
        if b.sequence <= a.sequence
    ]
    assert len(lost_s) == 1, "its numbers go on from the memory of some seconds ago"
    assert lost_s[0] > 1.0
    numbers = [each.sequence for each in ride.ear.heard(keys.MAP_MATCH)]
    assert min(numbers[1:]) > 1, "it remembers"
    # The filter goes on without a map meanwhile.
    assert len(ride.said(keys.EST_STATE)) == len(asunder.said(keys.EST_STATE))
    repeated(ride, cores, monkeypatch, tmp_path)


def test_matcher_that_stays_dead_leaves_the_filter_running_without_a_map_and_said_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ride = ridden(tmp_path / "dead", dead_s=(16.0, RIDE_S + 60.0))
    said = [each.kind for each in ride.ear.heard(keys.EVENT.at("ekf"))]
    assert said.count(TRACK_UNHEARD.name) == 1
    last = ride.ear.heard(keys.EST_STATE)[-1]
    assert (last.stamp_ns - EPOCH_NS) / S > RIDE_S - 1.0
    assert "track_across" not in {each.measurement for each in last.innovations}


@pytest.mark.parametrize(("fields", "runs"), [({}, True), ({"source": "est/ekf/state"}, False)])
def test_record_of_a_version_whose_filter_held_the_matcher_gets_one_beside_it(
    fields: dict[str, str], runs: bool, tmp_path: Path
) -> None:
    """Now it is the configuration that says whether a matcher runs."""
    old = {
        "vehicle": VEHICLE,
        "processors": ["resampler", "ekf"],
        "map": {"network": "n", **fields},
    }
    path = tmp_path / "old.mcap"
    with RecordFile(path, VEHICLE, {config_file.RECORD_ENTRY: json.dumps(old)}):
        pass
    with open_record(path) as record:
        assert (MATCHER in vehicle_of(record, path).running) == runs


@pytest.mark.parametrize("cores", [1, 2])
def test_geometry_that_the_bus_loses_is_left_out_again(
    asunder: Ride, cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    topic = keys.MAP_TRACK.on(VEHICLE)

    def loses(envelope: Envelope) -> bool:
        return envelope.topic == topic and envelope.sequence in (40, 41, 57)

    ride = ridden(tmp_path / "lossy", loses=loses)
    losses: list[Loss] = ride.ear.heard(keys.LOSS.at(registry.PROCESSORS))
    assert sum(each.count for each in losses if each.key == topic) == 3
    assert ride.said(keys.EST_STATE) != asunder.said(keys.EST_STATE)
    repeated(ride, cores, monkeypatch, tmp_path)
