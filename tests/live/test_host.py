"""Processors on a bus: dispatch, ticks with positions, memory across a restart, devices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from scripted import START_NS, VEHICLE, Ear, FakePort, Impatient, ManualClock, Script, Sender, raw

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Imu, Vehicle
from tramstream.errors import DeviceError
from tramstream.events.kinds import Event
from tramstream.events.messages import facts_of
from tramstream.live import snapshots
from tramstream.live.events import NOT_USED, PORT_FAILED, UNDECODABLE
from tramstream.live.host import Memory, ProcessorNode
from tramstream.processor import Processor, Sample, State
from tramstream.processors.distance.processor import DistanceFilter
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import DeviceHealth, NodeHealth
from tramstream.proto.raw_pb2 import CanFrames, ImuBatch, Odometry, WheelReading
from tramstream.proto.sync_pb2 import ImuMean, Snapshot, SyncFrame, Tick
from tramstream.transport.bus import LocalBus

MS = S // 1000


class Remembering(Processor):
    """Emits one `output` for each sample of its inputs."""

    name = "first"
    inputs = (keys.GNSS_FIX, keys.SYNC_TICK)
    outputs = (keys.SYNC_FRAME,)

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[str] = []
        self.ticks: list[Tick] = []

    def step(self, sample: Sample) -> list[Sample]:
        self.seen.append(sample.key.path)
        if sample.key is keys.SYNC_TICK:
            self.ticks.append(sample.message)
            return []
        return [self.emit(keys.SYNC_FRAME, SyncFrame(), sample.stamp_ns)]

    def snapshot(self) -> State:
        return {"sequences": self.sequences(), "seen": list(self.seen)}

    def restore(self, state: State) -> None:
        self.restore_sequences(state["sequences"])
        self.seen = list(state["seen"])


class Following(Remembering):
    """Takes what the first one makes; every third is one too many for it."""

    name = "second"
    inputs = (keys.SYNC_FRAME,)
    outputs = (keys.SYNC_IMU,)

    def step(self, sample: Sample) -> list[Sample]:
        self.seen.append(sample.key.path)
        if sample.sequence % 3 == 0:
            raise RuntimeError("three")
        return [self.emit(keys.SYNC_IMU, ImuMean(), sample.stamp_ns)]


class Decoder(Remembering):
    """Emits a batch for each read of the IMU, as a bridge does."""

    name = "imu"
    inputs = (keys.IMU_BYTES,)
    outputs = (keys.IMU_BATCH,)

    def step(self, sample: Sample) -> list[Sample]:
        if b"!" in sample.message.data:
            raise ValueError("cannot decode")
        return [self.emit(keys.IMU_BATCH, ImuBatch(gyro_x=[1]), sample.stamp_ns)]

    def device_counters(self) -> dict[str, Any]:
        return {"samples_lost": 3, "rejected_by_reason": {"checksum": 2}, "clock_skew_ppm": None}


class World:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.bus = LocalBus(self.clock)
        self.sender = Sender(self.bus)
        self.ear = Ear(self.bus)

    def fix(self, stamp_ns: int | None = None) -> None:
        stamp_ns = self.clock.now_ns() if stamp_ns is None else stamp_ns
        self.sender.send(keys.GNSS_FIX, GnssFix(stamp_ns=stamp_ns))

    def run(
        self, processors: Sequence[Processor], *steps: Any, path: Path | None = None
    ) -> ProcessorNode:
        node = ProcessorNode(
            "processors", VEHICLE, self.bus, Script(*steps), processors, (), Memory(path)
        )
        node.run()
        return node

    def read(self, script: Sequence[Any], key: keys.Key = keys.IMU_BYTES) -> ProcessorNode:
        """Run a bridge on a device until the script is at its end."""
        stop = Impatient()
        port = FakePort(script, stop, key)
        node = ProcessorNode("imu", VEHICLE, self.bus, stop, [Decoder()], [port])
        node.run()
        return node


@pytest.fixture
def world() -> World:
    return World()


# Dispatch -----------------------------------------------------------------------------------------
def test_outputs_go_to_the_bus_and_to_the_processors_that_want_them(world: World) -> None:
    first, second = Remembering(), Following()
    world.run([first, second], world.fix, world.fix)
    assert second.seen == [keys.SYNC_FRAME.path] * 2
    assert [m.sequence for m in world.ear.heard(keys.SYNC_FRAME)] == [1, 2]
    assert [m.sequence for m in world.ear.heard(keys.SYNC_IMU)] == [1, 2]
    published = [path for path in world.ear.paths() if path.startswith(("raw", "sync/fusion"))]
    assert published == [keys.GNSS_FIX.path, keys.SYNC_FRAME.path] * 2


def test_what_is_made_here_is_not_subscribed(world: World) -> None:
    node = ProcessorNode("p", VEHICLE, world.bus, Script(), [Remembering(), Following()])
    assert node.expressions() == [keys.GNSS_FIX.path]


def test_processor_that_raises_is_told_and_the_others_go_on(world: World) -> None:
    first, second = Remembering(), Following()
    node = world.run([first, second], *[world.fix] * 7)
    assert len(world.ear.heard(keys.SYNC_FRAME)) == 7
    assert len(world.ear.heard(keys.SYNC_IMU)) == 5
    assert node.faults == 2
    assert "RuntimeError: three" in world.ear.heard(keys.LOG)[0].message
    assert world.ear.heard(keys.HEARTBEAT)[-1].state == NodeHealth.DEGRADED


def test_message_that_is_garbage_is_refused_and_no_fault(world: World) -> None:
    def garbage() -> None:
        world.bus.publish(keys.GNSS_FIX.on(VEHICLE), b"\xff\xff", keys.GNSS_FIX.encoding, 1)

    first = Remembering()
    node = world.run([first], garbage, world.fix)
    assert node.faults == 0
    assert node.refusals.count == 1
    assert first.seen.count(keys.GNSS_FIX.path) == 1
    beat = world.ear.heard(keys.HEARTBEAT)[-1]
    assert beat.state == NodeHealth.DEGRADED
    assert "raw/gnss/fix holds bytes that are no tramstream.GnssFix" in beat.text
    facts = {"key": keys.GNSS_FIX.on(VEHICLE), "reason": "no tramstream.GnssFix"}
    (event,) = world.ear.heard(keys.EVENT)
    assert (event.kind, facts_of(event)) == (UNDECODABLE.name, facts)
    assert [trouble.kind for trouble in beat.troubles] == [UNDECODABLE.name, NOT_USED.name]
    (log,) = world.ear.heard(keys.LOG)
    assert (log.message, log.file) == (str(UNDECODABLE(**facts)), UNDECODABLE.name)
    assert log.timestamp.ToNanoseconds() == event.stamp_ns


# Ticks --------------------------------------------------------------------------------------------
def test_no_time_passes_before_the_first_input(world: World) -> None:
    first = Remembering()
    world.run([first], *[lambda: world.clock.advance(0.1)] * 20)
    assert first.ticks == []
    assert world.ear.heard(keys.SYNC_TICK) == []


def test_ticks_come_ten_times_a_second_and_are_published(world: World) -> None:
    first = Remembering()
    world.run([first], world.fix, *[lambda: world.clock.advance(0.1)] * 20)
    assert len(first.ticks) == 21  # the last at the end
    assert [tick.sequence for tick in world.ear.heard(keys.SYNC_TICK)] == list(range(1, 22))
    assert len({tick.session for tick in first.ticks}) == 1


def test_ticks_say_how_far_every_input_was_read(world: World) -> None:
    first = Remembering()
    world.run(
        [first],
        world.fix,
        world.fix,
        lambda: world.clock.advance(0.1),
        world.fix,
        lambda: world.clock.advance(0.1),
    )
    fixes = [e for e in world.ear.envelopes if e.topic == keys.GNSS_FIX.on(VEHICLE)]
    for tick, count in zip(first.ticks, (2, 3, 3), strict=True):
        (position,) = tick.positions
        assert (position.key, position.count) == (keys.GNSS_FIX.path, count)
        assert position.first_publish_ns == fixes[0].publish_ns
        assert position.last_publish_ns == fixes[count - 1].publish_ns


@pytest.mark.parametrize("age_s", [0.15, -0.02, 40_000_000.0])
def test_event_time_follows_the_stamps_also_of_an_old_record(world: World, age_s: float) -> None:
    first = Remembering()
    steps: list[Any] = []
    for _ in range(60):
        steps += [
            lambda: world.fix(world.clock.now_ns() - round(age_s * S)),
            lambda: world.clock.advance(0.1),
        ]
    world.run([first], *steps)
    now_ns = START_NS
    for tick in first.ticks[:-1]:
        now_ns += 100 * MS
        assert tick.stamp_ns == now_ns - round(age_s * S)


def test_tick_stamps_never_fall_although_the_lead_does(world: World) -> None:
    first = Remembering()
    steps: list[Any] = []
    for index in range(100):
        age_ns = 10 * MS if index < 10 else 180 * MS
        steps += [
            lambda age_ns=age_ns: world.fix(world.clock.now_ns() - age_ns),
            lambda: world.clock.advance(0.1),
        ]
    world.run([first], *steps)
    stamps = [tick.stamp_ns for tick in first.ticks]
    assert stamps == sorted(stamps)
    assert world.clock.now_ns() - stamps[-1] == 180 * MS


def test_event_time_is_that_of_the_promptest_input_of_two_seconds(world: World) -> None:
    """One fix in fifteen comes after 10 ms, the others wait 60 ms: the wait is no event time."""
    first = Remembering()
    steps: list[Any] = []
    for index in range(150):
        age_ns = 10 * MS if index % 15 == 0 else 60 * MS
        steps += [
            lambda age_ns=age_ns: world.fix(world.clock.now_ns() - age_ns),
            lambda: world.clock.advance(0.1),
        ]
    world.run([first], *steps)
    assert len(first.ticks) > 140
    ages_ns = {START_NS + (n + 1) * 100 * MS - t.stamp_ns for n, t in enumerate(first.ticks[:-1])}
    assert ages_ns == {10 * MS}


def test_one_device_with_broken_stamps_does_not_move_event_time(world: World) -> None:
    class Wide(Remembering):
        inputs = (keys.GNSS_FIX, keys.ODO_WHEELS, keys.IMU_BATCH, keys.SYNC_TICK)

        def step(self, sample: Sample) -> list[Sample]:
            return super().step(sample) if sample.key is keys.SYNC_TICK else []

    first = Wide()
    steps: list[Any] = []
    for _ in range(30):
        steps += [
            lambda: world.sender.send(keys.IMU_BATCH, ImuBatch(stamp_ns=world.clock.now_ns())),
            lambda: world.fix(world.clock.now_ns() + 3600 * S),
            lambda: world.sender.send(keys.ODO_WHEELS, Odometry(stamp_ns=world.clock.now_ns())),
            lambda: world.clock.advance(0.1),
        ]
    world.run([first], *steps)
    assert all(tick.stamp_ns <= world.clock.now_ns() for tick in first.ticks)


def test_process_that_stood_still_does_not_take_its_backlog_for_silence(world: World) -> None:
    """Two seconds without a turn of the loop, in which the sensors went on."""
    vehicle = Vehicle(vehicle=VEHICLE, imu=Imu(device="none"))

    def inertial(count: int) -> None:
        for _ in range(count):
            world.clock.advance(0.01)
            stamp_ns = world.clock.now_ns()
            first = (stamp_ns - START_NS) // (S // 2000)
            columns = {name: [0] * 20 for name in ("gyro_x", "gyro_y", "gyro_z")}
            columns |= {name: [0] * 20 for name in ("accel_x", "accel_y", "accel_z")}
            batch = ImuBatch(
                stamp_ns=stamp_ns, period_ns=5e5, first_sample_sequence=first, **columns
            )
            world.sender.send(keys.IMU_BATCH, batch)

    world.run(
        [Resampler(vehicle)],
        *[lambda: inertial(1)] * 100,
        lambda: inertial(200),
        *[lambda: inertial(1)] * 100,
    )
    assert world.ear.heard(keys.SYNC_LATE) == []
    frames = world.ear.heard(keys.SYNC_FRAME)
    assert len(frames) > 350
    assert all(frame.HasField("imu") for frame in frames)


# Memory -------------------------------------------------------------------------------------------
def test_snapshots_are_published_at_the_start_now_and_then_and_at_the_end(world: World) -> None:
    world.run([Remembering()], world.fix, *[lambda: world.clock.advance(0.1)] * 650)
    found = world.ear.heard(keys.SYNC_SNAPSHOT)
    assert [snapshot.start for snapshot in found] == [True, False, False, False]
    assert found[0].tick_sequence == 0
    assert found[-1].tick_sequence == world.ear.heard(keys.SYNC_TICK)[-1].sequence
    state = snapshots.unpack(found[-1].states[0].state)
    assert keys.GNSS_FIX.path in state["seen"]
    seconds = [(each.stamp_ns - found[0].stamp_ns) / S for each in found]
    assert seconds == pytest.approx([0.0, 30.0, 60.0, 65.0], abs=5.1)


def test_memory_on_disk_is_never_older_than_five_seconds(world: World, tmp_path: Path) -> None:
    path = tmp_path / "s"
    ages_s: list[float] = []

    def look() -> None:
        world.clock.advance(0.1)
        found = snapshots.load(path, world.clock.now_ns())
        if found is not None:
            ages_s.append((world.clock.now_ns() - found.stamp_ns) / S)

    world.run([Remembering()], world.fix, *[look] * 300, path=path)
    assert len(ages_s) == 300
    assert 4.0 < max(ages_s) < 5.5


def ride(world: World, begin: int, end: int) -> list[Any]:
    """Steps of a ride: wheels at 50 Hz, and time passing in between."""

    def read(index: int) -> None:
        world.clock.advance(0.02)
        counts = [WheelReading(wheel="left", pulses=50 * index)]
        world.sender.send(
            keys.ODO_WHEELS, Odometry(stamp_ns=START_NS + index * 20 * MS, wheels=counts)
        )

    return [lambda index=index: read(index) for index in range(begin, end)]


def test_second_node_goes_on_where_the_first_one_was(tmp_path: Path) -> None:
    vehicle = Vehicle(vehicle=VEHICLE)

    def processors() -> list[Processor]:
        return [DistanceFilter(vehicle), Resampler(vehicle)]

    path = tmp_path / "processors.snapshot"
    world = World()
    world.run(processors(), *ride(world, 1, 500), path=path)
    world.run(processors(), *ride(world, 500, 1000), path=path)
    outputs = world.ear.heard(keys.EST_DISTANCE)
    assert [output.sequence for output in outputs] == list(range(1, len(outputs) + 1))
    distances = [output.distance_m for output in outputs]
    assert distances == sorted(distances)
    logs = [log.message for log in world.ear.heard(keys.LOG)]
    assert any("goes on from the memory" in log for log in logs)
    starts = [s for s in world.ear.heard(keys.SYNC_SNAPSHOT) if s.start]
    assert len({snapshot.session for snapshot in starts}) == 2
    whole = World()
    whole.run(processors(), *ride(whole, 1, 1000))
    assert distances[-1] == pytest.approx(whole.ear.heard(keys.EST_DISTANCE)[-1].distance_m)


def test_unfit_memory_does_not_keep_a_node_from_starting(world: World, tmp_path: Path) -> None:
    path = tmp_path / "s"
    world.run([Remembering()], world.fix, path=path)
    snapshot = snapshots.load(path, world.clock.now_ns())
    assert isinstance(snapshot, Snapshot)
    snapshot.states[0].state = snapshots.pack({"of": "another version"})
    snapshots.save(path, snapshot)
    first = Remembering()
    world.run([first], world.fix, path=path)
    assert first.seen.count(keys.GNSS_FIX.path) == 1
    assert any("starting afresh" in log.message for log in world.ear.heard(keys.LOG))


def test_snapshot_file_that_cannot_be_written_is_told_and_no_more(
    world: World, tmp_path: Path
) -> None:
    node = world.run([Remembering()], world.fix, path=tmp_path / "absent" / "s")
    assert node.faults > 0
    assert len(world.ear.heard(keys.SYNC_FRAME)) == 1
    assert "FileNotFoundError" in world.ear.heard(keys.LOG)[0].message


# Devices ------------------------------------------------------------------------------------------
def test_reads_are_joined_published_and_the_last_of_them_too(world: World) -> None:
    world.read([raw(b"ab", 0.0), raw(b"c", 0.005), raw(b"d", 0.01)])
    found = world.ear.heard(keys.IMU_BYTES)
    assert b"".join(message.data for message in found) == b"abcd"
    assert [m.sequence for m in found] == list(range(1, len(found) + 1))
    arrivals = [m.stamp_ns + offset_ns for m in found for offset_ns in m.read_offset_ns]
    assert arrivals == [START_NS, START_NS + 5 * MS, START_NS + 10 * MS]
    assert len(world.ear.heard(keys.IMU_BATCH)) == 3


def test_bytes_that_the_decoder_chokes_on_are_in_the_record_all_the_same(world: World) -> None:
    node = world.read([raw(b"ok"), raw(b"bad!"), raw(b"ok")])
    assert b"".join(m.data for m in world.ear.heard(keys.IMU_BYTES)) == b"okbad!ok"
    assert len(world.ear.heard(keys.IMU_BATCH)) == 2
    assert node.faults == 1


def test_can_frames_are_joined_and_published_with_numbers(world: World) -> None:
    frames = [
        CanFrames(stamp_ns=START_NS + n, offset_ns=[0], id=[n], flags=[0], data=[b"x"])
        for n in range(3)
    ]
    world.read(frames, keys.ODO_FRAMES)
    found = world.ear.heard(keys.ODO_FRAMES)
    assert [id_ for message in found for id_ in message.id] == [0, 1, 2]
    assert [message.sequence for message in found] == list(range(1, len(found) + 1))
    arrivals = [m.stamp_ns + offset_ns for m in found for offset_ns in m.offset_ns]
    assert arrivals == [START_NS, START_NS + 1, START_NS + 2]


def test_device_that_is_lost_and_back_is_told_in_health(world: World) -> None:
    world.read([raw(b"a"), DeviceError("/dev/fake: unplugged; plug it in"), raw(b"b")])
    last = world.ear.heard(keys.DEVICE)[-1]
    assert (last.device, last.port, last.opened, last.bytes_received) == ("imu", "/dev/fake", 2, 2)
    assert last.state == DeviceHealth.OPEN
    assert last.samples_lost == 3
    assert last.rejected_by_reason == {"checksum": 2}
    assert not last.HasField("clock_skew_ppm")


class Complainer(Decoder):
    """A bridge that understands nothing of what comes."""

    def device_troubles(self) -> list[Event]:
        return [PORT_FAILED(device="/dev/fake", error="all bytes are garbage")]


def test_what_a_bridge_finds_wrong_with_its_device_is_told_in_health(world: World) -> None:
    stop = Impatient()
    port = FakePort([raw(b"a"), raw(b"b")], stop)
    ProcessorNode("imu", VEHICLE, world.bus, stop, [Complainer()], [port]).run()
    device, heartbeat = world.ear.heard(keys.DEVICE)[-1], world.ear.heard(keys.HEARTBEAT)[-1]
    assert device.state == DeviceHealth.OPEN
    assert device.trouble.kind == PORT_FAILED.name
    assert "all bytes are garbage" in device.text
    assert [trouble.kind for trouble in heartbeat.troubles] == [PORT_FAILED.name]
    assert heartbeat.state == NodeHealth.DEGRADED


def test_lost_device_makes_the_node_degraded_with_its_sentence(world: World) -> None:
    stop = Impatient()
    port = FakePort([], stop)
    node = ProcessorNode("imu", VEHICLE, world.bus, stop, [Decoder()], [port])

    def refuse() -> None:
        stop.set()
        raise DeviceError("/dev/fake: not there; check $.imu.device")

    port.open = refuse  # type: ignore[method-assign]
    node.run()
    device, heartbeat = world.ear.heard(keys.DEVICE)[-1], world.ear.heard(keys.HEARTBEAT)[-1]
    assert device.state == DeviceHealth.LOST
    assert device.text == heartbeat.text == "/dev/fake: not there; check $.imu.device"
    assert heartbeat.state == NodeHealth.DEGRADED


def test_bug_in_a_port_is_a_fault_and_the_device_is_read_on(world: World) -> None:
    node = world.read([raw(b"a"), ZeroDivisionError("in the port"), raw(b"b")])
    assert node.faults == 1
    assert "ZeroDivisionError: in the port" in world.ear.heard(keys.LOG)[0].message
    assert b"".join(message.data for message in world.ear.heard(keys.IMU_BYTES)) == b"ab"


def test_node_that_fails_at_its_start_says_why_although_no_device_was_opened(
    world: World,
) -> None:
    class Failing(ProcessorNode):
        def begin(self) -> None:
            raise RuntimeError("cannot begin")

    stop = Impatient()
    port = FakePort([], stop)
    with pytest.raises(RuntimeError, match="cannot begin"):
        Failing("imu", VEHICLE, world.bus, stop, [Decoder()], [port]).run()
    assert world.ear.heard(keys.HEARTBEAT)
