"""NMEA sentences to position fixes, for receivers that speak nothing better.

An epoch is what carries the same time of day: GGA or GNS (position, quality, height), RMC (date,
speed, course, position), GLL (position), GST (deviations), ZDA (date), and the untimed GSA and VTG
that follow one of these; where it ends says `epochs.py`. Of several positions that of GGA or GNS
counts, then RMC's, then GLL's, which is heeded only where it is the first. GST and ZDA begin no
epoch: where their time is that of the next one they belong to that.

What a receiver does not say is not made up. The altitude of GGA is above the geoid: without the
separation the ellipsoidal height stays absent, and without an altitude the fix is one of two
dimensions. A dilution that no constellation can have, and a place at exactly 0° 0°, are what
receivers send that know none. A date counts once the receiver vouches for its position: before, it
is the day that its clock was built or that the week's counter began with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream.bridges.gnss.clock import FIRST_DAY, is_nowhere
from tramstream.bridges.gnss.epochs import EndOfEpoch
from tramstream.bridges.gnss.nmea_sentences import TIMED, Sentence
from tramstream.clock import S
from tramstream.proto.gnss_pb2 import GnssFix

MPS_PER_KNOT = 1852 / 3600
RANGE_STD_M = 5.0
"""User range error by which the dilution is multiplied where no GST tells deviations: the single
frequency civil user's, 1 σ (GPS SPS Performance Standard, 5th edition, appendix A, rounded up)."""
VERTICAL_PER_HORIZONTAL = 1.5
"""Vertical over horizontal dilution where no GSA tells it, open sky."""
LEAST_DILUTION = 0.3
"""A smaller one states nothing: with 40 satellites all over the sky the horizontal one is 0.4."""

NO_COURSE_STD_DEG = 180.0
"""Of a course that a receiver leaves empty, as u-blox does below a speed: any is as likely."""

_DAY_NS = 86_400 * S
_UNIX_DAY = 719_163
"""Ordinal of 1970-01-01."""
_FIXED, _FLOAT, _ESTIMATED, _DIFFERENTIAL = 4, 5, 6, 2
_SATELLITE_FIX = range(1, 6)
"""GGA quality: 1 single, 2 differential, 3 PPS, 4 RTK fixed, 5 RTK float; 6 is estimated."""
_MODES = {
    "A": (1, GnssFix.AUTONOMOUS), "D": (2, GnssFix.DIFFERENTIAL), "P": (3, GnssFix.PRECISE),
    "R": (_FIXED, GnssFix.RTK_FIXED), "F": (_FLOAT, GnssFix.RTK_FLOAT),
    "E": (_ESTIMATED, GnssFix.ESTIMATED), "M": (0, GnssFix.MANUAL),
    "S": (0, GnssFix.SIMULATED), "N": (0, GnssFix.NOT_VALID),
}  # fmt: skip
"""FAA mode indicator: the quality that GGA would tell, and its name."""
_BEST_FIRST = "RFPDAEMSN"
"""Modes of GNS, one letter a system: the best counts."""
_PLACE_RANKS = {"GGA": 3, "GNS": 3, "RMC": 2, "GLL": 1}


@dataclass
class Epoch:
    """What the sentences of one epoch said; NaN where they said nothing."""

    time_of_day_ns: int
    first_arrival_ns: int
    first_size: int
    last_arrival_ns: int
    date: int = 0
    """Ordinal of the UTC date, 0 if not told."""
    days: int = 1
    """Midnights since the stream began, where no date is told; one more, so that no time is 0."""
    quality: int = 0
    mode: str = ""
    """FAA mode indicator, one letter."""
    place_rank: int = 0
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
    age_s: float = math.nan
    station: int = -1
    """Reference station of the corrections, -1 if not told."""
    std_m: list[float] = field(default_factory=list)
    """Deviations in latitude, longitude and altitude, from GST."""
    warning: bool = False
    """RMC or GLL says that the position is not valid."""

    def take(self, sentence: Sentence) -> None:
        """Add what `sentence` says."""
        kind, values = sentence.type, sentence.values
        if kind in _PLACE_RANKS:
            self._take_position(sentence)
        if kind == "RMC":
            self.speed_mps = values.get("speed_kn", math.nan) * MPS_PER_KNOT
            self.course_deg = values.get("course_deg", math.nan)
            self.date = self.date or round(values.get("date", 0))
        elif kind == "VTG" and math.isnan(self.speed_mps):
            speed_kmph = values.get("speed_kmph", math.nan) / 3.6
            speed_kn = values.get("speed_kn", math.nan) * MPS_PER_KNOT
            self.speed_mps = speed_kn if math.isfinite(speed_kn) else speed_kmph
            self.course_deg = values.get("course_deg", math.nan)
        elif kind == "GST":
            names = ("latitude_std_m", "longitude_std_m", "altitude_std_m")
            self.std_m = [values.get(name, math.nan) for name in names]
        elif kind == "GSA":
            self.pdop = values.get("pdop", math.nan)
            self.vdop = values.get("vdop", math.nan)
            if math.isnan(self.hdop):
                self.hdop = values.get("hdop", math.nan)
            self.dimensions = 2 if values.get("dimensions") == 2 else 3
        elif kind == "ZDA":
            self.date = self.date or round(values.get("date", 0))

    def _take_position(self, sentence: Sentence) -> None:
        kind, values = sentence.type, sentence.values
        told = sentence.letters.get("modes", "")
        letter = next((each for each in _BEST_FIRST if each in told), "")
        quality = _MODES[letter][0] if letter else 1
        self.mode = self.mode or letter
        if kind in ("RMC", "GLL"):
            void = sentence.letters.get("status", "A") != "A" or letter == "N"
            self.warning = self.warning or void
            quality = 0 if void else quality
        elif kind == "GGA":
            stated = values.get("quality", 0.0)
            quality = int(stated) if stated in (*_SATELLITE_FIX, _ESTIMATED) else 0
        rank = _PLACE_RANKS[kind]
        if rank < self.place_rank:
            return
        self.place_rank = rank
        self.quality = quality
        self.latitude_deg = values.get("latitude_deg", math.nan)
        self.longitude_deg = values.get("longitude_deg", math.nan)
        if rank < _PLACE_RANKS["GGA"]:
            return
        self.altitude_m = values.get("altitude_m", math.nan)
        self.separation_m = values.get("separation_m", math.nan)
        self.hdop = values.get("hdop", math.nan)
        self.age_s = values.get("age_s", math.nan)
        self.station = round(values.get("station", -1))
        satellites = values.get("satellites", 0.0)
        self.satellites = int(satellites) if 0 <= satellites <= 255 else 0

    @property
    def vouched(self) -> bool:
        """Whether the receiver itself says that it knows where it is."""
        return self.quality > 0 and not self.warning

    @property
    def utc_ns(self) -> int:
        """UTC in Unix nanoseconds; with no date known, as if the stream began on 1970-01-02."""
        days = self.date - _UNIX_DAY if self.date else self.days
        return days * _DAY_NS + self.time_of_day_ns


def fix_of(epoch: Epoch, max_accuracy_m: float) -> GnssFix:
    """Make the fix of a complete epoch; velocity components and speed's deviation stay unknown."""
    fix = GnssFix(source="NMEA", satellites_used=epoch.satellites)
    fix.fix_type = _fix_type(epoch)
    if epoch.mode:
        fix.faa_mode = _MODES[epoch.mode][1]
    fix.differential = epoch.quality in (_DIFFERENTIAL, _FIXED, _FLOAT)
    if epoch.quality in (_FIXED, _FLOAT):
        fix.carrier = GnssFix.FIXED if epoch.quality == _FIXED else GnssFix.FLOAT
    known = abs(epoch.latitude_deg) <= 90 and abs(epoch.longitude_deg) <= 180
    known = known and not is_nowhere(epoch.latitude_deg, epoch.longitude_deg)
    fix.invalid_llh = not known
    if known:
        fix.latitude_deg, fix.longitude_deg = epoch.latitude_deg, epoch.longitude_deg
        if math.isfinite(epoch.altitude_m):
            fix.height_msl_m = epoch.altitude_m
            if math.isfinite(epoch.separation_m):
                fix.height_ellipsoid_m = epoch.altitude_m + epoch.separation_m
    fix.horizontal_std_m, fix.vertical_std_m = _deviations(epoch)
    fix.speed_mps, fix.course_deg = _known(epoch.speed_mps), _known(epoch.course_deg)
    if not math.isfinite(epoch.course_deg):
        fix.course_std_deg = NO_COURSE_STD_DEG
    fix.pdop = _known(epoch.pdop)
    if math.isfinite(epoch.age_s):
        fix.correction_age_s = epoch.age_s
    if fix.differential and epoch.station >= 0:
        fix.reference_station = epoch.station
    fix.valid = (
        known
        and not epoch.warning
        and epoch.quality in _SATELLITE_FIX
        and fix.horizontal_std_m <= max_accuracy_m
    )
    return fix


def _fix_type(epoch: Epoch) -> GnssFix.FixType:
    if epoch.quality == _ESTIMATED:
        return GnssFix.DEAD_RECKONING
    if epoch.quality not in _SATELLITE_FIX:
        return GnssFix.NO_FIX
    flat = epoch.dimensions == 2 or not math.isfinite(epoch.altitude_m)
    return GnssFix.FIX_2D if flat else GnssFix.FIX_3D


def _deviations(epoch: Epoch) -> tuple[float, float]:
    """Horizontal and vertical deviation, m: from GST, else dilution times `RANGE_STD_M`; 0: none.

    A dilution that cannot be states nothing.
    """
    horizontal = _stated(epoch.hdop) * RANGE_STD_M
    vertical = _stated(epoch.vdop) * RANGE_STD_M or horizontal * VERTICAL_PER_HORIZONTAL
    if len(epoch.std_m) == 3:
        across = math.hypot(epoch.std_m[0], epoch.std_m[1])
        if math.isfinite(across) and across > 0.0:
            horizontal = across
            up = epoch.std_m[2]
            vertical = up if math.isfinite(up) and up > 0.0 else across * VERTICAL_PER_HORIZONTAL
    return horizontal, vertical if math.isfinite(epoch.altitude_m) else 0.0


@dataclass
class EpochAssembler:
    """Sentences in, complete epochs out; see the head of the module. It is its own memory."""

    _epoch: Epoch | None = None
    _end: EndOfEpoch = field(default_factory=EndOfEpoch)
    _early: dict[str, Sentence] = field(default_factory=dict)
    """GST and ZDA of another time than that of the epoch under way."""
    _date: int = 0
    _days: int = 1
    _time_ns: int = 0
    """Time of day of the last complete epoch."""

    def feed(self, sentence: Sentence, arrival_ns: int, size: int) -> list[Epoch]:
        """Take a sentence, return the epoch or epochs it completes."""
        out: list[Epoch] = []
        kind, time_ns = sentence.type, sentence.time_ns
        if kind in TIMED:
            if time_ns is None:
                return out  # the receiver does not know the time yet
            same = self._epoch is not None and self._epoch.time_of_day_ns == time_ns
            if not same and kind not in _PLACE_RANKS:
                self._early[kind] = sentence
                return out
            if same and kind == "GLL":
                return out  # it says the same again
            if not same:
                out += self._begin(time_ns, arrival_ns, size)
        if self._epoch is None or not self._end.room():
            return out  # an untimed sentence before the first timed one, or a stuck clock
        last = self._end.note(kind)
        if not self._end.complete:
            self._epoch.take(sentence)
            self._epoch.last_arrival_ns = arrival_ns
            if last:
                out += self.flush()
        return out

    def _begin(self, time_ns: int, arrival_ns: int, size: int) -> list[Epoch]:
        """Begin another epoch; returns the one before, if it was not complete."""
        out = self.flush()
        self._epoch = Epoch(time_ns, arrival_ns, size, arrival_ns)
        self._end.begin()
        for each in self._early.values():
            told_ns = time_ns if each.time_ns is None else each.time_ns
            if told_ns == time_ns or (each.type == "ZDA" and told_ns < time_ns):
                self._epoch.take(each)
        self._early.clear()
        return out

    def flush(self) -> list[Epoch]:
        """Give out the epoch under way, if it was not given out before."""
        epoch = self._epoch
        if epoch is None or self._end.complete:
            return []
        self._end.complete = True
        self._settle_date(epoch)
        return [epoch]

    def _settle_date(self, epoch: Epoch) -> None:
        """Give an epoch without a date that of its predecessors, a day later after midnight."""
        told = epoch.date if epoch.date >= FIRST_DAY and (epoch.vouched or self._date) else 0
        rolled = epoch.time_of_day_ns < self._time_ns - _DAY_NS // 2
        self._days += rolled
        epoch.days = self._days
        epoch.date = told or (self._date + rolled if self._date else 0)
        self._date, self._time_ns = epoch.date, epoch.time_of_day_ns


def _stated(dilution: float) -> float:
    return dilution if dilution >= LEAST_DILUTION else 0.0


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0
