"""The GNSS bridge: content from bytes alone, stamps from arrivals, nothing raises."""

from __future__ import annotations

import itertools
import json
import struct
from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import receivers
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream import keys
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.capture import epoch_times, unix_like_ns
from tramstream.bridges.gnss.clock import WEEK_NS, GpsTimeline, utc_ns
from tramstream.bridges.gnss.framer import UBX, Frame, Framer, nmea_frame, rtcm3_frame, ubx_frame
from tramstream.bridges.gnss.ubx_layouts import LAYOUTS
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Gnss, Vehicle
from tramstream.errors import ConfigError
from tramstream.keys import Key
from tramstream.processor import Sample
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import RawBytes

MS = 1_000_000
US = 1_000
DELAY_S = 0.1
BAUD = 460_800
BYTE_NS = 10 * S / BAUD
BOOT_NS = 1_700_000_000 * S
LEAP_S = 18
WEEK = 2300
START_NS = WEEK * WEEK_NS + 123_456 * S
LAST_DIGIT_DEG = 1e-7

VEHICLE = Vehicle(
    vehicle="t", gnss=Gnss(device="/dev/null", baud_rate=BAUD, receiver_delay_s=DELAY_S)
)

CAPTURES = (
    "u-blox-m8t-time.log",
    "ublox-8.log",
    "ublox-neo-m8l.log",
    "ublox-zed-f9p-nmea.log",
    "ublox-zed-f9p_hpg1.11.log",
    "ublox-zed-f9r.log",
    "zed-f9r-drive.ubx",
)


def solution(gps_ns: int, name: str = "NAV-PVT", **changes: Any) -> bytes:
    """A valid solution of epoch `gps_ns`, as a receiver rounds it."""
    itow_ms = round(gps_ns % WEEK_NS / MS)
    utc = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(seconds=round(gps_ns / S) - LEAP_S)
    fields: dict[str, Any] = {
        "iTOW": itow_ms % 604_800_000,
        "year": utc.year, "month": utc.month, "day": utc.day,
        "hour": utc.hour, "min": utc.minute, "sec": utc.second,
        "nano": gps_ns - round(gps_ns / S) * S, "valid": 7, "flags": 1,
        "lat": 50.0870001, "lon": 14.4212349, "height": 250_123, "hMSL": 205_100,
        "hAcc": 900, "vAcc": 1500, "gSpeed": 5000, "sAcc": 100,
    }  # fmt: skip
    if name == "HNR-PVT":
        fields |= {"gpsFix": 3, "headMot": 36.87, "headAcc": 1.0}
    else:
        fields |= {"fixType": 3, "numSV": 17, "velN": 4000, "velE": 3000, "velD": -10, "tAcc": 20}
    return ubx.encode(name, fields | changes)


def raw(data: bytes, arrival_ns: int) -> Sample:
    return Sample(keys.GNSS_BYTES, RawBytes(stamp_ns=arrival_ns, data=data), arrival_ns, 1)


def step_all(bridge: GnssBridge, reads: list[tuple[bytes, int]]) -> list[Sample]:
    return [sample for data, arrival_ns in reads for sample in bridge.step(raw(data, arrival_ns))]


def on(samples: list[Sample], key: Key) -> list[Sample]:
    return [sample for sample in samples if sample.key == key]


def content(samples: list[Sample]) -> list[tuple[str, int, bytes]]:
    """Everything but the stamps."""
    out = []
    for sample in samples:
        message = type(sample.message)()
        message.CopyFrom(sample.message)
        message.ClearField("timestamp" if isinstance(message, LocationFix) else "stamp_ns")
        out.append((sample.key.path, sample.sequence, message.SerializeToString()))
    return out


def ride(epochs: int, wait_ns: Any = lambda _: 0, skew: float = 0.0) -> list[tuple[bytes, int]]:
    """5 Hz solutions, each read `wait_ns` after its last byte has come."""
    reads = []
    for i in range(epochs):
        gps_ns = START_NS + i * S // 5
        data = solution(gps_ns) + ubx.encode("NAV-EOE", {"iTOW": gps_ns % WEEK_NS // MS})
        host_ns = BOOT_NS + round(i * S // 5 * (1 + skew))
        arrival_ns = host_ns + round(DELAY_S * S + 100 * BYTE_NS) + wait_ns(i)
        reads.append((data, arrival_ns))
    return reads


# content ---------------------------------------------------------------------------------------


def test_fix_is_published_twice_with_the_receivers_own_digits() -> None:
    out = GnssBridge(VEHICLE).step(raw(solution(START_NS), BOOT_NS))
    fix, location = (on(out, key)[0].message for key in (keys.GNSS_FIX, keys.GNSS_LOCATION))
    assert len(out) == 2
    assert (fix.latitude_deg, fix.longitude_deg) == (50.0870001, 14.4212349)
    assert (location.latitude, location.longitude) == (50.0870001, 14.4212349)
    assert fix.valid
    assert fix.source == "NAV-PVT"
    assert fix.gps_time_ns == START_NS
    assert fix.utc_ns == START_NS + (GPS_EPOCH_UNIX_S - LEAP_S) * S
    assert (fix.height_ellipsoid_m, fix.height_msl_m) == (250.123, 205.1)
    assert (fix.vel_n_mps, fix.vel_e_mps, fix.vel_d_mps) == (4.0, 3.0, -0.01)
    assert location.altitude == 250.123
    assert location.timestamp.ToNanoseconds() == fix.stamp_ns == out[0].stamp_ns == out[1].stamp_ns
    assert location.position_covariance_type == LocationFix.DIAGONAL_KNOWN
    diagonal = [location.position_covariance[i] for i in (0, 4, 8)]
    assert diagonal == pytest.approx([0.9**2 / 2, 0.9**2 / 2, 1.5**2])


@pytest.mark.parametrize("heading_is_valid", [False, True])
@pytest.mark.parametrize(
    ("solution_bits", "carrier"), [(0, GnssFix.NONE), (1, GnssFix.FLOAT), (2, GnssFix.FIXED)]
)
def test_carrier_phase_solution_is_told_by_bits_6_and_7_alone(
    solution_bits: int, carrier: Any, heading_is_valid: bool
) -> None:
    """UBX-NAV-PVT, flags: carrSoln in bits 7 and 6, headVehValid in bit 5, gnssFixOK in bit 0."""
    flags = solution_bits << 6 | heading_is_valid << 5 | 1
    data = solution(START_NS, flags=flags, headVeh=123.0)
    (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
    assert sample.message.carrier == carrier
    assert sample.message.HasField("heading_vehicle_deg") == heading_is_valid


@pytest.mark.parametrize("known", [(), ("Roll",), ("Heading",), ("Pitch", "Heading")])
def test_angle_is_known_where_its_own_accuracy_is(known: tuple[str, ...]) -> None:
    """UBX-NAV-ATT: an accuracy of zero means that the angle is not known."""
    fields = {"iTOW": START_NS % WEEK_NS // MS, "roll": 1.0, "pitch": 2.0, "heading": 3.0}
    accuracies = {f"acc{name}": 0.5 if name in known else 0.0 for name in ("Roll", "Pitch")}
    accuracies["accHeading"] = 0.5 if "Heading" in known else 0.0
    data = ubx.encode("NAV-ATT", fields | accuracies)
    (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_ATTITUDE)
    told = {name for name in ("Roll", "Pitch", "Heading")
            if sample.message.HasField(f"{name.lower()}_deg")}  # fmt: skip
    assert told == set(known)


def test_covariance_of_the_same_epoch_is_used_and_turned_to_east_north_up() -> None:
    itow = START_NS % WEEK_NS // MS
    values = dict(zip(("NN", "NE", "ND", "EE", "ED", "DD"), (4, 1, 0.5, 9, 0.25, 16), strict=True))
    fields = {f"posCov{axes}": value for axes, value in values.items()}
    cov = ubx.encode("NAV-COV", {"iTOW": itow, "posCovValid": 1, **fields})
    bridge = GnssBridge(VEHICLE)
    out = bridge.step(raw(cov + solution(START_NS) + solution(START_NS + S), BOOT_NS))
    first, second = (sample.message for sample in on(out, keys.GNSS_LOCATION))
    assert first.position_covariance_type == LocationFix.KNOWN
    C_enu_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    ned = np.array([[4, 1, 0.5], [1, 9, 0.25], [0.5, 0.25, 16]])
    expected = C_enu_ned @ ned @ C_enu_ned.T
    np.testing.assert_array_equal(np.reshape(first.position_covariance, (3, 3)), expected)
    assert second.position_covariance_type == LocationFix.DIAGONAL_KNOWN


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 90.0, 120.0])
def test_error_ellipse_of_the_receiver_points_where_it_does(azimuth_deg: float) -> None:
    """3 m along an azimuth, 1 m across, 5 m in height, in the bytes of the interface description.

    u-blox F9 HPG 1.32, UBX-22008968, section 3.15.1 (UBX-NAV-COV): iTOW, version, two validity
    flags, nine reserved bytes, then NN, NE, ND, EE, ED, DD of the position, of the velocity.
    """
    azimuth = np.deg2rad(azimuth_deg)
    along_ned = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    across_ned = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    ned = 9.0 * np.outer(along_ned, along_ned) + np.outer(across_ned, across_ned)
    ned[2, 2] = 25.0
    itow = START_NS % WEEK_NS // MS
    payload = struct.pack("<IBBB9x12f", itow, 0, 1, 0, *ned[np.triu_indices(3)], *[0.0] * 6)
    out = GnssBridge(VEHICLE).step(raw(ubx_frame(0x0136, payload) + solution(START_NS), BOOT_NS))
    (location,) = (sample.message for sample in on(out, keys.GNSS_LOCATION))
    enu = np.reshape(location.position_covariance, (3, 3))
    along_enu = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    across_enu = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    up_enu = np.array([0.0, 0.0, 1.0])
    variances = [axis @ enu @ axis for axis in (along_enu, across_enu, up_enu)]
    assert variances == pytest.approx([9.0, 1.0, 25.0], rel=1e-6)
    np.testing.assert_allclose(enu @ along_enu, 9.0 * along_enu, atol=1e-5)


@pytest.mark.parametrize(
    "changes",
    [
        {"flags": 0}, {"fixType": 0}, {"fixType": 1}, {"fixType": 5}, {"fixType": 77},
        {"flags3": 1}, {"hAcc": 100_001}, {"lat": 91.0},
    ],
)  # fmt: skip
def test_invalid_fix_has_no_location(changes: dict[str, Any]) -> None:
    out = GnssBridge(VEHICLE).step(raw(solution(START_NS, **changes), BOOT_NS))
    assert [sample.key for sample in out] == [keys.GNSS_FIX]
    assert not out[0].message.valid


def test_epoch_with_both_solutions_is_published_once_and_attitude_is_kept() -> None:
    pvat = solution(START_NS, "NAV-PVAT", flags=0x39, vehRoll=1.5, vehPitch=-2.5, vehHeading=180)
    out = GnssBridge(VEHICLE).step(raw(solution(START_NS) + pvat, BOOT_NS))
    assert [sample.message.source for sample in on(out, keys.GNSS_FIX)] == ["NAV-PVT"]
    attitude = on(out, keys.GNSS_ATTITUDE)[0].message
    assert (attitude.roll_deg, attitude.pitch_deg, attitude.heading_deg) == (1.5, -2.5, 180.0)
    out = GnssBridge(VEHICLE).step(raw(pvat + solution(START_NS), BOOT_NS))
    assert [sample.message.source for sample in on(out, keys.GNSS_FIX)] == ["NAV-PVAT"]


def test_high_rate_solution_is_a_fix_only_until_navigation_is_seen() -> None:
    bridge = GnssBridge(VEHICLE)
    reads = [
        (solution(START_NS + k * S // 10, "HNR-PVT"), BOOT_NS + k * S // 10) for k in (1, 2, 3)
    ]
    reads.append((solution(START_NS), BOOT_NS + 3 * S // 10))  # an older epoch comes later
    reads.append((solution(START_NS + 4 * S // 10, "HNR-PVT"), BOOT_NS + 4 * S // 10))
    reads.append((solution(START_NS + S), BOOT_NS + 13 * S // 10))
    out = step_all(bridge, reads)
    fixes = on(out, keys.GNSS_FIX)
    assert [f.message.source for f in fixes] == ["HNR-PVT"] * 3 + ["NAV-PVT"]
    high_rate = on(out, keys.GNSS_HIGH_RATE)
    assert [f.message.source for f in high_rate] == ["HNR-PVT"]
    assert high_rate[0].message.gps_time_ns == START_NS + 4 * S // 10
    assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(fixes))


def test_receiver_that_talks_both_is_published_once() -> None:
    sentences = b"".join(
        nmea_frame(f"GN{text}")
        for k in range(5)
        for text in (
            f"RMC,10000{k}.00,A,5000.0,N,01400.0,E,0.0,,010225,,,A",
            f"GGA,10000{k}.00,5000.0,N,01400.0,E,1,12,1.0,200.0,M,45.0,M,,",
        )
    )
    sources = lambda data: Counter(  # noqa: E731
        f.message.source for f in on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
    )
    assert sources(sentences) == {"NMEA": 5}
    assert sources(solution(START_NS) + sentences) == {"NAV-PVT": 1}


def test_better_solution_takes_over_from_a_date_in_the_future() -> None:
    texts = ("GNRMC,100000.00,V,,,,,,,010250,,,N", "GNGGA,100001.00,,,,,0,,,,,,,,")
    sentences = b"".join(map(nmea_frame, texts))
    out = GnssBridge(VEHICLE).step(raw(sentences + solution(START_NS), BOOT_NS))
    assert [f.message.source for f in on(out, keys.GNSS_FIX)] == ["NMEA", "NAV-PVT"]


def test_leap_seconds_only_where_valid() -> None:
    bridge = GnssBridge(VEHICLE)
    fields = {"iTOW": 1000, "week": WEEK, "leapS": LEAP_S}
    for valid, expected in ((3, False), (7, True)):
        out = bridge.step(raw(ubx.encode("NAV-TIMEGPS", {**fields, "valid": valid}), BOOT_NS))
        assert out[0].message.gps_time_ns == WEEK * WEEK_NS + S
        assert out[0].message.HasField("leap_seconds") is expected
    for valid, expected in ((0, False), (1, True)):
        fields = {"iTOW": 1000, "currLs": LEAP_S, "valid": valid}
        out = bridge.step(raw(ubx.encode("NAV-TIMELS", fields), BOOT_NS))
        assert out[0].message.HasField("leap_seconds") is expected
        assert not out[0].message.HasField("next_leap_in_s")


def test_unknown_frames_go_out_whole() -> None:
    data = ubx_frame(0x0134, b"abc") + ubx_frame(0x7F01, b"x") + ubx.encode("MON-VER")
    out = GnssBridge(VEHICLE).step(raw(data + ubx_frame(0x0A04, b""), BOOT_NS))
    assert [(s.message.name, len(s.message.payload)) for s in out] == [
        ("NAV-ORB", 3), ("7F-01", 1), ("MON-VER", 40), ("MON-VER", 0),
    ]  # fmt: skip
    assert {s.key for s in out} == {keys.GNSS_FRAME}
    assert {s.stamp_ns for s in out} == {BOOT_NS}  # arrival, as the key says


def test_pulse_sensors_and_subframes_are_stamped_with_their_arrival() -> None:
    gyro_z = (-4096 & 0xFFFFFF) | 5 << 24
    backward_ticks = 0x800000 | 7 | 8 << 24
    data = (
        solution(START_NS)
        + ubx.encode("TIM-TP", {"towMS": 5, "towSubMS": 0.5, "week": WEEK, "qErr": -9})
        + ubx.encode("ESF-MEAS", {"timeTag": 77, "flags": 2 << 11}, [[gyro_z], [backward_ticks]])
        + ubx.encode("RXM-SFRBX", {"svId": 3}, [[1], [0xFFFFFFFF]])
    )
    out = GnssBridge(VEHICLE).step(raw(data, BOOT_NS))[2:]
    assert [s.key for s in out] == [
        keys.GNSS_PULSE, keys.GNSS_ESF_MEASUREMENTS, keys.GNSS_SUBFRAME,
    ]  # fmt: skip
    assert {s.stamp_ns for s in out} == {BOOT_NS}
    pulse, esf, subframe = (s.message for s in out)
    assert (pulse.tow_sub_ms, pulse.quantisation_ps, pulse.quantisation_valid) == (0.5, -9, True)
    assert [(i.type, i.raw, i.value, i.unit) for i in esf.items] == [
        (5, -4096, -1.0, "deg/s"),
        (8, 0x800007 - 0x1000000, -7.0, "ticks"),
    ]
    assert list(subframe.words) == [1, 0xFFFFFFFF]


def test_refused_payload_is_counted_and_nothing_is_lost_behind_it() -> None:
    short = ubx_frame(0x0107, solution(START_NS)[6:-11])
    esf = ubx.encode("ESF-MEAS", {"flags": 3 << 11}, [[1]])  # says three, has one
    bridge = GnssBridge(VEHICLE)
    out = bridge.step(raw(short + esf + solution(START_NS), BOOT_NS))
    assert len(on(out, keys.GNSS_FIX)) == 1
    counters = bridge.device_counters()
    assert counters["rejected_by_reason"] == {"UBX length": 1, "ESF-MEAS count": 1}
    assert counters["frames_rejected"] == 2
    assert counters["bytes_rejected"] == len(short)
    assert counters["messages_decoded"] == 1
    assert all(ledger.balanced for ledger in bridge.ledgers())


def test_bridge_without_a_receiver_in_the_configuration_says_so() -> None:
    with pytest.raises(ConfigError, match=r"\$\.gnss"):
        GnssBridge(Vehicle(vehicle="t"))


# cuts, memory ----------------------------------------------------------------------------------


def mixed_stream() -> bytes:
    parts = [
        b"# header\n",
        nmea_frame("GNGGA,100000.00,5000.0,N,01400.0,E,1,12,1.0,200.0,M,45.0,M,,"),
    ]
    for k in range(6):
        gps_ns = START_NS + k * S
        itow = gps_ns % WEEK_NS // MS
        parts += [
            solution(gps_ns), ubx.encode("NAV-COV", {"iTOW": itow, "posCovValid": 1}),
            ubx.encode("NAV-SAT", {"iTOW": itow}, [{"svId": k, "prRes": -1.5}] * k),
            rtcm3_frame(b"\x43\x50abc"), b"\xb5\x62\x01\x07", solution(gps_ns, "NAV-PVAT")[:50],
            nmea_frame(f"GNRMC,10000{k}.00,A,5000.0,N,01400.0,E,0.0,,010225,,,A"),
        ]  # fmt: skip
    return b"".join(parts)


@settings(max_examples=60)
@given(st.lists(st.integers(1, 900), min_size=1, max_size=30), st.integers(0, 30))
def test_cuts_and_restarts_change_stamps_only(sizes: list[int], moved_at: int) -> None:
    data = mixed_stream()
    whole = content(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)))
    bridge, at, out = GnssBridge(VEHICLE), 0, []
    for count, size in enumerate([*sizes, len(data)]):
        if count == moved_at:
            state, bridge = bridge.snapshot(), GnssBridge(VEHICLE)
            bridge.restore(state)
        out += bridge.step(raw(data[at : at + size], BOOT_NS + count * MS))
        at += size
    assert content(out) == whole


def test_restored_bridge_goes_on_with_the_same_stamps() -> None:
    reads = ride(60, lambda i: i * 7919 % 13 * MS)
    whole = step_all(GnssBridge(VEHICLE), reads)
    first = GnssBridge(VEHICLE)
    out = step_all(first, reads[:31])
    second = GnssBridge(VEHICLE)
    second.restore(first.snapshot())
    assert out + step_all(second, reads[31:]) == whole


def test_reads_within_a_message_give_the_arrival_of_each_frame() -> None:
    frame = ubx_frame(0x7F01, b"abcd")
    data = frame * 3
    message = RawBytes(
        stamp_ns=BOOT_NS, data=data, read_length=[5, 12, 19], read_offset_ns=[0, 10 * MS, 30 * MS]
    )
    out = GnssBridge(VEHICLE).step(Sample(keys.GNSS_BYTES, message, BOOT_NS, 1))
    assert [s.stamp_ns - BOOT_NS for s in out] == [10 * MS, 30 * MS, 30 * MS]


@pytest.mark.parametrize(
    ("lengths", "offsets"),
    [([5], [0]), ([5, 500], [0, 1]), ([5], [0, 1]), ([0, 0], [2**64 - 1, 0]), ([2**32 - 1], [5])],
)
def test_reads_that_do_not_add_up_are_no_catastrophe(
    lengths: list[int], offsets: list[int]
) -> None:
    data = solution(START_NS)
    message = RawBytes(stamp_ns=BOOT_NS, data=data, read_length=lengths, read_offset_ns=offsets)
    bridge = GnssBridge(VEHICLE)
    assert len(bridge.step(Sample(keys.GNSS_BYTES, message, BOOT_NS, 1))) == 2
    assert bridge.step(raw(b"", BOOT_NS + S)) == []


# time --------------------------------------------------------------------------------------------


def test_stamps_are_the_epochs_on_the_vehicle_clock() -> None:
    """Arrivals jitter by 40 ms above the delay; the stamps do not."""
    rng = np.random.default_rng(3)
    waits = (rng.exponential(0.01, 300).clip(0, 0.04) * S).astype(int)
    fixes = on(step_all(GnssBridge(VEHICLE), ride(300, lambda i: int(waits[i]))), keys.GNSS_FIX)
    errors_ns = np.array([f.stamp_ns - BOOT_NS - i * S // 5 for i, f in enumerate(fixes)])
    assert np.abs(errors_ns[25:]).max() < 2 * MS
    assert np.diff([f.stamp_ns for f in fixes]).min() > 0


def test_stamps_follow_a_crystal_that_is_off() -> None:
    skew = 30e-6
    fixes = on(step_all(GnssBridge(VEHICLE), ride(400, skew=skew)), keys.GNSS_FIX)
    truth = BOOT_NS + np.arange(400) * (S // 5) * (1 + skew)
    errors_ns = np.array([f.stamp_ns for f in fixes]) - truth
    assert np.abs(errors_ns[50:]).max() < 0.2 * MS


def test_first_message_without_time_is_stamped_arrival_less_delay() -> None:
    attitude = ubx.encode("NAV-ATT", {"iTOW": 5000})
    out = GnssBridge(VEHICLE).step(raw(attitude, BOOT_NS))
    assert out[0].stamp_ns == BOOT_NS - round(DELAY_S * S)
    out = GnssBridge(VEHICLE).step(raw(solution(START_NS, valid=0), 5))
    assert out[0].stamp_ns == 0  # not before the clock's beginning
    assert not out[0].message.HasField("gps_time_ns")


def test_messages_of_one_epoch_share_its_stamp() -> None:
    itow = START_NS % WEEK_NS // MS
    bridge = GnssBridge(VEHICLE)
    out = bridge.step(raw(solution(START_NS), BOOT_NS))
    out += bridge.step(raw(ubx.encode("NAV-SAT", {"iTOW": itow}), BOOT_NS + 40 * MS))
    assert len({sample.stamp_ns for sample in out}) == 1


@pytest.mark.parametrize("offset_ns", [-422_154, -1, 0, 183_620])
def test_negative_and_positive_nano_give_the_true_epoch(offset_ns: int) -> None:
    out = GnssBridge(VEHICLE).step(raw(solution(START_NS + offset_ns), BOOT_NS))
    assert out[0].message.gps_time_ns == START_NS + offset_ns
    assert out[0].message.utc_ns == START_NS + offset_ns + (GPS_EPOCH_UNIX_S - LEAP_S) * S


def test_week_rolls_over_between_two_epochs() -> None:
    end_ns = (WEEK + 1) * WEEK_NS
    bridge = GnssBridge(VEHICLE)
    times = []
    for k in range(-5, 5):
        gps_ns = end_ns + k * S // 5
        data = ubx.encode("NAV-SAT", {"iTOW": gps_ns % WEEK_NS // MS}) + solution(gps_ns)
        out = bridge.step(raw(data, BOOT_NS + k * S // 5))
        times.append(on(out, keys.GNSS_FIX)[0].message.gps_time_ns - gps_ns)
        stamps = {sample.stamp_ns for sample in out}
        assert max(stamps) - min(stamps) < 150 * MS  # the first epoch's NAV-SAT has no time yet
        if k > -5:
            assert len(stamps) == 1
    assert times == [0] * 10
    assert bridge.clock.fit.restarts == 0


def test_delay_of_an_epoch_is_that_of_its_first_message() -> None:
    """What follows in the burst waited for it: 50 ms that are no delay of the receiver's clock."""
    bridge = GnssBridge(VEHICLE)
    for number in range(200):
        gps_ns = START_NS + number * S // 5
        arrival_ns = BOOT_NS + number * S // 5 + round(DELAY_S * S + 100 * BYTE_NS)
        bridge.step(raw(solution(gps_ns), arrival_ns))
        rest = ubx.encode("NAV-EOE", {"iTOW": gps_ns % WEEK_NS // MS})
        bridge.step(raw(rest, arrival_ns + 50 * MS))
    assert bridge.device_counters()["clock_residual_s"] == pytest.approx(0.0, abs=1e-3)


@given(st.integers(1000 * WEEK_NS, 3000 * WEEK_NS), st.integers(0, WEEK_NS - 1))
def test_time_of_week_is_that_of_the_week_that_is_nearest(reference_ns: int, tow_ns: int) -> None:
    timeline = GpsTimeline()
    timeline.reference_ns = reference_ns
    found_ns = timeline.near(tow_ns)
    assert found_ns is not None
    assert found_ns % WEEK_NS == tow_ns
    assert abs(found_ns - reference_ns) <= WEEK_NS // 2


@pytest.mark.parametrize("jump_s", [-3600, -10, -0.6, 0.6, 10, 3600, 7 * 86400])
def test_receiver_whose_time_jumps_recovers(jump_s: float) -> None:
    bridge = GnssBridge(VEHICLE)
    fixes = on(step_all(bridge, ride(50)), keys.GNSS_FIX)
    for i in range(50, 120):
        gps_ns = START_NS + i * S // 5 + round(jump_s * S)
        arrival_ns = BOOT_NS + i * S // 5 + round(DELAY_S * S + 100 * BYTE_NS)
        fixes += on(bridge.step(raw(solution(gps_ns), arrival_ns)), keys.GNSS_FIX)
    assert len(fixes) == 120
    errors_ns = [abs(f.stamp_ns - BOOT_NS - i * S // 5) for i, f in enumerate(fixes)]
    assert max(errors_ns[:50]) < MS
    if abs(jump_s) > 1:
        assert max(errors_ns[60:]) < 5 * MS
    if jump_s > 0:
        assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(fixes))


def test_stall_of_the_host_does_not_move_stamps() -> None:
    """Twenty epochs arrive at once after 4 s: they keep their own epochs."""
    reads = ride(100)
    stalled_ns = reads[60][1]
    reads = [(data, stalled_ns if 40 <= i < 60 else t) for i, (data, t) in enumerate(reads)]
    fixes = on(step_all(GnssBridge(VEHICLE), reads), keys.GNSS_FIX)
    stamps = np.array([f.stamp_ns for f in fixes])
    assert np.diff(stamps).min() > 0
    errors_ns = np.abs(stamps - BOOT_NS - np.arange(100) * (S // 5))
    assert errors_ns[70:].max() < 5 * MS


def test_silence_as_long_as_a_tunnel_is_bridged() -> None:
    reads = ride(900)
    fixes = on(step_all(GnssBridge(VEHICLE), reads[:100] + reads[700:]), keys.GNSS_FIX)
    expected = [*range(100), *range(700, 900)]
    errors_ns = [f.stamp_ns - BOOT_NS - i * S // 5 for i, f in zip(expected, fixes, strict=True)]
    assert max(map(abs, errors_ns)) < MS


def test_arrivals_that_go_back_or_spike_do_not_stop_the_fixes() -> None:
    reads = ride(60)
    reads[30] = (reads[30][0], reads[30][1] + 3600 * S)
    reads[40] = (reads[40][0], 0)
    fixes = on(step_all(GnssBridge(VEHICLE), reads), keys.GNSS_FIX)
    assert len(fixes) == 60
    assert fixes[-1].stamp_ns == pytest.approx(BOOT_NS + 59 * S // 5, abs=MS)


def test_nmea_is_stamped_by_a_fit_of_its_own() -> None:
    bridge = GnssBridge(VEHICLE)
    fixes = []
    for k in range(50):
        text = f"1000{k:02d}.00,5000.0,N,01400.0,E,1,12,1.0,200.0,M,45.0,M,,"
        data = nmea_frame(f"GNGGA,{text}")
        wait_ns = 0 if k % 5 == 0 else 30 * MS
        arrival_ns = BOOT_NS + k * S + round(DELAY_S * S + len(data) * BYTE_NS) + wait_ns
        fixes += on(bridge.step(raw(data, arrival_ns)), keys.GNSS_FIX)
    errors_ns = [f.stamp_ns - BOOT_NS - i * S for i, f in enumerate(fixes)]
    assert len(fixes) == 50
    assert max(map(abs, errors_ns[10:])) < 3 * MS
    assert not any(f.message.HasField("gps_time_ns") for f in fixes)


def test_utc_of_impossible_dates_is_unknown() -> None:
    assert utc_ns(2025, 1, 1, 0, 0, 0, -5) == 1_735_689_600 * S - 5
    for wrong in ((2025, 13, 1), (2025, 2, 30), (65535, 1, 1), (0, 0, 0)):
        assert utc_ns(*wrong, 0, 0, 0, 0) == 0


# dirt ------------------------------------------------------------------------------------------


@settings(max_examples=200)
@given(st.lists(st.binary(max_size=200), max_size=6))
def test_random_bytes_never_raise(pieces: list[bytes]) -> None:
    bridge = GnssBridge(VEHICLE)
    for piece in pieces:
        bridge.step(raw(piece, BOOT_NS))
        assert all(ledger.balanced for ledger in bridge.ledgers())


@pytest.mark.parametrize("seed", range(3))
def test_mutated_frames_with_good_checksums_never_raise(seed: int) -> None:
    """Payload bytes and lengths of every message type are changed and the checksum made good."""
    rng = np.random.default_rng(seed)
    bridge = GnssBridge(VEHICLE)
    for layout in LAYOUTS:
        for _ in range(60):
            groups = int(rng.integers(0, 4)) if layout.group else 0
            size = layout.fixed.size + groups * layout.repeated.size
            payload = bytearray(
                rng.choice([bytes(size), b"\xff" * size, rng.bytes(size)]).ljust(size, b"\0")
            )
            if layout.count:
                payload[layout.limit.count_at] = groups
            for _ in range(int(rng.integers(0, 3))):
                if payload:
                    payload[int(rng.integers(len(payload)))] = int(rng.integers(256))
            if rng.random() < 0.1:
                del payload[int(rng.integers(len(payload) + 1)) :]
            out = bridge.step(raw(ubx_frame(layout.kind, bytes(payload)), BOOT_NS))
            for sample in out:
                sample.message.SerializeToString()
    assert all(ledger.balanced for ledger in bridge.ledgers())
    out = step_all(bridge, ride(30))  # and it still works
    assert on(out, keys.GNSS_FIX)[-1].message.valid


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_mutated_captures_with_good_checksums_never_raise(data_dir: Path, name: str) -> None:
    rng = np.random.default_rng(1)
    bridge = GnssBridge(VEHICLE)
    for item in Framer().feed((data_dir / "ubx" / name).read_bytes()[:150_000]):
        if isinstance(item, Frame) and item.protocol == UBX:
            payload = bytearray(item.payload)
            for at in rng.integers(0, max(len(payload), 1), 2) if payload else ():
                payload[int(at)] = int(rng.integers(256))
            bridge.step(raw(ubx_frame(item.kind, bytes(payload)), BOOT_NS))
        elif isinstance(item, Frame) and item.raw[0] == ord("$"):
            words = bytearray(item.payload)
            words[int(rng.integers(6, len(words)))] = int(rng.integers(0x20, 0x7F))
            text = words.decode("ascii").replace("*", "").replace("$", "")
            bridge.step(raw(nmea_frame(text), BOOT_NS))
    assert all(ledger.balanced for ledger in bridge.ledgers())


# real receivers ----------------------------------------------------------------------------------


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_captures_cut_anywhere_give_the_same_messages(data_dir: Path, name: str) -> None:
    data = (data_dir / "ubx" / name).read_bytes()[:200_000]
    whole = content(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)))
    bridge, out = GnssBridge(VEHICLE), []
    edges = np.sort(np.random.default_rng(5).integers(0, len(data), 500)).tolist()
    for count, (a, b) in enumerate(zip([0, *edges], [*edges, len(data)], strict=True)):
        out += bridge.step(raw(data[a:b], BOOT_NS + count * 50 * MS))
    assert content(out) == whole
    assert all(ledger.balanced for ledger in bridge.ledgers())
    stamps = [sample.stamp_ns for sample in on(out, keys.GNSS_FIX)]
    assert all(a < b for a, b in itertools.pairwise(stamps))


def gpsd_positions(path: Path) -> dict[int, list[dict[str, float]]]:
    """gpsd's TPV reports with a position, by UTC in milliseconds."""
    reports: dict[int, list[dict[str, float]]] = {}
    for line in path.read_text(errors="replace").splitlines():
        if line.startswith('{"class":"TPV"'):
            report = json.loads(line)
            if "lat" in report and "time" in report:
                when = round(datetime.fromisoformat(report["time"]).timestamp() * 1000)
                reports.setdefault(when, []).append(report)
    return reports


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "source", "matched", "atol_deg", "atol_m"),
    [
        # gpsd reports the NMEA position of the same second (5 digits of minutes) as well
        ("ublox-zed-f9r.log", "NAV-PVT", 29, 1.01 * LAST_DIGIT_DEG, 0.1),
        ("ublox-neo-m8l.log", "HNR-PVT", 189, 1e-9, 1e-3),
        ("ublox-8.log", "NMEA", 72, 1e-9, 1e-3),
        ("ublox-zed-f9p-nmea.log", "NMEA", 29, 1e-9, 1e-3),
        ("ublox-zed-f9p_hpg1.11.log", "NMEA", 654, 1e-9, 1e-3),
    ],
)
def test_positions_are_those_that_gpsd_reports(
    data_dir: Path, name: str, source: str, matched: int, atol_deg: float, atol_m: float
) -> None:
    path = data_dir / "ubx" / name
    reports = gpsd_positions(path.with_name(name + ".chk"))
    data = path.read_bytes()
    if source == "HNR-PVT":  # which is a fix only where there is no NAV-PVT
        frames = [f for f in Framer().feed(data) if isinstance(f, Frame) and f.name != "NAV-PVT"]
        data = b"".join(f.raw for f in frames)
    fixes = [s.message for s in on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)]
    pairs = [(f, reports[round(f.utc_ns / MS)]) for f in fixes if round(f.utc_ns / MS) in reports]
    assert {f.source for f in fixes} == {source}
    assert len(pairs) == matched
    for fix, candidates in pairs:
        best = min(candidates, key=lambda r: distance_deg(fix, r))
        assert distance_deg(fix, best) <= atol_deg
        heights = [r["altHAE"] for r in candidates if "altHAE" in r]
        assert min(abs(h - fix.height_ellipsoid_m) for h in heights) <= atol_m


def distance_deg(fix: GnssFix, report: dict[str, float]) -> float:
    return max(abs(fix.latitude_deg - report["lat"]), abs(fix.longitude_deg - report["lon"]))


@pytest.mark.realdata
def test_pseudoranges_are_those_that_gpsd_reports(data_dir: Path) -> None:
    name = "ublox-zed-f9p_hpg1.11.log"
    lines = (data_dir / "ubx" / f"{name}.chk").read_text(errors="replace").splitlines()
    reports = [json.loads(line) for line in lines if line.startswith('{"class":"RAW"')]
    out = GnssBridge(VEHICLE).step(raw((data_dir / "ubx" / name).read_bytes()[:40_000], BOOT_NS))
    epochs = [sample.message for sample in on(out, keys.GNSS_MEASUREMENTS)]
    assert len(epochs) >= 10
    for epoch, report in zip(epochs, reports, strict=False):
        theirs = {(m["gnssid"], m["svid"], m["pseudorange"]) for m in report["rawdata"]}
        for m in epoch.measurements:
            assert any(
                (g, s) == (m.gnss_id, m.sv_id) and abs(p - m.pseudorange_m) < US / S
                for g, s, p in theirs
            )  # fmt: skip


# epoch times for import ------------------------------------------------------------------------


def test_epoch_times_know_the_week_before_it_is_told() -> None:
    itow = START_NS % WEEK_NS // MS
    early = ubx.encode("NAV-ATT", {"iTOW": itow - 1000})
    data = b"# text\n" + early + solution(START_NS)
    assert epoch_times(data) == [
        (7 + len(early), START_NS - S),
        (len(data), START_NS),
    ]
    assert unix_like_ns(START_NS) == START_NS + 315_964_800 * S


def test_epoch_times_of_nmea_use_the_leap_seconds_of_the_date() -> None:
    data = b"".join(
        nmea_frame(f"GNRMC,10000{k}.00,A,5000.0,N,01400.0,E,0.0,,010225,,,A") for k in range(3)
    )
    times = epoch_times(data)
    utc = utc_ns(2025, 2, 1, 10, 0, 0, 0)
    assert [gps_ns for _, gps_ns in times] == [
        utc + (LEAP_S - GPS_EPOCH_UNIX_S + k) * S for k in range(3)
    ]
    assert [end for end, _ in times] == [len(data) * (k + 1) // 3 for k in range(3)]


@pytest.mark.realdata
@pytest.mark.parametrize("name", CAPTURES)
def test_epoch_times_of_captures_go_forward_in_order(data_dir: Path, name: str) -> None:
    data = (data_dir / "ubx" / name).read_bytes()
    times = epoch_times(data)
    ends, gps = [end for end, _ in times], [gps_ns for _, gps_ns in times]
    assert len(times) >= 29
    assert ends == sorted(ends)
    assert ends[-1] <= len(data)
    assert gps == sorted(gps)
    assert gps[-1] - gps[0] < 3600 * S


# What is not believed ----------------------------------------------------------------------------


def test_place_at_zero_zero_is_none() -> None:
    for name in ("NAV-PVT", "NAV-PVAT", "HNR-PVT"):
        data = solution(START_NS, name, lat=0.0, lon=0.0)
        (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
        assert sample.message.invalid_llh
        assert not sample.message.valid
    (sample,) = on(
        GnssBridge(VEHICLE).step(raw(solution(START_NS, lat=0.0, lon=1e-7), BOOT_NS)), keys.GNSS_FIX
    )
    assert sample.message.valid


def covariance_of(**changes: float) -> bytes:
    fields = {f"{what}Cov{axes}": 1.0 for what in ("pos", "vel") for axes in ("NN", "EE", "DD")}
    fields |= {"iTOW": START_NS % WEEK_NS // MS, "posCovValid": 1, "velCovValid": 1}
    return ubx.encode("NAV-COV", fields | changes)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, -1.0, 0.0])
@pytest.mark.parametrize("axes", ["NN", "EE", "DD"])
def test_variance_that_cannot_be_makes_no_covariance(axes: str, wrong: float) -> None:
    data = covariance_of(**{f"posCov{axes}": wrong}) + solution(START_NS)
    out = GnssBridge(VEHICLE).step(raw(data, BOOT_NS))
    (covariance,), (location,) = on(out, keys.GNSS_COVARIANCE), on(out, keys.GNSS_LOCATION)
    assert (covariance.message.position_valid, covariance.message.velocity_valid) == (False, True)
    assert np.isfinite(covariance.message.position_m2).all()
    assert location.message.position_covariance_type == LocationFix.DIAGONAL_KNOWN
    assert np.isfinite(location.message.position_covariance).all()
    assert location.message.position_covariance[0] == pytest.approx(0.9**2 / 2)


@pytest.mark.parametrize("correlation", [np.nan, np.inf, 1.5, -1.01])
@pytest.mark.parametrize("axes", ["NE", "ND", "ED"])
def test_correlation_beyond_one_makes_no_covariance(axes: str, correlation: float) -> None:
    data = covariance_of(**{f"posCov{axes}": correlation}) + solution(START_NS)
    out = GnssBridge(VEHICLE).step(raw(data, BOOT_NS))
    (location,) = on(out, keys.GNSS_LOCATION)
    assert location.message.position_covariance_type == LocationFix.DIAGONAL_KNOWN


@pytest.mark.parametrize("name", ["NAV-PVT", "NAV-PVAT"])
def test_solution_that_comes_twice_an_epoch_is_one_fix(name: str) -> None:
    reads = [
        (2 * solution(START_NS + k * S // 5, name, hAcc=900 + k), BOOT_NS + k * S // 5)
        for k in range(10)
    ]
    fixes = on(step_all(GnssBridge(VEHICLE), reads), keys.GNSS_FIX)
    assert [fix.message.itow_ms for fix in fixes] == [
        (START_NS + k * S // 5) % WEEK_NS // MS for k in range(10)
    ]
    assert len({fix.stamp_ns for fix in fixes}) == 10


def test_time_of_week_that_stands_still_hides_no_fix() -> None:
    """A receiver that knows no time sends the same one; the same bytes tell the same again."""
    bridge = GnssBridge(VEHICLE)
    reads = [solution(START_NS, iTOW=0, valid=0, hAcc=900 + k // 2) for k in range(6)]
    out = [s for k, data in enumerate(reads) for s in bridge.step(raw(data, BOOT_NS + k * S))]
    assert [round(1000 * s.message.horizontal_std_m) for s in on(out, keys.GNSS_FIX)] == [
        900, 901, 902,
    ]  # fmt: skip


def test_same_time_of_week_a_week_later_is_another_epoch() -> None:
    reads = [(solution(START_NS + k * WEEK_NS), BOOT_NS + k * WEEK_NS) for k in range(3)]
    assert len(on(step_all(GnssBridge(VEHICLE), reads), keys.GNSS_FIX)) == 3


@pytest.mark.parametrize("year", [1980, 1994])
def test_date_before_gps_was_complete_is_no_time(year: int) -> None:
    data = solution(START_NS, year=year, month=1, day=6, hour=0, min=0, sec=12)
    (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
    assert sample.message.utc_ns == 0
    assert not sample.message.HasField("gps_time_ns")


ROLLOVER_NS = 1024 * WEEK_NS


@pytest.mark.parametrize("times", [1, 2])
def test_week_that_has_overflown_is_known_by_the_leap_seconds(times: int) -> None:
    behind_ns = START_NS - times * ROLLOVER_NS
    if times == 2:  # 1984: no date at all
        assert behind_ns < 15 * 365 * 86_400 * S
    bridge = GnssBridge(VEHICLE)
    leap = {"iTOW": 1000, "currLs": LEAP_S, "valid": 1}
    bridge.step(raw(ubx.encode("NAV-TIMELS", leap), BOOT_NS))
    (sample,) = on(bridge.step(raw(solution(behind_ns), BOOT_NS)), keys.GNSS_FIX)
    if times == 1:
        assert sample.message.gps_time_ns == START_NS
        assert sample.message.utc_ns == START_NS + (GPS_EPOCH_UNIX_S - LEAP_S) * S
    else:
        assert not sample.message.HasField("gps_time_ns")


def test_week_that_has_overflown_is_known_by_a_clock_that_knows_the_year() -> None:
    now_ns = START_NS + GPS_EPOCH_UNIX_S * S
    texts = (
        "RMC,{t},A,5000.0,N,01400.0,E,0.0,,{d},,,A",
        "GGA,{t},5000.0,N,01400.0,E,1,12,1.0,2.0,M,4.0,M,,",
    )
    for arrival_ns, behind in ((now_ns, 0), (5 * S, ROLLOVER_NS)):  # of one that nobody has set
        bridge = GnssBridge(VEHICLE)
        old = receivers.sol(START_NS - ROLLOVER_NS)
        out = bridge.step(raw(old, arrival_ns)) + bridge.finish()
        (sample,) = on(out, keys.GNSS_FIX)
        assert sample.message.gps_time_ns == START_NS - behind
        utc = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(
            seconds=(START_NS - ROLLOVER_NS) // S - LEAP_S
        )
        time, date = utc.strftime("%H%M%S.00"), utc.strftime("%d%m%y")
        data = b"".join(nmea_frame("GN" + text.format(t=time, d=date)) for text in texts)
        bridge = GnssBridge(VEHICLE)
        out = bridge.step(raw(data, arrival_ns)) + bridge.finish()
        (sample,) = on(out, keys.GNSS_FIX)
        assert sample.message.utc_ns == START_NS - behind + (GPS_EPOCH_UNIX_S - LEAP_S) * S


def test_week_that_has_overflown_is_known_by_what_the_receiver_sends() -> None:
    """No leap seconds, and a clock that nobody has set: NAV-PVT is no older than u-blox 7."""
    told_ns = START_NS - ROLLOVER_NS
    time_gps = {"week": told_ns // WEEK_NS, "iTOW": told_ns % WEEK_NS // MS, "valid": 3}
    data = solution(told_ns) + ubx.encode("NAV-TIMEGPS", time_gps) + solution(told_ns + S)
    out = GnssBridge(VEHICLE).step(raw(data, 5 * S))
    fixes = [sample.message for sample in on(out, keys.GNSS_FIX)]
    assert [fix.gps_time_ns for fix in fixes] == [START_NS, START_NS + S]
    assert fixes[0].utc_ns == START_NS + (GPS_EPOCH_UNIX_S - LEAP_S) * S
    (time,) = on(out, keys.GNSS_TIME)
    assert time.message.gps_time_ns == START_NS


def test_date_at_which_there_were_such_receivers_is_believed() -> None:
    """A capture of 2012 that is played on a computer of today."""
    then_ns = utc_ns(2012, 6, 1, 0, 0, 0, 0) - GPS_EPOCH_UNIX_S * S
    (sample,) = on(GnssBridge(VEHICLE).step(raw(solution(then_ns), BOOT_NS)), keys.GNSS_FIX)
    assert sample.message.gps_time_ns == then_ns


def test_week_that_has_overflown_is_the_same_in_every_protocol_of_the_receiver() -> None:
    """Its sentences tell the date that its solutions tell, and are moved alike."""
    told_ns = START_NS - ROLLOVER_NS
    data = solution(told_ns)
    utc = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(seconds=told_ns // S - LEAP_S)
    time, date = utc.strftime("%H%M%S.00"), utc.strftime("%d%m%y")
    data += nmea_frame(f"GNRMC,{time},A,5000.0,N,01400.0,E,0.0,,{date},,,A")
    assert {gps_ns // (60 * S) for _, gps_ns in epoch_times(data)} == {START_NS // (60 * S)}


def test_leap_second_more_is_news_and_no_rollover() -> None:
    bridge = GnssBridge(VEHICLE)
    leap = {"iTOW": 1000, "currLs": LEAP_S, "valid": 1}
    bridge.step(raw(ubx.encode("NAV-TIMELS", leap), BOOT_NS))
    before_ns = utc_ns(2016, 12, 1, 0, 0, 0, 0) - GPS_EPOCH_UNIX_S * S  # 17 s then
    (sample,) = on(bridge.step(raw(solution(before_ns), BOOT_NS)), keys.GNSS_FIX)
    assert sample.message.gps_time_ns == before_ns


def test_age_of_corrections_is_told_by_its_class() -> None:
    for told, age_s in ((0, None), (1, 1.0), (5, 15.0), (12, 120.0), (15, 120.0)):
        data = solution(START_NS, flags3=told << 1)
        (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
        known = sample.message.HasField("correction_age_s")
        assert (sample.message.correction_age_s if known else None) == age_s


def test_navigation_of_u_blox_7_is_a_fix_as_any() -> None:
    data = solution(START_NS, "NAV-PVT u-blox 7", flags3=1, flags=0x21)  # bits reserved there
    (sample,) = on(GnssBridge(VEHICLE).step(raw(data, BOOT_NS)), keys.GNSS_FIX)
    fix = sample.message
    assert (fix.source, fix.valid, fix.latitude_deg) == ("NAV-PVT", True, 50.0870001)
    assert (fix.vel_n_mps, fix.gps_time_ns) == (4.0, START_NS)
    assert not fix.HasField("heading_vehicle_deg")


# The end of a file --------------------------------------------------------------------------------


def test_end_of_the_bytes_gives_what_was_held_and_leaves_nothing() -> None:
    # Two whole frames behind a long start do not show yet that it is none; a third would.
    header = b"\xb5\x62\x02\x15" + (8176).to_bytes(2, "little") + bytes(11) + b"\xff" + bytes(4)
    bridge = GnssBridge(VEHICLE)
    held = b"".join(solution(START_NS + k * S // 5) for k in range(2))
    out = bridge.step(raw(solution(START_NS - S) + header + held, BOOT_NS))
    assert len(on(out, keys.GNSS_FIX)) == 1
    out = bridge.finish()
    assert len(on(out, keys.GNSS_FIX)) == 2
    for ledger in bridge.ledgers():
        assert ledger.balanced
        assert ledger.pending == 0
    assert bridge.device_counters()["bytes_rejected"] == len(header)
    assert bridge.finish() == []


@pytest.mark.parametrize("end", [b"", b"\r", b"\r\n"])
def test_last_epoch_is_given_though_it_is_shorter_than_the_one_before(end: bytes) -> None:
    def epoch(second: int, *, whole: bool) -> bytes:
        texts = [
            f"GNRMC,12000{second}.00,A,5004.5,N,01426.2,E,3.60,90.00,040124,,,A,V",
            f"GNGGA,12000{second}.00,5004.5,N,01426.2,E,1,09,1.1,200.0,M,45.0,M,,",
        ]
        texts += ["GNGSA,A,3,01,02,03,04,05,06,,,,,,,1.8,1.1,1.4,1"] if whole else []
        return b"".join(map(nmea_frame, texts))

    data = b"".join(epoch(k, whole=k % 3 == 0) for k in range(8)).rstrip() + end
    bridge = GnssBridge(VEHICLE)
    out = bridge.step(raw(data, BOOT_NS)) + bridge.finish()
    assert [fix.message.utc_ns // S % 60 for fix in on(out, keys.GNSS_FIX)] == list(range(8))
    assert all(ledger.pending == 0 for ledger in bridge.ledgers())
