"""The compiled filter of the slope: dense algebra, finite differences, identities."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tramstream.processors.grade import kernels
from tramstream.processors.grade.kernels import STATES, Ix
from tramstream.processors.grade.said import NUMBERS, Of

RNG = np.random.default_rng(5)
FIX = (2.25, 0.99)
"""Variance and fading of the fixes' error."""


def belief() -> tuple[Any, Any]:
    root = RNG.normal(size=(STATES, STATES))
    return RNG.normal(scale=0.02, size=STATES), root @ root.T


@pytest.mark.parametrize("way_m", [0.0, 0.12, -0.12])
def test_prediction_is_that_of_dense_algebra(way_m: float) -> None:
    x, P = belief()
    shift_m, dt_s = 3.2, 0.01
    F = np.eye(STATES)
    F[Ix.HEIGHT, Ix.SLOPE], F[Ix.HEIGHT, Ix.BEND] = way_m, way_m * shift_m
    F[Ix.SLOPE, Ix.BEND] = way_m
    fade = math.exp(-abs(way_m) / kernels.BEND_LENGTH_M)
    F[Ix.BEND, Ix.BEND], F[Ix.FIX_ERROR, Ix.FIX_ERROR] = fade, FIX[1]
    Q = np.zeros((STATES, STATES))
    Q[Ix.BEND, Ix.BEND] = (1 - fade**2) * kernels.BEND_STD_PER_M**2
    Q[Ix.FIX_ERROR, Ix.FIX_ERROR] = (1 - FIX[1] ** 2) * FIX[0]
    Q[Ix.SPRING, Ix.SPRING] = kernels.SPRING_WALK_RAD**2 * dt_s
    Q[Ix.ROLLING, Ix.ROLLING] = kernels.ROLLING_WALK**2 * dt_s * (way_m != 0.0)
    expected_x, expected_P = F @ x, F @ P @ F.T + Q
    kernels.carry(x, P, dt_s, way_m, shift_m, FIX)
    np.testing.assert_allclose(x, expected_x, rtol=1e-12)
    np.testing.assert_allclose(P, expected_P, rtol=1e-10, atol=1e-12)
    assert np.array_equal(P, P.T)


def test_update_is_that_of_dense_algebra() -> None:
    x, P = belief()
    H, R, y = RNG.normal(size=STATES), 0.3, 0.7
    S = H @ P @ H + R
    K = P @ H / S
    expected_x, expected_P = x + K * y, P - np.outer(K, H @ P)
    assert kernels.update(x, P, H, y, R, 5.0) == pytest.approx((y, S, True))
    np.testing.assert_allclose(x, expected_x, rtol=1e-12)
    np.testing.assert_allclose(P, expected_P, rtol=1e-9, atol=1e-10)
    assert np.array_equal(P, P.T)


def test_what_does_not_fit_or_is_no_number_changes_nothing() -> None:
    for y in (50.0, math.nan):
        x, P = belief()
        before_x, before_P = x.copy(), P.copy()
        H = np.eye(STATES)[Ix.HEIGHT]
        P[Ix.HEIGHT, Ix.HEIGHT] = before_P[Ix.HEIGHT, Ix.HEIGHT] = 1.0
        assert not kernels.update(x, P, H, y, 1.0, 5.0)[2]
        assert np.array_equal(x, before_x)
        assert np.array_equal(P, before_P)


MEASURED = {
    "height": lambda x: x[Ix.HEIGHT] + 3.0 * x[Ix.SLOPE] + x[Ix.FIX_ERROR],
    "climb": lambda x: 7.0 * (x[Ix.SLOPE] + 6.2 * x[Ix.BEND]),
    "force, forwards": lambda x: (
        x[Ix.MASS] * (0.4 + kernels.GRAVITY * (x[Ix.SLOPE] + x[Ix.ROLLING]))
    ),
    "force, backwards": lambda x: (
        x[Ix.MASS] * (0.4 + kernels.GRAVITY * (x[Ix.SLOPE] - x[Ix.ROLLING]))
    ),
}
"""h(x), as docs/theory.md, section 18, has them."""


def known_mass(x: Any, P: Any, way: float) -> tuple[float, float, bool]:
    """Take a force with a mass of one that is known."""
    return kernels.take_force(x, P, 1.0, 0.4, way, 0.5, 1e9, False)


TAKEN = {
    "height": lambda x, P: kernels.take_height(x, P, 1.0, 3.0, 0.5, 1e9),
    "climb": lambda x, P: kernels.take_climb(x, P, 1.0, 7.0, 6.2, 0.5, 1e9),
    "force, forwards": lambda x, P: known_mass(x, P, 1.0),
    "force, backwards": lambda x, P: known_mass(x, P, -1.0),
}


@pytest.mark.parametrize("kind", MEASURED)
def test_rows_of_h_are_the_derivatives_of_what_is_measured(kind: str) -> None:
    """By finite differences; seen by what an update does with them."""
    x, P = belief()
    x[Ix.MASS], P = 1.0, 1e-4 * P
    h = MEASURED[kind]
    step = 1e-6
    H = np.array([(h(x + step * e) - h(x - step * e)) / (2 * step) for e in np.eye(STATES)])
    S = H @ P @ H + 0.5
    y = 1.0 - h(x)
    expected = x + P @ H / S * y
    assert TAKEN[kind](x, P)[:2] == pytest.approx((y, S), rel=1e-6)
    np.testing.assert_allclose(x, expected, rtol=1e-5, atol=1e-8)


def test_force_that_holds_the_speed_is_not_taken_for_the_mass() -> None:
    x, P = belief()
    x[Ix.MASS], P = 1.0, 1e-4 * P
    before = x.copy()
    kernels.take_force(x, P, 1.0, 0.1, 1.0, 0.01, 1e9, True)
    assert [k for k in Ix if x[k] != before[k]] == [Ix.ROLLING]
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_force_that_is_led_by_a_localiser_changes_mass_and_rolling_alone() -> None:
    """Mass moves as by a full update; what is not known of the slope is allowed for."""
    x, P = belief()
    x[Ix.MASS], P = 1.0, 1e-4 * P
    led_x, led_P = x.copy(), P.copy()
    kernels.take_force(led_x, led_P, 1.0, 0.4, 1.0, 0.01, 1e9, True)
    full_x, full_P = x.copy(), P.copy()
    kernels.take_force(full_x, full_P, 1.0, 0.4, 1.0, 0.01, 1e9, False)
    others = [k for k in Ix if k not in (Ix.MASS, Ix.ROLLING)]
    assert np.array_equal(led_x[others], x[others])
    np.testing.assert_array_equal(led_P[np.ix_(others, others)], P[np.ix_(others, others)])
    assert not np.allclose(full_x[others], x[others])
    both = [Ix.MASS, Ix.ROLLING]
    np.testing.assert_allclose(led_x[both], full_x[both], rtol=1e-12)
    np.testing.assert_allclose(np.diag(led_P)[both], np.diag(full_P)[both], rtol=1e-9)
    assert np.linalg.eigvalsh(led_P).min() > 0.0


def followed(
    x: Any,
    P: Any,
    pitch: float,
    acceleration: float,
    stated: tuple[float, float] = (1e-6, 1e-6),
    level_change: float = math.nan,
) -> Any:
    """A frame of a vehicle that stands: what is said.

    `stated` is the variance of its pitch, now and a frame ago.
    """
    shift_m, tau_s, dt_s, way_m, fix_variance = 0.0, 20.0, 0.01, 0.0, 1.0
    out = np.zeros(NUMBERS)
    given = pitch, *stated, level_change, 0.0, fix_variance
    shaking = np.array([0.0, acceleration])  # springs have followed
    kernels.follow(x, P, shaking, shift_m, tau_s, out, dt_s, way_m, acceleration, *given)
    return out


def fresh() -> tuple[Any, Any]:
    x = np.zeros(STATES)
    x[Ix.MASS] = 1.0
    stds = np.array([0.03, 3e-4, 0.005, 1e-3, 1.0, 1.0, 0.3, 0.002])
    return x, np.diag(stds**2)


def test_vehicle_that_stands_keeps_its_slope_and_learns_it() -> None:
    x, P = fresh()
    for _ in range(500):
        said = followed(x, P, pitch=-0.02, acceleration=0.0)
    slope, variance = said[Of.SLOPE], said[Of.VARIANCE]
    assert slope == pytest.approx(0.02, abs=1e-4)
    stays = math.sqrt(kernels.PITCH_VARIANCES * 1e-6 + kernels.LEAST_OFFSET_STD_RAD**2)
    assert 0.6 * stays < math.sqrt(variance) < 1.05 * stays, "the pitch's error stays"


def test_pitch_that_changes_while_nothing_moves_is_the_springs_or_an_error_and_no_slope() -> None:
    x, P = fresh()
    springs, slope = 0.004, 0.02
    standing, pushed = (-slope - springs * (a + kernels.GRAVITY * slope) for a in (0.0, 1.0))
    for _ in range(500):
        followed(x, P, pitch=standing, acceleration=0.0)
    for _ in range(200):
        said = followed(x, P, pitch=pushed, acceleration=1.0)
    after, nod = said[Of.SLOPE], said[Of.NOD]
    assert after == pytest.approx(slope, abs=2e-4)
    force = 1.0 + kernels.GRAVITY * slope
    assert nod == pytest.approx(-springs * force, abs=4e-4), "bow up when it speeds up"


@pytest.mark.parametrize("lasts", [1, 100], ids=("at once", "within a second"))
def test_localiser_that_finds_its_pitch_in_a_departure_is_not_taken_for_springs(lasts: int) -> None:
    """What it learns moves its pitch while the vehicle speeds up; this body does not nod."""
    x, P = fresh()
    before, after, slope, wrong = 0.02**2, 1e-6, 0.02, 0.03
    P[Ix.OFFSET, Ix.OFFSET] = kernels.PITCH_VARIANCES * before
    for _ in range(500):
        followed(x, P, -slope + wrong, 0.0, (before, before))
    for k in range(lasts):
        known = 1.0 / before + (1.0 / after - 1.0 / before) * (k + 1) / lasts
        known_before = 1.0 / before + (1.0 / after - 1.0 / before) * k / lasts
        still = wrong / (before * known)
        followed(x, P, -slope + still, 1.0, (1.0 / known, 1.0 / known_before))
    spring, std = x[Ix.SPRING], math.sqrt(P[Ix.SPRING, Ix.SPRING])
    assert abs(spring) < 3.0 * std
    assert std > 0.002, "one departure that moves the pitch otherwise tells little"


def test_level_of_the_accelerometer_tells_springs_whatever_the_localiser_learns() -> None:
    """Its pitch moves by 3 % in a departure, and the level error says so: springs are found."""
    x, P = fresh()
    P[Ix.OFFSET, Ix.OFFSET] = P[Ix.SLOPE, Ix.SLOPE]
    springs, slope, wrong, unsure = 0.004, 0.02, 0.03, 0.02**2
    for k in range(600):
        pushed = 1.0 if k > 300 else 0.0
        learned = min(max(k - 300, 0), 100) / 100
        before = min(max(k - 301, 0), 100) / 100
        force = pushed + kernels.GRAVITY * slope
        pitch = -slope - springs * force + wrong * (1.0 - learned)
        change = math.nan if k == 0 else wrong * (learned - before)
        followed(x, P, pitch, pushed, (unsure, unsure), change)
    spring, std = x[Ix.SPRING], math.sqrt(P[Ix.SPRING, Ix.SPRING])
    assert abs(spring - springs) < 3.0 * std
    assert std < 3e-4


def test_localiser_that_knows_better_is_taken_at_its_word_once() -> None:
    """As with a map: its pitch is known by 0.1 %, and it says so again and again."""
    x, P = fresh()
    P[Ix.OFFSET, Ix.OFFSET] = 0.03**2
    for k in range(3000):
        followed(x, P, -0.02, 0.0, (1e-6, 1e-6), math.nan if k == 0 else 0.0)
    stays = math.sqrt(kernels.PITCH_VARIANCES * 1e-6 + kernels.LEAST_OFFSET_STD_RAD**2)
    assert 0.9 * stays < math.sqrt(P[Ix.OFFSET, Ix.OFFSET]) < 1.2 * stays


def test_covariance_stays_positive_over_an_hour_with_gaps_of_the_pitch() -> None:
    x, P = fresh()
    for k in range(36_000):
        pitch = math.nan if (k // 3000) % 3 == 1 else 0.02 * math.sin(k / 5000)
        level = 0.0 if k % 7000 > 3000 else math.nan
        given = math.sin(k / 50), pitch, 1e-6, 1e-6, level, 1e-8, 1.0
        kernels.follow(x, P, np.full(2, 1e-8), 3.2, 20.0, np.zeros(NUMBERS), 0.1, 1.0, *given)
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.isfinite(x).all()
