"""What receivers say of themselves: fields as the manual has them; the worst is in the fix."""

from __future__ import annotations

from typing import Any

import pytest
from receivers import BOOT_NS, START_NS, VEHICLE, decoded, itow_ms, on, raw, solution, status

from tramstream import keys
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.events import JAMMED, SPOOFED
from tramstream.bridges.gnss.interference import FRESH_NS
from tramstream.clock import S
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
    GnssFix,
    GnssProtection,
)

ITOW = itow_ms(START_NS)


def message(key: keys.Key, *data: bytes) -> Any:
    """The only message on a key."""
    (found,) = on(decoded(solution(), b"".join(data)), key)
    return found


def test_radio_of_each_band_is_told_and_the_worst_counts() -> None:
    bands = [
        {"blockId": 0, "flags": 1, "antStatus": 2, "antPower": 1, "noisePerMS": 90, "agcCnt": 8191,
         "jamInd": 12, "ofsI": -5, "magI": 130, "ofsQ": 6, "magQ": 131},
        {"blockId": 1, "flags": 2, "antStatus": 4, "agcCnt": 0, "jamInd": 200},
    ]  # fmt: skip
    told = message(keys.GNSS_INTERFERENCE, ubx.encode("MON-RF", {}, bands))
    assert (told.source, told.jamming, told.spoofing) == (
        "MON-RF", JAMMING_WARNING, SPOOFING_UNKNOWN,
    )  # fmt: skip
    first, second = told.parts
    assert (first.jamming, first.antenna_status, first.antenna_power, first.noise) == (
        JAMMING_OK, 2, 1, 90,
    )  # fmt: skip
    assert (first.gain, first.jamming_indicator) == (1.0, 12)
    assert (first.offset_i, first.magnitude_i, first.offset_q, first.magnitude_q) == (
        -5, 130, 6, 131,
    )  # fmt: skip
    assert (second.id, second.jamming, second.antenna_status, second.gain) == (
        1, JAMMING_WARNING, 4, 0.0,
    )  # fmt: skip
    assert told.stamp_ns == BOOT_NS + S  # its arrival: it tells no epoch


@pytest.mark.parametrize("form", ["MON-HW", "MON-HW u-blox 5"])
def test_radio_of_older_receivers_is_told(form: str) -> None:
    fields = {"flags": 3 << 2, "jamInd": 251, "agcCnt": 4096, "aStatus": 3, "aPower": 1}
    told = message(keys.GNSS_INTERFERENCE, ubx.encode(form, fields))
    assert (told.source, told.jamming) == ("MON-HW", JAMMING_CRITICAL)
    (part,) = told.parts
    assert (part.jamming_indicator, part.antenna_status) == (251, 3)
    assert part.gain == pytest.approx(0.5, abs=1e-3)


NEW, OLD = "SEC-SIG", "SEC-SIG version 1"


@pytest.mark.parametrize(
    ("form", "fields", "jamming", "spoofing", "detection"),
    [
        (NEW, {"sigSecFlags": 0b0011011}, JAMMING_OK, SPOOFING_NONE, (1, 1)),
        (NEW, {"sigSecFlags": 0b0111111}, JAMMING_CRITICAL, SPOOFING_AFFIRMED, (1, 1)),
        (NEW, {"sigSecFlags": 0b0110110}, JAMMING_UNKNOWN, SPOOFING_UNKNOWN, (0, 0)),
        (OLD, {"jamFlags": 5, "spfFlags": 5}, JAMMING_WARNING, SPOOFING_INDICATED, (1, 1)),
        (OLD, {"jamFlags": 4, "spfFlags": 4}, JAMMING_UNKNOWN, SPOOFING_UNKNOWN, (0, 0)),
    ],
)
def test_signal_security_is_told_where_the_detector_is_on(
    form: str, fields: dict[str, int], jamming: Any, spoofing: Any, detection: tuple[int, int]
) -> None:
    told = message(keys.GNSS_INTERFERENCE, ubx.encode(form, fields))
    assert (told.jamming, told.spoofing) == (jamming, spoofing)
    assert (told.jamming_detection, told.spoofing_detection) == detection


def test_jammed_carriers_are_told() -> None:
    carriers = [[1_575_420 | 1 << 24], [1_227_600]]
    told = message(keys.GNSS_INTERFERENCE, ubx.encode("SEC-SIG", {"sigSecFlags": 1}, carriers))
    assert [(c.frequency_hz, c.jammed) for c in told.carriers] == [
        (1575.42e6, True),
        (1227.6e6, False),
    ]


def test_status_tells_of_spoofing_only_where_it_knows() -> None:
    assert on(decoded(solution(), status(flags2=0)), keys.GNSS_INTERFERENCE) == []
    told = message(keys.GNSS_INTERFERENCE, status(flags2=2 << 3))
    assert told.spoofing == SPOOFING_INDICATED


def test_protection_levels_are_told_for_what_they_are() -> None:
    fields = {
        "iTOW": ITOW, "tmirCoeff": 5, "tmirExp": -3, "plPosValid": 1, "plPosFrame": 3,
        "plPos1": 2500, "plPos2": 1500, "plPos3": 4000, "plPosHorizOrient": 123.45,
        "plVelValid": 0, "plVelFrame": 9, "plTimeValid": 1, "plTime": 70,
    }  # fmt: skip
    told = message(keys.GNSS_PROTECTION, ubx.encode("NAV-PL", fields))
    assert told.integrity_risk == pytest.approx(5e-5)  # per cent in the manual
    assert (told.position_valid, told.velocity_valid, told.time_valid) == (True, False, True)
    assert told.position_frame == GnssProtection.MAJOR_MINOR_UP
    assert told.velocity_frame == GnssProtection.NO_FRAME
    assert list(told.position_m) == [2.5, 1.5, 4.0]
    assert (told.position_orient_deg, told.time_ns) == (123.45, 70)


def test_baseline_is_told_with_its_heading_where_valid() -> None:
    fields = {
        "version": 1, "refStationId": 42, "iTOW": ITOW, "relPosN": 150, "relPosE": -250,
        "relPosD": 10, "relPosLength": 291, "relPosHPN": 0.5, "relPosHPLength": -0.1,
        "relPosHeading": 301.0, "accN": 10.0, "accLength": 12.0, "accHeading": 0.5,
        "flags": 0x100 | 2 << 3 | 4,
    }  # fmt: skip
    told = message(keys.GNSS_BASELINE, ubx.encode("NAV-RELPOSNED", fields))
    assert (told.valid, told.carrier, told.reference_station) == (True, GnssFix.FIXED, 42)
    assert (told.north_m, told.east_m) == (pytest.approx(1.5005), -2.5)
    assert (told.length_m, told.length_std_m) == (pytest.approx(2.9099), 0.012)
    assert (told.heading_deg, told.north_std_m) == (301.0, 0.01)
    fields["flags"] = 4
    told = message(keys.GNSS_BASELINE, ubx.encode("NAV-RELPOSNED", fields))
    assert not told.HasField("heading_deg")
    old = {"iTOW": ITOW, "relPosN": 150, "accN": 10.0, "flags": 4}
    told = message(keys.GNSS_BASELINE, ubx.encode("NAV-RELPOSNED u-blox 8", old))
    assert (told.north_m, told.valid, told.HasField("length_m")) == (1.5, True, False)
    assert isinstance(told, GnssBaseline)


def test_dilutions_oscillator_and_spectrum_are_told() -> None:
    fields = {"gDOP": 2.2, "pDOP": 1.9, "tDOP": 1.1, "vDOP": 1.6, "hDOP": 1.0, "nDOP": 0.8,
              "eDOP": 0.6}  # fmt: skip
    told = message(keys.GNSS_DILUTION, ubx.encode("NAV-DOP", {"iTOW": ITOW, **fields}))
    assert [getattr(told, name) for name in (
        "geometric", "position", "time", "vertical", "horizontal", "north", "east",
    )] == list(fields.values())  # fmt: skip
    clock = {"iTOW": ITOW, "clkB": -999_759, "clkD": -627, "tAcc": 5, "fAcc": 300}
    told = message(keys.GNSS_OSCILLATOR, ubx.encode("NAV-CLOCK", clock))
    values = told.bias_ns, told.drift_nsps, told.time_std_ns, told.drift_std_psps
    assert values == (-999_759, -627, 5, 300)
    band = {"spectrum": bytes(range(256)), "span": 128_000_000, "res": 500_000,
            "center": 1_583_400_000, "pga": 54}  # fmt: skip
    told = message(keys.GNSS_SPECTRUM, ubx.encode("MON-SPAN", {}, [band]))
    (first,) = told.bands
    assert first.level == bytes(range(256))
    assert (first.centre_hz, first.span_hz, first.resolution_hz, first.gain_db) == (
        1.5834e9, 1.28e8, 5e5, 54,
    )  # fmt: skip


def test_corrections_and_their_use_are_told() -> None:
    fields = {"version": 2, "flags": 2 << 1, "subType": 0, "refStation": 7, "msgType": 1077}
    told = message(keys.GNSS_CORRECTION, ubx.encode("RXM-RTCM", fields))
    assert (told.protocol, told.message_type, told.station) == (1, 1077, 7)
    assert (told.damaged, told.use) == (False, GnssCorrection.USED)
    fields["flags"] = 1 | 1 << 1
    told = message(keys.GNSS_CORRECTION, ubx.encode("RXM-RTCM", fields))
    assert (told.damaged, told.use) == (True, GnssCorrection.NOT_USED)
    info = 2 | 2 << 5 | 2 << 7 | 513 << 9 | 1 << 25
    fields = {"version": 1, "ebno": 6.5, "statusInfo": info, "msgType": 3, "msgSubType": 1}
    told = message(keys.GNSS_CORRECTION, ubx.encode("RXM-COR", fields))
    assert (told.protocol, told.station, told.message_type, told.ebno_db) == (2, 513, 3, 6.5)
    assert (told.damaged, told.use) == (True, GnssCorrection.USED)
    assert not told.HasField("message_subtype")


def test_utc_of_the_receiver_is_told_where_valid() -> None:
    fields = {"iTOW": ITOW, "year": 2024, "month": 2, "day": 5, "hour": 1, "valid": 0x37,
              "tAcc": 20}  # fmt: skip
    told = message(keys.GNSS_TIME, ubx.encode("NAV-TIMEUTC", fields))
    assert (told.source, told.utc_standard, told.accuracy_ns) == ("NAV-TIMEUTC", 3, 20)
    assert told.utc_ns == 1_707_094_800 * S
    told = message(keys.GNSS_TIME, ubx.encode("NAV-TIMEUTC", fields | {"valid": 3}))
    assert not told.HasField("utc_ns")


# In the fixes -------------------------------------------------------------------------------------
def test_fix_carries_the_worst_that_was_said_lately() -> None:
    bridge = GnssBridge(VEHICLE)
    jammed = ubx.encode("MON-RF", {}, [{"flags": 3}])
    spoofed = ubx.encode("SEC-SIG", {"sigSecFlags": 0b0101011})
    states = []
    for k, said in enumerate((b"", jammed, spoofed, b"", b"")):
        arrival_ns = BOOT_NS + k * FRESH_NS // 2
        (fix,) = on(
            bridge.step(raw(said + solution(START_NS + k * 5 * S), arrival_ns)), keys.GNSS_FIX
        )
        states.append((fix.jamming, fix.spoofing))
    assert states == [
        (JAMMING_UNKNOWN, SPOOFING_UNKNOWN),
        (JAMMING_CRITICAL, SPOOFING_UNKNOWN),
        (JAMMING_CRITICAL, SPOOFING_INDICATED),
        (JAMMING_CRITICAL, SPOOFING_INDICATED),
        (JAMMING_OK, SPOOFING_INDICATED),  # what MON-RF said is older than ten seconds
    ]


def test_state_of_the_receiver_is_a_trouble_while_it_lasts() -> None:
    bridge = GnssBridge(VEHICLE)
    bridge.step(raw(solution() + ubx.encode("MON-RF", {}, [{"flags": 1}])))
    assert bridge.device_troubles() == []
    bridge.step(raw(ubx.encode("MON-RF", {}, [{"flags": 2, "jamInd": 99}]), BOOT_NS + S))
    (jammed,) = bridge.device_troubles()
    assert jammed == JAMMED(state="warning", told_by="MON-RF", indicator=99)
    bridge.step(raw(ubx.encode("SEC-SIG", {"sigSecFlags": 0b0111000}), BOOT_NS + 2 * S))
    assert bridge.device_troubles()[0] == SPOOFED(state="affirmed", told_by="SEC-SIG")
    bridge.step(raw(solution(START_NS + 20 * S), BOOT_NS + 20 * S))
    assert bridge.device_troubles() == []


def test_state_survives_a_restart_of_the_bridge() -> None:
    first, second = GnssBridge(VEHICLE), GnssBridge(VEHICLE)
    first.step(raw(ubx.encode("SEC-SIG", {"sigSecFlags": 0b0101011})))
    second.restore(first.snapshot())
    (fix,) = on(second.step(raw(solution(), BOOT_NS + S)), keys.GNSS_FIX)
    assert fix.spoofing == SPOOFING_INDICATED
