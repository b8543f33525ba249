"""Event time: wherever the localiser runs and whenever its states come, the slope is the same."""

from __future__ import annotations

import random
from collections.abc import Iterable
from functools import cache
from typing import Any

from slopes import FRAME_S, Slopes

from tramstream import keys
from tramstream.clock import S
from tramstream.processor import Sample
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.proto.sync_pb2 import LateSample

RIDE = Slopes(duration_s=40.0, matched=True)


@cache
def ride() -> tuple[Sample, ...]:
    return tuple(RIDE.samples())


def said(samples: Iterable[Sample], processor: GradeEstimator | None = None) -> list[Any]:
    stage = processor or GradeEstimator(RIDE.vehicle)
    return [
        (made.key.path, made.stamp_ns, made.sequence, made.message.SerializeToString())
        for sample in samples
        for made in stage.step(sample)
    ]


def arriving(delays_s: dict[str, tuple[float, float]]) -> list[Sample]:
    """The ride as it arrives over a bus: each key in order, later by its own delay."""
    rng = random.Random(3)
    newest: dict[str, float] = {}
    timed = []
    for number, sample in enumerate(ride()):
        path = sample.key.path
        low, high = delays_s.get(path, (0.0, 0.0))
        at = sample.stamp_ns / S + rng.uniform(low, high)
        newest[path] = at = max(at, newest.get(path, 0.0))
        timed.append((at, number, sample))
    return [sample for *_, sample in sorted(timed, key=lambda each: each[:2])]


def test_states_and_matches_that_come_later_give_the_same_bytes() -> None:
    state, match = keys.EST_STATE.path, keys.MAP_MATCH.path
    together = said(ride())
    assert any(path == keys.EST_GRADE.path for path, *_ in together)
    for delays in ({state: (0.0, 0.02), match: (0.01, 0.05)}, {state: (0.05, 0.19)}):
        assert said(arriving(delays)) == together


def test_slope_has_the_stamp_of_its_frame_and_comes_a_fifth_of_a_second_after_it() -> None:
    stage, newest_ns = GradeEstimator(RIDE.vehicle), 0
    for sample in ride():
        newest_ns = max(newest_ns, sample.stamp_ns)
        for made in stage.step(sample):
            if made.key is keys.EST_GRADE:
                assert newest_ns - made.stamp_ns == S // 5


def test_one_for_each_frame() -> None:
    stamps = [stamp for path, stamp, *_ in said(ride()) if path == keys.EST_GRADE.path]
    frames = [each.stamp_ns for each in ride() if each.key is keys.SYNC_FRAME]
    assert stamps == frames[: len(stamps)]
    assert len(frames) - len(stamps) == round(0.2 / FRAME_S)


def test_what_comes_too_late_is_named_counted_and_not_used() -> None:
    late_s, path = 0.5, keys.EST_STATE.path
    victims = {700, 701, 1200}
    held, arrived = [], []
    for sample in ride():
        if sample.key.path == path and sample.sequence in victims:
            held.append(sample)
        else:
            arrived.append(sample)
        while held and sample.stamp_ns > held[0].stamp_ns + late_s * S:
            arrived.append(held.pop(0))
    stage = GradeEstimator(RIDE.vehicle)
    found = said(arrived, stage)
    late = [LateSample.FromString(data) for p, _, _, data in found if p == "est/grade/late"]
    assert {(each.key, each.source_sequence) for each in late} == {(path, n) for n in victims}
    without = [each for each in ride() if not (each.key.path == path and each.sequence in victims)]
    expected = [each for each in said(without) if each[0] == "est/grade/state"]
    assert [each for each in found if each[0] == "est/grade/state"] == expected
    (ledger,) = stage.ledgers()
    assert ledger.balanced
    assert ledger.dropped == len(victims)
    again = GradeEstimator(RIDE.vehicle)
    again.late_recorded = {(each.key, -each.source_sequence): each for each in late}
    in_order = [each for each in said(ride(), again) if each[0] == "est/grade/state"]
    assert in_order == expected, "reprocessing leaves out what was late live"


def test_stamps_that_go_back_are_no_second_frame() -> None:
    frames = [each for each in ride() if each.key is keys.SYNC_FRAME]
    stage = GradeEstimator(RIDE.vehicle)
    said(ride()[:1500], stage)
    before = stage.memory.waiting.taken_ns
    assert said([frames[10]], stage) == []
    assert stage.memory.waiting.taken_ns == before


def test_state_that_is_no_number_is_counted_and_left_out() -> None:
    stage = GradeEstimator(RIDE.vehicle)
    broken = type(ride()[1].message)()
    broken.CopyFrom(ride()[1].message)
    broken.pitch_rad = float("nan")
    stage.step(ride()[1]._replace(message=broken))
    (ledger,) = stage.ledgers()
    assert (ledger.received, ledger.dropped) == (1, 1)
