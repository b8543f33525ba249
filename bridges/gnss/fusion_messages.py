"""What the receiver's own sensors and fusion say (ESF, HNR-INS) as messages of the bus."""

from __future__ import annotations

from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.proto.gnss_pb2 import (
    EsfAlignment,
    EsfInertial,
    EsfMeasurements,
    EsfSensor,
    EsfStatus,
)

# u-blox data type: unit and scale of the signed 24-bit value (interface description, "ESF
# measurement data"). Ticks (6 to 10) are 23 bits and a direction.
_ESF_DATA: dict[int, tuple[str, float]] = {
    5: ("deg/s", 2.0**-12), 6: ("ticks", 1.0), 7: ("ticks", 1.0), 8: ("ticks", 1.0),
    9: ("ticks", 1.0), 10: ("ticks", 1.0), 11: ("m/s", 1e-3), 12: ("degC", 1e-2),
    13: ("deg/s", 2.0**-12), 14: ("deg/s", 2.0**-12), 16: ("m/s^2", 2.0**-10),
    17: ("m/s^2", 2.0**-10), 18: ("m/s^2", 2.0**-10),
}  # fmt: skip


def esf_measurements(message: UbxMessage, _: int | None) -> EsfMeasurements:
    """ESF-MEAS or ESF-RAW; the calibrated time tag at the end of ESF-MEAS is no measurement."""
    out = EsfMeasurements(source=message.name)
    records = message.records
    if message.name == "ESF-MEAS":
        if message.fields["flags"] & 8:
            records = records[:-1]
        tag = message.fields["timeTag"]
        words = [(record[0], tag) for record in records]
    else:
        words = [(word, tag) for word, tag in records]
    for word, tag in words:
        type_ = word >> 24 & 0x3F
        raw = (word & 0xFFFFFF ^ 0x800000) - 0x800000
        unit, scale = _ESF_DATA.get(type_, ("", 0.0))
        value = raw * scale
        if unit == "ticks":
            value = float(word & 0x7FFFFF) * (-1.0 if word & 0x800000 else 1.0)
        out.items.add(type=type_, raw=raw, value=value, unit=unit, time_tag=tag)
    return out


def esf_status(message: UbxMessage, _: int | None) -> EsfStatus:
    return EsfStatus(
        itow_ms=message.fields["iTOW"],
        fusion_mode=message.fields["fusionMode"],
        sensors=[
            EsfSensor(
                type=first & 0x3F, used=bool(first & 0x40), ready=bool(first & 0x80),
                calibration=second & 3, time_status=second >> 2 & 3, frequency_hz=rate,
                faults=faults,
            )
            for first, second, rate, faults in message.records
        ],
    )  # fmt: skip


def esf_inertial(message: UbxMessage, _: int | None) -> EsfInertial:
    """ESF-INS or HNR-INS; components whose validity bit is not set are left out."""
    f = message.fields
    out = EsfInertial(source=message.name, itow_ms=f["iTOW"])
    valid = f["bitfield0"] >> 8
    for bit, axis in enumerate("xyz"):
        if valid >> bit & 1:
            setattr(out, f"rate_{axis}_degps", f[f"{axis}AngRate"])
        if valid >> (3 + bit) & 1:
            setattr(out, f"accel_{axis}_mps2", f[f"{axis}Accel"])
    return out


def esf_alignment(message: UbxMessage, _: int | None) -> EsfAlignment:
    f = message.fields
    return EsfAlignment(
        itow_ms=f["iTOW"], status=f["flags"] >> 1 & 7, error=f["error"], yaw_deg=f["yaw"],
        pitch_deg=f["pitch"], roll_deg=f["roll"],
    )  # fmt: skip
