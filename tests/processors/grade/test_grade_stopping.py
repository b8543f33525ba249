"""Distances to stop: against the issue's figures, a fine integration, and finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tramstream.processors.grade.kernels import GRAVITY
from tramstream.processors.grade.stopping import PIECE_M, PIECES, stop


def even(slope_rad: float) -> Any:
    return np.full(PIECES, slope_rad)


def integrated(slopes: Any, speed_mps: float, deceleration: float, reaction_s: float) -> float:
    """Small steps of time."""
    way, dt_s, time_s = 0.0, 1e-4, 0.0
    while speed_mps > 0.0:
        slope = slopes[0] if time_s < reaction_s else slopes[min(int(way / PIECE_M), PIECES - 1)]
        brake = 0.0 if time_s < reaction_s else deceleration
        way += speed_mps * dt_s
        speed_mps -= (brake + GRAVITY * math.sin(slope)) * dt_s
        time_s += dt_s
    return way


def test_on_the_level_it_is_half_the_square_of_the_speed_over_the_deceleration() -> None:
    assert stop(even(0.0), 15.0, 1.0, 0.0)[0] == pytest.approx(112.5)
    assert stop(even(0.0), 15.0, 1.0, 1.0)[0] == pytest.approx(127.5)
    assert stop(even(0.0), 0.0, 1.0, 0.0)[0] == 0.0


@pytest.mark.parametrize(("deceleration", "more_m"), [(1.55, 20.0), (1.0, 58.0)])
def test_two_degrees_down_take_20_and_58_m_more(deceleration: float, more_m: float) -> None:
    """The figures that braking distance needs the slope for."""
    level, down = (stop(even(math.radians(d)), 15.0, deceleration, 0.0)[0] for d in (0.0, -2.0))
    assert down - level == pytest.approx(more_m, abs=1.0)


@pytest.mark.parametrize("reaction_s", [0.0, 1.5])
def test_changing_slope_is_that_of_small_steps(reaction_s: float) -> None:
    slopes = 0.05 * np.sin(np.arange(PIECES) * PIECE_M / 40.0)
    for speed, deceleration in ((15.0, 1.0), (9.0, 1.55), (3.0, 0.7)):
        expected = integrated(slopes, speed, deceleration, reaction_s)
        found = stop(slopes, speed, deceleration, reaction_s)[0]
        assert found == pytest.approx(expected, abs=0.02)


def test_brakes_that_do_not_hold_the_slope_do_not_stop() -> None:
    assert math.isinf(stop(even(-0.11), 10.0, 1.0, 0.0)[0])


def test_vehicle_that_rolls_uphill_may_stand_before_its_brakes_hold() -> None:
    distance, _, _ = stop(even(0.09), 0.5, 1.0, 2.0)
    assert distance == pytest.approx(0.5**2 / (2 * GRAVITY * math.sin(0.09)), rel=1e-6)


@pytest.mark.parametrize("reaction_s", [0.0, 1.0])
def test_derivatives_are_those_of_finite_differences(reaction_s: float) -> None:
    slopes = 0.03 * np.cos(np.arange(PIECES) * PIECE_M / 60.0)
    step = 1e-6
    _, by_speed, by_slope = stop(slopes, 13.0, 1.0, reaction_s)
    speeds = [stop(slopes, 13.0 + d, 1.0, reaction_s)[0] for d in (-step, step)]
    slopes_m = [stop(slopes + d, 13.0, 1.0, reaction_s)[0] for d in (-step, step)]
    assert by_speed == pytest.approx((speeds[1] - speeds[0]) / (2 * step), rel=1e-4)
    assert by_slope == pytest.approx((slopes_m[1] - slopes_m[0]) / (2 * step), rel=1e-4)
