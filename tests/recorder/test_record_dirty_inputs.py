"""Nobody silences the vehicle: garbage and stamps from the future, live and in reprocessing.

A whole ride through the real processors on a bus without a network. What is injected is refused,
counted exactly, told and named; the localisation goes on at 100 Hz; reprocessing gives the same
bits.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from record_rides import CONFIG, batch, drive, fix, wheels, written
from scripted import VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import keys
from tramstream.clock import S
from tramstream.events.messages import facts_of
from tramstream.keys import Key
from tramstream.live import registry
from tramstream.live.events import FUTURE_STAMP, NOT_USED, UNDECODABLE
from tramstream.live.host import ProcessorNode
from tramstream.proto.health_pb2 import Loss, NodeHealth
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import rerun
from tramstream.transport.bus import LocalBus

STEPS = 400
FROM = 200
"""The attack begins here."""


class Dirt(NamedTuple):
    """One message that is not used."""

    key: Key
    payload: bytes


def ahead(make: Callable[[int], Any], key: Key, by_s: float) -> Callable[[int], list[Dirt]]:
    def dirt(step: int) -> list[Dirt]:
        message = make(step)
        message.stamp_ns += round(by_s * S)
        return [Dirt(key, message.SerializeToString())]

    return dirt


def long_batch(period_ns: float) -> Callable[[int], list[Dirt]]:
    def dirt(step: int) -> list[Dirt]:
        message = batch(step)
        message.period_ns = period_ns
        return [Dirt(keys.IMU_BATCH, message.SerializeToString())]

    return dirt


def garbage(step: int) -> list[Dirt]:
    chance = random.Random(step)
    inputs = (keys.IMU_BATCH, keys.ODO_WHEELS, keys.GNSS_FIX)
    return [Dirt(key, b"\xff" + chance.randbytes(chance.randrange(40))) for key in inputs]


ATTACKS: dict[str, tuple[Callable[[int], list[Dirt]], range, Loss.Cause.ValueType]] = {
    "a batch an hour ahead": (ahead(batch, keys.IMU_BATCH, 3600.0), range(1), Loss.STAMP),
    "a batch a second ahead": (ahead(batch, keys.IMU_BATCH, 1.0), range(1), Loss.STAMP),
    "fixes an hour ahead": (ahead(fix, keys.GNSS_FIX, 3600.0), range(30), Loss.STAMP),
    "wheels an hour ahead": (ahead(wheels, keys.ODO_WHEELS, 3600.0), range(30), Loss.STAMP),
    "a run of batches ahead": (ahead(batch, keys.IMU_BATCH, 3600.0), range(100), Loss.STAMP),
    "a batch that never ends": (long_batch(1e12), range(3), Loss.STAMP),
    "a batch that lasts NaN": (long_batch(float("nan")), range(3), Loss.STAMP),
    "a batch that lasts for ever": (long_batch(float("inf")), range(3), Loss.STAMP),
    "garbage on every input": (garbage, range(50), Loss.UNDECODABLE),
}


class Ride(NamedTuple):
    path: Path
    ear: Ear
    node: ProcessorNode
    injected: int


def ridden(path: Path, attack: str) -> Ride:
    """A ride with an attack on it, recorded."""
    clock = ManualClock()
    bus = LocalBus(clock)
    sender, ear = Sender(bus), Ear(bus)
    count = 0

    def dirty(dirt: Dirt) -> None:
        nonlocal count
        count += 1
        sender.send_bytes(dirt.key, dirt.payload)

    def steps() -> Iterator[Callable[[], None]]:
        make, when, _ = ATTACKS.get(attack, (garbage, range(0), Loss.BUS))
        for step in range(STEPS):
            yield from drive(sender, clock, range(step, step + 1))
            if step - FROM in when:
                for dirt in make(step):
                    yield lambda dirt=dirt: dirty(dirt)

    with written(path, bus):
        processors = registry.make_processors(CONFIG)
        node = ProcessorNode(registry.PROCESSORS, VEHICLE, bus, Script(*steps()), processors)
        node.run()
    return Ride(path, ear, node, count)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    return ridden(tmp_path_factory.mktemp("clean") / "ride.mcap", "")


@pytest.mark.parametrize("attack", ATTACKS)
def test_attack_is_refused_counted_named_and_repeated(
    clean: Ride, tmp_path: Path, attack: str
) -> None:
    ride = ridden(tmp_path / "ride.mcap", attack)
    assert ride.injected > 0
    assert ride.node.faults == 0
    # The localisation goes on, with the very states that it has without the attack.
    for key, rate_hz in ((keys.EST_STATE, 100), (keys.EST_DISTANCE, 50)):
        states = ride.ear.heard(key)
        assert len(states) > (STEPS / 100 - 0.5) * rate_hz
        assert states == clean.ear.heard(key)
    # Counted and told.
    beat = ride.ear.heard(keys.HEARTBEAT)[-1]
    books = next(stage for stage in beat.stages if stage.stage == "inputs")
    assert books.received == books.delivered + books.dropped + books.pending
    assert books.dropped == ride.injected
    told = next(b for b in ride.ear.heard(keys.HEARTBEAT) if b.state == NodeHealth.DEGRADED)
    cause = ATTACKS[attack][2]
    kind = {Loss.UNDECODABLE: UNDECODABLE, Loss.STAMP: FUTURE_STAMP}[cause].name
    assert {kind, NOT_USED.name} <= {trouble.kind for trouble in told.troubles}
    assert kind in [event.kind for event in ride.ear.heard(keys.EVENT)]
    named = [loss for loss in ride.ear.heard(keys.LOSS) if loss.cause == cause]
    assert sum(loss.count for loss in named) == ride.injected
    # Reprocessing leaves out exactly the same.
    again = rerun(ride.path, tmp_path / "out.mcap", None, check=True)
    assert again.comparison is not None
    assert again.comparison.differences == []
    assert again.identical
    with open_record(tmp_path / "out.mcap") as record:
        made = [m for _, m in record.decoded(keys.EST_STATE.on(VEHICLE).__eq__)]
    assert made == ride.ear.heard(keys.EST_STATE)


def test_message_that_is_refused_does_not_move_event_time(tmp_path: Path) -> None:
    ride = ridden(tmp_path / "ride.mcap", "a run of batches ahead")
    stamps = [tick.stamp_ns for tick in ride.ear.heard(keys.SYNC_TICK)]
    assert max(stamps) <= ride.node.clock.now_ns()


def test_device_whose_clock_is_ahead_for_good_is_refused_as_long_as_it_is_ahead() -> None:
    clock = ManualClock()
    bus = LocalBus(clock)
    sender, ear = Sender(bus), Ear(bus)

    def send(step: int) -> None:
        clock.advance(0.1)
        message = ImuBatch(stamp_ns=clock.now_ns() + 3600 * S, gyro_x=[1])
        sender.send(keys.IMU_BATCH, message)

    steps = [lambda step=step: send(step) for step in range(600)]
    processors = registry.make_processors(CONFIG)
    node = ProcessorNode(registry.PROCESSORS, VEHICLE, bus, Script(*steps), processors)
    node.run()
    assert node.refusals.count == 600
    assert ear.heard(keys.SYNC_TICK) == []
    beats = ear.heard(keys.HEARTBEAT)[2:]
    assert all(beat.state == NodeHealth.DEGRADED for beat in beats)
    facts = facts_of(beats[-1].troubles[0])
    assert facts == {"key": keys.IMU_BATCH.on(VEHICLE), "ahead_s": 3600.0, "limit_s": 0.5}
    assert "has stamps 3600 s ahead of their arrival, limit 0.5 s" in beats[-1].text
    events = [event for event in ear.heard(keys.EVENT) if event.kind == FUTURE_STAMP.name]
    assert len(events) == 6
    assert [event.unsaid for event in events] == [0, *[99] * 5]
