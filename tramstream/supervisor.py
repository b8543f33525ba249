"""Starts the nodes of a vehicle as processes of their own and starts those again that die.

The supervisor's process is the bus' router too; when it is gone, the nodes end by themselves.
Nodes end in the order bridges, processors, simulators, recorder, so that the record holds the last
word of each.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from tramstream import keys, process, registry
from tramstream.bus import Bus
from tramstream.clock import boot_id
from tramstream.config import Vehicle
from tramstream.errors import NodeError
from tramstream.node import Node
from tramstream.proto.health_pb2 import ClockReference

BACKOFF_FIRST_S = 0.2
BACKOFF_MAX_S = 10.0
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0
GOOD_RUN_S = 30.0
"""Who lived so long is started again at once."""


@dataclass
class Child:
    """One node's process."""

    name: str
    process: ForkServerProcess | None = None
    started_s: float = 0.0
    starts: int = 0
    backoff_s: float = BACKOFF_FIRST_S
    again_s: float = 0.0


class Supervisor:
    """Runs the nodes of `vehicle`.

    Parameters
    ----------
    vehicle, config_path
        The configuration and the file it came from, which the nodes read again.
    bus : Bus
        The router's session.
    say : callable
        Takes one sentence for people.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        config_path: Path,
        bus: Bus,
        say: Callable[[str], None],
        separate: bool = False,
    ) -> None:
        self.vehicle = vehicle
        self.bus = bus
        self._config_path = config_path
        self._say = say
        self._server = process.server()
        self.children = [Child(name) for name in registry.node_names(vehicle, separate)]

    def start(self) -> None:
        """Start the recorder, and once it is alive on the bus all others at once.

        Raises
        ------
        NodeError
            If a node ends at once; it has said why on standard error.
        """
        first, *others = self.children
        self._spawn(first)
        self._await_alive(first)
        for child in others:
            self._spawn(child)
        for child in others:
            self._await_alive(child)

    def watch(self) -> None:
        """Start dead nodes again whose time has come; call a few times a second."""
        now_s = time.monotonic()
        for child in self.children:
            if child.process is None:
                if now_s >= child.again_s:
                    self._spawn(child)
                continue
            status = child.process.exitcode
            if status is None:
                if now_s - child.started_s > GOOD_RUN_S:
                    child.backoff_s = BACKOFF_FIRST_S
                continue
            child.process = None
            child.again_s = now_s + child.backoff_s
            self._say(
                f"node {child.name} ended with status {status}; "
                f"starting it again in {child.backoff_s:g} s"
            )
            child.backoff_s = min(2 * child.backoff_s, BACKOFF_MAX_S)

    def stop(self) -> None:
        """End all nodes, the last started first, the recorder last."""
        for child in reversed(self.children):
            running = child.process
            if running is None:
                continue
            running.terminate()
            running.join(STOP_TIMEOUT_S)
            if running.exitcode is None:
                self._say(f"node {child.name} does not end; killing it")
                running.kill()
                running.join()
            child.process = None

    def _spawn(self, child: Child) -> None:
        child.process = process.spawn(self._server, child.name, self._config_path)
        child.started_s = time.monotonic()
        child.starts += 1

    def _await_alive(self, child: Child) -> None:
        token = keys.alive(self.vehicle.vehicle, child.name)
        running = child.process
        assert running is not None
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline_s:
            status = running.exitcode
            if status is not None:
                raise NodeError(
                    f"node {child.name} ended with status {status} at its start", status
                )
            if self.bus.alive(token):
                return
            time.sleep(0.02)
        self._say(f"node {child.name} is not on the bus after {START_TIMEOUT_S:.0f} s; going on")


class RouterNode(Node):
    """The router's own voice: descriptors for everybody, and what the clock reads against UTC."""

    CLOCK_S = 10.0

    def __init__(self, vehicle: str, bus: Bus, stop: threading.Event) -> None:
        super().__init__("router", vehicle, bus, stop)

    def expressions(self) -> list[str]:
        return []

    def handle(self, envelope: object) -> None:
        raise TypeError("the router reads nothing")

    def begin(self) -> None:
        self.bus.answer(keys.schema("*"), describe)
        self._reference()
        self.every(self.CLOCK_S, self._reference)

    def _reference(self) -> None:
        self.publish(keys.CLOCK, ClockReference(host_utc_ns=time.time_ns(), boot_id=boot_id()))


def describe(topic: str) -> bytes | None:
    """FileDescriptorSet of the message type that `topic` (`keys.schema`) ends with."""
    name = topic.rsplit("/", 1)[-1]
    for key in keys.ALL:
        if key.type.DESCRIPTOR.full_name == name:
            return keys.descriptor_set(key.type).SerializeToString()
    return None
