"""NMEA sentences to their values: tables of what stands where, as NMEA 0183 and receivers have it.

A sentence may be shorter than its table: earlier versions of the standard had fewer fields. It may
be longer: later ones will have more. A field that is empty says nothing. One that holds what
cannot stand there makes the sentence worthless, for its checksum was made after the damage.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from tramstream.bridges.gnss.clock import utc_ns
from tramstream.bridges.gnss.framer import Frame, Rejected
from tramstream.clock import S

TIMED = ("GGA", "GNS", "RMC", "GLL", "GST", "ZDA")
UNTIMED = ("GSA", "VTG")

_DAY_S = 86_400
_UNIX_DAY = 719_163
"""Ordinal of 1970-01-01."""
_FIRST_OF_1900S = 80
"""Years of two digits from this on are of the twentieth century: GPS time began in 1980."""
_LONGEST_NUMBER = 24
"""Characters of a number; no receiver tells more digits, and a float would not hold them."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)", re.ASCII)
_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{0,9})\d*)?", re.ASCII)


class Sentence(NamedTuple):
    """One sentence of interest: three-letter type, time of day, what else it tells.

    `time_ns` is None where the receiver left the time empty, as it does before it knows it.
    `values` has no entry for an empty field.
    """

    type: str
    time_ns: int | None
    values: dict[str, float]
    letters: dict[str, str]


class _MalformedError(ValueError):
    """A field that holds what cannot stand there."""


def sentence_type(frame: Frame) -> str:
    """GGA of `$GNGGA`; empty for a proprietary one."""
    address = frame.name
    return "" if address.startswith("P") or len(address) < 5 else address[-3:]


def parse(frame: Frame) -> Sentence | Rejected:
    """Parse one NMEA frame of the types in `TIMED` and `UNTIMED`."""
    kind = sentence_type(frame)
    table = _TABLES.get(kind)
    words = [word.strip() for word in frame.payload.decode("ascii").split(",")]
    if table is None or len(words) < table.fewest:
        return Rejected("NMEA not understood", frame.start, len(frame.raw))
    values: dict[str, float] = {}
    letters: dict[str, str] = {}
    try:
        for name, at, read in table.fields:
            text = words[at] if at < len(words) else ""
            if text and math.isfinite(value := read(text)):
                values[name] = value
        for name, at in table.letters:
            if at < len(words) and words[at]:
                letters[name] = words[at].upper()
        for name, at in table.places:
            _place(name, words[at : at + 2], values)
        if kind == "ZDA":
            _date_of_zda(words, values)
    except _MalformedError:
        return Rejected("NMEA not understood", frame.start, len(frame.raw))
    time = values.pop("time", None)
    return Sentence(kind, None if time is None else round(time), values, letters)


# Fields -------------------------------------------------------------------------------------------
def _number(text: str) -> float:
    if len(text) > _LONGEST_NUMBER or not _NUMBER.fullmatch(text):
        raise _MalformedError(text)
    return float(text)


def _count(text: str) -> float:
    """A number that the receiver pads or marks as it likes: what is none says nothing."""
    return _number(text) if text.isdigit() else math.nan


def _time(text: str) -> float:
    """Time of day, ns; a leap second's 60 counts on into the next minute."""
    found = _TIME.fullmatch(text)
    if found is None:
        raise _MalformedError(text)
    hour, minute, second = (int(found.group(part)) for part in (1, 2, 3))
    if hour > 23 or minute > 59 or second > 60:
        raise _MalformedError(text)
    return (hour * 3600 + minute * 60 + second) * S + int((found.group(4) or "").ljust(9, "0"))


def _day(text: str) -> float:
    """DDMMYY as the ordinal of a date.

    Firmware of which the weeks have overflown writes `2208-1`, and 000000 before it knows one: no
    date, and the place beside it is right all the same.
    """
    if not (text.isascii() and text.isdigit() and len(text) == 6):
        return math.nan
    day, month, year = int(text[:2]), int(text[2:4]), int(text[4:])
    return _ordinal(year + (1900 if year >= _FIRST_OF_1900S else 2000), month, day)


def _ordinal(year: int, month: int, day: int) -> float:
    midnight_ns = utc_ns(year, month, day, 0, 0, 0, 0)
    return midnight_ns // (_DAY_S * S) + _UNIX_DAY if midnight_ns else math.nan


def _date_of_zda(words: list[str], values: dict[str, float]) -> None:
    """The ordinal of a date in three fields; all of them, or none."""
    parts = words[2:5]
    if not any(parts):
        return
    if not all(part.isascii() and part.isdigit() and len(part) <= 4 for part in parts):
        raise _MalformedError(",".join(parts))
    day, month, year = map(int, parts)
    if day and month and year:
        values["date"] = _ordinal(year, month, day)
        if math.isnan(values["date"]):
            raise _MalformedError(",".join(parts))


def _place(name: str, words: list[str], values: dict[str, float]) -> None:
    """Degrees, minutes and a letter, `5004.53000,N`, as degrees."""
    if len(words) < 2 or not words[0]:
        return
    letters = "NS" if name == "latitude_deg" else "EW"
    angle, letter = words[0], words[1].upper()
    if _number(angle) < 0.0 or not letter or letter not in letters:
        raise _MalformedError(angle + letter)
    whole = len(angle.partition(".")[0])
    minutes = float(angle[max(whole - 2, 0) :])
    degrees = int(angle[: max(whole - 2, 0)] or "0")
    if minutes >= 60.0:
        raise _MalformedError(angle)
    value = degrees + minutes / 60.0
    values[name] = -value if letter in "SW" else value


class _Table(NamedTuple):
    fields: tuple[tuple[str, int, Callable[[str], float]], ...]
    places: tuple[tuple[str, int], ...] = ()
    letters: tuple[tuple[str, int], ...] = ()
    fewest: int = 2
    """Words there must be, the address among them."""


# NMEA 0183 version 4.11, section 6.3; u-blox F9 HPG 1.32 Interface Description, section 2.7.
_TABLES: dict[str, _Table] = {
    "GGA": _Table(
        (
            ("time", 1, _time), ("quality", 6, _number), ("satellites", 7, _count),
            ("hdop", 8, _number), ("altitude_m", 9, _number), ("separation_m", 11, _number),
            ("age_s", 13, _number), ("station", 14, _count),
        ),
        (("latitude_deg", 2), ("longitude_deg", 4)), fewest=7,
    ),
    "GNS": _Table(
        (
            ("time", 1, _time), ("satellites", 7, _count), ("hdop", 8, _number),
            ("altitude_m", 9, _number), ("separation_m", 10, _number), ("age_s", 11, _number),
            ("station", 12, _count),
        ),
        (("latitude_deg", 2), ("longitude_deg", 4)), (("modes", 6),), fewest=7,
    ),
    "RMC": _Table(
        (
            ("time", 1, _time), ("speed_kn", 7, _number), ("course_deg", 8, _number),
            ("date", 9, _day),
        ),
        (("latitude_deg", 3), ("longitude_deg", 5)), (("status", 2), ("modes", 12)), fewest=10,
    ),
    "GLL": _Table(
        (("time", 5, _time),), (("latitude_deg", 1), ("longitude_deg", 3)),
        (("status", 6), ("modes", 7)), fewest=6,
    ),
    "GST": _Table(
        (
            ("time", 1, _time), ("latitude_std_m", 6, _number), ("longitude_std_m", 7, _number),
            ("altitude_std_m", 8, _number),
        ),
        fewest=8,
    ),
    "ZDA": _Table((("time", 1, _time),), fewest=5),
    "GSA": _Table(
        (("dimensions", 2, _number), ("pdop", 15, _number), ("hdop", 16, _number),
         ("vdop", 17, _number)),
        fewest=16,
    ),
    "VTG": _Table(
        (("course_deg", 1, _number), ("speed_kn", 5, _number), ("speed_kmph", 7, _number)),
        (), (("modes", 9),), fewest=6,
    ),
}  # fmt: skip
"""Name of a value, its place, how it is read. RMC's status is a letter: A valid, V void."""
