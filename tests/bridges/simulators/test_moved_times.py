"""A capture whose times are moved on: every clock in it tells the later instant, nothing else."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest

from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.capture import epoch_times
from tramstream.bridges.gnss.clock import WEEK_NS
from tramstream.bridges.gnss.framer import Frame, Framer, nmea_frame, rtcm3_frame
from tramstream.bridges.simulators.moved_times import moved
from tramstream.clock import S

WEEK_MS = 604_800_000


def frames(data: bytes) -> list[Frame]:
    framer = Framer()
    items = framer.feed(data) + framer.flush()
    assert all(isinstance(item, Frame) for item in items)
    return [item for item in items if isinstance(item, Frame)]


def pvt(utc: datetime, itow_ms: int) -> bytes:
    date = {"year": utc.year, "month": utc.month, "day": utc.day}
    time = {"hour": utc.hour, "min": utc.minute, "sec": utc.second, "valid": 7}
    return ubx.encode("NAV-PVT", {"iTOW": itow_ms, **date, **time, "lat": 50.0, "lon": 14.0})


def test_solution_tells_the_later_instant_and_nothing_else_changes() -> None:
    before = datetime(2024, 2, 28, 23, 59, 30, tzinfo=UTC)
    after = before + timedelta(seconds=45)
    assert moved(pvt(before, 345_588_000), 45) == pvt(after, 345_633_000)


def test_week_goes_on_where_the_time_of_week_begins_anew() -> None:
    time_gps = {"iTOW": WEEK_MS - 5000, "week": 2300, "valid": 7}
    later = ubx.encode("NAV-TIMEGPS", time_gps | {"iTOW": 55_000, "week": 2301})
    assert moved(ubx.encode("NAV-TIMEGPS", time_gps), 60) == later
    rawx = {"rcvTow": 604_799.5, "week": 2300}
    later = ubx.encode("RXM-RAWX", rawx | {"rcvTow": 59.5, "week": 2301})
    assert moved(ubx.encode("RXM-RAWX", rawx), 60) == later


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (
            "GNRMC,235930.20,A,5004.53,N,01426.26,E,1.0,0.0,290224,,,A",
            "GNRMC,000015.20,A,5004.53,N,01426.26,E,1.0,0.0,010324,,,A",
        ),
        (
            "GNGGA,115930,5004.53,N,01426.26,E,1,9,0.9,200.0,M,45.0,M,,",
            "GNGGA,120015,5004.53,N,01426.26,E,1,9,0.9,200.0,M,45.0,M,,",
        ),
        ("GNZDA,235930.00,31,12,2024,00,00", "GNZDA,000015.00,01,01,2025,00,00"),
        (
            "GNGLL,5004.53,N,01426.26,E,115930.00,A,A",
            "GNGLL,5004.53,N,01426.26,E,120015.00,A,A",
        ),
        ("GNGGA,,,,,,0,00,99.99,,,,,,", "GNGGA,,,,,,0,00,99.99,,,,,,"),
        ("GPGSV,1,1,01,02,30,047,33", "GPGSV,1,1,01,02,30,047,33"),
    ],
)
def test_sentence_tells_the_later_time_of_day_and_date(before: str, after: str) -> None:
    assert moved(nmea_frame(before), 45) == nmea_frame(after)


def test_what_tells_no_time_and_what_is_no_frame_stays_where_it_was() -> None:
    no_date = ubx.encode("NAV-PVT", {"iTOW": 0xFFFFFFFF})
    parts = (b"noise", rtcm3_frame(b"\x43\x50abc"), no_date, ubx.encode("MON-VER"), b"\xb5\x62\x01")
    assert moved(b"".join(parts), 60) == b"".join(parts)


def test_repetitions_that_are_moved_on_make_one_long_ride() -> None:
    begin = datetime(2024, 3, 9, 12, tzinfo=UTC)
    minute = b"".join(
        pvt(begin + timedelta(seconds=k), 561_618_000 + 1000 * k)
        + ubx.encode("NAV-EOE", {"iTOW": 561_618_000 + 1000 * k})
        for k in range(60)
    )
    hour = b"".join(moved(minute, 60 * n) for n in range(60))
    assert len(frames(hour)) == 60 * len(frames(minute))
    told = sorted({gps_ns for _, gps_ns in epoch_times(hour)})
    assert [after - before for before, after in pairwise(told)] == [S] * 3599
    assert told[0] % WEEK_NS == 561_618 * S
