"""Every position that gpsd reports of a captured receiver is one of ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from receivers import START_NS, sentences, solution
from typer.testing import CliRunner

from tramstream.analysis.studies import receivers as study
from tramstream.cli.main import make_app
from tramstream.clock import S
from tramstream.errors import ConfigError


def written(folder: Path, data: bytes, places: list[tuple[float, float]]) -> Path:
    """A capture, and what a gpsd of these places would report of it."""
    capture = folder / "made.log"
    capture.write_bytes(data)
    reports = [{"class": "TPV", "mode": 3, "lat": lat, "lon": lon} for lat, lon in places]
    lines = ["$GPGSA,A,1", '{"class":"TPV","mode":1}']
    lines += [json.dumps(report, separators=(",", ":")) for report in reports]
    (folder / "made.log.chk").write_text("\n".join(lines))
    return capture


def test_positions_of_each_protocol_are_found_and_others_are_missed(tmp_path: Path) -> None:
    data = b"".join(
        solution(START_NS + k * S, lat=50.0 + 1e-4 * k, lon=14.0)
        + sentences(START_NS + k * S, "GGA")
        for k in range(3)
    )
    ubx, nmea, other = (50.0001, 14.0), (50.0870001, 14.4212349), (50.0001, 14.000001)
    found = study.compare(written(tmp_path, data, [ubx, nmea, other, ubx]))
    assert found.positions == 3
    assert found.equal == {"NAV-PVT": 1, "NMEA": 1}
    assert found.missing == [other]
    assert not found.agrees
    assert found.fixes == 3


def test_command_counts_them(tmp_path: Path) -> None:
    written(tmp_path, solution(START_NS), [(50.0870001, 14.4212349), (1.0, 2.0)])
    result: Any = CliRunner().invoke(
        make_app(), ["reproduce", "receivers", "--data", str(tmp_path), "--json"]
    )
    figures = json.loads(result.stdout)
    assert (figures["positions"], figures["missing"]) == (2, 1)


def test_folder_without_captures_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=str(tmp_path)):
        study.captures(tmp_path)


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["ubx", "../failing"])
def test_every_position_of_gpsd_is_ours(data_dir: Path, folder: str) -> None:
    if not (data_dir / folder).is_dir():
        pytest.skip(f"no recordings at {data_dir / folder}")
    found = [study.compare(capture) for capture in study.captures(data_dir / folder)]
    assert [(each.capture, each.missing) for each in found if not each.agrees] == []
    assert sum(each.positions for each in found) >= 8
    assert sum(each.nearly for each in found) == 0
