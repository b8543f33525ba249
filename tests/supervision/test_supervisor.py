"""Nodes that die or freeze are started again; real processes are in `test_pipeline.py`."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from live import HANG_S, SLEEP
from scripted import ManualClock

from tramstream import config_file, keys, plugins
from tramstream.config import Bus, Gnss, Imu, Simulator, Vehicle
from tramstream.errors import BusError, NodeError
from tramstream.events.kinds import Event
from tramstream.live import registry
from tramstream.supervision import events, hearing, roster, supervisor
from tramstream.supervision.child import BACKOFF_MAX_S, GOOD_RUN_S
from tramstream.supervision.process import Running
from tramstream.supervision.roster import Proc
from tramstream.supervision.supervisor import Plan, Supervisor
from tramstream.transport.bus import LocalBus

TURN_S = 0.1


class FakeProcess(Running):
    """A process that lives until it is told, or takes a signal."""

    def __init__(self, name: str, pid: int, log: list[str], stubborn: bool = False) -> None:
        self.name = name
        self.pid = pid
        self.ends_with: int | None = None
        self.ends_when_told = 0
        self.frozen = False
        self.stubborn = stubborn
        self._log = log

    def ended(self, timeout_s: float = 0.0) -> bool:
        return self.ends_with is not None

    def status(self) -> int | None:
        return self.ends_with

    def send(self, number: signal.Signals) -> None:
        if number == signal.SIGKILL or not (self.frozen or self.stubborn):
            self._log.append(f"{self.name} {number.name}")
            self.ends_with = -9 if number == signal.SIGKILL else self.ends_when_told

    def close(self) -> None:
        pass


class Scene:
    """A supervisor whose processes and time are played."""

    def __init__(self, folder: Path, separate: bool = False) -> None:
        self.vehicle = Vehicle(
            vehicle="t1",
            bus=Bus(runtime_dir=str(folder)),
            gnss=Gnss(device="/dev/none"),
            imu=Imu(device="/dev/none"),
            simulators={"ride": Simulator(kind="ride", link="/tmp/x")},
            separate=Vehicle(vehicle="t1").processors if separate else (),
        )
        self.now_s = 1000.0
        self.started: list[tuple[str, float]] = []
        self.processes: dict[str, FakeProcess] = {}
        self.signals: list[str] = []
        self.told: list[Event] = []
        self.bus = LocalBus(ManualClock())
        self.ends_at_start: set[str] = set()
        self.deaf: set[FakeProcess] = set()
        """Recorders that do not answer."""
        self.bus.answer(keys.farewell("t1"), self._answer)
        self.plan = Plan(self.vehicle, Path("t.toml"), successor=("run", roster.REST))
        self.supervisor = Supervisor(self.plan, self.told.append, self._start, lambda: self.now_s)

    def _start(self, name: str) -> Running:
        self.started.append((name, self.now_s))
        process = FakeProcess(name, 5_000_000 + len(self.started), self.signals)
        self.processes[name] = process
        if name in self.ends_at_start:
            process.ends_with = 2
        else:
            self.bus.announce(keys.alive("t1", name))
        return process

    def _answer(self, topic: str) -> bytes | None:
        """What the recorder says when it is asked whether it hears."""
        recorder = self.processes["recorder"]
        if not (recorder.ended() or recorder.frozen or recorder in self.deaf):
            return b""
        self.now_s += hearing.ASK_S
        return None

    def begin(self) -> None:
        self.supervisor.claim()
        self.supervisor.join(lambda: self.bus)
        self.supervisor.start(self.bus)

    def stop(self) -> None:
        """End the nodes as at the end of a run, with time passing where it is waited."""

        def each() -> None:
            self.now_s += TURN_S

        self.supervisor.stop_nodes(self.bus, each)

    def go_on(self, seconds: float, *silent: str) -> None:
        """Watch for so long, with heartbeats of all that live and are not `silent`."""
        for turn in range(round(seconds / TURN_S)):
            if turn % 10 == 0:
                for name, process in self.processes.items():
                    if name not in silent and not process.ended():
                        self.supervisor.heard(name, process.pid)
            self.now_s += TURN_S
            self.supervisor.watch()

    def starts_of(self, name: str) -> list[float]:
        return [at_s for each, at_s in self.started if each == name]


@pytest.fixture
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="tram-") as name:
        yield Path(name)


@pytest.fixture
def scene(folder: Path) -> Iterator[Scene]:
    scene = Scene(folder)
    yield scene
    scene.supervisor.stop_router()


# Order --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("separate", [False, True])
def test_router_starts_first_and_ends_last_with_the_recorder_next_to_it(
    folder: Path, separate: bool
) -> None:
    scene = Scene(folder, separate)
    scene.begin()
    assert [name for name, _ in scene.started[:2]] == ["router", "recorder"]
    assert {name for name, _ in scene.started} == set(registry.node_names(scene.vehicle))
    scene.supervisor.stop_nodes(None)
    assert "router SIGTERM" not in scene.signals
    scene.supervisor.stop_router()
    kinds = {
        **dict.fromkeys(plugins.names("bridges"), "bridge"),
        **dict.fromkeys(["processors", *plugins.names("processors")], "processor"),
    }
    ends = [line.removesuffix(" SIGTERM") for line in scene.signals]
    order = [kinds.get(name, name) for name in ends]
    assert list(dict.fromkeys(order)) == [
        *("bridge", "processor", "simulators", "recorder", "router")
    ]
    assert sorted(ends) == sorted(registry.node_names(scene.vehicle))


def test_stubborn_node_is_killed_at_the_end(scene: Scene) -> None:
    scene.begin()
    scene.processes["imu"].frozen = True
    scene.supervisor.stop_nodes(None)
    assert "imu SIGKILL" in scene.signals
    assert events.DOES_NOT_END(node="imu") in scene.told


def test_recorder_that_hears_is_ended_last_and_no_other_is_started(scene: Scene) -> None:
    scene.begin()
    scene.stop()
    assert scene.signals[-1] == "recorder SIGTERM"
    assert len(scene.starts_of("recorder")) == 1
    assert scene.supervisor.unheard is None


@pytest.mark.parametrize("how", ["frozen", "dead"])
def test_recorder_that_does_not_hear_is_replaced_before_the_first_publisher_ends(
    scene: Scene, how: str
) -> None:
    scene.begin()
    first = scene.processes["recorder"]
    if how == "dead":
        first.ends_with = -9
    else:
        first.frozen = True
    others = set(scene.processes) - {"router", "recorder"}
    scene.stop()
    assert len(scene.starts_of("recorder")) == 2
    kills = ["recorder SIGKILL"] if how == "frozen" else []
    assert scene.signals[: len(kills)] == kills
    assert sorted(scene.signals[len(kills) : -1]) == sorted(f"{name} SIGTERM" for name in others)
    assert scene.signals[-1] == "recorder SIGTERM"
    assert scene.supervisor.unheard is None


def test_question_that_a_full_link_drops_is_put_again(scene: Scene) -> None:
    scene.begin()
    first = scene.processes["recorder"]
    scene.deaf.add(first)
    answer, asked = scene._answer, []

    def late(topic: str) -> bytes | None:
        asked.append(topic)
        if len(asked) == hearing.ASKED:
            scene.deaf.clear()
        return answer(topic)

    scene.bus._answers.clear()
    scene.bus.answer(keys.farewell("t1"), late)
    scene.stop()
    assert scene.processes["recorder"] is first
    assert "recorder SIGKILL" not in scene.signals


def test_recorder_that_cannot_be_started_is_said_and_the_nodes_end(scene: Scene) -> None:
    scene.begin()
    scene.processes["recorder"].ends_with = 1
    scene.ends_at_start.add("recorder")
    scene.stop()
    reason = "node recorder ended with status 2 at its start"
    assert events.NOT_STARTED(reason=reason, advice="") in scene.told
    assert "imu SIGTERM" in scene.signals
    assert scene.supervisor.unheard == events.RECORDER_DEAF(node="recorder")


def test_recorder_that_answers_while_the_bus_is_away_is_not_killed(scene: Scene) -> None:
    scene.begin()
    scene.deaf.add(scene.processes["recorder"])
    scene.bus._announced.clear()  # nobody is seen on the bus
    scene.processes["router"].frozen = True

    scene.stop()
    assert "recorder SIGKILL" not in scene.signals
    assert scene.supervisor.unheard


@pytest.mark.parametrize("how", ["stubborn", "gone", "failing"])
def test_recorder_that_does_not_end_in_order_is_said(scene: Scene, how: str) -> None:
    scene.begin()
    recorder = scene.processes["recorder"]
    if how == "stubborn":
        recorder.stubborn = True
    elif how == "failing":
        recorder.ends_when_told = 1
    else:
        send = scene.processes["imu"].send

        def last_breath(number: signal.Signals) -> None:
            send(number)
            recorder.ends_with = -9

        scene.processes["imu"].send = last_breath  # type: ignore[method-assign]
    scene.stop()
    ends = {
        "stubborn": "ended with status -9",
        "gone": "was gone",
        "failing": "ended with status 1",
    }
    broken_off = events.RECORDER_BROKEN_OFF(node="recorder", how=ends[how])
    assert scene.supervisor.unheard == broken_off
    assert broken_off in scene.told


def test_node_that_ends_at_its_start_ends_the_run_with_its_status(scene: Scene) -> None:
    scene.ends_at_start.add("imu")
    with pytest.raises(NodeError, match="node imu ended with status 2 at its start") as caught:
        scene.begin()
    assert caught.value.exit_status == 2


def test_router_that_ends_at_its_start_ends_the_run(scene: Scene) -> None:
    scene.ends_at_start.add("router")

    def connect() -> LocalBus:
        raise BusError("no bus")

    scene.supervisor.claim()
    with pytest.raises(NodeError, match="node router ended with status 2"):
        scene.supervisor.join(connect)


# Dying --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["imu", "router"])
def test_node_that_dies_again_and_again_is_started_at_growing_pauses(
    scene: Scene, name: str
) -> None:
    scene.begin()
    pauses_s = []
    for _ in range(14):
        died_s = scene.now_s
        scene.processes[name].ends_with = 1
        count = len(scene.starts_of(name))
        while len(scene.starts_of(name)) == count:
            scene.go_on(TURN_S)
        pauses_s.append(scene.starts_of(name)[-1] - died_s)
    assert pauses_s[0] < 0.5
    for one, other in pairwise(pauses_s):
        assert other >= min(2 * one - 3 * TURN_S, BACKOFF_MAX_S)
        assert other <= BACKOFF_MAX_S + 2 * TURN_S
    assert pauses_s[-1] >= BACKOFF_MAX_S
    others = [each for each, _ in scene.started if each != name]
    assert len(others) == len(set(others))


def test_node_that_lived_long_is_started_again_at_once(scene: Scene) -> None:
    scene.begin()
    for _ in range(8):
        scene.processes["imu"].ends_with = 1
        scene.go_on(BACKOFF_MAX_S + 1.0)
    scene.go_on(GOOD_RUN_S + 1.0)
    scene.processes["imu"].ends_with = 1
    died_s = scene.now_s
    scene.go_on(1.0)
    assert scene.starts_of("imu")[-1] - died_s < 0.5
    assert scene.told[-1].kind is events.NODE_ENDED
    assert scene.told[-1].facts == {"node": "imu", "status": 1, "again_s": 0.2}


# Freezing -----------------------------------------------------------------------------------------
def test_frozen_node_is_said_killed_and_replaced(scene: Scene) -> None:
    scene.begin()
    scene.go_on(10.0)
    frozen = scene.processes["recorder"]
    frozen.frozen = True
    begin_s = scene.now_s
    scene.go_on(8.0, "recorder")
    assert events.NODE_SILENT(node="recorder", limit_s=3.0) in scene.told
    assert events.NODE_FROZEN(node="recorder", limit_s=5.0) in scene.told
    assert scene.signals == ["recorder SIGKILL"]
    assert scene.processes["recorder"] is not frozen
    assert scene.starts_of("recorder")[-1] - begin_s < 6.5
    others = {name for name, _ in scene.started} - {"recorder"}
    assert all(len(scene.starts_of(name)) == 1 for name in others)


def test_heartbeats_of_another_process_do_not_hide_a_frozen_node(scene: Scene) -> None:
    scene.begin()
    scene.go_on(5.0)
    scene.processes["imu"].frozen = True
    for _ in range(8):
        scene.supervisor.heard("imu", 4711)
        scene.go_on(1.0, "imu")
    assert scene.signals == ["imu SIGKILL"]


def test_supervisor_that_stood_still_kills_nobody(scene: Scene) -> None:
    scene.begin()
    scene.go_on(5.0)
    scene.now_s += 600.0  # stopped by a signal, or the machine slept
    scene.go_on(20.0)
    assert scene.signals == []
    assert scene.told == []


def test_slow_clock_makes_heartbeats_rare_and_kills_nobody(folder: Path) -> None:
    scene = Scene(folder)
    slow = Plan(scene.vehicle, Path("t.toml"), rate=0.1)
    scene.supervisor = Supervisor(slow, scene.told.append, scene._start, lambda: scene.now_s)
    scene.begin()
    for _ in range(5):
        for name, process in scene.processes.items():
            scene.supervisor.heard(name, process.pid)
        scene.go_on(10.0, *scene.processes)  # one heartbeat in ten seconds
    assert scene.signals == []
    scene.supervisor.stop_router()


# Succession ---------------------------------------------------------------------------------------
@pytest.fixture
def sleepers() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Processes that stand for nodes of a supervisor that was killed."""
    names = ("router", "recorder", "processors", "imu")
    children = {name: subprocess.Popen(SLEEP) for name in names}
    yield children
    for child in children.values():
        child.kill()
        child.wait()


def left_behind(
    scene: Scene, sleepers: dict[str, subprocess.Popen[bytes]], **fields: object
) -> None:
    """Write the roster of a supervisor that is gone."""
    nodes = {name: Proc.of(child.pid) for name, child in sleepers.items()}
    known = roster.Roster(
        boot=roster.fresh().boot,
        supervisor=Proc(os.getpid(), 1),
        claimed=True,
        command=("run",),
        configuration=config_file.text_digest(config_file.to_json(scene.vehicle)),
        nodes={name: process for name, process in nodes.items() if process is not None},
        lost=7,
    )
    roster.write(scene.vehicle.runtime_dir, msgspec.structs.replace(known, **fields))


def test_living_nodes_are_taken_over_and_only_the_missing_are_started(
    scene: Scene, sleepers: dict[str, subprocess.Popen[bytes]]
) -> None:
    left_behind(scene, sleepers)
    scene.begin()
    assert scene.supervisor.took_over
    assert scene.supervisor.lost == 7
    scene.go_on(TURN_S)
    missing = set(registry.node_names(scene.vehicle)) - set(sleepers)
    assert {name for name, _ in scene.started} == missing
    known = roster.read(scene.vehicle.runtime_dir)
    assert known is not None
    assert known.supervisor == Proc.of(os.getpid())
    assert set(known.nodes) >= set(sleepers)

    sleepers["imu"].kill()
    sleepers["imu"].wait()
    scene.go_on(1.0, *scene.processes)
    assert scene.starts_of("imu")
    assert events.NODE_GONE(node="imu", again_s=0.2) in scene.told
    scene.supervisor.stop_nodes(None)
    scene.supervisor.stop_router()
    assert all(child.wait(HANG_S) == -signal.SIGTERM for name, child in sleepers.items()
               if name != "imu")  # fmt: skip
    assert roster.read(scene.vehicle.runtime_dir) is None


@pytest.mark.parametrize(
    "fields", [{"configuration": "another"}, {"ending": True}, {"command": ()}]
)
def test_nodes_of_other_settings_or_of_a_run_that_was_ending_are_ended_not_taken_over(
    scene: Scene, sleepers: dict[str, subprocess.Popen[bytes]], fields: dict[str, object]
) -> None:
    left_behind(scene, sleepers, **fields)
    scene.begin()
    assert not scene.supervisor.took_over
    assert all(child.wait(HANG_S) == -signal.SIGTERM for child in sleepers.values())
    assert [name for name, _ in scene.started][:2] == ["router", "recorder"]
    assert set(scene.processes) == set(registry.node_names(scene.vehicle))


def test_frozen_router_that_was_taken_over_is_replaced_before_anything_else(
    scene: Scene, sleepers: dict[str, subprocess.Popen[bytes]]
) -> None:
    left_behind(scene, sleepers)
    scene.supervisor.claim()

    def connect() -> LocalBus:
        scene.now_s += 2.0  # what zenoh waits for
        if not scene.starts_of("router"):
            raise BusError("no answer")
        return scene.bus

    assert scene.supervisor.join(connect) is scene.bus
    assert sleepers["router"].wait(HANG_S) == -signal.SIGKILL
    assert len(scene.starts_of("router")) == 1
    assert events.NO_ANSWER(node="router") in scene.told


def test_second_supervisor_of_a_folder_is_refused_and_the_first_goes_on(scene: Scene) -> None:
    scene.begin()
    with subprocess.Popen(SLEEP) as other:
        known = roster.read(scene.vehicle.runtime_dir)
        assert known is not None
        process = Proc.of(other.pid)
        roster.write(scene.vehicle.runtime_dir, msgspec.structs.replace(known, supervisor=process))
        second = Supervisor(scene.plan, scene.told.append, scene._start)
        with pytest.raises(BusError, match=f"`kill {other.pid}` ends it"):
            second.claim()
        other.kill()


def test_successor_knows_what_was_lost_and_when_the_run_ends(scene: Scene) -> None:
    scene.begin()
    scene.supervisor.lose(3)
    scene.supervisor.lose(2)
    scene.supervisor.end_at(1234.5)
    known = roster.read(scene.vehicle.runtime_dir)
    assert known is not None
    assert known.lost == scene.supervisor.lost == 5
    assert known.ends_s == 1234.5
    assert known.command == ("run", roster.REST)
    assert known.claimed
    assert not known.ending


def test_vehicle_runs_on_when_the_roster_cannot_be_written(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(folder: Path, known: roster.Roster) -> None:
        raise OSError(28, "No space left on device")

    scene.begin()
    monkeypatch.setattr(supervisor.roster, "write", full)
    scene.processes["imu"].ends_with = 1
    scene.go_on(1.0)
    assert len(scene.starts_of("imu")) == 2
    folder = scene.vehicle.runtime_dir
    refused = events.ROSTER_REFUSED(folder=folder, reason="No space left on device")
    assert refused in scene.told
