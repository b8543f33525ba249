"""A ride on a computer with six busy processes a core: late readings are no slip of a wheel."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live import tramstream

from tramstream import keys
from tramstream.bridges.odometer.bridge import NOTE_LATE
from tramstream.clock import S
from tramstream.recorder.reader import open_record

LEARNED_S = 10.0
"""The period is known after two seconds; whoever slipped in them is used again by then."""
WHEEL_RATE_HZ = 50.0


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes beside us that do nothing but compute, ten minutes at most."""
    spinning = [
        subprocess.Popen(["timeout", "600", sys.executable, "-c", "while True: pass"])
        for _ in range(processes)
    ]
    try:
        yield
    finally:
        for each in spinning:
            each.kill()
            each.wait()


@pytest.mark.live
@pytest.mark.study
def test_no_wheel_reading_is_refused_for_lateness_on_a_busy_computer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`pytest -m study tests/test_pipeline_busy.py`; prints what was read late, and how late."""
    path = tmp_path / "d.mcap"
    with busy(6 * (os.cpu_count() or 1)):
        out = tramstream(
            *("demo", "--duration-s", "60", "--headless", "--json"), *("--out", str(path))
        )
    figures = json.loads(out)
    used, refused, late, stamps = 0, 0, 0, []
    device = None
    with open_record(path) as record:
        for each in record.messages():
            key = keys.split(each.topic)[1]
            if key == keys.ODO_WHEELS.path:
                stamps.append(record.decode(each).stamp_ns)
            elif key == keys.EST_STATE.path:
                state = record.decode(each)
                if not stamps or state.stamp_ns - stamps[0] < LEARNED_S * S:
                    continue
                wheels = [i for i in state.innovations if i.measurement.startswith("wheel")]
                used += sum(innovation.accepted for innovation in wheels)
                refused += sum(not innovation.accepted for innovation in wheels)
            elif key == keys.SYNC_LATE.path:
                late += record.decode(each).key == keys.ODO_WHEELS.path
            elif key == keys.DEVICE.at("odometer").path:
                device = record.decode(each)
    assert device is not None
    notes = dict(device.rejected_by_reason)
    with capsys.disabled():
        print(f"wheels: {used} used, {refused} refused, {late} late; {notes}; {figures['overrun']}")
    assert notes[NOTE_LATE] > 0
    assert (refused, late) == (0, 0)
    assert used > 2 * 0.9 * WHEEL_RATE_HZ * (60.0 - LEARNED_S) * 0.8  # it stands now and then
    assert len(stamps) > 0.99 * WHEEL_RATE_HZ * 60.0
