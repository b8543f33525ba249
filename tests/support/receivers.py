"""Receivers of several generations that do not exist: what each sends of a known epoch."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import Any

from tramstream import keys
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.clock import WEEK_NS
from tramstream.bridges.gnss.framer import nmea_frame
from tramstream.clock import S
from tramstream.config import Gnss, Vehicle
from tramstream.geodesy import ecef_from_geodetic
from tramstream.keys import Key
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import RawBytes

MS = 1_000_000
BAUD = 460_800
BOOT_NS = 1_700_000_000 * S
LEAP_S = 18
WEEK = 2300
START_NS = WEEK * WEEK_NS + 123_456 * S
LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M, MSL_M = 50.0870001, 14.4212349, 250.12, 205.1
NORTH_MPS, EAST_MPS, DOWN_MPS = 4.0, 3.0, -0.1
VEHICLE = Vehicle(vehicle="t", gnss=Gnss(device="/dev/null", baud_rate=BAUD, receiver_delay_s=0.1))


def raw(data: bytes, arrival_ns: int = BOOT_NS) -> Sample:
    return Sample(keys.GNSS_BYTES, RawBytes(stamp_ns=arrival_ns, data=data), arrival_ns, 1)


def on(samples: list[Sample], key: Key) -> list[Any]:
    """Messages on a key."""
    return [sample.message for sample in samples if sample.key == key]


def decoded(*data: bytes) -> list[Sample]:
    """All that a fresh bridge makes of a stream, one read a second."""
    bridge = GnssBridge(VEHICLE)
    out = [s for n, piece in enumerate(data) for s in bridge.step(raw(piece, BOOT_NS + n * S))]
    return out + bridge.finish()


def itow_ms(gps_ns: int) -> int:
    return round(gps_ns % WEEK_NS / MS)


def utc_of(gps_ns: int) -> datetime:
    return datetime(1980, 1, 6, tzinfo=UTC) + timedelta(microseconds=gps_ns / 1000 - LEAP_S * 1e6)


def sol(gps_ns: int = START_NS, **changes: Any) -> bytes:
    """NAV-SOL, in whole centimetres of the Earth-fixed frame."""
    place = [math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG), HEIGHT_M]
    x, y, z = ecef_from_geodetic(place).tolist()
    vx, vy, vz = velocity_e()
    fields = {
        "iTOW": itow_ms(gps_ns), "week": gps_ns // WEEK_NS, "gpsFix": 3, "flags": 0x0D,
        "ecefX": round(100 * x), "ecefY": round(100 * y), "ecefZ": round(100 * z), "pAcc": 360,
        "ecefVX": round(100 * vx), "ecefVY": round(100 * vy), "ecefVZ": round(100 * vz),
        "sAcc": 30, "pDOP": 1.5, "numSV": 9,
    }  # fmt: skip
    return ubx.encode("NAV-SOL", fields | changes)


def velocity_e() -> tuple[float, float, float]:
    """The velocity in the Earth-fixed frame, from the axes there (Groves, 2nd ed., 2.3.2)."""
    la, lo = math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG)
    north = (-math.sin(la) * math.cos(lo), -math.sin(la) * math.sin(lo), math.cos(la))
    east = (-math.sin(lo), math.cos(lo), 0.0)
    down = (-math.cos(la) * math.cos(lo), -math.cos(la) * math.sin(lo), -math.sin(la))
    axes = zip(north, east, down, strict=True)
    return tuple(NORTH_MPS * n + EAST_MPS * e + DOWN_MPS * d for n, e, d in axes)  # type: ignore[return-value]


def posllh(gps_ns: int = START_NS, **changes: Any) -> bytes:
    fields = {
        "iTOW": itow_ms(gps_ns), "lat": LATITUDE_DEG, "lon": LONGITUDE_DEG,
        "height": round(1000 * HEIGHT_M), "hMSL": round(1000 * MSL_M), "hAcc": 2500, "vAcc": 3500,
    }  # fmt: skip
    return ubx.encode("NAV-POSLLH", fields | changes)


def velned(gps_ns: int = START_NS) -> bytes:
    speed = math.hypot(NORTH_MPS, EAST_MPS)
    fields = {
        "iTOW": itow_ms(gps_ns), "velN": round(100 * NORTH_MPS), "velE": round(100 * EAST_MPS),
        "velD": round(100 * DOWN_MPS), "speed": round(100 * speed), "gSpeed": round(100 * speed),
        "heading": math.degrees(math.atan2(EAST_MPS, NORTH_MPS)), "sAcc": 30, "cAcc": 3.0,
    }  # fmt: skip
    return ubx.encode("NAV-VELNED", fields)


def status(gps_ns: int = START_NS, **changes: Any) -> bytes:
    fields = {"iTOW": itow_ms(gps_ns), "gpsFix": 3, "flags": 0x0D}
    return ubx.encode("NAV-STATUS", fields | changes)


def dop(gps_ns: int = START_NS) -> bytes:
    fields = {"iTOW": itow_ms(gps_ns), "pDOP": 2.5, "hDOP": 1.5, "vDOP": 2.0}
    return ubx.encode("NAV-DOP", fields)


def timeutc(gps_ns: int = START_NS, valid: int = 7) -> bytes:
    utc = utc_of(gps_ns)
    fields = {
        "iTOW": itow_ms(gps_ns), "year": utc.year, "month": utc.month, "day": utc.day,
        "hour": utc.hour, "min": utc.minute, "sec": utc.second, "valid": valid, "tAcc": 50,
    }  # fmt: skip
    return ubx.encode("NAV-TIMEUTC", fields)


def solution(gps_ns: int = START_NS, name: str = "NAV-PVT", **changes: Any) -> bytes:
    """NAV-PVT (of u-blox 7 too), NAV-PVAT or HNR-PVT."""
    utc = utc_of(gps_ns)
    fields: dict[str, Any] = {
        "iTOW": itow_ms(gps_ns), "year": utc.year, "month": utc.month, "day": utc.day,
        "hour": utc.hour, "min": utc.minute, "sec": utc.second, "valid": 7, "flags": 1,
        "lat": LATITUDE_DEG, "lon": LONGITUDE_DEG, "height": round(1000 * HEIGHT_M),
        "hMSL": round(1000 * MSL_M), "hAcc": 900, "vAcc": 1500,
        "gSpeed": round(1000 * math.hypot(NORTH_MPS, EAST_MPS)), "sAcc": 100,
    }  # fmt: skip
    course_deg = math.degrees(math.atan2(EAST_MPS, NORTH_MPS))
    if name == "HNR-PVT":
        fields |= {"gpsFix": 3, "headMot": course_deg, "headAcc": 1.0}
    else:
        fields |= {"fixType": 3, "numSV": 17, "velN": round(1000 * NORTH_MPS)}
        fields |= {"velE": round(1000 * EAST_MPS), "velD": round(1000 * DOWN_MPS)}
        fields |= {} if name == "NAV-PVAT" else {"headMot": course_deg}
    return ubx.encode(name, fields | changes)


def sentences(gps_ns: int = START_NS, *kinds: str) -> bytes:
    """NMEA of an epoch, of the sentences `kinds`."""
    utc = utc_of(gps_ns)
    time, date = utc.strftime("%H%M%S.00"), utc.strftime("%d%m%y")
    place = f"{_minutes(LATITUDE_DEG, 2)},N,{_minutes(LONGITUDE_DEG, 3)},E"
    knots = math.hypot(NORTH_MPS, EAST_MPS) * 3600 / 1852
    course_deg = math.degrees(math.atan2(EAST_MPS, NORTH_MPS))
    texts = {
        "RMC": f"GNRMC,{time},A,{place},{knots:.3f},{course_deg:.2f},{date},,,A,V",
        "GGA": f"GNGGA,{time},{place},1,12,0.8,{MSL_M},M,{HEIGHT_M - MSL_M:.2f},M,,",
        "GST": f"GNGST,{time},12,1.2,0.8,30,1.0,1.2,2.0",
    }
    return b"".join(nmea_frame(texts[kind]) for kind in kinds)


def _minutes(angle_deg: float, digits: int) -> str:
    degrees = int(angle_deg)
    return f"{degrees:0{digits}d}{60 * (angle_deg - degrees):010.7f}"
