"""Bytes on their way to the disk, off the thread that receives them.

A `Worker` runs jobs one after the other; a `Sink` hands whole groups of bytes to its file. A group
that the disk refuses is cut off again and tried at the next flush: what stands in the file ends
with a whole group unless the power goes while one is written.
"""

from __future__ import annotations

import errno
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from queue import SimpleQueue

from tramstream.events.kinds import Event
from tramstream.recorder.file.events import DISK_REFUSES, PART_RESCUED
from tramstream.recorder.file.storage import DISK, Storage

LIMIT_BYTES = 32_000_000
"""Kept in memory while the disk refuses or stalls: some minutes of live traffic."""
RESERVE_BYTES = 8_000_000
"""Set aside for a live file at a time: about a minute."""
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
    """Runs jobs in order on a thread of its own, or at once if not `threaded` (tests, tools).

    `storage` is the disk that the jobs work on.
    """

    def __init__(self, threaded: bool = True, storage: Storage = DISK) -> None:
        self.storage = storage
        self.events: deque[Event] = deque()
        """What jobs have done that people should know."""
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


class Stage(Enum):
    """Where a file is on its way. Each has one owner who may leave it, as told behind it.

    ::

        GROWING --finish--> ENDING --written, synced, renamed--> NAMED --folder synced--> FINISHED
           \\---abandon----/---abandon----> ABANDONED
    """

    GROWING = auto()
    """Groups may be put; the file is `<name>.active`. Left by its owner."""
    ENDING = auto()
    """Nothing is put any more, and what was put is not yet all on the disk. Left by the worker."""
    NAMED = auto()
    """The file has its final name, which a power cut may still undo. Left by the worker."""
    FINISHED = auto()
    """The file has its final name for good. Never left."""
    ABANDONED = auto()
    """The file stays `<name>.active` as it is. Never left."""


class Sink:
    """One file that grows by whole groups, `<name>.active` until it is finished.

    `put`, `flush` and `finish` only queue work: one job at the most beside the one that runs. A job
    does what the file's `Stage` asks for, so it does not matter how many run, or when: on a
    finished or abandoned file a job does nothing. `error` is one sentence while the disk refuses,
    empty otherwise. A `durable` sink syncs at each flush, any does before it is finished. After a
    sync that failed the kernel forgets what it has not written, so a durable sink writes anew what
    came since the last good one; `spoiled` tells the owner meanwhile to go on in another file. A
    file that somebody deletes or moves is written once more from what is still open, and said.
    """

    def __init__(self, final: Path, worker: Worker, durable: bool = True) -> None:
        self.final = final
        self.path = final.with_name(final.name + ACTIVE)
        self.size = 0  # of all that was put
        self.written = 0  # of all whole groups in the file
        self.error = ""
        self._refusal = ("", "")  # why the disk refuses, and what helps
        self.error_number = 0
        self.spoiled = False
        self._worker = worker
        self._durable = durable
        self._storage = worker.storage
        self._groups: deque[bytes] = deque()
        self._unsynced: list[bytes] = []  # in the file of a durable sink, not known to be on disk
        self._lock = threading.Lock()  # of the stage, of what waits, and of whether a job does
        self._stage = Stage.GROWING
        self._queued = False
        self._fd = -1
        self._new = False
        self._reserved = 0

    @property
    def pending_bytes(self) -> int:
        return self.size - self.written

    @property
    def finished(self) -> bool:
        """Whether the file has its final name for good."""
        return self._stage is Stage.FINISHED

    def put(self, group: bytes) -> None:
        """Append `group`, whole or not at all.

        Raises
        ------
        ValueError
            If the file was finished or abandoned: nothing may be put behind its end.
        """
        if self._stage is not Stage.GROWING:
            raise ValueError(f"{self.path}: a group was put behind the end of the file")
        self._groups.append(group)
        self.size += len(group)

    def flush(self) -> None:
        """Write and sync what is there, in the background."""
        with self._lock:
            if self._queued or self._stage in (Stage.FINISHED, Stage.ABANDONED):
                return
            self._queued = True
        self._worker.submit(self._work)

    def finish(self) -> None:
        """Once all is written and synced, name the file `final`; again while the disk refuses."""
        with self._lock:
            if self._stage is Stage.GROWING:
                self._stage = Stage.ENDING
        self.flush()

    def abandon(self, busy: bool = False) -> list[bytes]:
        """Leave the file as it is and return the groups that are not in it.

        `busy` says that the worker may hang in the file: it is then not closed. Should the worker
        come back, it takes the group that it was writing out of the file again.
        """
        with self._lock:
            if self._stage in (Stage.NAMED, Stage.FINISHED):
                return []  # all is in it
            self._stage = Stage.ABANDONED
            groups = list(self._groups)
        if self._fd >= 0 and not busy:
            self._storage.close(self._fd)
            self._fd = -1
        return groups

    def discard(self) -> None:
        """Close and delete the unfinished file."""
        self.abandon()
        self.path.unlink(missing_ok=True)

    def _work(self) -> None:
        with self._lock:
            self._queued = False  # whoever comes from here on wants another job
            stage = self._stage
        if stage in (Stage.FINISHED, Stage.ABANDONED):
            return
        try:
            if stage is not Stage.NAMED:
                self._bring(ending=stage is Stage.ENDING)
            if self._stage is Stage.NAMED:
                self._storage.sync_directory(self.path.parent)
                self._storage.close(self._fd)
                self._fd = -1
                self._go(Stage.NAMED, Stage.FINISHED)
        except OSError as error:
            self._refuse(error)
        else:
            self.error, self.error_number = "", 0

    def _go(self, from_: Stage, to: Stage) -> bool:
        """Change the stage, unless somebody else has changed it meanwhile."""
        with self._lock:
            if self._stage is not from_:
                return False
            self._stage = to
        return True

    def _bring(self, ending: bool) -> None:
        """Bring onto the disk what was put; with the last of it, the final name."""
        if self._fd < 0:
            self._fd = self._storage.create(self.path)
            self._new = True
        elif not self._storage.is_at(self._fd, self.path):
            self._rescue()
        grown = self._write()
        if ending and self._reserved > self.written:
            self._storage.truncate(self._fd, self.written)
            self._reserved = 0
        if ending or (grown and self._durable):
            self._sync()
        if ending and self._stage is Stage.ENDING:
            self._storage.rename(self.path, self.final)
            self._go(Stage.ENDING, Stage.NAMED)

    def _rescue(self) -> None:
        """Have what was written in a new file: somebody deleted or moved the one that is open."""
        fd = self._storage.create(self.path)
        try:
            self._storage.copy(self._fd, fd, self.written)
            self._storage.sync(fd)
            self._storage.sync_directory(self.path.parent)
        except OSError:
            self._storage.close(fd)
            self._storage.unlink(self.path)
            raise
        self._storage.close(self._fd)
        self._fd, self._reserved, self._new = fd, 0, False
        self._worker.events.append(PART_RESCUED(part=self.path.name))

    def _write(self) -> bool:
        grown = False
        while self._groups:
            group = memoryview(self._groups[0])
            self._reserve(len(group))
            done = 0
            while done < len(group):
                done += self._storage.write(self._fd, group[done:], self.written + done)
            with self._lock:  # a group is in the file, or its owner has it back: never both
                kept = self._stage is not Stage.ABANDONED
                if kept:
                    self.written += len(group)
                    self._unsynced.append(self._groups.popleft())
            if not kept:
                self._storage.truncate(self._fd, self.written)
                return False
            grown = True
        if not self._durable:
            self._unsynced.clear()
        return grown

    def _reserve(self, size: int) -> None:
        """Have blocks set aside for a live file, some minutes at a time."""
        if self._durable and self.written + size > self._reserved:
            self._reserved = self.written + size + RESERVE_BYTES
            self._storage.reserve(self._fd, self._reserved)

    def _sync(self) -> None:
        try:
            self._storage.sync(self._fd)
        except OSError:
            self.spoiled = True
            with self._lock:
                self._groups.extendleft(reversed(self._unsynced))
                self.written -= sum(map(len, self._unsynced))
                self._unsynced.clear()
            raise
        self._unsynced.clear()
        self.spoiled = False
        if self._new:
            self._storage.sync_directory(self.path.parent)
            self._new = False

    def trouble(self, dropped: int) -> Event | None:
        """What is wrong while the disk refuses; `dropped` messages had no room in memory."""
        if not self.error:
            return None
        (reason, advice), waiting_bytes = self._refusal, self.pending_bytes
        facts = {"waiting_bytes": waiting_bytes, "dropped": dropped}
        return DISK_REFUSES(path=self.path, reason=reason, advice=advice, **facts)

    def _refuse(self, error: OSError) -> None:
        """Cut off what was written of a group and say why."""
        try:
            if self._fd >= 0:
                self._storage.truncate(self._fd, self.written)
                self._reserved = 0
        except OSError:
            self.spoiled = True  # the rest of a group stays; readers step over it
        self.error_number = error.errno or 0
        self.error = f"{self.path}: {reason(error)}"
        self._refusal = why(error)


_FOLDER = "$.recorder.directory"
_REASONS = {
    errno.ENOSPC: ("the disk is full", "delete or move records"),
    errno.EDQUOT: ("the disk quota is used up", "delete or move records"),
    errno.EFBIG: ("the file may not grow further", "lower $.recorder.split_bytes"),
    errno.EIO: ("the disk fails (input/output error)", "replace it"),
    errno.EROFS: ("the disk is read-only", "mount it writable"),
    errno.EEXIST: ("the file exists already", "choose another name or delete it"),
    errno.EACCES: ("the folder may not be written", f"correct its owner or {_FOLDER}"),
    errno.ENOENT: ("the folder does not exist", f"create it or correct {_FOLDER}"),
}


def why(error: OSError) -> tuple[str, str]:
    """Why the disk refuses, and what helps."""
    return _REASONS.get(error.errno or 0) or (f"the disk refuses ({error.strerror or error})", "")


def reason(error: OSError) -> str:
    """Why the disk refuses and what helps, as the end of a sentence."""
    return "; ".join(filter(None, why(error)))
