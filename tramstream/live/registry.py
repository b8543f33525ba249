"""The nodes of a vehicle: which its configuration asks for, and how each is built.

Bridges, processors and whole nodes are found by entry point (`tramstream.plugins`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from tramstream import config_file, keys, plugins
from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.live import router
from tramstream.live.node import Node
from tramstream.processor import Processor
from tramstream.transport.bus import Bus

PROCESSORS = "processors"
"""Name of the node that runs the processors which have no process of their own."""


def make_processors(vehicle: Vehicle) -> list[Processor]:
    """All processors that the configuration asks for, fresh and in its order.

    Raises
    ------
    ConfigError
        If one of them is not installed.
    """
    return [make_processor(name, vehicle) for name in vehicle.running]


def make_processor(name: str, vehicle: Vehicle) -> Processor:
    """The processor called `name`, fresh."""
    made: Processor = plugins.load("processors", name)(vehicle)
    return made


def configured_bridges(vehicle: Vehicle) -> list[str]:
    """Bridges that the configuration has a section for."""
    return [name for name in plugins.names("bridges") if config_file.has_section(vehicle, name)]


def joint(vehicle: Vehicle) -> list[str]:
    """Processors that share one process."""
    return [name for name in vehicle.running if name not in vehicle.separate]


def node_names(vehicle: Vehicle) -> list[str]:
    """Nodes that `vehicle` needs, in the order in which they start; they end in the reverse one."""
    apart = [name for name in vehicle.separate if name in vehicle.running]
    processors = [*([PROCESSORS] if joint(vehicle) else []), *apart]
    simulators = ["simulators"] if vehicle.simulators else []
    return [router.NAME, "recorder", *simulators, *processors, *configured_bridges(vehicle)]


def check_node(name: str, vehicle: Vehicle) -> None:
    """Refuse a node that does not exist or that the configuration has no section for.

    Raises
    ------
    ConfigError
        One sentence; it lists the nodes that there are.
    """
    processors, bridges = plugins.names("processors"), plugins.names("bridges")
    known = [PROCESSORS, *processors, *bridges, *plugins.names("nodes"), router.NAME]
    if name not in known:
        raise ConfigError(plugins.unknown("node", name, known))
    if name in bridges and not config_file.has_section(vehicle, name):
        raise ConfigError(f"node {name}: the configuration has no section [{name}]", cure="add one")


def make_node(name: str, vehicle: Vehicle, bus: Bus, stop: threading.Event) -> Node:
    """Build the node called `name`."""
    check_node(name, vehicle)
    if name == router.NAME:
        return router.RouterNode(vehicle.vehicle, bus, stop)
    # Not above: the supervisor and a router of its own need no numpy, which takes 15 MB.
    from tramstream.live.host import Memory, ProcessorNode

    if name in plugins.names("bridges"):
        bridge = plugins.load("bridges", name)(vehicle)
        port = plugins.load("ports", name)(vehicle, bus.clock)
        return ProcessorNode(name, vehicle.vehicle, bus, stop, [bridge], [port])
    if name == PROCESSORS or name in plugins.names("processors"):
        own = joint(vehicle) if name == PROCESSORS else [name]
        processors = [make_processor(each, vehicle) for each in own]
        path = vehicle.runtime_dir / f"{name}.snapshot"
        memory = Memory(path, config_file.digest(vehicle), _ticks(own, vehicle))
        return ProcessorNode(name, vehicle.vehicle, bus, stop, processors, (), memory)
    build: Callable[[Vehicle, Bus, threading.Event], Node] = plugins.load("nodes", name)
    return build(vehicle, bus, stop)


def _ticks(own: list[str], vehicle: Vehicle) -> bool:
    """Whether the node that runs `own` makes the ticks: with the first processor that reads them.

    There is one maker of ticks on a vehicle; a node of its own that reads them has them off the
    bus, like anything else.
    """
    for name in [*vehicle.running, *own]:
        if keys.SYNC_TICK in plugins.load("processors", name).inputs:
            return name in own
    return False
