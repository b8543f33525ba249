"""The simulators as a node: truth and injected faults on the bus, tallies in the heartbeat."""

from __future__ import annotations

import threading
from typing import Any

from tramstream import keys
from tramstream.bridges.simulators.devices import run_simulators
from tramstream.bridges.simulators.events import FAULT_INJECTED, SIMULATORS_FAILED
from tramstream.config import Vehicle
from tramstream.errors import TramstreamError
from tramstream.live.node import Node
from tramstream.processor import Ledger
from tramstream.proto.raw_pb2 import TruthState
from tramstream.transport.bus import Bus, Envelope

NAME = "simulators"
FAULTS = "injected"
"""Stage name of the ledgers that count injected faults: their unit is the fault's name."""
OVERRUN = "overrun"
"""Stage name of the ledgers that count what a slow reader had no room for."""
LOST = (OVERRUN, "unplugged", "unheard")


class SimulatorNode(Node):
    """Runs the simulated devices in a thread and says what they did.

    Its ledgers: per device and unit what was produced, what reached the line (delivered) and what
    did not (dropped); of that what the reader was too slow for; and the injected faults.
    """

    def __init__(self, vehicle: Vehicle, bus: Bus, stop: threading.Event) -> None:
        super().__init__(NAME, vehicle.vehicle, bus, stop)
        self._vehicle = vehicle
        self._devices: dict[str, dict[str, Any]] = {}
        self._thread = threading.Thread(target=self._simulate, name=NAME, daemon=True)

    def expressions(self) -> list[str]:
        return []

    def handle(self, envelope: Envelope) -> None:
        raise TypeError("simulators read nothing from the bus")

    def begin(self) -> None:
        self._thread.start()

    def finish(self) -> None:
        self._thread.join(2.0)
        while len(self.ring):
            self._turn(0.0)

    def _simulate(self) -> None:
        put = self.ring.put
        try:
            run_simulators(
                self._vehicle,
                self.clock,
                self.stop,
                truth=lambda state: put("truth", state),
                report=lambda event: put("event", event),
            )
        except TramstreamError as error:
            put("error", error)

    def handle_item(self, item: Any) -> None:
        if isinstance(item, TruthState):
            sequence = self._sequences.get(keys.TRUTH_STATE.path, 0) + 1
            self._sequences[keys.TRUTH_STATE.path] = item.sequence = sequence
            self.put(keys.TRUTH_STATE, item, sequence)
        elif isinstance(item, TramstreamError):
            failed = SIMULATORS_FAILED(reason=item.reason, advice=item.cure)
            self.troubles = [failed]
            self.tell(failed)
        elif item["event"] == "progress":
            self._devices = item["devices"]
        elif item["event"] == "fault":
            faults = ", ".join(f"{name} ({count})" for name, count in item["faults"].items())
            self.tell(FAULT_INJECTED(device=item["device"], faults=faults))

    def ledgers(self) -> list[Ledger]:
        ledgers = []
        for name, device in self._devices.items():
            units = {unit for tally in ("sent", *LOST) for unit in device[tally]}
            for unit in sorted(units):
                sent = device["sent"].get(unit, 0)
                lost = sum(device[tally].get(unit, 0) for tally in LOST)
                ledgers.append(Ledger(name, unit, sent + lost, sent, lost))
            for unit, count in sorted(device[OVERRUN].items()):
                ledgers.append(Ledger(f"{name} {OVERRUN}", unit, count, 0, count))
            for fault, count in sorted(device["faults"].items()):
                ledgers.append(Ledger(f"{name} {FAULTS}", fault, count, count))
        return ledgers


def build(vehicle: Vehicle, bus: Bus, stop: threading.Event) -> SimulatorNode:
    """Make the node; the entry point of `tramstream.nodes`."""
    return SimulatorNode(vehicle, bus, stop)
