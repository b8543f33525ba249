"""Figures that need processes: the bus' round trip, and the whole pipeline on simulated devices."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tramstream import keys
from tramstream.cli.figures.bench_disk import Written, own_disk
from tramstream.cli.figures.bench_stages import REPEATS, Figure, median_s
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.cli.terminal.session import say
from tramstream.clock import S, VehicleClock
from tramstream.machine import compilation
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import Rerun, rerun
from tramstream.supervision import usage as processes
from tramstream.transport.bus import Envelope, ZenohBus
from tramstream.transport.ring import Ring

PINGS = 2000
END_S = 120.0
"""Nobody waits so long for the end of a run but on a machine with much else to do."""
WARM_UP_S = 5.0
"""Before that processes are still importing and clocks are being fitted."""
STEPS_HZ = 100.0
"""Rate of the fusion frames."""
CORE_PERCENT = {"processors": 10.0}
"""What a process may take at most, where that was asked for."""
PING, PONG = keys.full("bench", "ping"), keys.full("bench", "pong")

ECHO = """
import sys, time
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.clock import VehicleClock
from tramstream.cli.figures.bench_live import PING, PONG
folder = Path(sys.argv[1])
bus = ZenohBus.connect(folder, VehicleClock.shared(folder))
bus.subscribe(PING, lambda e: bus.publish(PONG, e.payload, e.encoding, e.sequence))
sys.stdin.read()
bus.close()
"""


def bus_round_trip() -> list[Figure]:
    """There and back through the router, between two processes, 400 bytes, a thousand a second."""
    with tempfile.TemporaryDirectory(prefix="tramstream-", dir="/tmp") as name:
        folder = Path(name)
        clock = VehicleClock.shared(folder)
        router = ZenohBus.route(folder, clock)
        other = subprocess.Popen([sys.executable, "-c", ECHO, name], stdin=subprocess.PIPE)
        bus = ZenohBus.connect(folder, clock)
        ring: Ring[Envelope] = Ring(100)
        try:
            bus.subscribe(PONG, lambda envelope: ring.put("", envelope))
            times = _ping(bus, ring)
        finally:
            other.communicate(b"", timeout=10)
            bus.close()
            router.close()
    return [
        Figure("bus_round_trip_p50_ms", float(np.percentile(times, 50))),
        Figure("bus_round_trip_p99_ms", float(np.percentile(times, 99))),
    ]


def _ping(bus: ZenohBus, ring: Ring[Envelope]) -> list[float]:
    payload = bytes(400)
    deadline_s = time.monotonic() + 20.0
    while ring.get(0.05) is None and time.monotonic() < deadline_s:
        bus.publish(PING, payload, "bytes", 1)  # until the other side has subscribed
    while ring.get(0.2) is not None:
        pass
    times = []
    for sequence in range(PINGS):
        begin = time.perf_counter()
        bus.publish(PING, payload, "bytes", sequence + 1)
        if ring.get(1.0) is not None:
            times.append(1e3 * (time.perf_counter() - begin))
        time.sleep(0.001)
    return times


def live_pipeline(duration_s: float) -> list[Figure]:
    """The demo's vehicle for `duration_s` after warming up, then its record reprocessed."""
    compilation.ensure(say)  # not within the measurement
    with tempfile.TemporaryDirectory(prefix="tramstream-", dir="/tmp") as name:
        folder = Path(name)
        config = folder / "bench.toml"
        config.write_text(configuration(folder, seed=1))
        with own_disk(folder / "records") as written:
            usage = _measure(config, duration_s, written)
            (found,) = (folder / "records").glob("*.mcap")
            path = Path(shutil.copy(found, folder / "live.mcap"))
        with open_record(path) as record:
            latency = _latency(record)
        again = reprocessing(path, folder / "again.mcap")
    cpu = dict(usage.cpu_percent)
    simulators = cpu.pop("simulators")
    rss_mb = sum(usage.rss_mb[name] for name in cpu)
    pss_mb = sum(usage.pss_mb[name] for name in cpu)
    others = sorted(set(cpu) - {"recorder"})
    return [
        *(
            Figure(f"live_{name}_core_percent", cpu[name], CORE_PERCENT.get(name), False)
            for name in others
        ),
        Figure("live_recorder_core_percent", cpu["recorder"], 5.0, False),
        Figure("live_pipeline_core_percent", sum(cpu.values()), 25.0, False),
        Figure("live_pipeline_pss_mb", pss_mb, 200.0, False),
        Figure("live_pipeline_rss_sum_mb", rss_mb),
        Figure("live_simulators_core_percent", simulators),
        *usage.writing,
        *latency,
        *again,
    ]


def reprocessing(path: Path, out: Path) -> list[Figure]:
    """The record `path` reprocessed: held to the live outputs, and without that for the time.

    A step is 10 ms of the ride. Reading, decoding, processors, encoding, writing and syncing are in
    it; the start of the program is not. Processor time is that of all processes together.
    """

    def run(check: bool) -> Rerun:
        out.unlink(missing_ok=True)
        return rerun(path, out, None, check=check)

    checked = run(check=True)
    checked_s = median_s(lambda: run(check=True))
    begin_s = _own_cpu_s()
    elapsed_s = median_s(lambda: run(check=False))
    cpu_s = (_own_cpu_s() - begin_s) / (REPEATS + 1)
    steps = STEPS_HZ * checked.duration_s
    return [
        Figure("reprocess_times_real_time", checked.duration_s / checked_s, 100.0),
        Figure("reprocess_us_per_step", 1e6 * elapsed_s / steps, 50.0, False),
        Figure("reprocess_cpu_us_per_step", 1e6 * cpu_s / steps),
        Figure("reprocess_identical", float(checked.identical), 1.0),
    ]


def _own_cpu_s() -> float:
    """Processor time of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _measure(config: Path, duration_s: float, written: Written) -> _Usage:
    """Run the vehicle as a user would, and watch its processes."""
    command = [sys.executable, "-m", "tramstream.cli.main", "run", str(config)]
    program = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        while not written().file_bytes and program.poll() is None:
            time.sleep(0.1)
        time.sleep(WARM_UP_S)
        usage = _Usage(program.pid)
        before = written()
        time.sleep(duration_s)
        usage.end()
        usage.writing = written().since(before)
    finally:
        program.send_signal(signal.SIGINT)
        program.wait(END_S)
    return usage


def _latency(record: Record) -> list[Figure]:
    """From the newest inertial sample to what is published of it; from its window's centre too.

    And from the receiver's first valid fix to the first state.
    """
    figures = []
    for name, key, goal_ms in (("sync", keys.SYNC_IMU, 20.0), ("state", keys.EST_NOW, 15.0)):
        topic = key.on(record.vehicle)
        start_ns = record.start_ns + int(WARM_UP_S * S)
        entries = record.messages(topic.__eq__, start_ns)
        made: list[tuple[int, Any]] = [(each.publish_ns, record.decode(each)) for each in entries]
        after_centre = np.array([publish_ns - mean.stamp_ns for publish_ns, mean in made]) / 1e6
        after_newest = after_centre - 500.0 / STEPS_HZ
        figures += [
            Figure(f"imu_to_{name}_p50_ms", float(np.percentile(after_newest, 50)), goal_ms, False),
            Figure(f"imu_to_{name}_p99_ms", float(np.percentile(after_newest, 99)), goal_ms, False),
            Figure(f"imu_centre_to_{name}_p99_ms", float(np.percentile(after_centre, 99))),
        ]
    fixes = record.messages(keys.GNSS_FIX.on(record.vehicle).__eq__)
    fix_ns = next(entry.publish_ns for entry in fixes if record.decode(entry).valid)
    states = record.messages(keys.EST_STATE.on(record.vehicle).__eq__)
    waited_s = (next(entry.publish_ns for entry in states) - fix_ns) / S
    return [*figures, Figure("fix_to_first_state_s", waited_s, 5.0, False)]


class _Usage:
    """Processor time and memory of a program and all below it, from /proc, by role."""

    def __init__(self, root: int) -> None:
        self._root = root
        self._begin_s = time.monotonic()
        self._before = {pid: processes.cpu_s(pid) for pid in processes.tree(root)}
        self.cpu_percent: dict[str, float] = {}
        self.rss_mb: dict[str, float] = {}
        self.pss_mb: dict[str, float] = {}
        self.writing: list[Figure] = []

    def end(self) -> None:
        """Take the second reading."""
        elapsed_s = time.monotonic() - self._begin_s
        for pid in processes.tree(self._root):
            role = processes.role(pid, self._root)
            used_s = processes.cpu_s(pid) - self._before.get(pid, 0.0)
            memory = processes.memory_mb(pid)
            for table, value in (
                (self.cpu_percent, 100.0 * used_s / elapsed_s),
                (self.rss_mb, memory["Rss"]),
                (self.pss_mb, memory["Pss"]),
            ):
                table[role] = table.get(role, 0.0) + value
