"""What the filters refuse is told with its innovation, its limit and what holds the limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from test_ekf import EVENT, RUNNING, memory
from test_tram_start import copies, plain

from tramstream import keys
from tramstream.events import Kind
from tramstream.events.messages import facts_of, sentence_of
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.processors.distance import events as distance_events
from tramstream.processors.distance.processor import DistanceFilter
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.tram_filter import events
from tramstream.proto.sync_pb2 import SyncFrame

M_PER_DEG = math.radians(1.0) * 6_371_000.0
FIRST = 100
"""Frame after the beginning from which on something is wrong."""


def north(m: float) -> Callable[[SyncFrame], None]:
    def change(frame: SyncFrame) -> None:
        for fix in frame.gnss:
            fix.latitude_deg += m / M_PER_DEG

    return change


def southwards(frame: SyncFrame) -> None:
    """The tram goes another way."""
    for fix in frame.gnss:
        fix.vel_e_mps, fix.vel_n_mps, fix.speed_std_mps = 0.0, -30.0, 0.1


def further(pulses: int) -> Callable[[SyncFrame], None]:
    """What the left wheel has counted jumps, and stays there."""

    def change(frame: SyncFrame) -> None:
        for reading in frame.odometry:
            reading.wheels[0].pulses += pulses

    return change


def told(processor: Processor, frames: list[SyncFrame], key: Any) -> list[Any]:
    """Events that a processor raises out of frames."""
    return [
        sample.message
        for number, frame in enumerate(frames)
        for sample in processor.step(Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number))
        if sample.key == key
    ]


def refused(change: Callable[[SyncFrame], None], frames_wrong: int) -> list[Any]:
    state, frames = memory(RUNNING, 2000)
    frames = copies(frames)
    for frame in frames[FIRST : FIRST + frames_wrong]:
        change(frame)
    processor = LocalisationFilter(plain(1).simulation.vehicle)
    processor.restore(snapshots.unpack(state))
    return told(processor, frames, EVENT)


@pytest.mark.parametrize(
    ("change", "kind", "key", "innovation", "value"),
    [
        (north(41.0), events.FIX_REFUSED, keys.GNSS_FIX, "innovation_m", 41.0),
        (southwards, events.VELOCITY_REFUSED, keys.GNSS_FIX, "innovation_mps", None),
        (further(40), events.WHEEL_REFUSED, keys.ODO_WHEELS, "innovation_m", None),
    ],
)
def test_refusal_names_key_innovation_limit_and_setting(
    change: Callable[[SyncFrame], None], kind: Kind, key: Any, innovation: str, value: float | None
) -> None:
    found = [each for each in refused(change, 120) if each.kind == kind.name]
    facts = facts_of(found[0])
    limit = facts[innovation.replace("innovation", "limit")]
    assert facts["key"] == key.path
    assert isinstance(limit, float)
    assert 0.0 < limit < float(facts[innovation])
    assert value is None or facts[innovation] == pytest.approx(value, abs=3.0)
    assert "$." in sentence_of(found[0])
    assert len(found) <= 2  # the same again only after ten seconds, with its count


def test_limit_is_where_fixes_begin_to_be_refused() -> None:
    """Of the very next fix after the same memory, in the same direction."""
    facts = facts_of(next(e for e in refused(north(41.0), 25) if e.kind == events.FIX_REFUSED.name))
    bias_m = float(facts["innovation_m"]) - 41.0  # the filter's and the fix's own
    limit_m = float(facts["limit_m"])
    for share, expected in ((0.9, False), (1.1, True)):
        kinds = {each.kind for each in refused(north(share * limit_m - bias_m), 25)}
        assert (events.FIX_REFUSED.name in kinds) == expected, share


def test_what_is_refused_for_long_is_counted() -> None:
    found = refused(north(41.0), 600)
    fixes = [each for each in found if each.kind == events.FIX_REFUSED.name]
    assert sum(1 + each.unsaid for each in fixes) >= 3


def test_distance_names_what_it_refuses_and_its_setting() -> None:
    ride = plain(1)
    frames = copies(ride.between(-1.0, 45.0))
    for frame in frames[RUNNING : RUNNING + 40]:
        further(400)(frame)
    processor = DistanceFilter(ride.simulation.vehicle)
    found = told(processor, frames, keys.EVENT.at("distance"))
    first = next(e for e in found if e.kind == distance_events.PATH_REFUSED.name)
    facts = facts_of(first)
    assert facts["key"] == keys.ODO_WHEELS.path
    assert float(facts["innovation_m"]) > float(facts["limit_m"]) > 0.0
    assert "$.distance.gate_sigma" in sentence_of(first)
