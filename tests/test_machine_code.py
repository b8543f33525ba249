"""Machine code of the kernels: kept, found again, and made anew when the sources change."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tramstream import machine_code

WARM_START = """
import numba
from numba.core import event
from tramstream.processors.compile_kernels import compile_all
with event.install_recorder("numba:compile") as recorder:
    compile_all()
    numba.njit(lambda: 0)()  # what is compiled is seen
print([each.data["dispatcher"].__name__ for _, each in recorder.buffer if each.is_start])
"""


def interrupt(_: str) -> None:
    raise InterruptedError


@pytest.mark.live
def test_warm_start_does_not_compile() -> None:
    machine_code.ensure(print)
    done = subprocess.run(
        [sys.executable, "-c", WARM_START], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "['<lambda>']"


def test_folder_belongs_to_the_state_of_the_sources() -> None:
    machine_code.folder.cache_clear()
    before = machine_code.folder()
    source = Path(machine_code.__file__)
    status = source.stat()
    try:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
        machine_code.folder.cache_clear()
        after = machine_code.folder()
    finally:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
        machine_code.folder.cache_clear()
    assert before != after
    assert before == machine_code.folder()
    after.rmdir()


def test_machine_code_that_is_whole_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine_code.folder.cache_clear()
    try:
        machine_code.mark_complete()
        machine_code.ensure(pytest.fail)
        torn = machine_code.folder() / "kernel.nbi"
        torn.touch()
        with pytest.raises(InterruptedError):
            machine_code.ensure(interrupt)
        machine_code.clear()
        assert not torn.exists()
        machine_code.mark_complete()
        machine_code.ensure(pytest.fail)
        for number in range(machine_code.KEPT + 2):
            (tmp_path / "tramstream" / f"old{number}").mkdir()
        machine_code.mark_complete()
        assert len(list((tmp_path / "tramstream").iterdir())) == machine_code.KEPT + 1
        assert machine_code.folder().is_dir()
    finally:
        machine_code.folder.cache_clear()
