"""The live page beside a running vehicle: a process of its own, for which nothing waits."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tramstream.cli.terminal.optional import needs
from tramstream.errors import ConfigError
from tramstream.private import RUNTIME_DIR

LEAVE_S = 5.0
ADDRESS = "live page: "
"""What stands before the address in the first line that `tramstream live` prints."""


def check_installed() -> None:
    """Refuse a page whose packages are missing, before a ride begins.

    Raises
    ------
    ConfigError
        With the cure.
    """
    with needs("live"):
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401


@contextmanager
def page_beside(vehicle: str, runtime_dir: Path, listen: str) -> Iterator[str]:
    """Serve the page of a vehicle; gives its address.

    Raises
    ------
    ConfigError
        If its packages are not installed, or nobody can listen there.
    """
    with page_process(vehicle, runtime_dir, listen) as (_, address):
        yield address


@contextmanager
def page_process(
    vehicle: str, runtime_dir: Path, listen: str
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The same with its process."""
    check_installed()
    command = [sys.executable, "-P", "-m", "tramstream.cli.main", "live", "--vehicle", vehicle]
    command += ["--listen", listen]
    environment = {**os.environ, RUNTIME_DIR: str(runtime_dir)}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        told: list[str] = []
        for said in process.stderr:
            told.append(said.strip())
            if said.startswith(ADDRESS):
                break
        if not told or not told[-1].startswith(ADDRESS):
            raise ConfigError(f"the live page did not start: {' '.join(told) or 'no word of it'}")
        yield process, told[-1].removeprefix(ADDRESS)
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(LEAVE_S)
        process.kill()
        process.wait()
        process.stderr.close()
