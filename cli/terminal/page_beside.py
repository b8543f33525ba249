"""The live page beside a running vehicle: a process of its own, which the vehicle does not wait for."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tramstream.cli.terminal.optional import needs

LEAVE_S = 5.0
ADDRESS = "live page: "
"""What stands before the address in the first line that `tramstream live` prints."""


@contextmanager
def page_beside(
    vehicle: str, runtime_dir: Path, listen: str, net: Path | None = None
) -> Iterator[str]:
    """Serve the page of a vehicle; gives its address.

    Raises
    ------
    ConfigError
        If its packages are not installed.
    """
    import os

    with needs("live"):
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401

    command = [sys.executable, "-P", "-m", "tramstream.cli.main", "live", "--vehicle", vehicle]
    command += ["--listen", listen, *(["--net", str(net)] if net is not None else [])]
    environment = {**os.environ, "TRAMSTREAM_RUNTIME_DIR": str(runtime_dir)}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        said = ""
        for said in process.stderr:
            if said.startswith(ADDRESS):
                break
        yield said.removeprefix(ADDRESS).strip() or "the live page did not start"
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(LEAVE_S)
        process.kill()
        process.wait()
        process.stderr.close()
