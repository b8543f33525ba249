"""Losses by sequence numbers, and whose fault they are."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from tramstream.proto.health_pb2 import Loss
from tramstream.transport.bus import Envelope
from tramstream.transport.losses import LossCounter
from tramstream.transport.ring import Ring

NONE: Counter[str] = Counter()


def envelope(sequence: int, topic: str = "a", session: int = 1) -> Envelope:
    return Envelope(topic, b"", "", 1000 * sequence, sequence, session, 0)


def test_unbroken_numbers_lose_nothing() -> None:
    losses = LossCounter("me")
    assert not any(losses.see(envelope(number), NONE) for number in range(5, 50))
    assert losses.total == 0


def test_gap_in_the_numbers_is_a_loss_of_the_bus_between_two_publications() -> None:
    losses = LossCounter("me")
    losses.see(envelope(3), NONE)
    (loss,) = losses.see(envelope(7), NONE)
    assert (loss.consumer, loss.key, loss.count) == ("me", "a", 3)
    assert (loss.after_publish_ns, loss.before_publish_ns) == (3000, 7000)
    assert loss.cause == Loss.BUS
    assert losses.total == losses.lost["a"] == 3


def test_every_topic_has_its_own_numbers() -> None:
    losses = LossCounter("me")
    for number in range(1, 10):
        for topic in ("a", "b"):
            assert losses.see(envelope(number, topic), NONE) == []


def test_new_session_begins_anew() -> None:
    losses = LossCounter("me")
    losses.see(envelope(100), NONE)
    assert losses.see(envelope(1, session=2), NONE) == []
    assert losses.see(envelope(4, session=2), NONE)[0].count == 2


def test_repeated_and_late_numbers_are_disorder_not_loss() -> None:
    losses = LossCounter("me")
    for number in (1, 2, 2, 1, 3):
        assert losses.see(envelope(number), NONE) == []
    assert losses.disordered["a"] == 2
    assert losses.total == 0


def test_strangers_without_a_header_are_not_counted() -> None:
    losses = LossCounter("me")
    losses.see(envelope(5), NONE)
    assert losses.see(envelope(0), NONE) == []
    assert losses.see(envelope(6), NONE) == []


def test_loss_is_split_between_own_queue_and_bus() -> None:
    losses = LossCounter("me")
    losses.see(envelope(1), NONE)
    found = losses.see(envelope(6), Counter({"a": 3, "b": 9}))
    assert [(loss.cause, loss.count) for loss in found] == [(Loss.QUEUE, 3), (Loss.BUS, 1)]
    assert losses.total == 4


def test_drops_that_come_after_the_message_are_kept_for_the_next() -> None:
    losses = LossCounter("me")
    dropped = Counter({"a": 5})  # two before message 4, three after it
    losses.see(envelope(1), NONE)
    assert [(x.cause, x.count) for x in losses.see(envelope(4), dropped)] == [(Loss.QUEUE, 2)]
    assert [(x.cause, x.count) for x in losses.see(envelope(8), dropped)] == [(Loss.QUEUE, 3)]
    assert [(x.cause, x.count) for x in losses.see(envelope(10), dropped)] == [(Loss.BUS, 1)]


def test_drops_of_an_old_session_are_not_blamed_on_the_new_one() -> None:
    losses = LossCounter("me")
    losses.see(envelope(1), NONE)
    dropped = Counter({"a": 4})
    losses.see(envelope(1, session=2), dropped)
    assert losses.see(envelope(3, session=2), dropped)[0].cause == Loss.BUS


@given(st.integers(1, 4), st.lists(st.sampled_from(["put", "lost", "get"]), max_size=80))
def test_what_a_ring_and_the_bus_lost_is_told_exactly_once(
    capacity: int, happenings: list[str]
) -> None:
    ring: Ring[Envelope] = Ring(capacity)
    losses = LossCounter("me")
    told: Counter[int] = Counter()
    sequence = got = 0
    lost_on_bus = 0

    def take() -> None:
        nonlocal got
        item = ring.get(0.0)
        if item is not None:
            got += 1
            for loss in losses.see(item, ring.dropped):
                told[loss.cause] += loss.count

    ring.put("a", envelope(1))  # the first is always read, so that what follows can be counted
    take()
    sequence = 1
    for happening in happenings:
        if happening == "get":
            take()
            continue
        sequence += 1
        if happening == "put":
            ring.put("a", envelope(sequence))
        else:
            lost_on_bus += 1
    sequence += 1
    ring.put("a", envelope(sequence))
    while len(ring):
        take()
    assert got + sum(told.values()) == sequence
    assert told[Loss.QUEUE] == ring.dropped_total
    assert told[Loss.BUS] == lost_on_bus
