"""docs/wire.md: the program that reads the bus without tramstream, and who describes the types."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from live import HANG_S, command, environment, finished, short_folder, until
from looking import VEHICLE, busy_bus, write_fixes

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.transport.bus import Bus, LocalBus, ZenohBus
from tramstream.transport.descriptions import describe, tell

PAGE = Path(__file__).resolve().parent.parent / "docs" / "wire.md"
(PROGRAM,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_program_is_as_short_as_it_is_said_to_be_and_needs_no_tramstream() -> None:
    lines = [line for line in PROGRAM.splitlines() if line.strip()]
    assert len(lines) <= 22
    assert "import tramstream" not in PROGRAM


def first_line(folder: Path, key: str) -> str:
    """What the page's program prints first."""
    endpoint = f"unixsock-stream/{folder}/bus.sock"
    words = [sys.executable, "-c", PROGRAM, endpoint, key]
    reading = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert reading.stdout is not None
    try:
        return reading.stdout.readline()
    finally:
        reading.kill()
        reading.wait(HANG_S)
        reading.stdout.close()


def test_program_reads_a_bus_whose_types_somebody_tells() -> None:
    with busy_bus() as folder:
        bus = ZenohBus.connect(folder, VehicleClock.shared(folder))
        tell(bus, [GnssFix])
        topic, _, text = first_line(folder, "tram/*/raw/gnss/fix").partition(" ")
        bus.close()
    assert topic == keys.GNSS_FIX.on(VEHICLE)
    assert json.loads(text)["source"] == "NAV-PVT"


def test_replay_describes_the_types_of_its_record(tmp_path: Path) -> None:
    path = write_fixes(tmp_path / "a.mcap", list(range(1, 50)))
    with short_folder() as folder:
        there = environment(folder)
        playing = subprocess.Popen(command("replay", path, "--loop"), env=there)
        try:

            def read() -> bool:
                return finished(command("list", "--json"), env=there).returncode == 0

            until(read, "the replay's bus")
            assert "NAV-PVT" in first_line(folder, "tram/*/raw/gnss/fix")
        finally:
            playing.terminate()
            playing.wait(HANG_S)


@pytest.mark.parametrize("kind", ["local", "zenoh"])
def test_all_types_are_listed_under_their_own_keys(kind: str) -> None:
    with short_folder() as folder:
        clock = VehicleClock.shared(folder)
        bus: Bus = LocalBus(clock) if kind == "local" else ZenohBus.route(folder, clock)
        asker = bus if kind == "local" else ZenohBus.connect(folder, clock)
        tell(bus, keys.TYPES.values())
        until(lambda: len(asker.ask(keys.schema("**"))) == len(keys.TYPES), "all types")
        for name in keys.TYPES:
            found = describe(asker, name, tries=3).type
            assert found is not None
            assert found.DESCRIPTOR.full_name == name
        assert describe(asker, "tramstream.Nothing").type is None
        asker.close()
        bus.close()
