"""What the slope's processor has to say: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import INFO, define

INPUT_LOST = define(
    "grade.input_lost",
    "{input} has told nothing of the slope for {silent_s}, limit {limit_s}; it goes on without",
    cause="A sensor or the localiser is silent, or what it says is refused.",
    cure="look at what its own node says",
    input=str,
    silent_s=float,
    limit_s=float,
)
INPUT_BACK = define(
    "grade.input_back",
    "{input} tells of the slope again",
    cause="It had been said to be silent.",
    severity=INFO,
    input=str,
)
MASS_KNOWN = define(
    "grade.mass_known",
    "the vehicle's mass is known: {mass_kg}, deviation {mass_std_kg}",
    cause="Departures and brakings have told it by the motor force.",
    severity=INFO,
    mass_kg=float,
    mass_std_kg=float,
)
SUSPENSION_CONTRADICTS = define(
    "grade.suspension_contradicts",
    "the body nods by {pitch_deg} for each m/s², $.grade.pitch_deg_per_mps2 is {told_deg}, "
    "limit {limit_deg}",
    cause="The springs are others than configured, or the IMU is not on the body.",
    cure="set $.grade.pitch_deg_per_mps2 to what was found",
    pitch_deg=float,
    told_deg=float,
    limit_deg=float,
)
PITCH_CONTRADICTS = define(
    "grade.pitch_contradicts",
    "the localiser's pitch is {offset_deg} off by the heights of fixes, limit {limit_deg}",
    cause="The IMU's mounting or its accelerometer is not as the localiser takes it to be.",
    cure="compare $.imu.mounting_deg with what configuration_check says",
    offset_deg=float,
    limit_deg=float,
)
