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
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path

from tramstream import private

KEPT = 4
"""Folders of other states of the sources that are kept: another installation may use them."""
_COMPLETE = "complete"
_COMPILER = "tramstream.processors.warm_up"
_refused: list[str] = []


@cache
def folder() -> Path:
    """Folder of the machine code that belongs to these sources; made if need be.

    What lies in it is run, so it is this user's alone (`tramstream.private`), and so is every file
    in it. A folder of this user that others could write in is emptied; where somebody else's lies
    in the way, and in the folder for temporary files too, a new one is made, which all processes
    that this one starts share.
    """
    name = _state_of_sources()
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    temporary = Path(tempfile.gettempdir()) / f"tramstream-{os.geteuid()}"
    for place in (root / "tramstream", temporary):
        try:
            doubt = _emptied(place) if os.path.lexists(place) else private.make(place)
            doubt = doubt or private.make(place / name)
            for each in () if doubt else private.close(place / name):
                _remove(each)
        except OSError:  # a vehicle whose root file system is read-only
            continue
        if not doubt:
            return place / name
        _refused.append(f"{place}: {doubt}; machine code is not taken from there")
    made = Path(tempfile.mkdtemp(prefix="tramstream-"))
    os.environ["XDG_CACHE_HOME"] = str(made)
    private.make(made / "tramstream" / name)
    return made / "tramstream" / name


def refused() -> list[str]:
    """A sentence for each folder whose machine code was not this user's alone, and is not used."""
    return list(_refused)


def _state_of_sources() -> str:
    digest = hashlib.sha256(version("numba").encode())
    spec = importlib.util.find_spec("tramstream.processors")
    places = spec.submodule_search_locations if spec is not None else None
    for place in (Path(__file__).parent, *map(Path, places or ())):
        for file in sorted(place.rglob("*.py")):
            status = file.stat()
            digest.update(f"{file}{status.st_size}{status.st_mtime_ns}".encode())
    return digest.hexdigest()[:16]


def _emptied(place: Path) -> str:
    """Why a folder that is there cannot be used; one of this user that was open is emptied first.

    Raises
    ------
    OSError
        If it cannot be looked at.
    """
    status = place.lstat()
    is_open = stat.S_ISDIR(status.st_mode) and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if is_open and status.st_uid == os.geteuid():
        place.chmod(0o700)
        for each in place.iterdir():
            _remove(each)
        mode = stat.S_IMODE(status.st_mode)
        _refused.append(f"{place}: others could write there (mode {mode:o}); it was emptied")
    return private.doubt_of(place)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def ensure(say: Callable[[str], None]) -> None:
    """See to it that all kernels are compiled; says so when that has to be waited for."""
    here = folder()
    for sentence in _refused:
        say(f"{sentence} (machine code is kept in {here})")
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
