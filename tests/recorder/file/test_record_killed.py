"""A real recorder, killed without warning at random moments, loses less than half a second.

SIGKILL takes what the process has not written; what a power cut takes besides is what the last
`fdatasync` had not reached, which nothing here can see (docs: tramstream/recorder/sink.py).
"""

from __future__ import annotations

import mmap
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from live import HANG_S, until
from record_samples import VEHICLE

from tramstream import keys
from tramstream.clock import S, VehicleClock
from tramstream.config import Recorder
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.file.sink import Worker
from tramstream.recorder.reader import open_record
from tramstream.recorder.recording import Recording

LIMIT_NS = S // 2

WRITER = """
import mmap, os, struct, sys, time
from pathlib import Path
from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.config import Recorder
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.recording import Recording

folder, vehicle = Path(sys.argv[1]), sys.argv[2]
with open(sys.argv[3], "r+b") as file:
    shared = mmap.mmap(file.fileno(), 16)
clock = VehicleClock(time.time_ns() - time.monotonic_ns())
settings = Recorder(split_s=float(sys.argv[4]), free_space_floor_bytes=0)
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

    def __init__(self, folder: Path, split_s: float) -> None:
        self.folder = folder
        folder.mkdir()
        board = folder.parent / f"{folder.name}.last"
        board.write_bytes(bytes(16))
        with board.open("r+b") as file:
            self.shared = mmap.mmap(file.fileno(), 16)
        arguments = [sys.executable, "-c", WRITER, str(folder), VEHICLE, str(board), str(split_s)]
        self.process = subprocess.Popen(arguments)
        self.kill_at_s = 0.0

    def last(self) -> tuple[int, int]:
        """Log time and number of the last message that was appended."""
        return struct.unpack("<QQ", self.shared[:16])


def kill_all(victims: list[Victim], chance: random.Random, latest_s: float) -> None:
    """Wait until each writes, then kill each at a moment of its own, `latest_s` at the latest."""
    waiting = list(victims)

    def all_killed() -> bool:
        for victim in list(waiting):
            if victim.kill_at_s == 0.0 and victim.last()[1] > 0:
                victim.kill_at_s = time.monotonic() + chance.uniform(0.6, latest_s)
            if victim.kill_at_s and time.monotonic() >= victim.kill_at_s:
                os.kill(victim.process.pid, signal.SIGKILL)
                waiting.remove(victim)
        return not waiting

    until(all_killed, "every recorder to write and to be killed")
    for victim in victims:
        victim.process.wait(HANG_S)


def check(victim: Victim) -> float:
    """The next start repairs; everything is there, in order, up to less than 0.5 s: how much."""
    finished = {path: path.read_bytes() for path in victim.folder.glob("*.mcap")}
    recording = Recording(
        victim.folder,
        VEHICLE,
        Recorder(free_space_floor_bytes=0),
        VehicleClock(),
        worker=Worker(threaded=False),
    )
    recording.start()
    assert all(path.read_bytes() == data for path, data in finished.items())
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
    return (last_ns - found[-1].log_ns) / S


def killed(folder: Path, kills: int, at_once: int, split_s: float, latest_s: float) -> list[float]:
    """Kill so many recorders; what each lost, in seconds."""
    chance = random.Random(20261122)
    lost_s = []
    for wave in range(kills // at_once):
        victims = [Victim(folder / f"{wave}-{number}", split_s) for number in range(at_once)]
        try:
            kill_all(victims, chance, latest_s)
        finally:
            for victim in victims:
                victim.process.kill()
        lost_s += [check(victim) for victim in victims]
        for victim in victims:
            shutil.rmtree(victim.folder)
    return lost_s


@pytest.mark.live
def test_killed_recorder_loses_less_than_half_a_second(tmp_path):
    killed(tmp_path, kills=20, at_once=10, split_s=0.9, latest_s=3.0)


@pytest.mark.study
def test_thousand_kills_damage_no_finished_file(tmp_path):
    """Parts of 2 s: what was finished is byte for byte as it was, the rest is repaired."""
    lost_s = sorted(killed(tmp_path, kills=1000, at_once=20, split_s=2.0, latest_s=6.5))
    print(f"lost: median {lost_s[500]:.3f} s, 99 % {lost_s[990]:.3f} s, worst {lost_s[-1]:.3f} s")
