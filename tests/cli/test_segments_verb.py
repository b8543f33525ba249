"""`tramstream segments` and `learn-line`, on a record of a simulated ride's frames."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import report_samples
from looking import tramstream

from tramstream import config_file, keys
from tramstream.analysis.segments.rides import Ridden, World, frames, ridden
from tramstream.tracks import signature, signature_file

RIDE_S = 160.0
"""Three stops."""


@pytest.fixture(scope="module")
def ride() -> Ridden:
    return ridden(World(), 1, duration_s=RIDE_S)


@pytest.fixture(scope="module")
def record(ride: Ridden, tmp_path_factory: pytest.TempPathFactory) -> Path:
    def rows() -> Iterator[report_samples.Sample]:
        for each in frames(ride.simulation):
            yield report_samples.Sample(keys.SYNC_FRAME, each.stamp_ns, each.message)

    text = config_file.to_json(ride.simulation.vehicle)
    path = tmp_path_factory.mktemp("segments") / "ride.mcap"
    return report_samples.write(path, rows(), metadata={config_file.RECORD_ENTRY: text})


def test_sections_are_those_of_the_ride(ride: Ridden, record: Path, tmp_path: Path) -> None:
    """Dwell, way and travel between the stops, and how the driver drove, against the plan."""
    line = tmp_path / "line.signature"
    signature_file.save(signature.of_line(ride.simulation.line, "7"), line)
    out = tmp_path / "ride.parquet"
    ended = tramstream("segments", record, "--line", line, "--parquet", out, "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    first, second = told["sections"][:2]
    dwells = ride.simulation.ride.dwells_s
    limits = ride.simulation.scenario.driver
    assert first["dwell_s"] == pytest.approx(dwells[1, 1] - dwells[1, 0], abs=1.0)
    assert first["doors"]
    for k, each in enumerate((first, second)):
        way = float(np.diff(ride.simulation.line.stops_m)[k])
        assert each["way_m"] == pytest.approx(way, abs=0.5)
        assert each["travel_s"] == pytest.approx(dwells[k + 1, 0] - dwells[k, 1], abs=1.0)
        assert each["most_braking_mps2"] == pytest.approx(limits.acceleration_mps2, abs=0.15)
        assert each["most_lateral_mps2"] < limits.lateral_mps2 + 0.3
        assert each["traction_kwh"] > 0.05
    assert second["end"] == "stop 3"
    assert out.exists()
    again = tramstream("segments", record, "--parquet", out)
    assert again.returncode == 2
    assert "--overwrite" in again.stderr


def test_table_is_readable(record: Path) -> None:
    ended = tramstream("segments", record)
    assert ended.returncode == 0, ended.stderr
    assert "dwell s" in ended.stdout


def test_record_without_frames_is_refused_with_the_cure(ride: Ridden, tmp_path: Path) -> None:
    text = config_file.to_json(ride.simulation.vehicle)
    path = tmp_path / "empty.mcap"
    report_samples.write(path, metadata={config_file.RECORD_ENTRY: text})
    ended = tramstream("segments", path)
    assert ended.returncode in (1, 2)
    assert "reprocess" in ended.stderr


def test_line_is_learned_and_never_replaced_silently(record: Path, tmp_path: Path) -> None:
    out = tmp_path / "line.signature"
    ended = tramstream("learn-line", record, "-o", out, "--line", "7", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["rides"] == 1
    assert told["stops"] >= 3
    assert signature_file.load(out).name == "7/0"
    again = tramstream("learn-line", record, "-o", out)
    assert again.returncode == 2
    assert "--overwrite" in again.stderr


def test_no_verb_writes_over_the_record_that_it_reads(tmp_path: Path) -> None:
    record = tmp_path / "ride.mcap"
    record.write_bytes(b"a ride")
    for verb in (("segments", record, "--parquet", record), ("learn-line", record, "-o", record)):
        done = tramstream(*verb, "--overwrite")
        assert done.returncode == 2, done.stderr
        assert "is what would be read" in done.stderr
    assert record.read_bytes() == b"a ride"
