"""Sources: one publisher a key, others apart, and nothing lost where a node is started again."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import START_NS, VEHICLE

from tramstream import keys
from tramstream.clock import S
from tramstream.transport import tokens
from tramstream.transport.bus import Envelope
from tramstream.transport.sources import (
    HELD_BYTES,
    MOST_RIVALS,
    MOST_TOPICS,
    OTHERS,
    QUIET_S,
    WAIT_S,
    Sources,
)
from tramstream.transport.tokens import Announced

TOPIC = keys.GNSS_FIX.on(VEHICLE)
MS = S // 1000
FIRST, SECOND = 0xA, 0xB


class World:
    """Publishers, their tokens, and one reader's judgement."""

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.since_ns: dict[int, int] = {}
        self.asked = 0
        self.sources = Sources(self.ask)
        self.numbers: dict[int, int] = {}
        self.used: list[Envelope] = []
        self.apart: list[Envelope] = []

    def ask(self) -> list[Announced]:
        self.asked += 1
        return [
            Announced(keys.alive(VEHICLE, f"n{session:x}"), since_ns, session)
            for session, since_ns in self.since_ns.items()
        ]

    def announce(self, session: int) -> None:
        self.since_ns[session] = self.now_ns

    def end(self, session: int) -> None:
        del self.since_ns[session]

    def send(self, session: int, size: int = 1) -> None:
        number = self.numbers[session] = self.numbers.get(session, 0) + 1
        payload = bytes(size)
        envelope = Envelope(TOPIC, payload, "", self.now_ns, number, session, self.now_ns)
        self._sort(self.sources.judge(envelope, self.now_ns))

    def wait(self, dt_s: float) -> None:
        """Let time pass; the node's timer runs ten times a second."""
        end_ns = self.now_ns + round(dt_s * S)
        while self.now_ns < end_ns:
            self.now_ns = min(self.now_ns + S // 10, end_ns)
            self._sort(self.sources.settle(self.now_ns))

    def finish(self) -> None:
        self._sort(self.sources.settle(self.now_ns, at_end=True))

    def _sort(self, envelopes: list[Envelope]) -> None:
        for each in envelopes:
            (self.apart if keys.is_apart(each.topic) else self.used).append(each)

    def used_of(self, session: int) -> list[int]:
        return [each.sequence for each in self.used if each.session == session]

    def apart_of(self, session: int) -> list[int]:
        topic = keys.apart(TOPIC, session)
        return [each.sequence for each in self.apart if each.topic == topic]


def test_one_publisher_is_used_and_nobody_is_asked() -> None:
    world = World()
    for _ in range(10):
        world.send(FIRST)
        world.wait(0.2)
    assert world.used_of(FIRST) == list(range(1, 11))
    assert world.asked == 0


def test_second_publisher_beside_the_first_is_apart_from_its_first_message() -> None:
    world = World()
    world.announce(FIRST)
    world.wait(1.0)
    world.announce(SECOND)
    for _ in range(20):
        world.send(FIRST)
        world.wait(0.1)
        world.send(SECOND)
        world.wait(0.1)
    world.finish()
    assert world.used_of(FIRST) == world.apart_of(SECOND) == list(range(1, 21))
    assert not world.used_of(SECOND)


def test_node_that_is_started_again_is_used_at_once() -> None:
    world = World()
    world.announce(FIRST)
    world.send(FIRST)
    world.end(FIRST)
    world.announce(SECOND)
    world.send(SECOND)
    assert world.used_of(SECOND) == [1]
    assert not world.sources.contested


def test_nothing_is_lost_where_the_old_token_goes_after_the_new_ones_first_messages() -> None:
    world = World()
    world.announce(FIRST)
    world.send(FIRST)
    world.announce(SECOND)
    for _ in range(3):
        world.now_ns += 100 * MS
        world.send(SECOND)
    assert not world.used_of(SECOND)
    world.end(FIRST)
    world.wait(0.1)
    world.send(SECOND)
    assert world.used_of(SECOND) == [1, 2, 3, 4]
    assert not world.apart


def test_second_publisher_waits_no_longer_than_it_must_beside_a_silent_first() -> None:
    world = World()
    world.announce(FIRST)
    world.send(FIRST)
    world.announce(SECOND)
    world.now_ns += 200 * MS
    world.send(SECOND)
    world.wait(WAIT_S)
    assert world.apart_of(SECOND) == [1]


def test_second_publisher_follows_when_the_first_is_gone_and_was_silent() -> None:
    world = World()
    world.announce(FIRST)
    world.announce(SECOND)
    for _ in range(5):
        world.send(FIRST)
        world.send(SECOND)
        world.wait(0.1)
    world.end(FIRST)
    last_ns = world.used[-1].publish_ns
    for _ in range(20):
        world.send(SECOND)
        world.wait(0.1)
    used = [each for each in world.used if each.session == SECOND]
    assert used[0].publish_ns > last_ns + QUIET_S * S
    assert world.apart_of(SECOND) + world.used_of(SECOND) == list(range(1, 26))
    assert not world.sources.contested


def test_whoever_was_announced_first_is_used_whoever_was_heard_first() -> None:
    """A reader that was started again hears the second one first."""
    world = World()
    world.announce(FIRST)
    world.wait(1.0)
    world.announce(SECOND)
    world.send(SECOND)
    world.now_ns += 5 * MS
    world.send(FIRST)
    world.send(SECOND)
    world.send(FIRST)
    assert world.used_of(FIRST) == [1, 2]
    assert world.used_of(SECOND) == [1]
    assert world.apart_of(SECOND) == [2]


def test_who_is_not_announced_is_used_alone_and_apart_beside_a_node() -> None:
    world = World()
    world.send(SECOND)
    assert world.used_of(SECOND) == [1]
    world.now_ns += 5 * MS
    world.announce(FIRST)
    world.send(FIRST)
    world.send(SECOND)
    world.send(FIRST)
    assert world.used_of(FIRST) == [1, 2]
    assert world.apart_of(SECOND) == [2]


def test_one_tool_follows_another_and_nothing_is_lost() -> None:
    world = World()
    for session in (0x1, 0x2, 0x3):
        for _ in range(10):
            world.now_ns += 100 * MS
            world.send(session)
        world.wait(0.0)
    world.finish()
    for session in (0x1, 0x2, 0x3):
        assert world.used_of(session) == list(range(1, 11))


def test_message_without_our_header_is_apart() -> None:
    world = World()
    world.send(0)
    world.send(FIRST)
    world.send(0)
    assert len(world.apart_of(0)) == 2
    assert world.used_of(FIRST) == [1]


def test_stranger_with_ever_new_sessions_gets_one_topic_and_a_node_is_still_used() -> None:
    world = World()
    world.announce(FIRST)
    world.send(FIRST)
    for session in range(0x100, 0x200):
        world.now_ns += MS
        world.send(session)
        world.send(FIRST)
    topics = {each.topic for each in world.apart}
    assert len(topics) == MOST_RIVALS + 1
    assert keys.apart(TOPIC, OTHERS) in topics
    assert len(world.apart) == 0x100
    world.end(FIRST)
    world.announce(SECOND)
    world.now_ns += 200 * MS
    world.send(SECOND)
    assert world.used_of(SECOND) == [1]


@pytest.mark.parametrize("since_ns", [0, START_NS - 1])
def test_token_that_says_it_is_older_than_the_reader_knows_takes_no_key_over(since_ns: int) -> None:
    world = World()
    world.announce(FIRST)
    world.sources.know(world.now_ns)  # as a node does at its start
    world.wait(1.0)
    world.send(FIRST)
    world.wait(1.0)
    world.since_ns[SECOND] = since_ns
    for _ in range(10):
        world.send(SECOND)
        world.wait(0.2)
        world.send(FIRST)
        world.wait(0.2)
    assert world.used_of(FIRST) == list(range(1, 12))
    assert world.apart_of(SECOND) == list(range(1, 11))


def test_topics_that_are_made_up_are_not_remembered_beyond_a_limit_and_a_nodes_are() -> None:
    world = World()
    sources = world.sources

    def judge(number: int, session: int) -> str:
        topic = f"{TOPIC}{number}"
        envelope = Envelope(topic, b"", "", world.now_ns, 1, session, world.now_ns)
        return sources.judge(envelope, world.now_ns)[0].topic

    for number in range(MOST_TOPICS + 500):
        judge(number, SECOND)
    assert len(sources.by_topic) == MOST_TOPICS
    assert judge(9999, SECOND) == keys.apart(f"{TOPIC}9999", OTHERS)
    world.announce(FIRST)
    world.now_ns += S
    assert judge(10_000, FIRST) == f"{TOPIC}10000"


def test_what_is_held_is_bounded() -> None:
    world = World()
    world.announce(FIRST)
    world.send(FIRST)
    for _ in range(4):
        world.now_ns += MS
        world.send(SECOND, size=HELD_BYTES // 3)
    assert world.apart_of(SECOND) == [1, 2, 3, 4]


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["send", "send", "send", "send", "announce", "end", "wait"]),
        st.sampled_from([0xA, 0xB, 0xC, 0]),
        st.sampled_from([0, 1, 50, 120, 600, 1500]),
    ),
    max_size=60,
)


@settings(deadline=None, max_examples=300)
@given(events=EVENTS)
def test_every_message_comes_out_once_in_its_order_used_or_apart(
    events: list[tuple[str, int, int]],
) -> None:
    world = World()
    for what, session, dt_ms in events:
        world.now_ns += dt_ms * MS
        if what == "send":
            world.send(session)
        elif what == "wait":
            world.wait(0.1)
        elif what == "announce" and session:
            world.announce(session)
        elif session in world.since_ns:
            world.end(session)
    world.finish()
    for session, count in world.numbers.items():
        both = sorted(world.used_of(session) + world.apart_of(session))
        assert both == list(range(1, count + 1))
        assert world.used_of(session) == sorted(world.used_of(session))
        assert world.apart_of(session) == sorted(world.apart_of(session))
    assert not world.used_of(0)


def test_tokens_are_read_as_they_were_made_and_a_strangers_are_passed_over() -> None:
    ours = Announced("tram/v/health/imu/alive", START_NS, 0xBEEF)
    strange = ["tram/v/health/imu/alive/xyz", "alive", "", "a/-", "a/1-g"]
    assert tokens.read([ours.token, *strange]) == [ours]
