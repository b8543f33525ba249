"""What receivers say of themselves as messages of the bus: radio, jamming, spoofing, corrections.

Sections of the u-blox F9 HPG 1.32 Interface Description: 3.10 (NAV), 3.11 (RXM), 3.9 (MON), 3.13
(SEC); u-blox 8/M8 Receiver Description, 32.16 (MON).
"""

from __future__ import annotations

from tramstream.bridges.gnss.messages import MILLI, carrier_of
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.proto.gnss_pb2 import (
    JAMMING_CRITICAL,
    JAMMING_OK,
    JAMMING_UNKNOWN,
    JAMMING_WARNING,
    SPOOFING_AFFIRMED,
    SPOOFING_INDICATED,
    SPOOFING_NONE,
    SPOOFING_UNKNOWN,
    GnssBaseline,
    GnssCorrection,
    GnssDilution,
    GnssInterference,
    GnssOscillator,
    GnssProtection,
    GnssSpectrum,
)

_FULL_GAIN = 8191.0
"""agcCnt at the highest gain."""
_RTCM3 = 1
_CENTI = _PERCENT = 100.0
_AXES = (1, 2, 3)


JAMMING_STATES = (JAMMING_UNKNOWN, JAMMING_OK, JAMMING_WARNING, JAMMING_CRITICAL)
SPOOFING_STATES = (SPOOFING_UNKNOWN, SPOOFING_NONE, SPOOFING_INDICATED, SPOOFING_AFFIRMED)
"""By the numbers that the messages have for them."""
_FRAMES = (
    GnssProtection.NO_FRAME, GnssProtection.NORTH_EAST_DOWN, GnssProtection.ALONG_ACROSS_UP,
    GnssProtection.MAJOR_MINOR_UP,
)  # fmt: skip
_USES = (
    GnssCorrection.USE_UNKNOWN, GnssCorrection.NOT_USED, GnssCorrection.USED,
    GnssCorrection.USE_UNKNOWN,
)  # fmt: skip


def radio(message: UbxMessage, _: int | None) -> GnssInterference:
    """MON-RF, one part for each band."""
    out = GnssInterference(source=message.name)
    for (
        block, flags, antenna, power, _post, _r, noise, gain, indicator, ofs_i, mag_i, ofs_q, mag_q,
        _s,
    ) in message.records:  # fmt: skip
        out.parts.add(
            id=block, jamming=JAMMING_STATES[flags & 3], noise=noise, gain=gain / _FULL_GAIN,
            jamming_indicator=indicator, antenna_status=antenna, antenna_power=power,
            offset_i=ofs_i, magnitude_i=mag_i, offset_q=ofs_q, magnitude_q=mag_q,
        )  # fmt: skip
        out.jamming = max(out.jamming, JAMMING_STATES[flags & 3])
    return out


def hardware(message: UbxMessage, _: int | None) -> GnssInterference:
    """MON-HW, of receivers with one band."""
    f = message.fields
    jamming = JAMMING_STATES[f["flags"] >> 2 & 3]
    out = GnssInterference(source=message.name, jamming=jamming)
    out.parts.add(
        jamming=jamming, noise=f["noisePerMS"], gain=f["agcCnt"] / _FULL_GAIN,
        jamming_indicator=f["jamInd"], antenna_status=f["aStatus"], antenna_power=f["aPower"],
    )  # fmt: skip
    return out


def signal_security(message: UbxMessage, _: int | None) -> GnssInterference:
    """SEC-SIG; a detector that is off knows no state."""
    f = message.fields
    if message.form:
        jam, spoof = f["jamFlags"], f["spfFlags"]
    else:
        jam, spoof = f["sigSecFlags"] & 7, f["sigSecFlags"] >> 3
    out = GnssInterference(
        source=message.name, jamming_detection=bool(jam & 1), spoofing_detection=bool(spoof & 1)
    )
    if jam & 1:
        out.jamming = JAMMING_STATES[jam >> 1 & 3]
    if spoof & 1:
        out.spoofing = SPOOFING_STATES[min(spoof >> 1 & 7, len(SPOOFING_STATES) - 1)]
    for (carrier,) in message.records:
        out.carriers.add(frequency_hz=(carrier & 0xFFFFFF) * 1e3, jammed=bool(carrier >> 24 & 1))
    return out


def status(message: UbxMessage, _: int | None) -> GnssInterference:
    """NAV-STATUS: what it says of spoofing, since u-blox 8."""
    state = SPOOFING_STATES[message.fields["flags2"] >> 3 & 3]
    detection = None if state == SPOOFING_UNKNOWN else True
    return GnssInterference(source=message.name, spoofing=state, spoofing_detection=detection)


def protection(message: UbxMessage, _: int | None) -> GnssProtection:
    """NAV-PL: position, velocity and time, each with its own validity."""
    f = message.fields
    return GnssProtection(
        itow_ms=f["iTOW"],
        integrity_risk=f["tmirCoeff"] * 10.0 ** f["tmirExp"] / _PERCENT,
        position_valid=f["plPosValid"] == 1,
        position_reason=f["plPosInvalidityReason"],
        position_frame=_frame(f["plPosFrame"]),
        position_m=[f[f"plPos{axis}"] / MILLI for axis in _AXES],
        position_orient_deg=f["plPosHorizOrient"],
        velocity_valid=f["plVelValid"] == 1,
        velocity_frame=_frame(f["plVelFrame"]),
        velocity_mps=[f[f"plVel{axis}"] / MILLI for axis in _AXES],
        velocity_orient_deg=f["plVelHorizOrient"],
        time_valid=f["plTimeValid"] == 1,
        time_ns=f["plTime"],
    )


def _frame(told: int) -> GnssProtection.Frame:
    return _FRAMES[told] if told < len(_FRAMES) else GnssProtection.NO_FRAME


def baseline(message: UbxMessage, _: int | None) -> GnssBaseline:
    """NAV-RELPOSNED; that of u-blox 8 has neither length nor heading."""
    f = message.fields
    flags = f["flags"]
    out = GnssBaseline(
        itow_ms=f["iTOW"], reference_station=f["refStationId"], valid=bool(flags & 4),
        carrier=carrier_of(flags >> 3 & 3), flags=flags,
    )  # fmt: skip
    for name, axis in (("north", "N"), ("east", "E"), ("down", "D")):
        value_m = f[f"relPos{axis}"] / _CENTI + f[f"relPosHP{axis}"] / MILLI
        setattr(out, f"{name}_m", value_m)
        setattr(out, f"{name}_std_m", f[f"acc{axis}"] / MILLI)
    if not message.form:
        out.length_m = f["relPosLength"] / _CENTI + f["relPosHPLength"] / MILLI
        out.length_std_m = f["accLength"] / MILLI
        if flags & 0x100:
            out.heading_deg = f["relPosHeading"]
        out.heading_std_deg = f["accHeading"]
    return out


def dilution(message: UbxMessage, _: int | None) -> GnssDilution:
    """NAV-DOP."""
    f = message.fields
    return GnssDilution(
        itow_ms=f["iTOW"], geometric=f["gDOP"], position=f["pDOP"], time=f["tDOP"],
        vertical=f["vDOP"], horizontal=f["hDOP"], north=f["nDOP"], east=f["eDOP"],
    )  # fmt: skip


def oscillator(message: UbxMessage, _: int | None) -> GnssOscillator:
    """NAV-CLOCK."""
    f = message.fields
    return GnssOscillator(
        itow_ms=f["iTOW"], bias_ns=f["clkB"], drift_nsps=f["clkD"], time_std_ns=f["tAcc"],
        drift_std_psps=f["fAcc"],
    )  # fmt: skip


def spectrum(message: UbxMessage, _: int | None) -> GnssSpectrum:
    """MON-SPAN."""
    out = GnssSpectrum()
    for level, span, resolution, centre, gain, _r in message.records:
        out.bands.add(
            level=level, span_hz=span, resolution_hz=resolution, centre_hz=centre, gain_db=gain
        )
    return out


def rtcm_input(message: UbxMessage, _: int | None) -> GnssCorrection:
    """RXM-RTCM."""
    f = message.fields
    return GnssCorrection(
        source=message.name, protocol=_RTCM3, message_type=f["msgType"],
        message_subtype=f["subType"], station=f["refStation"], damaged=bool(f["flags"] & 1),
        use=_USES[f["flags"] >> 1 & 3],
    )  # fmt: skip


def correction_input(message: UbxMessage, _: int | None) -> GnssCorrection:
    """RXM-COR, which tells of all protocols; error status 2 is a correction with errors."""
    f = message.fields
    told = f["statusInfo"]
    out = GnssCorrection(
        source=message.name, protocol=told & 31, station=told >> 9 & 0xFFFF,
        damaged=told >> 5 & 3 == 2, use=_USES[told >> 7 & 3],
        ebno_db=f["ebno"],
    )  # fmt: skip
    if told >> 25 & 1:
        out.message_type = f["msgType"]
    if told >> 26 & 1:
        out.message_subtype = f["msgSubType"]
    return out
