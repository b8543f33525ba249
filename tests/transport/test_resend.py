"""What a publisher keeps, forgets and sends once more."""

from __future__ import annotations

import tracemalloc

from hypothesis import given
from hypothesis import strategies as st

from tramstream.clock import S
from tramstream.proto.resend_pb2 import ResendAnswer, ResendRequest, ResendStretch, ResentStretch
from tramstream.transport.resend import ANSWER_BYTES, KEPT_FEW, LIMIT_BYTES, History

SESSION = 7


def ask(history: History, *stretches: ResendStretch, **fields: object) -> ResendAnswer:
    request = ResendRequest(stretches=stretches, **fields)  # type: ignore[arg-type]
    data = history.answer(request.SerializeToString())
    return ResendAnswer() if data is None else ResendAnswer.FromString(data)


def stretch(
    history: History, after_ns: int, before_ns: int = 0, topic: str = "a", session: int = SESSION
) -> ResentStretch:
    """The only stretch of an answer."""
    wanted = ResendStretch(
        topic=topic, session=session, after_publish_ns=after_ns, before_publish_ns=before_ns
    )
    (found,) = ask(history, wanted).stretches
    return found


def fill(history: History, times: list[int], topic: str = "a", size: int = 10) -> None:
    for number, publish_ns in enumerate(times, 1):
        history.keep(topic, bytes([number % 256]) * size, "e", number, publish_ns)


@given(
    st.lists(st.integers(1, 60), unique=True, min_size=1).map(sorted),
    st.integers(0, 61),
    st.integers(0, 61),
)
def test_answer_holds_what_was_published_strictly_between(
    times: list[int], after_ns: int, before_ns: int
) -> None:
    history = History(SESSION)
    fill(history, times)
    found = stretch(history, after_ns, before_ns)
    wanted = [t for t in times if after_ns < t and (before_ns == 0 or t < before_ns)]
    assert [message.publish_ns for message in found.messages] == wanted
    assert [message.sequence for message in found.messages] == [times.index(t) + 1 for t in wanted]
    assert all(m.payload == bytes([m.sequence]) * 10 for m in found.messages)
    assert found.after_sequence == sum(t <= after_ns for t in times)
    assert found.newest_publish_ns == times[-1]


def test_old_ones_are_forgotten_but_the_last_few_of_a_topic_are_kept() -> None:
    history = History(SESSION, span_s=1.0)
    fill(history, [1 + n * S // 10 for n in range(100)], "often")
    fill(history, [1 + n * S for n in range(3)], "rare")
    fill(history, [1 + 100 * S // 10 + n * S // 10 for n in range(900)], "often")
    assert len(stretch(history, 0, topic="rare").messages) == 3
    found = stretch(history, 1, topic="often")
    assert KEPT_FEW <= len(found.messages) <= 12 + KEPT_FEW
    assert not found.HasField("after_sequence")  # the first ones are gone: nobody can say
    assert found.messages[-1].publish_ns == found.newest_publish_ns


def test_forgotten_ones_still_tell_where_the_numbering_stood() -> None:
    history = History(SESSION, span_s=1e-9)
    fill(history, list(range(1, 101)))
    first = stretch(history, 0).messages[0]
    found = stretch(history, first.publish_ns - 1)
    assert found.after_sequence == first.sequence - 1


@given(
    st.lists(st.tuples(st.sampled_from("abcd"), st.integers(0, 4000)), max_size=200),
    st.integers(500, 20_000),
)
def test_bound_holds_after_every_message_and_the_newest_is_kept_longest(
    messages: list[tuple[str, int]], limit_bytes: int
) -> None:
    history = History(SESSION, limit_bytes=limit_bytes)
    for number, (topic, size) in enumerate(messages, 1):
        history.keep(topic, bytes(size), "e", number, number)
        assert 0 <= history.size_bytes <= limit_bytes
        for each in "abcd":
            wanted = ResendStretch(topic=each, session=SESSION)
            for found in ask(history, wanted).stretches:
                times = [message.publish_ns for message in found.messages]
                assert times == sorted(times)
                assert not found.messages or found.more or times[-1] == found.newest_publish_ns


def test_memory_is_what_the_bound_says() -> None:
    history = History(SESSION)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for number in range(60_000):
        history.keep(f"t{number % 12}", bytes(150 + number % 300), "e", number, S + number)
    used = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert history.size_bytes > 0.99 * LIMIT_BYTES
    assert used < LIMIT_BYTES


def test_long_answer_comes_in_parts_that_follow_each_other() -> None:
    history = History(SESSION)
    fill(history, list(range(1, 1001)), size=1000)
    got: list[int] = []
    while True:
        found = stretch(history, got[-1] if got else 0, 900)
        assert sum(len(message.payload) for message in found.messages) <= ANSWER_BYTES + 1000
        got += [message.publish_ns for message in found.messages]
        if not found.more:
            break
    assert got == list(range(1, 900))


def test_stretches_beyond_the_room_are_left_out_and_said() -> None:
    history = History(SESSION)
    fill(history, list(range(1, 501)), "a", 1000)
    fill(history, list(range(1, 501)), "b", 1000)
    wanted = [ResendStretch(topic=topic, session=SESSION) for topic in "ab"]
    answer = ask(history, *wanted)
    assert len(answer.stretches) == 1
    assert answer.more


def test_other_sessions_and_unknown_topics_are_not_ours_to_answer() -> None:
    history = History(SESSION)
    fill(history, [1, 2])
    assert not ask(history, ResendStretch(topic="a", session=SESSION + 1)).stretches
    assert not ask(history, ResendStretch(topic="x", session=SESSION)).stretches
    assert len(stretch(history, 0, session=0).messages) == 2


def test_asked_for_everything_only_news_are_told() -> None:
    history = History(SESSION)
    for topic in ("t/a", "t/b", "u/a"):
        fill(history, [10, 20], topic)
    known = ResendStretch(topic="t/a", session=SESSION, after_publish_ns=20)
    answer = ask(history, known, expression="t/**", after_publish_ns=10, before_publish_ns=21)
    (found,) = answer.stretches
    assert found.topic == "t/b"
    assert [message.publish_ns for message in found.messages] == [20]
    assert found.after_sequence == 1


@given(st.binary(max_size=40))
def test_garbage_is_no_request(data: bytes) -> None:
    history = History(SESSION)
    fill(history, [1, 2])
    history.answer(data)
    assert history.answer(b"\xff\xff\xff") is None
    assert history.refused >= 1
