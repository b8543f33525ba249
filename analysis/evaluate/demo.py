"""What a demo ride came to: errors against the known truth, losses, injected faults and what the
bridges made of them. All of it is read from the record."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate import errors
from tramstream.analysis.evaluate.errors import Statistics
from tramstream.boundary import Undecodable
from tramstream.bridges.simulators.node import FAULTS, OVERRUN
from tramstream.clock import S
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.health_pb2 import DeviceHealth, Loss, NodeHealth
from tramstream.recorder.columns import RideSeries, read_ride
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import vehicle_of

_DECODED = frozenset(
    (
        keys.TRUTH_STATE.path,
        keys.EST_DISTANCE.path,
        keys.GNSS_FIX.path,
        NodeHealth,
        DeviceHealth,
        Loss,
    )
)
"""Paths and types that the figures are made of."""


@dataclass
class DemoReport:
    """Figures of one demo record."""

    duration_s: float = 0.0
    messages: int = 0
    lost: int = 0
    """Messages that any node missed, by sequence numbers, and samples unaccounted for."""
    distance_m: float = 0.0
    distance_rms_m: float = 0.0
    distance_end_m: float = 0.0
    speed_rms_mps: float = 0.0
    gnss_speed_rms_mps: float = 0.0
    position_rms_m: float | None = None
    """Horizontal, once the localisation filter knows its heading; None if it never did."""
    gnss_position_rms_m: float | None = None
    """The same of the fixes as they are."""
    yaw_rms_deg: float | None = None
    rates_hz: dict[str, float] = field(default_factory=dict)
    injected: dict[str, int] = field(default_factory=dict)
    found: dict[str, int] = field(default_factory=dict)
    overrun: dict[str, int] = field(default_factory=dict)
    """What the simulated lines had no room for, because this machine read too late."""
    unbalanced: list[str] = field(default_factory=list)
    """Stages whose ledger does not add up."""


def summarise(path: Path) -> DemoReport:
    """Read the record of a demo and reckon."""
    report = DemoReport()
    arrivals: dict[str, list[int]] = {}
    last: dict[str, Any] = {}
    truth: list[tuple[int, float, float]] = []
    estimate: list[tuple[int, float, float]] = []
    gnss: list[tuple[int, float]] = []
    with open_record(path) as record:
        report.duration_s = (record.end_ns - record.start_ns) / S
        report.messages = record.message_count
        for entry in record.messages():
            key_path = keys.split(entry.topic)[1]
            arrivals.setdefault(key_path, []).append(entry.log_ns)
            key = keys.find(key_path)
            if key is None:
                continue
            if key.path not in _DECODED and key.type not in _DECODED:
                continue
            message: Any = record.decode(entry)
            if isinstance(message, Undecodable):
                continue
            if key.path == keys.TRUTH_STATE.path:
                truth.append((message.stamp_ns, message.arc_length_m, message.speed_mps))
            elif key.path == keys.EST_DISTANCE.path:
                estimate.append((message.stamp_ns, message.distance_m, message.speed_mps))
            elif key.path == keys.GNSS_FIX.path:
                if message.valid:
                    gnss.append((message.stamp_ns, message.speed_mps))
            elif key.type is Loss:
                report.lost += message.count
            else:
                last[key_path] = message
        ride = read_ride(record, [keys.EST_STATE.path], keys.TRUTH_STATE.path, fixes=True)
        vehicle = vehicle_of(record, path)
    report.rates_hz = {
        name: (len(times) - 1) * S / (times[-1] - times[0])
        for name, times in sorted(arrivals.items())
        if times[-1] > times[0]
    }
    _errors(report, np.array(truth), np.array(estimate), np.array(gnss))
    _place(report, ride, vehicle.gnss.lever_arm_m if vehicle.gnss is not None else (0.0, 0.0, 0.0))
    _faults(report, last)
    return report


def _errors(report: DemoReport, truth: Any, estimate: Any, gnss: Any) -> None:
    """Distance since the first estimate and speed, against the truth at the same stamps."""
    if len(truth) < 2 or len(estimate) < 2:
        return
    inside = (estimate[:, 0] >= truth[0, 0]) & (estimate[:, 0] <= truth[-1, 0])
    estimate = estimate[inside]
    if not len(estimate):
        return
    arc = np.interp(estimate[:, 0], truth[:, 0], truth[:, 1])
    speed = np.interp(estimate[:, 0], truth[:, 0], truth[:, 2])
    error = (estimate[:, 1] - estimate[0, 1]) - (arc - arc[0])
    report.distance_m = float(arc[-1] - arc[0])
    report.distance_rms_m = float(np.sqrt(np.mean(error**2)))
    report.distance_end_m = float(error[-1])
    report.speed_rms_mps = float(np.sqrt(np.mean((estimate[:, 2] - speed) ** 2)))
    if len(gnss):
        gnss_truth = np.interp(gnss[:, 0], truth[:, 0], truth[:, 2])
        report.gnss_speed_rms_mps = float(np.sqrt(np.mean((gnss[:, 1] - gnss_truth) ** 2)))


def _place(report: DemoReport, ride: RideSeries, lever_arm_v: tuple[float, float, float]) -> None:
    """Position and heading of the localisation filter, and the fixes', against the truth."""
    states = ride.states.get(keys.EST_STATE.path)
    if states is None or ride.truth is None or ride.fixes is None:
        return
    known = states.take(states.mode != MotionState.HEADING_UNKNOWN)
    if len(known.stamp_ns) == 0:
        return
    found = errors.summary(errors.errors(known, ride.truth), 0)
    raw = errors.summary(errors.fix_errors(ride.fixes, ride.truth, lever_arm_v), 0)
    report.position_rms_m, report.yaw_rms_deg = _rms(found["horizontal_m"]), _rms(found["yaw_deg"])
    report.gnss_position_rms_m = _rms(raw["horizontal_m"])


def _rms(statistics: Statistics | None) -> float | None:
    return None if statistics is None else statistics.rms


def _faults(report: DemoReport, last: dict[str, Any]) -> None:
    """What the simulators did wrong on purpose, what the bridges found, whose books are off."""
    for path, message in last.items():
        if isinstance(message, NodeHealth):
            for stage in message.stages:
                device, _, kind = stage.stage.partition(" ")
                if kind == FAULTS:
                    report.injected[f"{device} {stage.unit}"] = stage.delivered
                elif kind == OVERRUN:
                    report.overrun[f"{device} {stage.unit}"] = stage.dropped
                elif stage.received != stage.delivered + stage.dropped + stage.pending:
                    report.unbalanced.append(f"{path}: {stage.stage} {stage.unit}")
        else:
            device = path.split("/")[1]
            report.found[f"{device} opened again"] = max(0, message.opened - 1)
            report.found[f"{device} frames rejected"] = message.frames_rejected
            report.found[f"{device} samples lost"] = message.samples_lost
