"""The last value of a key in one short line for people, per message type.

What matters most comes first: the line may be cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.message import Message

from tramstream import keys
from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.events.messages import sentence_of
from tramstream.events.wording import clipped, lasting, scaled

FALLBACK_FIELDS = 4
_FIX = {
    "NO_FIX": "no fix",
    "DEAD_RECKONING": "dead reckoning",
    "FIX_2D": "2D",
    "FIX_3D": "3D",
    "GNSS_AND_DEAD_RECKONING": "3D + DR",
    "TIME_ONLY": "time only",
}


def digest(message: Message | None) -> str:
    """One line about `message`; of a type without a digest of its own the first fields."""
    if message is None:
        return "cannot be decoded"
    ours = message.DESCRIPTOR.full_name in keys.TYPES
    short = _DIGESTS.get(message.DESCRIPTOR.name) if ours else None
    return short(message) if short is not None else _first_fields(message)


def _xyz(values: Iterable[float], digits: int) -> str:
    return " ".join(f"{value:+.{digits}f}" for value in values)


def _place(message: Any) -> str:
    return f"{message.latitude_deg:.6f}° {message.longitude_deg:.6f}°"


def _fix(message: Any) -> str:
    kind = _FIX.get(name_of(type(message).FixType, message.fix_type), "?")
    carrier = (
        f" {name_of(type(message).Carrier, message.carrier).lower()}" if message.carrier else ""
    )
    parts = [
        f"{message.speed_mps:.2f} m/s",
        f"{kind}{carrier}" + ("" if message.valid else ", not valid"),
        f"{message.satellites_used} sat",
        f"±{message.horizontal_std_m:.1f} m",
        _place(message),
    ]
    return "  ".join(parts)


def _location(message: Any) -> str:
    height = "" if math.isnan(message.altitude) else f"  {message.altitude:.1f} m"
    return f"{message.latitude:.6f}° {message.longitude:.6f}°{height}"


def _covariance(message: Any) -> str:
    terms = list(message.position_m2)
    if len(terms) != 6 or not message.position_valid:
        return "not valid"
    stds = (math.sqrt(max(0.0, terms[place])) for place in (0, 3, 5))
    return (
        "σ " + "  ".join(f"{axis} {std:.2f}" for axis, std in zip("NED", stds, strict=True)) + " m"
    )


def _gnss_time(message: Any) -> str:
    leap = f"leap {message.leap_seconds} s" if message.HasField("leap_seconds") else "leap unknown"
    return f"tow {message.itow_ms / 1000:.1f} s  {leap}  ±{message.accuracy_ns:.0f} ns"


def _satellites(message: Any) -> str:
    used = sum(satellite.used for satellite in message.satellites)
    best = max((satellite.cno_dbhz for satellite in message.satellites), default=0)
    return f"{used} used of {len(message.satellites)}  best {best} dBHz"


def _attitude(message: Any) -> str:
    angles = ("roll", "pitch", "heading")
    known = [
        f"{angle} {getattr(message, f'{angle}_deg'):+.2f}°"
        for angle in angles
        if message.HasField(f"{angle}_deg")
    ]
    return "  ".join(known) or "unknown"


def _raw_bytes(message: Any) -> str:
    reads = len(message.read_length) or 1
    return f"{len(message.data)} bytes in {reads} {'reads' if reads > 1 else 'read'}"


def _can_frames(message: Any) -> str:
    ids = " ".join(f"{id_:X}" for id_ in sorted(set(message.id)))
    return f"{len(message.id)} frames  {ids}"


def _imu_batch(message: Any) -> str:
    count = len(message.gyro_x)
    if not count:
        return "no samples"
    gyro = [
        1e3 * message.gyro_scale_radps * sum(axis) / count
        for axis in (message.gyro_x, message.gyro_y, message.gyro_z)
    ]
    accel = [
        message.accel_scale_mps2 * sum(axis) / count
        for axis in (message.accel_x, message.accel_y, message.accel_z)
    ]
    temperature_degc = message.temperature_scale_degc * message.temperature
    flags = f"  DIAG {message.diag_stat:04X}" if message.diag_stat else ""
    return (
        f"a {_xyz(accel, 2)} m/s²  ω {_xyz(gyro, 1)} mrad/s  "
        f"{count} × {temperature_degc:.1f} °C{flags}"
    )


def _imu_mean(message: Any) -> str:
    accel = (message.accel_x_mps2, message.accel_y_mps2, message.accel_z_mps2)
    gyro = (message.gyro_x_radps, message.gyro_y_radps, message.gyro_z_radps)
    bridged = f"  {message.bridged_count} bridged" if message.bridged_count else ""
    rates = _xyz((1e3 * rate for rate in gyro), 1)
    return f"a {_xyz(accel, 2)} m/s²  ω {rates} mrad/s{bridged}"


def _odometry(message: Any) -> str:
    parts = []
    for wheel in message.wheels:
        value = f"{wheel.pulses}" if wheel.HasField("pulses") else f"{wheel.speed_mps:.2f} m/s"
        parts.append(f"{wheel.wheel} {value}")
    if message.HasField("doors_open"):
        parts.append("doors open" if message.doors_open else "doors shut")
    if message.HasField("motor_force_n"):
        parts.append(f"{message.motor_force_n / 1e3:+.1f} kN")
    return "  ".join(parts)


def _truth(message: Any) -> str:
    standing = "  standing" if message.standing else ""
    return (
        f"{message.arc_length_m:.2f} m  {message.speed_mps:.3f} m/s  "
        f"{message.acceleration_mps2:+.2f} m/s²{standing}"
    )


def _frame(message: Any) -> str:
    parts = [_imu_mean(message.imu) if message.HasField("imu") else "no inertial data"]
    parts += [f"{len(message.gnss)} GNSS"] if message.gnss else []
    parts += [f"{len(message.odometry)} odometry"] if message.odometry else []
    return "  ".join(parts)


def _gap(message: Any) -> str:
    what = "bridged" if message.bridged else "left open"
    return f"{message.missing_count} samples, {lasting(message.duration_s)}, {what}"


def _late(message: Any) -> str:
    late_ms = (message.horizon_ns - message.stamp_ns) / 1e6
    return f"{message.key} #{message.source_sequence}, {late_ms:.0f} ms behind the horizon"


def _tick(message: Any) -> str:
    read = sum(position.count for position in message.positions)
    return f"{read} read on {len(message.positions)} keys"


def _snapshot(message: Any) -> str:
    size = sum(len(state.state) for state in message.states)
    return f"{' '.join(state.name for state in message.states)}  {scaled(size, 'B')}"


def _distance(message: Any) -> str:
    refused = sum(not innovation.accepted for innovation in message.innovations)
    gate = f"  {refused} refused" if refused else ""
    return (
        f"{message.distance_m:.3f} m ±{message.distance_std_m:.3f}  "
        f"{message.speed_mps:.3f} m/s ±{message.speed_std_mps:.3f}{gate}"
    )


def _percent(slope_rad: float) -> float:
    """Slopes are told in percent."""
    return 100.0 * math.tan(slope_rad)


def _grade(message: Any) -> str:
    parts = [f"slope {_percent(message.grade_rad):+.2f} ±{_percent(message.grade_std_rad):.2f} %"]
    parts.append(f"nod {math.degrees(message.body_pitch_rad):+.2f}°")
    if message.HasField("mass_kg"):
        parts.append(f"{message.mass_kg / 1e3:.1f} ±{message.mass_std_kg / 1e3:.1f} t")
    return "  ".join([*parts, " ".join(message.inputs)]).rstrip()


def _segment(message: Any) -> str:
    kind = message.DESCRIPTOR.enum_types_by_name["Kind"].values_by_number[message.kind].name
    parts = [kind.lower().replace("_", " ")]
    if message.name:
        parts.append(message.name)
    if message.HasField("angle_rad"):
        parts.append(f"{math.degrees(message.angle_rad):+.1f}°")
        parts.append(f"radius {message.radius_m:.0f} ±{message.radius_std_m:.0f} m")
    lasted_s = (message.end_ns - message.start_ns) / S
    if lasted_s > 0.0:
        parts.append(f"{lasted_s:.1f} s")
    parts.append(f"{message.distance_m:.0f} m after the one before")
    return "  ".join([*parts, " ".join(message.inputs)]).rstrip()


def _line_place(message: Any) -> str:
    states = message.DESCRIPTOR.enum_types_by_name["State"].values_by_number
    parts = [states[message.state].name.lower().replace("_", " ")]
    if message.line:
        where = f"line {message.line}/{message.direction} at {message.chainage_m:.0f}"
        parts.append(f"{where} ±{message.chainage_std_m:.0f} m")
        parts.append(f"{100.0 * message.probability:.0f} %")
    if message.alternatives:
        parts.append(f"{len(message.alternatives)} others")
    return "  ".join(parts)


def _landmark(message: Any) -> str:
    of = "/".join(each for each in (message.line, message.direction) if each) or "any line"
    return f"{message.name}  {of} at {message.chainage_m:.0f} ±{message.chainage_std_m:.0f} m"


def _stopping(message: Any) -> str:
    parts = []
    for stop in message.stops:
        with_ = f" with {stop.deceleration_mps2:.3g} m/s²"
        known = stop.HasField("distance_m")
        way = f"{stop.distance_m:.0f} ±{stop.distance_std_m:.0f} m" if known else "no stop"
        parts.append(way + with_)
    return "  ".join([*parts, f"{message.speed_mps:.1f} m/s"])


def _node(message: Any) -> str:
    state = name_of(type(message).State, message.state)
    return f"{state}  {message.text}" if message.text else state


def _device(message: Any) -> str:
    state = name_of(type(message).State, message.state)
    parts = [state, scaled(message.bytes_received, "B"), f"{message.messages_decoded} decoded"]
    parts += [f"{message.frames_rejected} rejected"] if message.frames_rejected else []
    parts += [message.text] if message.text else []
    return "  ".join(parts)


def _loss(message: Any) -> str:
    cause = name_of(type(message).Cause, message.cause).lower()
    return f"{message.count} of {message.key} ({cause})"


def _log(message: Any) -> str:
    return " ".join(message.message.rstrip().splitlines()[-1:]).strip()


def _event(message: Any) -> str:
    return f"{message.kind}  {sentence_of(message)}"


def _clock(message: Any) -> str:
    ahead_s = (message.host_utc_ns - message.stamp_ns) / S
    return f"host's UTC {ahead_s:+.6f} s from the vehicle clock"


def _first_fields(message: Message) -> str:
    parts: list[str] = []
    for field in message.DESCRIPTOR.fields:
        if field.name in ("stamp_ns", "sequence", "itow_ms", "source"):
            continue
        if len(parts) == FALLBACK_FIELDS:
            break
        parts += _field(message, field)
    return "  ".join(parts)


def _field(message: Message, field: Any) -> list[str]:
    if field.has_presence and not message.HasField(field.name):
        return []
    value = getattr(message, field.name)
    if field.is_repeated:
        return [f"{len(value)} {field.name}"]
    if field.message_type is not None:
        return []
    if isinstance(value, bytes):
        return [f"{field.name} {len(value)} bytes"]
    if isinstance(value, float):
        return [f"{field.name} {value:.6g}"]
    return [f"{field.name} {clipped(str(value), 24)}"]


_DIGESTS: dict[str, Callable[[Any], str]] = {
    "CanFrames": _can_frames,
    "ClockReference": _clock,
    "DeviceHealth": _device,
    "DistanceState": _distance,
    "Event": _event,
    "GnssAttitude": _attitude,
    "GnssCovariance": _covariance,
    "GnssFix": _fix,
    "GnssPosition": lambda m: (
        f"{_place(m)}  {m.height_ellipsoid_m:.2f} m  ±{m.horizontal_std_m:.1f} m"
    ),
    "GnssSatellites": _satellites,
    "GnssTime": _gnss_time,
    "GradeState": _grade,
    "GradeStopping": _stopping,
    "ImuBatch": _imu_batch,
    "ImuMean": _imu_mean,
    "Landmark": _landmark,
    "LateSample": _late,
    "LinePlace": _line_place,
    "LocationFix": _location,
    "Log": _log,
    "Loss": _loss,
    "NodeHealth": _node,
    "Odometry": _odometry,
    "RawBytes": _raw_bytes,
    "SegmentEvent": _segment,
    "Snapshot": _snapshot,
    "SyncFrame": _frame,
    "SyncGap": _gap,
    "Tick": _tick,
    "TruthState": _truth,
}
