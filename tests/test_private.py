"""Rights on a shared machine, with users that are really others: this needs root."""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from live import finished
from other_users import as_user, open_folder

from tramstream import private
from tramstream.clock import VehicleClock, boot_id
from tramstream.errors import ConfigError
from tramstream.live import snapshots
from tramstream.machine import compilation, machine_code
from tramstream.proto.sync_pb2 import Snapshot

STRANGER, OTHER = 65534, 1001
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be other users")


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder in which everybody may make something, as /tmp."""
    with open_folder() as folder:
        yield folder


def clock_of(stranger: Path) -> None:
    """What somebody writes who wants to be believed."""
    stranger.mkdir(mode=0o755)
    known = {"boot_id": boot_id(), "offset_ns": 666, "rate": 1.0}
    (stranger / "clock.json").write_text(json.dumps(known))


@needs_root
def test_runtime_folder_of_a_stranger_is_refused_though_it_has_a_clock(shared: Path) -> None:
    folder = shared / "run"
    as_user(STRANGER, clock_of, folder)
    with pytest.raises(ConfigError, match=r"belongs to user 65534; set \$\.bus\.runtime_dir"):
        VehicleClock.shared(folder)


@needs_root
def test_runtime_folder_that_a_stranger_may_write_in_is_refused_though_it_has_a_clock(
    shared: Path,
) -> None:
    folder = shared / "run"
    clock_of(folder)
    folder.chmod(0o777)
    with pytest.raises(ConfigError, match="can be written by others"):
        VehicleClock.shared(folder)
    folder.chmod(0o770)
    with pytest.raises(ConfigError, match="can be written by others"):
        VehicleClock.shared(folder)
    folder.chmod(0o755)
    assert VehicleClock.shared(folder).offset_ns == 666


@needs_root
def test_runtime_folder_behind_a_strangers_link_is_refused(shared: Path) -> None:
    clock_of(shared / "mine")
    as_user(STRANGER, (shared / "link").symlink_to, shared / "mine")
    for folder in (shared / "link", shared / "link" / "below"):
        with pytest.raises(ConfigError, match="link of user 65534"):
            VehicleClock.shared(folder)


@needs_root
def test_runtime_folder_in_a_strangers_folder_is_refused(shared: Path) -> None:
    as_user(STRANGER, (shared / "theirs").mkdir, 0o777)
    with pytest.raises(ConfigError, match="which belongs to user 65534"):
        VehicleClock.shared(shared / "theirs" / "run")


@needs_root
def test_user_is_not_given_the_default_folder_that_another_made_first(shared: Path) -> None:
    """Without XDG_RUNTIME_DIR it is `/tmp/tramstream-<uid>`; another user was the first there."""
    folder = shared / f"tramstream-{OTHER}"
    as_user(STRANGER, clock_of, folder)

    def start() -> None:
        with pytest.raises(ConfigError, match="belongs to user 65534"):
            VehicleClock.shared(folder)

    as_user(OTHER, start)


def test_what_is_made_is_for_this_user_alone(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    before = os.umask(0)
    try:
        VehicleClock.shared(folder)
        snapshots.save(folder / "processors.snapshot", Snapshot(stamp_ns=1))
    finally:
        os.umask(before)
    for each in (folder.parent, folder):
        assert stat.S_IMODE(each.stat().st_mode) == 0o700
    for name in ("clock.json", "processors.snapshot"):
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600


def test_snapshot_is_replaced_and_never_written_in_place(tmp_path: Path) -> None:
    """Whoever has the old one open reads the old one to its end."""
    path = tmp_path / "processors.snapshot"
    snapshots.save(path, Snapshot(stamp_ns=1))
    with path.open("rb") as old:
        before = path.stat().st_ino
        snapshots.save(path, Snapshot(stamp_ns=2))
        assert Snapshot.FromString(old.read()).stamp_ns == 1
    assert path.stat().st_ino != before
    assert Snapshot.FromString(path.read_bytes()).stamp_ns == 2
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.fixture
def cache(shared: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache folder, and a folder for temporary files beside it."""
    (shared / "tmp").mkdir()
    (shared / "tmp").chmod(0o1777)
    (shared / "cache").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared / "cache"))
    monkeypatch.setattr(machine_code.tempfile, "tempdir", str(shared / "tmp"))
    machine_code.folder.cache_clear()
    machine_code._refused.clear()
    yield shared / "cache"
    machine_code.folder.cache_clear()
    machine_code._refused.clear()


def plant(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "kernel.nbi").write_bytes(b"a pickle of somebody else")


@needs_root
def test_machine_code_is_not_taken_from_a_strangers_folder(cache: Path) -> None:
    cache.chmod(0o1777)
    as_user(STRANGER, plant, cache / "tramstream" / "kernels")
    found = machine_code.folder()
    assert found == cache.parent / "tmp" / "tramstream-0" / "kernels"
    assert list(found.iterdir()) == []
    assert (
        "belongs to user 65534; machine code is not taken from there" in (machine_code.refused()[0])
    )


@needs_root
def test_vehicle_starts_where_both_folders_are_strangers(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.chmod(0o1777)
    as_user(STRANGER, plant, cache / "tramstream" / "kernels")
    as_user(STRANGER, plant, cache.parent / "tmp" / "tramstream-0" / "kernels")
    found = machine_code.folder()
    assert list(found.iterdir()) == []
    assert private.doubt_of(found) == ""
    machine_code.folder.cache_clear()
    assert machine_code.folder() == found  # what this process starts uses the same
    said: list[str] = []
    machine_code.mark_complete([])
    compilation.ensure(said.append)
    assert len(said) == 2
    assert all("is not taken from there" in text and str(found) in text for text in said)


@needs_root
def test_files_of_a_stranger_in_a_folder_of_ours_are_not_run(cache: Path) -> None:
    found = machine_code.folder()
    machine_code.mark_complete([])
    theirs, ours, link = found / "theirs.nbi", found / "ours.nbi", found / "link.nbi"
    for path in (theirs, ours):
        path.write_bytes(b"code")
    os.chown(theirs, STRANGER, STRANGER)
    link.symlink_to(theirs)
    machine_code.folder.cache_clear()
    assert machine_code.folder() == found
    assert {each.name for each in found.iterdir()} == {
        "ours.nbi",
        f"complete-{machine_code.state()}",
    }


@pytest.mark.parametrize("mode", [0o777, 0o775])
def test_folder_of_ours_that_others_could_write_in_is_emptied_and_closed(
    cache: Path, mode: int
) -> None:
    found = machine_code.folder()
    (found / "kernel.nbi").write_bytes(b"planted, perhaps")
    machine_code.mark_complete([])
    found.parent.chmod(mode)
    machine_code.folder.cache_clear()
    assert machine_code.folder() == found
    assert list(found.iterdir()) == []
    assert stat.S_IMODE(found.parent.stat().st_mode) == 0o700


def test_compiled_kernels_are_nobody_elses(cache: Path) -> None:
    """As the compiler's process makes them, with a user whose group may write what is made."""
    program = (
        "import os; os.umask(0o002)\n"
        "from tramstream.machine import machine_code\n"
        "print(machine_code.folder())"
    )
    done = finished([sys.executable, "-c", program], check=True)
    for each in (Path(done.stdout.strip()), Path(done.stdout.strip()).parent):
        assert stat.S_IMODE(each.stat().st_mode) == 0o700
