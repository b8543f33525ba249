"""What strangers publish on health keys ends nothing and hides nothing."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from hypothesis import given
from hypothesis import strategies as st
from scripted import VEHICLE, ManualClock, Sender

from tramstream import keys
from tramstream.boundary import Undecodable, decode
from tramstream.events import define
from tramstream.events.messages import message_of
from tramstream.keys import Key
from tramstream.proto.health_pb2 import Loss, NodeHealth
from tramstream.supervision.budget import AGAIN_S, LINES, SOURCES
from tramstream.supervision.voice import RING_CAPACITY, Voice
from tramstream.transport.bus import LocalBus

LATE = define("test.late", "{device} is late by {late_s}", device=str, late_s=float)
HEARD = (keys.HEARTBEAT, keys.LOSS, keys.LOG)


class Scene:
    def __init__(self) -> None:
        self.bus = LocalBus(ManualClock())
        self.said: list[str] = []
        self.beats: list[tuple[str, int]] = []
        self.lost = 0
        self.now_s = 0.0
        self.bus.announce(keys.alive(VEHICLE, "recorder"))
        self.voice = Voice(self.bus, VEHICLE, self.said.append, self, lambda: self.now_s)

    def heard(self, name: str, pid: int) -> None:
        self.beats.append((name, pid))

    def lose(self, count: int) -> None:
        self.lost += count

    def put(self, key: Key, payload: bytes) -> None:
        self.bus.publish(key.on(VEHICLE), payload, key.encoding, 1)


def test_nodes_speak_and_a_state_is_told_when_it_changes() -> None:
    scene = Scene()
    scene.put(keys.LOG.at("imu"), Log(name="imu", message="opened again").SerializeToString())
    late = [
        LATE(device="a", late_s=3.0),
        LATE(device="a", late_s=4.0),
        LATE(device="b", late_s=4.0),
    ]
    for trouble in (None, *late, None, None):
        beat = NodeHealth(node="imu", pid=42, text="" if trouble is None else str(trouble))
        beat.troubles.extend([] if trouble is None else [message_of(trouble)])
        scene.put(keys.HEARTBEAT.at("imu"), beat.SerializeToString())
    scene.voice.speak()
    assert sorted(scene.said) == [
        "imu: a is late by 3 s",  # and not again for other seconds
        "imu: all is well again",
        "imu: b is late by 4 s",
        "imu: opened again",
    ]
    assert scene.beats == [("imu", 42)] * 6


def test_details_are_for_whoever_looks_for_something() -> None:
    scene = Scene()
    for level in (Log.DEBUG, Log.INFO):
        log = Log(name="ekf", message="a wheel", level=level)
        scene.put(keys.LOG.at("ekf"), log.SerializeToString())
    scene.voice.speak()
    assert scene.said == ["ekf: a wheel"]


def test_loose_plug_says_twenty_lines_and_then_twenty_a_minute() -> None:
    """A device that comes and goes with each heartbeat, for an hour."""
    scene = Scene()
    for second in range(3600):
        scene.now_s = float(second)
        away = LATE(device="a", late_s=3.0)
        beat = NodeHealth(node="imu", pid=42, text=str(away) if second % 2 else "")
        beat.troubles.extend([message_of(away)] if second % 2 else [])
        scene.put(keys.HEARTBEAT.at("imu"), beat.SerializeToString())
        scene.put(keys.HEARTBEAT.at("ekf"), NodeHealth(node="ekf").SerializeToString())
        scene.voice.speak()
    assert 600 <= len(scene.said) <= LINES + 3600 / AGAIN_S
    assert len(scene.beats) == 2 * 3600


def test_flood_of_lines_is_counted_and_hides_nobody_elses() -> None:
    scene = Scene()
    for number in range(500):
        log = Log(name="imu", message=f"line {number}")
        scene.put(keys.LOG.at("imu"), log.SerializeToString())
    scene.put(keys.LOG.at("ekf"), Log(name="ekf", message="a word").SerializeToString())
    scene.voice.speak()
    assert scene.said == [*(f"imu: line {number}" for number in range(LINES)), "ekf: a word"]
    scene.now_s = AGAIN_S
    scene.put(keys.LOG.at("imu"), Log(name="imu", message="more").SerializeToString())
    scene.voice.speak()
    assert scene.said[-1] == f"imu: more (and {500 - LINES} more lines)"


def test_state_that_lasts_is_said_late_rather_than_never() -> None:
    scene = Scene()
    for number in range(100):
        log = Log(name="imu", message=f"line {number}")
        scene.put(keys.LOG.at("imu"), log.SerializeToString())
    scene.voice.speak()
    for second in range(10):
        scene.now_s = float(second)
        beat = NodeHealth(node="imu", pid=42, text="late")
        scene.put(keys.HEARTBEAT.at("imu"), beat.SerializeToString())
        scene.voice.speak()
    assert [text for text in scene.said if "late" in text] == [
        f"imu: late (and {100 - LINES} more lines)"
    ]


def test_any_number_of_made_up_names_says_no_more_lines_than_so_many() -> None:
    scene = Scene()
    for number in range(10_000):
        log = Log(name=f"n{number}", message="I am")
        scene.put(keys.LOG.at(f"n{number}"), log.SerializeToString())
        scene.voice.speak()
    assert len(scene.said) <= SOURCES + LINES


def test_state_of_a_program_that_knows_no_events_is_told_by_its_text() -> None:
    scene = Scene()
    for text in ("", "late", "late", ""):
        beat = NodeHealth(node="imu", pid=42, text=text)
        scene.put(keys.HEARTBEAT.at("imu"), beat.SerializeToString())
    scene.voice.speak()
    assert scene.said == ["imu: late", "imu: all is well again"]


def test_messages_of_three_and_six_bytes_are_said_and_left_out() -> None:
    scene = Scene()
    scene.put(keys.LOG.at("x"), b"\x0a\xff\xff")
    scene.put(keys.HEARTBEAT.at("x"), b"\x0a\xff\xff\xff\xff\x0f")
    scene.voice.speak()
    assert scene.voice.left_out == 2
    assert len(scene.said) == 1  # once in a while
    assert "health/x/heartbeat: 6 B are no tramstream.NodeHealth; left out" in scene.said[0]
    scene.now_s += 60.0
    scene.put(keys.LOG.at("x"), b"\x0a\xff\xff")
    scene.voice.speak()
    assert "health/x/log: 3 B are no foxglove.Log" in scene.said[1]
    assert "3 so far" in scene.said[1]


@given(st.lists(st.tuples(st.sampled_from(HEARD), st.binary(max_size=40)), max_size=30))
def test_any_bytes_are_heard_or_counted(messages: list[tuple[Key, bytes]]) -> None:
    scene = Scene()
    bad = 0
    for key, payload in messages:
        scene.put(key.at("recorder"), payload)
        bad += isinstance(decode(key.type, payload, "k"), Undecodable)
    scene.voice.speak()
    assert scene.voice.left_out == bad
    assert len(scene.beats) == sum(
        key is keys.HEARTBEAT and not isinstance(decode(key.type, payload, "k"), Undecodable)
        for key, payload in messages
    )


def test_flood_of_sentences_drowns_no_heartbeat() -> None:
    scene = Scene()
    scene.put(keys.HEARTBEAT.at("imu"), NodeHealth(node="imu", pid=42).SerializeToString())
    for key in (keys.LOG, keys.LOSS):
        for _ in range(5 * RING_CAPACITY):
            scene.put(key.at("x"), b"\xff")
    scene.voice.speak()
    assert scene.beats == [("imu", 42)]
    assert len(scene.said) == 1


@pytest.mark.parametrize(
    ("node", "consumer", "counted"),
    [("recorder", "recorder", 12), ("processors", "processors", 0), ("x", "recorder", 0)],
)
def test_losses_of_the_recorder_are_losses_of_the_record(
    node: str, consumer: str, counted: int
) -> None:
    scene = Scene()
    for cause in (Loss.Cause.BUS, Loss.Cause.QUEUE, Loss.Cause.DISK):
        loss = Loss(consumer=consumer, key="k", count=4, cause=cause)
        scene.put(keys.LOSS.at(node), loss.SerializeToString())
    scene.voice.speak()
    assert scene.lost == counted


def test_losses_that_a_stranger_tells_in_the_recorders_name_are_not_believed() -> None:
    scene = Scene()
    stranger = Sender(scene.bus, session=0xBAD)
    for _ in range(200):
        stranger.send(keys.LOSS.at("recorder"), Loss(consumer="recorder", key="k", count=1))
    scene.put(
        keys.LOSS.at("recorder"), Loss(consumer="recorder", key="k", count=4).SerializeToString()
    )
    scene.voice.speak()
    assert scene.lost == 4
    assert scene.voice.strange == 200
    assert len(scene.said) == 1
    assert "session 00000bad tells of losses in the recorder's name" in scene.said[0]


def test_stranger_that_is_announced_as_a_recorder_later_is_not_believed_either() -> None:
    scene = Scene()
    stranger = Sender(scene.bus, session=0xBAD)
    scene.bus.clock.advance(1.0)  # type: ignore[attr-defined]
    stranger.announce("recorder")
    stranger.send(keys.LOSS.at("recorder"), Loss(consumer="recorder", key="k", count=1))
    scene.voice.speak()
    assert scene.lost == 0


def test_last_words_of_a_recorder_that_is_gone_and_of_its_successor_count() -> None:
    scene = Scene()
    scene.voice.speak()
    scene.bus._announced.clear()
    successor = Sender(scene.bus, session=0xC0DE)
    scene.put(
        keys.LOSS.at("recorder"), Loss(consumer="recorder", key="k", count=1).SerializeToString()
    )
    scene.now_s += 1.0
    scene.voice.speak()
    successor.announce("recorder")
    successor.send(keys.LOSS.at("recorder"), Loss(consumer="recorder", key="k", count=2))
    scene.now_s += 1.0
    scene.voice.speak()
    assert scene.lost == 3
