"""NMEA sentences to position fixes, for receivers that speak nothing better.

An epoch is what carries the same time of day: GGA or GNS (position, quality), RMC (date, speed,
course), GST (deviations), and the untimed GSA and VTG that follow one of these. It is complete with
the sentence that ended the epoch before (the second GSA, say), so that a fix does not wait for the
next one; the first epoch, and one whose last sentence was lost, ends where the next begins. What
comes after an epoch is complete teaches the next one's end and is otherwise left out.

Sentences are parsed by pynmeagps. The altitude of GGA is above the geoid; the ellipsoidal height
is altitude plus separation.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pynmeagps import NMEAReader
from pynmeagps.exceptions import (
    NMEAMessageError,
    NMEAParseError,
    NMEAStreamError,
    NMEATypeError,
)

from tramstream.bridges.gnss.clock import utc_ns
from tramstream.bridges.gnss.framer import Frame, Rejected
from tramstream.clock import S
from tramstream.proto.gnss_pb2 import GnssFix

TIMED = ("GGA", "GNS", "RMC", "GST", "ZDA")
UNTIMED = ("GSA", "VTG")

MPS_PER_KNOT = 1852 / 3600
RANGE_STD_M = 5.0
"""User range error by which the dilution is multiplied where no GST tells deviations: the single
frequency civil user's, 1 σ (GPS SPS Performance Standard, 5th edition, appendix A, rounded up)."""
VERTICAL_PER_HORIZONTAL = 1.5
"""Vertical over horizontal dilution where no GSA tells it, open sky."""

NO_COURSE_STD_DEG = 180.0
"""Of a course that a receiver leaves empty, as u-blox does below a speed: any is as likely."""

_DAY_NS = 86_400 * S
_UNIX_DAY = 719_163
"""Ordinal of 1970-01-01."""
_MOST_SENTENCES = 64
"""Sentences of interest that one epoch can have; a time that stands still must not fill memory."""
_FIXED, _FLOAT, _ESTIMATED, _DIFFERENTIAL = 4, 5, 6, 2
_SATELLITE_FIX = range(1, 6)
"""GGA quality: 1 single, 2 differential, 3 PPS, 4 RTK fixed, 5 RTK float; 6 is estimated."""
_GNS_QUALITY = {"A": 1, "D": 2, "P": 3, "R": _FIXED, "F": _FLOAT, "E": _ESTIMATED}


class Sentence(NamedTuple):
    """One parsed sentence of interest: three-letter type and values by pynmeagps' names."""

    type: str
    values: dict[str, Any]


def sentence_type(frame: Frame) -> str:
    """GGA of `$GNGGA`; empty for a proprietary one."""
    address = frame.name
    return "" if address.startswith("P") else address[-3:]


def parse(frame: Frame) -> Sentence | Rejected:
    """Parse one NMEA frame of the types in `TIMED` and `UNTIMED`."""
    try:
        message = NMEAReader.parse(frame.raw)
    except (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError):
        message = None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        message = None  # the parser's own trouble with a sentence of the wrong shape
    if message is None or message.msgID != sentence_type(frame):
        return Rejected("NMEA not understood", frame.start, len(frame.raw))
    values = {name: value for name, value in vars(message).items() if not name.startswith("_")}
    if message.msgID in TIMED and not isinstance(values.get("time"), datetime.time):
        return Rejected("NMEA without time", frame.start, len(frame.raw))
    return Sentence(message.msgID, values)


@dataclass
class Epoch:
    """What the sentences of one epoch said; NaN where they said nothing."""

    time_of_day_ns: int
    first_arrival_ns: int
    first_size: int
    last_arrival_ns: int
    date: int = 0
    """Ordinal of the UTC date, 0 if not told."""
    quality: int = 0
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan
    altitude_m: float = math.nan
    separation_m: float = math.nan
    satellites: int = 0
    hdop: float = math.nan
    vdop: float = math.nan
    pdop: float = math.nan
    dimensions: int = 3
    speed_mps: float = math.nan
    course_deg: float = math.nan
    std_m: list[float] = field(default_factory=list)
    """Deviations in latitude, longitude and altitude, from GST."""
    warning: bool = False
    """RMC says that the position is not valid."""

    def take(self, sentence: Sentence) -> None:
        """Add what `sentence` says."""
        values = sentence.values
        if sentence.type in ("GGA", "GNS"):
            self._take_position(values)
        elif sentence.type == "RMC":
            self.warning = values.get("status") != "A"
            self.speed_mps = _number(values, "spd") * MPS_PER_KNOT
            self.course_deg = _number(values, "cog")
            if isinstance(values.get("date"), datetime.date):
                self.date = values["date"].toordinal()
        elif sentence.type == "VTG" and math.isnan(self.speed_mps):
            self.speed_mps = _number(values, "sogn") * MPS_PER_KNOT
            self.course_deg = _number(values, "cogt")
        elif sentence.type == "GST":
            self.std_m = [_number(values, name) for name in ("stdLat", "stdLong", "stdAlt")]
        elif sentence.type == "GSA":
            self.pdop, self.vdop = _number(values, "PDOP"), _number(values, "VDOP")
            self.dimensions = 2 if values.get("navMode") == 2 else 3
        elif sentence.type == "ZDA":
            year, month, day = (_number(values, name) for name in ("year", "month", "day"))
            if math.isfinite(year + month + day):
                midnight_ns = utc_ns(int(year), int(month), int(day), 0, 0, 0, 0)
                self.date = midnight_ns // _DAY_NS + _UNIX_DAY if midnight_ns else 0

    def _take_position(self, values: dict[str, Any]) -> None:
        if "quality" in values:
            quality = _number(values, "quality")
            self.quality = int(quality) if quality in (*_SATELLITE_FIX, _ESTIMATED) else 0
        else:  # GNS: one letter a system, the best counts
            known = [_GNS_QUALITY.get(letter, 0) for letter in str(values.get("posMode", ""))]
            self.quality = max((q for q in known if q != _ESTIMATED), default=0) or max(
                known or [0]
            )
        self.latitude_deg = _number(values, "lat")
        self.longitude_deg = _number(values, "lon")
        self.altitude_m = _number(values, "alt")
        self.separation_m = _number(values, "sep")
        self.hdop = _number(values, "HDOP")
        satellites = _number(values, "numSV")
        self.satellites = int(satellites) if 0 <= satellites <= 255 else 0

    @property
    def utc_ns(self) -> int:
        """UTC in Unix nanoseconds; with no date known, nanoseconds of 1970-01-01."""
        return ((self.date or _UNIX_DAY) - _UNIX_DAY) * _DAY_NS + self.time_of_day_ns


def fix_of(epoch: Epoch, max_accuracy_m: float) -> GnssFix:
    """Make the fix of a complete epoch; velocity components and speed's deviation stay unknown."""
    fix = GnssFix(source="NMEA", satellites_used=epoch.satellites)
    fix.fix_type = _fix_type(epoch)
    fix.differential = epoch.quality in (_DIFFERENTIAL, _FIXED, _FLOAT)
    if epoch.quality in (_FIXED, _FLOAT):
        fix.carrier = GnssFix.FIXED if epoch.quality == _FIXED else GnssFix.FLOAT
    known = abs(epoch.latitude_deg) <= 90 and abs(epoch.longitude_deg) <= 180
    fix.invalid_llh = not known
    if known:
        fix.latitude_deg, fix.longitude_deg = epoch.latitude_deg, epoch.longitude_deg
        fix.height_msl_m = _known(epoch.altitude_m)
        fix.height_ellipsoid_m = _known(epoch.altitude_m) + _known(epoch.separation_m)
    fix.horizontal_std_m, fix.vertical_std_m = _deviations(epoch)
    fix.speed_mps, fix.course_deg = _known(epoch.speed_mps), _known(epoch.course_deg)
    if not math.isfinite(epoch.course_deg):
        fix.course_std_deg = NO_COURSE_STD_DEG
    fix.pdop = _known(epoch.pdop)
    fix.valid = (
        known
        and not epoch.warning
        and epoch.quality in _SATELLITE_FIX
        and 0 < fix.horizontal_std_m <= max_accuracy_m
        and math.isfinite(fix.height_ellipsoid_m)
    )
    return fix


def _fix_type(epoch: Epoch) -> GnssFix.FixType:
    if epoch.quality == _ESTIMATED:
        return GnssFix.DEAD_RECKONING
    if epoch.quality not in _SATELLITE_FIX:
        return GnssFix.NO_FIX
    return GnssFix.FIX_2D if epoch.dimensions == 2 else GnssFix.FIX_3D


def _deviations(epoch: Epoch) -> tuple[float, float]:
    """Horizontal and vertical deviation, m: from GST, else dilution times `RANGE_STD_M`."""
    if len(epoch.std_m) == 3 and all(map(math.isfinite, epoch.std_m)):
        return math.hypot(epoch.std_m[0], epoch.std_m[1]), epoch.std_m[2]
    horizontal_m = _known(epoch.hdop) * RANGE_STD_M
    vertical = epoch.vdop if math.isfinite(epoch.vdop) else epoch.hdop * VERTICAL_PER_HORIZONTAL
    return horizontal_m, _known(vertical) * RANGE_STD_M


@dataclass
class EpochAssembler:
    """Sentences in, complete epochs out; see the head of the module. It is its own memory."""

    _epoch: Epoch | None = None
    _complete: bool = False
    _seen: list[str] = field(default_factory=list)
    """Types of the epoch under way, in order."""
    _end: list[str] = field(default_factory=list)
    """Those of the epoch before."""
    _date: int = 0
    _date_time_ns: int = 0

    def feed(self, sentence: Sentence, arrival_ns: int, size: int) -> list[Epoch]:
        """Take a sentence, return the epoch or epochs it completes."""
        out: list[Epoch] = []
        kind = sentence.type
        if kind in TIMED:
            time_ns = _time_of_day_ns(sentence.values["time"])
            if self._epoch is None or self._epoch.time_of_day_ns != time_ns:
                out += self.flush()
                self._epoch = Epoch(time_ns, arrival_ns, size, arrival_ns)
                self._complete = False
                self._seen, self._end = [], self._seen
        if self._epoch is None or len(self._seen) >= _MOST_SENTENCES:
            return out  # an untimed sentence before the first timed one, or a stuck clock
        self._seen.append(kind)
        if not self._complete:
            self._epoch.take(sentence)
            self._epoch.last_arrival_ns = arrival_ns
            last = self._end[-1] if self._end else ""
            if kind == last and self._seen.count(kind) == self._end.count(kind):
                out += self.flush()
        return out

    def flush(self) -> list[Epoch]:
        """Give out the epoch under way, if it was not given out before."""
        epoch = self._epoch
        if epoch is None or self._complete:
            return []
        self._complete = True
        self._keep_date(epoch)
        return [epoch]

    def _keep_date(self, epoch: Epoch) -> None:
        """Give an epoch without a date that of its predecessors, a day later after midnight."""
        if epoch.date == 0 and self._date:
            rolled = epoch.time_of_day_ns < self._date_time_ns - _DAY_NS // 2
            epoch.date = self._date + rolled
        self._date, self._date_time_ns = epoch.date, epoch.time_of_day_ns


def _time_of_day_ns(time: datetime.time) -> int:
    seconds = time.hour * 3600 + time.minute * 60 + time.second
    return seconds * S + time.microsecond * 1000


def _number(values: dict[str, Any], name: str) -> float:
    """The number called `name`; NaN for what is empty or no number."""
    value = values.get(name)
    return float(value) if isinstance(value, (int, float)) else math.nan


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0
