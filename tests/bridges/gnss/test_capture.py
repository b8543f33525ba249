"""Arrivals of captures that hold none: in the order of the file, as far apart as the epochs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from receivers import START_NS, sentences, sol, solution

from tramstream.bridges.gnss.capture import epoch_times, read_times, unix_like_ns
from tramstream.bridges.gnss.clock import WEEK_NS
from tramstream.bridges.gnss.framer import nmea_frame
from tramstream.clock import S

GGA = "GNGGA,{},5004.5,N,01426.2,E,1,09,1.1,200.0,M,45.0,M,,"


def arrivals_s(data: bytes) -> list[float]:
    """Since the first."""
    times = [arrival_ns for _, arrival_ns in read_times(data)]
    return [(time - times[0]) / S for time in times]


def gga(*times: str) -> bytes:
    return b"".join(nmea_frame(GGA.format(time)) for time in times)


def rmc(time: str, date: str, status: str = "A") -> bytes:
    place = "5004.5,N,01426.2,E" if status == "A" else ",,,"
    return nmea_frame(f"GNRMC,{time},{status},{place},3.6,90.0,{date},,,A")


def test_receivers_time_that_steps_back_keeps_the_order_of_the_file() -> None:
    steps = [START_NS + k * S // 5 for k in range(50)]
    jumped = [*steps, *(gps_ns - 40 * S for gps_ns in steps)]
    assert arrivals_s(b"".join(map(solution, jumped))) == pytest.approx(np.arange(100) / 5)


def test_week_less_keeps_the_order_of_the_file() -> None:
    times = [START_NS, START_NS + S, START_NS + 2 * S - WEEK_NS, START_NS + 3 * S - WEEK_NS]
    assert arrivals_s(b"".join(map(solution, times))) == [0, 1, 2, 3]


@settings(max_examples=60)
@given(st.lists(st.integers(-5_000_000, 5_000_000), min_size=1, max_size=30))
def test_arrivals_never_go_back_and_pieces_keep_their_order(steps_ms: list[int]) -> None:
    times = itertools.accumulate(steps_ms, initial=START_NS // 10**6)
    data = b"".join(solution(ms * 10**6) for ms in times)
    found = read_times(data)
    assert found == sorted(found)
    assert [end for end, _ in found] == sorted({end for end, _ in found})


def test_times_of_day_without_a_date_are_as_far_apart_as_they_say() -> None:
    data = gga("235958.00", "235959.00", "000000.00", "000002.00")
    assert arrivals_s(data) == [0, 1, 2, 4]
    assert min(arrival_ns for _, arrival_ns in read_times(data)) > 0


def test_epochs_right_before_the_first_date_get_theirs() -> None:
    data = gga("235958.00", "235959.00") + rmc("000000.00", "050124") + gga("000001.00")
    assert arrivals_s(data) == [0, 1, 2, 3]
    utc_ns = 1_704_412_800 * S  # 2024-01-05T00:00:00Z
    assert read_times(data)[2][1] == utc_ns + 18 * S


@pytest.mark.parametrize("date", ["060180", "220899", "050180"])
def test_clock_of_a_receiver_without_a_fix_makes_the_ride_no_longer(date: str) -> None:
    """As one that begins in 1980 and then finds 2024: 44 years are not of the ride."""
    data = b"".join(rmc(f"0000{s}.00", date, "V") for s in range(12, 20))
    data += b"".join(rmc(f"1200{s:02d}.00", "040124") for s in range(30))
    assert arrivals_s(data)[-1] == 29.0
    undated = gga("235951.952", "235952.953") + gga("102523.342") + rmc("102524.342", "210808")
    assert arrivals_s(undated)[-1] == 1.0


def test_date_that_is_found_late_is_that_of_the_whole_capture() -> None:
    """1024 weeks back, or a wrong one before, though the receiver vouched for it."""
    data = b"".join(rmc(f"1159{s}.00", "200504") for s in range(50, 60))
    data += b"".join(rmc(f"12000{s}.00", "040124") for s in range(10))
    assert arrivals_s(data) == list(range(20))
    assert read_times(data)[-1][1] == (1_704_369_609 + 18) * S
    lost = data + b"".join(rmc(f"00000{s}.00", "200504") for s in range(3))
    assert read_times(lost)[:20] == read_times(data)
    assert arrivals_s(lost) == list(range(23))


def test_capture_that_tells_no_time_has_no_arrivals() -> None:
    assert read_times(b"# nothing\n") == read_times(b"") == []
    assert read_times(nmea_frame("GNGGA,,,,,,0,00,99.99,,,,,,")) == []


def test_old_receivers_tell_the_time() -> None:
    times = [START_NS + k * S // 4 for k in range(5)]
    data = b"".join(map(sol, times))
    assert [gps_ns for _, gps_ns in epoch_times(data)] == times
    assert read_times(data)[0][1] == unix_like_ns(START_NS)


def test_protocols_of_one_receiver_are_on_one_clock() -> None:
    data = b"".join(
        solution(gps_ns) + sentences(gps_ns, "RMC", "GGA")
        for gps_ns in (START_NS + k * S for k in range(5))
    )
    assert {gps_ns for _, gps_ns in epoch_times(data)} == {START_NS + k * S for k in range(5)}
