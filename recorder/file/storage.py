"""The calls by which a record gets onto the disk, in one place.

Whoever writes a record (`sink`, `repair`) asks a `Storage` and nobody else, so that a test may
watch the order of writes, syncs and renames, delay them or refuse them.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from pathlib import Path

MODE = 0o640
"""Of every file that the recorder makes: records tell where people were at what time."""
_AT_FDCWD, _RENAME_NOREPLACE, _FALLOC_KEEP_SIZE = -100, 1, 1
_WITHOUT = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)
"""What a kernel or file system says that does not know a call."""
_COPY_BYTES = 1 << 20
_libc = ctypes.CDLL(None, use_errno=True)


class Storage:
    """The disk itself. All methods raise OSError where the disk refuses."""

    def create(self, path: Path) -> int:
        """Make `path`, which may not exist, locked for this process; return its descriptor.

        The lock tells a living recorder's file from one that a dead one left.
        """
        fd = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, MODE)
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return fd

    def write(self, fd: int, data: memoryview, offset: int) -> int:
        """Write some of `data` at `offset`; return how many bytes of it."""
        return os.pwrite(fd, data, offset)

    def reserve(self, fd: int, size: int) -> None:
        """Have the file system set blocks aside for `size` bytes; the file's length stays.

        Each sync then changes less of the file system. One that cannot do it is no error.
        """
        if _libc.fallocate(fd, _FALLOC_KEEP_SIZE, ctypes.c_int64(0), ctypes.c_int64(size)):
            number = ctypes.get_errno()
            if number not in (*_WITHOUT, errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise OSError(number, os.strerror(number))

    def is_at(self, fd: int, path: Path) -> bool:
        """Whether the open file still stands at `path`: nobody deleted, moved or replaced it."""
        try:
            there = os.stat(path, follow_symlinks=False)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(os.fstat(fd), there)

    def copy(self, fd: int, target_fd: int, size: int) -> None:
        """Write the first `size` bytes of an open file, which may have no name, to another."""
        with open(f"/proc/self/fd/{fd}", "rb", buffering=0) as source:
            offset = 0
            while offset < size and (data := source.read(min(_COPY_BYTES, size - offset))):
                offset += os.pwrite(target_fd, data, offset)
                source.seek(offset)

    def truncate(self, fd: int, size: int) -> None:
        """Cut the file to `size` bytes, and give back what was reserved beyond."""
        os.ftruncate(fd, size)

    def sync(self, fd: int) -> None:
        """Return when the file's data are on the disk for good."""
        os.fdatasync(fd)

    def rename(self, path: Path, final: Path) -> None:
        """Give `path` the name `final`.

        Raises
        ------
        FileExistsError
            If there is a file of that name: nothing is ever replaced.
        """
        names = os.fsencode(path), os.fsencode(final)
        if not _libc.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_NOREPLACE):
            return
        number = ctypes.get_errno()
        if number not in _WITHOUT:
            raise OSError(number, os.strerror(number), str(path), None, str(final))
        os.link(path, final)  # refuses as well; cut before the next line, the file has both names
        os.unlink(path)

    def unlink(self, path: Path) -> None:
        """Delete `path`, if it is there."""
        path.unlink(missing_ok=True)

    def sync_directory(self, folder: Path) -> None:
        """Make names that were created, changed or deleted in `folder` survive a power cut."""
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)

    def close(self, fd: int) -> None:
        """Let go of the file and its lock."""
        os.close(fd)


def is_written(path: Path) -> bool:
    """Whether a living process has the lock that `Storage.create` takes.

    Raises
    ------
    OSError
        If `path` cannot be read.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False


DISK = Storage()
