"""The live page with a hundred open browsers, and one that does not read.

The vehicle's messages are published by this process at the rates of a ride, the page is a process
of its own, as a user starts it, and the browsers are another: they take each message and count it.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from google.protobuf.message import Message

from tramstream import keys
from tramstream.cli.figures.bench_stages import Figure
from tramstream.cli.terminal.page_beside import page_process
from tramstream.clock import S, VehicleClock
from tramstream.proto.estimate_pb2 import GradeState, MapMatch, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.supervision import usage
from tramstream.transport.bus import Bus, ZenohBus

VEHICLE = "bench"
CLIENTS = 100
SETTLE_S = 5.0
MEASURE_S = 60.0
RATE_HZ = 100.0

READERS = """
import asyncio, json, sys, time
import websockets
address, clients = sys.argv[1], int(sys.argv[2])
begin_s, end_s, ahead_s = (float(each) for each in sys.argv[3:6])
async def silent():
    reader, writer = await asyncio.open_connection("127.0.0.1", int(address.rpartition(":")[2]))
    host = address.encode()
    writer.write(b"GET /live HTTP/1.1\\r\\nHost: " + host + b"\\r\\nUpgrade: websocket\\r\\n"
                 b"Connection: Upgrade\\r\\nSec-WebSocket-Version: 13\\r\\n"
                 b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\\r\\n\\r\\n")
    reader._transport.pause_reading()
    return writer
async def read(counts, late, k):
    async with websockets.connect(f"ws://{address}/live", max_size=None, compression=None) as link:
        while time.time() < end_s:
            message = await link.recv()
            if begin_s <= time.time() < end_s and message.startswith(b'{"type":"frame"'):
                counts[k] += 1
                if k == 0:
                    state = json.loads(message)["state"]
                    late.append(time.time() + ahead_s - state["t_s"])
async def main():
    counts, late = [0] * clients, []
    quiet = await silent()
    await asyncio.gather(*(read(counts, late, k) for k in range(clients)))
    quiet.close()
    late.sort()
    print(json.dumps({"least": min(counts), "late_p95_s": late[int(0.95 * len(late))]}))
asyncio.run(main())
"""


def measure() -> list[Figure]:
    """A minute with a hundred browsers."""
    with tempfile.TemporaryDirectory(prefix="tramstream-", dir="/tmp") as name:
        folder = Path(name)
        bus = ZenohBus.route(folder, VehicleClock())
        try:
            with riding(bus), page_process(VEHICLE, folder, "127.0.0.1:0") as (process, address):
                ahead_s = (bus.clock.now_ns() - time.time_ns()) / S
                return _measured(process.pid, address.split("/")[2], ahead_s)
        finally:
            bus.close()


def _measured(pid: int, address: str, ahead_s: float) -> list[Figure]:
    time.sleep(SETTLE_S)
    alone_mb = usage.memory_mb(pid)["Pss"]
    begin_s = time.time() + SETTLE_S
    times = (str(begin_s), str(begin_s + MEASURE_S), str(ahead_s))
    command = [sys.executable, "-c", READERS, address, str(CLIENTS), *times]
    readers = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    time.sleep(max(0.0, begin_s - time.time()))
    before_s, begun_s = usage.cpu_s(pid), time.monotonic()
    time.sleep(MEASURE_S)
    core_percent = 100 * (usage.cpu_s(pid) - before_s) / (time.monotonic() - begun_s)
    pss_mb = usage.memory_mb(pid)["Pss"]
    told, _ = readers.communicate()
    found = json.loads(told)
    return [
        Figure("live_page_core_percent", core_percent, 10.0, False),
        Figure("live_page_pss_mb", pss_mb, 80.0, False),
        Figure("live_page_pss_alone_mb", alone_mb),
        Figure("live_page_messages_per_s", found["least"] / MEASURE_S, 9.9),
        Figure("live_page_late_p95_ms", 1e3 * found["late_p95_s"], 150.0, False),
    ]


@contextmanager
def riding(bus: Bus) -> Iterator[None]:
    """Publish what a vehicle on its line publishes of what the page shows, at its rates."""
    stop = threading.Event()

    def ride() -> None:
        begun_s, number = time.monotonic(), 0
        bus.announce(keys.alive(VEHICLE, "ekf"))
        while not stop.is_set():
            number += 1
            for key, message in _messages(bus.clock.now_ns(), number):
                payload = message.SerializeToString()
                bus.publish(key.on(VEHICLE), payload, key.encoding, number)
            stop.wait(max(0.0, begun_s + number / RATE_HZ - time.monotonic()))

    thread = threading.Thread(target=ride)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _messages(now_ns: int, number: int) -> Iterator[tuple[keys.Key, Message]]:
    """What is published in one step of 10 ms."""
    phase = 0.01 * number
    latitude_deg, longitude_deg = 50.0 + 1e-4 * math.sin(phase), 14.0 + 1e-7 * number
    state = MotionState(
        stamp_ns=now_ns,
        sequence=number,
        mode=MotionState.TRACKING,
        speed_mps=12.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
    )
    for name in ("wheel_a", "wheel_b", "gnss_east", "gnss_north"):
        state.innovations.add(measurement=name, value=math.sin(phase), variance=1.0, accepted=True)
    yield keys.EST_NOW, state
    yield keys.EST_STATE, state
    match = MapMatch(stamp_ns=now_ns, state=MapMatch.ON_TRACK, run=0, edge="1-2", probability=0.98)
    match.references.add(line="7", direction="0", chainage_m=12.0 * phase)
    yield keys.MAP_MATCH, match
    yield keys.EST_GRADE, GradeState(stamp_ns=now_ns, grade_rad=0.01, grade_std_rad=0.001)
    if number % 2 == 0:
        wheels = Odometry(stamp_ns=now_ns)
        wheels.wheels.add(wheel="a", speed_mps=12.0)
        yield keys.ODO_WHEELS, wheels
    if number % 20 == 0:
        fix = GnssFix(stamp_ns=now_ns, valid=True, speed_mps=12.0)
        fix.latitude_deg, fix.longitude_deg = latitude_deg, longitude_deg
        yield keys.GNSS_FIX, fix
