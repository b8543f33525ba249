"""The two-state filter: filterpy's dense algebra as authority, and consistency over many seeds."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from tramstream.processors.distance import kalman1d

RELATIVE = 1e-12
"""Two orders of summation of the same few terms."""

numbers = st.floats(-1e3, 1e3).map(lambda value: round(value, 6))
positive = st.floats(1e-3, 1e3)


def dense(x: np.ndarray, P: np.ndarray) -> KalmanFilter:
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.x, kalman.P = x.reshape(2, 1).copy(), P.copy()
    return kalman


def assert_same(ours: kalman1d.TwoStateFilter, theirs: KalmanFilter) -> None:
    """Equal but for rounding of the terms that were added, which may cancel out in x and P."""
    terms = {
        "x": np.abs(theirs.x_prior).max() + np.abs(theirs.K * theirs.y).max(),
        "P": np.abs(theirs.P_prior).max(),
    }
    terms |= {"x_post": terms["x"], "P_post": terms["P"], "y": terms["x"]}
    for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "S", "SI", "K"):
        mine, reference = getattr(ours, name), getattr(theirs, name)
        assert mine.shape == reference.shape, name
        scale = terms.get(name, np.abs(reference).max())
        np.testing.assert_allclose(
            mine, reference, rtol=RELATIVE, atol=RELATIVE * scale, err_msg=name
        )
    assert ours.z.item() == np.asarray(theirs.z).item()


@settings(max_examples=60)
@given(
    x=st.tuples(numbers, numbers),
    root=st.tuples(positive, numbers, positive),
    steps=st.lists(
        st.tuples(st.floats(0.001, 10.0), positive, numbers, positive, st.booleans()),
        min_size=1,
        max_size=6,
    ),
)
def test_written_out_filter_equals_filterpys_dense_result(
    x: tuple[float, float], root: tuple[float, float, float], steps: list[tuple]
) -> None:
    L = np.array([[root[0], 0.0], [root[1], root[2]]])
    start = np.array(x), L @ L.T
    for dt_s, acceleration_std, z, R, speed in steps:
        # Started alike in each step, so that only the step itself is compared.
        ours, theirs = kalman1d.distance_filter(*start), dense(*start)
        F = kalman1d.transition(dt_s)
        Q = kalman1d.acceleration_noise(dt_s, acceleration_std)
        H = kalman1d.SPEED if speed else kalman1d.POSITION
        for kalman in (ours, theirs):
            kalman.predict(F=F, Q=Q)
        np.testing.assert_allclose(ours.P, theirs.P, rtol=RELATIVE, atol=RELATIVE * theirs.P.max())
        theirs.x, theirs.P = ours.x.copy(), ours.P.copy()
        theirs.x_prior, theirs.P_prior = ours.x.copy(), ours.P.copy()
        for kalman in (ours, theirs):
            kalman.update(z, R=R, H=H)
        assert_same(ours, theirs)
        start = ours.x[:, 0], ours.P


def test_general_matrices_give_filterpys_result() -> None:
    rng = np.random.default_rng(5)
    x, root = rng.normal(size=2), rng.normal(size=(2, 2))
    ours, theirs = kalman1d.distance_filter(x, root @ root.T), dense(x, root @ root.T)
    for kalman in (ours, theirs):
        kalman.F = np.array([[0.9, 0.2], [-0.1, 1.1]])
        kalman.H = np.array([[0.7, -0.4]])
        kalman.Q, kalman.R = np.array([[0.3, 0.1], [0.1, 0.5]]), np.array([[0.2]])
        kalman.predict()
        kalman.update(np.array([[1.5]]))
    assert_same(ours, theirs)
    assert ours.log_likelihood == pytest.approx(theirs.log_likelihood, rel=RELATIVE)
    assert ours.likelihood == pytest.approx(theirs.likelihood, rel=RELATIVE)
    assert ours.mahalanobis == pytest.approx(theirs.mahalanobis, rel=RELATIVE)


@given(
    x=st.tuples(numbers, numbers),
    root=st.tuples(positive, numbers, positive),
    dt_s=st.floats(1e-3, 60.0),
    acceleration_std=positive,
)
def test_moving_is_predicting_to_the_same_bits(
    x: tuple[float, float],
    root: tuple[float, float, float],
    dt_s: float,
    acceleration_std: float,
) -> None:
    L = np.array([[root[0], 0.0], [root[1], root[2]]])
    moved, predicted = (kalman1d.distance_filter(np.array(x), L @ L.T) for _ in range(2))
    moved.move(dt_s, acceleration_std)
    F, Q = kalman1d.transition(dt_s), kalman1d.acceleration_noise(dt_s, acceleration_std)
    predicted.predict(F=F, Q=Q)
    assert moved.state == predicted.state
    assert moved.covariance == predicted.covariance
    np.testing.assert_array_equal(moved.P_prior, predicted.P_prior)
    assert moved.covariance == tuple(moved.P.ravel())


def test_what_is_handed_out_cannot_be_written_to_unseen() -> None:
    kalman = kalman1d.distance_filter(np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        kalman.P[0, 0] = 5.0
    kalman.P = kalman.P * 5.0
    np.testing.assert_array_equal(kalman.P, 5.0 * np.eye(2))


def test_rare_calls_go_to_filterpy() -> None:
    ours = kalman1d.distance_filter(np.array([1.0, 2.0]), np.eye(2))
    theirs = dense(np.array([1.0, 2.0]), np.eye(2))
    for kalman in (ours, theirs):
        kalman.predict(u=np.array([[3.0]]), B=np.array([[0.5], [1.0]]), F=np.eye(2), Q=0.25)
        kalman.update(None)
    for mine, reference in ((ours.x, theirs.x), (ours.P, theirs.P), (ours.y, theirs.y)):
        np.testing.assert_array_equal(mine, reference)
    assert ours.update(None) is None


def test_gate_reports_what_it_refuses_and_changes_nothing() -> None:
    kalman = kalman1d.distance_filter(np.zeros(2), np.diag([3.0, 0.0]))
    refused = kalman.update(6.1, R=1.0, H=kalman1d.POSITION, gate_sigma=3.0)
    assert refused == kalman1d.Verdict(6.1, 4.0, accepted=False)
    np.testing.assert_array_equal(kalman.x, np.zeros((2, 1)))
    np.testing.assert_array_equal(kalman.P, np.diag([3.0, 0.0]))
    accepted = kalman.update(6.0, R=1.0, H=kalman1d.POSITION, gate_sigma=3.0)
    assert accepted == kalman1d.Verdict(6.0, 4.0, accepted=True)
    assert kalman.x[0, 0] == pytest.approx(4.5)


def test_measurement_that_is_no_number_is_refused() -> None:
    kalman = kalman1d.distance_filter(np.zeros(2), np.eye(2))
    verdict = kalman.update(float("nan"), R=1.0, H=kalman1d.SPEED)
    assert verdict is not None
    assert not verdict.accepted
    assert np.isfinite(kalman.x).all()


def test_posterior_does_not_share_memory_with_what_was_handed_out() -> None:
    kalman = kalman1d.distance_filter(np.zeros(2), np.eye(2))
    kalman.update(1.0, R=1.0, H=kalman1d.POSITION)
    x, P = kalman.x, kalman.P
    before = x.copy(), P.copy()
    kalman.predict(F=kalman1d.transition(1.0), Q=np.eye(2))
    kalman.update(5.0, R=1.0, H=kalman1d.POSITION)
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(P, before[1])


def test_acceleration_noise_is_that_of_one_acceleration_per_step() -> None:
    gain = np.array([[0.5 * 0.2**2], [0.2]])
    np.testing.assert_allclose(
        kalman1d.acceleration_noise(0.2, 3.0), gain @ gain.T * 9.0, rtol=RELATIVE
    )


def test_nees_lies_inside_both_bounds_over_many_seeds() -> None:
    runs, steps, acceleration_std, sigma = 200, 60, 0.7, 2.0
    P0 = np.diag([4.0, 1.0])
    nees, nis = np.zeros((runs, steps)), np.zeros((runs, steps))
    for run in range(runs):
        rng = np.random.default_rng(run)
        truth = rng.multivariate_normal([0.0, 0.0], P0)
        kalman = kalman1d.distance_filter(np.zeros(2), P0)
        for step in range(steps):
            dt_s = rng.uniform(0.05, 1.0)
            gain = np.array([0.5 * dt_s**2, dt_s])
            truth = kalman1d.transition(dt_s) @ truth + gain * rng.normal(0.0, acceleration_std)
            kalman.predict(
                F=kalman1d.transition(dt_s),
                Q=kalman1d.acceleration_noise(dt_s, acceleration_std),
            )
            H = kalman1d.POSITION if step % 3 else kalman1d.SPEED
            z = (H @ truth).item() + rng.normal(0.0, sigma)
            verdict = kalman.update(z, R=sigma**2, H=H)
            assert verdict is not None
            error = truth - kalman.x[:, 0]
            nees[run, step] = error @ np.linalg.solve(kalman.P, error)
            nis[run, step] = verdict.innovation**2 / verdict.variance
    for step in (0, 5, 20, steps - 1):  # across runs the errors are independent
        low, high = chi2.ppf([0.025, 0.975], 2 * runs)
        assert low <= nees[:, step].sum() <= high
    low, high = chi2.ppf([0.025, 0.975], runs * steps)  # innovations are white
    assert low <= nis.sum() <= high
