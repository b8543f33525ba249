"""Track geometry on its way into the filter: at its frame, in order, or late and named."""

from __future__ import annotations

from tramstream import keys
from tramstream.clock import S
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.processor import Sample
from tramstream.processors.localisation.delayed import MOST, Delayed, DelayedMemory
from tramstream.proto.estimate_pb2 import TrackGeometry
from tramstream.proto.sync_pb2 import LateSample

MS = S // 1000
DELAY_S = 0.2


def geometry(stamp_ns: int, sequence: int = 1, publish_ns: int = 77) -> Sample:
    message = TrackGeometry(stamp_ns=stamp_ns, sequence=sequence)
    return Sample(keys.MAP_TRACK, message, stamp_ns, sequence, publish_ns)


def test_geometry_is_used_at_the_first_frame_at_or_after_its_instant_and_the_delay() -> None:
    delayed = Delayed(DELAY_S)
    assert delayed.due(S) == []
    assert delayed.take(geometry(S)) is None
    assert delayed.due(S + 199 * MS) == []
    (found,) = delayed.due(S + 200 * MS)
    assert found.stamp_ns == S
    assert delayed.due(S + 210 * MS) == []
    assert delayed.ledger.balanced


def test_order_of_coming_makes_no_difference() -> None:
    delayed = Delayed(DELAY_S)
    for stamp_ms in (1030, 1010, 1020):
        assert delayed.take(geometry(stamp_ms * MS)) is None
    stamps = [each.stamp_ns // MS for each in delayed.due(1220 * MS)]
    assert stamps == [1010, 1020]
    assert delayed.ledger.pending == 1


def test_geometry_whose_frame_has_gone_by_is_late_and_named() -> None:
    delayed = Delayed(DELAY_S)
    delayed.due(S + 200 * MS)
    late = delayed.take(geometry(S, sequence=9))
    assert late == LateSample(
        key=keys.MAP_TRACK.path,
        source_sequence=9,
        source_publish_ns=77,
        horizon_ns=S + 200 * MS,
    )
    assert delayed.take(geometry(S + MS)) is None
    assert delayed.ledger.dropped == 1
    assert delayed.ledger.balanced


def test_repeated_ride_holds_for_late_what_was_late_and_nothing_else() -> None:
    delayed = Delayed(DELAY_S)
    name = LateSample(stamp_ns=S, sequence=3, key=keys.MAP_TRACK.path, source_sequence=9)
    other = LateSample(stamp_ns=2 * S, sequence=4, key=keys.GNSS_FIX.path, source_sequence=10)
    delayed.repeat({(name.key, 77): name, (other.key, 78): other})
    assert delayed.take(geometry(S, sequence=9, publish_ns=0)) is name
    assert delayed.take(geometry(2 * S, sequence=10, publish_ns=0)) is None
    assert [each.sequence for each in delayed.due(3 * S)] == [10]


def test_what_never_finds_its_frame_does_not_pile_up() -> None:
    delayed = Delayed(DELAY_S)
    late = [delayed.take(geometry(S + k)) for k in range(MOST + 10)]
    assert sum(each is not None for each in late) == 10
    assert delayed.ledger.pending == MOST
    assert delayed.ledger.balanced


def test_restored_queue_goes_on() -> None:
    delayed, other = Delayed(DELAY_S), Delayed(DELAY_S)
    delayed.due(S)
    delayed.take(geometry(S + MS, sequence=5))
    assign(other.memory, from_plain(DelayedMemory, to_plain(delayed.memory)))
    assert other.memory == delayed.memory
    assert other.due(2 * S) == delayed.due(2 * S)
    assert other.ledger == delayed.ledger
