"""Five hundred parts onto disks that take 0.05 to 2 s a call, at the recorder's own pace."""

from __future__ import annotations

import random
import threading
import time
from pathlib import Path

import pytest
from disks import Watched
from record_samples import VEHICLE, traffic

from tramstream.clock import VehicleClock
from tramstream.config import Recorder
from tramstream.recorder.file.sink import Worker
from tramstream.recorder.reader import open_record
from tramstream.recorder.recording import Recording

PARTS = {0.05: 260, 0.15: 120, 0.5: 60, 1.0: 40, 2.0: 20}
"""Seconds a call takes, and how many parts go onto such a disk: 500 in all."""


class Ride(threading.Thread):
    """A recorder on a slow disk: appends, flushes four times a second, splits now and then."""

    def __init__(self, folder: Path, delay_s: float, parts: int) -> None:
        super().__init__(name=f"disk of {delay_s} s")
        self.folder, self.parts = folder, parts
        self.chance = random.Random(parts)
        disk = Watched(lambda name, file: time.sleep(delay_s * self.chance.uniform(0.5, 1.5)))
        self.recording = Recording(
            folder,
            VEHICLE,
            Recorder(split_s=0.3, free_space_floor_bytes=0),
            VehicleClock(time.time_ns() - time.monotonic_ns()),
            worker=Worker(storage=disk),
        )
        self.sent = 0
        self.closed = False

    def run(self) -> None:
        self.recording.start()
        source = traffic(2000)
        while self.recording.part < self.parts:
            for one in source[:5]:
                self.sent += 1
                self.recording.append(
                    one.topic, one.key, one.payload, self.sent, self.sent, self.sent
                )
            self.recording.flush()
            time.sleep(self.chance.uniform(0.0, 0.25))
        self.closed = self.recording.close(3600.0)


@pytest.mark.study
def test_no_part_is_empty_or_replaced_on_a_slow_disk(tmp_path):
    rides = []
    for delay_s, parts in PARTS.items():
        (tmp_path / str(delay_s)).mkdir()
        rides.append(Ride(tmp_path / str(delay_s), delay_s, parts))
    for ride in rides:
        ride.start()
    for ride in rides:
        ride.join()
    counted = 0
    for ride in rides:
        assert ride.closed
        assert ride.recording.take_losses() == []
        numbers = []
        for path in sorted(ride.folder.glob("*.mcap*")):
            counted += 1
            assert path.suffix == ".mcap"
            with open_record(path) as record:
                found = [entry.sequence for entry in record.messages()]
                assert found, f"{path} is empty"
                assert not record.damaged
            numbers += found
        assert numbers == list(range(1, ride.sent + 1))
    print(f"{counted} parts, {sum(ride.sent for ride in rides)} messages: none empty or replaced")
    assert counted >= sum(PARTS.values())
