"""Folders and files that only their user can change, on a machine that others share.

What lies in them is believed: machine code is run, a snapshot becomes a processor's memory, whoever
answers at a socket is the bus. So they belong to the user that runs us, nobody else may write in
them, and nobody else can have put them, or a link, in their place.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def make(folder: Path) -> str:
    """Make a folder, and those above it that are missing, for this user alone.

    Returns
    -------
    doubt : str
        Why what is there cannot be trusted (see `doubt_of`); empty if it can.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    missing = []
    for each in (folder, *folder.parents):
        if os.path.lexists(each):
            break
        missing.append(each)
    for each in reversed(missing):
        each.mkdir(mode=0o700, exist_ok=True)
    return doubt_of(folder)


def doubt_of(folder: Path) -> str:
    """Why a folder cannot be trusted, without a subject; empty if it can.

    It must be a folder of this user in which nobody else may write. So must be the folders above
    it, but there root may be the owner, and a group may write (Debian's users have one of their
    own), and anybody where the sticky bit keeps them from each other's files, as in /tmp. Links are
    followed if they are this user's or root's. (Who root is, the owner of / tells.)
    """
    trusted = (0, os.geteuid(), Path("/").stat().st_uid)
    for each in (folder, *folder.absolute().parents):
        status = each.lstat()
        if stat.S_ISLNK(status.st_mode) and status.st_uid not in trusted:
            return f"is reached by a link of user {status.st_uid} ({each})"
    status = folder.stat()
    if not stat.S_ISDIR(status.st_mode):
        return "is no folder"
    if status.st_uid != os.geteuid():
        return f"belongs to user {status.st_uid}"
    if status.st_mode & _OTHERS_WRITE:
        return f"can be written by others (mode {stat.S_IMODE(status.st_mode):o})"
    for each in folder.resolve().parents:
        status = each.stat()
        if status.st_uid not in trusted:
            return f"lies in {each}, which belongs to user {status.st_uid}"
        if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
            return f"lies in {each}, where anybody may replace it"
    return ""


def close(folder: Path) -> list[Path]:
    """Let nobody else look into a folder of this user; what somebody else can have put there."""
    was_open = folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    if was_open:
        with suppress(OSError):  # a read-only disk; nobody can write there either
            folder.chmod(0o700)
    doubtful = []
    for each in folder.rglob("*"):
        try:
            status = each.lstat()
        except FileNotFoundError:  # a process of this user writes here
            continue
        plain = stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)
        if (
            not plain
            or status.st_uid != os.geteuid()
            or (was_open and status.st_mode & _OTHERS_WRITE)
        ):
            doubtful.append(each)
    return doubtful


def write(path: Path, data: bytes) -> None:
    """Write a file of a private folder so that readers see the old or the new one, never half."""
    temporary = path.with_suffix(".new")
    temporary.unlink(missing_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with os.fdopen(os.open(temporary, flags, 0o600), "wb") as file:
        file.write(data)
    os.replace(temporary, path)


RUNTIME_DIR = "TRAMSTREAM_RUNTIME_DIR"
"""Environment variable that names the folder of the bus."""


def default_runtime_dir() -> Path:
    """`TRAMSTREAM_RUNTIME_DIR`, else the user's own folder."""
    chosen = os.environ.get(RUNTIME_DIR)
    return Path(chosen) if chosen else own_runtime_dir()


def own_runtime_dir() -> Path:
    """/run/tramstream for root, else a folder of the user's own."""
    if os.geteuid() == 0:
        return Path("/run/tramstream")
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "tramstream" if user else Path(f"/tmp/tramstream-{os.geteuid()}")
