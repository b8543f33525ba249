"""The bounded queue between threads."""

from __future__ import annotations

import threading
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from tramstream.transport.ring import Ring


def test_items_come_out_in_order() -> None:
    ring: Ring[int] = Ring(10)
    for item in range(5):
        ring.put("a", item)
    assert len(ring) == 5
    assert [ring.get(0.0) for _ in range(5)] == [0, 1, 2, 3, 4]
    assert ring.get(0.0) is None


def test_full_ring_drops_the_oldest_and_counts_it_by_name() -> None:
    ring: Ring[int] = Ring(3)
    for item in range(7):
        ring.put("even" if item % 2 == 0 else "odd", item)
    assert [ring.get(0.0) for _ in range(3)] == [4, 5, 6]
    assert ring.dropped == {"even": 2, "odd": 2}
    assert ring.dropped_total == 4


def test_drop_is_counted_under_the_name_of_what_was_dropped() -> None:
    ring: Ring[int] = Ring(3)
    for name in ("old", "old", "older still", "new", "new"):
        ring.put(name, 0)
    assert ring.dropped == {"old": 2}
    ring.put("newest", 0)
    assert ring.dropped == {"old": 2, "older still": 1}


@given(st.integers(1, 4), st.text("abc", max_size=30))
def test_names_of_drops_and_of_what_is_left_are_those_that_were_put(
    capacity: int, names: str
) -> None:
    ring: Ring[str] = Ring(capacity)
    for name in names:
        ring.put(name, name)
    left = [ring.get(0.0) for _ in range(len(ring))]
    assert left == list(names[-capacity:])
    assert ring.dropped == Counter(names[:-capacity])


def test_negative_patience_is_none_at_all() -> None:
    assert Ring(1).get(-1.0) is None


@given(st.integers(1, 5), st.lists(st.booleans(), max_size=60))
def test_ledger_balances_after_any_puts_and_gets(capacity: int, puts: list[bool]) -> None:
    ring: Ring[int] = Ring(capacity)
    for number, put in enumerate(puts):
        if put:
            ring.put("a", number)
        else:
            ring.get(0.0)
        assert ring.ledger().balanced
        assert len(ring) <= capacity
    assert ring.ledger().received == sum(puts)
    assert ring.ledger().dropped == sum(ring.dropped.values())


def test_ledger_balances_while_other_threads_put() -> None:
    ring: Ring[int] = Ring(8)
    count, threads = 2000, 3
    begin = threading.Barrier(threads + 1)

    def work() -> None:
        begin.wait()
        for number in range(count):
            ring.put("a", number)

    workers = [threading.Thread(target=work) for _ in range(threads)]
    for worker in workers:
        worker.start()
    begin.wait()
    while any(worker.is_alive() for worker in workers):
        ring.get(0.0)
        assert ring.ledger().balanced
    while ring.get(0.0) is not None:
        pass
    ledger = ring.ledger()
    assert ledger.balanced
    assert ledger.received == count * threads
    assert ledger.dropped == ring.dropped["a"]
    assert len(ring) == 0
