"""Whether errors of the fixes last for minutes, by how they drift against the way.

Truth: errors are drawn as first-order Gauss-Markov processes, and the way errs as a random walk.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_errors import Array, drawn

from tramstream.clock import S
from tramstream.memory.stage import from_plain, to_plain
from tramstream.processors.tram_sources.slow_fix_error import (
    SAMPLE_S,
    SlowFixError,
    SlowFixErrorMemory,
)

TAU_S = 20.0
STATED_M = 0.7
SEEDS = range(1, 6)
LONG_S = 600.0
WAY_M2_PER_S = 0.0015
"""A heading that is off by 0.06° for ten seconds at a time, at 12 m/s."""


def way(seed: int, count: int) -> Array:
    """What the way errs by at the end of each second."""
    rng = np.random.default_rng((seed, 1))
    return np.cumsum(rng.normal(0.0, math.sqrt(WAY_M2_PER_S), (count, 2)), axis=0)


def weighed(errors: Array, found: SlowFixError | None = None, start_s: int = 0) -> SlowFixError:
    found = SlowFixError(TAU_S) if found is None else found
    for k, (east, north) in enumerate(errors.tolist()):
        found.see((1 + start_s + k) * S, east, north, STATED_M, WAY_M2_PER_S * SAMPLE_S)
    return found


def ordinary(seed: int, times: float = 1.0) -> Array:
    errors = drawn(seed, times * STATED_M, TAU_S, LONG_S)
    return errors + way(seed, len(errors))


@pytest.mark.parametrize("times", [1.0, 1.4, 3.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_errors_that_last_as_configured_are_not_slow(seed: int, times: float) -> None:
    found = weighed(ordinary(seed, times))
    assert found.slow < 0.15
    assert found.fast == pytest.approx(times * times, rel=0.6)


@pytest.mark.parametrize("seed", SEEDS)
def test_errors_of_thrice_the_size_that_last_ten_minutes_are_found_slow(seed: int) -> None:
    """Within five minutes: nine times the stated variance, of which a part must be claimed."""
    errors = drawn(seed, 3.0 * STATED_M, 600.0, 300.0)
    found = weighed(errors + way(seed, len(errors)))
    assert found.slow > 1.0
    assert found.fast < 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_fixes_that_jump_now_and_then_are_not_slow(seed: int) -> None:
    """Multipath: 6 m for 8 s, every two minutes."""
    errors = ordinary(seed, 1.4)
    for start in range(60, len(errors), 120):
        errors[start : start + 8] += (4.8, -3.6)
    assert weighed(errors).slow < 0.5


def test_place_that_was_taken_for_another_tells_nothing() -> None:
    """The filter moves its place by 40 m; neither is the error of the fixes."""
    found = weighed(ordinary(1)[:300])
    before = found.slow
    found.forget()
    later = weighed(ordinary(2)[:100] + 40.0, found, 300)
    assert later.slow < before + 0.1


def test_nothing_is_known_at_the_beginning() -> None:
    """Receivers as they are thought to be: hardly any slow error, about as large as stated."""
    found = SlowFixError(TAU_S)
    assert found.slow < 0.3
    assert 0.5 < found.fast < 3.0


def test_more_fixes_teach_no_more() -> None:
    errors = drawn(1, STATED_M, TAU_S, 200.0, 5.0)
    few, many = SlowFixError(TAU_S), SlowFixError(TAU_S)
    for k, (east, north) in enumerate(errors.tolist()):
        stamp_ns = S + k * S // 5
        many.see(stamp_ns, east, north, STATED_M, 0.0)
        if k % 25 == 0:
            few.see(stamp_ns, east, north, STATED_M, 0.0)
    assert many.slow == few.slow


@pytest.mark.parametrize("tau_s", [0.01, 20.0, 600.0])
@pytest.mark.parametrize("stated_m", [0.005, 0.7, 50.0])
def test_any_receiver_will_do(tau_s: float, stated_m: float) -> None:
    found = SlowFixError(tau_s)
    for k, (east, north) in enumerate(drawn(1, 1.0, 20.0, 300.0).tolist()):
        found.see((1 + k) * S, east, north, stated_m, 0.0)
    assert math.isfinite(found.slow)
    assert math.isfinite(found.fast)


def test_memory_comes_back() -> None:
    errors = ordinary(3)
    once = weighed(errors)
    half = len(errors) // 2
    begun = weighed(errors[:half])
    memory = from_plain(SlowFixErrorMemory, to_plain(begun.memory))
    again = weighed(errors[half:], SlowFixError(TAU_S, memory), half)
    assert (again.slow, again.fast) == (once.slow, once.fast)
