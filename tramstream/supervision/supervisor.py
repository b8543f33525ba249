"""Starts the nodes of a vehicle as processes of their own, and again those that die or freeze.

The router is a node like the others; it starts first and ends last. Nodes end in the order bridges,
processors, simulators, recorder, router, so that the record holds the last word of each. A
supervisor that comes after one that was killed takes over the nodes that live, and does not start
them twice: see `tramstream.supervision.roster` and `tramstream.supervision.succession`.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from tramstream import config_file, keys
from tramstream.config import Vehicle
from tramstream.errors import BusError, NodeError
from tramstream.events.kinds import Event
from tramstream.live import registry, router
from tramstream.supervision import events, roster
from tramstream.supervision.child import Child
from tramstream.supervision.hearing import PATIENCE_S, READY_S, carries, hears
from tramstream.supervision.heartbeats import FROZEN_S, Heartbeats, Silence
from tramstream.supervision.process import Forks, Running
from tramstream.supervision.roster import Proc
from tramstream.transport.bus import Bus

START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0
STOP_RECORDER_S = 40.0
"""The recorder asks publishers for what is missing, and a slow disk takes what waits in memory."""
LAST_WORD_S = 2.0
POLL_S = 0.02


@dataclass(frozen=True)
class Plan:
    """What a supervisor runs.

    `successor` is the command that starts another supervisor in its place, with `roster.REST` for
    the seconds that are left; empty where nobody shall go on.
    """

    vehicle: Vehicle
    config_path: Path
    rate: float = 1.0
    successor: Sequence[str] = ()


class Supervisor:
    """Runs the nodes of a vehicle.

    Parameters
    ----------
    plan : Plan
    tell : callable
        Takes what happens.
    start : callable or None
        Starts the node of a name; by default as a fork of one server.
    now_s : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        plan: Plan,
        tell: Callable[[Event], None],
        start: Callable[[str], Running] | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.plan = plan
        self.took_over = False
        """Whether there were nodes of a supervisor before this one."""
        self.unheard: Event | None = None
        """Whether the recorder did not end in order: its last messages may be missing."""
        self._runtime_dir = plan.vehicle.runtime_dir
        self._tell = tell
        self._start = start or Forks(plan.config_path, self._runtime_dir).start
        self._now_s = now_s
        self._heartbeats = Heartbeats(router.NAME)
        self._watched_s = now_s()
        self._lock: int | None = None
        self._roster = msgspec.structs.replace(
            roster.fresh(),
            claimed=True,
            command=tuple(plan.successor),
            configuration=config_file.text_digest(config_file.to_json(plan.vehicle)),
        )
        self.children = [Child(name) for name in registry.node_names(plan.vehicle)]

    # Beginning -----------------------------------------------------------------------------------
    def claim(self) -> None:
        """Become the one supervisor of the runtime folder; take over what one before has left.

        Raises
        ------
        BusError
            If somebody else is.
        """
        self._lock = roster.lock(self._runtime_dir)
        before = roster.read(self._runtime_dir)
        living = before.living() if before is not None else {}
        me = Proc.of(os.getpid()) or roster.NOBODY
        self._roster = msgspec.structs.replace(self._roster, supervisor=me)
        if before is not None and living:
            names = {child.name for child in self.children}
            same = before.configuration == self._roster.configuration and set(living) <= names
            if same and before.command and not before.ending:
                self._adopt(before, living)
            else:
                self._end_strangers(living)
        self._save()

    def _adopt(self, before: roster.Roster, living: dict[str, Proc]) -> None:
        self.took_over = True
        self._roster = msgspec.structs.replace(self._roster, lost=before.lost)
        for child in self.children:
            process = living.get(child.name)
            if process is None:
                continue
            running = Running(process.pid)
            if not process.alive:  # looked at only now that nobody else can get its number
                running.close()
                continue
            child.running = running
            child.started_s = self._now_s()
            child.starts = 1
            self._heartbeats.started(child.name, heard=True)

    def _end_strangers(self, living: dict[str, Proc]) -> None:
        """Nodes of other settings, or of a supervisor that was ending them, are not taken over."""
        self._tell(events.ENDING_OTHERS(nodes=", ".join(living)))
        for name, process in reversed(living.items()):
            self._end(name, Running(process.pid))

    def join(self, connect: Callable[[], Bus]) -> Bus:
        """Start the router if there is none, and return the session that `connect` opens with it.

        Raises
        ------
        NodeError
            If the router ends at its start; it has said why on standard error.
        BusError
            If it cannot be reached for as long as a node may take to start.
        """
        child = self.children[0]
        if child.running is None:
            self._spawn(child)
        begin_s = since_s = self._now_s()
        while True:
            try:
                return connect()
            except BusError:
                now_s = self._now_s()
                if now_s - begin_s > START_TIMEOUT_S:
                    raise
            assert child.running is not None
            if child.running.ended(POLL_S):
                if not self.took_over:
                    raise self._ended_at_start(child, child.running)
                self._replace(child)
            elif self.took_over and now_s - since_s > FROZEN_S:
                self._tell(events.NO_ANSWER(node=child.name))
                child.running.send(signal.SIGKILL)
                since_s = now_s

    def start(self, bus: Bus, each: Callable[[], None] = lambda: None) -> None:
        """Start the recorder, and once it is alive on the bus all others at once.

        Where nodes were taken over, `watch` starts those that are missing.

        Parameters
        ----------
        bus : Bus
        each : callable
            Called while waiting, a few times a second.

        Raises
        ------
        NodeError
            If a node ends at once; it has said why on standard error.
        """
        if self.took_over:
            return
        _, first, *others = self.children
        for group in ([first], others):
            for child in group:
                self._spawn(child)
            for child in group:
                self._await_alive(bus, child, each)

    def end_at(self, ends_s: float) -> None:
        """Let a successor know when the run ends, on the monotonic clock; 0 is never."""
        self._roster = msgspec.structs.replace(self._roster, ends_s=ends_s)
        self._save()

    # Watching ------------------------------------------------------------------------------------
    def heard(self, name: str, pid: int) -> None:
        """Take note of a heartbeat; of another process than the node's own it is none."""
        for child in self.children:
            running = child.running
            if child.name != name or running is None or running.pid != pid:
                continue
            if self._heartbeats.beat(name):
                self._tell(events.HEARD_AGAIN(node=name))

    @property
    def lost(self) -> int:
        """Messages missing in the records of this run, as far as `lose` was told."""
        return self._roster.lost

    def lose(self, count: int) -> None:
        """So many more messages are missing in the records."""
        self._roster = msgspec.structs.replace(self._roster, lost=self._roster.lost + count)
        self._save()

    def watch(self) -> None:
        """Start dead nodes again whose time has come, end frozen ones; call ten times a second."""
        now_s = self._now_s()
        dt_s, self._watched_s = now_s - self._watched_s, now_s
        for child in self.children:
            self._look_after(child, now_s)
        # A ride on a slower clock has slower heartbeats.
        for silence in self._heartbeats.pass_time(dt_s * min(1.0, self.plan.rate)):
            self._break_silence(silence)

    def _look_after(self, child: Child, now_s: float) -> None:
        running = child.running
        if running is None:
            if now_s >= child.again_s:
                self._spawn(child)
            return
        if not running.ended():
            child.lived_until(now_s)
            return
        status = running.status()
        self._bury(child, running)
        name, pause_s = child.name, child.died(now_s)
        if status is None:
            self._tell(events.NODE_GONE(node=name, again_s=pause_s))
        else:
            self._tell(events.NODE_ENDED(node=name, status=status, again_s=pause_s))
        if now_s >= child.again_s:
            self._spawn(child)

    def _break_silence(self, silence: Silence) -> None:
        kind = events.NODE_FROZEN if silence.frozen else events.NODE_SILENT
        self._tell(kind(node=silence.name, limit_s=silence.limit_s))
        if not silence.frozen:
            return
        for child in self.children:
            if child.name == silence.name and child.running is not None:
                child.running.send(signal.SIGKILL)  # a stopped process takes no other

    # Ending --------------------------------------------------------------------------------------
    def stop_nodes(self, bus: Bus | None, each: Callable[[], None] = lambda: None) -> None:
        """End all nodes but the router: the last started first, the recorder last.

        With the bus, see to it that a recorder hears the others end, and wait for its last words;
        `each` is called while waiting.
        """
        self._roster = msgspec.structs.replace(self._roster, ending=True)
        self._save()
        if bus is not None and any(child.lives for child in self.children[2:]):
            self._have_them_heard(bus, each)
        for child in reversed(self.children[2:]):
            self._stop(child)
            each()
        self._stop_recorder(self.children[1])
        if bus is None:
            return
        # Who has left the bus in the router's eyes has been heard to the end by then.
        end_s = self._now_s() + LAST_WORD_S
        token = keys.alive(self.plan.vehicle.vehicle, self.children[1].name)
        while bus.alive(token) and self._now_s() < end_s:
            each()
        each()

    def _have_them_heard(self, bus: Bus, each: Callable[[], None]) -> None:
        """See to it that a recorder hears and asks the others for what none has."""
        recorder, vehicle = self.children[1], self.plan.vehicle.vehicle

        def wait(seconds: float) -> bool:
            self._look_after(self.children[0], self._now_s())
            each()
            return recorder.running is not None and not recorder.running.ended(seconds)

        try:
            for _ in range(2):
                patience_s = PATIENCE_S
                if not recorder.lives:
                    self._replace(recorder)
                    self._await_alive(bus, recorder, each)
                    patience_s = READY_S
                if hears(bus, vehicle, wait, patience_s, self._now_s):
                    return
                if recorder.running is not None and recorder.lives:
                    if not carries(bus, vehicle, wait):
                        self._tell(events.BUS_DEAD())
                        break
                    self._tell(events.NO_ANSWER(node=recorder.name))
                    recorder.running.send(signal.SIGKILL)
                    recorder.running.ended(STOP_TIMEOUT_S)
        except NodeError as error:
            self._tell(events.NOT_STARTED(reason=error.reason, advice=error.cure))
        self.unheard = events.RECORDER_DEAF(node=recorder.name)

    def _replace(self, child: Child) -> None:
        if child.running is not None:
            self._bury(child, child.running)
        self._spawn(child)

    def _stop_recorder(self, recorder: Child) -> None:
        """End it behind all others; take note if what it had in memory may be lost."""
        running, recorder.running = recorder.running, None
        if running is None:
            return
        gone = "was gone" if running.ended() else ""
        if how := self._end(recorder.name, running) or gone:
            self.unheard = events.RECORDER_BROKEN_OFF(node=recorder.name, how=how)
            self._tell(self.unheard)

    def stop_router(self) -> None:
        """End the router, and give the supervisor's place away."""
        self._stop(self.children[0])
        if self._lock is not None:
            roster.remove(self._runtime_dir)
            os.close(self._lock)
            self._lock = None

    def _stop(self, child: Child) -> None:
        running, child.running = child.running, None
        if running is not None:
            self._end(child.name, running)

    def _end(self, name: str, running: Running) -> str:
        """End a process; how it ended if not in order."""
        running.send(signal.SIGTERM)
        recorder = self.children[1].name
        if not running.ended(STOP_RECORDER_S if name == recorder else STOP_TIMEOUT_S):
            self._tell(events.DOES_NOT_END(node=name))
            running.send(signal.SIGKILL)
            running.ended(STOP_TIMEOUT_S)
        status = running.status()
        running.close()
        return f"ended with status {status}" if status else ""

    # Processes -----------------------------------------------------------------------------------
    def _spawn(self, child: Child) -> None:
        child.running = self._start(child.name)
        child.started_s = self._now_s()
        child.starts += 1
        self._heartbeats.started(child.name)
        self._save()

    def _bury(self, child: Child, running: Running) -> None:
        running.close()
        child.running = None
        self._heartbeats.ended(child.name)

    def _await_alive(self, bus: Bus, child: Child, each: Callable[[], None]) -> None:
        token = keys.alive(self.plan.vehicle.vehicle, child.name)
        deadline_s = self._now_s() + START_TIMEOUT_S
        while self._now_s() < deadline_s:
            running = child.running
            if running is not None and running.ended(POLL_S):
                raise self._ended_at_start(child, running)
            if bus.alive(token):
                return
            self._look_after(self.children[0], self._now_s())
            each()
        self._tell(events.NOT_ON_BUS(node=child.name, limit_s=START_TIMEOUT_S))

    def _ended_at_start(self, child: Child, running: Running) -> NodeError:
        status = running.status() or 0
        self._bury(child, running)
        return NodeError(f"node {child.name} ended with status {status} at its start", status)

    def _save(self) -> None:
        """Write the roster; without it the vehicle runs, but no successor finds its nodes."""
        nodes = {
            child.name: process
            for child in self.children
            if child.running is not None and (process := Proc.of(child.running.pid)) is not None
        }
        self._roster = msgspec.structs.replace(self._roster, nodes=nodes)
        if self._lock is None:
            return
        try:
            roster.write(self._runtime_dir, self._roster)
        except OSError as error:
            self._tell(events.ROSTER_REFUSED(folder=self._runtime_dir, reason=error.strerror))
