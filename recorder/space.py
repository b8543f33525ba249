"""Keep space on the disk: below the floor the oldest finished, unprotected record goes first.

Which is the oldest, the order of boots and parts in the names says (`names`), never a clock.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path

from tramstream.events.kinds import Event
from tramstream.recorder.events import (
    FOLDER_REFUSED,
    NO_SPACE,
    PART_DELETED,
    PART_NOT_DELETED,
    SPACE_HELD,
)
from tramstream.recorder.file.sink import why
from tramstream.recorder.names import KEEP, PartName, parse

_PATIENCE_NS = 60_000_000_000
"""Deleted bytes that somebody still reads come back later; until then nothing else is deleted."""


class FreeSpace:
    """The floor under one folder's free space. `check` runs on the disk worker.

    Only files named like a recorder's own are ever deleted. `blocked` says why nothing may be
    written: the space is below the floor and nothing may be deleted.
    """

    def __init__(
        self,
        directory: Path,
        floor_bytes: int,
        free_bytes: Callable[[Path], int] | None = None,
    ) -> None:
        self.directory = directory
        self.floor_bytes = floor_bytes
        self.blocked: Event | None = None
        self.events: deque[Event] = deque()
        self.latest: PartName | None = None
        """The running session's last finished part: stays, else a stop would eat its own record."""
        self._free_bytes = free_bytes or _disk_free
        self._refused: set[Path] = set()
        self._wait_until_ns = 0

    def check(self, now_ns: int) -> None:
        """Delete as far as needed and allowed; set `blocked`."""
        try:
            free = self._free_bytes(self.directory)
            while free < self.floor_bytes and now_ns >= self._wait_until_ns:
                oldest = self._oldest()
                if oldest is None:
                    break
                free = self._delete(oldest, free, now_ns)
        except OSError as error:
            reason, advice = why(error)
            self.blocked = FOLDER_REFUSED(folder=self.directory, reason=reason, advice=advice)
            return
        waiting = now_ns < self._wait_until_ns
        self.blocked = None if free >= self.floor_bytes or waiting else self._too_little(free)

    def _too_little(self, free: int) -> Event:
        return NO_SPACE(folder=self.directory, free_bytes=free, floor_bytes=self.floor_bytes)

    def _oldest(self) -> Path | None:
        found = []
        for path in self.directory.glob("*.mcap"):
            name = parse(path.name)
            if name is None or self._is_latest(name) or path in self._refused:
                continue
            if not path.with_name(path.name + KEEP).exists():
                found.append((name, path))
        return min(found)[1] if found else None

    def _is_latest(self, name: PartName) -> bool:
        """Whether it is the latest part, whatever its name has been corrected to."""
        return self.latest is not None and name._replace(start=self.latest.start) == self.latest

    def _delete(self, path: Path, free: int, now_ns: int) -> int:
        """Delete `path`; bytes free after it."""
        try:
            size = path.stat().st_blocks * 512
            path.unlink()
        except FileNotFoundError:
            return self._free_bytes(self.directory)
        except OSError as error:
            self._refused.add(path)
            reason, advice = why(error)
            self.events.append(PART_NOT_DELETED(part=path.name, reason=reason, advice=advice))
            return free
        after = self._free_bytes(self.directory)
        floor = self.floor_bytes
        self.events.append(PART_DELETED(part=path.name, free_bytes=free, floor_bytes=floor))
        if after - free < size // 2:
            self._wait_until_ns = now_ns + _PATIENCE_NS
            self.events.append(SPACE_HELD(part=path.name))
        return after


def _disk_free(directory: Path) -> int:
    return shutil.disk_usage(directory).free
