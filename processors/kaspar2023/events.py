"""What the filter of Kašpar 2023 does not believe: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import define

WHEELS_JUMPED = define(
    "kaspar2023.wheels_jumped",
    "{key}: wheels jumped by {pulses} pulses in {interval_s}, limit {limit_mps}; not used",
    cause="A counter was reset, or readings are of two vehicles.",
    cure="check the signals of $.odometer.wheels",
    key=str,
    pulses=int,
    interval_s=float,
    limit_mps=float,
)
HEADING_LOST = define(
    "kaspar2023.heading_lost",
    "{silence_s} without inertial data, limit {limit_s}: the heading is lost",
    cause="The IMU was away or silent for too long.",
    cure="look at the device imu",
    silence_s=float,
    limit_s=float,
)
