"""`tramstream reproduce drives`: real drives, held to the project's demands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tramstream.analysis.studies import drives as study
from tramstream.cli.figures.reproduce_drives import rms_m
from tramstream.cli.main import make_app
from tramstream.errors import ConfigError

MAPPINGS = Path(__file__).resolve().parents[2] / "mappings"
RTK_RMS_M = 0.07
"""The goal; the limit is 0.09."""
OUTAGE_RMS_M = {15.0: 5.0, 30.0: 12.0, 60.0: 20.0}
SMARTLOC_RMS_M = 29.0
"""What the filter has, 27.4, with a margin. The demand, `CANYON_RMS_M`, is met by the smoother
only: docs/accuracy.md says why."""
CANYON_RMS_M = 20.0
PLACES = 6


def run(*arguments: str) -> Any:
    return CliRunner().invoke(make_app(), ["reproduce", "drives", *arguments])


def test_drives_that_are_not_there_are_told_before_the_work_begins(tmp_path: Path) -> None:
    result = run("--data", str(tmp_path), "--mappings", str(MAPPINGS), "--json")
    assert isinstance(result.exception, ConfigError)
    assert str(tmp_path) in str(result.exception)
    assert "--data" in str(result.exception)
    assert result.stdout == ""


@pytest.mark.realdata
def test_rtk_and_canyon_are_as_good_as_demanded_and_never_overconfident(data_dir: Path) -> None:
    found = {
        drive.name: study.whole(data_dir / "drives" / drive.folder, MAPPINGS / drive.mapping, print)
        for drive in study.DRIVES
    }
    rtkx, smartloc = found["rtkx"], found["smartloc"]
    assert rtkx["judged"] > 700
    assert rtkx["horizontal_rms_m"] < RTK_RMS_M
    assert smartloc["judged"] > 1300
    assert smartloc["horizontal_rms_m"] < SMARTLOC_RMS_M < smartloc["gnss_horizontal_rms_m"]
    assert smartloc["smoothed_horizontal_rms_m"] < CANYON_RMS_M
    for figures in (rtkx, smartloc):
        for prefix in ("", "smoothed_"):
            mean = figures[f"{prefix}nees_position_mean"]
            assert mean < figures[f"{prefix}nees_position_high"]
            assert figures[f"{prefix}protection_exceeded_share"] in (None, 0.0)


@pytest.mark.realdata
def test_outages_without_an_odometer_end_as_near_as_demanded(data_dir: Path) -> None:
    drive = study.DRIVES[0]
    data, mapping = data_dir / "drives" / drive.folder, MAPPINGS / drive.mapping
    cuts = study.outages(data, mapping, 0, 1)
    for duration_s, limit_m in OUTAGE_RMS_M.items():
        ends = [cut for cut in cuts if cut.duration_s == duration_s]
        assert len(ends) >= PLACES
        assert rms_m(cuts, duration_s) < limit_m
        # Squared errors over stated variances: 1 is right, less is caution.
        assert sum((cut.horizontal_m / cut.std_m) ** 2 for cut in ends) / len(ends) < 1.0


@pytest.mark.realdata
def test_a_branch_without_fixes_is_what_an_import_with_a_cut_gives(data_dir: Path) -> None:
    """One of the cuts, the way a user would make it."""
    drive = study.DRIVES[0]
    data, mapping = data_dir / "drives" / drive.folder, MAPPINGS / drive.mapping
    branch = next(cut for cut in study.outages(data, mapping, 0, 4) if cut.duration_s == 15.0)
    vehicle, frames, truth, level = study.frames_of(data, mapping, [(branch.start_s, 15.0)])
    filter_ = study.localiser(vehicle)
    end_ns = frames[0].stamp_ns + round((branch.start_s + 15.0) * study.S)
    states = [filter_.take(frame) for frame in frames if frame.stamp_ns < end_ns]
    known = [state for state in states if state is not None][-150:]
    assert filter_.level is not None
    (cut,) = study.judged([(15.0, known, filter_.level)], branch.start_s, truth, level)
    assert cut.along_m == pytest.approx(branch.along_m, abs=0.5)
    assert cut.across_m == pytest.approx(branch.across_m, abs=0.5)


def test_figures_are_printed_as_one_json_object(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tramstream.cli.figures import reproduce_drives as verb

    cut = study.Cut(start_s=70.0, duration_s=15.0, along_m=3.0, across_m=-4.0, std_m=6.0)
    figures = {"rtkx": {"horizontal_rms_m": 0.04, "nees_position_mean": None}}
    monkeypatch.setattr(verb, "_study", lambda data, mappings: (figures, [cut]))
    for drive in study.DRIVES:
        (tmp_path / drive.folder).mkdir()
    places = ("--data", str(tmp_path), "--mappings", str(MAPPINGS))
    found = json.loads(run(*places, "--json").stdout)
    assert found["outages"] == {"15": {"places": 1, "horizontal_rms_m": 5.0}}
    assert found["drives"] == figures
    text = run(*places).stdout
    assert "KF-GINS" in text
    assert "70 s: 3.0, -4.0 ± 6" in text
