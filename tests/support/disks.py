"""Disks for the recorder's tests: real files behind calls that are watched, delayed or refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from tramstream.recorder.file.storage import Storage

Call = tuple[str, str]
"""Name of a method of `Storage`, and of the file that it was asked about."""


class Watched(Storage):
    """The real disk; `before(name, file)` sees every call first, and may wait or raise."""

    def __init__(self, before: Callable[[str, str], None] = lambda name, file: None) -> None:
        self.before = before
        self.calls: list[Call] = []
        """Calls that the disk did not refuse, in their order."""
        self.names: dict[int, str] = {}

    def _do(self, name: str, file: str, call: Callable[[], object]) -> object:
        self.before(name, file)
        result = call()
        self.calls.append((name, file))
        return result

    def create(self, path: Path) -> int:
        fd = self._do("create", path.name, lambda: Storage.create(self, path))
        assert isinstance(fd, int)
        self.names[fd] = path.name
        return fd

    def write(self, fd: int, data: memoryview, offset: int) -> int:
        done = self._do("write", self._name(fd), lambda: Storage.write(self, fd, data, offset))
        assert isinstance(done, int)
        return done

    def truncate(self, fd: int, size: int) -> None:
        self._do("truncate", self._name(fd), lambda: Storage.truncate(self, fd, size))

    def sync(self, fd: int) -> None:
        self._do("sync", self._name(fd), lambda: Storage.sync(self, fd))

    def rename(self, path: Path, final: Path) -> None:
        self._do("rename", path.name, lambda: Storage.rename(self, path, final))

    def unlink(self, path: Path) -> None:
        self._do("unlink", path.name, lambda: Storage.unlink(self, path))

    def sync_directory(self, folder: Path) -> None:
        self._do("sync_directory", "", lambda: Storage.sync_directory(self, folder))

    def _name(self, fd: int) -> str:
        return self.names.get(fd) or os.path.basename(os.readlink(f"/proc/self/fd/{fd}"))


def refusing(name: str, number: int) -> Callable[[str, str], None]:
    """A `before` that refuses every call of one name."""

    def before(called: str, file: str) -> None:
        if called == name:
            raise OSError(number, os.strerror(number))

    return before
