"""What tests of real processes share: the program, one way to wait, one limit against hanging.

No test judges by the wall clock. A busy machine is slow, not wrong: whoever waits, waits for a
condition, and `HANG_S` only ends what would else hang for ever.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

HANG_S = 900.0
"""What takes this long never ends; ten times what the slowest test takes with both cores busy six
times over."""
PAUSE_S = 0.01
"""Between two looks at a condition."""
SLEEP = ("sleep", str(HANG_S))
"""A program that does nothing for as long as any test may need it."""


def until(condition: Callable[[], T], what: str, found: Callable[[], object] = lambda: "") -> T:
    """Wait until `condition` holds and return what it gave.

    If it never does, fail with `what` was waited for and what was `found` instead.
    """
    end_s = time.monotonic() + HANG_S
    while not (result := condition()):
        if time.monotonic() > end_s:
            raise AssertionError(f"waited {HANG_S:.0f} s in vain for {what}; {found()}")
        time.sleep(PAUSE_S)
    return result


def command(*arguments: object) -> list[str]:
    """The program as a user would call it."""
    # -P: a stale tramstream.egg-info in the working directory would hide the verbs.
    return [sys.executable, "-P", "-m", "tramstream.cli.main", *map(str, arguments)]


def environment(runtime_dir: Path, **more: str) -> dict[str, str]:
    return {**os.environ, "TRAMSTREAM_RUNTIME_DIR": str(runtime_dir), **more}


def finished(words: Sequence[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, its output kept as text."""
    options = {"capture_output": True, "text": True, "check": False, **options}
    return subprocess.run(words, timeout=HANG_S, **options)


def tramstream(*arguments: object, status: int = 0, **options: Any) -> str:
    """Run the command line to its end, which has to be `status`; its standard output."""
    done = finished(command(*arguments), **options)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout


@contextmanager
def short_folder() -> Iterator[Path]:
    """A folder whose name leaves room for a Unix socket."""
    folder = Path(tempfile.mkdtemp(prefix="tmst", dir="/tmp"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
