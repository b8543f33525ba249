"""Decoded UBX messages to the messages of the bus: pure functions, one for each UBX type.

Stamp and sequence are the bridge's business and left alone here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from google.protobuf.message import Message

from tramstream import keys
from tramstream.bridges.gnss.clock import solution_utc_ns
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.proto.gnss_pb2 import (
    EsfAlignment,
    EsfInertial,
    EsfMeasurements,
    EsfSensor,
    EsfStatus,
    GnssAttitude,
    GnssCovariance,
    GnssFix,
    GnssMeasurements,
    GnssPosition,
    GnssSatellites,
    GnssSubframe,
    GnssTime,
    TimePulse,
)

MILLI = 1000.0
ANTENNA = "gnss"
"""Frame of the location: its origin is the antenna."""

_USABLE = (GnssFix.FIX_2D, GnssFix.FIX_3D, GnssFix.GNSS_AND_DEAD_RECKONING)
_CARRIERS = (GnssFix.NONE, GnssFix.FLOAT, GnssFix.FIXED, GnssFix.NONE)

# Standard deviations of RXM-RAWX, by the low four bits of the byte that codes them.
_PSEUDORANGE_STD_M = tuple(0.01 * 2**n for n in range(16))
_PHASE_STD_CYCLES = tuple(0.004 * n for n in range(16))
_DOPPLER_STD_HZ = tuple(0.002 * 2**n for n in range(16))

# u-blox data type: unit and scale of the signed 24-bit value (interface description, "ESF
# measurement data"). Ticks (6 to 10) are 23 bits and a direction.
_ESF_DATA: dict[int, tuple[str, float]] = {
    5: ("deg/s", 2.0**-12), 6: ("ticks", 1.0), 7: ("ticks", 1.0), 8: ("ticks", 1.0),
    9: ("ticks", 1.0), 10: ("ticks", 1.0), 11: ("m/s", 1e-3), 12: ("degC", 1e-2),
    13: ("deg/s", 2.0**-12), 14: ("deg/s", 2.0**-12), 16: ("m/s^2", 2.0**-10),
    17: ("m/s^2", 2.0**-10), 18: ("m/s^2", 2.0**-10),
}  # fmt: skip


def fix(message: UbxMessage, gps_time_ns: int | None, max_accuracy_m: float) -> GnssFix:
    """NAV-PVT, NAV-PVAT or HNR-PVT as a fix.

    `valid` needs a fix type with satellites in it (2D, 3D, GNSS with dead reckoning), the
    receiver's own gnssFixOK, a position not marked invalid and an accuracy within
    `max_accuracy_m`. NAV-PVAT does not tell the course's deviation: it is taken from speed's.
    """
    f = message.fields
    high_rate = message.name == "HNR-PVT"
    fix_type = f["gpsFix"] if high_rate else f["fixType"]
    flags = f["flags"]
    out = GnssFix(
        source=message.name,
        itow_ms=f["iTOW"],
        gps_time_ns=gps_time_ns,
        fix_type=fix_type if fix_type <= GnssFix.TIME_ONLY else GnssFix.NO_FIX,
        differential=bool(flags & 2),
        latitude_deg=f["lat"],
        longitude_deg=f["lon"],
        height_ellipsoid_m=f["height"] / MILLI,
        height_msl_m=f["hMSL"] / MILLI,
        horizontal_std_m=f["hAcc"] / MILLI,
        vertical_std_m=f["vAcc"] / MILLI,
        speed_mps=f["gSpeed"] / MILLI,
        speed_std_mps=f["sAcc"] / MILLI,
        utc_ns=solution_utc_ns(f),
        invalid_llh=bool(f.get("flags3", 0) & 1),
    )
    if high_rate:
        out.course_deg, out.course_std_deg = f["headMot"], f["headAcc"]
        if flags & 0x10:
            out.heading_vehicle_deg = f["headVeh"]
    else:
        _add_navigation(out, message.name, f)
    out.valid = (
        bool(flags & 1)
        and out.fix_type in _USABLE
        and not out.invalid_llh
        and out.horizontal_std_m <= max_accuracy_m
        and abs(out.latitude_deg) <= 90
        and abs(out.longitude_deg) <= 180
    )
    return out


def _add_navigation(out: GnssFix, name: str, f: dict[str, Any]) -> None:
    """What NAV-PVT and NAV-PVAT have beyond HNR-PVT."""
    flags = f["flags"]
    out.carrier = _CARRIERS[flags >> 6]
    out.satellites_used = f["numSV"]
    out.vel_n_mps = f["velN"] / MILLI
    out.vel_e_mps = f["velE"] / MILLI
    out.vel_d_mps = f["velD"] / MILLI
    if name == "NAV-PVT":
        out.course_deg, out.course_std_deg = f["headMot"], f["headAcc"]
        out.pdop = f["pDOP"]
    else:
        out.course_deg = f["motHeading"]
        out.course_std_deg = math.degrees(math.atan2(f["sAcc"], abs(f["gSpeed"])))
    if flags & 0x20:
        out.heading_vehicle_deg = f["headVeh"] if name == "NAV-PVT" else f["vehHeading"]


def location(of: GnssFix, covariance: GnssCovariance | None = None) -> LocationFix:
    """The fix for any viewer, with `covariance` if that belongs to the same epoch.

    Without it the horizontal variance is split evenly between east and north. All zero deviations
    mean that none are known.
    """
    out = LocationFix(
        frame_id=ANTENNA,
        latitude=of.latitude_deg,
        longitude=of.longitude_deg,
        altitude=of.height_ellipsoid_m,
    )
    if covariance is not None and covariance.position_valid:
        nn, ne, nd, ee, ed, dd = covariance.position_m2
        out.position_covariance[:] = [ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd]
        out.position_covariance_type = LocationFix.KNOWN
    elif of.horizontal_std_m > 0:
        per_axis_m2 = of.horizontal_std_m**2 / 2
        out.position_covariance[:] = [
            per_axis_m2, 0, 0, 0, per_axis_m2, 0, 0, 0, of.vertical_std_m**2
        ]  # fmt: skip
        out.position_covariance_type = LocationFix.DIAGONAL_KNOWN
    return out


def attitude(message: UbxMessage, _: int | None) -> GnssAttitude:
    """NAV-ATT or HNR-ATT; an angle whose accuracy is zero is not known."""
    f = message.fields
    out = GnssAttitude(
        source=message.name, itow_ms=f["iTOW"], roll_std_deg=f["accRoll"],
        pitch_std_deg=f["accPitch"], heading_std_deg=f["accHeading"],
    )  # fmt: skip
    for name in ("roll", "pitch", "heading"):
        if f[f"acc{name.capitalize()}"] > 0:
            setattr(out, f"{name}_deg", f[name])
    return out


def attitude_of_pvat(message: UbxMessage, _: int | None) -> GnssAttitude:
    """The vehicle's attitude in NAV-PVAT, as far as its flags say that it is valid."""
    f, flags = message.fields, message.fields["flags"]
    out = GnssAttitude(
        source=message.name, itow_ms=f["iTOW"], roll_std_deg=f["accRoll"],
        pitch_std_deg=f["accPitch"], heading_std_deg=f["accHeading"],
    )  # fmt: skip
    if flags & 0x08:
        out.roll_deg = f["vehRoll"]
    if flags & 0x10:
        out.pitch_deg = f["vehPitch"]
    if flags & 0x20:
        out.heading_deg = f["vehHeading"]
    return out


def covariance(message: UbxMessage, _: int | None) -> GnssCovariance:
    f, axes = message.fields, ("NN", "NE", "ND", "EE", "ED", "DD")
    return GnssCovariance(
        itow_ms=f["iTOW"],
        position_valid=f["posCovValid"] == 1,
        velocity_valid=f["velCovValid"] == 1,
        position_m2=[f[f"posCov{pair}"] for pair in axes],
        velocity_m2ps2=[f[f"velCov{pair}"] for pair in axes],
    )


def position(message: UbxMessage, _: int | None) -> GnssPosition:
    """NAV-HPPOSLLH, or NAV-POSLLH, which cannot say that it is invalid."""
    f = message.fields
    high = message.name == "NAV-HPPOSLLH"
    return GnssPosition(
        source=message.name,
        itow_ms=f["iTOW"],
        valid=not (high and f["flags"] & 1),
        latitude_deg=f["lat"] + (f["latHp"] if high else 0),
        longitude_deg=f["lon"] + (f["lonHp"] if high else 0),
        height_ellipsoid_m=(f["height"] + (f["heightHp"] if high else 0)) / MILLI,
        height_msl_m=(f["hMSL"] + (f["hMSLHp"] if high else 0)) / MILLI,
        horizontal_std_m=f["hAcc"] / MILLI,
        vertical_std_m=f["vAcc"] / MILLI,
    )


def time_gps(message: UbxMessage, gps_time_ns: int | None) -> GnssTime:
    f = message.fields
    return GnssTime(
        source=message.name,
        itow_ms=f["iTOW"],
        gps_time_ns=gps_time_ns,
        leap_seconds=f["leapS"] if f["valid"] & 4 else None,
        accuracy_ns=f["tAcc"],
    )


def time_leap(message: UbxMessage, gps_time_ns: int | None) -> GnssTime:
    f = message.fields
    announced = bool(f["valid"] & 2)
    return GnssTime(
        source=message.name,
        itow_ms=f["iTOW"],
        gps_time_ns=gps_time_ns,
        leap_seconds=f["currLs"] if f["valid"] & 1 else None,
        next_leap_change=f["lsChange"] if announced else 0,
        next_leap_in_s=f["timeToLsEvent"] if announced and f["lsChange"] else None,
    )


def pulse(message: UbxMessage, _: int | None) -> TimePulse:
    f = message.fields
    return TimePulse(
        tow_ms=f["towMS"],
        week=f["week"],
        tow_sub_ms=f["towSubMS"],
        quantisation_ps=f["qErr"],
        utc_base=bool(f["flags"] & 1),
        quantisation_valid=not f["flags"] & 0x10,
    )


def satellites(message: UbxMessage, _: int | None) -> GnssSatellites:
    """NAV-SAT. Elevation and azimuth beyond their range mean that they are not known."""
    out = GnssSatellites(source=message.name, itow_ms=message.fields["iTOW"])
    add = out.satellites.add
    for gnss_id, sv_id, cno, elevation, azimuth, residual, flags in message.records:
        known = -90 <= elevation <= 90
        add(
            gnss_id=gnss_id, sv_id=sv_id, cno_dbhz=cno, residual_m=residual, flags=flags,
            elevation_deg=elevation if known else None, azimuth_deg=azimuth if known else None,
            quality=flags & 7, used=bool(flags & 8), health=flags >> 4 & 3,
        )  # fmt: skip
    return out


def signals(message: UbxMessage, _: int | None) -> GnssSatellites:
    """NAV-SIG; `used` where the pseudorange is."""
    out = GnssSatellites(source=message.name, itow_ms=message.fields["iTOW"])
    add = out.satellites.add
    for (
        gnss_id,
        sv_id,
        signal,
        frequency,
        residual,
        cno,
        quality,
        _c,
        _i,
        flags,
        _r,
    ) in message.records:
        add(
            gnss_id=gnss_id, sv_id=sv_id, signal_id=signal, frequency_id=frequency,
            cno_dbhz=cno, residual_m=residual, quality=quality, used=bool(flags & 8),
            health=flags & 3, flags=flags,
        )  # fmt: skip
    return out


def measurements(message: UbxMessage, _: int | None) -> GnssMeasurements:
    f = message.fields
    status = f["recStat"]
    out = GnssMeasurements(
        receiver_tow_s=f["rcvTow"], week=f["week"], clock_reset=bool(status & 2),
        leap_seconds=f["leapS"] if status & 1 else None,
    )  # fmt: skip
    add = out.measurements.add
    for (
        pr,
        cp,
        do,
        gnss,
        sv,
        signal,
        freq,
        lock,
        cno,
        pr_std,
        cp_std,
        do_std,
        track,
        _r,
    ) in message.records:
        add(
            pseudorange_m=pr, carrier_phase_cycles=cp, doppler_hz=do, gnss_id=gnss, sv_id=sv,
            signal_id=signal, frequency_id=freq, lock_time_ms=lock, cno_dbhz=cno,
            pseudorange_std_m=_PSEUDORANGE_STD_M[pr_std & 15],
            carrier_phase_std_cycles=_PHASE_STD_CYCLES[cp_std & 15],
            doppler_std_hz=_DOPPLER_STD_HZ[do_std & 15], tracking=track,
        )  # fmt: skip
    return out


def subframe(message: UbxMessage, _: int | None) -> GnssSubframe:
    f = message.fields
    return GnssSubframe(
        gnss_id=f["gnssId"], sv_id=f["svId"], signal_id=f["sigId"], frequency_id=f["freqId"],
        channel=f["chn"], words=[record[0] for record in message.records],
    )  # fmt: skip


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


Builder = Callable[[UbxMessage, int | None], Message]

BUILDERS: dict[str, tuple[keys.Key, Builder]] = {
    "NAV-ATT": (keys.GNSS_ATTITUDE, attitude),
    "HNR-ATT": (keys.GNSS_ATTITUDE, attitude),
    "NAV-COV": (keys.GNSS_COVARIANCE, covariance),
    "NAV-HPPOSLLH": (keys.GNSS_POSITION, position),
    "NAV-POSLLH": (keys.GNSS_POSITION, position),
    "NAV-TIMEGPS": (keys.GNSS_TIME, time_gps),
    "NAV-TIMELS": (keys.GNSS_TIME, time_leap),
    "NAV-SAT": (keys.GNSS_SATELLITES, satellites),
    "NAV-SIG": (keys.GNSS_SIGNALS, signals),
    "TIM-TP": (keys.GNSS_PULSE, pulse),
    "RXM-RAWX": (keys.GNSS_MEASUREMENTS, measurements),
    "RXM-SFRBX": (keys.GNSS_SUBFRAME, subframe),
    "ESF-MEAS": (keys.GNSS_ESF_MEASUREMENTS, esf_measurements),
    "ESF-RAW": (keys.GNSS_ESF_MEASUREMENTS, esf_measurements),
    "ESF-STATUS": (keys.GNSS_ESF_STATUS, esf_status),
    "ESF-INS": (keys.GNSS_ESF_INERTIAL, esf_inertial),
    "HNR-INS": (keys.GNSS_ESF_INERTIAL, esf_inertial),
    "ESF-ALG": (keys.GNSS_ESF_ALIGNMENT, esf_alignment),
}
"""UBX type to key and builder, where one message follows from one."""
