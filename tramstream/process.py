"""A node as a process: what it runs, and the server that forks it.

Nodes are forked off a server that has imported everything once and has no threads: they share its
memory (six processes would else hold the same libraries six times) and start in milliseconds, which
is what counts when one has died on the way. The server is multiprocessing's own.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from importlib.metadata import entry_points
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path

from tramstream import registry
from tramstream.bus import Bus, ZenohBus
from tramstream.clock import VehicleClock
from tramstream.config import load
from tramstream.errors import TramstreamError

GROUPS = ("bridges", "ports", "processors", "nodes")
PRELOAD = "tramstream.preload"


def run_node(name: str, config: Path, stop: threading.Event) -> None:
    """Run one node of the vehicle in `config` until `stop` is set."""
    vehicle = load(config)
    registry.check_node(name, vehicle)  # before waiting for a router that may never come
    clock = VehicleClock.shared(vehicle.runtime_dir)
    bus: Bus = ZenohBus.connect(vehicle.runtime_dir, clock, stop)
    try:
        registry.make_node(name, vehicle, bus, stop).run()
    finally:
        bus.close()


def server() -> ForkServerContext:
    """The server's context, told what to import before it forks."""
    context = multiprocessing.get_context("forkserver")
    # Ours that are loaded here too: multiprocessing imports the main module in every process.
    ours = sorted(name for name in sys.modules if name.startswith("tramstream."))
    context.set_forkserver_preload([*ours, PRELOAD])
    return context


def spawn(context: ForkServerContext, name: str, config: Path) -> ForkServerProcess:
    """Start a node; the process is ended by SIGTERM, or by the end of this process."""
    process = context.Process(target=_main, args=(name, str(config)), name=name)
    process.start()
    return process


def import_nodes() -> None:
    """Import every module that a node may need."""
    for group in GROUPS:
        for point in entry_points(group=f"tramstream.{group}"):
            point.load()


def _main(name: str, config: str) -> None:
    os.setsid()  # Ctrl-C is for the supervisor, which ends the nodes in order
    Path("/proc/self/comm").write_text(f"tram-{name}")  # what top and ps show
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_stop_with_parent, args=(stop,), name="parent", daemon=True).start()
    try:
        run_node(name, Path(config), stop)
    except TramstreamError as error:
        sys.stderr.write(f"tramstream: node {name}: {error}\n")
        sys.exit(error.exit_status)


def _stop_with_parent(stop: threading.Event) -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    stop.set()
