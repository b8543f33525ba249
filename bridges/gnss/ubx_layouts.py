"""Layouts of UBX messages as tables that mirror the manuals.

Sources: u-blox F9 HPS 1.30 and HPG 1.32 Interface Descriptions (UBX-22010984, UBX-22008968), and
for the HNR class u-blox 8/M8 Receiver Description (UBX-13003221), for what older receivers say
u-blox 5, 6 and 7 (GPS.G5-X-07036, GPS.G6-SW-10018, GPS.G7-SW-12001), each in its chapter on the UBX
protocol; each table stands under the name the manual gives the message. Little-endian.

Some messages have had several forms. A table that is not the newest says which in `form`, and a
payload is read by the form that its length, and where two have one length its version, tells.

A field is (name, type, scale, unit). Types: U unsigned, I signed, X bits, R float, C text, with the
number of bytes; `U1*9` is nine bytes kept as they are. A decoded value is the integer sent times
the scale, in the unit; scale 1 leaves integers alone. Reserved bytes are kept, so that encoding
what was decoded gives the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from struct import Struct
from typing import NamedTuple


class Field(NamedTuple):
    name: str
    type: str
    scale: float = 1.0
    unit: str = ""

    @property
    def divisor(self) -> float:
        """1 / scale: dividing by a whole number rounds the decimal fraction correctly."""
        inverse = 1.0 / self.scale
        return float(round(inverse)) if abs(inverse - round(inverse)) < 1e-6 * inverse else inverse


_CODES = {
    "U1": "B", "I1": "b", "X1": "B", "U2": "H", "I2": "h", "X2": "H",
    "U4": "I", "I4": "i", "X4": "I", "R4": "f", "R8": "d",
}  # fmt: skip


def _code(type_: str) -> str:
    if type_.startswith("C"):
        return f"{type_[1:]}s"
    base, _, repeat = type_.partition("*")
    return f"{repeat}s" if repeat else _CODES[base]


@dataclass(frozen=True)
class Layout:
    """One message: its fixed part, and the group that repeats to the end of the payload."""

    name: str
    message_class: int
    message_id: int
    fields: tuple[Field, ...]
    group: tuple[Field, ...] = ()
    count: str = ""
    """Field that holds the number of groups, where there is one."""
    longest: int = 0
    """Most groups the message can hold."""
    form: str = ""
    """Which one of several this is; empty for the newest."""
    version: int = -1
    """What the first byte of the payload holds, where it tells the form."""
    fixed: Struct = field(init=False)
    repeated: Struct = field(init=False)
    names: tuple[str, ...] = field(init=False)
    scaled: tuple[tuple[str, float], ...] = field(init=False)
    group_names: tuple[str, ...] = field(init=False)
    group_scaled: tuple[tuple[int, float], ...] = field(init=False)

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("fixed", Struct("<" + "".join(_code(f.type) for f in self.fields)))
        put("repeated", Struct("<" + "".join(_code(f.type) for f in self.group)))
        put("names", tuple(f.name for f in self.fields))
        put("scaled", tuple((f.name, f.divisor) for f in self.fields if f.scale != 1.0))
        put("group_names", tuple(f.name for f in self.group))
        put(
            "group_scaled",
            tuple((i, f.divisor) for i, f in enumerate(self.group) if f.scale != 1.0),
        )

    @property
    def kind(self) -> int:
        return self.message_class << 8 | self.message_id

    @property
    def title(self) -> str:
        """Name and form, as `BY_NAME` has it."""
        return f"{self.name} {self.form}".rstrip()

    def fits(self, payload: bytes) -> bool:
        """Whether a payload of this length may be of this form."""
        extra, step = len(payload) - self.fixed.size, self.repeated.size
        if extra < 0 or (extra % step if step else extra):
            return False
        return self.version < 0 or payload[0] == self.version

    @property
    def limit(self) -> Limit:
        count_at = -1
        if self.count:
            at = self.names.index(self.count)
            count_at = Struct("<" + "".join(_code(f.type) for f in self.fields[:at])).size
        step = self.repeated.size
        return Limit(self.fixed.size, step, self.fixed.size + step * self.longest, count_at)


class Limit(NamedTuple):
    """Lengths a payload may have: `fixed + n * step`, at most `longest`.

    `count_at` is where the payload tells n in one byte, -1 if nowhere.
    """

    fixed: int
    step: int
    longest: int
    count_at: int


ANY_LIMIT = Limit(0, 1, 8192, -1)
"""Of types without a table. The longest message a receiver sends by itself is RXM-RAWX with 255
measurements (8176 bytes); at 460800 baud 8 KiB pass in 0.18 s."""

F = Field
_ITOW = F("iTOW", "U4", 1, "ms")
_DATE = (
    F("year", "U2"), F("month", "U1"), F("day", "U1"), F("hour", "U1"), F("min", "U1"),
    F("sec", "U1"),
)  # fmt: skip
_LLH = (
    F("lon", "I4", 1e-7, "deg"), F("lat", "I4", 1e-7, "deg"), F("height", "I4", 1, "mm"),
    F("hMSL", "I4", 1, "mm"),
)  # fmt: skip
_ACCURACY = (F("hAcc", "U4", 1, "mm"), F("vAcc", "U4", 1, "mm"))
_ATTITUDE = (
    _ITOW, F("version", "U1"), F("reserved0", "U1*3"), F("roll", "I4", 1e-5, "deg"),
    F("pitch", "I4", 1e-5, "deg"), F("heading", "I4", 1e-5, "deg"),
    F("accRoll", "U4", 1e-5, "deg"), F("accPitch", "U4", 1e-5, "deg"),
    F("accHeading", "U4", 1e-5, "deg"),
)  # fmt: skip
_DYNAMICS = (
    F("bitfield0", "X4"), F("reserved0", "U1*4"), _ITOW, F("xAngRate", "I4", 1e-3, "deg/s"),
    F("yAngRate", "I4", 1e-3, "deg/s"), F("zAngRate", "I4", 1e-3, "deg/s"),
    F("xAccel", "I4", 1e-2, "m/s^2"), F("yAccel", "I4", 1e-2, "m/s^2"),
    F("zAccel", "I4", 1e-2, "m/s^2"),
)  # fmt: skip
_ANSWER = (F("clsID", "U1"), F("msgID", "U1"))
_PVT = (
    _ITOW, *_DATE, F("valid", "X1"), F("tAcc", "U4", 1, "ns"), F("nano", "I4", 1, "ns"),
    F("fixType", "U1"), F("flags", "X1"), F("flags2", "X1"), F("numSV", "U1"),
    *_LLH, *_ACCURACY, F("velN", "I4", 1, "mm/s"), F("velE", "I4", 1, "mm/s"),
    F("velD", "I4", 1, "mm/s"), F("gSpeed", "I4", 1, "mm/s"), F("headMot", "I4", 1e-5, "deg"),
    F("sAcc", "U4", 1, "mm/s"), F("headAcc", "U4", 1e-5, "deg"), F("pDOP", "U2", 1e-2),
    F("flags3", "X2"), F("reserved0", "U1*4"),
)  # fmt: skip
_POSITION_E = (
    F("ecefX", "I4", 1, "cm"), F("ecefY", "I4", 1, "cm"), F("ecefZ", "I4", 1, "cm"),
    F("pAcc", "U4", 1, "cm"),
)  # fmt: skip
_VELOCITY_E = (
    F("ecefVX", "I4", 1, "cm/s"), F("ecefVY", "I4", 1, "cm/s"), F("ecefVZ", "I4", 1, "cm/s"),
    F("sAcc", "U4", 1, "cm/s"),
)  # fmt: skip
_PINS = (F("pinSel", "X4"), F("pinBank", "X4"), F("pinDir", "X4"), F("pinVal", "X4"))
_HARDWARE = (
    F("noisePerMS", "U2"), F("agcCnt", "U2"), F("aStatus", "U1"), F("aPower", "U1"),
    F("flags", "X1"), F("reserved0", "U1"), F("usedMask", "X4"),
)  # fmt: skip
_INTERRUPTS = (
    F("jamInd", "U1"), F("reserved1", "U1*2"), F("pinIrq", "X4"), F("pullH", "X4"),
    F("pullL", "X4"),
)  # fmt: skip
_REL_POS = (
    F("relPosN", "I4", 1, "cm"), F("relPosE", "I4", 1, "cm"), F("relPosD", "I4", 1, "cm"),
)  # fmt: skip
_REL_POS_HP = (
    F("relPosHPN", "I1", 0.1, "mm"), F("relPosHPE", "I1", 0.1, "mm"),
    F("relPosHPD", "I1", 0.1, "mm"),
)  # fmt: skip
_REL_ACC = (
    F("accN", "U4", 0.1, "mm"), F("accE", "U4", 0.1, "mm"), F("accD", "U4", 0.1, "mm"),
)  # fmt: skip

LAYOUTS: tuple[Layout, ...] = (
    # UBX-ACK-NAK (0x05 0x00), UBX-ACK-ACK (0x05 0x01)
    Layout("ACK-NAK", 0x05, 0x00, _ANSWER),
    Layout("ACK-ACK", 0x05, 0x01, _ANSWER),
    # UBX-NAV-POSLLH (0x01 0x02): geodetic position solution
    Layout("NAV-POSLLH", 0x01, 0x02, (_ITOW, *_LLH, *_ACCURACY)),
    # UBX-NAV-ATT (0x01 0x05): attitude solution
    Layout("NAV-ATT", 0x01, 0x05, _ATTITUDE),
    # UBX-NAV-POSECEF (0x01 0x01): position solution in ECEF
    Layout("NAV-POSECEF", 0x01, 0x01, (_ITOW, *_POSITION_E)),
    # UBX-NAV-STATUS (0x01 0x03): receiver navigation status
    Layout("NAV-STATUS", 0x01, 0x03, (
        _ITOW, F("gpsFix", "U1"), F("flags", "X1"), F("fixStat", "X1"), F("flags2", "X1"),
        F("ttff", "U4", 1, "ms"), F("msss", "U4", 1, "ms"),
    )),
    # UBX-NAV-DOP (0x01 0x04): dilution of precision
    Layout("NAV-DOP", 0x01, 0x04, (
        _ITOW, *(F(f"{axis}DOP", "U2", 1e-2) for axis in "gptvhne"),
    )),
    # UBX-NAV-SOL (0x01 0x06): navigation solution information; u-blox 4 to 8
    Layout("NAV-SOL", 0x01, 0x06, (
        _ITOW, F("fTOW", "I4", 1, "ns"), F("week", "I2"), F("gpsFix", "U1"), F("flags", "X1"),
        *_POSITION_E, *_VELOCITY_E, F("pDOP", "U2", 1e-2), F("reserved0", "U1"), F("numSV", "U1"),
        F("reserved1", "U1*4"),
    )),
    # UBX-NAV-PVT (0x01 0x07): navigation position velocity time solution; 84 bytes on u-blox 7
    Layout("NAV-PVT", 0x01, 0x07, (
        *_PVT, F("headVeh", "I4", 1e-5, "deg"), F("magDec", "I2", 1e-2, "deg"),
        F("magAcc", "U2", 1e-2, "deg"),
    )),
    Layout("NAV-PVT", 0x01, 0x07, _PVT, form="u-blox 7"),
    # UBX-NAV-VELECEF (0x01 0x11), UBX-NAV-VELNED (0x01 0x12): velocity solution
    Layout("NAV-VELECEF", 0x01, 0x11, (_ITOW, *_VELOCITY_E)),
    Layout("NAV-VELNED", 0x01, 0x12, (
        _ITOW, F("velN", "I4", 1, "cm/s"), F("velE", "I4", 1, "cm/s"), F("velD", "I4", 1, "cm/s"),
        F("speed", "U4", 1, "cm/s"), F("gSpeed", "U4", 1, "cm/s"), F("heading", "I4", 1e-5, "deg"),
        F("sAcc", "U4", 1, "cm/s"), F("cAcc", "U4", 1e-5, "deg"),
    )),
    # UBX-NAV-HPPOSLLH (0x01 0x14): high precision geodetic position solution
    Layout("NAV-HPPOSLLH", 0x01, 0x14, (
        F("version", "U1"), F("reserved0", "U1*2"), F("flags", "X1"), _ITOW, *_LLH,
        F("lonHp", "I1", 1e-9, "deg"), F("latHp", "I1", 1e-9, "deg"),
        F("heightHp", "I1", 0.1, "mm"), F("hMSLHp", "I1", 0.1, "mm"),
        F("hAcc", "U4", 0.1, "mm"), F("vAcc", "U4", 0.1, "mm"),
    )),
    # UBX-NAV-PVAT (0x01 0x17): navigation position velocity attitude time solution
    Layout("NAV-PVAT", 0x01, 0x17, (
        _ITOW, F("version", "U1"), F("valid", "X1"), *_DATE, F("reserved0", "U1"),
        F("reserved1", "U1*2"), F("tAcc", "U4", 1, "ns"), F("nano", "I4", 1, "ns"),
        F("fixType", "U1"), F("flags", "X1"), F("flags2", "X1"), F("numSV", "U1"),
        *_LLH, *_ACCURACY, F("velN", "I4", 1, "mm/s"), F("velE", "I4", 1, "mm/s"),
        F("velD", "I4", 1, "mm/s"), F("gSpeed", "I4", 1, "mm/s"), F("sAcc", "U4", 1, "mm/s"),
        F("vehRoll", "I4", 1e-5, "deg"), F("vehPitch", "I4", 1e-5, "deg"),
        F("vehHeading", "I4", 1e-5, "deg"), F("motHeading", "I4", 1e-5, "deg"),
        F("accRoll", "U2", 1e-2, "deg"), F("accPitch", "U2", 1e-2, "deg"),
        F("accHeading", "U2", 1e-2, "deg"), F("magDec", "I2", 1e-2, "deg"),
        F("magAcc", "U2", 1e-2, "deg"), F("errEllipseOrient", "U2", 1e-2, "deg"),
        F("errEllipseMajor", "U4", 1, "mm"), F("errEllipseMinor", "U4", 1, "mm"),
        F("reserved2", "U1*4"), F("reserved3", "U1*4"),
    )),
    # UBX-NAV-TIMEGPS (0x01 0x20): GPS time solution
    Layout("NAV-TIMEGPS", 0x01, 0x20, (
        _ITOW, F("fTOW", "I4", 1, "ns"), F("week", "I2"), F("leapS", "I1", 1, "s"),
        F("valid", "X1"), F("tAcc", "U4", 1, "ns"),
    )),
    # UBX-NAV-TIMEUTC (0x01 0x21): UTC time solution
    Layout("NAV-TIMEUTC", 0x01, 0x21, (
        _ITOW, F("tAcc", "U4", 1, "ns"), F("nano", "I4", 1, "ns"), *_DATE, F("valid", "X1"),
    )),
    # UBX-NAV-CLOCK (0x01 0x22): clock solution
    Layout("NAV-CLOCK", 0x01, 0x22, (
        _ITOW, F("clkB", "I4", 1, "ns"), F("clkD", "I4", 1, "ns/s"), F("tAcc", "U4", 1, "ns"),
        F("fAcc", "U4", 1, "ps/s"),
    )),
    # UBX-NAV-TIMELS (0x01 0x26): leap second event information
    Layout("NAV-TIMELS", 0x01, 0x26, (
        _ITOW, F("version", "U1"), F("reserved0", "U1*3"), F("srcOfCurrLs", "U1"),
        F("currLs", "I1", 1, "s"), F("srcOfLsChange", "U1"), F("lsChange", "I1", 1, "s"),
        F("timeToLsEvent", "I4", 1, "s"), F("dateOfLsGpsWn", "U2"), F("dateOfLsGpsDn", "U2"),
        F("reserved1", "U1*3"), F("valid", "X1"),
    )),
    # UBX-NAV-SVINFO (0x01 0x30): space vehicle information; u-blox 4 to 8
    Layout(
        "NAV-SVINFO", 0x01, 0x30,
        (_ITOW, F("numCh", "U1"), F("globalFlags", "X1"), F("reserved0", "U1*2")),
        (
            F("chn", "U1"), F("svid", "U1"), F("flags", "X1"), F("quality", "X1"),
            F("cno", "U1", 1, "dBHz"), F("elev", "I1", 1, "deg"), F("azim", "I2", 1, "deg"),
            F("prRes", "I4", 1, "cm"),
        ),
        count="numCh", longest=255,
    ),
    # UBX-NAV-SAT (0x01 0x35): satellite information
    Layout(
        "NAV-SAT", 0x01, 0x35,
        (_ITOW, F("version", "U1"), F("numSvs", "U1"), F("reserved0", "U1*2")),
        (
            F("gnssId", "U1"), F("svId", "U1"), F("cno", "U1", 1, "dBHz"),
            F("elev", "I1", 1, "deg"), F("azim", "I2", 1, "deg"), F("prRes", "I2", 0.1, "m"),
            F("flags", "X4"),
        ),
        count="numSvs", longest=255,
    ),
    # UBX-NAV-COV (0x01 0x36): covariance matrices, north-east-down
    Layout("NAV-COV", 0x01, 0x36, (
        _ITOW, F("version", "U1"), F("posCovValid", "U1"), F("velCovValid", "U1"),
        F("reserved0", "U1*9"),
        *(F(f"posCov{axes}", "R4", 1, "m^2") for axes in ("NN", "NE", "ND", "EE", "ED", "DD")),
        *(F(f"velCov{axes}", "R4", 1, "m^2/s^2") for axes in ("NN", "NE", "ND", "EE", "ED", "DD")),
    )),
    # UBX-NAV-RELPOSNED (0x01 0x3c): relative positioning; 40 bytes on u-blox 8
    Layout("NAV-RELPOSNED", 0x01, 0x3C, (
        F("version", "U1"), F("reserved0", "U1"), F("refStationId", "U2"), _ITOW, *_REL_POS,
        F("relPosLength", "I4", 1, "cm"), F("relPosHeading", "I4", 1e-5, "deg"),
        F("reserved1", "U1*4"), *_REL_POS_HP, F("relPosHPLength", "I1", 0.1, "mm"), *_REL_ACC,
        F("accLength", "U4", 0.1, "mm"), F("accHeading", "U4", 1e-5, "deg"),
        F("reserved2", "U1*4"), F("flags", "X4"),
    )),
    Layout("NAV-RELPOSNED", 0x01, 0x3C, (
        F("version", "U1"), F("reserved0", "U1"), F("refStationId", "U2"), _ITOW, *_REL_POS,
        *_REL_POS_HP, F("reserved1", "U1"), *_REL_ACC, F("flags", "X4"),
    ), form="u-blox 8", version=0),
    # UBX-NAV-SIG (0x01 0x43): signal information
    Layout(
        "NAV-SIG", 0x01, 0x43,
        (_ITOW, F("version", "U1"), F("numSigs", "U1"), F("reserved0", "U1*2")),
        (
            F("gnssId", "U1"), F("svId", "U1"), F("sigId", "U1"), F("freqId", "U1"),
            F("prRes", "I2", 0.1, "m"), F("cno", "U1", 1, "dBHz"), F("qualityInd", "U1"),
            F("corrSource", "U1"), F("ionoModel", "U1"), F("sigFlags", "X2"),
            F("reserved1", "U1*4"),
        ),
        count="numSigs", longest=255,
    ),
    # UBX-NAV-EOE (0x01 0x61): end of epoch
    Layout("NAV-EOE", 0x01, 0x61, (_ITOW,)),
    # UBX-NAV-PL (0x01 0x62): protection level
    Layout("NAV-PL", 0x01, 0x62, (
        F("version", "U1"), F("tmirCoeff", "U1"), F("tmirExp", "I1"), F("plPosValid", "U1"),
        F("plPosFrame", "U1"), F("plVelValid", "U1"), F("plVelFrame", "U1"),
        F("plTimeValid", "U1"), F("plPosInvalidityReason", "U1"),
        F("plVelInvalidityReason", "U1"), F("plTimeInvalidityReason", "U1"),
        F("reserved0", "U1"), _ITOW, F("plPos1", "U4", 1, "mm"),
        F("plPos2", "U4", 1, "mm"), F("plPos3", "U4", 1, "mm"), F("plVel1", "U4", 1, "mm/s"),
        F("plVel2", "U4", 1, "mm/s"), F("plVel3", "U4", 1, "mm/s"),
        F("plPosHorizOrient", "U2", 1e-2, "deg"), F("plVelHorizOrient", "U2", 1e-2, "deg"),
        F("plTime", "U4", 1, "ns"), F("reserved1", "U1*4"),
    )),
    # UBX-RXM-RAW (0x02 0x10): raw measurements; u-blox 4 to 6
    Layout(
        "RXM-RAW", 0x02, 0x10,
        (F("iTOW", "I4", 1, "ms"), F("week", "I2"), F("numSV", "U1"), F("reserved0", "U1")),
        (
            F("cpMes", "R8", 1, "cycles"), F("prMes", "R8", 1, "m"), F("doMes", "R4", 1, "Hz"),
            F("sv", "U1"), F("mesQI", "I1"), F("cno", "I1", 1, "dBHz"), F("lli", "U1"),
        ),
        count="numSV", longest=255,
    ),
    # UBX-RXM-SFRBX (0x02 0x13): broadcast navigation data subframe
    Layout(
        "RXM-SFRBX", 0x02, 0x13,
        (
            F("gnssId", "U1"), F("svId", "U1"), F("sigId", "U1"), F("freqId", "U1"),
            F("numWords", "U1"), F("chn", "U1"), F("version", "U1"), F("reserved0", "U1"),
        ),
        (F("dwrd", "U4"),),
        count="numWords", longest=32,
    ),
    # UBX-RXM-RAWX (0x02 0x15): multi-GNSS raw measurements
    Layout(
        "RXM-RAWX", 0x02, 0x15,
        (
            F("rcvTow", "R8", 1, "s"), F("week", "U2"), F("leapS", "I1", 1, "s"),
            F("numMeas", "U1"), F("recStat", "X1"), F("version", "U1"), F("reserved0", "U1*2"),
        ),
        (
            F("prMes", "R8", 1, "m"), F("cpMes", "R8", 1, "cycles"), F("doMes", "R4", 1, "Hz"),
            F("gnssId", "U1"), F("svId", "U1"), F("sigId", "U1"), F("freqId", "U1"),
            F("locktime", "U2", 1, "ms"), F("cno", "U1", 1, "dBHz"), F("prStdev", "X1"),
            F("cpStdev", "X1"), F("doStdev", "X1"), F("trkStat", "X1"), F("reserved1", "U1"),
        ),
        count="numMeas", longest=255,
    ),
    # UBX-RXM-RTCM (0x02 0x32), UBX-RXM-COR (0x02 0x34): corrections that came in
    Layout("RXM-RTCM", 0x02, 0x32, (
        F("version", "U1"), F("flags", "X1"), F("subType", "U2"), F("refStation", "U2"),
        F("msgType", "U2"),
    )),
    Layout("RXM-COR", 0x02, 0x34, (
        F("version", "U1"), F("ebno", "U1", 0.125, "dB"), F("reserved0", "U1*2"),
        F("statusInfo", "X4"), F("msgType", "U2"), F("msgSubType", "U2"),
    )),
    # UBX-MON-VER (0x0a 0x04): receiver and software version
    Layout(
        "MON-VER", 0x0A, 0x04, (F("swVersion", "C30"), F("hwVersion", "C10")),
        (F("extension", "C30"),), longest=64,
    ),
    # UBX-MON-HW (0x0a 0x09): hardware status; 68 bytes on u-blox 5
    Layout("MON-HW", 0x0A, 0x09, (*_PINS, *_HARDWARE, F("VP", "U1*17"), *_INTERRUPTS)),
    Layout(
        "MON-HW", 0x0A, 0x09, (*_PINS, *_HARDWARE, F("VP", "U1*25"), *_INTERRUPTS), form="u-blox 5"
    ),
    # UBX-MON-SPAN (0x0a 0x31): signal characteristics
    Layout(
        "MON-SPAN", 0x0A, 0x31,
        (F("version", "U1"), F("numRfBlocks", "U1"), F("reserved0", "U1*2")),
        (
            F("spectrum", "U1*256"), F("span", "U4", 1, "Hz"), F("res", "U4", 1, "Hz"),
            F("center", "U4", 1, "Hz"), F("pga", "U1", 1, "dB"), F("reserved1", "U1*3"),
        ),
        count="numRfBlocks", longest=8,
    ),
    # UBX-MON-RF (0x0a 0x38): RF information
    Layout(
        "MON-RF", 0x0A, 0x38,
        (F("version", "U1"), F("nBlocks", "U1"), F("reserved0", "U1*2")),
        (
            F("blockId", "U1"), F("flags", "X1"), F("antStatus", "U1"), F("antPower", "U1"),
            F("postStatus", "U4"), F("reserved1", "U1*4"), F("noisePerMS", "U2"),
            F("agcCnt", "U2"), F("jamInd", "U1"), F("ofsI", "I1"), F("magI", "U1"),
            F("ofsQ", "I1"), F("magQ", "U1"), F("reserved2", "U1*3"),
        ),
        count="nBlocks", longest=8,
    ),
    # UBX-SEC-SIG (0x27 0x09): signal security information; version 1 without the carriers
    Layout(
        "SEC-SIG", 0x27, 0x09,
        (
            F("version", "U1"), F("sigSecFlags", "X1"), F("reserved0", "U1"),
            F("jamNumCentFreqs", "U1"),
        ),
        (F("jamStateCentFreq", "X4"),),
        count="jamNumCentFreqs", longest=32, version=2,
    ),
    Layout("SEC-SIG", 0x27, 0x09, (
        F("version", "U1"), F("reserved0", "U1*3"), F("jamFlags", "X1"), F("reserved1", "U1*3"),
        F("spfFlags", "X1"), F("reserved2", "U1*3"),
    ), form="version 1", version=1),
    # UBX-TIM-TP (0x0d 0x01): time pulse time data
    Layout("TIM-TP", 0x0D, 0x01, (
        F("towMS", "U4", 1, "ms"), F("towSubMS", "U4", 2**-32, "ms"), F("qErr", "I4", 1, "ps"),
        F("week", "U2"), F("flags", "X1"), F("refInfo", "X1"),
    )),
    # UBX-ESF-MEAS (0x10 0x02): external sensor fusion measurements; the last word is a
    # calibrated time tag if bit 3 of flags says so
    Layout(
        "ESF-MEAS", 0x10, 0x02, (F("timeTag", "U4"), F("flags", "X2"), F("id", "U2")),
        (F("data", "X4"),), longest=32,
    ),
    # UBX-ESF-RAW (0x10 0x03): raw sensor measurements
    Layout(
        "ESF-RAW", 0x10, 0x03, (F("reserved0", "U1*4"),),
        (F("data", "X4"), F("sTtag", "U4")), longest=255,
    ),
    # UBX-ESF-STATUS (0x10 0x10): external sensor fusion status
    Layout(
        "ESF-STATUS", 0x10, 0x10,
        (
            _ITOW, F("version", "U1"), F("initStatus1", "X1"), F("initStatus2", "X1"),
            F("reserved0", "U1*5"), F("fusionMode", "U1"), F("reserved1", "U1*2"),
            F("numSens", "U1"),
        ),
        (
            F("sensStatus1", "X1"), F("sensStatus2", "X1"), F("freq", "U1", 1, "Hz"),
            F("faults", "X1"),
        ),
        count="numSens", longest=255,
    ),
    # UBX-ESF-ALG (0x10 0x14): IMU alignment information
    Layout("ESF-ALG", 0x10, 0x14, (
        _ITOW, F("version", "U1"), F("flags", "X1"), F("error", "X1"), F("reserved0", "U1"),
        F("yaw", "U4", 1e-2, "deg"), F("pitch", "I2", 1e-2, "deg"), F("roll", "I2", 1e-2, "deg"),
    )),
    # UBX-ESF-INS (0x10 0x15): vehicle dynamics information
    Layout("ESF-INS", 0x10, 0x15, _DYNAMICS),
    # UBX-HNR-PVT (0x28 0x00): high rate output of PVT solution
    Layout("HNR-PVT", 0x28, 0x00, (
        _ITOW, *_DATE, F("valid", "X1"), F("nano", "I4", 1, "ns"), F("gpsFix", "U1"),
        F("flags", "X1"), F("reserved0", "U1*2"), *_LLH, F("gSpeed", "I4", 1, "mm/s"),
        F("speed", "I4", 1, "mm/s"), F("headMot", "I4", 1e-5, "deg"),
        F("headVeh", "I4", 1e-5, "deg"), *_ACCURACY, F("sAcc", "U4", 1, "mm/s"),
        F("headAcc", "U4", 1e-5, "deg"), F("reserved1", "U1*4"),
    )),
    # UBX-HNR-ATT (0x28 0x01): attitude solution
    Layout("HNR-ATT", 0x28, 0x01, _ATTITUDE),
    # UBX-HNR-INS (0x28 0x02): vehicle dynamics information
    Layout("HNR-INS", 0x28, 0x02, _DYNAMICS),
)  # fmt: skip

BY_KIND: dict[int, tuple[Layout, ...]] = {
    layout.kind: tuple(each for each in LAYOUTS if each.kind == layout.kind) for layout in LAYOUTS
}
BY_NAME: dict[str, Layout] = {layout.title: layout for layout in LAYOUTS}
LIMITS: dict[int, Limit] = {kind: forms[0].limit for kind, forms in BY_KIND.items()}
OTHER_LENGTHS: dict[int, frozenset[int]] = {
    kind: frozenset(layout.fixed.size for layout in forms[1:])
    for kind, forms in BY_KIND.items()
    if forms[1:]
}
"""Lengths of the older forms, none of which has a group that repeats."""

_CLASSES = {
    0x01: "NAV", 0x02: "RXM", 0x04: "INF", 0x05: "ACK", 0x06: "CFG", 0x09: "UPD", 0x0A: "MON",
    0x0B: "AID", 0x0D: "TIM", 0x10: "ESF", 0x13: "MGA", 0x21: "LOG", 0x27: "SEC", 0x28: "HNR",
    0x29: "NAV2",
}  # fmt: skip
_OTHERS = {
    0x0101: "POSECEF", 0x0103: "STATUS", 0x0104: "DOP", 0x0106: "SOL", 0x0109: "ODO",
    0x0110: "RESETODO", 0x0111: "VELECEF", 0x0112: "VELNED", 0x0113: "HPPOSECEF",
    0x0121: "TIMEUTC", 0x0122: "CLOCK", 0x0123: "TIMEGLO", 0x0124: "TIMEBDS", 0x0125: "TIMEGAL",
    0x0127: "TIMEQZSS", 0x0130: "SVINFO", 0x0131: "DGPS", 0x0132: "SBAS", 0x0134: "ORB",
    0x0139: "GEOFENCE", 0x013B: "SVIN", 0x013C: "RELPOSNED", 0x013D: "EELL", 0x0142: "SLAS",
    0x0160: "AOPSTATUS", 0x0162: "PL", 0x0214: "MEASX", 0x0220: "SVSI", 0x0232: "RTCM",
    0x0233: "SPARTN", 0x0234: "COR", 0x0259: "RLM", 0x0272: "PMP", 0x0273: "QZSSL6",
    0x0400: "ERROR", 0x0401: "WARNING", 0x0402: "NOTICE", 0x0403: "TEST", 0x0404: "DEBUG",
    0x0600: "PRT", 0x0601: "MSG", 0x0608: "RATE", 0x0609: "CFG", 0x068A: "VALSET",
    0x068B: "VALGET", 0x0A02: "IO", 0x0A06: "MSGPP", 0x0A07: "RXBUF", 0x0A08: "TXBUF",
    0x0A09: "HW", 0x0A0B: "HW2", 0x0A21: "RXR", 0x0A27: "PATCH", 0x0A28: "GNSS", 0x0A31: "SPAN",
    0x0A36: "COMMS", 0x0A37: "HW3", 0x0A38: "RF", 0x0D03: "TM2", 0x0D04: "SVIN", 0x0D06: "VRFY",
    0x1306: "GLO", 0x1300: "GPS", 0x1302: "GAL", 0x1303: "BDS", 0x1310: "SF", 0x1320: "ANO",
    0x1340: "INI", 0x1360: "ACK", 0x1380: "DBD", 0x2703: "UNIQID", 0x2709: "SIG",
}  # fmt: skip


def name_of(kind: int) -> str:
    """NAV-PVT; class and identifier in hexadecimal (`0A-99`) where there is no name."""
    forms = BY_KIND.get(kind)
    if forms is not None:
        return forms[0].name
    short = _OTHERS.get(kind)
    return f"{_CLASSES[kind >> 8]}-{short}" if short else f"{kind >> 8:02X}-{kind & 0xFF:02X}"
