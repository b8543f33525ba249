"""Which buses this user has on this machine: `demo`, a replay and a vehicle each have their own.

A router notes its folder in the user's own; whoever looks for a bus finds it there. A note whose
router no longer listens is of one that was killed, and goes.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from tramstream import private
from tramstream.transport.router_socket import router_listens

FOLDER = "buses"
_MOST_BYTES = 4096


def note(meeting: Path) -> None:
    """Note that a router listens in `meeting`.

    Not where `TRAMSTREAM_RUNTIME_DIR` says where the bus is: whoever sets it looks there. A folder
    that cannot be written, or that others can write in, holds no notes: then a bus is found only
    where it is looked for.
    """
    if os.environ.get(private.RUNTIME_DIR) or meeting == private.own_runtime_dir():
        return
    folder = private.own_runtime_dir() / FOLDER
    _noted(folder)  # what others have left goes
    with suppress(OSError):
        if not private.make(folder):
            private.write(_note_of(folder, meeting), os.fsencode(meeting.absolute()))


def listening() -> list[Path]:
    """Folders of the user's buses that have a router now, the usual one first."""
    if os.environ.get(private.RUNTIME_DIR):
        folders = [private.default_runtime_dir()]
    else:
        folders = [private.own_runtime_dir(), *_noted(private.own_runtime_dir() / FOLDER)]
    return [folder for folder in folders if router_listens(folder)]


def _noted(folder: Path) -> list[Path]:
    """Folders that routers have noted, by name; notes of those that are gone are removed."""
    try:
        if not folder.is_dir() or private.doubt_of(folder):
            return []
        notes = sorted(folder.iterdir())
    except OSError:
        return []
    found = []
    for each in notes:
        try:
            meeting = Path(os.fsdecode(each.read_bytes()[:_MOST_BYTES]))
        except OSError:
            continue  # its router ended in this instant
        if meeting.is_absolute() and router_listens(meeting):
            found.append(meeting)
        else:
            with suppress(OSError):
                each.unlink(missing_ok=True)
    return found


def _note_of(folder: Path, meeting: Path) -> Path:
    name = hashlib.blake2b(os.fsencode(meeting.absolute()), digest_size=8).hexdigest()
    return folder / name
