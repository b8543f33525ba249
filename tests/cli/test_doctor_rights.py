"""What the doctor says of rights on a shared machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from looking import tramstream
from other_users import as_user, open_folder

from tramstream.cli.checks import machine
from tramstream.cli.checks.machine import State
from tramstream.config import Recorder
from tramstream.machine import machine_code

STRANGER = 65534
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be other users")


@pytest.fixture
def shared() -> Iterator[Path]:
    with open_folder() as folder:
        yield folder


@needs_root
def test_root_is_told_to_be_somebody_else() -> None:
    finding = machine.check_rights()[0]
    assert (finding.name, finding.state) == ("user", State.WARNING)
    assert "runs as root" in finding.text
    assert "useradd --system" in finding.cure


@needs_root
def test_user_is_not() -> None:
    def look() -> None:
        finding = machine.check_rights()[0]
        assert (finding.state, finding.text) == (State.OK, "nobody")

    machine_code.folder()
    as_user(STRANGER, look)


@needs_root
def test_runtime_folder_of_a_stranger_fails(shared: Path) -> None:
    as_user(STRANGER, (shared / "run").mkdir)
    (finding,) = machine.check_runtime_dir(shared / "run")
    assert finding.state == State.FAIL
    assert "belongs to user 65534" in finding.text
    done = tramstream("doctor", runtime_dir=shared / "run")
    assert done.returncode == 1
    assert "belongs to user 65534" in done.stdout


@pytest.mark.parametrize(("mode", "state"), [(0o777, State.WARNING), (0o750, State.OK)])
def test_records_where_others_may_write_are_warned_of(
    tmp_path: Path, mode: int, state: State
) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    folder.chmod(mode)
    settings = Recorder(directory=str(folder), free_space_floor_bytes=0)
    finding = machine.check_disk(settings)[0]
    assert ("can be written by others" in finding.text) == (state == State.WARNING)
    assert bool(finding.cure) or state == State.OK


def test_machine_code_that_others_could_write_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "tramstream").mkdir()
    (tmp_path / "tramstream").chmod(0o777)
    monkeypatch.setattr(machine_code, "_refused", [])
    machine_code.folder.cache_clear()
    try:
        (finding,) = machine.check_rights()[1:]
    finally:
        machine_code.folder.cache_clear()
    assert finding.state == State.WARNING
    assert "others could write there (mode 777); it was emptied" in finding.text
