"""A real recorder, killed without warning at random moments, loses less than half a second.

SIGKILL takes what the process has not written; what a power cut takes besides is what the last
`fdatasync` had not reached, which nothing here can see (docs: tramstream/recorder/sink.py).
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from record_samples import VEHICLE

from tramstream import keys
from tramstream.clock import S, VehicleClock
from tramstream.config import Recorder
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.disk import Recording
from tramstream.recorder.reader import open_record
from tramstream.recorder.sink import Worker

KILLS, AT_ONCE = 50, 10
LIMIT_NS = S // 2
DEADLINE_S = 30.0

WRITER = """
import mmap, os, struct, sys, time
from pathlib import Path
from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.config import Recorder
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.disk import Recording

folder, vehicle = Path(sys.argv[1]), sys.argv[2]
with open(sys.argv[3], "r+b") as file:
    shared = mmap.mmap(file.fileno(), 16)
clock = VehicleClock(time.time_ns() - time.monotonic_ns())
settings = Recorder(split_s=0.9, free_space_floor_bytes=0)
recording = Recording(folder, vehicle, settings, clock)
recording.start()
topic, noise, number = keys.IMU_BYTES.on(vehicle), os.urandom(4096), 0
flushed = clock.now_ns()
while True:
    for _ in range(7):
        number += 1
        now = clock.now_ns()
        message = RawBytes(stamp_ns=now, sequence=number, data=noise[number % 3000 :][:200])
        recording.append(topic, RawBytes, message.SerializeToString(), now, now, number)
        struct.pack_into("<QQ", shared, 0, now, number)
    if now - flushed >= settings.flush_s * 1e9:
        recording.flush()
        flushed = now
    time.sleep(0.01)
"""


class Victim:
    """A recorder of its own that is going to be killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        board = folder.parent / f"{folder.name}.last"
        board.write_bytes(bytes(16))
        with board.open("r+b") as file:
            self.shared = mmap.mmap(file.fileno(), 16)
        arguments = [sys.executable, "-c", WRITER, str(folder), VEHICLE, str(board)]
        self.process = subprocess.Popen(arguments)
        self.kill_at_s = 0.0

    def last(self) -> tuple[int, int]:
        """Log time and number of the last message that was appended."""
        return struct.unpack("<QQ", self.shared[:16])


def kill_all(victims: list[Victim], chance: random.Random) -> None:
    """Wait until each writes, then kill each at a moment of its own."""
    deadline_s = time.monotonic() + DEADLINE_S
    waiting = list(victims)
    while waiting:
        assert time.monotonic() < deadline_s
        for victim in list(waiting):
            if victim.kill_at_s == 0.0 and victim.last()[1] > 0:
                victim.kill_at_s = time.monotonic() + chance.uniform(0.6, 3.0)
            if victim.kill_at_s and time.monotonic() >= victim.kill_at_s:
                os.kill(victim.process.pid, signal.SIGKILL)
                waiting.remove(victim)
        time.sleep(0.001)
    for victim in victims:
        victim.process.wait(DEADLINE_S)


def check(victim: Victim) -> None:
    """The next start repairs; everything is there, in order, up to less than 0.5 s."""
    recording = Recording(
        victim.folder,
        VEHICLE,
        Recorder(free_space_floor_bytes=0),
        VehicleClock(),
        worker=Worker(threaded=False),
    )
    recording.start()
    assert not [path for path in victim.folder.glob("*.mcap*") if path.suffix != ".mcap"]
    last_ns, last_number = victim.last()
    with open_record(victim.folder) as record:
        found = list(record.messages())
        assert not record.damaged
        assert all(file.finished for file in record.files)
        for entry in found[:: len(found) // 20 + 1]:
            message = record.decode(entry)
            assert isinstance(message, RawBytes)
            assert message.sequence == entry.sequence
            assert message.stamp_ns == entry.log_ns
    assert [entry.sequence for entry in found] == list(range(1, len(found) + 1))
    assert found[-1].topic == keys.IMU_BYTES.on(VEHICLE)
    assert last_ns - found[-1].log_ns < LIMIT_NS
    assert len(found) <= last_number + 1


@pytest.mark.live
def test_killed_recorder_loses_less_than_half_a_second(tmp_path):
    chance = random.Random(20261122)
    for wave in range(KILLS // AT_ONCE):
        victims = [Victim(tmp_path / f"{wave}-{number}") for number in range(AT_ONCE)]
        try:
            kill_all(victims, chance)
        finally:
            for victim in victims:
                victim.process.kill()
        for victim in victims:
            check(victim)
