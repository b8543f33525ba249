"""The recorder as a node, on a bus within one process: its ledger, its losses, its questions."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from google.protobuf import text_format
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from live import until
from scripted import START_NS, VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import keys
from tramstream.boundary import described
from tramstream.clock import S
from tramstream.config import Recorder
from tramstream.events.messages import sentence_of
from tramstream.events.repeats import AGAIN_NS, MOST
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import Loss, NodeHealth
from tramstream.proto.resend_pb2 import ResendAnswer
from tramstream.recorder.events import KEY_OF_OTHERS, TOO_MANY_KEYS
from tramstream.recorder.node import RecorderNode
from tramstream.recorder.reader import open_record
from tramstream.transport.bus import Envelope, LocalBus
from tramstream.transport.sources import MOST_TOPICS

FIX = keys.GNSS_FIX.on(VEHICLE)


def node(bus: LocalBus, folder: Path, stop: threading.Event) -> RecorderNode:
    settings = Recorder(directory=str(folder), free_space_floor_bytes=0)
    return RecorderNode(VEHICLE, bus, stop, settings, {}, goes_on=True)


def fixes(folder: Path) -> list[int]:
    """Sequence numbers of the recorded fixes."""
    with open_record(folder) as record:
        return [entry.sequence for entry in record.messages(FIX.__eq__)]


def test_messages_that_the_disk_did_not_take_are_no_longer_delivered(tmp_path: Path) -> None:
    folder = tmp_path / "taken"
    folder.write_text("a file where the folder should be")
    bus = LocalBus(ManualClock())
    ear, sender = Ear(bus), Sender(bus)
    steps = [lambda: sender.send(keys.GNSS_FIX, GnssFix())] * 20
    recorder = node(bus, folder, Script(*steps))
    recorder.run()
    (ledger,) = recorder.ledgers()
    assert ledger.balanced
    assert ledger.delivered == 0
    losses: list[Loss] = ear.heard(keys.LOSS.at("recorder"))
    assert sum(loss.count for loss in losses if loss.key == FIX) == 20
    assert {loss.cause for loss in losses} == {Loss.DISK}
    assert sum(loss.count for loss in losses) <= ledger.dropped == ledger.received


def test_drop_of_the_own_queue_is_had_again(tmp_path: Path) -> None:
    bus = LocalBus(ManualClock())
    ear, sender = Ear(bus), Sender(bus)

    def burst() -> None:
        for _ in range(recorder.ring.capacity + 500):
            sender.send(keys.GNSS_FIX, GnssFix())

    recorder = node(bus, tmp_path, Script(lambda: sender.send(keys.GNSS_FIX, GnssFix()), burst))
    recorder.run()
    assert recorder.ring.dropped[FIX] > 0
    assert fixes(tmp_path) == list(range(1, recorder.ring.capacity + 502))
    assert ear.heard(keys.LOSS.at("recorder")) == []
    assert recorder.losses.total == 0
    (ledger,) = recorder.ledgers()
    assert ledger.balanced


def test_gap_that_no_publisher_can_fill_is_lost_and_stands_in_the_record(tmp_path: Path) -> None:
    bus = LocalBus(ManualClock())
    sender = Sender(bus)
    recorder = node(
        bus,
        tmp_path,
        Script(
            lambda: sender.send(keys.GNSS_FIX, GnssFix()),
            lambda: sender.send(keys.GNSS_FIX, GnssFix(), skip=4),
        ),
    )
    recorder.run()
    assert fixes(tmp_path) == [1, 6]
    assert recorder.losses.total == 4
    with open_record(tmp_path) as record:
        topic = keys.LOSS.at("recorder").on(VEHICLE)
        losses = [record.decode(entry) for entry in record.messages(topic.__eq__)]
    assert [(loss.key, loss.count, loss.cause) for loss in losses] == [(FIX, 4, Loss.BUS)]


@pytest.mark.parametrize("data", [b"\xff\xff\xff", ResendAnswer(session=5).SerializeToString()])
def test_answer_that_nobody_understands_is_left_out(tmp_path: Path, data: bytes) -> None:
    bus = LocalBus(ManualClock())
    ear = Ear(bus)
    recorder = node(bus, tmp_path, Script())
    recorder.ring.put("x", data)
    recorder.run()
    beats: list[NodeHealth] = ear.heard(keys.HEARTBEAT.at("recorder"))
    assert {beat.faults for beat in beats} == {0}


def test_last_part_is_finished_whatever_goes_wrong_with_the_last_questions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = LocalBus(ManualClock())
    ear, sender = Ear(bus), Sender(bus)
    recorder = node(bus, tmp_path, Script(lambda: sender.send(keys.GNSS_FIX, GnssFix())))

    def broken() -> None:
        raise ValueError("a bug")

    monkeypatch.setattr(recorder, "_ask_for_the_last", broken)
    recorder.run()
    assert [path.suffix for path in tmp_path.glob("*.mcap*")] == [".mcap"]
    assert fixes(tmp_path) == [1]
    assert ear.heard(keys.HEARTBEAT.at("recorder"))[-1].faults == 1


@pytest.mark.parametrize(
    ("publish_ns", "sequence"), [(START_NS, 1 << 63), ((1 << 64) - 1, 1), (START_NS + 5 * S, 1)]
)
def test_impossible_message_of_an_answer_is_left_out(
    tmp_path: Path, publish_ns: int, sequence: int
) -> None:
    bus = LocalBus(ManualClock())
    ear = Ear(bus)
    recorder = node(bus, tmp_path, Script())
    answer = ResendAnswer(session=5)
    message = answer.stretches.add(topic=FIX).messages.add()
    message.publish_ns, message.sequence = publish_ns, sequence
    recorder.ring.put("x", answer.SerializeToString())
    recorder.run()
    assert ear.heard(keys.HEARTBEAT.at("recorder"))[-1].faults == 0
    assert fixes(tmp_path) == []


def test_flood_of_made_up_keys_is_told_in_few_sentences_and_remembered_in_few_places(
    tmp_path: Path,
) -> None:
    clock = ManualClock()
    bus = LocalBus(clock)
    ear, stranger, fix = Ear(bus), Sender(bus, session=0xBAD), Sender(bus, session=0xF1)
    fix.announce("gnss")

    def flood() -> None:
        for number in range(2 * MOST_TOPICS):
            stranger.send_bytes(keys.LOG.at(f"x{number}"), b"")
            stranger.send_bytes(replace(keys.LOG, quantity=f"q{number}"), b"")
            if number % 500 == 0:
                recorder.drain()

    recorder = node(
        bus,
        tmp_path,
        Script(
            flood,
            lambda: recorder.drain(),
            lambda: clock.advance(AGAIN_NS / S),
            lambda: fix.send(keys.GNSS_FIX, GnssFix()),
        ),
    )
    recorder.run()
    told = Counter(event.kind for event in ear.heard(keys.EVENT.at("recorder")))
    assert MOST < told[TOO_MANY_KEYS.name] <= MOST + 3
    assert sum(told.values()) <= 3 * (MOST + 3)
    told_of = [e for e in ear.heard(keys.EVENT.at("recorder")) if e.kind == TOO_MANY_KEYS.name]
    left_out = sum(1 + event.unsaid for event in told_of)
    assert left_out == recorder.ledgers()[-1].dropped  # each is in one count
    assert fixes(tmp_path) == [1]
    assert len(recorder._kinds) <= MOST_TOPICS + 10
    assert len(recorder._gaps._streams) <= MOST_TOPICS + 10
    (ledger,) = recorder.ledgers()
    assert ledger.balanced
    assert ledger.dropped >= 2 * MOST_TOPICS - 10  # of 4, of which as many are remembered


DAMPING = FileDescriptorSet.FromString(
    text_format.Parse(
        """
        file { name: "damping.proto" package: "damping" syntax: "proto3"
          message_type { name: "Damping"
            field { name: "stamp_ns" number: 1 type: TYPE_INT64 label: LABEL_OPTIONAL }
            field { name: "sequence" number: 2 type: TYPE_UINT64 label: LABEL_OPTIONAL }
            field { name: "ratio" number: 3 type: TYPE_DOUBLE label: LABEL_OPTIONAL } } }
        """,
        FileDescriptorSet(),
    ).SerializeToString()
)
"""What a package of somebody else describes its messages by."""


def damping(ratio: float) -> bytes:
    class_ = described(DAMPING.SerializeToString(), "damping.Damping")
    assert not isinstance(class_, str)
    return class_(stamp_ns=1, sequence=1, ratio=ratio).SerializeToString()


@pytest.mark.parametrize("late", [False, True])
def test_key_of_another_package_is_recorded_with_the_description_that_its_maker_gives(
    tmp_path: Path, late: bool
) -> None:
    bus = LocalBus(ManualClock())
    topic, encoding = f"tram/{VEHICLE}/est/damper/ratio", "application/protobuf;damping.Damping"
    gate = threading.Event()

    def describe(asked: str) -> bytes:
        until(gate.is_set, "the question may be answered")
        return DAMPING.SerializeToString()

    def open_gate() -> None:
        gate.set()
        until(lambda: len(recorder.ring), "the answer")

    bus.answer("tram/schema/damping.Damping", describe)
    sent = [lambda n=n: bus.publish(topic, damping(n / 8), encoding, n) for n in (1, 2, 3)]
    steps = [*sent, open_gate] if late else [sent[0], open_gate, *sent[1:]]
    recorder = node(bus, tmp_path, Script(*steps, lambda: recorder.drain()))
    recorder.run()
    with open_record(tmp_path) as record:
        found = list(record.decoded(lambda each: each == topic))
        assert [message.ratio for _, message in found] == [1 / 8, 2 / 8, 3 / 8]
        assert [entry.sequence for entry, _ in found] == [1, 2, 3]
        assert record.type_of(topic) == "damping.Damping"
    (ledger,) = recorder.ledgers()
    assert ledger.balanced


@pytest.mark.parametrize(
    ("encoding", "answer", "said"),
    [
        ("application/json", None, ""),
        ("application/protobuf;no.Body", None, "nobody describes it"),
        ("application/protobuf;no.Body", b"garbage", "is damaged"),
    ],
)
def test_bytes_that_nobody_describes_are_recorded_as_they_are(
    tmp_path: Path, encoding: str, answer: bytes | None, said: str
) -> None:
    bus = LocalBus(ManualClock())
    ear = Ear(bus)
    bus.answer("tram/schema/*", lambda asked: answer)
    topic = f"tram/{VEHICLE}/est/damper/ratio"
    settle = lambda: until(lambda: not said or len(recorder.ring), "the answer")  # noqa: E731
    recorder = node(bus, tmp_path, Script(lambda: bus.publish(topic, b"{}", encoding, 1), settle))
    recorder.run()
    with open_record(tmp_path) as record:
        (entry,) = record.messages(lambda each: each == topic)
        assert entry.payload == b"{}"
        assert record.type_of(topic) == ""
    texts = " ".join(log.message for log in ear.heard(keys.LOG.at("recorder")))
    assert said in texts


def test_key_of_no_vehicle_of_ours_is_not_recorded(tmp_path: Path) -> None:
    bus = LocalBus(ManualClock())
    ear = Ear(bus)
    recorder = node(bus, tmp_path, Script(lambda: recorder.handle(envelope)))
    envelope = Envelope("elsewhere/x/y", b"", "", 1, 1, 7, 1)
    recorder.run()
    (event,) = ear.heard(keys.EVENT.at("recorder"))
    assert event.kind == KEY_OF_OTHERS.name
    assert sentence_of(event).startswith("elsewhere/x/y: not recorded")
