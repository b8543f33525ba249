"""`tramstream reprocess --smooth`: what it adds, where it stands in the record, what is refused."""

from __future__ import annotations

import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner, Result

from tramstream import keys
from tramstream.analysis.evaluate import record as judging
from tramstream.analysis.evaluate.contradiction import Contradiction
from tramstream.analysis.evaluate.record import contradictions_in
from tramstream.cli.main import make_app
from tramstream.clock import S
from tramstream.errors import CheckFailedError, ConfigError
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import rerun, vehicle_of

DURATION_S = 60
AFTER = 10
"""Of the last states, after the inertial sensor has ended, some are further apart."""
PATH = keys.EST_SMOOTHED.path


def tramstream(verb: str, *arguments: object) -> Result:
    """Run a verb in this process; what it refuses is raised."""
    result = CliRunner().invoke(make_app(verb), [verb, *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    tramstream("simulate", "--scenario", "kaspar2023", "--duration-s", DURATION_S, "-o", path)
    return path


@pytest.fixture(scope="module")
def smoothed(ride: Path) -> tuple[Path, dict[str, Any]]:
    """The record with what a smoother says, and the figures of the run."""
    out = ride.with_name("smoothed.mcap")
    return out, json.loads(tramstream("reprocess", ride, "-o", out, "--smooth", "--json").stdout)


def by_path(path: Path) -> dict[str, list[tuple[int, int, bytes]]]:
    """Log time, sequence and payload of all messages, in the reader's order."""
    found = defaultdict(list)
    last_ns = 0
    with open_record(path) as record:
        for entry in record.messages():
            assert entry.log_ns >= last_ns
            last_ns = entry.log_ns
            payload = (entry.log_ns, entry.sequence, entry.payload)
            found[keys.split(entry.topic)[1]].append(payload)
    return found


def test_smoothed_states_stand_in_the_record_at_their_time(
    smoothed: tuple[Path, dict[str, Any]],
) -> None:
    out, figures = smoothed
    messages = by_path(out)[PATH]
    assert figures["smoothed"] == len(messages) > 10 * (DURATION_S - 20)
    assert [sequence for _, sequence, _ in messages] == list(range(1, len(messages) + 1))
    for log_ns, sequence, payload in messages:
        state = keys.EST_SMOOTHED.type.FromString(payload)
        assert (state.stamp_ns, state.sequence) == (log_ns, sequence)
        assert state.protection_along_m > 0.0
    steps_ns = {b[0] - a[0] for a, b in pairwise(messages[1:-AFTER])}
    assert steps_ns == {S // 10}


def test_all_else_is_as_without(ride: Path, smoothed: tuple[Path, dict[str, Any]]) -> None:
    out = ride.with_name("plain.mcap")
    figures = json.loads(tramstream("reprocess", ride, "-o", out, "--json").stdout)
    assert figures["smoothed"] == 0
    plain, with_smoother = by_path(out), by_path(smoothed[0])
    assert set(with_smoother) - set(plain) == {PATH}
    for path, messages in plain.items():
        assert with_smoother[path] == messages, path


def test_evaluation_judges_filter_and_smoother_side_by_side(
    smoothed: tuple[Path, dict[str, Any]],
) -> None:
    figures = json.loads(tramstream("evaluate", smoothed[0], "--json").stdout)
    assert figures["smoothed_speed_rms_mps"] < figures["speed_rms_mps"]


def test_filter_that_is_right_is_not_contradicted(ride: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.mcap"
    figures = json.loads(tramstream("reprocess", ride, "-o", out, "--judge", "--json").stdout)
    assert (figures["contradicted"], figures["contradictions"]) == (False, [])


def test_filter_that_is_told_a_wrong_wheel_is_contradicted_with_and_without_truth(
    ride: Path, tmp_path: Path
) -> None:
    with open_record(ride) as record:
        vehicle = vehicle_of(record, ride)
    wheels = replace(vehicle.wheels, m_per_pulse=1.3 * vehicle.wheels.m_per_pulse, scale_std=1e-4)
    wrong = tmp_path / "wrong.mcap"
    rerun(ride, wrong, replace(vehicle, wheels=wheels))
    without_truth = {each.figure for each in contradictions_in(wrong)}
    assert any(figure.startswith("nis_wheel") for figure in without_truth)
    wrong.rename(ride.with_name(wrong.name))
    with_truth = contradictions_in(ride.with_name(wrong.name))
    assert with_truth[0].figure in ("protection_exceeded_share", "nees_joint_mean")


def test_record_that_is_contradicted_ends_with_the_check_that_failed(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = Contradiction("nees_joint_mean", 16.7, 7.9, "NEES is 16.7", "fixes", "gnss")
    monkeypatch.setattr(judging, "contradictions_in", lambda out: [wrong])
    with pytest.raises(CheckFailedError, match="nees_joint_mean") as failed:
        tramstream("reprocess", ride, "-o", tmp_path / "o.mcap", "--judge")
    assert failed.value.exit_status == 1


def test_model_without_a_smoother_is_refused(ride: Path, tmp_path: Path) -> None:
    config = tmp_path / "vehicle.toml"
    config.write_text(
        'vehicle = "simulated"\n[imu]\ndevice = "none"\n[ekf]\nmodel = "kaspar2023"\n'
    )
    with pytest.raises(ConfigError, match="kaspar2023 has no smoother"):
        tramstream("reprocess", ride, "-o", tmp_path / "o.mcap", "--smooth", "--config", config)
    assert not list(tmp_path.glob("o.mcap*"))


def test_map_that_is_not_there_is_told(ride: Path, tmp_path: Path) -> None:
    """The vehicle's file is seldom where records are looked at."""
    config = tmp_path / "vehicle.toml"
    config.write_text(
        'vehicle = "simulated"\n[imu]\ndevice = "none"\n[map]\nnetwork = "no.tracks"\n'
    )
    out = tmp_path / "o.mcap"
    result = tramstream("reprocess", ride, "-o", out, "--config", config, "--json")
    (sentence,) = [line for line in result.stderr.splitlines() if line.startswith("$.map.network")]
    assert sentence.startswith(f"$.map.network: {tmp_path / 'no.tracks'}: cannot be read")
    assert "went on without the map" in sentence
    figures = json.loads(result.stdout)
    assert "$.map: absent in the record, a section now" in figures["settings_changed"]
    assert "  $.map: absent in the record, a section now" in result.stderr.splitlines()
    assert json.loads(result.stdout)["outputs"] > 0
    assert keys.EST_STATE.path in by_path(out)
