"""Bytes of a file that may lie on a failing disk."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from types import TracebackType

from tramstream.errors import RecordError

_PAGE_BYTES = 4096


class Source:
    """A file as bytes at offsets. Pages that the disk cannot read count as zeros.

    Read with `pread`, not mapped: a mapped page that cannot be read ends the process (SIGBUS).
    `size` is the file's at opening; what a recorder appends later is not seen.
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
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError as error:
            raise RecordError(
                f"{path}: cannot be read ({error.strerror}); check the name and the rights"
            ) from error
        self.size = os.fstat(self._fd).st_size

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
        try:
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        return False

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

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
        return os.pread(self._fd, length, offset)
