"""Health of a record: runs of states, silences, losses, sentences, the clock."""

from __future__ import annotations

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys
from tramstream.clock import S
from tramstream.proto.health_pb2 import ClockReference, DeviceHealth, Loss, NodeHealth
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


def test_all_health_keys_are_taken():
    told = {key.type.DESCRIPTOR.full_name for key in keys.ALL if key.layer == "health"}
    assert told == HEALTH_TYPES
