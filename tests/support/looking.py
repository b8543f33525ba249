"""What the tests of the looking verbs share: small records, a busy bus, the verbs' whole answer."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from live import command, environment, finished, short_folder

from tramstream import keys
from tramstream.cli.main import main
from tramstream.clock import S, VehicleClock
from tramstream.keys import Key
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.file.writer import RecordFile
from tramstream.transport.bus import Envelope, ZenohBus

VEHICLE = "4711"
START_NS = 1_790_000_000 * S


def tramstream(
    *arguments: object, runtime_dir: Path | None = None, **more: str
) -> subprocess.CompletedProcess[str]:
    """Run the command line to its end, whatever its status.

    With a runtime folder, where a bus may be, in a process of its own; else in this one, for a
    process takes a second to begin.
    """
    if runtime_dir is not None:
        return finished(command(*arguments), env=environment(runtime_dir, **more))
    words = ["tramstream", *map(str, arguments)]
    out, errors = (io.TextIOWrapper(io.BytesIO(), write_through=True) for _ in range(2))
    with (
        patch.dict(os.environ, environment(Path("/nonexistent"), **more)),
        patch.object(sys, "argv", words),
        redirect_stdout(out),
        redirect_stderr(errors),
    ):
        try:
            main()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
    texts = [stream.buffer.getvalue().decode() for stream in (out, errors)]
    return subprocess.CompletedProcess(words, status, *texts)


def fix(number: int, stamp_ns: int = START_NS) -> GnssFix:
    return GnssFix(
        stamp_ns=stamp_ns, sequence=number, source="NAV-PVT", latitude_deg=50 + number / 1000
    )


def envelope(
    key: Key,
    message,
    arrival_ns: int,
    sequence: int = 1,
    session: int = 1,
    publish_ns: int = 0,
    vehicle: str = VEHICLE,
) -> Envelope:
    payload = message if isinstance(message, bytes) else message.SerializeToString()
    published = publish_ns or arrival_ns
    topic = key.on(vehicle)
    return Envelope(topic, payload, key.encoding, published, sequence, session, arrival_ns)


def write_fixes(path: Path, numbers: list[int], period_ns: int = S // 5) -> Path:
    """A record of fixes with these sequence numbers; the numbers give the arrivals."""
    with RecordFile(path, VEHICLE) as record:
        for number in numbers:
            arrival_ns = START_NS + number * period_ns
            topic = keys.GNSS_FIX.on(VEHICLE)
            payload = fix(number, arrival_ns).SerializeToString()
            record.append(topic, keys.GNSS_FIX, payload, arrival_ns, arrival_ns, number)
    return path


@contextmanager
def busy_bus() -> Iterator[Path]:
    """A router with one node that publishes a fix and a heartbeat again and again."""
    with short_folder() as folder:
        bus = ZenohBus.route(folder, VehicleClock.shared(folder))
        bus.announce(keys.alive(VEHICLE, "gnss"))
        stop = threading.Event()

        def publish() -> None:
            beat = keys.HEARTBEAT.at("gnss")
            number = 0
            while not stop.wait(0.02):
                number += 1
                now_ns = bus.clock.now_ns()
                health = NodeHealth(
                    stamp_ns=now_ns, sequence=number, node="gnss", pid=7, uptime_s=number, cpu_s=1
                )
                for key, message in ((keys.GNSS_FIX, fix(number, now_ns)), (beat, health)):
                    payload = message.SerializeToString()
                    bus.publish(key.on(VEHICLE), payload, key.encoding, number)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield folder
        finally:
            stop.set()
            thread.join()
            bus.close()
