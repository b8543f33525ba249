"""A replay as fast as it goes lets the recorder keep up: what that missed can be sent again."""

from __future__ import annotations

from pathlib import Path
from threading import Event

import pytest

from tramstream import keys
from tramstream.clock import S, VehicleClock
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record
from tramstream.recorder.replay import AFTER_NS, Replay
from tramstream.transport.bus import LocalBus
from tramstream.transport.resend import ENTRY_BYTES, LIMIT_BYTES
from tramstream.transport.settings import LEAVE_S

COUNT, SIZE_BYTES = 60, 300_000
"""Twice as much as a publisher keeps."""


class Slow(LocalBus):
    """A bus whose recorder has nothing until it is waited for; it may stand still."""

    def __init__(self, stands_still: bool) -> None:
        super().__init__(VehicleClock())
        self.ahead_bytes = self.most_bytes = self.waits = 0
        self.stands_still = stands_still

    def _put(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int
    ) -> None:
        self.ahead_bytes += len(payload) + ENTRY_BYTES
        self.most_bytes = max(self.most_bytes, self.ahead_bytes)

    def until_recorded(self, vehicle: str, timeout_s: float = LEAVE_S) -> bool:
        self.waits += 1
        self.ahead_bytes = 0
        return not self.stands_still


def replayed(folder: Path, rate: float, stands_still: bool = False) -> Slow:
    path = folder / "big.mcap"
    key = keys.IMU_BYTES
    with RecordFile(path, "tram") as file:
        for number in range(1, COUNT + 1):
            payload = RawBytes(data=bytes(SIZE_BYTES)).SerializeToString()
            at_ns = number * S // 1000
            file.append(key.on("tram"), key, payload, at_ns, at_ns, number)
    bus = Slow(stands_still)
    with open_record(path) as record:
        replay = Replay(record, bus, "copy", rate, lambda _: True)
        replay.run(Event(), lambda: None)
    assert replay.published == COUNT
    return bus


def test_no_more_is_ahead_of_the_recorder_than_is_kept_for_it(tmp_path: Path) -> None:
    assert COUNT * SIZE_BYTES > 2 * LIMIT_BYTES
    assert replayed(tmp_path, 0.0).most_bytes < LIMIT_BYTES


@pytest.mark.parametrize(("rate", "stands_still", "waits"), [(100.0, False, 1), (0.0, True, 2)])
def test_nothing_is_waited_for_at_a_pace_and_a_dead_recorder_only_once(
    tmp_path: Path, rate: float, stands_still: bool, waits: int
) -> None:
    """Once on the way, and once at the end."""
    assert replayed(tmp_path, rate, stands_still).waits == waits


def test_pause_of_years_in_a_record_is_not_waited_for(tmp_path: Path) -> None:
    path, key, years_ns = tmp_path / "jump.mcap", keys.IMU_BYTES, 44 * 365 * 86_400 * S
    with RecordFile(path, "tram") as file:
        for number, at_ns in enumerate((S, 2 * S, years_ns, years_ns + S), 1):
            payload = RawBytes(data=b"x").SerializeToString()
            file.append(key.on("tram"), key, payload, at_ns, at_ns, number)
    bus = Slow(stands_still=False)
    with open_record(path) as record:
        replay = Replay(record, bus, "copy", 1000.0, lambda _: True)
        replay.run(Event(), lambda: None)
    assert replay.published == 4
    assert replay.skipped_ns == years_ns - 2 * S - AFTER_NS
