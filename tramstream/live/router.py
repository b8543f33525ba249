"""The router as a node: all meet at it; it describes message types and tells clock and UTC."""

from __future__ import annotations

import threading
import time

from tramstream import keys
from tramstream.clock import boot_id
from tramstream.live.node import Node
from tramstream.proto.health_pb2 import ClockReference
from tramstream.transport.bus import Bus
from tramstream.transport.descriptions import tell

NAME = "router"


class RouterNode(Node):
    """The router's own voice: descriptors for everybody, and what the clock reads against UTC.

    Parameters
    ----------
    bus : Bus
        The router's session.
    """

    CLOCK_S = 10.0

    def __init__(self, vehicle: str, bus: Bus, stop: threading.Event) -> None:
        super().__init__(NAME, vehicle, bus, stop)

    def expressions(self) -> list[str]:
        return []

    def handle(self, envelope: object) -> None:
        raise TypeError("the router reads nothing")

    def begin(self) -> None:
        tell(self.bus, keys.TYPES.values())
        self._reference()
        self.every(self.CLOCK_S, self._reference)

    def _reference(self) -> None:
        self.publish(keys.CLOCK, ClockReference(host_utc_ns=time.time_ns(), boot_id=boot_id()))
