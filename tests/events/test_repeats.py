"""What repeats is said now and then, and each time it happened is in exactly one count."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from tramstream.clock import S
from tramstream.events import Event, define
from tramstream.events.repeats import AGAIN_NS, MOST, Repeats

LATE = define("test.late", "{key} is late by {late_s}", key=str, late_s=float)
LOUD = define("test.loud", "{key} is loud", key=str)


def late(key: str = "a", late_s: float = 1.0) -> Event:
    return LATE(key=key, late_s=late_s)


def test_same_event_is_said_at_once_and_again_after_a_while_with_its_count() -> None:
    repeats = Repeats()
    said = [repeats.take(late(late_s=t), t * S) for t in range(25)]
    assert [(t, unsaid) for t, unsaid in enumerate(said) if unsaid is not None] == [
        (0, 0), (10, 9), (20, 9),
    ]  # fmt: skip


def test_other_keys_and_other_kinds_are_other_events() -> None:
    repeats = Repeats()
    assert [repeats.take(each, 0) for each in (late("a"), late("b"), LOUD(key="a"))] == [0, 0, 0]


def test_what_nobody_said_for_long_is_overdue_with_its_newest_facts() -> None:
    repeats = Repeats()
    for t in range(4):
        repeats.take(late(late_s=t), t * S)
    assert repeats.overdue(9 * S) == []
    assert repeats.overdue(AGAIN_NS) == [(late(late_s=3.0), 2)]
    assert repeats.overdue(2 * AGAIN_NS) == []


def test_time_that_is_set_back_keeps_nothing_quiet_for_ever() -> None:
    repeats = Repeats()
    assert repeats.take(late(), 1000 * S) == 0
    assert repeats.take(late(), 5 * S) == 0


def test_made_up_keys_are_told_apart_up_to_a_bound() -> None:
    repeats = Repeats()
    said = [repeats.take(late(f"made up {n}"), 0) for n in range(1000)]
    assert len([each for each in said if each is not None]) == MOST + 1
    (_, unsaid), *others = repeats.overdue(AGAIN_NS)
    assert (unsaid, others) == (1000 - MOST - 1 - 1, [])
    assert len(json.dumps(repeats.snapshot())) < 200 * MOST


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 8)), max_size=60),
    st.integers(0, 60),
)
def test_each_event_is_counted_once_whenever_the_memory_is_cut(
    happened: list[tuple[str, int]], cut: int
) -> None:
    repeats, whole = Repeats([LATE]), Repeats([LATE])
    now_ns = counted = 0
    for place, (key, pause_s) in enumerate(happened):
        if place == cut:
            memory = json.loads(json.dumps(repeats.snapshot()))
            repeats = Repeats([LATE])
            repeats.restore(memory)
        now_ns += pause_s * S
        unsaid = repeats.take(late(key), now_ns)
        assert unsaid == whole.take(late(key), now_ns)
        counted += 0 if unsaid is None else 1 + unsaid
    counted += sum(1 + unsaid for _, unsaid in repeats.overdue(now_ns + AGAIN_NS))
    assert counted == len(happened)
