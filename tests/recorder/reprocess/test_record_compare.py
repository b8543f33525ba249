"""Outputs made again are paired with recorded ones by their numbers."""

from __future__ import annotations

import random

import pytest

from tramstream import keys
from tramstream.recorder.reprocess.compare import REORDERED, Comparison

LATE, STATE = keys.SYNC_LATE.path, keys.EST_DISTANCE.path


def payload(number: int) -> bytes:
    return keys.EST_DISTANCE.type(sequence=number, distance_m=number).SerializeToString()


@pytest.mark.parametrize("seed", range(5))
def test_late_samples_made_in_another_order_are_the_same(seed: int) -> None:
    """Whichever side is ahead."""
    comparison, chance = Comparison(), random.Random(seed)
    steps = [(side, number) for side in ("make", "expect") for number in range(1, 60)]
    chance.shuffle(steps)
    for side, number in steps:
        getattr(comparison, side)(0, LATE, number, payload(number))
    comparison.close()
    assert (comparison.compared, comparison.difference_count) == (59, 0)
    assert (comparison.unrecorded, comparison.unanchored) == (0, 0)


def test_one_that_differs_is_named_in_whatever_order_they_come() -> None:
    comparison = Comparison()
    for number in (1, 2, 3):
        comparison.expect(0, STATE, number, payload(number))
    for number, made in ((3, 3), (1, 1), (2, 7)):
        comparison.make(0, STATE, number, payload(made))
    comparison.close()
    assert comparison.differences == [f"{STATE} sequence 2: sequence was 2, is now 7"]


def test_recorded_output_that_is_not_made_or_is_there_twice_is_a_difference() -> None:
    comparison = Comparison()
    comparison.expect(0, STATE, 1, payload(1))
    comparison.expect(0, STATE, 2, payload(2))
    comparison.expect(0, STATE, 2, payload(2))
    comparison.make(0, STATE, 1, payload(1))
    comparison.close()
    missed = f"{STATE} sequence 2: recorded, but not made again"
    assert comparison.differences == [missed, missed]


@pytest.mark.parametrize("recorded_first", [True, False])
def test_numbers_that_come_again_are_paired_in_turn(recorded_first: bool) -> None:
    """A process that is killed goes on from its memory, with the numbers of that."""
    comparison = Comparison()
    sides = ["expect", "make"] if recorded_first else ["make", "expect"]
    for side in sides:
        for number, content in ((1, 1), (2, 2), (3, 3), (2, 20), (3, 30)):
            getattr(comparison, side)(0, STATE, number, payload(content))
    comparison.close()
    assert (comparison.compared, comparison.difference_count) == (5, 0)


def test_what_no_recorder_heard_is_counted_and_not_kept() -> None:
    comparison = Comparison()
    for number in range(REORDERED + 100):
        comparison.make(0, STATE, number, payload(number))
    assert comparison.unrecorded == 100
    comparison.close()
    assert comparison.unrecorded == REORDERED + 100
    assert comparison.difference_count == 0


def test_numbers_begin_again_at_32_bits() -> None:
    comparison = Comparison()
    comparison.make(0, STATE, (1 << 32) + 5, payload(5))
    comparison.expect(0, STATE, 5, payload(5))
    comparison.close()
    assert comparison.compared == 1
