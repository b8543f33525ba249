"""One fix out of the several messages in which receivers before NAV-PVT tell it (u-blox 4 to 6).

What carries the same time of week is one epoch; where it ends says `epochs.py`, or NAV-EOE. The
place is that of NAV-POSLLH, else that of NAV-SOL or NAV-POSECEF turned to latitude and longitude;
the velocity that of NAV-VELNED, else the Earth-fixed one turned to north, east and down. NAV-SOL
and NAV-STATUS say whether it is a fix. Without either, a position counts that is as accurate as is
asked: one without a fix states hundreds of kilometres.

Sections of the u-blox 6 Receiver Description (GPS.G6-SW-10018): 36, NAV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from tramstream.bridges.gnss.epochs import EndOfEpoch
from tramstream.bridges.gnss.messages import MILLI, fix_type_of, judge, utc_of
from tramstream.bridges.gnss.nmea import VERTICAL_PER_HORIZONTAL
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.geodesy import geodetic_from_ecef
from tramstream.proto.gnss_pb2 import GnssFix

_CENTI = 100.0
_UTC_IS_VALID = 4
_EARTH_FIXED, _GEODETIC = 1, 2
_STANDING_MPS = 0.01
"""One unit of the messages: what is slower has no course."""
PARTS = (
    "NAV-SOL", "NAV-POSLLH", "NAV-POSECEF", "NAV-VELNED", "NAV-VELECEF", "NAV-STATUS", "NAV-DOP",
    "NAV-TIMEUTC",
)  # fmt: skip
"""Messages that tell a part of a fix."""


@dataclass
class Combination:
    """What the messages of one epoch said; NaN where they said nothing."""

    itow_ms: int
    first_arrival_ns: int
    gps_ns: int | None = None
    kinds: list[str] = field(default_factory=list)
    place_from: int = 0
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    height_m: float = 0.0
    msl_m: float = math.nan
    horizontal_std_m: float = math.nan
    vertical_std_m: float = math.nan
    spatial_std_m: float = math.nan
    """Of the position in space, where it alone is told."""
    velocity_e_mps: list[float] = field(default_factory=list)
    velocity_ned_mps: list[float] = field(default_factory=list)
    speed_std_mps: float = 0.0
    course_deg: float = math.nan
    course_std_deg: float = math.nan
    gps_fix: int = -1
    """Fix type, -1 if not told."""
    flags: int = 0
    satellites: int = 0
    pdop: float = 0.0
    hdop: float = 0.0
    vdop: float = 0.0
    utc_ns: int = 0

    @property
    def source(self) -> str:
        """What the fix is named after: who told whether it is one, or else the place."""
        for name in ("NAV-SOL", "NAV-POSLLH"):
            if name in self.kinds:
                return name
        return "NAV-POSECEF"

    @property
    def is_placed(self) -> bool:
        """Whether a position was among the messages."""
        return self.place_from > 0

    @property
    def is_judged(self) -> bool:
        """Whether the receiver said if it is a fix."""
        return self.gps_fix >= 0

    def take(self, message: UbxMessage, gps_ns: int | None) -> None:
        """Add what `message` says."""
        name, f = message.name, message.fields
        self.kinds.append(name)
        if self.gps_ns is None or name in ("NAV-SOL", "NAV-TIMEUTC"):
            self.gps_ns = gps_ns if gps_ns is not None else self.gps_ns
        if name in ("NAV-SOL", "NAV-STATUS"):
            self.gps_fix, self.flags = f["gpsFix"], f["flags"]
        if name in ("NAV-SOL", "NAV-POSECEF"):
            self._take_earth_fixed(f)
        if name in ("NAV-SOL", "NAV-VELECEF"):
            self.velocity_e_mps = [f[f"ecefV{axis}"] / _CENTI for axis in "XYZ"]
            if not self.velocity_ned_mps:
                self.speed_std_mps = f["sAcc"] / _CENTI
        if name == "NAV-SOL":
            self.satellites, self.pdop = f["numSV"], f["pDOP"]
        elif name == "NAV-POSLLH":
            self.place_from = _GEODETIC
            self.latitude_deg, self.longitude_deg = f["lat"], f["lon"]
            self.height_m, self.msl_m = f["height"] / MILLI, f["hMSL"] / MILLI
            self.horizontal_std_m, self.vertical_std_m = f["hAcc"] / MILLI, f["vAcc"] / MILLI
        elif name == "NAV-VELNED":
            self.velocity_ned_mps = [f[f"vel{axis}"] / _CENTI for axis in "NED"]
            self.speed_std_mps = f["sAcc"] / _CENTI
            self.course_deg, self.course_std_deg = f["heading"], f["cAcc"]
        elif name == "NAV-DOP":
            self.pdop, self.hdop, self.vdop = f["pDOP"], f["hDOP"], f["vDOP"]
        elif name == "NAV-TIMEUTC":
            self.utc_ns = utc_of(f, gps_ns, _UTC_IS_VALID)

    def _take_earth_fixed(self, f: dict[str, Any]) -> None:
        p_e = [f[f"ecef{axis}"] / _CENTI for axis in "XYZ"]
        if self.place_from == _GEODETIC or not any(p_e):
            return
        self.place_from = _EARTH_FIXED
        latitude, longitude, height = geodetic_from_ecef(p_e).tolist()
        self.latitude_deg, self.longitude_deg = math.degrees(latitude), math.degrees(longitude)
        self.height_m, self.spatial_std_m = height, f["pAcc"] / _CENTI


def fix_of(of: Combination, max_accuracy_m: float) -> GnssFix:
    """Make the fix of a complete epoch."""
    fix = GnssFix(
        source=of.source, itow_ms=of.itow_ms, gps_time_ns=of.gps_ns, utc_ns=of.utc_ns,
        differential=bool(of.flags & 2), satellites_used=of.satellites, pdop=of.pdop,
        latitude_deg=of.latitude_deg, longitude_deg=of.longitude_deg,
        height_ellipsoid_m=of.height_m,
        height_msl_m=of.msl_m if math.isfinite(of.msl_m) else None,
    )  # fmt: skip
    fix.horizontal_std_m, fix.vertical_std_m = _deviations(of)
    _add_velocity(fix, of)
    if of.is_judged:
        fix.fix_type = fix_type_of(of.gps_fix)
        judge(fix, bool(of.flags & 1), max_accuracy_m)
    else:
        fix.fix_type = GnssFix.FIX_3D
        judge(fix, fix.horizontal_std_m > 0.0, max_accuracy_m)
        if not fix.valid:
            fix.fix_type = GnssFix.NO_FIX
    return fix


def _deviations(of: Combination) -> tuple[float, float]:
    """Horizontal and vertical, m. That in space alone is shared out by the dilutions."""
    if of.place_from == _GEODETIC:
        return of.horizontal_std_m, of.vertical_std_m
    across, up = 1.0, VERTICAL_PER_HORIZONTAL
    if of.hdop > 0.0 and of.vdop > 0.0:
        across, up = of.hdop, of.vdop
    part = of.spatial_std_m / math.hypot(across, up)
    return part * across, part * up


def _add_velocity(fix: GnssFix, of: Combination) -> None:
    """North, east and down as told, or turned out of the Earth's frame at the fix's place."""
    ned, course_deg, course_std_deg = of.velocity_ned_mps, of.course_deg, of.course_std_deg
    if not ned and of.velocity_e_mps:
        ned = _north_east_down(of)
        speed = math.hypot(ned[0], ned[1])
        moves = speed > _STANDING_MPS
        course_deg = math.degrees(math.atan2(ned[1], ned[0])) % 360.0 if moves else 0.0
        course_std_deg = math.degrees(math.atan2(of.speed_std_mps, speed)) if moves else 180.0
    if not ned:
        return
    fix.vel_n_mps, fix.vel_e_mps, fix.vel_d_mps = ned
    fix.speed_mps, fix.speed_std_mps = math.hypot(ned[0], ned[1]), of.speed_std_mps
    fix.course_deg, fix.course_std_deg = course_deg, course_std_deg


def _north_east_down(of: Combination) -> list[float]:
    """The Earth-fixed velocity at the place (Groves, 2nd ed., eq. 2.150)."""
    latitude, longitude = math.radians(of.latitude_deg), math.radians(of.longitude_deg)
    x, y, z = of.velocity_e_mps
    outward = math.cos(longitude) * x + math.sin(longitude) * y
    east = -math.sin(longitude) * x + math.cos(longitude) * y
    north = -math.sin(latitude) * outward + math.cos(latitude) * z
    down = -math.cos(latitude) * outward - math.sin(latitude) * z
    return [north, east, down]


@dataclass
class CombinationAssembler:
    """Messages in, complete epochs out. It is its own memory."""

    _epoch: Combination | None = None
    _end: EndOfEpoch = field(default_factory=EndOfEpoch)

    def feed(self, message: UbxMessage, gps_ns: int | None, arrival_ns: int) -> list[Combination]:
        """Take one of `PARTS`, return the epoch or epochs it completes."""
        out: list[Combination] = []
        itow_ms = message.fields["iTOW"]
        if self._epoch is None or self._epoch.itow_ms != itow_ms:
            out += self.flush()
            self._epoch = Combination(itow_ms, arrival_ns)
            self._end.begin()
        if not self._end.room():
            return out
        last = self._end.note(message.name)
        if not self._end.complete:
            self._epoch.take(message, gps_ns)
            if last:
                out += self.flush()
        return out

    def flush(self) -> list[Combination]:
        """Give out the epoch under way, if it has a place and was not given out before."""
        epoch = self._epoch
        if epoch is None or self._end.complete:
            return []
        self._end.complete = True
        return [epoch] if epoch.is_placed else []
