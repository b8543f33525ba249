"""What a GNSS fix is worth to any localiser: whether it can be used, its deviations, its place."""

from __future__ import annotations

import math

from tramstream import keys
from tramstream.estimation.events import (
    FIX_JAMMED,
    FIX_NO_NUMBER,
    FIX_NOWHERE,
    FIX_SPOOFED,
    FIX_TOO_FAR,
    FIX_TOO_HIGH,
    FIX_TOO_POOR,
)
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel
from tramstream.proto.gnss_pb2 import (
    JAMMING_CRITICAL,
    SPOOFING_INDICATED,
    GnssFix,
    JammingState,
    SpoofingState,
)

_KEY = keys.GNSS_FIX.path
UNSTATED_STD_M = 5.0
"""Horizontal deviation of a fix whose receiver states none, m."""
WORST_STD_M = 1000.0
"""A fix whose stated deviation is larger tells nothing, m."""
FAR_M = 200_000.0
"""A fix further from the origin of the level frame is not of this ride, m."""
NO_COURSE_DEG = 90.0
"""A course whose stated deviation is this or more tells no direction; 0 states none."""
FASTEST_MPS = 100.0
"""No rail vehicle of this house is faster; a velocity beyond is none."""
HIGHEST_M = 9000.0
"""A fix higher or deeper than this is not near the ground (Mount Everest: 8849 m), m."""


def deviations(fix: GnssFix, floor_m: float) -> tuple[float, float]:
    """Deviation of each horizontal axis and of the height; the receiver's, within reason.

    u-blox states the horizontal accuracy as the deviation of the distance: √2 of an axis'. Of a
    height that the receiver does not tell, nothing is known.
    """
    horizontal, vertical = fix.horizontal_std_m, fix.vertical_std_m
    if not (math.isfinite(horizontal) and horizontal > 0.0):
        horizontal = math.sqrt(2.0) * UNSTATED_STD_M
    if not measures_height(fix):
        vertical = WORST_STD_M
    elif not (math.isfinite(vertical) and 0.0 < vertical < WORST_STD_M):
        vertical = 1.5 * horizontal
    return max(horizontal / math.sqrt(2.0), floor_m), max(vertical, floor_m)


def unusable(fix: GnssFix, level: LocalLevel | None) -> Event | None:
    """Why a fix that the receiver calls valid cannot be used; None if it can."""
    values = (fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m)
    if not all(math.isfinite(value) for value in values):
        return FIX_NO_NUMBER(key=_KEY)
    if abs(fix.latitude_deg) > 90.0 or abs(fix.longitude_deg) > 360.0:
        latitude, longitude = fix.latitude_deg, fix.longitude_deg
        return FIX_NOWHERE(key=_KEY, latitude_deg=latitude, longitude_deg=longitude)
    if abs(fix.height_ellipsoid_m) > HIGHEST_M:
        return FIX_TOO_HIGH(key=_KEY, height_m=fix.height_ellipsoid_m, limit_m=HIGHEST_M)
    if fix.horizontal_std_m > WORST_STD_M and math.isfinite(fix.horizontal_std_m):
        return FIX_TOO_POOR(key=_KEY, accuracy_m=fix.horizontal_std_m, limit_m=WORST_STD_M)
    away_m = 0.0 if level is None else _away_m(fix, level)
    if not away_m < FAR_M:
        return FIX_TOO_FAR(key=_KEY, distance_m=away_m, limit_m=FAR_M)
    if fix.spoofing or fix.jamming:
        return _disowned(fix)
    return None


def _disowned(fix: GnssFix) -> Event | None:
    """Why a receiver's own words speak against its fix: signals of others, or none to be heard.

    Interference that it copes with (a warning) is no reason.
    """
    facts = {"key": _KEY, "accuracy_m": fix.horizontal_std_m, "satellites": fix.satellites_used}
    if fix.spoofing >= SPOOFING_INDICATED:
        return FIX_SPOOFED(state=SpoofingState.Name(fix.spoofing), **facts)
    if fix.jamming >= JAMMING_CRITICAL:
        return FIX_JAMMED(state=JammingState.Name(fix.jamming), **facts)
    return None


def _away_m(fix: GnssFix, level: LocalLevel) -> float:
    """How far a fix is from the origin of `level`, on a sphere."""
    radius = 6_371_000.0
    north = (math.radians(fix.latitude_deg) - level.latitude_rad) * radius
    east = math.remainder(math.radians(fix.longitude_deg) - level.longitude_rad, math.tau)
    east *= radius * math.cos(level.latitude_rad)
    return math.hypot(north, east)


def measures_speed(fix: GnssFix) -> bool:
    """Whether the receiver gives a speed: one that has measured none leaves speed and course 0."""
    return fix.HasField("vel_n_mps") or fix.speed_mps != 0.0


def measures_height(fix: GnssFix) -> bool:
    """Whether the receiver gives a height above the ellipsoid that it has measured.

    NMEA without the geoid's separation gives none, and a fix of two dimensions holds an old one.
    """
    return fix.HasField("height_ellipsoid_m") and fix.fix_type != GnssFix.FIX_2D


def place_deg(fix: GnssFix, otherwise_m: float = 0.0) -> tuple[float, float, float]:
    """Latitude, longitude (degrees) and the best that is known of the height, m.

    Above the sea where only that is told: 110 m off at most, which moves a place 10 km away by
    0.2 m in the plane.
    """
    height_m = otherwise_m
    if fix.HasField("height_ellipsoid_m"):
        height_m = fix.height_ellipsoid_m
    elif fix.HasField("height_msl_m"):
        height_m = fix.height_msl_m
    return fix.latitude_deg, fix.longitude_deg, height_m


def velocity_l(fix: GnssFix, level: LocalLevel) -> tuple[float, float] | None:
    """East and north in `level`, m/s; None if the receiver has measured nothing that can be one.

    A receiver that gives no components (NMEA's) may give speed and course.

    The receiver's axes are those of its place, which the meridian convergence turns against those
    of the level frame (docs/theory.md, section 2.2). Its up leans by a thousandth in ten
    kilometres, by which no vertical speed of a rail vehicle shows here.
    """
    if fix.HasField("vel_e_mps") or fix.HasField("vel_n_mps"):
        if not (fix.HasField("vel_e_mps") and fix.HasField("vel_n_mps")):
            return None
        east, north = fix.vel_e_mps, fix.vel_n_mps
    elif fix.speed_mps > 0.0 and fix.course_std_deg < NO_COURSE_DEG:
        course = math.radians(fix.course_deg)
        east, north = fix.speed_mps * math.sin(course), fix.speed_mps * math.cos(course)
    else:  # 0 is also what a receiver leaves that has measured none, or holds its place
        return None
    if not abs(east) + abs(north) < FASTEST_MPS:
        return None
    off = math.radians(fix.longitude_deg) - level.longitude_rad
    angle = math.atan2(math.sin(level.latitude_rad) * math.sin(off), math.cos(off))
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * east - sin * north, sin * east + cos * north


def antenna_l(fix: GnssFix, level: LocalLevel) -> tuple[float, float, float]:
    """Position of the antenna in l, m."""
    latitude_deg, longitude_deg, height_m = place_deg(fix, level.height_m)
    return level.place(math.radians(latitude_deg), math.radians(longitude_deg), height_m)
