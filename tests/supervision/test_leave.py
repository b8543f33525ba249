"""A program ends with its status, whatever zenoh's threads are doing."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from live import finished, short_folder

pytestmark = pytest.mark.live

PROGRAM = """
import sys, threading, time
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.cli.main import leave
from tramstream.clock import VehicleClock

many = [{i: [i]} for i in range(100_000)]  # taking the interpreter down takes its time
bus = ZenohBus.route(Path(sys.argv[1]), VehicleClock())
came = threading.Event()

def deliver(envelope):
    came.set()
    while sys.argv[2] == "busy":
        time.sleep(0.001)

for number in range(30):
    bus.subscribe(f"a/{number}", deliver)
bus.publish("a/0", b"x", "text", 1)
came.wait()
print("said", end="")
bus.close()
leave(3)
"""


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as path:
        yield path


@pytest.mark.parametrize("callback", ["busy", "done"])
def test_program_ends_with_its_status_and_all_it_printed(folder: Path, callback: str) -> None:
    """Without `leave` the process hangs, or is aborted: "FATAL: exception not rethrown"."""
    done = finished([sys.executable, "-c", PROGRAM, str(folder), callback])
    assert done.returncode == 3, done.stderr
    assert done.stdout == "said"
    assert done.stderr == ""
