"""Reprocessing: a ride on a bus without a network, repeated bit for bit, in one process or two."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from record_rides import CONFIG, batch, drive, wheels, written
from scripted import START_NS, VEHICLE, ManualClock, Script, Sender

from tramstream import keys
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.live import registry, snapshots
from tramstream.live.host import ProcessorNode
from tramstream.processor import Processor, Sample
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.proto.sync_pb2 import Snapshot
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess import parallel as apart
from tramstream.recorder.reprocess.parallel import part
from tramstream.recorder.reprocess.run import Rerun, rerun
from tramstream.transport.bus import LocalBus

STEPS = 600
"""Of 10 ms, each with 20 inertial samples; the wheels come every 20 ms, a fix every 200 ms."""
CRASH = 350
"""Here the processors die; their successors know nothing."""


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a recorder hears of processors that die midway; one reading is late, one is lost."""
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    clock = ManualClock()
    bus = LocalBus(clock)
    sender = Sender(bus)
    with written(path, bus):
        for steps in (range(CRASH), range(CRASH, STEPS)):
            script = Script(*drive(sender, clock, steps))
            processors = registry.make_processors(CONFIG)
            ProcessorNode(registry.PROCESSORS, VEHICLE, bus, script, processors).run()
            clock.advance(1.0)
    return path


def again(
    monkeypatch: pytest.MonkeyPatch, ride: Path, out: Path, cores: int, **options: bool
) -> Rerun:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cores)))
    return rerun(ride, out, None, **options)


@pytest.mark.parametrize("cores", [1, 2])
def test_ride_is_repeated_across_a_crash(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    result = again(monkeypatch, ride, tmp_path / "out.mcap", cores, check=True)
    assert result.comparison is not None
    assert result.comparison.differences == []
    assert result.identical
    assert result.sessions == 2
    assert result.comparison.compared > 2 * STEPS
    assert result.comparison.unanchored == 0


@pytest.mark.parametrize("option", ["check", "fresh", "smooth"])
def test_several_processes_write_the_bytes_of_one(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str
) -> None:
    one, two = tmp_path / "1" / "out.mcap", tmp_path / "2" / "out.mcap"
    for out, cores in ((one, 1), (two, 2)):
        out.parent.mkdir()
        assert again(monkeypatch, ride, out, cores, **{option: True}).outputs > 2 * STEPS
    assert one.read_bytes() == two.read_bytes()


def processor(inputs: tuple[keys.Key, ...], output: keys.Key, demanding: bool = False) -> Resampler:
    """What `part` looks at, and nothing else."""
    one = Resampler(CONFIG)
    one.inputs, one.outputs, one.demanding = inputs, (output,), demanding  # type: ignore[misc]
    return one


def test_parted_are_the_demanding_and_those_behind_them() -> None:
    first = processor((keys.IMU_BATCH, keys.SYNC_TICK), keys.SYNC_FRAME)
    beside = processor((keys.SYNC_FRAME,), keys.EST_DISTANCE)
    demanding = processor((keys.SYNC_FRAME,), keys.EST_STATE, demanding=True)
    behind = processor((keys.EST_STATE,), keys.EST_LOCATION)
    assert part([beside, first]) == ([beside, first], [])
    assert part([behind, beside, demanding, first]) == ([beside, first], [behind, demanding])


@pytest.mark.parametrize("other", [keys.ODO_WHEELS, keys.SYNC_TICK, keys.EST_DISTANCE])
def test_what_would_see_another_order_is_not_parted(other: keys.Key) -> None:
    first = processor((keys.IMU_BATCH, keys.SYNC_TICK), keys.SYNC_FRAME)
    beside = processor((keys.SYNC_FRAME,), keys.EST_DISTANCE)
    demanding = processor((keys.SYNC_FRAME, other), keys.EST_STATE, demanding=True)
    assert part([first, beside, demanding]) == ([first, beside, demanding], [])


@pytest.mark.parametrize("cores", [1, 2])
def test_difference_is_named(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    take = Resampler._take_window

    def heat(self: Resampler, window: object, batch: ImuBatch, results: list) -> None:
        take(self, window, batch, results)
        results[-1].message.temperature_degc += 1.0

    monkeypatch.setattr(Resampler, "_take_window", heat)
    result = again(monkeypatch, ride, tmp_path / "out.mcap", cores, check=True)
    assert not result.identical
    assert result.comparison is not None
    assert result.comparison.differences[0].startswith(keys.SYNC_IMU.path)
    assert "temperature_degc was 0.0, is now 1.0" in result.comparison.differences[0]


@pytest.mark.parametrize("cores", [1, 2])
@pytest.mark.parametrize("where", [Resampler, LocalisationFilter])
def test_bug_in_a_processor_is_raised_wherever_it_runs(
    ride: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cores: int,
    where: type[Processor],
) -> None:
    monkeypatch.setattr(where, "step", lambda self, sample: [1 // 0])
    with pytest.raises(ZeroDivisionError):
        again(monkeypatch, ride, tmp_path / "out.mcap", cores)
    assert not (tmp_path / "out.mcap").exists()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("where", "doing"), [(Resampler, apart.READING), (LocalisationFilter, apart.FOLLOWING)]
)
def test_other_process_that_is_killed_is_told(
    ride: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    where: type[Processor],
    doing: str,
) -> None:
    here, step = os.getpid(), where.step

    def die(self: Processor, sample: Sample) -> list[Sample]:
        assert os.getpid() != here
        if sample.stamp_ns > START_NS + 2 * S:
            os.kill(os.getpid(), signal.SIGKILL)
        return step(self, sample)

    monkeypatch.setattr(where, "step", die)
    with pytest.raises(RecordError, match=f"{doing} was killed"):
        again(monkeypatch, ride, tmp_path / "out.mcap", 2)
    assert not multiprocessing.active_children()


def test_interrupted_run_ends_all_processes(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(self: RecordFile, *sent: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(RecordFile, "append", interrupt)
    with pytest.raises(KeyboardInterrupt):
        again(monkeypatch, ride, tmp_path / "out.mcap", 2)
    assert not multiprocessing.active_children()


def test_pipes_smaller_than_what_goes_through_block_nobody(
    ride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "PIPE_BYTES", 4096)
    result = again(monkeypatch, ride, tmp_path / "out.mcap", 2, check=True)
    assert result.identical


# Late samples ------------------------------------------------------------------------------------
@pytest.mark.parametrize("cores", [1, 2])
def test_late_samples_are_the_same_in_whatever_order_they_are_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    """Between two ticks readings are fed before batches, whichever came first live."""
    path, clock = tmp_path / "ride.mcap", ManualClock()
    bus = LocalBus(clock)
    sender = Sender(bus)

    def messages() -> Iterator[Callable[[], None]]:
        for step, send in enumerate(drive(sender, clock, range(STEPS // 2))):
            yield send
            if step in (150, 250):
                for late in (90, 91, 92):
                    yield partial(sender.send, keys.IMU_BATCH, batch(late))
                    yield partial(sender.send, keys.ODO_WHEELS, wheels(late))

    with written(path, bus):
        processors = registry.make_processors(CONFIG)
        ProcessorNode(registry.PROCESSORS, VEHICLE, bus, Script(*messages()), processors).run()
    result = again(monkeypatch, path, tmp_path / "out.mcap", cores, check=True)
    assert result.comparison is not None
    assert result.comparison.differences == []
    assert result.identical
    with open_record(path) as record:
        late = [message for _, message in record.decoded(lambda topic: topic.endswith("late"))]
    assert {each.key for each in late} >= {keys.IMU_BATCH.path, keys.ODO_WHEELS.path}


# Memory that is of no use -------------------------------------------------------------------------
def middle_of(ride: Path, path: Path, change: Callable[[Snapshot], None]) -> Path:
    """The record from its second session on, as `change` leaves the memory in it."""
    with open_record(ride) as record, RecordFile(path, VEHICLE, record.metadata) as target:
        sessions: set[int] = set()
        for entry in record.messages():
            key = keys.find(keys.split(entry.topic)[1])
            assert key is not None
            payload = entry.payload
            if key is keys.SYNC_SNAPSHOT:
                snapshot = Snapshot.FromString(payload)
                sessions.add(snapshot.session)
                change(snapshot)
                payload = snapshot.SerializeToString()
            if len(sessions) > 1:
                sent = entry.log_ns, entry.publish_ns, entry.sequence
                target.append(entry.topic, key, payload, *sent)
    return path


def in_mid_ride(snapshot: Snapshot) -> None:
    snapshot.tick_sequence, snapshot.start = 7, False


def of_another_version(snapshot: Snapshot) -> None:
    in_mid_ride(snapshot)
    for each in snapshot.states:
        state = snapshots.unpack(each.state)
        if each.name == "resampler":
            state["memory"]["lately"] = state["memory"].pop("horizon_ns")
        each.state = snapshots.pack(state)


def of_other_processors(snapshot: Snapshot) -> None:
    in_mid_ride(snapshot)
    snapshot.states[0].name = "grade"


@pytest.mark.parametrize("cores", [1, 2])
@pytest.mark.parametrize(
    ("change", "unfit"), [(in_mid_ride, 0), (of_another_version, 1), (of_other_processors, 1)]
)
def test_memory_of_another_version_is_said_and_begun_afresh(
    ride: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Snapshot], None],
    unfit: int,
    cores: int,
) -> None:
    middle = middle_of(ride, tmp_path / "middle.mcap", change)
    result = again(monkeypatch, middle, tmp_path / "out.mcap", cores)
    assert result.unfit == unfit
    assert result.sessions == 1
    assert result.outputs > STEPS // 2
