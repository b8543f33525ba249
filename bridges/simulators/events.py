"""What simulated devices have to say of themselves: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, INFO, define

FAULT_INJECTED = define(
    "simulators.fault_injected",
    "{device}: injected {faults}",
    cause="The scenario asks for a fault, as a test of what a vehicle makes of it.",
    severity=INFO,
    device=str,
    faults=str,
)
SIMULATORS_FAILED = define(
    "simulators.failed",
    "{reason}",
    cause="The simulated devices cannot be made here.",
    cure="{advice}",
    severity=ERROR,
    reason=str,
    advice=str,
)
