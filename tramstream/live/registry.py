"""Nodes, bridges and processors by name, found by entry point: the library imports none of them.

Groups: `tramstream.bridges` (processor class), `tramstream.ports` (port factory of the bridge with
the same name), `tramstream.processors` (processor class), `tramstream.nodes` (whole node).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from tramstream import config
from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.live import router
from tramstream.live.node import Node
from tramstream.processor import Processor
from tramstream.transport.bus import Bus

PROCESSORS = "processors"
"""Name of the node that runs all processors in one process."""
SNAPSHOT_FILE = "processors.snapshot"


def names(group: str) -> list[str]:
    """Names registered in `tramstream.<group>`."""
    return [point.name for point in _points(group)]


def load(group: str, name: str) -> Any:
    """The object registered as `name`.

    Raises
    ------
    ConfigError
        If there is none; the sentence lists those that there are.
    """
    for point in _points(group):
        if point.name == name:
            return point.load()
    known = ", ".join(names(group)) or "none; is tramstream installed (`pip install -e .`)?"
    raise ConfigError(f"no {group.rstrip('s')} is called {name!r}; there are: {known}")


def _points(group: str) -> list[EntryPoint]:
    return sorted(entry_points(group=f"tramstream.{group}"), key=lambda point: point.name)


def make_processors(vehicle: Vehicle) -> list[Processor]:
    """All processors, fresh."""
    return [load("processors", name)(vehicle) for name in names("processors")]


def configured_bridges(vehicle: Vehicle) -> list[str]:
    """Bridges that the configuration has a section for."""
    return [name for name in names("bridges") if getattr(vehicle, name, None) is not None]


def node_names(vehicle: Vehicle, separate: bool = False) -> list[str]:
    """Nodes that `vehicle` needs, in the order in which they start; they end in the reverse one."""
    processors = names("processors") if separate else [PROCESSORS]
    simulators = ["simulators"] if vehicle.simulators else []
    return [router.NAME, "recorder", *simulators, *processors, *configured_bridges(vehicle)]


def check_node(name: str, vehicle: Vehicle) -> None:
    """Refuse a node that does not exist or that the configuration has no section for.

    Raises
    ------
    ConfigError
        One sentence; it lists the nodes that there are.
    """
    parts = [*names("processors"), *names("bridges"), *names("nodes")]
    known = [PROCESSORS, *parts, router.NAME]
    if name not in known:
        raise ConfigError(f"no node is called {name!r}; there are: {', '.join(known)}")
    if name in names("bridges") and getattr(vehicle, name, None) is None:
        raise ConfigError(f"node {name}: the configuration has no section [{name}]; add one")


def make_node(name: str, vehicle: Vehicle, bus: Bus, stop: threading.Event) -> Node:
    """Build the node called `name`."""
    check_node(name, vehicle)
    if name == router.NAME:
        return router.RouterNode(vehicle.vehicle, bus, stop)
    # Not above: the supervisor and a router of its own need no numpy, which takes 15 MB.
    from tramstream.live.host import ProcessorNode

    if name in names("bridges"):
        bridge = load("bridges", name)(vehicle)
        port = load("ports", name)(vehicle, bus.clock)
        return ProcessorNode(name, vehicle.vehicle, bus, stop, [bridge], [port])
    if name == PROCESSORS or name in names("processors"):
        processors = (
            make_processors(vehicle) if name == PROCESSORS else [load("processors", name)(vehicle)]
        )
        snapshot_path = vehicle.runtime_dir / SNAPSHOT_FILE if name == PROCESSORS else None
        digest = config.digest(vehicle)
        return ProcessorNode(
            name, vehicle.vehicle, bus, stop, processors, (), snapshot_path, digest
        )
    build: Callable[[Vehicle, Bus, threading.Event], Node] = load("nodes", name)
    return build(vehicle, bus, stop)
