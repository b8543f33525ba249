"""Heading out of displacements, turned back by the gyroscope: truth is the geometry of the way."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from tramstream.live import snapshots
from tramstream.memory.stage import from_plain, to_plain
from tramstream.processors.tram_filter.alignment import (
    ENOUGH_RAD,
    LEAST_WAY_M,
    Alignment,
    AlignmentMemory,
)

SEEDS = range(20)
TAU_S = 20.0
STD_M = 0.5
HEADINGS_RAD = [0.0, 0.4, 2.0, math.pi, -1.3]
ROUNDING = 1e-9


def arc(
    yaw_rad: float, speed_mps: float, yaw_rate_radps: float, count: int, dt_s: float = 1.0
) -> list[tuple[float, complex, float]]:
    """Fixes on a circle: time, place (east + i·north), turn since the beginning."""
    fixes = []
    for k in range(count):
        time_s = k * dt_s
        turned = yaw_rate_radps * time_s
        if yaw_rate_radps:
            chord = speed_mps / yaw_rate_radps * (cmath.exp(1j * turned) - 1.0) / 1j
        else:
            chord = complex(speed_mps * time_s)
        fixes.append((time_s, chord * cmath.exp(1j * yaw_rad), turned))
    return fixes


def took(fixes: list[tuple[float, complex, float]], std: float = STD_M) -> Alignment:
    alignment = Alignment(TAU_S)
    for time_s, place, turned in fixes:
        alignment.take(time_s, place.real, place.imag, turned, std)
    return alignment


def off(alignment: Alignment, yaw_rad: float) -> float:
    return abs(math.remainder(alignment.yaw_rad - yaw_rad, math.tau))


@pytest.mark.parametrize("yaw_rad", HEADINGS_RAD)
@pytest.mark.parametrize("yaw_rate_radps", [0.0, 0.15, -0.3])
def test_heading_at_departure_is_exact_on_a_straight_and_on_a_circle(
    yaw_rad: float, yaw_rate_radps: float
) -> None:
    alignment = took(arc(yaw_rad, 6.0, yaw_rate_radps, 8))
    assert off(alignment, yaw_rad) < ROUNDING
    # A chord is shorter than its arc; turned back they add up like a straight.
    half = 0.5 * yaw_rate_radps
    shorter = math.sin(half) / half if half else 1.0
    assert alignment.way_m == pytest.approx(7 * 6.0 * shorter)


@pytest.mark.parametrize("yaw_rad", HEADINGS_RAD)
def test_running_backwards_gives_the_opposite(yaw_rad: float) -> None:
    assert off(took(arc(yaw_rad, -6.0, 0.2, 8)), yaw_rad + math.pi) < ROUNDING


def test_speed_and_time_between_fixes_do_not_matter() -> None:
    way = np.cumsum([0.0, 1.0, 2.5, 4.5, 7.0, 9.0])
    times = [0.0, 1.0, 2.0, 3.0, 4.1, 5.0]
    fixes = [
        (time, complex(metres * math.cos(0.7), metres * math.sin(0.7)), 0.0)
        for time, metres in zip(times, way.tolist(), strict=True)
    ]
    assert off(took(fixes), 0.7) < ROUNDING


def test_nothing_is_ready_without_a_way() -> None:
    alignment = Alignment(TAU_S)
    assert not alignment.ready
    assert alignment.yaw_std_rad == math.inf
    for k in range(30):
        alignment.take(float(k), 0.02 * k, 0.0, 0.0, 0.01)
        assert alignment.way_m >= LEAST_WAY_M or alignment.yaw_std_rad == math.inf
    assert not took(arc(0.0, 6.0, 0.0, 2)).ready  # one displacement has no witness


def test_better_fixes_are_ready_earlier() -> None:
    def first(std: float) -> int:
        return next(n for n in range(200) if took(arc(0.3, 2.0, 0.0, n), std).ready)

    assert 3 <= first(0.02) < first(1.0) < first(3.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_error_is_as_large_as_claimed_when_it_is_ready(seed: int) -> None:
    """Fixes whose error is that of a receiver: most of it shared by neighbours."""
    rng = np.random.default_rng(seed)
    keep = math.exp(-1.0 / TAU_S)
    error = rng.normal(0.0, STD_M, 2)
    alignment = Alignment(TAU_S)
    for time_s, place, turned in arc(1.1, 2.5, 0.05, 60):
        alignment.take(time_s, place.real + error[0], place.imag + error[1], turned, STD_M)
        if alignment.ready:
            break
        error = keep * error + math.sqrt(1.0 - keep**2) * rng.normal(0.0, STD_M, 2)
    assert alignment.ready
    assert alignment.yaw_std_rad < ENOUGH_RAD
    assert off(alignment, 1.1) < 3.5 * alignment.yaw_std_rad


@pytest.mark.parametrize("wrong", [[0], [0, 1], [5], [3, 4], [9]])
@pytest.mark.parametrize("offset", [50.0 + 0.0j, -20.0 + 12.0j])
def test_fixes_that_are_far_off_turn_nothing(wrong: list[int], offset: complex) -> None:
    alignment = Alignment(TAU_S)
    for number, (time_s, place, turned) in enumerate(arc(0.5, 8.0, 0.1, 15)):
        seen = place + (offset if number in wrong else 0.0)
        alignment.take(time_s, seen.real, seen.imag, turned, STD_M)
        if alignment.ready:
            assert off(alignment, 0.5) < ROUNDING
    assert alignment.ready


def test_fix_at_the_same_instant_is_not_taken_twice() -> None:
    fixes = arc(0.5, 6.0, 0.1, 8)
    doubled = [each for each in fixes for _ in range(2)]
    assert took(doubled).memory == took(fixes).memory


def test_memory_comes_back() -> None:
    fixes = arc(0.5, 6.0, 0.1, 9)
    whole, first = took(fixes), took(fixes[:5])
    kept = snapshots.unpack(snapshots.pack(to_plain(first.memory)))
    second = Alignment(TAU_S, from_plain(AlignmentMemory, kept))
    for time_s, place, turned in fixes[5:]:
        second.take(time_s, place.real, place.imag, turned, STD_M)
    assert second.memory == whole.memory
