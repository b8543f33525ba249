"""Continuous GPS time of a receiver's messages, and its place on the vehicle clock.

`GpsTimeline` turns week, time of week and UTC of a message into nanoseconds since 1980-01-06. Most
messages carry only the time of week; the week comes from the last message that knew it, so that a
roll of the week between two messages is of no consequence. A UTC date gives the week without the
leap seconds, which are believed only where the receiver says that they are valid.

A receiver that has not found its place tells the day that its clock was built, or with which its
week counter began: dates before GPS was complete are none. One that is older than its firmware's
idea of weeks is 1024 weeks back. What it sends tells it, where no receiver of that date sent such
messages yet; so do its leap seconds, or a vehicle clock that knows the year.

`ArrivalClock` maps a device's time to the vehicle clock with `ClockFit`, by the definition
arrival = epoch + receiver delay + line time + waiting, waiting ≥ 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import date
from typing import Any

from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.clock import GPS_EPOCH_UNIX_S, ClockFit, FitMemory, S

WEEK_NS = 604_800 * S
MS = 1_000_000
"""Nanoseconds in a millisecond."""
_DAY_S = 86_400
_FIRST_YEAR, _LAST_YEAR = 1980, 2150
_LAST_WEEK = 8871
"""Of 2150: a later one is garbage, and its nanoseconds would soon not fit into 64 bits."""
_LATEST_NS = 2**63 - 1

FIRST_DAY = date(1995, 1, 1).toordinal()
"""GPS was complete in 1995, and nobody has built a receiver for vehicles before: an earlier date is
no date."""
_FIRST_NS = ((FIRST_DAY - 719_163) * _DAY_S - GPS_EPOCH_UNIX_S) * S
ROLLOVER_NS = 1024 * WEEK_NS
"""Ten bits of week: what a receiver is wrong by that does not know which of them it is."""
MODERN = frozenset(
    ("NAV-PVT", "NAV-PVAT", "HNR-PVT", "RXM-RAWX", "NAV-SAT", "NAV-SIG", "NAV-COV", "NAV-EOE")
)
"""What no receiver sends that was built before u-blox 7."""
_MODERN_DAY = date(2011, 1, 1).toordinal()
"""The first u-blox 7 were sold in 2012 (GPS.G7-SW-12001). A date that is 1024 weeks back lies
before it until August 2030."""
_MODERN_NS = ((_MODERN_DAY - 719_163) * _DAY_S - GPS_EPOCH_UNIX_S) * S
_NEAR_NS = 30 * _DAY_S * S
"""A vehicle clock that knows the year is right by this."""

# IERS Bulletin C: GPS − UTC from these dates on.
_LEAP_SECONDS = (
    (date(2017, 1, 1), 18), (date(2015, 7, 1), 17), (date(2012, 7, 1), 16),
    (date(2009, 1, 1), 15), (date(2006, 1, 1), 14), (date(1999, 1, 1), 13),
)  # fmt: skip


_NEWEST_LEAP = _LEAP_SECONDS[0][1]
"""More leap seconds than there have been tell nothing of the date."""
_MISSED_LEAPS = 2
"""In 1024 weeks so many are inserted at least; one more is only news."""


def utc_ns(year: int, month: int, day: int, hour: int, minute: int, second: int, nano: int) -> int:
    """UTC in Unix nanoseconds; 0 if that is no date. `nano` may be negative, `second` 60."""
    if not (_FIRST_YEAR <= year <= _LAST_YEAR and 0 < month <= 12 and 0 < day <= 31):
        return 0
    if hour > 23 or minute > 59 or second > 60:
        return 0
    try:
        days = date(year, month, day).toordinal() - 719_163  # 1970-01-01
    except ValueError:
        return 0
    return (days * _DAY_S + hour * 3600 + minute * 60 + second) * S + nano


def leap_seconds_on(unix_ns: int) -> int:
    """GPS − UTC of a UTC instant since 1999, where no receiver says it: offline only."""
    day = date.fromordinal(719_163 + unix_ns // S // _DAY_S)
    return next((seconds for since, seconds in _LEAP_SECONDS if day >= since), 13)


def is_nowhere(latitude_deg: float, longitude_deg: float) -> bool:
    """Whether a place is 0° 0° to the last digit: what is sent by who knows none."""
    return latitude_deg == 0.0 and longitude_deg == 0.0


def behind_ns(time_ns: int, vehicle_ns: int) -> int:
    """How much a time is behind by rollovers of the week, against a clock that looks like it.

    Parameters
    ----------
    time_ns : int
        Receiver's time, from the Unix epoch.
    vehicle_ns : int
        Vehicle clock. Where nobody has set it, it is decades behind and tells nothing.
    """
    rollovers = (vehicle_ns - time_ns + ROLLOVER_NS // 2) // ROLLOVER_NS
    missing_ns = rollovers * ROLLOVER_NS
    return missing_ns if rollovers > 0 and abs(vehicle_ns - time_ns - missing_ns) < _NEAR_NS else 0


@dataclass
class GpsTimeline:
    """Week and leap seconds as the receiver's messages reveal them: a memory."""

    reference_ns: int | None = None
    """The latest GPS time of which the week was known."""
    leap_seconds: int | None = None
    modern: bool = False
    """Whether the receiver has sent what is in `MODERN`."""

    def of(self, message: UbxMessage, vehicle_ns: int = 0) -> int | None:
        """GPS time of the epoch that `message` belongs to; None while the week is unknown.

        `vehicle_ns`, the arrival by a vehicle clock that may know the year, corrects rollovers.
        """
        fields = message.fields
        name = message.name
        self.modern = self.modern or name in MODERN
        find = _WHOLE_TIMES.get(name)
        if find is None:
            if name == "NAV-TIMELS" and fields["valid"] & 1:
                self.leap_seconds = fields["currLs"]
            itow_ms = fields.get("iTOW")
            return None if itow_ms is None or itow_ms < 0 else self.near(itow_ms * MS)
        gps_ns = find(self, fields)
        if gps_ns is None or gps_ns < _FIRST_NS:
            return None
        gps_ns += behind_ns(gps_ns + GPS_EPOCH_UNIX_S * S, vehicle_ns)
        gps_ns = self.in_its_age(gps_ns)
        if self.leap_seconds is not None and self.leap_seconds <= _NEWEST_LEAP:
            while (
                self.leap_seconds - leap_seconds_on(gps_ns + GPS_EPOCH_UNIX_S * S) >= _MISSED_LEAPS
            ):
                gps_ns += ROLLOVER_NS
        self.reference_ns = gps_ns
        return gps_ns

    def in_its_age(self, gps_ns: int) -> int:
        """Move a GPS time by rollovers of the week to when there were receivers like this one."""
        while self.modern and gps_ns < _MODERN_NS:
            gps_ns += ROLLOVER_NS
        return gps_ns

    def near(self, tow_ns: int) -> int | None:
        """The instant of time of week `tow_ns` nearest to the last known one."""
        if self.reference_ns is None or tow_ns >= WEEK_NS:
            return None
        return _nearest(tow_ns, self.reference_ns)

    def _of_solution(self, fields: dict[str, Any]) -> int | None:
        """Week from the UTC date, fraction of a millisecond from nano."""
        itow_ns = fields["iTOW"] * MS
        utc = solution_utc_ns(fields)
        if itow_ns >= WEEK_NS:
            return None
        if utc == 0:
            return self.near(itow_ns)
        about_ns = utc - GPS_EPOCH_UNIX_S * S  # wrong by the leap seconds, which cannot matter
        gps_ns = _nearest(itow_ns, about_ns)
        fraction_ns = (fields["nano"] - gps_ns + S // 2) % S - S // 2
        return gps_ns + fraction_ns if abs(fraction_ns) <= MS else gps_ns

    def _of_timeutc(self, fields: dict[str, Any]) -> int | None:
        itow_ns, utc = fields["iTOW"] * MS, solution_utc_ns(fields, _VALID_UTC)
        if utc == 0 or itow_ns >= WEEK_NS:
            return self.near(itow_ns)
        return _nearest(itow_ns, utc - GPS_EPOCH_UNIX_S * S)

    def _of_sol(self, fields: dict[str, Any]) -> int | None:
        """NAV-SOL of receivers before NAV-PVT; its flags tell week and time of week apart."""
        flags, week = fields["flags"], fields["week"]
        tow_ns = fields["iTOW"] * MS + (fields["fTOW"] if abs(fields["fTOW"]) <= MS else 0)
        if not flags & 8 or fields["iTOW"] * MS >= WEEK_NS:
            return None
        if not flags & 4 or not 0 < week <= _LAST_WEEK:
            return self.near(tow_ns)
        return int(week * WEEK_NS + tow_ns)

    def _of_timegps(self, fields: dict[str, Any]) -> int | None:
        valid, week = fields["valid"], fields["week"]
        if valid & 4:
            self.leap_seconds = fields["leapS"]
        tow_ns = fields["iTOW"] * MS + (fields["fTOW"] if abs(fields["fTOW"]) <= MS else 0)
        if not valid & 1 or fields["iTOW"] * MS >= WEEK_NS:
            return None
        if not valid & 2 or not 0 < week <= _LAST_WEEK:
            return self.near(tow_ns)
        return int(week * WEEK_NS + tow_ns)

    def _of_rawx(self, fields: dict[str, Any]) -> int | None:
        if fields["recStat"] & 1:
            self.leap_seconds = fields["leapS"]
        tow_s, week = fields["rcvTow"], fields["week"]
        if not (math.isfinite(tow_s) and 0 <= tow_s < 604_800) or not 0 < week <= _LAST_WEEK:
            return None
        return int(week * WEEK_NS + round(tow_s * 1e9))


_VALID_DATE_AND_TIME = 3
_VALID_UTC = 4


def solution_utc_ns(fields: dict[str, Any], wanted: int = _VALID_DATE_AND_TIME) -> int:
    """UTC of NAV-PVT, NAV-PVAT, HNR-PVT or NAV-TIMEUTC; 0 unless the bits `wanted` are valid.

    Nor is it UTC before `FIRST_DAY`.
    """
    if fields["valid"] & wanted != wanted:
        return 0
    utc = utc_ns(
        fields["year"], fields["month"], fields["day"],
        fields["hour"], fields["min"], fields["sec"], fields["nano"],
    )  # fmt: skip
    return utc if utc >= _FIRST_NS + GPS_EPOCH_UNIX_S * S else 0


_WHOLE_TIMES = {
    "NAV-PVT": GpsTimeline._of_solution,
    "NAV-PVAT": GpsTimeline._of_solution,
    "HNR-PVT": GpsTimeline._of_solution,
    "NAV-TIMEGPS": GpsTimeline._of_timegps,
    "NAV-TIMEUTC": GpsTimeline._of_timeutc,
    "NAV-SOL": GpsTimeline._of_sol,
    "RXM-RAWX": GpsTimeline._of_rawx,
}
"""Messages that may know the week."""


def _nearest(tow_ns: int, about_ns: int) -> int:
    weeks = (about_ns - tow_ns + WEEK_NS // 2) // WEEK_NS
    return weeks * WEEK_NS + tow_ns


@dataclass
class ArrivalMemory:
    """What an `ArrivalClock` remembers."""

    fit: FitMemory = field(default_factory=FitMemory)
    newest_ns: int | None = None


class ArrivalClock:
    """Device time to vehicle clock, from when messages arrive.

    The line time is that of the message itself, 10 bits a byte: what the receiver sent before it in
    the same burst is not known to belong to the epoch, and counts as waiting. Of each epoch only
    the message that comes first is added, because it waited least.
    """

    LONGEST_DELAY_NS = 5 * S
    """Nothing waits longer on its way: a port's buffer holds less. Beyond it, and where an epoch
    would lie after its own arrival, the device's time has jumped and is not used until the fit has
    restarted."""
    REORDERED_NS = 2 * S
    """An epoch this much older than the newest is not an earlier one that comes late (NAV-PVT after
    HNR-PVT), but a jump."""

    def __init__(
        self, receiver_delay_s: float, baud_rate: int, memory: ArrivalMemory | None = None
    ) -> None:
        self.memory = ArrivalMemory() if memory is None else memory
        self.fit = ClockFit(memory=self.memory.fit)
        self._delay_ns = round(receiver_delay_s * S)
        self._byte_ns = 10 * S / baud_rate

    def add(self, device_ns: int, arrival_ns: int, size: int) -> None:
        """Take note that a message of `size` bytes of epoch `device_ns` arrived."""
        newest_ns = self.memory.newest_ns
        if newest_ns is not None and newest_ns - self.REORDERED_NS < device_ns <= newest_ns + MS:
            return  # not the first of its epoch; 1 ms: a fraction may follow a whole millisecond
        self.memory.newest_ns = device_ns
        self.fit.add(device_ns, arrival_ns - self._delay_ns - round(size * self._byte_ns))

    def stamp(self, device_ns: int | None, arrival_ns: int) -> int:
        """Vehicle clock at `device_ns`; if that is unknown, arrival less the receiver's delay."""
        if device_ns is not None and self.fit.ready:
            host_ns = self.fit.host_ns(device_ns)
            if arrival_ns - self.LONGEST_DELAY_NS <= host_ns <= arrival_ns:
                return in_range(host_ns)
        return in_range(arrival_ns - self._delay_ns)


def in_range(stamp_ns: int) -> int:
    """The nearest stamp that a message can hold."""
    return min(max(stamp_ns, 0), _LATEST_NS)
