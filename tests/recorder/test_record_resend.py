"""A recorder between real processes: what a jam, a stop, a kill or another router costs the record.

Publishers with the traffic of a vehicle in one process, the router in another, the recorder in a
third; each is stopped, killed and started again. The publishers say at the end what they sent.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tramstream import keys
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.reader import Record, open_record

pytestmark = pytest.mark.live

DEADLINE_S = 60.0
VEHICLE = "v"

ROUTER = """
import sys
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.clock import VehicleClock
folder = Path(sys.argv[1])
bus = ZenohBus.route(folder, VehicleClock.shared(folder))
print("up", flush=True)
sys.stdin.read()
"""

RECORDER = """
import signal, sys, threading
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.clock import VehicleClock
from tramstream.config import Recorder
from tramstream.recorder.node import RecorderNode
folder = Path(sys.argv[1])
stop = threading.Event()
signal.signal(signal.SIGTERM, lambda number, frame: stop.set())
bus = ZenohBus.connect(folder, VehicleClock.shared(folder), stop)
settings = Recorder(directory=str(folder / "records"), free_space_floor_bytes=0)
node = RecorderNode("v", bus, stop, settings, {}, goes_on=True)
print("up", flush=True)
node.run()
bus.close()
"""

PUBLISHERS = """
import json, os, sys, threading, time
from pathlib import Path
from tramstream import keys
from tramstream.transport.bus import ZenohBus
from tramstream.clock import VehicleClock
from tramstream.proto.raw_pb2 import RawBytes
folder = Path(sys.argv[1])
clock = VehicleClock.shared(folder)
KEYS = (keys.IMU_BYTES, keys.GNSS_BYTES, keys.ODO_FRAMES, keys.EST_STATE)
buses = [ZenohBus.connect(folder, clock) for key in KEYS]
sent = {key.path: 0 for key in KEYS}
end = threading.Event()
threading.Thread(target=lambda: (sys.stdin.readline(), end.set()), daemon=True).start()
noise = os.urandom(4000)
large = bytes(20_000 if "large" in sys.argv else 0)
print("up", flush=True)
begin_s, count = time.monotonic(), 0
while not end.is_set():
    time.sleep(max(0.0, begin_s + count / 150 - time.monotonic()))
    count += 1
    for bus, key in zip(buses, KEYS):
        if key is keys.GNSS_BYTES and count % 300:
            continue  # every two seconds
        sent[key.path] += 1
        payload = noise[count % 3000 :][:300] + (large if key is keys.EST_STATE else b"")
        bus.publish(key.on("v"), payload, key.encoding, sent[key.path])
time.sleep(1.0)
print(json.dumps(sent), flush=True)
sys.stdin.read()
for bus in buses:
    bus.close()
"""


HASTY = """
import sys
from pathlib import Path
from tramstream import keys
from tramstream.transport.bus import ZenohBus
from tramstream.clock import VehicleClock
folder = Path(sys.argv[1])
bus = ZenohBus.connect(folder, VehicleClock.shared(folder))
key, count = keys.GNSS_SUBFRAME, 20_000
print("up", flush=True)
sys.stdin.readline()
for number in range(count):
    bus.publish(key.on("v"), bytes(100), key.encoding, number + 1)
bus.until_recorded("v", 60.0)
bus.close()
print(count, flush=True)
"""


class Other:
    """A process of its own that is up; killed at the end."""

    def __init__(self, program: str, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", program, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "up\n"

    def line(self) -> str:
        """Tell it to come to an end; what it says then."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.process.stdout.readline()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(DEADLINE_S)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


class Vehicle:
    """Router, recorder and publishers, and what the record holds of them at the end."""

    def __init__(self, folder: Path, load: str) -> None:
        self.folder = folder
        self.others: list[Other] = []
        self.router = self.start(ROUTER)
        self.recorder = self.start(RECORDER)
        self.publishers = self.start(PUBLISHERS, load)
        self.grow(20_000)

    def start(self, program: str, *arguments: str) -> Other:
        self.others.append(Other(program, str(self.folder), *arguments))
        return self.others[-1]

    def grow(self, size: int) -> None:
        """Wait until the records have grown by `size` bytes."""
        before = self.size()
        end_s = time.monotonic() + DEADLINE_S
        while self.size() < before + size:
            assert time.monotonic() < end_s, "the record does not grow"
            time.sleep(0.05)

    def size(self) -> int:
        files = (self.folder / "records").glob("*.mcap*")
        return sum(path.stat().st_size for path in files)

    def end(
        self, also: dict[str, int] | None = None
    ) -> tuple[dict[str, int], list[Loss], Counter[str]]:
        """What was sent by key path, the losses named, and what is recorded, each message once.

        `also` was sent by others than the publishers.
        """
        sent: dict[str, int] = {**json.loads(self.publishers.line()), **(also or {})}
        time.sleep(0.5)
        self.recorder.process.send_signal(signal.SIGTERM)
        assert self.recorder.process.wait(DEADLINE_S) == 0
        with open_record(self.folder / "records") as record:
            return sent, *contents(record, sent)

    def close(self) -> None:
        for other in self.others:
            other.kill()


def contents(record: Record, sent: dict[str, int]) -> tuple[list[Loss], Counter[str]]:
    """Losses that the recorder names, and messages by key path; each once and in order."""
    assert record.damages == []
    losses: list[Loss] = []
    count: Counter[str] = Counter()
    latest: dict[str, Any] = {}
    for entry in record.messages():
        path = keys.split(entry.topic)[1]
        if path == keys.LOSS.at("recorder").path:
            losses.append(record.decode(entry))
        elif path in sent:
            count[path] += 1
            place = entry.publish_ns, entry.sequence
            assert latest.get(path, (0, 0)) < place, f"{path}: twice, or not in order"
            latest[path] = place
    return losses, count


@pytest.fixture
def vehicle(request: pytest.FixtureRequest) -> Iterator[Vehicle]:
    folder = Path(tempfile.mkdtemp(dir="/tmp", prefix="tr"))
    made = Vehicle(folder, getattr(request, "param", ""))
    yield made
    made.close()
    shutil.rmtree(folder)


def test_killed_recorder_leaves_no_hole(vehicle: Vehicle) -> None:
    for _ in range(2):
        vehicle.recorder.kill()
        time.sleep(1.0)  # so long nobody records
        vehicle.recorder = vehicle.start(RECORDER)
        vehicle.grow(50_000)
    sent, losses, count = vehicle.end()
    assert count == sent
    assert losses == []


@pytest.mark.parametrize("halt_s", [8.0, pytest.param(20.0, marks=pytest.mark.study)])
def test_frozen_recorder_gets_everything_afterwards(vehicle: Vehicle, halt_s: float) -> None:
    vehicle.recorder.process.send_signal(signal.SIGSTOP)
    time.sleep(halt_s)
    vehicle.recorder.process.send_signal(signal.SIGCONT)
    vehicle.grow(300_000)
    sent, losses, count = vehicle.end()
    assert count == sent
    assert losses == []


def test_router_that_is_killed_and_started_again_costs_the_record_nothing(
    vehicle: Vehicle,
) -> None:
    for pause_s in (0.3, 2.0):
        vehicle.router.kill()
        time.sleep(pause_s)
        vehicle.router = vehicle.start(ROUTER)
        vehicle.grow(150_000)
    sent, losses, count = vehicle.end()
    assert count == sent
    assert losses == []


def test_publisher_that_ends_waits_until_the_recorder_has_the_last_of_it(vehicle: Vehicle) -> None:
    """Far more than any queue holds, at once, and then the end: no later message shows a gap."""
    done = vehicle.start(HASTY).line()
    sent, losses, count = vehicle.end(also={keys.GNSS_SUBFRAME.path: int(done)})
    assert count == +Counter(sent)
    assert losses == []


@pytest.mark.parametrize("vehicle", ["large"], indirect=True)
def test_hole_beyond_what_publishers_keep_is_named_to_the_message(vehicle: Vehicle) -> None:
    """One key carries 3 MB a second, so that its publisher keeps less than three seconds."""
    vehicle.recorder.kill()
    time.sleep(6.0)
    vehicle.recorder = vehicle.start(RECORDER)
    vehicle.grow(50_000)
    sent, losses, count = vehicle.end()
    lost: Counter[str] = Counter()
    for loss in losses:
        assert loss.cause == Loss.ABSENT
        lost[keys.split(loss.key)[1]] += loss.count
    assert set(lost) == {keys.EST_STATE.path}
    assert count + lost == sent
