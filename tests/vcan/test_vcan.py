"""The CAN path on a real kernel, in qemu: `pytest -m study tests/vcan`; see docs/can.md."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import run  # noqa: E402  a program beside this file, not a package


@pytest.mark.study
def test_can_port_holds_on_a_real_kernel() -> None:
    try:
        run.tools()
        kernel = run.kernel_package(run.cache_folder(), download=False)
    except run.AbsentError as error:
        pytest.skip(str(error))
    command = [sys.executable, str(HERE / "run.py"), "--kernel", str(kernel)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr


def test_archive_is_laid_out_as_the_kernel_wants_it(tmp_path: Path) -> None:
    """Authority: cpio itself, where it is installed; else alignment and trailer only."""
    data = run.archive({"bin": (0o040755, b""), "bin/x": (0o100755, b"12345")})
    assert len(data) % 4 == 0
    assert data.count(b"070701") == 3
    assert b"TRAILER!!!\0" in data
    cpio = shutil.which("cpio")
    if cpio is None:
        pytest.skip("cpio is absent: apt-get install cpio")
    subprocess.run([cpio, "-id"], input=data, cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "bin" / "x").read_bytes() == b"12345"
    assert (tmp_path / "bin" / "x").stat().st_mode & 0o777 == 0o755


def test_modules_are_loaded_after_what_they_depend_on(tmp_path: Path) -> None:
    for name, needed in {"can": b"", "can-raw": b"can", "can-dev": b"", "card": b"can_dev"}.items():
        (tmp_path / f"{name}.ko").write_bytes(b"\x7fELF\0depends=" + needed + b"\0name=x\0")
    found = run.module_files(tmp_path, ("can-raw", "card", "built-in"))
    assert [path.stem for path in found] == ["can", "can-raw", "can-dev", "card"]


def test_absent_kernel_package_is_named_with_its_folder(tmp_path: Path) -> None:
    with pytest.raises(run.AbsentError, match=str(tmp_path)):
        run.kernel_package(tmp_path, download=False)
