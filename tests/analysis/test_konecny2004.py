"""konecny2004: a text book recursion as reference, the Riccati equation, and the true interval."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from tramstream.analysis.studies import konecny2004
from tramstream.analysis.studies.konecny2004 import MEAN_INTERVAL_S, POSITION_STD_M, STEPS
from tramstream.processors.distance import kalman1d

RELATIVE = 1e-9
"""Accumulated rounding of two hundred steps in another order."""


def text_book(dt_s: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Predicted s, filtered s, filtered ṡ, σ of s: x = Ax, P = APAᵀ + Q, K = PCᵀ/(CPCᵀ + R), …"""
    C, Q, R = np.array([[1.0, 0.0]]), np.diag([0.0, 2.0]), 40.0**2
    x, P = np.array([[measured[0]], [0.0]]), np.diag([1600.0, 0.0])
    rows = []
    for k in range(1, len(measured)):
        A = np.array([[1.0, dt_s[k]], [0.0, 1.0]])
        x, P = A @ x, A @ P @ A.T + Q
        predicted = x[0, 0]
        K = P @ C.T / (C @ P @ C.T + R)
        x = x + K * (measured[k] - C @ x)
        P = (np.eye(2) - K @ C) @ P
        rows.append((predicted, x[0, 0], x[1, 0], np.sqrt(P[0, 0])))
    return np.array(rows)


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_run_equals_the_text_book_recursion(irregular: bool, seed: int) -> None:
    dt_s = konecny2004.intervals(irregular, np.random.default_rng(seed))
    rows = konecny2004.run(dt_s, dt_s, np.random.default_rng(seed + 100))
    time = np.cumsum(dt_s)
    measured = 0.5 * time**2 + np.random.default_rng(seed + 100).normal(0.0, 40.0, STEPS)
    np.testing.assert_allclose(rows[:, 2], measured[1:], rtol=RELATIVE)
    np.testing.assert_allclose(rows[:, 0], 0.5 * time[1:] ** 2, rtol=RELATIVE)
    np.testing.assert_allclose(rows[:, 1], time[1:], rtol=RELATIVE)
    np.testing.assert_allclose(rows[:, 3:], text_book(dt_s, measured), rtol=RELATIVE)


def test_constant_interval_settles_at_the_riccati_solution() -> None:
    F, H = kalman1d.transition(MEAN_INTERVAL_S), kalman1d.POSITION
    prior = solve_discrete_are(F.T, H.T, konecny2004.PROCESS_NOISE, [[POSITION_STD_M**2]])
    kalman = kalman1d.distance_filter(np.zeros(2), konecny2004.START_COVARIANCE)
    for _ in range(500):
        kalman.predict(F=F, Q=konecny2004.PROCESS_NOISE)
        kalman.update(0.0, R=POSITION_STD_M**2, H=H)
    np.testing.assert_allclose(kalman.P_prior, prior, rtol=RELATIVE)
    gain = prior @ H.T / (H @ prior @ H.T + POSITION_STD_M**2)
    np.testing.assert_allclose(kalman.K, gain, rtol=RELATIVE)


def test_intervals_are_those_of_the_work() -> None:
    np.testing.assert_array_equal(
        konecny2004.intervals(False, np.random.default_rng(1)), np.full(STEPS, 0.5)
    )
    drawn = np.concatenate(
        [konecny2004.intervals(True, np.random.default_rng(seed)) for seed in range(50)]
    )
    assert 0.1 <= drawn.min() < 0.11
    assert 0.89 < drawn.max() <= 0.9
    assert drawn.mean() == pytest.approx(0.5, abs=0.01)


def test_filter_gains_on_the_raw_measurement_and_true_interval_beats_the_mean() -> None:
    constant, irregular, told_mean = konecny2004.cases(seed=1, runs=40)
    for case in (constant, irregular):
        assert case.raw_rmse_m == pytest.approx(40.0, rel=0.03)
        assert case.filtered_rmse_m < case.predicted_rmse_m < case.raw_rmse_m
        assert case.gain > 1.5
    assert irregular.filtered_rmse_m < 0.8 * told_mean.filtered_rmse_m
    assert irregular.within_two_sigma > told_mean.within_two_sigma


def test_same_seed_gives_the_same_figures() -> None:
    assert konecny2004.cases(seed=3, runs=3) == konecny2004.cases(seed=3, runs=3)
