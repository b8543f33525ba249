"""Where compiled kernels are kept, and that they are there before a vehicle needs them.

One folder for all states of our sources, all checkouts and installations of a user: the name of a
file says what it is the code of (`machine/kernels.py`). Compiling all kernels takes longer than
starting a vehicle should; so it is done before, once, in processes of its own
(`machine/compilation.py`), and a file `complete-<state>` lists what these sources need. What
nobody has used for `KEPT_DAYS` is removed, and what was used longest ago when all take more than
`KEPT_BYTES`.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

from tramstream import private

KEPT_DAYS = 90.0
KEPT_BYTES = 1_000_000_000
"""All kernels of one state of the sources take 8 MB."""
YOUNG_DAYS = 1.0
"""Time within which no file is removed however much there is: a vehicle may be starting with it."""
_NAME = "kernels"
_DAY_S = 86400.0
_refused: list[str] = []


@cache
def folder() -> Path:
    """Folder of all machine code of this user; made if need be.

    What lies in it is run, so it is this user's alone (`tramstream.private`), and so is every file
    in it. A folder of this user that others could write in is emptied; where somebody else's lies
    in the way, and in the folder for temporary files too, a new one is made, which all processes
    that this one starts share.
    """
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    temporary = Path(tempfile.gettempdir()) / f"tramstream-{os.geteuid()}"
    for place in (root / "tramstream", temporary):
        try:
            doubt = _emptied(place) if os.path.lexists(place) else private.make(place)
            doubt = doubt or private.make(place / _NAME)
            for each in () if doubt else private.close(place / _NAME):
                _remove(each)
        except OSError:  # a vehicle whose root file system is read-only
            continue
        if not doubt:
            return place / _NAME
        _refused.append(f"{place}: {doubt}; machine code is not taken from there")
    made = Path(tempfile.mkdtemp(prefix="tramstream-"))
    os.environ["XDG_CACHE_HOME"] = str(made)
    private.make(made / "tramstream" / _NAME)
    return made / "tramstream" / _NAME


def refused() -> list[str]:
    """A sentence for each folder whose machine code was not this user's alone, and is not used."""
    return list(_refused)


@cache
def state() -> str:
    """Digest of all that decides which kernels a vehicle needs: sources, compiler, processor."""
    digest = hashlib.sha256(platform.python_version().encode())
    for package in ("numba", "llvmlite", "numpy"):
        digest.update(version(package).encode())
    for name, value in sorted(os.environ.items()):
        if name.startswith("NUMBA_"):
            digest.update(f"{name}={value}".encode())
    digest.update(_processor())
    spec = importlib.util.find_spec("tramstream.processors")
    places = spec.submodule_search_locations if spec is not None else None
    for place in (Path(__file__).parent.parent, *map(Path, places or ())):
        for file in sorted(place.rglob("*.py")):
            digest.update(f"{file.relative_to(place)} {file.stat().st_size} ".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _processor() -> bytes:
    """What the kernel says of the first processor: a disk may be moved to another machine."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_bytes().partition(b"\n\n")[0].splitlines()
        return b"".join(each for each in lines if each.startswith((b"model name", b"flags")))
    return platform.processor().encode()


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


def whole() -> bool:
    """Whether all kernels are there; one that a power cut has emptied, or that is gone, is not."""
    complete = _complete()
    try:
        names = complete.read_text().splitlines()
        there = all((complete.parent / each).stat().st_size for each in names)
    except FileNotFoundError:
        return False
    with suppress(OSError):  # a read-only disk: nobody prunes there either
        os.utime(complete)
    return there


def mark_complete(names: Iterable[str]) -> None:
    """Remember that all kernels of these sources are there, on disk for good; remove old ones.

    Parameters
    ----------
    names : iterable of str
        The files that they are in.
    """
    os.sync()
    private.write(_complete(), "".join(f"{each}\n" for each in sorted(names)).encode())
    os.sync()
    prune(KEPT_BYTES, KEPT_DAYS, time.time())


def _complete() -> Path:
    return folder() / f"complete-{state()}"


def prune(most_bytes: int, most_days: float, now_s: float) -> None:
    """Remove what was not used for long; and more, oldest first, while there is too much.

    What a list of complete kernels names was used when the list was. Folders of versions before
    0.9, one for each state of their sources, go by their age too.
    """
    here = folder()
    used_s: dict[Path, float] = {}
    for each in here.iterdir():
        with suppress(FileNotFoundError):  # another process prunes too
            used_s[each] = max(each.stat().st_mtime, used_s.get(each, 0.0))
    for complete in [each for each in used_s if each.name.startswith("complete-")]:
        with suppress(FileNotFoundError):
            for name in complete.read_text().splitlines():
                path = here / name
                if path in used_s:
                    used_s[path] = max(used_s[path], used_s[complete])
    used_s.pop(here / "lock", None)
    sizes = {each: each.stat().st_size for each in used_s if each.exists()}
    total = sum(sizes.values())
    for each in sorted(sizes, key=used_s.__getitem__):
        age_days = (now_s - used_s[each]) / _DAY_S
        if age_days > most_days or (total > most_bytes and age_days > YOUNG_DAYS):
            each.unlink(missing_ok=True)
            total -= sizes[each]
    for old in here.parent.iterdir():
        if old != here and old.is_dir() and now_s - old.stat().st_mtime > most_days * _DAY_S:
            shutil.rmtree(old, ignore_errors=True)
