"""Satellites, raw measurements and navigation data of UBX as messages of the bus."""

from __future__ import annotations

from tramstream.bridges.gnss.messages import MILLI
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.proto.gnss_pb2 import GnssMeasurements, GnssSatellites, GnssSubframe

_NUMBERS = (
    (1, 32, 0, 1), (33, 64, 3, 6), (65, 96, 6, 1), (120, 158, 1, 120), (159, 163, 3, 1),
    (193, 202, 5, 1), (211, 246, 2, 1),
)  # fmt: skip
"""Numbers of one byte, first and last of a system; its id in UBX, and the first's number there."""

# Standard deviations of RXM-RAWX, by the low four bits of the byte that codes them.
_PSEUDORANGE_STD_M = tuple(0.01 * 2**n for n in range(16))
_PHASE_STD_CYCLES = tuple(0.004 * n for n in range(16))
_DOPPLER_STD_HZ = tuple(0.002 * 2**n for n in range(16))


def satellites(message: UbxMessage, _: int | None) -> GnssSatellites:
    """NAV-SAT. Elevation and azimuth beyond their range mean that they are not known."""
    out = GnssSatellites(source=message.name, itow_ms=message.fields["iTOW"])
    add = out.satellites.add
    for gnss_id, sv_id, cno, elevation, azimuth, residual, flags in message.records:
        known = -90 <= elevation <= 90
        add(
            gnss_id=gnss_id, sv_id=sv_id, cno_dbhz=cno, residual_m=residual, flags=flags,
            elevation_deg=elevation if known else None, azimuth_deg=azimuth if known else None,
            quality=flags & 7, used=bool(flags & 8), health=flags >> 4 & 3,
        )  # fmt: skip
    return out


def space_vehicles(message: UbxMessage, _: int | None) -> GnssSatellites:
    """NAV-SVINFO of receivers before NAV-SAT, whose numbers tell the system (section "Satellite
    numbering" of their manuals)."""
    out = GnssSatellites(source=message.name, itow_ms=message.fields["iTOW"])
    for _channel, number, flags, quality, cno, elevation, azimuth, residual in message.records:
        gnss_id, sv_id = _system_of(number)
        known = -90 <= elevation <= 90
        out.satellites.add(
            gnss_id=gnss_id, sv_id=sv_id, cno_dbhz=cno, residual_m=residual / 100.0, flags=flags,
            elevation_deg=elevation if known else None, azimuth_deg=azimuth if known else None,
            quality=quality & 15, used=bool(flags & 1), health=2 if flags & 16 else 1,
        )  # fmt: skip
    return out


def _system_of(number: int) -> tuple[int, int]:
    """System and number within it; 255 is a satellite of GLONASS whose number is not known."""
    if number == 255:
        return 6, 255
    for first, last, gnss_id, begin in _NUMBERS:
        if first <= number <= last:
            return gnss_id, number - first + begin
    return 0, number


def signals(message: UbxMessage, _: int | None) -> GnssSatellites:
    """NAV-SIG; `used` where the pseudorange is."""
    out = GnssSatellites(source=message.name, itow_ms=message.fields["iTOW"])
    add = out.satellites.add
    for (
        gnss_id,
        sv_id,
        signal,
        frequency,
        residual,
        cno,
        quality,
        _c,
        _i,
        flags,
        _r,
    ) in message.records:
        add(
            gnss_id=gnss_id, sv_id=sv_id, signal_id=signal, frequency_id=frequency,
            cno_dbhz=cno, residual_m=residual, quality=quality, used=bool(flags & 8),
            health=flags & 3, flags=flags,
        )  # fmt: skip
    return out


def measurements(message: UbxMessage, _: int | None) -> GnssMeasurements:
    f = message.fields
    status = f["recStat"]
    out = GnssMeasurements(
        receiver_tow_s=f["rcvTow"], week=f["week"], clock_reset=bool(status & 2),
        leap_seconds=f["leapS"] if status & 1 else None,
    )  # fmt: skip
    add = out.measurements.add
    for (
        pr,
        cp,
        do,
        gnss,
        sv,
        signal,
        freq,
        lock,
        cno,
        pr_std,
        cp_std,
        do_std,
        track,
        _r,
    ) in message.records:
        add(
            pseudorange_m=pr, carrier_phase_cycles=cp, doppler_hz=do, gnss_id=gnss, sv_id=sv,
            signal_id=signal, frequency_id=freq, lock_time_ms=lock, cno_dbhz=cno,
            pseudorange_std_m=_PSEUDORANGE_STD_M[pr_std & 15],
            carrier_phase_std_cycles=_PHASE_STD_CYCLES[cp_std & 15],
            doppler_std_hz=_DOPPLER_STD_HZ[do_std & 15], tracking=track,
        )  # fmt: skip
    return out


def raw_measurements(message: UbxMessage, _: int | None) -> GnssMeasurements:
    """RXM-RAW of receivers before RXM-RAWX: GPS and SBAS on L1, without deviations."""
    f = message.fields
    out = GnssMeasurements(receiver_tow_s=f["iTOW"] / MILLI, week=max(f["week"], 0))
    for phase, pseudorange, doppler, number, _quality, cno, loss in message.records:
        gnss_id, sv_id = _system_of(number)
        out.measurements.add(
            pseudorange_m=pseudorange, carrier_phase_cycles=phase, doppler_hz=doppler,
            gnss_id=gnss_id, sv_id=sv_id, cno_dbhz=max(cno, 0), tracking=loss,
        )  # fmt: skip
    return out


def subframe(message: UbxMessage, _: int | None) -> GnssSubframe:
    f = message.fields
    return GnssSubframe(
        gnss_id=f["gnssId"], sv_id=f["svId"], signal_id=f["sigId"], frequency_id=f["freqId"],
        channel=f["chn"], words=[record[0] for record in message.records],
    )  # fmt: skip
