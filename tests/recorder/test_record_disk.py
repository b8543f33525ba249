"""The folder of records: parts, space, trouble with the disk, and what a start finds."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import disks
import pytest
from disks import Watched, refusing
from live import finished
from record_samples import START_NS, VEHICLE, active, plain, read, traffic

from tramstream.clock import S, VehicleClock
from tramstream.config import Recorder
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.events import (
    EMPTY_DELETED,
    FOLDER_REFUSED,
    NO_SPACE,
    PART_DELETED,
    PART_REPAIRED,
    SPACE_HELD,
)
from tramstream.recorder.file.events import DISK_REFUSES
from tramstream.recorder.file.repair import REDO
from tramstream.recorder.file.sink import Worker
from tramstream.recorder.reader import open_record
from tramstream.recorder.recording import Recording
from tramstream.recorder.space import FreeSpace


class Time:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.ns = START_NS
        self.clock = VehicleClock(monotonic_ns=lambda: self.ns)


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def recording(tmp_path, time):
    settings = Recorder(split_s=1.0, free_space_floor_bytes=0)
    worker = Worker(threaded=False, storage=Watched())
    return Recording(tmp_path, VEHICLE, settings, time.clock, {"config": "x"}, worker)


def disk_of(recording) -> Watched:
    return recording._worker.storage


def feed(recording, time, sent, flush_every=100):
    for number, one in enumerate(sent, 1):
        time.ns = one.log_ns
        recording.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
        if number % flush_every == 0:
            recording.flush()


def test_parts_can_be_read_alone_and_together(recording, time, tmp_path):
    assert recording.start() == []
    sent = traffic(1600)
    feed(recording, time, sent)
    assert recording.path is not None
    assert recording.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    (tmp_path / ".boot").unlink()
    assert names == [
        ".boot",
        "4711_b0001-0001_20260921T141320Z.mcap",
        "4711_b0001-0002_20260921T141321Z.mcap",
        "4711_b0001-0003_20260921T141322Z.mcap",
    ]
    with open_record(tmp_path) as record:
        assert plain(record.messages()) == plain(sent)
        ids = [{c.topic: id_ for id_, c in file.channels.items()} for file in record.files]
        assert ids[0] == ids[1] == ids[2]
        assert [file.part for file in record.files] == [1, 2, 3]
        assert len({file.session for file in record.files}) == 1
        assert all(file.metadata["config"] == "x" for file in record.files)
    for path in tmp_path.iterdir():
        with open_record(path) as record:
            decoded = [record.decode(entry) for entry in record.messages()]
        assert len(decoded) >= 300


def test_idle_recording_leaves_no_file(recording, time, tmp_path):
    recording.start()
    for _ in range(10):
        time.ns += S
        recording.flush()
    assert recording.close()
    assert [path.name for path in tmp_path.iterdir()] == [".boot"]


def test_name_that_somebody_took_meanwhile_is_stepped_over(recording, time, tmp_path):
    recording.start()
    taken = tmp_path / "4711_b0001-0001_20260921T141320Z.mcap"
    taken.write_bytes(b"old")
    feed(recording, time, traffic(3))
    assert recording.close()
    assert taken.read_bytes() == b"old"
    assert read(tmp_path / "4711_b0001-0002_20260921T141320Z.mcap") == plain(traffic(3))


def test_start_repairs_what_was_left(recording, tmp_path):
    active(tmp_path / "4711_a_01.mcap", traffic(100), 30)
    (tmp_path / "4711_b_01.mcap.active").write_bytes(b"")
    (tmp_path / "gone.mcap.repair").write_bytes(b"rest")
    repaired, deleted = recording.start()
    assert repaired.kind is PART_REPAIRED
    assert (repaired.facts["part"], repaired.facts["messages"]) == ("4711_a_01.mcap.active", 100)
    assert deleted == EMPTY_DELETED(part="4711_b_01.mcap.active")
    assert [path.name for path in tmp_path.glob("*.mcap*")] == ["4711_a_01.mcap"]
    assert read(tmp_path / "4711_a_01.mcap") == plain(traffic(100))
    assert not list(tmp_path.glob(f"*{REDO}"))


class Disk:
    """A disk of a given size under one folder."""

    def __init__(self, folder: Path, size: int) -> None:
        self.folder, self.size, self.held = folder, size, 0

    def free(self, folder: Path) -> int:
        return self.size - self.held - sum(p.stat().st_blocks * 512 for p in folder.iterdir())


def filled(folder: Path, days: int) -> list[Path]:
    paths = [folder / f"4711_202609{day:02d}T120000Z_01.mcap" for day in range(1, days + 1)]
    for path in paths:
        path.write_bytes(os.urandom(100_000))
    return paths


def test_oldest_unprotected_record_goes_first(tmp_path):
    paths = filled(tmp_path, 5)
    (tmp_path / f"{paths[0].name}.keep").touch()
    (tmp_path / "mine.mcap").write_bytes(bytes(100_000))
    (tmp_path / "4711_20260801T120000Z_01.mcap.active").write_bytes(bytes(100_000))
    space = FreeSpace(tmp_path, 300_000, Disk(tmp_path, 850_000).free)
    space.check(0)
    assert [path.exists() for path in paths] == [True, False, False, True, True]
    assert [event.kind for event in space.events] == [PART_DELETED, PART_DELETED]
    assert space.events[0].facts["part"] == paths[1].name
    assert space.events[0].facts["free_bytes"] < space.floor_bytes
    assert space.blocked is None
    space.floor_bytes = 800_000
    space.check(0)
    assert [path.exists() for path in paths] == [True, False, False, False, False]
    assert (tmp_path / "mine.mcap").exists()
    assert (tmp_path / "4711_20260801T120000Z_01.mcap.active").exists()
    free_bytes = space._free_bytes(tmp_path)
    facts = {"free_bytes": free_bytes, "floor_bytes": 800_000}
    assert space.blocked == NO_SPACE(folder=tmp_path, **facts)


def test_deleting_stops_while_deleted_bytes_are_not_free(tmp_path):
    """Somebody reads the deleted file: deleting on would eat every record."""
    paths = filled(tmp_path, 4)
    space = FreeSpace(tmp_path, 10_000, lambda folder: 5_000)
    space.check(0)
    assert [path.exists() for path in paths] == [False, True, True, True]
    assert space.events[1] == SPACE_HELD(part=paths[0].name)
    space.check(S)
    assert paths[1].exists()
    assert space.blocked is None
    space.check(61 * S)
    assert not paths[1].exists()


def test_recording_stops_below_the_floor_counts_and_resumes(recording, time, tmp_path):
    recording.start()
    sent = traffic(300)
    feed(recording, time, sent[:100])
    recording.space._free_bytes = lambda folder: 10
    recording.space.floor_bytes = 1000
    recording.flush()
    feed(recording, time, sent[100:200], flush_every=10)
    assert recording.state == NodeHealth.FAILED
    assert recording.trouble is not None
    assert recording.trouble.kind is NO_SPACE
    losses = recording.take_losses()
    assert sum(loss.count for loss in losses) == 100
    first = next(loss for loss in losses if loss.topic == sent[100].topic)
    assert first.after_publish_ns < sent[100].publish_ns < first.before_publish_ns
    recording.space._free_bytes = lambda folder: 10_000
    recording.flush()
    assert recording.state == NodeHealth.OK
    feed(recording, time, sent[200:])
    assert recording.close()
    with open_record(tmp_path) as record:
        assert plain(record.messages()) == plain(sent[:100] + sent[200:])


def test_refused_write_is_cut_off_and_tried_again(recording, time, tmp_path, monkeypatch):
    recording.start()
    sent = traffic(400)
    feed(recording, time, sent[:100])
    sink = recording._file._sink
    room = [700]

    def small(self, fd, data, offset):
        if room[0] <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = os.pwrite(fd, data[: room[0]], offset)
        room[0] -= written
        return written

    monkeypatch.setattr(Watched, "write", small)
    good = sink.path.stat().st_size
    feed(recording, time, sent[100:200])
    assert sink.path.stat().st_size == good
    assert recording.state == NodeHealth.DEGRADED
    assert recording.trouble.kind is DISK_REFUSES
    assert recording.trouble.facts["reason"] == "the disk is full"
    assert recording.trouble.facts["waiting_bytes"] > 0
    assert read(sink.path) == plain(sent[:100])
    room[0] = 1 << 40
    feed(recording, time, sent[200:])
    assert recording.state == NodeHealth.OK
    assert recording.take_losses() == []
    assert recording.close()
    with open_record(tmp_path) as record:
        assert plain(record.messages()) == plain(sent)


def test_what_a_full_disk_never_took_is_counted_at_the_end(recording, time, tmp_path):
    recording.start()
    sent = traffic(300)
    feed(recording, time, sent[:100])
    disk_of(recording).before = refusing("write", errno.ENOSPC)
    feed(recording, time, sent[100:])
    assert not recording.close()
    assert sum(loss.count for loss in recording.take_losses()) == 200
    (left,) = tmp_path.glob("*.mcap*")
    assert read(left) == plain(sent[:100])


def test_failed_sync_makes_the_recording_go_on_in_another_file(recording, time, tmp_path):
    recording.settings = Recorder(split_s=1000.0, free_space_floor_bytes=0)
    recording.start()
    sent = traffic(200)
    feed(recording, time, sent[:100])
    disk, before = disk_of(recording), disk_of(recording).before
    disk.before = refusing("sync", errno.EIO)
    feed(recording, time, sent[100:150], flush_every=10)
    assert recording.part == 1
    assert recording.trouble.kind is DISK_REFUSES
    assert recording.trouble.facts["advice"] == "replace it"
    time.ns += 11 * S
    recording.flush()
    disk.before = before
    feed(recording, time, sent[150:])
    assert recording.part == 2
    assert recording.close()
    with open_record(tmp_path) as record:
        assert plain(record.messages()) == plain(sent)


def test_what_a_failed_sync_may_have_cost_is_written_again(recording, time, tmp_path):
    """The kernel drops pages that it could not write and reports that once only."""
    recording.start()
    sent = traffic(200)
    feed(recording, time, sent[:100])
    disk, before = disk_of(recording), disk_of(recording).before
    path = recording._file._sink.path
    safe = path.stat().st_size
    disk.before = refusing("sync", errno.EIO)
    feed(recording, time, sent[100:])
    with path.open("r+b") as file:  # what the kernel makes of it
        file.seek(safe)
        file.write(bytes(path.stat().st_size - safe))
    disk.before = before
    recording.flush()
    assert recording.state == NodeHealth.OK
    assert recording.close()
    with open_record(tmp_path) as record:
        assert plain(record.messages()) == plain(sent)
        assert not record.damaged


def test_folder_that_cannot_be_made_is_told_and_tried_again(tmp_path, time):
    blocker = tmp_path / "usb"
    blocker.touch()
    recording = Recording(
        blocker / "records",
        VEHICLE,
        Recorder(free_space_floor_bytes=0),
        time.clock,
        None,
        Worker(threaded=False),
    )
    assert recording.start() == []
    feed(recording, time, traffic(10))
    assert recording.state == NodeHealth.FAILED
    assert recording.trouble.kind is FOLDER_REFUSED
    assert recording.trouble.facts["folder"] == str(blocker / "records")
    assert sum(loss.count for loss in recording.take_losses()) == 10
    blocker.unlink()
    recording.flush()
    feed(recording, time, traffic(10))
    assert recording.close()
    assert [read(path) for path in (blocker / "records").glob("*.mcap")] == [plain(traffic(10))]


WRITER = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from disks import Watched, refusing
from record_samples import VEHICLE, append, traffic
from tramstream.config import Recorder
from tramstream.recorder.recording import Recording
from tramstream.recorder.file.sink import Worker
from tramstream.clock import VehicleClock
import resource
if sys.argv[3] != "0":
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
recording = Recording(
    Path(sys.argv[2]), VEHICLE, Recorder(free_space_floor_bytes=0), VehicleClock()
)
recording.start()
append(recording, traffic(3000), 100)
states = recording.state, recording.trouble
print(recording.close(), sum(loss.count for loss in recording.take_losses()), sep=";")
"""


def run_writer(folder: Path, limit: int) -> list[str]:
    done = finished(
        [sys.executable, "-c", WRITER, str(Path(disks.__file__).parent), str(folder), str(limit)],
        check=True,
    )
    return done.stdout.strip().split(";")


@pytest.mark.live
def test_file_size_limit_of_the_system_harms_nothing_written(tmp_path):
    closed, dropped = run_writer(tmp_path, 100_000)
    (left,) = tmp_path.glob("*.mcap*")
    found = read(left)
    assert closed == "False"
    assert left.stat().st_size <= 100_000
    assert 0 < len(found) == 3000 - int(dropped)
    assert found == plain(traffic(3000)[: len(found)])
    with open_record(left) as record:
        assert not record.damaged


@pytest.mark.live
def test_full_file_system_harms_nothing_written(tmp_path):
    mounted = finished(["mount", "-t", "tmpfs", "-o", "size=128k", "none", str(tmp_path)])
    if mounted.returncode:
        pytest.skip("mount is not allowed here")
    try:
        closed, dropped = run_writer(tmp_path, 0)
        (left,) = tmp_path.glob("*.mcap*")
        found = read(left)
        with open_record(left) as record:
            assert not record.damaged
    finally:
        finished(["umount", str(tmp_path)], check=True)
    assert closed == "False"
    assert 0 < len(found) == 3000 - int(dropped)
    assert found == plain(traffic(3000)[: len(found)])
