"""NEES, NIS and their bounds: right for filters that are right, and for no others."""

from __future__ import annotations

import numpy as np
import pytest
from circling import along_across, motion, states, truth
from scipy.signal import lfilter
from scipy.stats import chi2

from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.consistency import (
    NEES_SLOTS,
    Verdict,
    autocorrelation_time,
    chi_square_interval,
    mean_bounds,
    nees,
    nees_series,
    nis,
    protection,
    quadratic_form,
    shortfalls,
)
from tramstream.analysis.evaluate.errors import errors
from tramstream.estimation.series import Innovations, Slot

TRUTH_S = np.arange(0.0, 40.0, 0.1)
STATE_S = np.arange(0.0, 39.9, 0.02)
RUNS = 1000
COVERAGE = (0.93, 0.97)
"""Within three standard deviations of 95 % of a thousand runs."""


def autoregressive(rng: np.random.Generator, n: int, phi: float, d: int) -> np.ndarray:
    """Stationary AR(1) of unit variance, (n, d)."""
    noise = rng.standard_normal((n, d))
    noise[1:] *= np.sqrt(1 - phi**2)
    return lfilter([1.0], [1.0, -phi], noise, axis=0)


def random_covariances(rng: np.random.Generator, n: int, d: int) -> np.ndarray:
    roots = rng.standard_normal((n, d, d + 2)) * np.logspace(-3, 1, d)[:, None]
    return roots @ np.swapaxes(roots, 1, 2)


def made_up(rng: np.random.Generator, error: np.ndarray, P: np.ndarray):
    """Errors of states whose east, north, speed and yaw are off by `error`."""
    full = np.eye(len(Slot))
    full[np.ix_(NEES_SLOTS["joint"], NEES_SLOTS["joint"])] = P
    east_north = np.pad(error[:, :2], ((0, 0), (0, 1)))
    off = states(STATE_S, east_north, error[:, 2], error[:, 3], full)
    return errors(off, truth(TRUTH_S))


# Algebra ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("d", [1, 2, 4, 7])
def test_quadratic_form_is_that_of_the_inverse(d):
    rng = np.random.default_rng(d)
    P, error = random_covariances(rng, 50, d), rng.standard_normal((50, d))
    expected = [e @ np.linalg.solve(p, e) for e, p in zip(error, P, strict=True)]
    np.testing.assert_allclose(quadratic_form(P, error), expected, rtol=1e-6)


def test_quadratic_form_of_no_covariance_is_nan():
    P = np.stack(
        [np.eye(2), np.zeros((2, 2)), np.ones((2, 2)), -np.eye(2), np.full((2, 2), np.nan)]
    )
    found = quadratic_form(P, np.ones((5, 2)))
    assert found[0] == 2.0
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("degrees", [1, 2, 4, 400, 1e6])
def test_interval_is_that_of_scipy(degrees):
    expected = chi2.ppf([0.025, 0.975], degrees)
    np.testing.assert_allclose(chi_square_interval(degrees), expected, rtol=1e-9)


def test_bounds_of_many_samples_are_the_textbooks_and_of_few_wider():
    """Bar-Shalom 2001, section 5.4.2: 50 runs of dimension 2 give [1.5, 2.6]."""
    np.testing.assert_allclose(chi2.ppf([0.025, 0.975], 100) / 50, [1.48, 2.59], atol=0.005)
    low, high = mean_bounds(2, 50)
    assert low < 1.48
    assert high > 2.59
    np.testing.assert_allclose(
        mean_bounds(2, 1e5), np.array(chi_square_interval(2e5)) / 1e5, rtol=1e-6
    )


# Autocorrelation ----------------------------------------------------------------------------------
@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.98])
def test_autocorrelation_time_is_that_of_an_autoregressive_process(phi):
    """τ = 1 + 2 Σ φᵏ = (1 + φ) / (1 − φ)."""
    series = autoregressive(np.random.default_rng(5), 400_000, phi, 1)[:, 0]
    assert autocorrelation_time(series) == pytest.approx((1 + phi) / (1 - phi), rel=0.1)


def test_autocorrelation_time_does_not_depend_on_scale_or_offset():
    series = autoregressive(np.random.default_rng(6), 10_000, 0.9, 1)[:, 0]
    assert autocorrelation_time(3.0 + 7.0 * series) == pytest.approx(autocorrelation_time(series))


def test_autocorrelation_time_stays_between_one_and_all():
    assert autocorrelation_time(np.array([3.0])) == 1.0
    assert autocorrelation_time(np.full(50, 2.0)) == 50.0
    assert autocorrelation_time(np.tile([1.0, -1.0], 50)) == 1.0
    assert autocorrelation_time(np.arange(100.0)) <= 100.0


@pytest.mark.parametrize(
    ("phi", "n"), [(0.0, 500), (0.9, 4000), (0.98, 20_000), (0.98, 5000), (0.98, 1500)]
)
def test_bounds_hold_the_mean_of_correlated_errors_as_often_as_they_say(phi, n):
    """NEES of two AR(1) errors; τ of their squares is (1 + φ²)/(1 − φ²), so n/τ is 30 to 500."""
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(RUNS):
        series = (autoregressive(rng, n, phi, 2) ** 2).sum(axis=1)
        held += float(series.mean()) in mean_bounds(2, n / autocorrelation_time(series))
    assert COVERAGE[0] <= held / RUNS <= COVERAGE[1]


def test_bounds_of_several_short_rides_rest_on_all_of_them() -> None:
    """Worth 8 independent samples each; one ride alone could not tell its own bounds.

    They are a little wide: the mean of so few scatters less than the limit of many says.
    """
    rng = np.random.default_rng(8)
    rides, runs, held = 10, RUNS // 5, 0
    for _ in range(runs):
        series = [(autoregressive(rng, 800, 0.99, 2) ** 2).sum(axis=1) for _ in range(rides)]
        bounds = mean_bounds(2, 800 / autocorrelation_time(*series), rides)
        held += sum(float(each.mean()) in bounds for each in series)
    assert 0.95 <= held / runs / rides <= 0.985


def test_bounds_that_took_correlated_samples_for_independent_would_be_wrong():
    rng = np.random.default_rng(8)
    series = [(autoregressive(rng, 4000, 0.98, 2) ** 2).sum(axis=1) for _ in range(200)]
    held = sum(float(each.mean()) in mean_bounds(2, 4000) for each in series)
    assert held < 0.5 * len(series)


# NEES ---------------------------------------------------------------------------------------------
def test_gaussian_errors_of_the_claimed_covariance_are_consistent_over_seeds():
    P = random_covariances(np.random.default_rng(1), 1, 4)[0]
    root = np.linalg.cholesky(P)
    verdicts = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        white = autoregressive(rng, len(STATE_S), 0.9, 4)
        found = made_up(rng, white @ root.T * 0.01, P * 1e-4)
        verdicts += [
            each.consistent
            for slots in NEES_SLOTS.values()
            if set(slots) <= set(NEES_SLOTS["joint"])  # what `made_up` puts errors in
            and (each := nees(found, slots)) is not None
        ]
    assert len(verdicts) == 240
    # Four judgements of one ride go together: about 60 independent ones, 95 % ± 3 · 2.8 %.
    assert np.mean(verdicts) >= 0.86


@pytest.mark.parametrize(("factor", "side"), [(2.0, "high"), (0.5, "low")])
def test_a_covariance_wrong_by_a_factor_is_found(factor, side):
    rng = np.random.default_rng(3)
    P = np.diag([0.04, 0.04, 0.01, 1e-4])
    white = autoregressive(rng, len(STATE_S), 0.9, 4)
    judged = nees(made_up(rng, white * np.sqrt(factor * np.diag(P)), P), NEES_SLOTS["joint"])
    assert not judged.consistent
    assert judged.mean == pytest.approx(4 * factor, rel=0.15)
    assert (judged.mean > judged.bounds.high) is (side == "high")


def test_share_inside_the_interval_is_that_of_single_samples():
    rng = np.random.default_rng(4)
    P = np.diag([0.04, 0.04, 0.01, 1e-4])
    error = rng.standard_normal((len(STATE_S), 4)) * np.sqrt(np.diag(P))
    judged = nees(made_up(rng, error, P), NEES_SLOTS["position"])
    assert judged.inside_share == pytest.approx(0.95, abs=0.02)
    assert judged.effective > 0.8 * judged.count


def test_nees_is_given_where_it_can_be_and_counted_where_not():
    series = states(STATE_S, [2.0, 0.0, 0.0])
    series.covariance[:10] = np.nan
    found = errors(series, truth(TRUTH_S))
    np.testing.assert_allclose(nees_series(found, NEES_SLOTS["position"])[10:], 4.0, rtol=1e-4)
    judged = nees(found, NEES_SLOTS["position"])
    assert (judged.count, judged.undefined) == (len(STATE_S) - 10, 10)


def test_truth_without_yaw_leaves_yaw_and_joint_unjudged():
    known = truth(TRUTH_S)
    known.attitude_rad[:] = np.nan
    found = errors(states(STATE_S), known)
    assert nees(found, NEES_SLOTS["yaw"]) is None
    assert nees(found, NEES_SLOTS["joint"]) is None
    assert nees(found, NEES_SLOTS["position"]) is not None


def test_one_state_is_worth_one_sample():
    found = errors(states(np.array([5.0]), [1.0, 0.0, 0.0]), truth(np.array([5.0])))
    judged = nees(found, NEES_SLOTS["position"])
    assert (judged.count, judged.effective, judged.consistent) == (1, 1.0, None)
    assert judged.verdict is Verdict.SHORT
    assert judged.mean == pytest.approx(1.0)


@pytest.mark.parametrize("d", [1, 2, 4])
def test_no_bound_is_wider_than_that_of_any_correlation(d):
    """E[X; X > q] by hand: for d = 2, χ² is exponential of mean 2, so it is (q + 2) P(X > q)."""
    low, high = mean_bounds(d, 1.0)
    np.testing.assert_allclose((low, high), shortfalls(d, 0.025), rtol=1e-9)
    values = chi2.rvs(d, size=400_000, random_state=np.random.default_rng(d))
    tail = np.sort(values)[-10_000:]
    assert high == pytest.approx(tail.mean(), rel=0.02)
    assert shortfalls(2, 0.025).high == pytest.approx(chi2.ppf(0.975, 2) + 2.0)


def test_excursion_does_not_widen_the_interval_that_judges_it():
    """A right filter that is 8 σ off for a tenth of the ride: before, [0, 74] held that mean."""
    rng = np.random.default_rng(9)
    error = autoregressive(rng, len(STATE_S), 0.9, 4)
    error[:200] += 8.0
    judged = nees(made_up(rng, error * 0.1, np.eye(4) * 0.01), NEES_SLOTS["joint"])
    assert judged.mean > 20.0
    assert judged.verdict is Verdict.CONFIDENT
    assert judged.bounds.high < 14.0


# NIS ----------------------------------------------------------------------------------------------
def innovations(which: list[int], value, variance, accepted=None) -> Innovations:
    n = len(which)
    return Innovations(
        stamp_ns=np.arange(n, dtype=np.int64),
        names=("gnss_east", "wheel_left", "never"),
        which=np.array(which, dtype=np.int64),
        value=np.asarray(value, dtype=float),
        variance=np.asarray(variance, dtype=float),
        accepted=np.ones(n, dtype=bool) if accepted is None else np.asarray(accepted),
    )


def test_white_innovations_of_their_variance_are_consistent_over_seeds():
    consistent = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        which, variance = rng.integers(0, 2, 500), rng.uniform(0.1, 5.0, 500)
        value = rng.standard_normal(500) * np.sqrt(variance)
        found = nis(innovations(which, value, variance))
        assert set(found) == {"gnss_east", "wheel_left"}
        consistent += [each.consistent for each in found.values()]
        assert abs(found["gnss_east"].lag1) < 5 / np.sqrt(found["gnss_east"].count)
    assert 0.92 <= np.mean(consistent) <= 0.98


def test_innovations_that_are_correlated_show_it():
    value = autoregressive(np.random.default_rng(2), 20_000, 0.7, 1)[:, 0]
    found = nis(innovations([0] * 20_000, value, np.ones(20_000)))["gnss_east"]
    assert found.lag1 == pytest.approx(0.7, abs=0.03)


def test_bounds_of_correlated_innovations_hold_their_mean():
    held = 0
    for seed in range(200):
        value = autoregressive(np.random.default_rng(seed), 4000, 0.95, 1)[:, 0]
        held += nis(innovations([0] * 4000, value, np.ones(4000)))["gnss_east"].consistent is True
    assert 0.91 <= held / 200 <= 0.98


def test_what_the_gate_refused_counts_apart():
    found = nis(innovations([0] * 4, [1.0, 10.0, -1.0, 1.0], [1.0] * 4, [True, False, True, True]))[
        "gnss_east"
    ]
    assert (found.count, found.accepted_share, found.mean) == (4, 0.75, 1.0)
    assert found.mean_all == pytest.approx(103 / 4)
    assert found.lag1 == pytest.approx(-1.0)


def test_innovations_all_refused_or_without_variance_are_survived():
    found = nis(innovations([0, 1, 1], [9.0, 1.0, 1.0], [1.0, 0.0, 1.0], [False, True, True]))
    assert np.isnan(found["gnss_east"].mean)
    assert found["gnss_east"].verdict is None
    assert found["gnss_east"].consistent is None
    assert found["wheel_left"].count == 1
    assert nis(innovations([], [], [])) == {}


# Protection levels --------------------------------------------------------------------------------
def test_protection_levels_are_exceeded_as_often_as_put_in():
    _, yaw = motion(STATE_S)
    along = np.where(np.arange(len(yaw)) % 10 == 0, -3.0, 1.0)
    series = states(STATE_S, along_across(yaw, along, 0.5 + 0 * yaw))
    series.protection_m[:] = [2.0, 1.0]
    series.protection_m[:10] = np.nan
    found = protection(errors(series, truth(TRUTH_S)))
    assert found.count == len(STATE_S) - 10
    assert found.exceeded_share == pytest.approx((0.1, 0.0), abs=1e-3)
    assert found.exceeded_any_share == found.exceeded_share[0]
    assert found.mean_m == pytest.approx((2.0, 1.0))


def test_without_levels_nothing_is_said_of_them():
    assert protection(errors(states(STATE_S), truth(TRUTH_S))) is None


def test_confidence_is_the_95_percent_of_the_tables():
    assert consistency.CONFIDENCE == 0.95
