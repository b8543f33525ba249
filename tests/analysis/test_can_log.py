"""CAN logs: what their clock did, which bus is meant, in which unit a wheel speaks."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.analysis.tables import can_log, wheel_units
from tramstream.analysis.tables.can_log import MOST_ODD, CanLog
from tramstream.bridges.odometer.candump import LATEST_S
from tramstream.clock import S
from tramstream.errors import ConfigError

UTC_S = 1_709_640_000  # 2024-03-05, GPS − UTC = 18 s


def log_of(stamps_s: list[float]) -> CanLog:
    text = "".join(f"({each:.6f}) can0 0AA#{k:04X}\n" for k, each in enumerate(stamps_s))
    return can_log.read(Path("x.candump"), text)


def numbers(log: CanLog) -> list[int]:
    return [int.from_bytes(frame.data, "big") for frame in log.frames]


def even(count: int, start_s: float = UTC_S, period_s: float = 0.02) -> list[float]:
    return [start_s + k * period_s for k in range(count)]


def test_utc_of_a_log_becomes_gps_time() -> None:
    log = log_of(even(3))
    assert [frame.stamp_ns for frame in log.frames] == [
        (UTC_S + 18) * S + k * S // 50 for k in range(3)
    ]
    assert log.dated


def test_stamps_from_zero_on_are_no_dates() -> None:
    log = log_of(even(3, 0.0))
    assert log.frames[0].stamp_ns == S
    assert not log.dated


@pytest.mark.parametrize("place", [0, 1, 50, 98, 99])
@pytest.mark.parametrize("by_s", [-1e9, -100.0, -1.0, 1.0, 100.0, 7e7, 9e8])
@pytest.mark.parametrize("count", [1, 3, MOST_ODD])
def test_odd_stamps_cost_their_frames_and_no_other(place: int, by_s: float, count: int) -> None:
    stamps = even(100)
    odd = list(range(place, min(place + count, 100)))
    for each in odd:
        stamps[each] += by_s
    log = log_of(stamps)
    at_an_end = place == 0 or odd[-1] == 99
    kept = set(numbers(log))
    if at_an_end and abs(by_s) < 3600 and (by_s > 0) == (odd[-1] == 99):
        assert kept == set(range(100))  # a pause there may be
        return
    assert kept == set(range(100)) - set(odd)
    assert log.odd == len(odd)
    assert log.set_back == 0


@pytest.mark.parametrize("back_s", [0.5, 3.0, 100.0, 3600.0, 1e9])
def test_clock_that_is_set_back_costs_no_frame_and_no_time(back_s: float) -> None:
    stamps = even(300)
    stamps = stamps[:150] + [each - back_s for each in stamps[150:]]
    log = log_of(stamps)
    assert numbers(log) == list(range(300))
    steps_ns = [after.stamp_ns - before.stamp_ns for before, after in pairwise(log.frames)]
    assert steps_ns == pytest.approx([20_000_000] * 299, abs=1000)
    assert (log.odd, log.set_back) == (0, 1)
    assert log.set_back_s == pytest.approx(back_s, abs=0.03)


def test_frames_a_little_out_of_order_are_put_in_order() -> None:
    stamps = even(100, period_s=0.001)
    stamps[40], stamps[43] = stamps[43], stamps[40]
    log = log_of(stamps)
    assert numbers(log) == [*range(40), 43, 41, 42, 40, *range(44, 100)]
    assert (log.odd, log.set_back) == (0, 0)


@given(st.lists(st.integers(1, LATEST_S - 1), min_size=1, max_size=80))
def test_any_stamps_give_frames_in_order(stamps: list[int]) -> None:
    text = "".join(f"({each}.0) can0 0AA#00\n" for each in stamps)
    log = can_log.read(Path("x"), text)
    ordered = [frame.stamp_ns for frame in log.frames]
    assert ordered == sorted(ordered)
    assert len(ordered) + log.odd == len(stamps)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "none of its 0 lines"),
        ("hello\nworld\n", r"none of its 2 lines .*not a candump line"),
        ("  can0  0AA   [1]  1A\n" * 3, r"no stamp .*candump -L"),
        (" (2023-11-14 22:13:20.000000)  can0  0AA   [1]  1A\n", "unknown time zone"),
        (
            "(000.000000)  can0  0AA   [1]  1A\n" + "(000.020000)  can0  0AA   [1]  1A\n" * 20,
            "differences, as candump -t d",
        ),
    ],
)
def test_log_that_tells_no_instant_is_refused_with_the_cure(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        can_log.read(Path("x.candump"), text)


# buses --------------------------------------------------------------------------------------------


def two_buses(second: str) -> CanLog:
    text = "".join(
        f"({UTC_S + k / 50:.6f}) can{k % 2} {second if k % 2 else '0AA'}#00\n" for k in range(20)
    )
    return can_log.read(Path("x"), text)


def wants(*wanted: int) -> object:
    return lambda id_, flags: f"M{id_:X}" if id_ in wanted else None


def test_identifier_on_two_buses_is_refused_until_one_is_named() -> None:
    log = two_buses("0AA")
    with pytest.raises(ConfigError, match=r"MAA come on can0 \(10\) and can1 \(10\).*--bus can0"):
        can_log.buses(Path("x"), log, wants(0xAA), "")  # type: ignore[arg-type]
    decoded, heard = can_log.buses(Path("x"), log, wants(0xAA), "can1")  # type: ignore[arg-type]
    assert (decoded, heard) == ({"can1"}, {"MAA"})
    with pytest.raises(ConfigError, match="--bus can7: x has can0, can1"):
        can_log.buses(Path("x"), log, wants(0xAA), "can7")  # type: ignore[arg-type]


def test_wheels_may_be_on_two_buses_where_no_identifier_is() -> None:
    log = two_buses("0AB")
    decoded, heard = can_log.buses(Path("x"), log, wants(0xAA, 0xAB), "")  # type: ignore[arg-type]
    assert (decoded, heard) == ({"can0", "can1"}, {"MAA", "MAB"})
    decoded, heard = can_log.buses(Path("x"), log, wants(0xAB, 0xAC), "")  # type: ignore[arg-type]
    assert (decoded, heard) == ({"can1"}, {"MAB"})


def test_log_without_a_wanted_frame_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"none of its 20 frames .*most are AA"):
        can_log.buses(Path("x"), two_buses("0AA"), wants(0x7), "")  # type: ignore[arg-type]


# units --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "spellings"),
    [
        (1 / 3.6, "km/h KM/H Km/h kmh KMH kph KPH Kph kmph km/hr km/hour [km/h] km·h-1 km_h kmhr"),
        (1.0, "m/s M/S mps MPS m/sec m/second m·s^-1 m·s⁻¹ (m/s) msec"),
        (0.44704, "mph MPH Mph mi/h miles/h miles/hour mile/hour"),
        (1852 / 3600, "kn kt kts knots KN"),
        (0.01, "cm/s CM/S cm/sec centimeter/s"),
        (0.001, "mm/s mm/sec"),
        (0.3048, "ft/s fps ft/sec feet/second"),
        (1 / 60, "m/min"),
    ],
)
def test_speed_is_one_in_any_spelling(factor: float, spellings: str) -> None:
    for unit in [*spellings.split(), *(f" {each} " for each in spellings.split())]:
        assert wheel_units.kind_of(unit, "X") == ("speed", pytest.approx(factor)), unit
    assert wheel_units.kind_of("km per hour", "X") == ("speed", pytest.approx(1 / 3.6))
    assert wheel_units.kind_of("kilometers per hour", "X") == ("speed", pytest.approx(1 / 3.6))


@pytest.mark.parametrize("unit", ["", "pulses", "Pulse", "Imp.", "ticks", "counts", "1", "-"])
def test_pulses_are_pulses(unit: str) -> None:
    assert wheel_units.kind_of(unit, "WHEEL_PULSES_FL") == ("pulses", 1.0)


@pytest.mark.parametrize(
    "unit", ["rpm", "1/min", "rad/s", "m", "km", "%", "ms", "s", "0.01 km/h", "bar", "deg/s", "?"]
)
def test_what_nobody_knows_is_neither(unit: str) -> None:
    assert wheel_units.kind_of(unit, "WHEEL_FL") is None


@pytest.mark.parametrize("signal", ["WHEEL_SPEED_FL", "WhlVelocity", "VehSpd", "Radgeschw"])
def test_speed_without_a_unit_is_not_taken_for_pulses(signal: str) -> None:
    assert wheel_units.kind_of("", signal) is None
    assert wheel_units.kind_of("pulses", signal) == ("pulses", 1.0)
