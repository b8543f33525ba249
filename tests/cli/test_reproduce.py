"""`tramstream reproduce`: works by name, one JSON object, a line that cannot be used."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from live import HANG_S, command, finished
from networks import junctions
from typer.testing import CliRunner

from tramstream.analysis.studies.kaspar2023 import KINDS, WITH_MAP
from tramstream.cli import reproduce as verb
from tramstream.cli.main import make_app
from tramstream.errors import ConfigError

REPRODUCE = ("reproduce", "kaspar2023")


def run(*arguments: str) -> Any:
    return CliRunner().invoke(make_app(), ["reproduce", *arguments])


def test_unknown_work_is_told_with_those_there_are() -> None:
    result = run("newton1687")
    assert isinstance(result.exception, ConfigError)
    for name in verb.WORKS:
        assert name in str(result.exception)


def test_konecny2004_prints_one_json_object_for_a_seed() -> None:
    first, second = run("konecny2004", "--seed", "3", "--json"), run("konecny2004", "--json")
    figures, other = json.loads(first.stdout), json.loads(second.stdout)
    assert (figures["work"], figures["seed"], other["seed"]) == ("konecny2004", 3, 2004)
    assert figures["cases"] != other["cases"]


def test_line_that_is_not_there_is_told_before_the_rides_begin() -> None:
    result = run("kaspar2023", "--line", "nowhere.geojson", "--json")
    assert isinstance(result.exception, ConfigError)
    assert "nowhere.geojson" in str(result.exception)
    assert result.stdout == ""


def test_kind_of_rides_that_is_not_there_is_told_with_those_there_are() -> None:
    result = run("kaspar2023", "--kind", "three wheels", "--json")
    assert isinstance(result.exception, ConfigError)
    for kind in KINDS:
        assert kind in str(result.exception)


@pytest.mark.parametrize("line", ["nowhere.geojson", "lines.geojson#7/0"])
def test_chladek2023_says_which_file_of_lines_it_wants(line: str) -> None:
    result = run("chladek2023", "--line", line, "--json")
    assert isinstance(result.exception, ConfigError)
    assert line in str(result.exception)
    assert result.stdout == ""


def test_chladek2023_wants_as_many_rides_as_it_is_judged_by() -> None:
    result = run("chladek2023", "--line", "a.geojson", "--seeds", "3")
    assert isinstance(result.exception, ConfigError)
    assert "needs 10 at least" in str(result.exception)


def test_chladek2023_takes_one_file() -> None:
    result = run("chladek2023", "--line", "a.geojson", "--line", "b.geojson")
    assert isinstance(result.exception, ConfigError)
    assert "takes one --line" in str(result.exception)


@pytest.mark.live
def test_kaspar2023_prints_one_json_object_of_both_models() -> None:
    options = ("--seeds", "1", "--seed", "7", "--duration-s", "25", "--json")
    done = finished(command(*REPRODUCE, *options), check=True)
    figures = json.loads(done.stdout)
    assert figures["published"]["position_p90_m"] == 0.55
    assert figures["missing_rides"] == 0
    kinds = {(ride["model"], ride["kind"]) for ride in figures["rides"]}
    models = ("tram", "tram smoothed", "kaspar2023")
    expected = {(model, kind) for model in models for kind in KINDS}
    assert kinds == expected
    assert {ride["seed"] for ride in figures["rides"]} == {7}
    assert len(figures["overall"]) == len(expected)
    for total in figures["overall"]:
        if total["model"] == "tram smoothed":
            assert total["over_filter"]["position_p90_m"] > 0.0
            continue
        if total["kind"] in WITH_MAP:
            assert "bound" not in total
            continue
        ratio = total["position_p90_m"] / total["bound"]["position_p90_m"]
        assert total["over_bound"]["position_p90_m"] == pytest.approx(ratio)
    assert done.stderr.count(f"/{len(KINDS)}:") == len(KINDS)


def test_matching_wants_a_network_and_lines_that_it_has(tmp_path: Path) -> None:
    missing = run("matching", "--json")
    assert isinstance(missing.exception, ConfigError)
    assert "--net" in str(missing.exception)
    absent = run("matching", "--net", str(tmp_path / "no.net"))
    assert isinstance(absent.exception, ConfigError)
    path = tmp_path / "small.net"
    junctions().save(path)
    unknown = run("matching", "--net", str(path), "--line", "7", "--json")
    assert isinstance(unknown.exception, ConfigError)
    assert "it has 1/0" in str(unknown.exception)
    kind = run("matching", "--net", str(path), "--kind", "white")
    assert isinstance(kind.exception, ConfigError)
    assert "plain, slow, gyro" in str(kind.exception)


@pytest.mark.live
def test_matching_prints_one_json_object_of_lines_and_detours(tmp_path: Path) -> None:
    path = tmp_path / "small.net"
    junctions().save(path)
    options = ["--net", str(path), "--seeds", "2", "--detours", "1", "--duration-s", "15"]
    done = finished(command("reproduce", "matching", *options, "--json"), check=True)
    figures = json.loads(done.stdout)
    assert figures["missing_rides"] == 0
    assert [(ride["route"], ride["seed"]) for ride in figures["rides"]] == [
        ("1/0", 1), ("1/0", 2), ("detour", 1),
    ]  # fmt: skip
    assert [total["name"] for total in figures["overall"]] == ["1/0", "detour", "all"]
    whole = figures["overall"][-1]
    assert whole["right_track"]["total"] == sum(
        ride["right_track"]["total"] for ride in figures["rides"]
    )
    bins = whole["reliability"]["most_probable"]
    assert sum(each["points"] for each in bins) <= whole["right_track"]["total"]
    assert all(each["low"] <= each["stated"] <= each["high"] for each in bins)
    assert whole["nearest_to_fix"]["total"] > 0


@pytest.mark.live
def test_interrupted_rides_leave_what_was_done() -> None:
    arguments = command(*REPRODUCE, "--seeds", "20", "--duration-s", "25", "--json")
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        assert process.stdout is not None
        rides = 20 * len(KINDS)
        assert process.stderr.readline().startswith(f"1/{rides}")
        process.send_signal(signal.SIGINT)
        figures = json.loads(process.stdout.read())
        assert process.wait(HANG_S) == 0
    assert 0 < figures["missing_rides"] < rides
    assert len(figures["rides"]) == 3 * (rides - figures["missing_rides"])
