"""Whole rides: real processes, pseudo terminals, zenoh and files, from the command line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from live import HANG_S, command, environment, finished, short_folder, tramstream, until

from tramstream import keys
from tramstream.cli.terminal.demo_vehicle import configuration
from tramstream.clock import S, VehicleClock
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.reader import open_record
from tramstream.supervision import roster
from tramstream.supervision.hearing import hears
from tramstream.supervision.roster import Proc, Roster
from tramstream.transport.bus import ZenohBus

pytestmark = pytest.mark.live

REPOSITORY = Path(__file__).resolve().parent.parent
NODES = ("router", "recorder", "simulators", "processors", "gnss", "imu", "odometer")


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A demo ride, faults included, and its figures.

    In real time: a pseudo terminal holds 18 kB, a quarter of a second of the IMU, and a test
    machine may be as busy as that.
    """
    path = tmp_path_factory.mktemp("ride") / "d.mcap"
    text = tramstream(
        *("demo", "--duration-s", "44", "--headless", "--json"),
        *("--out", str(path)),
    )
    return path, json.loads(text)


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as path:
        yield path


def test_demo_loses_nothing_and_finds_every_injected_fault(ride: Any) -> None:
    _, figures = ride
    assert figures["lost"] == 0
    assert figures["unbalanced"] == []
    injected, found = figures["injected"], figures["found"]
    late = figures["overrun"]  # what a busy machine did not read in time: bounded by what was sent
    samples_late = late.get("ride.imu samples", 0)
    assert injected["ride.imu frames_corrupted"] == 3
    corrupted = injected["ride.imu frames_corrupted"]
    assert corrupted <= found["imu frames rejected"] <= corrupted + samples_late
    lost = corrupted + injected["ride.imu samples_dropped"]
    assert lost <= found["imu samples lost"] <= lost + samples_late
    assert found["gnss opened again"] >= 1
    assert found["gnss frames rejected"] >= injected["ride.gnss checksums_spoilt"]
    assert found["odometer frames rejected"] >= injected["ride.can lines_damaged"]


def test_demo_estimates_the_distance_that_was_travelled(ride: Any) -> None:
    _, figures = ride
    pulses_late = figures["overrun"].get("ride.can pulses_left", 0)
    assert figures["distance_m"] > 50.0
    assert abs(figures["distance_end_m"]) < 0.1 + pulses_late * 0.00093
    assert figures["distance_rms_m"] < 0.1 + pulses_late * 0.00093


def test_reprocessing_twice_is_identical_to_the_ride_and_to_itself(
    ride: Any, tmp_path: Path
) -> None:
    path, _ = ride
    outputs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for out in outputs:
        text = tramstream("reprocess", str(path), "-o", str(out), "--check", "--json")
        figures = json.loads(text)
        assert figures["identical"]
        assert figures["compared"] > 1000
        assert figures["unanchored"] == 0
        assert figures["inputs_missing"] == {}
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_check_fails_when_the_processors_are_configured_differently(
    ride: Any, tmp_path: Path
) -> None:
    path, _ = ride
    config = tmp_path / "other.toml"
    config.write_text(configuration(tmp_path, 7) + "\n[wheels]\nm_per_pulse = 0.00093\n")
    out = str(tmp_path / "o.mcap")
    arguments = ("reprocess", str(path), "-o", out, "--config", str(config), "--check", "--json")
    figures = json.loads(tramstream(*arguments, status=1))
    assert not figures["identical"]
    others = [
        each for each in figures["differences"] if not each.startswith(keys.EST_DISTANCE.path)
    ]
    assert not others


def test_part_of_a_ride_is_reprocessed_from_its_first_snapshot(ride: Any, tmp_path: Path) -> None:
    """As with a split recording whose first part is gone."""
    from tramstream.recorder.file.writer import RecordFile

    path, _ = ride
    part = tmp_path / "part.mcap"
    with open_record(path) as record:
        middle_ns = (record.start_ns + record.end_ns) // 2
        metadata = {"config": record.metadata["config"]}
        with RecordFile(part, record.vehicle, metadata) as target:
            for entry in record.messages(start_ns=middle_ns):
                key = keys.find(keys.split(entry.topic)[1])
                assert key is not None
                target.append(
                    entry.topic, key, entry.payload, entry.log_ns, entry.publish_ns, entry.sequence
                )
    text = tramstream("reprocess", str(part), "-o", str(tmp_path / "r.mcap"), "--check", "--json")
    assert json.loads(text)["identical"]


def test_replay_gives_every_message_to_a_recorder_that_listens(ride: Any, folder: Path) -> None:
    path, _ = ride
    env = environment(folder / "run")
    router = subprocess.Popen(
        command("replay", path, "--start-paused"),
        env=env,
        stderr=subprocess.PIPE,
    )
    try:
        until((folder / "run" / "bus.sock").exists, "the first replay's bus")
        recorder = subprocess.Popen(
            command("record", "--out", folder / "out", "--vehicle", "copy"),
            env=env,
            stderr=subprocess.PIPE,
        )
        until(lambda: list((folder / "out").glob("*.active")) or recorder.poll(), "the recorder")
        bus = ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))
        try:  # its file is there before its subscriptions are
            until(lambda: hears(bus, "copy", lambda _: True), "a recorder that hears")
        finally:
            bus.close()
        text = tramstream("replay", str(path), "--rate", "0", "--as", "copy", "--json",
                          "--onto-live", env=env)  # fmt: skip
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(HANG_S) == 0
    finally:
        router.send_signal(signal.SIGINT)
        router.wait(HANG_S)
    published = json.loads(text)["published"]
    with open_record(path) as first, open_record(folder / "out") as second:
        assert first.message_count == published
        for topic, info in first.channels.items():
            if "/health/recorder/" in topic:
                continue  # the second recorder's own are among them
            copied = second.channels[topic.replace("tram/demo/", "tram/copy/")]
            assert copied.count == info.count, topic


def test_replay_refuses_keys_of_a_live_vehicle(ride: Any, folder: Path) -> None:
    path, _ = ride
    env = environment(folder / "run")
    first = subprocess.Popen(
        command("replay", path, "--loop"),
        env=env,
        stderr=subprocess.DEVNULL,
    )
    try:
        until((folder / "run" / "bus.sock").exists, "the first replay's bus")

        def refused() -> bool:
            done = finished(command("replay", path, "--duration-s", 0.1), env=env)
            return done.returncode == 2 and "is live on this bus" in done.stderr

        until(refused, "a refusal")
    finally:
        first.send_signal(signal.SIGINT)
        assert first.wait(HANG_S) == 0


class Running:
    """`tramstream run` as a child process, and its nodes and successors by name."""

    def __init__(self, config: Path, folder: Path, verb: tuple[str, ...] = ("run",)) -> None:
        self.folder = folder
        self.config = config
        self.process = subprocess.Popen(
            command(*verb, config),
            stderr=(folder / "log.txt").open("w"),
        )

    def roster(self) -> Roster | None:
        return roster.read(self.folder / "run")

    def node(self, name: str) -> int:
        """Process of a node; 0 if it is not there."""
        known = self.roster()
        process = known.living().get(name) if known is not None else None
        return process.pid if process is not None else 0

    def nodes(self) -> dict[str, int]:
        """Processes of all nodes, once all are there and the run says so."""
        until(lambda: "vehicle demo:" in self.log() or self.process.poll(), "the run")
        return {name: until(lambda n=name: self.node(n), name) for name in NODES}

    def supervisor(self) -> int:
        """The process that supervises now, and has begun to; 0 if there is none."""
        known = self.roster()
        there = known is not None and known.claimed and known.supervisor.alive
        return known.supervisor.pid if known is not None and there else 0

    def log(self) -> str:
        return (self.folder / "log.txt").read_text()

    def size(self) -> int:
        """Bytes in the record that is being written."""
        return sum(path.stat().st_size for path in (self.folder / "records").glob("*.active"))

    def grow(self, size: int) -> None:
        """Wait until the record has grown by so much."""
        before = self.size()
        until(lambda: self.size() > before + size, "more record")

    def end(self, status: int = 0) -> None:
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(HANG_S) == status, self.log()

    def end_successor(self) -> None:
        """As its sentence says."""
        pid = self.supervisor()
        assert f"process {pid} has taken over" in self.log()
        assert f"`kill {pid}` ends it" in self.log()
        os.kill(pid, signal.SIGTERM)
        until(lambda: not Proc.of(pid), "the successor to end")

    def clean_up(self) -> None:
        """Leave no process behind, whatever a test has done."""
        processes = [self.process.pid]
        known = self.roster()
        if known is not None:
            processes += [p.pid for p in (known.supervisor, *known.nodes.values()) if p.alive]
        for pid in processes:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()


@pytest.fixture
def running(folder: Path) -> Iterator[Running]:
    config = folder / "ride.toml"
    config.write_text(configuration(folder, seed=3))
    run = Running(config, folder)
    yield run
    run.clean_up()


def test_nodes_outlive_each_other_and_the_ride_is_repeated_across_the_crash(
    running: Running, folder: Path, tmp_path: Path
) -> None:
    names = ("recorder", "processors", "gnss", "imu", "odometer")
    before = until(
        lambda: all(pids := {n: running.node(n) for n in names}.values()) and pids, "all nodes"
    )
    assert before is not None
    pids = {name: running.node(name) for name in names}
    active = until(lambda: list((folder / "records").glob("*.active")), "a record")[0]
    until(lambda: active.stat().st_size > 200_000, "a few seconds of record")

    os.kill(pids["processors"], signal.SIGKILL)
    until(lambda: running.node("processors") not in (0, pids["processors"]), "new processors")
    size = active.stat().st_size
    until(lambda: active.stat().st_size > size + 150_000, "more record")
    assert [running.node(n) for n in names if n != "processors"] == [
        pids[n] for n in names if n != "processors"
    ]

    os.kill(pids["imu"], signal.SIGKILL)
    until(lambda: running.node("imu") not in (0, pids["imu"]), "a new imu bridge")
    size = active.stat().st_size
    until(lambda: active.stat().st_size > size + 150_000, "more record")
    assert running.node("recorder") == pids["recorder"]
    running.end()

    text = tramstream(
        *("reprocess", str(folder / "records"), "-o", str(tmp_path / "r.mcap")),
        *("--check", "--json"),
    )
    figures = json.loads(text)
    assert figures["sessions"] == 2
    assert figures["identical"]


def test_separate_processors_give_a_ride_that_is_repeated_as_well(
    folder: Path, tmp_path: Path
) -> None:
    config = folder / "ride.toml"
    config.write_text(configuration(folder, seed=4))
    tramstream("run", str(config), "--separate", "--duration-s", "6")
    text = tramstream(
        *("reprocess", str(folder / "records"), "-o", str(tmp_path / "r.mcap")),
        *("--check", "--json"),
    )
    assert json.loads(text)["identical"]


def test_killed_recorder_is_started_again_and_its_record_repaired(
    running: Running, folder: Path
) -> None:
    first = until(lambda: running.node("recorder"), "the recorder")
    active = until(lambda: list((folder / "records").glob("*.active")), "a record")[0]
    until(lambda: active.stat().st_size > 100_000, "some record")
    others = {name: running.node(name) for name in ("processors", "imu")}
    os.kill(first, signal.SIGKILL)
    until(lambda: running.node("recorder") not in (0, first), "a new recorder")
    finished = active.with_name(active.name.removesuffix(".active"))
    until(finished.exists, "the repaired record")
    assert {name: running.node(name) for name in others} == others
    running.end()
    assert len(list((folder / "records").glob("*.mcap"))) == 2
    with open_record(folder / "records") as record:
        assert record.damages == []


def lost_by(folder: Path) -> dict[str, int]:
    """Messages that nodes missed, by consumer and key."""
    found: dict[str, int] = {}
    with open_record(folder / "records") as record:
        assert record.damages == []
        for entry in record.messages(lambda topic: topic.endswith("/loss")):
            loss = record.decode(entry)
            name = f"{loss.consumer} {loss.key}"
            found[name] = found.get(name, 0) + loss.count
    return found


def test_killed_run_comes_back_by_itself_and_its_nodes_have_gone_on(
    running: Running, folder: Path
) -> None:
    nodes = running.nodes()
    running.grow(100_000)
    first = running.process.pid
    for _ in range(2):  # a successor has one, too
        os.kill(first, signal.SIGKILL)
        running.process.wait()
        second = until(
            lambda old=first: (new := running.supervisor()) not in (0, old) and new, "a successor"
        )
        until(lambda p=second: f"process {p} has taken over" in running.log(), "its sentence")
        first = second
        running.grow(100_000)
        assert {name: running.node(name) for name in NODES} == nodes

    os.kill(nodes["imu"], signal.SIGKILL)  # of a parent that is gone
    until(lambda: running.node("imu") not in (0, nodes["imu"]), "a new imu bridge")
    running.grow(100_000)
    running.end_successor()
    assert not any(Proc.of(pid) for pid in nodes.values())
    assert list((folder / "records").glob("*.active")) == []
    assert len(list((folder / "records").glob("*.mcap"))) == 1
    assert lost_by(folder) == {}
    assert not (folder / "run" / roster.FILE).exists()


def test_nodes_end_in_order_when_supervisor_and_router_are_killed_together(
    running: Running, folder: Path
) -> None:
    nodes = running.nodes()
    running.grow(100_000)
    for pid in (nodes["router"], running.process.pid):
        os.kill(pid, signal.SIGSTOP)  # neither sees the other go
    for pid in (nodes["router"], running.process.pid):
        os.kill(pid, signal.SIGKILL)
    running.process.wait()
    until(lambda: not any(Proc.of(pid) for pid in nodes.values()), "the nodes to end")
    assert running.log().count("no supervisor for 10 s") == len(NODES) - 1
    assert list((folder / "records").glob("*.active")) == []  # finished
    assert len(list((folder / "records").glob("*.mcap"))) == 1


def test_demo_whose_program_is_killed_ends() -> None:
    others = set(Path("/tmp").glob("tramstream-demo-*"))
    demo = subprocess.Popen(
        command("demo", "--headless", "--out", "/tmp/never-written.mcap"),
        stderr=subprocess.DEVNULL,
    )
    try:
        folder = until(
            lambda: [
                path
                for path in set(Path("/tmp").glob("tramstream-demo-*")) - others
                if (known := roster.read(path / "run")) and known.supervisor.pid == demo.pid
            ],
            "the demo's folder",
        )[0]
        until(lambda: list((folder / "records").glob("*.active")), "a record")
        known = roster.read(folder / "run")
        assert known is not None
    finally:
        demo.kill()
        demo.wait()
    assert "router" in known.nodes
    until(lambda: not known.living(), "the nodes to end")
    until(lambda: not list((folder / "records").glob("*.active")), "the record's end")
    after = roster.read(folder / "run")
    assert after is None or after.supervisor.pid == demo.pid  # nobody came after it
    shutil.rmtree(folder)


def test_killed_router_is_back_and_all_nodes_with_it(running: Running, folder: Path) -> None:
    nodes = running.nodes()
    running.grow(100_000)
    os.kill(nodes["router"], signal.SIGKILL)
    until(lambda: running.node("router") not in (0, nodes["router"]), "a new router")
    size = running.size()
    until(lambda: running.size() > size + 200_000, "the record to go on")
    others = {name: running.node(name) for name in NODES if name != "router"}
    assert others == {name: pid for name, pid in nodes.items() if name != "router"}
    running.process.send_signal(signal.SIGINT)
    # What was on its way through the old router is lost, and the run says so.
    status = running.process.wait(HANG_S)
    lost = sum(n for name, n in lost_by(folder).items() if name.startswith("recorder "))
    assert status == (3 if lost else 0), running.log()
    assert (f"{lost} messages are missing in the records" in running.log()) == bool(lost)


@pytest.mark.parametrize("name", ["recorder", "router", "imu"])
def test_frozen_node_is_said_killed_and_replaced(running: Running, name: str) -> None:
    nodes = running.nodes()
    running.grow(100_000)
    os.kill(nodes[name], signal.SIGSTOP)
    until(lambda: running.node(name) not in (0, nodes[name]), f"a new {name}")
    running.grow(100_000)
    log = running.log()
    assert f"node {name} has given no heartbeat for 3 s\n" in log
    assert f"node {name} has given no heartbeat for 5 s; killing it" in log
    assert f"node {name} ended with status -9; starting it again" in log
    others = {each: running.node(each) for each in NODES if each != name}
    assert others == {each: pid for each, pid in nodes.items() if each != name}
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(HANG_S) in (0, 3)  # 3: the bus could not hold all of it


def test_nodes_of_a_frozen_supervisor_go_on_and_are_not_killed_when_it_wakes(
    running: Running, folder: Path
) -> None:
    nodes = running.nodes()
    running.grow(100_000)
    os.kill(running.process.pid, signal.SIGSTOP)
    for _ in range(10):
        running.grow(100_000)
    os.kill(running.process.pid, signal.SIGCONT)
    for _ in range(6):
        running.grow(100_000)
    assert {name: running.node(name) for name in NODES} == nodes
    assert "no heartbeat" not in running.log()
    running.end()
    assert lost_by(folder) == {}


def test_malformed_messages_of_a_stranger_end_nothing(running: Running, folder: Path) -> None:
    nodes = running.nodes()
    bus = ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))
    try:
        for key, payload in (
            (keys.LOG.at("x"), b"\x0a\xff\xff"),
            (keys.HEARTBEAT.at("recorder"), b"\x0a\xff\xff\xff\xff\x0f"),
        ):
            for sequence in range(1, 20):
                bus.publish(key.on("demo"), payload, key.encoding, sequence)
        until(lambda: "left out, as" in running.log(), "a sentence")
    finally:
        bus.close()
    running.grow(200_000)
    assert {name: running.node(name) for name in NODES} == nodes
    assert running.process.poll() is None
    running.end()


def test_losses_that_a_stranger_tells_in_the_recorders_name_change_no_status(
    running: Running, folder: Path
) -> None:
    running.nodes()
    loss = Loss(consumer="recorder", key=keys.IMU_BATCH.on("demo"), count=5, cause=Loss.Cause.DISK)
    bus = ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))
    try:
        key = keys.LOSS.at("recorder")
        bus.publish(key.on("demo"), loss.SerializeToString(), key.encoding, 1)
        until(lambda: "is not the recorder; it is not believed" in running.log(), "a sentence")
    finally:
        bus.close()
    running.end()
    assert "messages are missing" not in running.log()


def test_second_run_in_the_same_folder_is_refused_and_the_first_goes_on(running: Running) -> None:
    nodes = running.nodes()
    done = finished(command("run", running.config))
    assert done.returncode == 2
    assert f"`kill {running.process.pid}` ends it" in done.stderr
    assert "$.bus.runtime_dir" in done.stderr
    running.grow(50_000)
    assert {name: running.node(name) for name in NODES} == nodes
    running.end()


def test_run_ends_in_order_when_its_terminal_is_closed(running: Running, folder: Path) -> None:
    nodes = running.nodes()
    running.grow(50_000)
    running.process.send_signal(signal.SIGHUP)
    assert running.process.wait(HANG_S) == 0, running.log()
    assert not any(Proc.of(pid) for pid in nodes.values())
    assert list((folder / "records").glob("*.active")) == []


@pytest.mark.realdata
def test_captured_bytes_run_through_the_whole_vehicle(data_dir: Path, folder: Path) -> None:
    text = (REPOSITORY / "docs" / "captures.toml").read_text()
    text = text.replace("../../shared/data", str(data_dir.resolve()))
    config = folder / "captures.toml"
    config.write_text(text.replace("/tmp/tramstream-captures", str(folder)))
    tramstream("run", str(config), "--duration-s", "8")
    with open_record(folder / "records") as record:
        counts = {keys.split(topic)[1]: info.count for topic, info in record.channels.items()}
        assert counts[keys.GNSS_FIX.path] >= 5
        assert counts[keys.GNSS_LOCATION.path] >= 5
        assert counts[keys.ODO_WHEELS.path] > 300
        assert counts[keys.IMU_BATCH.path] > 400
        assert counts[keys.EST_DISTANCE.path] > 200
        lost = [name for name in counts if name.endswith("/loss")]
        assert lost == []
        wheels = [
            wheel.speed_mps
            for entry in record.messages(lambda topic: topic.endswith(keys.ODO_WHEELS.path))
            for wheel in record.decode(entry).wheels
        ]
        assert 5.0 < min(wheels) < max(wheels) < 30.0


@pytest.mark.study
def test_no_healthy_node_is_taken_for_frozen_with_six_busy_processes_a_core(
    running: Running, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Prints the longest pause between two heartbeats of each node, as they arrive."""
    nodes = running.nodes()
    arrivals: dict[str, list[int]] = {}
    bus = ZenohBus.connect(folder / "run", VehicleClock.shared(folder / "run"))
    busy = [
        subprocess.Popen(["timeout", "60", sys.executable, "-c", "while True: pass"])
        for _ in range(6 * (os.cpu_count() or 1))
    ]
    try:
        bus.subscribe(
            keys.HEARTBEAT.on("demo"),
            lambda envelope: arrivals.setdefault(envelope.topic, []).append(envelope.arrival_ns),
        )
        for each in busy:
            each.wait()
    finally:
        for each in busy:
            each.kill()
            each.wait()
        bus.close()
    with capsys.disabled():
        for topic, at_ns in sorted(arrivals.items()):
            longest_s = max(after - before for before, after in pairwise(at_ns)) / S
            print(f"{topic}: {len(at_ns)} heartbeats, longest pause {longest_s:.2f} s")
    assert {name: running.node(name) for name in NODES} == nodes
    assert "no heartbeat" not in running.log()
    assert len(arrivals) == len(NODES)
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(HANG_S) in (0, 3)  # a simulated line may have overrun
