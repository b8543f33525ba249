"""Two publishers on one key: one is used, the other is kept apart in the record, and said."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest
from record_rides import CONFIG, drive, fix, wheels
from scripted import VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import config_file, keys
from tramstream.config import Recorder
from tramstream.events.messages import facts_of
from tramstream.live import registry
from tramstream.live.events import SECOND_PUBLISHER
from tramstream.live.host import ProcessorNode
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.columns import read_ride
from tramstream.recorder.describe import describe
from tramstream.recorder.events import SECOND_PUBLISHER as RECORDED_APART
from tramstream.recorder.exports.geojson import geojson
from tramstream.recorder.node import RecorderNode
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import Rerun, rerun
from tramstream.transport.bus import LocalBus

STEPS = 400
FIRST, SECOND = 0xAA, 0xBB


class Ride(NamedTuple):
    folder: Path
    ear: Ear
    node: ProcessorNode
    sent: dict[int, int]
    """By session: fixes, or readings of a stranger."""


class Vehicle:
    """A ride with two receivers; a recorder and the processors listen."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock()
        self.bus = LocalBus(self.clock)
        self.ear = Ear(self.bus)
        self.folder = folder
        self.first = Sender(self.bus, FIRST)
        self.second = Sender(self.bus, SECOND)
        self.stranger = Sender(self.bus, 0)
        self.others = Sender(self.bus)
        self.sent = {FIRST: 0, SECOND: 0, 0: 0}
        settings = Recorder(directory=str(folder), free_space_floor_bytes=0)
        metadata = {config_file.RECORD_ENTRY: config_file.to_json(CONFIG)}
        stop = threading.Event()
        self.recorder = RecorderNode(VEHICLE, self.bus, stop, settings, metadata)
        self.bus.subscribe(keys.full(VEHICLE, "**"), self.recorder._deliver)
        self.recorder.begin()

    def receive(self, sender: Sender, step: int) -> None:
        message = fix(step)
        if sender is not self.first:
            message.latitude_deg += 0.01
        assert sender.session is not None
        self.sent[sender.session] += 1
        sender.send(keys.GNSS_FIX, message)

    def disturb(self, step: int) -> None:
        """A stranger without our header, on the wheels."""
        self.sent[0] += 1
        self.stranger.send(keys.ODO_WHEELS, wheels(step + 1000))

    def steps(
        self, events: dict[int, Callable[[], None]], receivers: dict[str, range], strangers: range
    ) -> Iterator[Callable[[], None]]:
        def recorded(todo: Callable[[], None]) -> Callable[[], None]:
            """A step and the recorder's work on it; alone that would be waited for."""

            def both() -> None:
                todo()
                self.recorder.drain()
                self.recorder.settle_sources()

            return both

        self.first.announce("gnss")
        for step in range(STEPS):
            if step in events:
                yield events[step]
            for todo in drive(self.others, self.clock, range(step, step + 1), fixes=False):
                yield recorded(todo)
            for name, when in receivers.items():
                if step % 20 == 0 and step in when:
                    yield recorded(partial(self.receive, getattr(self, name), step))
            if step in strangers:
                yield recorded(partial(self.disturb, step))

    def ride(
        self,
        receivers: dict[str, range],
        events: dict[int, Callable[[], None]] | None = None,
        strangers: range = range(0),
    ) -> Ride:
        script = Script(*self.steps(events or {}, receivers, strangers))
        processors = registry.make_processors(CONFIG)
        node = ProcessorNode(registry.PROCESSORS, VEHICLE, self.bus, script, processors)
        node.run()
        self.recorder.drain()
        self.recorder.finish()
        return Ride(self.folder, self.ear, node, self.sent)


def checked(ride: Ride, tmp_path: Path) -> Rerun:
    again = rerun(ride.folder, tmp_path / "out.mcap", None, check=True)
    assert again.comparison is not None
    assert again.comparison.differences == []
    assert again.identical
    return again


def counts(folder: Path) -> dict[str, int]:
    with open_record(folder) as record:
        found = {keys.split(topic)[1]: info.count for topic, info in record.channels.items()}
    return {path: n for path, n in found.items() if path.startswith("raw/")}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    vehicle = Vehicle(tmp_path_factory.mktemp("clean"))
    return vehicle.ride({"first": range(STEPS)})


def test_second_receiver_and_a_stranger_are_not_used_and_kept_apart(
    clean: Ride, tmp_path: Path
) -> None:
    vehicle = Vehicle(tmp_path / "records")
    receivers = {"first": range(STEPS), "second": range(100, STEPS)}
    starts = {100: lambda: vehicle.second.announce("receiver2")}
    ride = vehicle.ride(receivers, starts, range(200, 210))
    assert ride.ear.heard(keys.EST_STATE) == clean.ear.heard(keys.EST_STATE)
    # The record has all, each under its publisher.
    apart = {key: keys.apart(key.path, session) for key, session in WHO}
    found = counts(ride.folder)
    assert found[keys.GNSS_FIX.path] == ride.sent[FIRST]
    assert found[apart[keys.GNSS_FIX]] == ride.sent[SECOND] > 10
    assert found[apart[keys.ODO_WHEELS]] == ride.sent[0] == 10
    assert found[keys.ODO_WHEELS.path] == counts(clean.folder)[keys.ODO_WHEELS.path]
    # Counted and said.
    beats = [beat for beat in ride.ear.heard(keys.HEARTBEAT) if beat.node == registry.PROCESSORS]
    beat = beats[-1]
    books = next(stage for stage in beat.stages if stage.stage == "inputs")
    assert books.dropped == ride.sent[SECOND] + ride.sent[0]
    assert books.received == books.delivered + books.dropped
    assert any(b.state == NodeHealth.DEGRADED for b in beats)
    told = [(event.kind, facts_of(event)) for event in ride.ear.heard(keys.EVENT)]
    unused = [facts["who"] for kind, facts in told if kind == SECOND_PUBLISHER.name]
    assert set(unused) == {"receiver2 (session 000000bb)", "a stranger without our header"}
    assert any(kind == RECORDED_APART.name for kind, _ in told)
    checked(ride, tmp_path)


WHO = ((keys.GNSS_FIX, SECOND), (keys.ODO_WHEELS, 0))


def test_readers_show_what_is_apart_and_compute_without_it(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "records")
    starts = {100: lambda: vehicle.second.announce("receiver2")}
    ride = vehicle.ride({"first": range(STEPS), "second": range(100, STEPS)}, starts)
    topic = keys.apart(keys.GNSS_FIX.on(VEHICLE), SECOND)
    with open_record(ride.folder) as record:
        figures = {channel.topic: channel for channel in describe(record).channels}
        assert figures[topic].type == "tramstream.GnssFix"
        assert (figures[topic].count, figures[topic].missing) == (ride.sent[SECOND], 0)
        assert figures[keys.GNSS_FIX.on(VEHICLE)].missing == 0
        fixes = read_ride(record, fixes=True).fixes
        assert fixes is not None
        assert len(fixes) == ride.sent[FIRST]
        decoded = [message for _, message in record.decoded(topic.__eq__)]
        assert {round(message.latitude_deg, 6) for message in decoded} == {50.01}
        names = {feature["properties"]["key"] for feature in geojson(record)["features"]}
        assert topic not in names or len(names) > 1


@pytest.mark.parametrize("silent_steps", [0, 5, 30])
def test_receiver_that_is_started_again_is_used_at_once_and_nothing_is_said(
    tmp_path: Path, silent_steps: int
) -> None:
    """Its token may go only after its successor's first message."""
    vehicle = Vehicle(tmp_path / "records")

    def again() -> None:
        vehicle.second.announce("gnss")

    events = {200: again, 200 + silent_steps: vehicle.first.end}
    if not silent_steps:
        events = {200: lambda: (vehicle.first.end(), again())[0]}
    receivers = {"first": range(200), "second": range(200, STEPS)}
    ride = vehicle.ride(receivers, events)
    found = counts(ride.folder)
    assert found[keys.GNSS_FIX.path] == ride.sent[FIRST] + ride.sent[SECOND]
    assert not any(keys.is_apart(path) for path in found)
    assert ride.node.refusals.count == 0
    seconds = {SECOND_PUBLISHER.name, RECORDED_APART.name}
    assert not [event for event in ride.ear.heard(keys.EVENT) if event.kind in seconds]
    checked(ride, tmp_path)


def test_second_receiver_follows_when_the_first_is_gone(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "records")
    starts = {100: lambda: vehicle.second.announce("receiver2"), 201: vehicle.first.end}
    receivers = {"first": range(201), "second": range(100, STEPS)}
    ride = vehicle.ride(receivers, starts)
    found = counts(ride.folder)
    apart = found[keys.apart(keys.GNSS_FIX.path, SECOND)]
    assert found[keys.GNSS_FIX.path] + apart == ride.sent[FIRST] + ride.sent[SECOND]
    assert found[keys.GNSS_FIX.path] > ride.sent[FIRST] + 3
    assert ride.node.refusals.count == apart
    checked(ride, tmp_path)


def test_losses_are_counted_for_each_publisher(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "records")
    for sender, name in ((vehicle.first, "gnss"), (vehicle.second, "receiver2")):
        vehicle.clock.advance(0.01)
        sender.announce(name)
    for step in range(40):
        vehicle.clock.advance(0.2)
        vehicle.first.send(keys.GNSS_FIX, fix(step), skip=step % 3 == 0 and step > 0)
        vehicle.second.send(keys.GNSS_FIX, fix(step), skip=2 * (step % 5 == 0) * (step > 0))
        vehicle.recorder.drain()
    vehicle.recorder.finish()
    topic = keys.GNSS_FIX.on(VEHICLE)
    lost = vehicle.recorder.losses.lost
    assert sum(lost.values()) == 13 + 14
    assert set(lost) <= {topic, keys.apart(topic, SECOND)}


def test_recorder_keeps_what_nobody_can_decode_as_it_came(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "records")
    chance = random.Random(3)
    sent = [(key, chance.randbytes(chance.randrange(40))) for key in ANY_KEY for _ in range(5)]
    for key, payload in sent:
        vehicle.clock.advance(0.01)
        vehicle.others.send_bytes(key, payload)
        vehicle.stranger.send_bytes(key, payload)
        vehicle.recorder.drain()
    vehicle.recorder.finish()
    assert vehicle.recorder.faults == 0
    with open_record(tmp_path / "records") as record:
        for key in ANY_KEY:
            wanted = [payload for each, payload in sent if each is key]
            for topic in (key.on(VEHICLE), keys.apart(key.on(VEHICLE), 0)):
                found = [entry.payload for entry in record.messages(topic.__eq__)]
                assert found[: len(wanted)] == wanted


ANY_KEY = [key.at("x") if key.source == keys.ANY_SOURCE else key for key in keys.ALL]
