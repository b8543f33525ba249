"""Health of a record: runs of states, silences, losses, sentences, the clock."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys
from tramstream.clock import S
from tramstream.events import define
from tramstream.events.messages import log_of, message_of
from tramstream.proto.health_pb2 import ClockReference, DeviceHealth, Event, Loss, NodeHealth
from tramstream.recorder.health import HEALTH_TYPES, Health, Run

START_NS = 1_790_000_000 * S
GNSS = keys.HEARTBEAT.at("gnss").on("4711")


def beat(second: float, state: NodeHealth.State, text: str = "") -> NodeHealth:
    return NodeHealth(stamp_ns=START_NS + round(second * S), state=state, text=text)


def test_heartbeats_of_one_state_are_one_run():
    health = Health()
    for second in range(100):
        health.add(GNSS, beat(second, NodeHealth.OK))
    assert health.nodes == {"gnss": [Run("OK", "", START_NS, START_NS + 99 * S)]}
    assert health.last_of_node["gnss"].stamp_ns == START_NS + 99 * S


def test_state_holds_until_the_next_one_is_told():
    health = Health()
    health.add(GNSS, beat(0, NodeHealth.OK))
    health.add(GNSS, beat(1, NodeHealth.FAILED, "no device"))
    health.add(GNSS, beat(2, NodeHealth.OK))
    assert [
        (run.state, run.text, (run.end_ns - run.start_ns) / S) for run in health.nodes["gnss"]
    ] == [
        ("OK", "", 1.0),
        ("FAILED", "no device", 1.0),
        ("OK", "", 0.0),
    ]


def test_silence_ends_a_run():
    health = Health()
    for second in (0, 1, 60, 61):
        health.add(GNSS, beat(second, NodeHealth.OK))
    runs = [
        ((run.start_ns - START_NS) // S, (run.end_ns - START_NS) // S)
        for run in health.nodes["gnss"]
    ]
    assert runs == [(0, 1), (60, 61)]


def test_stamps_that_go_back_begin_a_run():
    health = Health()
    for second in (10, 11, 3):
        health.add(GNSS, beat(second, NodeHealth.OK))
    assert len(health.nodes["gnss"]) == 2


def test_devices_losses_sentences_and_clock_are_kept():
    health = Health()
    device = DeviceHealth(stamp_ns=START_NS, state=DeviceHealth.LOST, text="unplugged")
    health.add(keys.DEVICE.at("imu").on("4711"), device)
    health.add(keys.LOSS.at("recorder").on("4711"), Loss(consumer="recorder", count=3))
    log = Log(level=Log.ERROR, message="trouble")
    log.timestamp.FromNanoseconds(START_NS)
    health.add(keys.LOG.at("imu").on("4711"), log)
    clock = ClockReference(stamp_ns=START_NS, host_utc_ns=START_NS - 37 * S)
    health.add(keys.CLOCK.on("4711"), clock)
    assert health.devices["imu"][0].state == "LOST"
    assert health.losses[0].count == 3
    assert (health.log[0].level, health.log[0].node, health.log[0].text) == (
        "ERROR",
        "imu",
        "trouble",
    )
    assert health.utc_offset_ns == -37 * S


LATE = define("test.late", "{device} is late by {late_s}", device=str, late_s=float)


def told(second: int, number: int, unsaid: int = 0) -> tuple[Event, Log]:
    """An event as it goes onto the bus: itself, and its sentence."""
    event = message_of(LATE(device="a", late_s=number), "imu", unsaid)
    event.stamp_ns, event.sequence = START_NS + second * S, number
    log = log_of(event)
    log.timestamp.FromNanoseconds(event.stamp_ns)
    return event, log


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_event_and_its_sentence_are_one_line(order):
    health = Health()
    for number, unsaid in ((1, 0), (2, 5)):
        pair = told(10, number, unsaid)
        for each in order:
            key = (keys.EVENT, keys.LOG)[each]
            health.add(key.at("imu").on("4711"), pair[each])
    assert [(line.kind, line.node) for line in health.log] == [(LATE.name, "imu")] * 2
    assert health.log[1].text == "a is late by 2 s (and 5 more times since this was said last)"
    (late,) = health.happened.values()
    assert (late.count, late.last, late.level) == (7, health.log[1].text, "WARNING")


def test_trouble_that_lasts_has_happened_once_each_time_it_began():
    health = Health()
    for second, late_s in enumerate((0, 1, 2, 0, 5, 6)):
        message = beat(second, NodeHealth.DEGRADED if late_s else NodeHealth.OK)
        message.troubles.extend([message_of(LATE(device="a", late_s=late_s))] if late_s else [])
        health.add(GNSS, message)
    (late,) = health.happened.values()
    assert (late.node, late.kind, late.count) == ("gnss", LATE.name, 2)
    assert (late.first_ns, late.last_ns) == (START_NS + S, START_NS + 4 * S)


def test_sentences_of_programs_that_know_no_events_are_all_there():
    """Also those of records that were made before there were events."""
    health = Health()
    for text in ("one", "two"):
        log = Log(level=Log.WARNING, message=text, name="imu")
        log.timestamp.FromNanoseconds(START_NS)
        health.add(keys.LOG.at("imu").on("4711"), log)
    assert [line.text for line in health.log] == ["one", "two"]
    assert not health.happened


def test_sentence_whose_event_was_not_recorded_is_there():
    health = Health()
    health.add(keys.LOG.at("imu").on("4711"), told(10, 1)[1])
    assert [line.text for line in health.log] == ["a is late by 1 s"]


def test_all_health_keys_are_taken():
    told = {key.type.DESCRIPTOR.full_name for key in keys.ALL if key.layer == "health"}
    assert told == HEALTH_TYPES
