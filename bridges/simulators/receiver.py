"""A simulated u-blox receiver on a ride: NAV messages of each epoch, late as real ones are.

The receiver's epochs lie on whole multiples of its period in GPS time. Its clock is taken as
perfect; the vehicle clock, which only looks like Unix time, is wrong by `CLOCK_AHEAD_NS`, so that
epochs do not fall on round stamps. Bytes leave no faster than the line carries them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.bridges.gnss import ubx
from tramstream.bridges.simulators.streams import (
    BITS_PER_BYTE,
    NO_FAULTS,
    SILENCE_AFTER_S,
    Cable,
    Chunk,
    Faults,
)
from tramstream.clock import S
from tramstream.geodesy import PRAGUE_GEOID_M, C_nl
from tramstream.simulation.receiver import GPS_MINUS_UNIX_S, LEAP_SECONDS, Fixes, Gnss, GnssErrors
from tramstream.simulation.ride import Ride

CLOCK_AHEAD_NS = 37_500_000
WEEK_S = 604_800
UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
PIECE_S = 0.001
"""The host's serial driver hands bytes over about this often."""
SKY = tuple(
    (gnss_id, sv_id, 30 + 3 * (sv_id % 6), 15 + 11 * (sv_id % 7), 47 * sv_id % 360)
    for gnss_id, sv_ids in ((0, (2, 5, 7, 13, 15, 30)), (2, (3, 8, 13, 24)), (3, (19, 20, 29, 35)))
    for sv_id in sv_ids
)
"""GNSS, satellite, C/N0 in dBHz, elevation and azimuth in degrees: an invented sky that stays."""


@dataclass(frozen=True, slots=True)
class GnssDevice:
    """The receiver, its antenna and its line."""

    rate_hz: int = 5
    baud_rate: int = 460_800
    delay_s: float = 0.1
    """Epoch to first byte at the fastest; see `config.Gnss.receiver_delay_s`."""
    jitter_s: float = 0.004
    p_va_v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    errors: GnssErrors = field(default_factory=GnssErrors)


class Epoch(NamedTuple):
    """One epoch's instant in GPS time and what the receiver makes of it."""

    gps_ns: int
    geodetic_deg: NDArray[np.float64]
    velocity: NDArray[np.float64]
    """East, north, up of the place, m/s."""

    @property
    def itow_ms(self) -> int:
        return self.gps_ns // 1_000_000 % (WEEK_S * 1000)


def gnss_stream(
    ride: Ride,
    rng: Generator,
    start_ns: int,
    device: GnssDevice | None = None,
    faults: Faults = NO_FAULTS,
) -> Iterator[Chunk]:
    """All the receiver says on a ride, and the pulling of its plug."""
    device = device or GnssDevice()
    fixes_rng, line_rng = rng.spawn(2)
    receiver = Gnss(fixes_rng, device.rate_hz, device.errors, device.p_va_v)
    period_ns = S // device.rate_hz
    gps_ahead_ns = GPS_MINUS_UNIX_S * S - CLOCK_AHEAD_NS
    first = -(-(start_ns + gps_ahead_ns) // period_ns)
    last = (start_ns + gps_ahead_ns + round((ride.duration_s + SILENCE_AFTER_S) * S)) // period_ns
    bad_checksum = [start_ns + round(at * S) for at in faults.gnss_bad_checksum_s]
    cable = _cable(faults, start_ns)
    for number in range(first, last + 1):
        stamp_ns = number * period_ns - gps_ahead_ns
        time_s = np.array([(stamp_ns - start_ns) / S])
        fixes = receiver.measure(ride.position_l(time_s), ride.motion(time_s))
        epoch = _epoch(ride, number * period_ns, fixes)
        messages = _messages(epoch, device, number - first)
        spoilt = bool(bad_checksum) and stamp_ns >= bad_checksum[0]
        if spoilt:
            messages[0] = _spoil_checksum(messages[0])
            del bad_checksum[0]
        delay_s = device.delay_s + line_rng.uniform(0, device.jitter_s)
        chunks = _on_the_line(messages, stamp_ns + round(delay_s * S), device.baud_rate, spoilt)
        while cable and cable[0].due_ns <= chunks[0].due_ns:
            yield cable.pop(0)
        yield from chunks


def _cable(faults: Faults, start_ns: int) -> list[Chunk]:
    pulls: list[Chunk] = []
    for pulled_s, plugged_s in faults.gnss_unplugged_s:
        pulls.append(
            Chunk(start_ns + round(pulled_s * S), faults={"unplugged": 1}, cable=Cable.PULLED)
        )
        pulls.append(Chunk(start_ns + round(plugged_s * S), cable=Cable.PLUGGED))
    return pulls


def _epoch(ride: Ride, gps_ns: int, fixes: Fixes) -> Epoch:
    level = ride.line.level
    geodetic = level.to_geodetic(fixes.p_l[0])
    latitude, longitude, height = geodetic
    geodetic_deg = np.array([math.degrees(latitude), math.degrees(longitude), height])
    return Epoch(gps_ns, geodetic_deg, C_nl(level, geodetic) @ fixes.vel_l[0])


def _messages(epoch: Epoch, device: GnssDevice, count: int) -> list[bytes]:
    """Messages of an epoch, NAV-PVT first, end of epoch last."""
    itow = epoch.itow_ms
    messages = [
        ubx.encode("NAV-PVT", _pvt(epoch, device.errors)),
        ubx.encode("NAV-COV", _covariance(itow, device.errors)),
    ]
    if count % device.rate_hz == 0:
        time_gps = {
            "iTOW": itow,
            "week": epoch.gps_ns // S // WEEK_S,
            "leapS": LEAP_SECONDS,
            "valid": 0x07,  # time of week, week and leap seconds
            "tAcc": 5,
        }
        messages.append(ubx.encode("NAV-TIMEGPS", time_gps))
        messages.append(ubx.encode("NAV-SAT", {"iTOW": itow, "version": 1}, _satellites()))
    if count % (10 * device.rate_hz) == 0:
        leap = {"iTOW": itow, "srcOfCurrLs": 2, "currLs": LEAP_SECONDS, "valid": 0x03}
        messages.append(ubx.encode("NAV-TIMELS", leap))
    messages.append(ubx.encode("NAV-EOE", {"iTOW": itow}))
    return messages


def _pvt(epoch: Epoch, errors: GnssErrors) -> dict[str, Any]:
    """Fields of NAV-PVT (u-blox F9 HPG 1.32, section 3.15.13)."""
    unix_ns = epoch.gps_ns - GPS_MINUS_UNIX_S * S
    seconds, nano = divmod(unix_ns, S)
    utc = UNIX_EPOCH + timedelta(seconds=seconds)
    latitude_deg, longitude_deg, height_m = epoch.geodetic_deg
    east, north, up = epoch.velocity
    speed = math.hypot(east, north)
    course_std_deg = math.degrees(math.atan2(errors.velocity_std_mps, speed))
    return {
        "iTOW": epoch.itow_ms,
        "year": utc.year,
        "month": utc.month,
        "day": utc.day,
        "hour": utc.hour,
        "min": utc.minute,
        "sec": utc.second,
        "valid": 0x07,  # date, time, fully resolved
        "tAcc": 20,
        "nano": nano,
        "fixType": 3,
        "flags": 0x01,  # gnssFixOK
        "flags2": 0xE0,  # date and time confirmed
        "numSV": len(SKY),
        "lon": longitude_deg,
        "lat": latitude_deg,
        "height": round(height_m * 1e3),
        "hMSL": round((height_m - PRAGUE_GEOID_M) * 1e3),
        "hAcc": round(math.sqrt(2) * errors.horizontal_std_m * 1e3),
        "vAcc": round(errors.vertical_std_m * 1e3),
        "velN": round(north * 1e3),
        "velE": round(east * 1e3),
        "velD": round(-up * 1e3),
        "gSpeed": round(speed * 1e3),
        "headMot": math.degrees(math.atan2(east, north)) % 360,
        "sAcc": round(errors.velocity_std_mps * 1e3),
        "headAcc": course_std_deg,
        "pDOP": 1.3,
    }


def _covariance(itow_ms: int, errors: GnssErrors) -> dict[str, Any]:
    horizontal, vertical = errors.horizontal_std_m**2, errors.vertical_std_m**2
    fields: dict[str, Any] = {"iTOW": itow_ms, "posCovValid": 1, "velCovValid": 1}
    for axes, variance in (("NN", horizontal), ("EE", horizontal), ("DD", vertical)):
        fields[f"posCov{axes}"] = variance
        fields[f"velCov{axes}"] = errors.velocity_std_mps**2
    return fields


def _satellites() -> list[dict[str, Any]]:
    # flags: quality 7 (code and carrier locked), used, healthy, ephemeris
    return [
        {"gnssId": gnss, "svId": sv, "cno": cno, "elev": elev, "azim": azim, "flags": 0x91F}
        for gnss, sv, cno, elev, azim in SKY
    ]


def _spoil_checksum(message: bytes) -> bytes:
    return message[:-1] + bytes([message[-1] ^ 0x55])


def _on_the_line(messages: list[bytes], start_ns: int, baud_rate: int, spoilt: bool) -> list[Chunk]:
    """Cut an epoch's bytes as the line hands them over; the last chunk counts the epoch."""
    byte_ns = BITS_PER_BYTE * S / baud_rate
    counts = {"frames": len(messages) - spoilt, "fixes": 1 - spoilt}
    faults = {"checksums_spoilt": 1} if spoilt else {}
    chunks = pieces(b"".join(messages), start_ns, byte_ns)
    chunks[-1] = chunks[-1]._replace(counts=counts, faults=faults)
    return chunks


def pieces(data: bytes, start_ns: int, byte_ns: float) -> list[Chunk]:
    """Cut bytes into what the line carries in `PIECE_S`, each due when its last byte is there."""
    size = max(int(PIECE_S * S / byte_ns), 1)
    return [
        Chunk(start_ns + round(min(at + size, len(data)) * byte_ns), data[at : at + size])
        for at in range(0, len(data), size)
    ]
