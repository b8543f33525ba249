"""What a GNSS fix is worth to any localiser: whether it can be used, its deviations, its place."""

from __future__ import annotations

import math

from tramstream.geodesy import LocalLevel
from tramstream.proto.gnss_pb2 import GnssFix

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

    u-blox states the horizontal accuracy as the deviation of the distance: √2 of an axis'.
    """
    horizontal, vertical = fix.horizontal_std_m, fix.vertical_std_m
    if not (math.isfinite(horizontal) and horizontal > 0.0):
        horizontal = math.sqrt(2.0) * UNSTATED_STD_M
    if not (math.isfinite(vertical) and 0.0 < vertical < WORST_STD_M):
        vertical = 1.5 * horizontal
    return max(horizontal / math.sqrt(2.0), floor_m), max(vertical, floor_m)


def unusable(fix: GnssFix, level: LocalLevel | None) -> str:
    """Why a fix that the receiver calls valid cannot be used; empty if it can."""
    values = (fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m)
    if not all(math.isfinite(value) for value in values):
        return "a fix with a position that is no number"
    if abs(fix.latitude_deg) > 90.0 or abs(fix.longitude_deg) > 360.0:
        return "a fix that is nowhere on the Earth"
    if abs(fix.height_ellipsoid_m) > HIGHEST_M:
        return "a fix that is not near the ground"
    if fix.horizontal_std_m > WORST_STD_M and math.isfinite(fix.horizontal_std_m):
        return "a fix that is good to a kilometre at best"
    if level is not None and _is_far(fix, level):
        return "a fix hundreds of kilometres away from where the ride began"
    return ""


def _is_far(fix: GnssFix, level: LocalLevel) -> bool:
    """Whether a fix cannot be of a ride that began at the origin of `level`."""
    radius = 6_371_000.0
    north = (math.radians(fix.latitude_deg) - level.latitude_rad) * radius
    east = math.remainder(math.radians(fix.longitude_deg) - level.longitude_rad, math.tau)
    east *= radius * math.cos(level.latitude_rad)
    return not math.hypot(north, east) < FAR_M


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
    row = (
        math.radians(fix.latitude_deg),
        math.radians(fix.longitude_deg),
        fix.height_ellipsoid_m,
    )
    east, north, up = level.from_geodetic(row).tolist()
    return east, north, up
