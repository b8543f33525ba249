"""What the processor `segments` has to say: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, INFO, define

PLACED = define(
    "segments.placed",
    "on line {line} to {destination}, {chainage_m} from its first stop, deviation {std_m}, "
    "found after {gone_m} of way",
    cause="Curves and stops of the ride are those of this line.",
    severity=INFO,
    line=str,
    destination=str,
    chainage_m=float,
    std_m=float,
    gone_m=float,
)
NO_LINE_FITS = define(
    "segments.no_line_fits",
    "none of {lines} lines fits the way of the last {gone_m}; no place is told",
    cause="The vehicle is on another line or a detour, or the wheels' constant is wrong by more "
    "than 10 %.",
    cure="check $.segments.lines and $.wheels.m_per_pulse",
    lines=int,
    gone_m=float,
)
LINES_UNREAD = define(
    "segments.lines_unread",
    "no line can be looked for: {reason}",
    cause="The network or a signature cannot be read, or has no such line.",
    cure="{advice}",
    severity=ERROR,
    reason=str,
    advice=str,
)
MOUNTING_CONTRADICTS = define(
    "segments.mounting_contradicts",
    "gravity is {tilt_deg} off the IMU's mounting, limit {limit_deg}; the mounting is found on the "
    "run",
    cause="The IMU does not lie as $.imu.mounting_deg says.",
    cure="set $.imu.mounting_deg, or $.segments.mounting to own",
    tilt_deg=float,
    limit_deg=float,
)
WHEELS_REFUSED = define(
    "segments.wheels_refused",
    "the wheels have not fitted the motion for {refused_s}, limit {limit_s}; the way is that of "
    "the IMU",
    cause="They slide or slip, their counter is stuck, or their constant is wrong.",
    cure="look at raw/odo/wheels",
    refused_s=float,
    limit_s=float,
)
GYRO_STUCK = define(
    "segments.gyro_stuck",
    "the yaw rate has not changed for {still_s} of motion; turns cannot be seen",
    cause="The gyroscope is stuck.",
    cure="look at raw/imu/batch",
    still_s=float,
)
