"""What a node does when its supervisor has vanished: it goes on, and there will be another.

A supervisor that ends in order says so in the roster and ends its nodes. When it is gone without
that (killed, crashed), the router starts a successor, which takes over the nodes that live; the
others only look whether there is anybody. Nodes that see no supervisor for `ORPHAN_S` end by
themselves, in order: router and supervisor died together, or no successor could be started. The
nodes of a ride that has no successor (`demo`) end at once.

Only time in which a node itself ran counts, so that one which was stopped for a while, or a machine
that slept, finds its supervisor again.
"""

from __future__ import annotations

import os
import select
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tramstream.events.kinds import Event
from tramstream.supervision import roster
from tramstream.supervision.events import NO_SUCCESSOR, NO_SUPERVISOR, TAKEN_OVER
from tramstream.supervision.roster import Proc, Roster

ORPHAN_S = 10.0
LOOK_S = 0.2
LOOK_MAX_S = 0.5
"""A look that took longer is one in which this process stood still."""
AGAIN_S = 2.0
"""Between two starts of a successor: one that ends at its start does so the next time, too."""


class Orphan:
    """Watches over one node from the moment on that its first supervisor is gone.

    Parameters
    ----------
    runtime_dir : Path
    stop : threading.Event
        Set when the node shall end.
    tell : callable
        Takes what happens.
    starts_successor : bool
        The router's part.
    now_s : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        runtime_dir: Path,
        stop: threading.Event,
        tell: Callable[[Event], None],
        starts_successor: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._runtime_dir = runtime_dir
        self._stop = stop
        self._tell = tell
        self._starts_successor = starts_successor
        self._now_s = now_s
        self._successor: subprocess.Popen[bytes] | None = None
        self._tried_s = now_s() - AGAIN_S

    def watch(self) -> None:
        """Return when the node has to end, or was told to."""
        alone_s = 0.0
        while not self._stop.is_set():
            known = roster.read(self._runtime_dir)
            if known is not None and not self._may_go_on(known):
                break
            if known is not None and known.supervisor.alive:
                if known.claimed:
                    alone_s = 0.0
                self._wait_for_end_of(known.supervisor)
                continue
            if known is not None and self._starts_successor:
                self._start_successor()
            if alone_s >= ORPHAN_S:
                self._tell(NO_SUPERVISOR(limit_s=ORPHAN_S))
                break
            before_s = self._now_s()
            self._stop.wait(LOOK_S)
            alone_s += min(self._now_s() - before_s, LOOK_MAX_S)
        self._stop.set()

    def _may_go_on(self, known: Roster) -> bool:
        return known.supervisor.alive or bool(known.command and not known.ending)

    def _wait_for_end_of(self, supervisor: Proc) -> None:
        """Wait until it is gone, but not for long: it may have been another all the time."""
        with suppress(ProcessLookupError):
            descriptor = os.pidfd_open(supervisor.pid)
            try:
                poll = select.poll()
                poll.register(descriptor, select.POLLIN)
                poll.poll(1000 * LOOK_MAX_S)
            finally:
                os.close(descriptor)
        if self._successor is not None:
            self._successor.poll()  # reaps it, if it is the one that has ended

    def _start_successor(self) -> None:
        """Start it, unless somebody has taken the place, or the last try is not long ago."""
        now_s = self._now_s()
        if now_s - self._tried_s < AGAIN_S:
            return
        self._tried_s = now_s
        lock = roster.try_lock(self._runtime_dir)
        if lock is None:
            return  # whoever holds it will say in the roster who he is
        try:
            known = roster.read(self._runtime_dir)
            if known is not None and not known.supervisor.alive:
                self._start(known, now_s)
        except OSError as error:
            self._tell(NO_SUCCESSOR(reason=error))
        finally:
            os.close(lock)

    def _start(self, known: Roster, now_s: float) -> None:
        successor = subprocess.Popen(
            known.successor(now_s), stdin=subprocess.DEVNULL, start_new_session=True
        )
        self._successor = successor
        # Written here: until it has imported what it needs, the nodes must not end.
        process = Proc.of(successor.pid) or roster.NOBODY
        roster.write(self._runtime_dir, roster.with_successor(known, process))
        self._tell(TAKEN_OVER(before=known.supervisor.pid, successor=successor.pid))
