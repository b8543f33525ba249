"""A ride whose recorder stood still and was killed: nothing is missing, and it is repeated."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from live import short_folder, tramstream, until
from test_pipeline import Running

from tramstream import keys
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.recorder.describe import describe
from tramstream.recorder.reader import open_record

pytestmark = pytest.mark.live

HALT_S = 3.0
"""Shorter than a supervisor lets pass before it replaces a node."""


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as path:
        yield path


def size(folder: Path) -> int:
    """Of all records; one may get its last name while they are counted."""
    found = 0
    for path in (folder / "records").glob("*.mcap*"):
        with suppress(FileNotFoundError):
            found += path.stat().st_size
    return found


def grow(folder: Path, by: int) -> None:
    before = size(folder)
    until(lambda: size(folder) > before + by, "more record")


def test_ride_whose_recorder_stood_still_and_was_killed_is_whole_and_repeated(
    folder: Path, tmp_path: Path
) -> None:
    config = folder / "ride.toml"
    config.write_text(configuration(folder, seed=3))
    run = Running(config, folder)
    try:
        until(lambda: run.node("processors"), "the processors")
        grow(folder, 200_000)
        recorder = run.node("recorder")
        os.kill(recorder, signal.SIGSTOP)
        time.sleep(HALT_S)
        os.kill(recorder, signal.SIGCONT)
        grow(folder, 200_000)
        killed = run.node("recorder")
        os.kill(killed, signal.SIGKILL)
        until(lambda: run.node("recorder") not in (0, killed), "a new recorder")
        grow(folder, 600_000)  # whoever ends takes what is only in its memory with it
        run.end()
    finally:
        if run.process.poll() is None:
            run.process.kill()
            run.process.wait()
    with open_record(folder / "records") as record:
        assert len(record.paths) == 2
        found = describe(record)
        ours = [each for each in found.channels if not each.path.startswith("health/recorder/")]
        assert {each.path: each.missing for each in ours if each.missing or each.restarts} == {}
        assert keys.LOSS.at("recorder").path not in {each.path for each in found.channels}
    text = tramstream(
        *("reprocess", str(folder / "records"), "-o", str(tmp_path / "r.mcap")),
        *("--check", "--json"),
    )
    figures = json.loads(text)
    assert figures["identical"]
    assert figures["inputs_missing"] == {}
    assert figures["sessions"] == 1
    assert figures["compared"] > 1000
