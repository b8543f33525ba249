"""The file that the processes of a vehicle know each other by."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from live import SLEEP

from tramstream.errors import BusError
from tramstream.supervision import roster
from tramstream.supervision.roster import NOBODY, REST, Proc, Roster


@pytest.fixture
def folder() -> Iterator[Path]:
    """A private folder, as a runtime folder is."""
    with tempfile.TemporaryDirectory(prefix="tram-") as name:
        yield Path(name)


def me() -> Proc:
    process = Proc.of(os.getpid())
    assert process is not None
    return process


def written(**fields: object) -> Roster:
    return msgspec.structs.replace(roster.fresh(), **fields)


def test_living_process_is_alive_and_one_of_another_start_is_not() -> None:
    process = me()
    assert process.alive
    assert not Proc(process.pid, process.start_ticks + 1).alive
    assert not NOBODY.alive


def test_ended_process_is_gone_even_before_it_is_reaped() -> None:
    child = subprocess.Popen(SLEEP)
    process = Proc.of(child.pid)
    assert process is not None
    assert process.alive
    child.kill()
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # ended, and still a zombie
    assert not process.alive
    child.wait()
    assert not process.alive


def test_process_with_blanks_and_brackets_in_its_name_is_known_by_its_start(folder: Path) -> None:
    program = folder / "a) R 1 (b"
    program.symlink_to("/bin/sleep")
    with subprocess.Popen([str(program), *SLEEP[1:]]) as child:
        process = Proc.of(child.pid)
        plain = subprocess.Popen(SLEEP)
        try:
            assert process is not None
            later = Proc.of(plain.pid)
            assert later is not None
            assert 0 <= later.start_ticks - process.start_ticks < 100 * 3600
        finally:
            for each in (child, plain):
                each.kill()
                each.wait()


def test_roster_is_read_as_it_was_written(folder: Path) -> None:
    assert roster.read(folder) is None
    known = written(supervisor=me(), claimed=True, command=("a", REST), nodes={"x": me()}, lost=3)
    roster.write(folder, known)
    assert roster.read(folder) == known
    assert known.living() == {"x": me()}
    roster.remove(folder)
    roster.remove(folder)
    assert roster.read(folder) is None


def test_roster_of_another_boot_or_cut_anywhere_is_none(folder: Path) -> None:
    roster.write(folder, written(boot="another"))
    assert roster.read(folder) is None
    roster.write(folder, written(nodes={"x": me()}))
    whole = (folder / roster.FILE).read_bytes()
    for length in range(len(whole)):
        (folder / roster.FILE).write_bytes(whole[:length])
        assert roster.read(folder) is None
    for garbage in (b"\xff" * 30, b"[" * 100_000, b'{"boot": 1}'):
        (folder / roster.FILE).write_bytes(garbage)
        assert roster.read(folder) is None


def test_nodes_that_have_ended_do_not_live(folder: Path) -> None:
    child = subprocess.Popen(SLEEP)
    process = Proc.of(child.pid)
    assert process is not None
    known = written(nodes={"a": process, "b": me()})
    assert list(known.living()) == ["a", "b"]
    child.kill()
    child.wait()
    assert list(known.living()) == ["b"]


def test_successor_gets_what_is_left_of_the_run() -> None:
    known = written(command=("run", "--duration-s", REST))
    assert known.successor(100.0) == ["run", "--duration-s", "0.000"]  # 0 is for ever
    limited = msgspec.structs.replace(known, ends_s=130.5)
    assert limited.successor(100.0) == ["run", "--duration-s", "30.500"]
    assert float(limited.successor(1000.0)[-1]) > 0.0  # never 0, which would be for ever


def test_place_is_taken_once_and_free_again_after(folder: Path) -> None:
    held = roster.lock(folder)
    roster.write(folder, written(supervisor=Proc(1, Proc.of(1).start_ticks)))  # type: ignore[union-attr]
    assert roster.try_lock(folder) is None
    with pytest.raises(BusError, match=r"running in this folder already \(process 1; `kill 1`"):
        roster.lock(folder)
    os.close(held)
    os.close(roster.lock(folder))
