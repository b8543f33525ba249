"""Bytes of a file that may lie on a failing disk."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
from collections import OrderedDict
from pathlib import Path
from types import TracebackType

from tramstream.errors import RecordError

_PAGE_BYTES = 4096
OPEN_FILES = 200
"""So many files are open at a time, a fifth of what a process usually may have; a week of parts of
five minutes are 2,016."""
_FLAGS = os.O_RDONLY | os.O_CLOEXEC
_ACTIVE = ".active"
_open: OrderedDict[Source, int] = OrderedDict()
"""Descriptors by their source, the one used last at the end."""
_lock = threading.Lock()
"""Held while a descriptor of `_open` is used: whoever reads another file may close it."""


class Source:
    """A file as bytes at offsets. Pages that the disk cannot read count as zeros.

    Read with `pread`, not mapped: a mapped page that cannot be read ends the process (SIGBUS).
    `size` is the file's at opening; what a recorder appends later is not seen. Where there are more
    than `OPEN_FILES`, the one that was read longest ago is closed, and opened again when needed.
    """

    def __init__(self, path: Path) -> None:
        """Open `path`.

        Raises
        ------
        RecordError
            If it is absent or may not be read.
        """
        self.path = path
        self.unreadable_bytes = 0
        self._identity: tuple[int, int] | None = None
        self._closed = False
        try:
            with _lock:
                status = os.fstat(self._descriptor())
        except OSError as error:
            raise RecordError(
                f"{path}: cannot be read ({error.strerror}); check the name and the rights"
            ) from error
        self._identity = (status.st_dev, status.st_ino)
        self.size = status.st_size

    def __enter__(self) -> Source:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def locked(self) -> bool:
        """Whether a living recorder writes the file."""
        with _lock:
            fd = self._descriptor()
            try:
                fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                return True
            fcntl.flock(fd, fcntl.LOCK_UN)
            return False

    def close(self) -> None:
        self._closed = True
        with _lock:
            fd = _open.pop(self, -1)
        if fd >= 0:
            os.close(fd)

    def read(self, offset: int, length: int) -> bytes:
        """Bytes from `offset`; fewer than `length` only at the end of the file."""
        offset, end = max(offset, 0), min(offset + length, self.size)
        parts: list[bytes] = []
        while offset < end:
            try:
                part = self._pread(end - offset, offset)
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
                part = self._page(offset, end)
            if not part:
                break  # somebody made the file shorter
            parts.append(part)
            offset += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _page(self, offset: int, end: int) -> bytes:
        """What is left of the page at `offset`, zeros if it cannot be read."""
        length = min(end, offset - offset % _PAGE_BYTES + _PAGE_BYTES) - offset
        try:
            return self._pread(length, offset)
        except OSError:
            self.unreadable_bytes += length
            return bytes(length)

    def _pread(self, length: int, offset: int) -> bytes:
        with _lock:
            return os.pread(self._descriptor(), length, offset)

    def _descriptor(self) -> int:
        """The open file; the caller holds the lock."""
        fd = _open.get(self)
        if fd is not None:
            _open.move_to_end(self)
            return fd
        if self._closed:
            raise ValueError(f"{self.path}: is read after it was closed")
        while len(_open) >= OPEN_FILES:
            os.close(_open.popitem(last=False)[1])
        fd = self._reopened() if self._identity else os.open(self.path, _FLAGS)
        _open[self] = fd
        return fd

    def _reopened(self) -> int:
        """The same file once more; a recorder may have finished it meanwhile.

        Raises
        ------
        RecordError
            If it has been deleted or replaced.
        """
        finished = self.path.with_name(self.path.name.removesuffix(_ACTIVE))
        for path in dict.fromkeys((self.path, finished)):
            try:
                fd = os.open(path, _FLAGS)
            except FileNotFoundError:
                continue
            status = os.fstat(fd)
            if (status.st_dev, status.st_ino) == self._identity:
                return fd
            os.close(fd)
        raise RecordError(f"{self.path}: was deleted or replaced while it was read; read it again")
