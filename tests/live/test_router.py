"""The router's own voice."""

from __future__ import annotations

import time

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from scripted import VEHICLE, Ear, ManualClock, Script

from tramstream import keys
from tramstream.clock import S, boot_id
from tramstream.live.router import RouterNode
from tramstream.transport.bus import LocalBus
from tramstream.transport.descriptions import tell


@pytest.fixture(scope="module")
def told() -> LocalBus:
    bus = LocalBus(ManualClock())
    tell(bus, keys.TYPES.values())
    return bus


@pytest.mark.parametrize("key", keys.ALL, ids=lambda key: key.path)
def test_type_of_every_key_is_described(told: LocalBus, key: keys.Key) -> None:
    name = key.type.DESCRIPTOR.full_name
    (data,) = told.ask(keys.schema(name))
    files = FileDescriptorSet.FromString(data).file
    described = {
        f"{file.package}.{message.name}" for file in files for message in file.message_type
    }
    assert name in described


def test_unknown_type_is_met_with_silence_and_all_are_listed(told: LocalBus) -> None:
    assert told.ask(keys.schema("tramstream.Nothing")) == []
    assert len(told.ask(keys.schema("*"))) == len(keys.TYPES)


def test_router_answers_for_types_and_relates_its_clock_to_utc_now_and_then() -> None:
    clock = ManualClock()
    bus = LocalBus(clock)
    ear = Ear(bus)
    asked: list[bytes] = []
    type_name = keys.CLOCK.type.DESCRIPTOR.full_name
    steps = [lambda: asked.extend(bus.ask(keys.schema(type_name))) or clock.advance(1.0)]
    RouterNode(VEHICLE, bus, Script(*steps, *[lambda: clock.advance(1.0)] * 20)).run()
    assert len(asked) == 1
    references = ear.heard(keys.CLOCK)
    assert len(references) == 3
    for reference in references:
        assert reference.boot_id == boot_id()
        assert abs(reference.host_utc_ns - time.time_ns()) < 3600 * S
    stamps = [reference.stamp_ns for reference in references]
    assert stamps[2] - stamps[1] == stamps[1] - stamps[0] == 10 * S
