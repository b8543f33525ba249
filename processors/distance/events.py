"""What the filter of distance and speed does not believe: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import DEBUG, define

PATH_REFUSED = define(
    "distance.path_refused",
    "{key}: the wheels' way is refused, innovation {innovation_m}, limit {limit_m} "
    "($.distance.gate_sigma)",
    cause="A wheel slips or slides, or its counter has jumped.",
    cure="if it happens on dry rail, correct $.wheels.m_per_pulse",
    severity=DEBUG,
    key=str,
    innovation_m=float,
    limit_m=float,
)
SPEED_REFUSED = define(
    "distance.speed_refused",
    "{key}: a speed is refused, innovation {innovation_mps}, limit {limit_mps} "
    "($.distance.gate_sigma)",
    cause="A wheel slips or slides, or the receiver errs.",
    cure="if good speeds are refused, raise $.distance.gate_sigma",
    severity=DEBUG,
    key=str,
    innovation_mps=float,
    limit_mps=float,
)
