"""`tramstream calibrate`: what it says of a ride that tells nothing, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rides import altered, laid
from typer.testing import CliRunner, Result

from tramstream.analysis.fleet.table import read
from tramstream.analysis.notebook.rides import simulate
from tramstream.cli.main import make_app
from tramstream.errors import CheckFailedError, ConfigError, RecordError
from tramstream.simulation import scenario


def calibrate(*arguments: object) -> Result:
    """Run the verb in this process."""
    return CliRunner().invoke(make_app("calibrate"), ["calibrate", *map(str, arguments)])


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve seconds at the first stop."""
    city = scenario.load("city")
    chosen = altered(city, imu={"rate_hz": 100.0, "batch": 1}, resampler=None)
    path = tmp_path_factory.mktemp("standing") / "standing.mcap"
    simulate(chosen, line=laid("| 200 |"), seed=1, duration_s=12.0, out=path).close()
    return path


def test_ride_without_motion_has_a_verdict_in_print_json_and_table(
    standing: Path, tmp_path: Path
) -> None:
    table, page, out = tmp_path / "t.parquet", tmp_path / "p.html", tmp_path / "c.toml"
    result = calibrate(standing, "--json", "--table", table, "--page", page, "-o", out)
    assert isinstance(result.exception, CheckFailedError)
    assert "too little motion" in str(result.exception)
    told = json.loads(result.stdout)
    (ride,) = told["rides"]
    assert ride["figures"] == {}
    assert "too little motion" in ride["verdict"]
    assert told["vehicles"] == []
    assert not out.exists()
    assert "too little motion" in page.read_text()
    (row,) = read(table)
    assert "too little motion" in row.verdict


def test_record_that_is_none_is_named_and_the_others_are_worked_on(
    standing: Path, tmp_path: Path
) -> None:
    strange = tmp_path / "strange.mcap"
    strange.write_text("torn")
    result = calibrate(strange, standing, "--workers", 1)
    assert isinstance(result.exception, CheckFailedError)
    assert "strange.mcap: left out" in result.stderr
    assert "no figures: too little motion" in result.stdout


def test_nothing_is_overwritten_silently(standing: Path, tmp_path: Path) -> None:
    page = tmp_path / "p.html"
    page.write_text("mine")
    assert isinstance(calibrate(standing, "--page", page).exception, ConfigError)
    assert page.read_text() == "mine"


def test_name_that_means_no_record_is_refused(tmp_path: Path) -> None:
    assert isinstance(calibrate(tmp_path / "none.mcap").exception, RecordError)
