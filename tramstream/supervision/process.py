"""A node as a process: what it runs, the server that forks it, and the hold that a supervisor has.

Nodes are forked off a server that has imported everything once and has no threads: they share its
memory (six processes would else hold the same libraries six times) and start in milliseconds, which
is what counts when one has died on the way. The server is multiprocessing's own. It lives as long
as one of its nodes does, whoever started it.
"""

from __future__ import annotations

import multiprocessing
import os
import select
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path

from tramstream import plugins
from tramstream.clock import VehicleClock
from tramstream.config_file import load
from tramstream.errors import TramstreamError
from tramstream.live import registry, router
from tramstream.supervision.succession import Orphan
from tramstream.transport import buses
from tramstream.transport.bus import Bus, ZenohBus

GROUPS = ("bridges", "ports", "processors", "nodes")
PRELOAD = "tramstream.supervision.preload"
OURS = "tramstream"
"""Name of our distribution."""
REPORT_S = 2.0
"""The fork server tells a child's status as soon as it runs."""


class Running:
    """A node's process: our child, or one that the supervisor before us has started.

    Held by a descriptor (pidfd) and not by its number, which may be somebody else's by now.

    Parameters
    ----------
    pid : int
    child : ForkServerProcess or None
        None for a process that is no child of ours.
    """

    def __init__(self, pid: int, child: ForkServerProcess | None = None) -> None:
        self.pid = pid
        self._child = child
        try:
            self._descriptor = os.pidfd_open(pid)
        except ProcessLookupError:  # it has ended already
            self._descriptor = -1

    def ended(self, timeout_s: float = 0.0) -> bool:
        """Whether it is gone; waits for it for `timeout_s`."""
        if self._descriptor < 0:
            return True
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        return bool(poll.poll(1000.0 * timeout_s))

    def status(self) -> int | None:
        """Exit status once it is gone, negative for a signal; None if only its parent knows."""
        if self._child is None:
            return None
        self._child.join(REPORT_S)
        return self._child.exitcode

    def send(self, number: signal.Signals) -> None:
        """Signal it, if it is there."""
        if self._descriptor >= 0:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._descriptor, number)

    def close(self) -> None:
        """Let go of it."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def run_node(name: str, config: Path, stop: threading.Event) -> None:
    """Run one node of the vehicle in `config`, or its router, until `stop` is set."""
    vehicle = load(config)
    registry.check_node(name, vehicle)  # before waiting for a router that may never come
    clock = VehicleClock.shared(vehicle.runtime_dir)
    bus: Bus
    if name == router.NAME:
        bus = ZenohBus.route(vehicle.runtime_dir, clock)
        buses.note(vehicle.runtime_dir)
    else:
        bus = ZenohBus.connect(vehicle.runtime_dir, clock, stop)
    try:
        registry.make_node(name, vehicle, bus, stop).run()
    finally:
        bus.close()


class Forks:
    """Starts the nodes of the vehicle in `config`."""

    def __init__(self, config: Path, runtime_dir: Path) -> None:
        self._config = str(config)
        self._runtime_dir = str(runtime_dir)
        self._context = server()

    def start(self, name: str) -> Running:
        """Start a node; the process is ended by SIGTERM, or for want of a supervisor."""
        process = self._context.Process(
            target=_main, args=(name, self._config, self._runtime_dir), name=name
        )
        process.start()
        assert process.pid is not None
        return Running(process.pid, process)


def server() -> ForkServerContext:
    """The server's context, told what to import before it forks."""
    context = multiprocessing.get_context("forkserver")
    # Ours that are loaded here too: multiprocessing imports the main module in every process.
    ours = sorted(name for name in sys.modules if name.startswith("tramstream."))
    context.set_forkserver_preload([*ours, PRELOAD])
    return context


def import_nodes() -> None:
    """Import every module of ours that a node may need; strangers' are imported where they run."""
    for group in GROUPS:
        for point in plugins.points(group):
            if point.dist is not None and point.dist.name == OURS:
                point.load()


def _main(name: str, config: str, runtime_dir: str) -> None:
    os.setsid()  # Ctrl-C is for the supervisor, which ends the nodes in order
    Path("/proc/self/comm").write_text(f"tram-{name}")  # what top and ps show
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    orphan = Orphan(
        Path(runtime_dir),
        stop,
        lambda event: _say(name, str(event)),
        starts_successor=name == router.NAME,
    )
    threading.Thread(target=_outlive, args=(orphan,), name="parent", daemon=True).start()
    try:
        run_node(name, Path(config), stop)
    except TramstreamError as error:
        _say(name, str(error))
        sys.exit(error.exit_status)


def _outlive(orphan: Orphan) -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    orphan.watch()


def _say(name: str, text: str) -> None:
    with suppress(OSError):  # the terminal that the run was started from is closed
        sys.stderr.write(f"tramstream: node {name}: {text}\n")
        sys.stderr.flush()
