"""`tramstream simulate`: the record, what is printed, and what is refused."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from tramstream import config, config_file, keys
from tramstream.cli.main import make_app
from tramstream.errors import ConfigError, RecordError
from tramstream.lines.line import built_in_line
from tramstream.recorder.reader import open_record
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation


@pytest.fixture(autouse=True)
def stop(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """The event that Ctrl-C would set; the tests' own process keeps its signal handlers."""
    event = threading.Event()
    monkeypatch.setattr("tramstream.cli.terminal.session.stop_on_signals", lambda: event)
    return event


def simulate(*arguments: object) -> Result:
    """Run the verb in this process; what it refuses is raised."""
    command = ["simulate", *map(str, arguments)]
    result = CliRunner().invoke(make_app("simulate"), command)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_record_holds_the_ride_and_its_configuration(tmp_path: Path) -> None:
    out = tmp_path / "ride.mcap"
    result = simulate("--seed", 3, "--duration-s", 20, "-o", out, "--json")
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["scenario"] == "city"
    assert told["seed"] == 3
    assert told["stops"] == 27
    simulation = Simulation(built_in_line(), scenario.load("city"), 3, 20.0)
    expected = {
        (sample.key.path, sample.sequence): sample.message.SerializeToString()
        for sample in simulation.samples()
    }
    counts: dict[str, int] = {}
    with open_record(out) as record:
        for entry in record.messages():
            path = keys.split(entry.topic)[1]
            counts[path] = counts.get(path, 0) + 1
            if path != keys.GNSS_LOCATION.path:
                assert entry.payload == expected.pop((path, entry.sequence))
        kept = record.metadata
    assert not expected
    assert counts == told["messages"]
    vehicle = msgspec.json.decode(kept[config_file.RECORD_ENTRY].encode(), type=config.Vehicle)
    assert vehicle == simulation.vehicle
    assert kept["simulation.scenario"] == "city"


def test_locations_for_viewers_lie_where_the_valid_fixes_are(tmp_path: Path) -> None:
    out = tmp_path / "ride.mcap"
    events = tmp_path / "tunnel.toml"
    events.write_text(
        '[gnss]\nrate_hz = 2.0\n[[events]]\nkind = "tunnel"\nstart_s = 5.0\nduration_s = 5.0\n'
    )
    simulate("--scenario", events, "--duration-s", 20, "-o", out)
    with open_record(out) as record:
        fixes = [record.decode(e) for e in record.messages(lambda t: t.endswith("gnss/fix"))]
        spots = [record.decode(e) for e in record.messages(lambda t: t.endswith("gnss/location"))]
    valid = [fix for fix in fixes if fix.valid]
    assert len(valid) < len(fixes)
    np.testing.assert_array_equal(
        [spot.latitude for spot in spots], [fix.latitude_deg for fix in valid]
    )


def test_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    records = [tmp_path / name for name in ("a.mcap", "b.mcap", "c.mcap")]
    for out, seed in zip(records, (1, 1, 2), strict=True):
        simulate("--scenario", "kaspar2023", "--seed", seed, "--duration-s", 30, "-o", out)
    first, again, other = (out.read_bytes() for out in records)
    assert first == again
    assert first != other


def test_line_of_a_file_is_driven_along(tmp_path: Path) -> None:
    coordinates = [[14.45, 50.08], [14.46, 50.08], [14.466, 50.083]]
    path = tmp_path / "line.geojson"
    path.write_text(json.dumps({"type": "LineString", "coordinates": coordinates}))
    out = tmp_path / "ride.mcap"
    result = simulate("--line", path, "--scenario", "konecny2004", "-o", out)
    assert "1.2" in result.stdout  # km
    with open_record(out) as record:
        entries = record.messages(lambda t: t.endswith("truth/state"))
        last: Any = [record.decode(entry) for entry in entries][-1]
    assert last.standing
    assert last.latitude_deg == pytest.approx(50.083, abs=2e-5)
    assert last.longitude_deg == pytest.approx(14.466, abs=2e-5)


def test_interrupted_simulation_leaves_a_whole_record(
    tmp_path: Path, stop: threading.Event
) -> None:
    stop.set()
    out = tmp_path / "ride.mcap"
    result = simulate("--scenario", "kaspar2023", "-o", out, "--json")
    assert result.exit_code == 0
    assert "interrupted" in result.stderr
    with open_record(out) as record:
        assert sum(1 for _ in record.messages()) == sum(
            json.loads(result.stdout)["messages"].values()
        )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--scenario", "town"), "give a file or one of chladek2023, city"),
        (("--line", "nowhere.geojson"), "cannot be read"),
    ],
)
def test_unknown_scenario_or_line_is_refused(
    arguments: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    out = tmp_path / "ride.mcap"
    with pytest.raises(ConfigError, match=says):
        simulate(*arguments, "-o", out)
    assert not list(tmp_path.iterdir())


def test_record_that_exists_is_not_overwritten_unless_told(tmp_path: Path) -> None:
    out = tmp_path / "ride.mcap"
    out.write_bytes(b"precious")
    short = ("--scenario", "konecny2004", "--duration-s", 5, "-o", out)
    with pytest.raises(RecordError, match="exists already"):
        simulate(*short)
    assert out.read_bytes() == b"precious"
    assert simulate(*short, "--overwrite").exit_code == 0
    scenario_file = tmp_path / "mine.toml"
    scenario_file.write_text("[gnss]\n")
    with pytest.raises(ConfigError, match="what would be read"):
        simulate("--scenario", scenario_file, "-o", scenario_file, "--overwrite")
