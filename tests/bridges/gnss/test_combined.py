"""Receivers before NAV-PVT: one fix out of several messages, against the epoch that they tell."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from receivers import (
    BOOT_NS,
    DOWN_MPS,
    EAST_MPS,
    HEIGHT_M,
    LATITUDE_DEG,
    LEAP_S,
    LONGITUDE_DEG,
    MS,
    MSL_M,
    NORTH_MPS,
    START_NS,
    VEHICLE,
    decoded,
    dop,
    itow_ms,
    on,
    posllh,
    raw,
    sentences,
    sol,
    solution,
    status,
    timeutc,
    velned,
)

from tramstream import keys
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.clock import WEEK_NS
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.proto.gnss_pb2 import GnssFix

CENTIMETRE_DEG = 1e-7
"""Earth-fixed coordinates come in centimetres: at most 0.9 cm off in space."""
CENTIMETRE = 0.01


def epochs(*makers: object, count: int = 4, step_ns: int = S // 4) -> list[bytes]:
    """One read an epoch: what each of `makers` sends of it."""
    assert all(callable(maker) for maker in makers)
    return [
        b"".join(maker(START_NS + k * step_ns) for maker in makers)  # type: ignore[operator]
        for k in range(count)
    ]


def fixes(*data: bytes) -> list[GnssFix]:
    return on(decoded(*data), keys.GNSS_FIX)


ORDERS = [
    (sol, posllh, velned, status),
    (status, posllh, velned, sol),
    (posllh, status, velned, dop, timeutc, sol),
]


@pytest.mark.parametrize("makers", ORDERS, ids=lambda m: "-".join(each.__name__ for each in m))
def test_messages_of_an_epoch_make_one_fix_in_any_order(makers: tuple[object, ...]) -> None:
    found = fixes(*epochs(*makers))
    assert len(found) == 4
    for k, fix in enumerate(found):
        assert fix.source == "NAV-SOL"
        assert fix.valid
        assert fix.fix_type == GnssFix.FIX_3D
        assert (fix.latitude_deg, fix.longitude_deg) == (LATITUDE_DEG, LONGITUDE_DEG)
        assert (fix.height_ellipsoid_m, fix.height_msl_m) == (HEIGHT_M, MSL_M)
        assert (fix.horizontal_std_m, fix.vertical_std_m) == (2.5, 3.5)
        assert (fix.vel_n_mps, fix.vel_e_mps, fix.vel_d_mps) == (NORTH_MPS, EAST_MPS, DOWN_MPS)
        assert fix.speed_mps == pytest.approx(5.0)
        assert (fix.speed_std_mps, fix.course_std_deg) == (0.3, 3.0)
        assert fix.course_deg == pytest.approx(math.degrees(math.atan2(3, 4)), abs=1e-5)
        assert fix.satellites_used == 9
        if k or makers[0] is sol:  # before, nobody has told the week
            assert fix.gps_time_ns == START_NS + k * S // 4


def test_earth_fixed_position_and_velocity_are_turned_to_the_place() -> None:
    (fix, *_) = fixes(*epochs(sol))
    assert fix.latitude_deg == pytest.approx(LATITUDE_DEG, abs=CENTIMETRE_DEG)
    assert fix.longitude_deg == pytest.approx(LONGITUDE_DEG, abs=CENTIMETRE_DEG)
    assert fix.height_ellipsoid_m == pytest.approx(HEIGHT_M, abs=CENTIMETRE)
    assert not fix.HasField("height_msl_m")
    velocity = fix.vel_n_mps, fix.vel_e_mps, fix.vel_d_mps
    assert velocity == pytest.approx((NORTH_MPS, EAST_MPS, DOWN_MPS), abs=CENTIMETRE)
    assert fix.course_deg == pytest.approx(math.degrees(math.atan2(3, 4)), abs=0.2)
    spatial = math.hypot(fix.horizontal_std_m, fix.vertical_std_m)
    assert spatial == pytest.approx(3.6)  # pAcc is the deviation in space


def test_deviation_in_space_is_shared_out_by_the_dilutions() -> None:
    found = fixes(*epochs(sol, dop))
    assert found[0].horizontal_std_m / found[0].vertical_std_m == pytest.approx(1.5 / 2.0)
    assert found[0].pdop == 2.5


def test_velocity_alone_in_the_earths_frame_is_taken_with_posllh() -> None:
    from receivers import velocity_e

    vx, vy, vz = (round(100 * each) for each in velocity_e())
    fields = {"ecefVX": vx, "ecefVY": vy, "ecefVZ": vz, "sAcc": 40}
    velecef = lambda t: ubx.encode("NAV-VELECEF", {"iTOW": itow_ms(t), **fields})  # noqa: E731
    fix = fixes(*epochs(posllh, velecef, status))[0]
    velocity = fix.vel_n_mps, fix.vel_e_mps, fix.vel_d_mps
    assert velocity == pytest.approx((NORTH_MPS, EAST_MPS, DOWN_MPS), abs=CENTIMETRE)
    assert fix.speed_std_mps == 0.4


def test_position_alone_is_a_fix_as_accurate_as_is_asked() -> None:
    found = fixes(*epochs(posllh))
    assert [fix.valid for fix in found] == [True] * 4
    assert found[0].source == "NAV-POSLLH"
    assert not found[0].HasField("vel_n_mps")
    unknown = lambda t: posllh(t, lat=0, lon=0, hAcc=2**32 - 1, vAcc=2**32 - 1)  # noqa: E731
    far = lambda t: posllh(t, hAcc=3_750_000_000)  # noqa: E731
    for maker in (unknown, far):
        assert [fix.valid for fix in fixes(*epochs(maker))] == [False] * 4


@pytest.mark.parametrize(
    "changes",
    [{"gpsFix": 0}, {"gpsFix": 1}, {"gpsFix": 5}, {"gpsFix": 77}, {"flags": 0x0C}],
    ids=str,
)
def test_what_the_receiver_does_not_call_a_fix_is_none(changes: dict[str, int]) -> None:
    assert not any(fix.valid for fix in fixes(*epochs(lambda t: sol(t, **changes))))
    told = lambda t: status(t, **changes)  # noqa: E731
    assert not any(fix.valid for fix in fixes(*epochs(posllh, told)))


def test_earths_centre_is_no_place() -> None:
    nowhere = {"ecefX": 0, "ecefY": 0, "ecefZ": 0, "gpsFix": 0}
    assert fixes(*epochs(lambda t: sol(t, **nowhere))) == []


def test_fix_does_not_wait_for_the_next_epoch() -> None:
    bridge = GnssBridge(VEHICLE)
    counts = [
        len(on(bridge.step(raw(data, BOOT_NS + k * S)), keys.GNSS_FIX))
        for k, data in enumerate(epochs(sol, posllh, velned, count=5))
    ]
    assert counts == [0, 2, 1, 1, 1]  # the first ends where the second begins
    end = ubx.encode("NAV-EOE", {"iTOW": itow_ms(START_NS)})
    assert len(on(GnssBridge(VEHICLE).step(raw(sol() + end)), keys.GNSS_FIX)) == 1


def test_time_is_that_of_the_receiver() -> None:
    fix = fixes(*epochs(sol, timeutc))[0]
    utc_ns = START_NS + (GPS_EPOCH_UNIX_S - LEAP_S) * S
    assert (fix.gps_time_ns, fix.utc_ns) == (START_NS, utc_ns)
    assert fixes(*epochs(sol))[0].utc_ns == 0  # leap seconds are not told
    gps = ubx.encode("NAV-TIMEGPS", {"iTOW": itow_ms(START_NS), "week": START_NS // WEEK_NS,
                                     "leapS": LEAP_S, "valid": 7})  # fmt: skip
    assert fixes(gps + sol(), sol(START_NS + S))[0].utc_ns == utc_ns
    late = fixes(*epochs(posllh, lambda t: timeutc(t, valid=0)))
    assert not late[0].HasField("gps_time_ns")


def test_utc_of_the_receiver_tells_the_week() -> None:
    found = fixes(*epochs(timeutc, posllh, status))
    assert [fix.gps_time_ns for fix in found] == [START_NS + k * S // 4 for k in range(4)]


def test_week_that_is_not_set_is_none() -> None:
    fix = fixes(*epochs(lambda t: sol(t, flags=1)))[0]
    assert fix.valid
    assert not fix.HasField("gps_time_ns")


def test_better_solutions_take_over_and_nothing_is_told_twice() -> None:
    found = fixes(*epochs(sol, solution))
    assert [fix.source for fix in found] == ["NAV-PVT"] * 4
    found = fixes(*epochs(sol, lambda t: sentences(t, "RMC", "GGA"), step_ns=S))
    assert {fix.source for fix in found[1:]} == {"NAV-SOL"}
    assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(found))
    found = fixes(*epochs(posllh, lambda t: sentences(t, "RMC", "GGA"), step_ns=S))
    assert {fix.source for fix in found[2:]} == {"NMEA"}  # which says whether it is a fix


def test_stamps_are_those_of_the_epochs() -> None:
    bridge, found = GnssBridge(VEHICLE), []
    for k, data in enumerate(epochs(sol, posllh, velned, count=60)):
        arrival_ns = BOOT_NS + k * S // 4 + 100 * MS + (7919 * k % 13) * MS
        found += on(bridge.step(raw(data, arrival_ns)), keys.GNSS_FIX)
    errors_ns = [fix.stamp_ns - BOOT_NS - k * S // 4 for k, fix in enumerate(found)]
    assert max(map(abs, errors_ns[20:])) < 5 * MS


@settings(max_examples=40)
@given(st.lists(st.integers(1, 300), max_size=20), st.integers(0, 20))
def test_cuts_and_restarts_change_no_fix(sizes: list[int], moved_at: int) -> None:
    data = b"".join(epochs(sol, posllh, velned, status, dop))
    whole = fixes(data)
    bridge, at, found = GnssBridge(VEHICLE), 0, []
    for count, size in enumerate([*sizes, len(data)]):
        if count == moved_at:
            state, bridge = bridge.snapshot(), GnssBridge(VEHICLE)
            bridge.restore(state)
        found += on(bridge.step(raw(data[at : at + size])), keys.GNSS_FIX)
        at += size
    found += on(bridge.finish(), keys.GNSS_FIX)
    assert [each.latitude_deg for each in found] == [each.latitude_deg for each in whole]
    assert [each.itow_ms for each in found] == [each.itow_ms for each in whole]


def test_raw_measurements_and_satellites_of_old_receivers_are_told() -> None:
    data = ubx.encode(
        "RXM-RAW", {"iTOW": itow_ms(START_NS), "week": 2300},
        [{"prMes": 2.1e7, "cpMes": 1.1e8, "doMes": -1500.0, "sv": 7, "cno": 44, "lli": 1},
         {"prMes": 3.6e7, "sv": 123, "cno": 38}],
    )  # fmt: skip
    data += ubx.encode(
        "NAV-SVINFO", {"iTOW": itow_ms(START_NS)},
        [{"svid": 7, "flags": 1, "quality": 7, "cno": 44, "elev": 40, "azim": 210, "prRes": -150},
         {"svid": 70, "flags": 16, "elev": -91}, {"svid": 255}],
    )  # fmt: skip
    out = decoded(data)
    (epoch,) = on(out, keys.GNSS_MEASUREMENTS)
    assert (epoch.receiver_tow_s, epoch.week) == (itow_ms(START_NS) / 1000, 2300)
    first, second = epoch.measurements
    assert (first.pseudorange_m, first.carrier_phase_cycles) == (2.1e7, 1.1e8)
    assert first.doppler_hz == -1500.0
    assert [(m.gnss_id, m.sv_id, m.cno_dbhz) for m in (first, second)] == [(0, 7, 44), (1, 123, 38)]
    (view,) = on(out, keys.GNSS_SATELLITES)
    assert [(s.gnss_id, s.sv_id) for s in view.satellites] == [(0, 7), (6, 6), (6, 255)]
    gps, glonass, _ = view.satellites
    assert (gps.used, gps.health, gps.elevation_deg, gps.residual_m) == (True, 1, 40, -1.5)
    assert (glonass.used, glonass.health, glonass.HasField("elevation_deg")) == (False, 2, False)
