"""Fixes, positions and times of UBX as messages of the bus: pure functions, one for each type.

Stamp and sequence are the bridge's business and left alone here.
"""

from __future__ import annotations

import math
from typing import Any

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream.bridges.gnss.clock import WEEK_NS, is_nowhere, solution_utc_ns
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.proto.gnss_pb2 import (
    GnssAttitude,
    GnssCovariance,
    GnssFix,
    GnssPosition,
    GnssTime,
    TimePulse,
)

MILLI = 1000.0
ANTENNA = "gnss"
"""Frame of the location: its origin is the antenna."""

UNKNOWN_HEIGHT_M2 = 1e6
"""Variance of a height of which nothing is known: all of the Earth's surface is within 9 km."""

_CORRECTION_AGES_S = (0, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120, 120, 120, 120, 120)
"""NAV-PVT's classes of the corrections' age, by their upper end; the last is "120 s and more"."""
_FIX_TYPES = (
    GnssFix.NO_FIX, GnssFix.DEAD_RECKONING, GnssFix.FIX_2D, GnssFix.FIX_3D,
    GnssFix.GNSS_AND_DEAD_RECKONING, GnssFix.TIME_ONLY,
)  # fmt: skip
_USABLE = (GnssFix.FIX_2D, GnssFix.FIX_3D, GnssFix.GNSS_AND_DEAD_RECKONING)
_CARRIERS = (GnssFix.NONE, GnssFix.FLOAT, GnssFix.FIXED, GnssFix.NONE)


def fix(message: UbxMessage, gps_time_ns: int | None, max_accuracy_m: float) -> GnssFix:
    """NAV-PVT, NAV-PVAT or HNR-PVT as a fix.

    `valid` needs a fix type with satellites in it (2D, 3D, GNSS with dead reckoning), the
    receiver's own gnssFixOK, a position not marked invalid and not at 0° 0°, and an accuracy within
    `max_accuracy_m`. The date is that of `gps_time_ns` where the two are weeks apart.
    NAV-PVAT does not tell the course's deviation: it is taken from speed's.
    """
    f = message.fields
    high_rate = message.name == "HNR-PVT"
    fix_type = f["gpsFix"] if high_rate else f["fixType"]
    flags = f["flags"]
    out = GnssFix(
        source=message.name,
        itow_ms=f["iTOW"],
        gps_time_ns=gps_time_ns,
        fix_type=fix_type_of(fix_type),
        differential=bool(flags & 2),
        latitude_deg=f["lat"],
        longitude_deg=f["lon"],
        height_ellipsoid_m=f["height"] / MILLI,
        height_msl_m=f["hMSL"] / MILLI,
        horizontal_std_m=f["hAcc"] / MILLI,
        vertical_std_m=f["vAcc"] / MILLI,
        speed_mps=f["gSpeed"] / MILLI,
        speed_std_mps=f["sAcc"] / MILLI,
        utc_ns=utc_of(f, gps_time_ns),
    )
    if high_rate:
        out.course_deg, out.course_std_deg = f["headMot"], f["headAcc"]
        if flags & 0x10:
            out.heading_vehicle_deg = f["headVeh"]
    else:
        _add_navigation(out, message)
    judge(out, bool(flags & 1), max_accuracy_m)
    return out


def fix_type_of(told: int) -> GnssFix.FixType:
    """Fix type as UBX numbers it; what it does not know is none."""
    return _FIX_TYPES[told] if told < len(_FIX_TYPES) else GnssFix.NO_FIX


def judge(of: GnssFix, fix_ok: bool, max_accuracy_m: float) -> None:
    """Fill in whether a fix is valid, and whether it has a place at all."""
    of.invalid_llh = of.invalid_llh or is_nowhere(of.latitude_deg, of.longitude_deg)
    of.valid = (
        fix_ok
        and of.fix_type in _USABLE
        and not of.invalid_llh
        and of.horizontal_std_m <= max_accuracy_m
        and abs(of.latitude_deg) <= 90
        and abs(of.longitude_deg) <= 180
    )


def utc_of(f: dict[str, Any], gps_time_ns: int | None, wanted: int = 3) -> int:
    """UTC that a message tells, moved by the weeks that its receiver is behind; 0 if not valid."""
    utc = solution_utc_ns(f, wanted)
    if utc == 0 or gps_time_ns is None:
        return utc
    weeks = (gps_time_ns + GPS_EPOCH_UNIX_S * S - utc + WEEK_NS // 2) // WEEK_NS
    return utc + weeks * WEEK_NS


def _add_navigation(out: GnssFix, message: UbxMessage) -> None:
    """What NAV-PVT and NAV-PVAT have beyond HNR-PVT; u-blox 7 has reserved bits for some of it."""
    name, f = message.name, message.fields
    flags, flags3 = f["flags"], 0 if message.form else f.get("flags3", 0)
    out.invalid_llh = bool(flags3 & 1)
    if flags3 >> 1 & 15:
        out.correction_age_s = _CORRECTION_AGES_S[flags3 >> 1 & 15]
    out.carrier = carrier_of(flags >> 6)
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
    if flags & 0x20 and not message.form:
        out.heading_vehicle_deg = f["headVeh"] if name == "NAV-PVT" else f["vehHeading"]


def carrier_of(bits: int) -> GnssFix.Carrier:
    """Carrier phase solution as UBX codes it in two bits."""
    return _CARRIERS[bits & 3]


def location(of: GnssFix, covariance: GnssCovariance | None = None) -> LocationFix:
    """The fix for any viewer, with `covariance` if that belongs to the same epoch.

    Without it the horizontal variance is split evenly between east and north. All zero deviations
    mean that none are known. A height that is not known is NaN, as in ROS' NavSatFix, and its
    variance that of who knows nothing of it.
    """
    known = of.HasField("height_ellipsoid_m")
    out = LocationFix(
        frame_id=ANTENNA,
        latitude=of.latitude_deg,
        longitude=of.longitude_deg,
        altitude=of.height_ellipsoid_m if known else math.nan,
    )
    if covariance is not None and covariance.position_valid:
        nn, ne, nd, ee, ed, dd = covariance.position_m2
        out.position_covariance[:] = [ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd]
        out.position_covariance_type = LocationFix.KNOWN
    elif of.horizontal_std_m > 0:
        per_axis_m2 = of.horizontal_std_m**2 / 2
        out.position_covariance[:] = [
            per_axis_m2, 0, 0, 0, per_axis_m2, 0, 0, 0,
            of.vertical_std_m**2 if known else UNKNOWN_HEIGHT_M2,
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
    """NAV-COV. What is none (NaN, infinite, negative variances) is not valid, and left out."""
    f, axes = message.fields, ("NN", "NE", "ND", "EE", "ED", "DD")
    position = [f[f"posCov{pair}"] for pair in axes]
    velocity = [f[f"velCov{pair}"] for pair in axes]
    return GnssCovariance(
        itow_ms=f["iTOW"],
        position_valid=f["posCovValid"] == 1 and _is_covariance(position),
        velocity_valid=f["velCovValid"] == 1 and _is_covariance(velocity),
        position_m2=position if all(map(math.isfinite, position)) else (),
        velocity_m2ps2=velocity if all(map(math.isfinite, velocity)) else (),
    )


def _is_covariance(upper: list[float]) -> bool:
    """Whether the upper triangle is that of a covariance: finite, and no variance is negative.

    Of 32 bits each; correlations may be one, and rounded beyond.
    """
    nn, ne, nd, ee, ed, dd = upper
    return (
        all(map(math.isfinite, upper))
        and min(nn, ee, dd) > 0.0
        and all(
            cross * cross <= a * b * (1.0 + 1e-6)
            for cross, a, b in ((ne, nn, ee), (nd, nn, dd), (ed, ee, dd))
        )
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


def time_utc(message: UbxMessage, gps_time_ns: int | None) -> GnssTime:
    """NAV-TIMEUTC."""
    f, utc = message.fields, utc_of(message.fields, gps_time_ns, 4)
    return GnssTime(
        source=message.name,
        itow_ms=f["iTOW"],
        gps_time_ns=gps_time_ns,
        accuracy_ns=f["tAcc"],
        utc_ns=utc or None,
        utc_standard=f["valid"] >> 4,
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
