"""Bytes on their way to the disk, off the thread that receives them.

A `Worker` runs jobs one after the other; a `Sink` hands whole groups of bytes to its file. A group
that the disk refuses is cut off again and tried at the next flush: what stands in the file ends
with a whole group unless the power goes while one is written.
"""

from __future__ import annotations

import errno
import fcntl
import os
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

LIMIT_BYTES = 32_000_000
"""Kept in memory while the disk refuses or stalls: some minutes of live traffic."""
ACTIVE = ".active"
"""Ending of a file that is still written, after its final name."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Messages of one topic that never reached the disk: all published between the two instants."""

    topic: str
    count: int
    after_publish_ns: int
    before_publish_ns: int


class LossBook:
    """Counts what was dropped, topic by topic."""

    def __init__(self) -> None:
        self.count = 0
        self._open: dict[str, list[int]] = {}

    def add(self, topic: str, publish_ns: int) -> None:
        """One message of `topic`, published at `publish_ns`, was dropped."""
        self.count += 1
        entry = self._open.setdefault(topic, [0, publish_ns, publish_ns])
        entry[0] += 1
        entry[1] = min(entry[1], publish_ns)
        entry[2] = max(entry[2], publish_ns)

    def add_all(self, loss: Loss) -> None:
        """Take over what another book counted."""
        self.count += loss.count
        first_ns, last_ns = loss.after_publish_ns + 1, loss.before_publish_ns - 1
        entry = self._open.setdefault(loss.topic, [0, first_ns, last_ns])
        entry[0] += loss.count
        entry[1] = min(entry[1], first_ns)
        entry[2] = max(entry[2], last_ns)

    def take(self) -> list[Loss]:
        """What was dropped since the last call."""
        losses = [
            Loss(topic, count, max(first_ns - 1, 0), last_ns + 1)
            for topic, (count, first_ns, last_ns) in self._open.items()
        ]
        self._open.clear()
        return losses


class Worker:
    """Runs jobs in order on a thread of its own, or at once if not `threaded` (tests, tools)."""

    def __init__(self, threaded: bool = True) -> None:
        self._threaded = threaded
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    def submit(self, job: Callable[[], None]) -> None:
        """Run `job` after those before it. A bug in an earlier job is raised here."""
        if self._failure is not None:
            raise self._failure
        if not self._threaded:
            job()
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="recorder-disk", daemon=True)
            self._thread.start()
        self._jobs.put(job)

    def drain(self, timeout_s: float) -> bool:
        """Wait until all jobs submitted so far have run; False if they took longer."""
        done = threading.Event()
        self.submit(done.set)
        return done.wait(timeout_s)

    def close(self, timeout_s: float) -> bool:
        """End the thread after its jobs; False if they took longer."""
        if self._thread is None:
            return True
        self._jobs.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except Exception as error:  # noqa: BLE001 - handed to the owner by `submit`
                self._failure = error


class Sink:
    """One file that grows by whole groups, `<name>.active` until it is finished.

    `put`, `flush` and `finish` only queue work. `error` is one sentence while the disk refuses,
    empty otherwise; `spoiled` says that a sync failed, after which the kernel forgets what it has
    not written: the owner should go on in another file. A `durable` sink syncs at each flush, any
    does before it is finished.
    """

    def __init__(self, final: Path, worker: Worker, durable: bool = True) -> None:
        self.final = final
        self.path = final.with_name(final.name + ACTIVE)
        self.size = 0  # of all that was put
        self.written = 0  # of all whole groups in the file
        self.error = ""
        self.error_number = 0
        self.spoiled = False
        self.finished = False
        self._worker = worker
        self._durable = durable
        self._groups: deque[bytes] = deque()
        self._lock = threading.Lock()
        self._scheduled = False
        self._finishing = False
        self._fd = -1
        self._new = False

    @property
    def pending_bytes(self) -> int:
        return self.size - self.written

    def put(self, group: bytes) -> None:
        """Append `group`, whole or not at all."""
        self._groups.append(group)
        self.size += len(group)

    def flush(self) -> None:
        """Write and sync what is there, in the background."""
        with self._lock:
            if self._scheduled or self.finished:
                return
            self._scheduled = True
        self._worker.submit(self._work)

    def finish(self) -> None:
        """Once all is written and synced, give the file its final name."""
        self._finishing = True
        self.flush()

    def abandon(self, busy: bool = False) -> list[bytes]:
        """Close the file as it is (if not `busy`) and return the groups that are not in it."""
        if self._fd >= 0 and not busy:
            os.close(self._fd)
            self._fd = -1
        return list(self._groups)

    def discard(self) -> None:
        """Close and delete the unfinished file."""
        self.abandon()
        self.path.unlink(missing_ok=True)

    def _work(self) -> None:
        with self._lock:
            self._scheduled = False
        finishing = self._finishing  # nothing is put after it was set
        try:
            self._open()
            grown = self._write()
            if finishing or (grown and self._durable):
                self._sync()
            if finishing:
                self._rename()
        except OSError as error:
            self._refuse(error)
        else:
            self.error, self.error_number = "", 0

    def _open(self) -> None:
        if self._fd < 0:
            flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC
            self._fd = os.open(self.path, flags, 0o644)
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # released when the process dies
            self._new = True

    def _write(self) -> bool:
        grown = False
        while self._groups:
            group = memoryview(self._groups[0])
            done = 0
            while done < len(group):
                done += self._pwrite(group[done:], self.written + done)
            self.written += len(group)
            self._groups.popleft()
            grown = True
        return grown

    def _sync(self) -> None:
        try:
            self._fdatasync()
        except OSError:
            self.spoiled = True
            raise
        if self._new:
            sync_directory(self.path.parent)
            self._new = False

    def _rename(self) -> None:
        os.rename(self.path, self.final)
        sync_directory(self.path.parent)
        os.close(self._fd)
        self._fd, self.finished = -1, True

    def _refuse(self, error: OSError) -> None:
        """Cut off what was written of a group and say why."""
        try:
            if self._fd >= 0:
                os.ftruncate(self._fd, self.written)
        except OSError:
            self.spoiled = True  # the rest of a group stays; readers step over it
        self.error_number = error.errno or 0
        self.error = f"{self.path}: {reason(error)}"

    def _pwrite(self, data: memoryview, offset: int) -> int:
        return os.pwrite(self._fd, data, offset)

    def _fdatasync(self) -> None:
        os.fdatasync(self._fd)


_REASONS = {
    errno.ENOSPC: "the disk is full; delete or move records",
    errno.EDQUOT: "the disk quota is used up; delete or move records",
    errno.EFBIG: "the file may not grow further; lower $.recorder.split_bytes",
    errno.EIO: "the disk fails (input/output error); replace it",
    errno.EROFS: "the disk is read-only; mount it writable",
    errno.EEXIST: "the file exists already; choose another name or delete it",
    errno.EACCES: "the folder may not be written; correct its owner or $.recorder.directory",
    errno.ENOENT: "the folder does not exist; create it or correct $.recorder.directory",
}


def reason(error: OSError) -> str:
    """Why the disk refuses and what helps, as the end of a sentence."""
    known = _REASONS.get(error.errno or 0)
    return known or f"the disk refuses ({error.strerror or error})"


def sync_directory(folder: Path) -> None:
    """Make names that were created, changed or deleted in `folder` survive a power cut."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
