"""A processor of somebody else's package can do everything that one of ours can."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from installed import COMFORT, install, put_on_path
from live import HANG_S, command, environment, finished, short_folder, tramstream, until

from tramstream import config_file
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.errors import ConfigError
from tramstream.live import registry
from tramstream.recorder.reader import open_record

PUSH = "est/comfort/push"
LINES = 25
"""Of its code; blank ones are not counted, nor the sentence that explains its setting."""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    made = install(COMFORT, tmp_path / "site")
    put_on_path(made, monkeypatch)
    return made


def read_all(path: Path) -> list[tuple[str, int, int, bytes]]:
    with open_record(path) as record:
        return [(e.topic, e.log_ns, e.sequence, e.payload) for e in record.messages()]


def with_section(folder: Path, section: str, *more: str) -> bytes:
    return (configuration(folder, 7, more) + section).encode()


def test_it_is_short() -> None:
    lines = [line.strip() for line in (COMFORT / "comfort.py").read_text().splitlines()]
    assert sum(bool(line) and not line.startswith('"""') for line in lines) <= LINES


def test_what_is_installed_runs_only_where_the_configuration_names_it(
    site: Path, tmp_path: Path
) -> None:
    vehicle = config_file.parse(with_section(tmp_path, ""), "x.toml", tmp_path)
    assert "comfort" not in [each.name for each in registry.make_processors(vehicle)]
    vehicle = config_file.parse(with_section(tmp_path, "", "comfort"), "x.toml", tmp_path)
    *_, comfort = registry.make_processors(vehicle)
    assert comfort.name == "comfort"
    assert comfort.settings.limit_mps2 == 1.2


def test_its_section_is_checked_as_ours_are(site: Path, tmp_path: Path) -> None:
    good = with_section(tmp_path, "[comfort]\nlimit_mps2 = 0.8\n", "comfort")
    vehicle = config_file.parse(good, "x.toml", tmp_path)
    *_, comfort = registry.make_processors(vehicle)
    assert comfort.settings.limit_mps2 == 0.8
    at = r"\$\.comfort\.limit_mps"
    for section, said in (
        ("limit_mps = 0.8", rf"{at}: unknown field; did you mean limit_mps2"),
        ("limit_mps2 = 'much'", rf"Expected `float`, got `str` - at `{at}2`"),
        ("limit_mps2 = nan", rf"{at}2: nan is not a finite number"),
    ):
        text = with_section(tmp_path, f"[comfort]\n{section}\n", "comfort")
        with pytest.raises(ConfigError, match=said):
            config_file.parse(text, "x.toml", tmp_path)


def test_package_that_cannot_be_imported_is_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = install(COMFORT, tmp_path / "site")
    (site / "comfort.py").write_text("import no_such_module\n")
    put_on_path(site, monkeypatch)
    monkeypatch.delitem(sys.modules, "comfort", raising=False)
    said = "package tramstream-comfort cannot be loaded .ModuleNotFoundError: .*no_such_module"
    with pytest.raises(ConfigError, match=said):
        config_file.parse(with_section(tmp_path, "", "comfort"), "x.toml", tmp_path)


def test_processor_that_is_not_installed_is_refused_with_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\$\.processors\[5\]: no processor is called 'comfort'"):
        config_file.parse(with_section(tmp_path, "", "comfort"), "x.toml", tmp_path)
    with pytest.raises(ConfigError, match=r"\$\.comfort: unknown field"):
        config_file.parse(with_section(tmp_path, "[comfort]\n"), "x.toml", tmp_path)


@pytest.mark.live
def test_it_lives_in_demo_and_in_everything_that_looks_at_a_record(
    site: Path, tmp_path: Path
) -> None:
    out = tmp_path / "d.mcap"
    tramstream("demo", "--headless", "--duration-s", "12", "--add", "comfort", "--out", out)
    with open_record(out) as record:
        pushes = list(record.decoded(lambda topic: topic.endswith(PUSH)))
        assert len(pushes) > 10
        assert all(message.horizontal_mps2 > 0.0 for _, message in pushes)
        assert record.type_of(f"tram/demo/{PUSH}") == "comfort.Push"
    for cores in ("0", "0,1"):
        again = command("reprocess", out, "-o", tmp_path / f"on_{len(cores)}.mcap", "--check")
        done = finished(["taskset", "-c", cores, *again], check=True)
        assert done.stdout.startswith("identical: ")
    one, two = (read_all(tmp_path / f"on_{name}.mcap") for name in (1, 3))
    assert one == two
    # Without the package a reader still knows what the messages are: the record says it.
    bare = {**os.environ, "PYTHONPATH": ""}
    shown = tramstream("echo", PUSH, "--file", out, "--count", "1", env=bare)
    assert "horizontal_mps2" in shown
    listed = json.loads(tramstream("list", "--file", out, "--json", env=bare))
    assert {"key": PUSH, "type": "comfort.Push"}.items() <= next(
        row for row in listed["keys"] if row["key"] == PUSH
    ).items()
    tramstream("export", out, "--csv", tmp_path / "csv", env=bare)
    with next((tmp_path / "csv").glob("*comfort*push*.csv")).open() as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == len(pushes)
    assert float(rows[0]["horizontal_mps2"]) == pytest.approx(pushes[0][1].horizontal_mps2)
    page = tmp_path / "r.html"
    tramstream("report", out, "-o", page, env=bare)
    assert PUSH in page.read_text()


@pytest.mark.live
@pytest.mark.parametrize("separate", [False, True])
def test_it_lives_in_run_and_top_shows_it(site: Path, separate: bool) -> None:
    with short_folder() as folder:
        config = folder / "v.toml"
        text = configuration(folder, 7, ("comfort",))
        if separate:
            text = text.replace("\n\n", '\nseparate = ["comfort"]\n\n', 1)
        config.write_text(text + "\n[comfort]\nlimit_mps2 = 0.01\n")
        there = environment(folder / "run")
        running = subprocess.Popen(command("run", config), env=there)
        try:

            def row() -> dict[str, object]:
                done = finished(command("top", "--once", "--json"), env=there)
                keys = json.loads(done.stdout)["keys"] if done.returncode == 0 else []
                return next((each for each in keys if each["key"] == PUSH), {})

            until(lambda: row().get("last"), "top shows the key with its last message")
            found = row()
            assert found["type"] == "comfort.Push"
            assert "horizontal_mps2" in str(found["last"])
        finally:
            running.terminate()
            running.wait(HANG_S)
        (part,) = (folder / "records").glob("*.mcap")
        with open_record(part) as record:
            pushes = [m for _, m in record.decoded(lambda topic: topic.endswith(PUSH))]
            assert pushes
            assert all(message.uncomfortable for message in pushes)  # its own settings
        said = tramstream("reprocess", part, "-o", folder / "again.mcap", "--check")
        assert said.startswith("identical: ")
