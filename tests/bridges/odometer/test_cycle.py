"""Stamps of cyclic messages that a busy reader stamps late, against the instants they were sent."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field

import numpy as np
import pytest

from tramstream.bridges.odometer.cycle import LATE_NS, LEARNED, STUCK, Cycle, CycleMemory
from tramstream.clock import S
from tramstream.memory.stage import copied

MS = 1_000_000
START_NS = 1_700_000_000 * S


def cycle() -> Cycle:
    return Cycle(CycleMemory())


@dataclass
class Sender:
    """An ECU that sends every `period_ns`, and a reader that wakes up when it can."""

    period_ns: float = 20 * MS
    seed: int = 1
    jitter_ns: float = 0.1 * MS
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def sent(self, count: int, start_ns: int = START_NS) -> list[int]:
        ideal_ns = np.arange(count) * self.period_ns + self.rng.uniform(0, self.jitter_ns, count)
        return [start_ns + round(each) for each in ideal_ns.tolist()]

    def read(self, sent: list[int], share: float, longest_ns: float) -> list[int]:
        """Arrivals: a share of the wakings come up to `longest_ns` late, with all that waits."""
        arrivals: list[int] = []
        awake_ns = 0
        for each in sent:
            if each > awake_ns:
                late_ns = self.rng.uniform(0, longest_ns) if self.rng.random() < share else 0.0
                awake_ns = each + round(late_ns + self.rng.exponential(0.05 * MS))
            arrivals.append(awake_ns)
        return arrivals


def stamped(node: Cycle, arrivals: list[int]) -> list[int]:
    return [node.stamp(arrival) for arrival in arrivals]


def errors_ms(stamps: list[int], sent: list[int]) -> np.ndarray:
    return (np.array(stamps) - np.array(sent)) / MS


@pytest.mark.parametrize("period_ms", [10.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize("skew", [-100e-6, 0.0, 100e-6])
def test_late_readings_are_stamped_when_they_were_sent(period_ms: float, skew: float) -> None:
    """Half of the wakings are up to 200 ms late: the arrivals are 100 ms off, the stamps 2 ms."""
    sender = Sender(period_ms * MS * (1 + skew))
    quiet = sender.sent(max(2 * LEARNED, round(3 * S / sender.period_ns)))
    busy = sender.sent(2000, quiet[-1] + round(sender.period_ns))
    node = cycle()
    stamped(node, sender.read(quiet, 0.0, 0.0))
    arrivals = sender.read(busy, 0.5, 200 * MS)
    stamps = stamped(node, arrivals)
    assert np.abs(errors_ms(arrivals, busy)).max() > 100
    assert np.abs(errors_ms(stamps, busy)).max() < 2.0
    assert node.memory.late > 0.3 * len(busy) * min(1.0, 50 / period_ms)
    assert all(stamp <= arrival for stamp, arrival in zip(stamps, arrivals, strict=True))
    assert node.memory.skipped == 0


def test_period_is_learned_on_a_busy_computer_too() -> None:
    sender = Sender(seed=3)
    sent = sender.sent(3000)
    node = cycle()
    stamps = stamped(node, sender.read(sent, 0.3, 100 * MS))
    assert node.period_ns == pytest.approx(20 * MS, rel=1e-3)
    settled = np.abs(errors_ms(stamps, sent))[500:]
    assert settled.max() < 1.0


def test_arrivals_in_time_keep_their_stamps_to_the_jitter_of_the_bus() -> None:
    sender = Sender(jitter_ns=1.0 * MS)
    sent = sender.sent(2000)
    node = cycle()
    stamps = stamped(node, sent)
    assert stamps[:100] == sent[:100]
    assert np.abs(errors_ms(stamps, sent)).max() < 1.1
    assert node.memory.late == 0
    assert node.memory.refuted == 0


@pytest.mark.parametrize("lost", [1, 3, 40])
def test_lost_messages_are_found_and_cost_four_stamps(lost: int) -> None:
    sender = Sender()
    sent = sender.sent(600)
    sent = sent[:300] + sent[300 + lost :]
    node = cycle()
    wrong = np.abs(errors_ms(stamped(node, sent), sent)) > 1.0
    assert wrong.sum() == STUCK - 1
    assert wrong[300 : 300 + STUCK - 1].all()
    assert node.memory.skipped == lost


def test_sender_that_was_silent_or_started_anew_begins_a_new_phase() -> None:
    sender = Sender()
    first = sender.sent(200)
    later = sender.sent(200, first[-1] + 9 * S + 13 * MS)  # another phase after a silence
    moved = sender.sent(200, later[-1] + 20 * MS + 9 * MS)  # and after none, by 9 ms
    sooner = sender.sent(200, moved[-1] + 7 * MS)
    node = cycle()
    sent = first + later + moved + sooner
    errors = np.abs(errors_ms(stamped(node, sent), sent))
    assert errors[:400].max() < 1.0
    assert errors[400:500].max() < 10.0  # until none of 50 messages in a row was in time
    assert errors[500:].max() < 1.0


@pytest.mark.parametrize("gaps_ms", [(20, 30), (10, 10, 20), (30, 20, 30, 20), (40, 35)])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_pattern_of_a_sender_is_no_lateness(gaps_ms: tuple[int, ...], share: float) -> None:
    """A gateway's task sends in its own steps; after a minute the stamps are those of sending."""
    count = 3000
    steps_ms = np.tile(gaps_ms, count // len(gaps_ms) + 1)[: count - 1]
    sent = [START_NS + round(each * MS) for each in np.concatenate(([0], np.cumsum(steps_ms)))]
    node = cycle()
    stamps = stamped(node, Sender(seed=6).read(sent, share, 60 * MS))
    assert np.abs(errors_ms(stamps, sent))[1800:].max() < 1.0


def test_messages_without_a_cycle_keep_their_arrivals() -> None:
    rng = np.random.default_rng(4)
    gaps_ns = rng.exponential(30 * MS, 3000)
    sent = [START_NS + round(each) for each in np.cumsum(gaps_ns).tolist()]
    node = cycle()
    errors = np.abs(errors_ms(stamped(node, sent), sent))
    assert np.median(errors) == 0.0
    assert np.quantile(errors, 0.99) < 1.0


def test_cycle_that_ends_is_no_cycle_any_more() -> None:
    rng = np.random.default_rng(5)
    regular = Sender().sent(200)
    wild = np.cumsum(rng.uniform(1 * MS, 12 * MS, 400)) + regular[-1]
    sent = regular + [round(each) for each in wild.tolist()]
    node = cycle()
    errors = np.abs(errors_ms(stamped(node, sent), sent))
    assert errors[250:].max() < 12.0
    assert np.median(errors[250:]) == 0.0


def test_reader_that_is_away_for_more_than_a_second_finds_the_rest_in_its_place() -> None:
    sender = Sender()
    sent = sender.sent(600)
    arrivals = [max(each, sent[300] + round(1.4 * S)) if i >= 300 else each
                for i, each in enumerate(sent)]  # fmt: skip
    node = cycle()
    assert np.abs(errors_ms(stamped(node, arrivals), sent)).max() < 1.0
    assert node.memory.late == sum(a - s > LATE_NS for a, s in zip(arrivals, sent, strict=True))


def test_restored_cycle_goes_on_like_the_one_that_was_copied() -> None:
    sender = Sender(seed=9)
    arrivals = sender.read(sender.sent(400), 0.4, 100 * MS)
    whole = cycle()
    expected = stamped(whole, arrivals)
    for cut in range(0, 400, 37):
        first = cycle()
        stamps = stamped(first, arrivals[:cut])
        state = copied(first.memory)
        kept = pickle.dumps(state)
        second = Cycle(copied(state))
        assert stamps + stamped(second, arrivals[cut:]) == expected
        assert pickle.dumps(state) == kept
        assert second.memory == whole.memory
