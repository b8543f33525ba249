"""What is learned of the error of the fixes: its size, how long it lasts, and what is no error.

Truth: errors are drawn as a first-order Gauss-Markov process, or made as the name of the test says.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_errors import Array, drawn
from seeds import seeds

from tramstream.clock import S
from tramstream.estimation.fix_error import (
    EVEN,
    LEAST_SHARE,
    LIMIT,
    SLOW_SHARE,
    FixError,
)

TAU_S = 20.0
STATED_M = 0.5
SEEDS = seeds(2, of=5)
LONG_S = 900.0


def learned(errors: Array, rate_hz: float = 1.0, stated_m: float = STATED_M) -> FixError:
    found = FixError(TAU_S)
    for k, (east, north) in enumerate(errors.tolist()):
        found.see(S + round(k / rate_hz * S), east, north, stated_m)
    return found


@pytest.mark.parametrize("times", [2.0, 4.0, 10.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_receiver_that_boasts_is_found_out(seed: int, times: float) -> None:
    found = learned(drawn(seed, times * STATED_M, TAU_S, LONG_S))
    assert found.scale == pytest.approx(times, rel=0.4)


@pytest.mark.parametrize("times", [1.0, 1.6, 4.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_heights_that_boast_are_found_out_and_honest_ones_believed(seed: int, times: float) -> None:
    """One axis alone: its squares scatter more than those of two, and have the same mean."""
    found = FixError(TAU_S, axes=1)
    for k, (up, _) in enumerate(drawn(seed, times * STATED_M, TAU_S, LONG_S).tolist()):
        found.see(S + k * S, up, 0.0, STATED_M)
    assert found.scale == pytest.approx(times, rel=0.5)


@pytest.mark.parametrize("axes", [1, 2])
def test_mean_of_what_counts_is_that_of_a_chi_square(axes: int) -> None:
    drawn_ = np.random.default_rng(1).chisquare(axes, 1_000_000) / axes
    assert np.minimum(drawn_, LIMIT).mean() == pytest.approx(EVEN[axes], abs=0.003)


@pytest.mark.parametrize("seed", SEEDS)
def test_receiver_that_boasts_tenfold_is_half_found_out_after_a_minute(seed: int) -> None:
    assert learned(drawn(seed, 10.0 * STATED_M, TAU_S, 60.0)).scale > 3.0


@pytest.mark.parametrize("seed", SEEDS)
def test_honest_receiver_is_believed(seed: int) -> None:
    found = learned(drawn(seed, STATED_M, TAU_S, LONG_S))
    assert 1.0 <= found.scale < 1.5
    assert found.fast > 0.6


@pytest.mark.parametrize("seed", SEEDS)
def test_errors_of_the_stated_size_without_memory_are_no_boast(seed: int) -> None:
    """White errors change by as much in a second as in a minute."""
    errors = np.random.default_rng(seed).normal(0.0, STATED_M, (round(LONG_S), 2))
    assert learned(errors).scale < 1.5


@pytest.mark.parametrize("share", [0.1, 0.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_receiver_is_never_believed_to_be_better_than_it_says(seed: int, share: float) -> None:
    """What does not show within the correlation time may last for longer."""
    found = learned(drawn(seed, share * STATED_M, TAU_S, LONG_S))
    assert found.scale >= 1.0
    assert found.fast + found.slow >= 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_errors_that_last_for_ten_minutes_are_seen_to_last(seed: int) -> None:
    found = learned(drawn(seed, STATED_M, 600.0, LONG_S))
    assert found.slow > 1.0
    assert LEAST_SHARE <= found.fast < 0.3


@pytest.mark.parametrize("rate_hz", [5.0, 25.0])
def test_more_fixes_teach_no_more(rate_hz: float) -> None:
    """Every n-th of the same errors."""
    errors = drawn(1, 3.0 * STATED_M, TAU_S, 300.0, rate_hz)
    found, few = learned(errors, rate_hz), learned(errors[:: round(rate_hz)])
    assert found.scale == pytest.approx(few.scale, rel=0.01)
    assert found.memory.learned_s == pytest.approx(few.memory.learned_s, abs=1.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_fixes_that_jump_now_and_then_are_no_boast(seed: int) -> None:
    """Multipath: 20 m for 8 s, every four minutes."""
    errors = drawn(seed, STATED_M, TAU_S, LONG_S)
    for start in range(100, len(errors), 240):
        errors[start : start + 8] += (16.0, -12.0)
    assert learned(errors).scale < 1.7


@pytest.mark.parametrize("seed", SEEDS)
def test_filter_that_goes_astray_makes_no_receiver_boast(seed: int) -> None:
    """Its place leaves the fixes by half a metre a second, as if the error of those grew."""
    errors = drawn(seed, STATED_M, TAU_S, 360.0)
    errors[300:] += np.arange(60.0)[:, None] * (0.4, 0.3)
    assert learned(errors).scale < 2.0


def test_error_across_the_rails_tells_what_lasts_for_ever() -> None:
    found = learned(np.full((300, 2), 4.0))
    assert found.scale == 1.0
    for k in range(600):
        found.see_across((400 + k) * S, 4.0, 0.25, STATED_M)
    assert found.scale * STATED_M == pytest.approx(4.0, rel=0.2)


def test_error_of_the_map_is_not_that_of_the_fixes() -> None:
    """Fixes of a centimetre beside a map of half a metre."""
    found, rng = FixError(TAU_S), np.random.default_rng(1)
    for k in range(600):
        found.see_across(k * S, float(rng.normal(0.0, 0.3)), 0.25, 0.01)
    assert found.scale < 3.0


def test_nothing_is_known_at_the_beginning() -> None:
    found = FixError(TAU_S)
    assert (found.fast, found.slow, found.scale) == (1.0, SLOW_SHARE, 1.0)
    assert not found.see(S, 0.0, 0.0, STATED_M)


@pytest.mark.parametrize("tau_s", [0.01, 0.5, 600.0])
def test_any_correlation_time_will_do(tau_s: float) -> None:
    found = FixError(tau_s)
    for k, (east, north) in enumerate(drawn(1, STATED_M, 20.0, 200.0).tolist()):
        found.see(k * S, east, north, STATED_M)
    assert math.isfinite(found.scale)
    assert len(found.memory.seen) < 1000


def test_pause_ends_what_is_compared() -> None:
    """Errors of before and after a long pause have nothing to do with each other."""
    found = FixError(TAU_S)
    for k in range(100):
        found.see(k * S, 0.0, 0.0, STATED_M)
    before = found.scale
    for k in range(5):
        found.see((1000 + k) * S, 50.0, 50.0, STATED_M)
    assert found.scale == before
