"""What a ride says of its vehicle, in the fields of the configuration, for the fleet's table.

The constants of `calibration` are what the configuration leaves; here they are put on top of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tramstream.analysis.fleet.changes import State
from tramstream.analysis.fleet.outcome import Figure, Finding
from tramstream.analysis.odometry.calibration import (
    ANTENNA_AHEAD,
    ANTENNA_LEFT,
    RECEIVER_DELAY,
    WHEEL_DELAY,
    Calibration,
    calibrate,
)
from tramstream.analysis.odometry.material import Ride, read_ride
from tramstream.calibrated import Provenance, Source
from tramstream.calibration_file import document
from tramstream.config import Vehicle

VERB = "calibrate"
RECEIVER, WHEELS = "gnss.receiver_delay_s", "wheels.delay_s"
PER_PULSE = "m_per_pulse"


class Detail(NamedTuple):
    """What the verb prints beside the table."""

    calibration: Calibration
    source: Source
    lever_arm_m: tuple[float, float, float]
    """As configured."""
    pivot_m: float
    pivot_known: bool
    left_out: str


def find(paths: list[Path], vehicle: Vehicle | None = None) -> Finding:
    """Calibrate by the ride in `paths`."""
    ride = read_ride(paths, vehicle)
    found = calibrate(ride)
    config = ride.vehicle
    ekf, end_ns = config.ekf, ride.origin_ns + round(ride.duration_s * 1e9)
    told = ekf.pivot_std_m >= 0.0 or ekf.pivot_m != 0.0 or ekf.bogie_distance_m != 0.0
    detail = Detail(
        found,
        Source.of(str(paths[0]), ride.name, ride.origin_ns, end_ns),
        config.gnss.lever_arm_m if config.gnss is not None else (0.0, 0.0, 0.0),
        ekf.pivot_m,
        told,
        ride.left_out,
    )
    return Finding(
        ride.name,
        ride.origin_ns,
        ride.duration_s,
        ride.digest,
        found.verdict,
        tuple(_absolute(ride, found)),
        detail,
        ride.damaged,
    )


def _absolute(ride: Ride, found: Calibration) -> Iterable[Figure]:
    """Figures that are told, in the fields of the configuration."""
    gnss, wheels = ride.vehicle.gnss, ride.vehicle.wheels
    per_pulse = {one.name: one.m_per_pulse for one in ride.wheels}
    for each in found.figures:
        if not each.told:
            continue
        field, value, std, unit = each.name, each.value, each.std, each.unit
        kind, _, name = field.partition(" ")
        if kind == "scale" and per_pulse.get(name):
            constant = per_pulse[name]
            field, value, std = f"wheels.each.{name}.{PER_PULSE}", (1 + value) * constant, std
            std, unit = std * constant, "m"
        elif field == RECEIVER_DELAY:
            field, value = RECEIVER, value + (gnss.receiver_delay_s if gnss is not None else 0.0)
        elif field == WHEEL_DELAY:
            field, value = WHEELS, value + wheels.delay_s
        yield Figure(field=field, value=value, std=std, unit=unit)


def fragment(states: Iterable[State], details: Iterable[Detail]) -> str:
    """The text of a vehicle's calibration; empty if nothing is known.

    A clock that is seconds off is none of it: that is repaired, and not configured.
    """
    of = {state.field: state for state in states}
    used = list(details)
    last = used[-1]
    off = any(detail.calibration.clock.sensor for detail in used)
    sections: dict[str, dict[str, Any]] = {}
    std: dict[str, float | tuple[float, ...]] = {}
    each: dict[str, Mapping[str, float]] = {}
    for field, state in of.items():
        if not field.endswith(f".{PER_PULSE}"):
            continue
        name = field.split(".")[2]
        each[name] = {PER_PULSE: state.value, "scale_std": state.std / state.value}
        std[field] = state.std
    if each:
        sections["wheels"] = {"each": each}
    if WHEELS in of and not off:
        wheels = sections.setdefault("wheels", {})
        # Plain values stand before tables.
        sections["wheels"] = {"delay_s": of[WHEELS].value, "delay_std_s": of[WHEELS].std} | wheels
        std[WHEELS] = of[WHEELS].std
    gnss: dict[str, Any] = {}
    if RECEIVER in of and not off and of[RECEIVER].value >= 0.0:
        gnss |= {"receiver_delay_s": of[RECEIVER].value, "delay_std_s": of[RECEIVER].std}
        std[RECEIVER] = of[RECEIVER].std
    notes = ["the antenna's height is as it was configured: a ride does not tell it"]
    if ANTENNA_AHEAD in of and ANTENNA_LEFT in of and last.pivot_known:
        arm = (of[ANTENNA_AHEAD].value - last.pivot_m, of[ANTENNA_LEFT].value, last.lever_arm_m[2])
        gnss["lever_arm_m"] = list(arm)
        std["gnss.lever_arm_m"] = (of[ANTENNA_AHEAD].std, of[ANTENNA_LEFT].std, math.inf)
    elif ANTENNA_AHEAD in of:
        notes = [
            "gnss.lever_arm_m is not here: the antenna is known from the point that does not slip "
            "sideways, and nobody has said where that is ($.ekf.pivot_m, $.ekf.pivot_std_m)"
        ]
    if gnss:
        sections["gnss"] = gnss
    if not sections:
        return ""
    std = {name: value for name, value in std.items() if not isinstance(value, tuple)} | {
        name: value[:2] for name, value in std.items() if isinstance(value, tuple)
    }
    sources = tuple(detail.source for detail in used if not detail.calibration.verdict)
    return document(sections, Provenance.now(VERB, sources, std, tuple(notes)))
