"""Where compiled kernels are kept, and that they are there before a vehicle needs them.

One folder a state of our sources: numba itself notices when the file of a kernel changes, but not
when that of another kernel does which it calls. Compiling all of them takes about as long as
starting a vehicle should not; so it is done before, once, in a process of its own.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path

KEPT = 4
"""Folders of other states of the sources that are kept: another installation may use them."""
_COMPLETE = "complete"
_COMPILER = "tramstream.processors.compile_kernels"


@cache
def folder() -> Path:
    """Folder of the machine code that belongs to these sources; made if need be."""
    digest = hashlib.sha256(version("numba").encode())
    spec = importlib.util.find_spec("tramstream.processors")
    places = spec.submodule_search_locations if spec is not None else None
    for place in (Path(__file__).parent, *map(Path, places or ())):
        for file in sorted(place.glob("*.py")):
            status = file.stat()
            digest.update(f"{file}{status.st_size}{status.st_mtime_ns}".encode())
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    chosen = Path(root) / "tramstream" / digest.hexdigest()[:16]
    try:
        chosen.mkdir(parents=True, exist_ok=True)
    except OSError:  # a vehicle whose root file system is read-only
        chosen = Path(tempfile.gettempdir()) / f"tramstream-{os.getuid()}" / chosen.name
        chosen.mkdir(parents=True, exist_ok=True)
    return chosen


def ensure(say: Callable[[str], None]) -> None:
    """See to it that all kernels are compiled; says so when that has to be waited for."""
    if _whole():
        return
    say("compiling the filters for this machine; once, it takes about half a minute")
    subprocess.run([sys.executable, "-m", _COMPILER], check=True)


def _whole() -> bool:
    """Whether all kernels are there; a file that a power cut has emptied says that they are not."""
    here = folder()
    return (here / _COMPLETE).exists() and all(
        each.stat().st_size for each in here.rglob("*.nb?") if each.is_file()
    )


def clear() -> None:
    """Remove what is there: a compilation that a power cut has ended leaves torn files."""
    here = folder()
    for each in (here / _COMPLETE, *here.rglob("*.nb?")):
        each.unlink(missing_ok=True)


def mark_complete() -> None:
    """Remember that all kernels are there, on disk for good; forget folders of older sources."""
    here = folder()
    os.sync()
    (here / _COMPLETE).touch()
    others = sorted(
        (each for each in here.parent.iterdir() if each.is_dir() and each != here),
        key=lambda each: each.stat().st_mtime,
    )
    for old in others[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
