"""Parts of a record on their way to the disk, in every order that a slow disk may make of it.

The worker is the real thread. Before each call the disk waits for the test, which so decides how
far the worker has come when the recorder appends, flushes and begins the next part.
"""

from __future__ import annotations

import errno
import itertools
import os
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from disks import Call, Watched
from hypothesis import given, settings
from hypothesis import strategies as st
from record_samples import START_NS, VEHICLE, Sent, plain, traffic

from tramstream.clock import S, VehicleClock
from tramstream.config import Recorder
from tramstream.recorder.file.events import PART_RESCUED
from tramstream.recorder.file.sink import ACTIVE, Sink, Worker
from tramstream.recorder.reader import open_record
from tramstream.recorder.recording import Recording

TRAFFIC = traffic(100)
PATIENCE_S = 600.0
"""Nothing here takes long; only a deadlock does."""


class GatedDisk(Watched):
    """A disk that makes one call for each permit, and refuses those that it is told to.

    It syncs nothing: what a power cut would leave is read from the order of the calls.
    """

    def __init__(self) -> None:
        super().__init__(self._pass)
        self.changed = threading.Condition()
        self.waiting = False
        self.refusals = 0
        self._permits = 0
        self._open = False

    def _pass(self, name: str, file: str) -> None:
        with self.changed:
            self.waiting = True
            self.changed.notify_all()
            allowed = self.changed.wait_for(lambda: self._permits or self._open, PATIENCE_S)
            assert allowed, "the test has forgotten the worker"
            self.waiting = False
            if not self._open:
                self._permits -= 1
            refused, self.refusals = self.refusals > 0, max(0, self.refusals - 1)
        if refused:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def permit(self) -> None:
        with self.changed:
            self._permits += 1
            self.changed.notify_all()

    def open(self) -> None:
        with self.changed:
            self._open, self.refusals = True, 0
            self.changed.notify_all()

    def sync(self, fd: int) -> None:
        self._do("sync", self._name(fd), lambda: None)

    def sync_directory(self, folder: Path) -> None:
        self._do("sync_directory", "", lambda: None)


class CountingWorker(Worker):
    """The worker, and how many of its jobs have not ended."""

    def __init__(self, disk: GatedDisk) -> None:
        super().__init__(storage=disk)
        self.disk = disk
        self.unfinished = 0

    def submit(self, job: Callable[[], None]) -> None:
        def counted() -> None:
            try:
                job()
            finally:
                with self.disk.changed:
                    self.unfinished -= 1
                    self.disk.changed.notify_all()

        with self.disk.changed:
            self.unfinished += 1
        super().submit(counted)

    def settle(self) -> None:
        """Wait until the worker waits for a permit or has nothing to do."""
        with self.disk.changed:
            quiet = self.disk.changed.wait_for(
                lambda: self.disk.waiting or not self.unfinished, PATIENCE_S
            )
        assert quiet, "the worker neither waits nor ends"


class Drive:
    """A recorder that is driven step by step."""

    def __init__(self, folder: Path) -> None:
        self.now_ns = START_NS
        self.disk = GatedDisk()
        self.worker = CountingWorker(self.disk)
        self.recording = Recording(
            folder,
            VEHICLE,
            Recorder(split_s=1.0, free_space_floor_bytes=0),
            VehicleClock(monotonic_ns=lambda: self.now_ns),
            worker=self.worker,
        )
        self.sent: list[Sent] = []
        self.lost = 0
        self._source = iter(TRAFFIC)

    def step(self, name: str) -> None:
        match name:
            case "append":
                one = next(self._source)
                self.sent.append(one)
                self.recording.append(
                    one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence
                )
            case "flush":
                self.recording.flush()
            case "split":
                self.now_ns += 2 * S
                self.recording.flush()
            case "disk":
                if self.disk.waiting:
                    with self.disk.changed:
                        self.disk.waiting = False
                    self.disk.permit()
            case "refuse":
                with self.disk.changed:
                    self.disk.refusals += 1
        self.worker.settle()

    def end(self) -> bool:
        self.disk.open()
        closed = self.recording.close(PATIENCE_S)
        self.lost += sum(loss.count for loss in self.recording.take_losses())
        return closed


def drive(steps: Sequence[str]) -> None:
    """Take the steps, let the disk go, and look at what is there."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = Drive(folder)
        for step in steps:
            run.step(step)
        assert run.end()
        assert run.lost == 0
        found, files = [], sorted(folder.glob("*.mcap*"))
        assert not [path for path in files if path.name.endswith(ACTIVE)]
        for path in files:
            with open_record(path) as record:
                messages = plain(record.messages())
                assert messages, f"{path.name} is empty"
                assert not record.damaged
            found += messages
        assert sorted(found) == sorted(plain(run.sent))
        refused = "refuse" in steps
        check_order(run.disk.calls, [path.name for path in files], refused)


def check_order(calls: list[Call], finished: list[str], refused: bool) -> None:
    """A power cut between any two calls leaves nothing worse than a file to be repaired.

    The name of a new file is on the disk before anybody relies on it, a file has its final name
    only once all of it is on the disk, and it is not touched again.
    """
    assert sorted(f for name, f in calls if name == "rename") == [f + ACTIVE for f in finished]
    for file in (name + ACTIVE for name in finished):
        of_file = [(at, name) for at, (name, each) in enumerate(calls) if each == file]
        folders = [at for at, (name, _) in enumerate(calls) if name == "sync_directory"]
        created = next(at for at, name in of_file if name == "create")
        synced = [at for at, name in of_file if name == "sync"]
        renamed = next(at for at, name in of_file if name == "rename")
        changed = [at for at, name in of_file if name in ("write", "truncate")]
        assert max(changed) < max(synced) < renamed, "renamed before all was on the disk"
        assert any(created < at < renamed for at in folders), "its name was never synced"
        assert any(renamed < at for at in folders), "its final name was never synced"
        first = min(synced)
        second = min((at for at in synced if at > first), default=len(calls))
        if not refused:  # a folder that was not synced is told, and tried again by the next flush
            named = min(at for at in folders if at > first)
            assert named < second, "a second flush relied on a name that was not on the disk"


STEPS = ("append", "flush", "split", "disk", "disk", "refuse")


@given(st.lists(st.sampled_from(STEPS), max_size=60))
@settings(deadline=None, max_examples=150)
def test_every_message_is_in_one_part_whatever_the_disk_does_meanwhile(steps):
    drive(steps)


@pytest.mark.parametrize("calls", range(9))
def test_flush_while_a_part_is_being_finished_changes_nothing(calls):
    """The bug that replaced finished records by empty files: the disk is so many calls into it."""
    for after in itertools.product(("flush", "split", "append"), repeat=3):
        for more in range(4):
            drive(["append", "split", *["disk"] * calls, *after, *["disk"] * more, "flush"])


def test_finished_record_is_never_replaced(tmp_path):
    """Whoever took the name meanwhile keeps it, and so does the record its messages."""
    worker = Worker(threaded=False)
    sink = Sink(tmp_path / "a.mcap", worker)
    sink.put(b"of the recorder")
    sink.flush()
    (tmp_path / "a.mcap").write_bytes(b"of somebody else")
    sink.finish()
    assert "exists already" in sink.error
    assert not sink.finished
    assert (tmp_path / "a.mcap").read_bytes() == b"of somebody else"
    assert sink.path.read_bytes() == b"of the recorder"
    (tmp_path / "a.mcap").unlink()
    sink.finish()
    assert sink.finished
    assert (tmp_path / "a.mcap").read_bytes() == b"of the recorder"


def test_nothing_is_put_behind_the_end(tmp_path):
    sink = Sink(tmp_path / "a.mcap", Worker(threaded=False))
    sink.put(b"all")
    sink.finish()
    with pytest.raises(ValueError, match="behind the end"):
        sink.put(b"more")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("fate", ["deleted", "moved", "its folder deleted", "another's file"])
def test_file_that_vanishes_while_it_is_written_is_written_once_more(tmp_path, fate):
    """It is still open, so all of it is still there."""
    folder, worker = tmp_path / "records", Worker(threaded=False)
    folder.mkdir()
    sink = Sink(folder / "a.mcap", worker)
    sink.put(b"before, ")
    sink.flush()
    if fate == "moved":
        sink.path.rename(tmp_path / "elsewhere")
    else:
        sink.path.unlink()
    if fate == "its folder deleted":
        folder.rmdir()
        sink.put(b"meanwhile, ")
        sink.flush()
        assert "the folder does not exist" in sink.error
        folder.mkdir()
    elif fate == "another's file":
        sink.path.write_bytes(b"of somebody else")
        sink.put(b"meanwhile, ")
        sink.flush()
        assert "exists already" in sink.error
        sink.path.unlink()
    else:
        sink.put(b"meanwhile, ")
        sink.flush()
        assert not sink.error
    sink.put(b"after")
    sink.finish()
    assert sink.finished
    assert (folder / "a.mcap").read_bytes() == b"before, meanwhile, after"
    assert list(worker.events) == [PART_RESCUED(part="a.mcap.active")]


def test_group_is_in_the_file_or_given_back_when_the_disk_hangs():
    """A recorder that ends while the disk hangs counts what hangs as lost, and lost it stays."""
    with tempfile.TemporaryDirectory() as name:
        disk = GatedDisk()
        worker = CountingWorker(disk)
        sink = Sink(Path(name) / "a.mcap", worker)
        sink.put(b"first")
        sink.flush()
        for _ in range(2):  # create, write; then it waits before the sync
            worker.settle()
            disk.waiting = False
            disk.permit()
        worker.settle()
        sink.put(b"second")
        sink.flush()
        for _ in range(2):  # the sync, the folder's
            disk.waiting = False
            disk.permit()
            worker.settle()
        assert sink.abandon(busy=True) == [b"second"]  # it waits before the write
        disk.open()
        assert worker.close(PATIENCE_S)
        assert sink.path.read_bytes() == b"first"


def test_records_are_not_for_everybody(tmp_path):
    sink = Sink(tmp_path / "a.mcap", Worker(threaded=False))
    sink.put(b"all")
    sink.finish()
    assert (tmp_path / "a.mcap").stat().st_mode & 0o777 == 0o640 & ~_umask()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
