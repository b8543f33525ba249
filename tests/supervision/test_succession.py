"""What becomes of nodes whose supervisor has vanished; with real processes, in played time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from live import HANG_S, SLEEP, until

from tramstream.events.kinds import Event
from tramstream.supervision import events, roster
from tramstream.supervision.roster import NOBODY, REST, Proc, Roster
from tramstream.supervision.succession import ORPHAN_S, Orphan

GONE = Proc(os.getpid(), 1)
"""A supervisor that has ended; its number is somebody else's now."""


class Look(threading.Event):
    """A stop event whose `wait` lets played time pass, and does what the script says for then."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.looks = 0
        self.script: list[tuple[float, Callable[[], None]]] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.now_s += timeout or 0.0
        self.looks += 1
        assert self.looks < 500, "the node never ends"
        while self.script and self.script[0][0] <= self.now_s:
            self.script.pop(0)[1]()
        return self.is_set()


class Scene:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stop = Look()
        self.told: list[Event] = []

    def write(self, **fields: object) -> None:
        known = Roster(boot=roster.fresh().boot, supervisor=GONE, claimed=True, command=("none",))
        roster.write(self.folder, msgspec.structs.replace(known, **fields))

    def watch(self, starts_successor: bool = False) -> float:
        """Play the node until it ends; return when that was."""
        Orphan(
            self.folder, self.stop, self.told.append, starts_successor, lambda: self.stop.now_s
        ).watch()
        assert self.stop.is_set()
        return self.stop.now_s


@pytest.fixture
def scene() -> Iterator[Scene]:
    with tempfile.TemporaryDirectory(prefix="tram-") as name:
        yield Scene(Path(name))


def test_nodes_of_a_ride_without_successor_end_at_once(scene: Scene) -> None:
    scene.write(command=())
    assert scene.watch() == 0.0


def test_nodes_of_a_supervisor_that_was_ending_them_end_at_once(scene: Scene) -> None:
    scene.write(ending=True)
    assert scene.watch() == 0.0


@pytest.mark.parametrize("known", [True, False])
def test_node_without_any_supervisor_ends_after_ten_seconds(scene: Scene, known: bool) -> None:
    if known:
        scene.write()
    assert scene.watch() == pytest.approx(ORPHAN_S, abs=1.0)
    assert events.NO_SUPERVISOR(limit_s=10.0) in scene.told


def test_node_goes_on_under_a_new_supervisor(scene: Scene) -> None:
    scene.write()
    child = subprocess.Popen(SLEEP)

    def succeed() -> None:
        scene.write(supervisor=Proc.of(child.pid))
        threading.Timer(0.3, child.kill).start()
        threading.Thread(target=child.wait).start()

    scene.stop.script = [(9.0, succeed)]
    ended_s = scene.watch()
    assert ended_s >= 9.0 + ORPHAN_S - 1.0  # its ten seconds began anew


def test_time_in_which_the_node_stood_still_does_not_count(scene: Scene) -> None:
    scene.write()

    def sleep() -> None:
        scene.stop.now_s += 3600.0

    scene.stop.script = [(5.0, sleep)]
    assert scene.watch() >= 3600.0 + ORPHAN_S - 1.0


def test_router_starts_the_successor_and_the_node_waits_for_it(scene: Scene) -> None:
    out = scene.folder / "out"
    program = f"import sys; open({str(out)!r}, 'w').write(sys.argv[1])"
    scene.write(command=(sys.executable, "-c", program, REST), ends_s=100.0)
    scene.watch(starts_successor=True)
    assert 80.0 < float(out.read_text()) <= 100.0
    assert events.TAKEN_OVER in [event.kind for event in scene.told]
    known = roster.read(scene.folder)
    assert known is not None
    assert not known.claimed  # it has never begun its work


def test_successor_that_ends_at_its_start_is_tried_again_and_then_given_up(scene: Scene) -> None:
    tries = scene.folder / "tries"
    program = f"open({str(tries)!r}, 'a').write('x')"
    scene.write(command=(sys.executable, "-c", program))
    scene.watch(starts_successor=True)
    assert 2 <= len(tries.read_text()) <= ORPHAN_S / 2.0 + 1
    assert events.NO_SUPERVISOR(limit_s=10.0) in scene.told


def test_command_that_cannot_be_started_is_said(scene: Scene) -> None:
    scene.write(command=("/nowhere/tramstream",))
    scene.watch(starts_successor=True)
    assert events.NO_SUCCESSOR in [event.kind for event in scene.told]


def test_router_starts_nobody_while_somebody_takes_the_place(scene: Scene) -> None:
    scene.write(command=SLEEP)
    held = roster.lock(scene.folder)
    scene.stop.script = [(1.0, lambda: os.close(held)), (1.0, scene.stop.set)]
    scene.watch(starts_successor=True)
    known = roster.read(scene.folder)
    assert known is not None
    assert known.supervisor in (GONE, NOBODY)


def test_successor_is_in_a_session_of_its_own(scene: Scene) -> None:
    """Ctrl-C in the terminal of the first does not reach it; `kill` does."""
    scene.write(command=SLEEP)

    def end() -> None:
        known = roster.read(scene.folder)
        assert known is not None
        pid = known.supervisor.pid
        assert os.getsid(pid) == pid != os.getsid(0)
        os.kill(pid, signal.SIGKILL)
        scene.stop.set()

    watching = threading.Thread(target=scene.watch, args=(True,))
    watching.start()
    try:
        until(
            lambda: (known := roster.read(scene.folder)) and known.supervisor.alive,
            "the successor",
        )
    finally:
        end()
    watching.join(HANG_S)
    assert not watching.is_alive()
