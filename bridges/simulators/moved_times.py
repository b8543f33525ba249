"""A receiver's capture with its times moved on, so that repetitions of it make one long ride.

Moved are the time of week, the week and the date of UBX messages, and time of day and date of NMEA
sentences. What the tables of `bridges.gnss` do not know, the receiver's own counters and RTCM
(corrections on their way back, which nobody decodes here) stay as they were sent.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import reduce
from operator import xor
from typing import Any

from tramstream.bridges.gnss import ubx_layouts
from tramstream.bridges.gnss.framer import NMEA, UBX, Frame, Framer, ubx_frame
from tramstream.bridges.gnss.nmea_sentences import sentence_type

WEEK_S = 604_800
_DATE = ("year", "month", "day", "hour", "min", "sec")
_LEAP_SECOND = 60
_CENTURY = 2000
_CLOCK = {"GGA": 1, "GNS": 1, "RMC": 1, "GLL": 5, "GST": 1, "ZDA": 1, "GBS": 1, "GRS": 1}
"""Which field of a sentence is the time of day; 0 is the address."""
_RMC_DATE = 9
_ZDA_DAY = 2
_DAY_DIGITS = 6


def moved(capture: bytes, by_s: int) -> bytes:
    """Give a capture as its receiver would have sent it `by_s` later, at the same places.

    Each frame keeps its length, and what lies between frames is kept.
    """
    framer = Framer()
    made, at = [], 0
    for item in framer.feed(capture) + framer.flush():
        if isinstance(item, Frame):
            raw = item.raw
            if item.protocol == UBX:
                raw = _moved_ubx(item, by_s)
            elif item.protocol == NMEA:
                raw = _moved_nmea(item, by_s)
            made += [capture[at : item.start], raw]
            at = item.end + 1
    return b"".join([*made, capture[at:]])


def _moved_ubx(frame: Frame, by_s: int) -> bytes:
    payload = frame.payload
    forms = ubx_layouts.BY_KIND.get(frame.kind, ())
    layout = next((form for form in forms if form.fits(payload)), None)
    if layout is None:
        return frame.raw
    wire = dict(zip(layout.names, layout.fixed.unpack_from(payload), strict=True))
    for name, unit in (("iTOW", 1000), ("towMS", 1000), ("rcvTow", 1)):
        told = wire.get(name)
        if told is not None and 0 <= told < WEEK_S * unit:
            weeks, wire[name] = divmod(told + by_s * unit, WEEK_S * unit)
            if wire.get("week"):
                wire["week"] += int(weeks)
    if all(name in wire for name in _DATE) and wire["sec"] < _LEAP_SECOND:
        _move_date(wire, by_s)
    fixed = layout.fixed.pack(*wire.values())
    return ubx_frame(frame.kind, fixed + payload[len(fixed) :])


def _move_date(wire: dict[str, Any], by_s: int) -> None:
    """Move the UTC of a solution; one that is no date is left alone."""
    try:
        now = datetime(*(wire[name] for name in _DATE)) + timedelta(seconds=by_s)
    except (ValueError, OverflowError):
        return
    values = (now.year, now.month, now.day, now.hour, now.minute, now.second)
    wire.update(zip(_DATE, values, strict=True))


def _moved_nmea(frame: Frame, by_s: int) -> bytes:
    kind = sentence_type(frame)
    place = _CLOCK.get(kind)
    words = frame.payload.decode("ascii").split(",")
    if place is None or len(words) <= place or not words[place][:_DAY_DIGITS].isdigit():
        return frame.raw
    day = datetime(_CENTURY, 1, 2)
    clock = words[place]
    try:
        if kind == "RMC" and words[_RMC_DATE]:
            day = datetime.strptime(words[_RMC_DATE], "%d%m%y")
        elif kind == "ZDA" and words[_ZDA_DAY]:
            day = datetime.strptime("-".join(words[_ZDA_DAY : _ZDA_DAY + 3]), "%d-%m-%Y")
        now = datetime.combine(day, datetime.strptime(clock[:_DAY_DIGITS], "%H%M%S").time())
    except (ValueError, IndexError):
        return frame.raw
    now += timedelta(seconds=by_s)
    words[place] = now.strftime("%H%M%S") + clock[_DAY_DIGITS:]
    if kind == "RMC" and words[_RMC_DATE]:
        words[_RMC_DATE] = now.strftime("%d%m%y")
    elif kind == "ZDA" and words[_ZDA_DAY]:
        words[_ZDA_DAY : _ZDA_DAY + 3] = [f"{now.day:02d}", f"{now.month:02d}", f"{now.year:04d}"]
    body = ",".join(words).encode("ascii")
    behind = frame.raw.index(b"*")
    return frame.raw[:1] + body + b"*%02X" % reduce(xor, body, 0) + frame.raw[behind + 3 :]
