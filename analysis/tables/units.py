"""Units and clocks of tables: factors to SI, and the way to GPS time as Unix time."""

from __future__ import annotations

import re
from math import pi
from typing import Annotated, Literal

from msgspec import Meta

from tramstream.bridges.gnss.clock import WEEK_NS, leap_seconds_on, utc_ns
from tramstream.bridges.imu.bridge import STANDARD_GRAVITY_MPS2
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Struct

UNITS: dict[str, dict[str, float]] = {
    "angle": {"deg": pi / 180, "rad": 1.0, "1e-7 deg": 1e-7 * pi / 180},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "mm/s": 1e-3, "cm/s": 1e-2, "kn": 1852 / 3600,
              "mph": 0.44704},
    "acceleration": {"m/s2": 1.0, "g": STANDARD_GRAVITY_MPS2, "mg": 1e-3 * STANDARD_GRAVITY_MPS2},
    "turn rate": {"rad/s": 1.0, "deg/s": pi / 180, "mdeg/s": 1e-3 * pi / 180,
                  "mrad/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3},
    "temperature": {"degC": 1.0},
    "wheel": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "pulses": 1.0, "total pulses": 1.0},
}  # fmt: skip
"""Factors to SI, by what is measured; temperatures stay in °C and pulses are counts."""

_INSTANT = re.compile(
    r"(\d{4})[-/](\d\d?)[-/](\d\d?)(?:[T ](\d\d?):(\d\d):(\d\d)(?:\.(\d{1,9})\d*)?)?"
    r"\s*(?:Z|([+-])(\d\d):?(\d\d))?"
)


class Clock(Struct, frozen=True, kw_only=True):
    """What a time column counts from, and in which scale."""

    kind: Literal["gps_week", "gps", "utc", "relative"]
    """gps_week: seconds of a GPS week. gps: since 1980-01-06. utc: Unix time. relative: since
    `start`, on a clock of their own."""
    week: Annotated[int, Meta(ge=0, le=8000)] | None = None
    """Of gps_week: counted on since 1980, not modulo 1024."""
    date: str = ""
    """Of gps_week, instead of the week: any of its days."""
    start: str = ""
    """Of relative: what the record calls second zero."""


def instant_ns(text: str) -> int | None:
    """Nanoseconds from 1970 to a date, with a time of day or not, in its own scale."""
    match = _INSTANT.fullmatch(text.strip())
    if match is None:
        return None
    year, month, day, hour, minute, second = (int(part or 0) for part in match.groups()[:6])
    fraction, sign, zone_h, zone_min = match.groups()[6:]
    whole_ns = utc_ns(year, month, day, hour, minute, second, 0)
    if whole_ns == 0:
        return None
    zone_s = 60 * (60 * int(zone_h) + int(zone_min)) if sign else 0
    return (
        whole_ns + int((fraction or "0").ljust(9, "0")) - (zone_s * S) * (-1 if sign == "-" else 1)
    )


def scale_start_ns(clock: Clock, first_ns: int, dated: bool) -> int:
    """What turns a table's time into GPS time as Unix time, the scale of imported records.

    Parameters
    ----------
    first_ns : int
        The first time in the table: tells the leap seconds of a UTC clock.
    dated : bool
        Whether the time is a date, and so counts from 1970.
    """
    if clock.kind == "utc":
        return leap_seconds_on(first_ns) * S
    if dated:
        return 0
    if clock.kind == "gps":
        return GPS_EPOCH_UNIX_S * S
    if clock.kind == "relative":
        return instant_ns(clock.start) or 0
    if clock.week is not None:
        return GPS_EPOCH_UNIX_S * S + clock.week * WEEK_NS
    day_ns = instant_ns(clock.date) or 0
    return day_ns - (day_ns - GPS_EPOCH_UNIX_S * S) % WEEK_NS
