"""Smooth curves through noisy nodes: against known curves, and against dense algebra."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Segment, built_in_line, curve
from tramstream.mapping.curve import between, bridge_variances, lengths_m, variances
from tramstream.mapping.fit import Curves, Fit, fit
from tramstream.mapping.smoother import (
    CURVATURE_STD_PER_M,
    DIRECTION_STD,
    filter_curves,
    smooth_curves,
)

Array = NDArray[np.float64]
MM, CM = 1e-3, 1e-2


def one(points: Array) -> Curves:
    """One chain, all nodes its own."""
    return Curves(np.array([0, len(points)]), points, np.ones(len(points), dtype=bool))


def map_nodes(line: Line, tolerance_m: float, rng: np.random.Generator) -> Array:
    """Arc lengths where a mapper would put nodes: chords are off the track by a tolerance."""
    at = [0.0]
    while at[-1] < line.length_m:
        bent = np.max(np.abs(line.curvature_per_m(at[-1] + np.linspace(0.0, 8.0, 9))))
        chord = min(math.sqrt(8 * tolerance_m / max(bent, 1e-6)), rng.uniform(10.0, 50.0))
        at.append(at[-1] + max(chord * rng.uniform(0.6, 1.2), 1.5))
    return np.array([*at[:-1], line.length_m])


def errors(fitted: Fit, line: Line) -> tuple[Array, Array, Array, Array]:
    """Left of the true curve, m, in yaw, rad, in curvature, 1/m; and the true curvature."""
    dense = np.arange(0.0, line.length_m, 0.05)
    track = line.position_l(dense)[:, :2]
    nearest = cKDTree(track).query(fitted.position)[1]
    yaw, bent = line.yaw_rad(dense[nearest]), line.curvature_per_m(dense[nearest])
    away = fitted.position - track[nearest]
    left = np.cos(yaw) * away[:, 1] - np.sin(yaw) * away[:, 0]
    turn = np.angle(np.exp(1j * (fitted.yaw_rad - yaw)))
    return left, turn, fitted.curvature_per_m - bent, bent


@pytest.fixture(scope="module")
def noisy() -> list[tuple[Fit, Line]]:
    """The built-in line as maps draw it, nodes off by 0.2 m."""
    line, found = built_in_line(), []
    for seed in range(3):
        rng = default_rng(seed)
        plan = line.position_l(map_nodes(line, 0.1, rng))[:, :2]
        found.append((fit(one(plan + rng.normal(0.0, 0.2, plan.shape))), line))
    return found


def test_noise_of_nodes_is_estimated(noisy: list[tuple[Fit, Line]]) -> None:
    for fitted, _ in noisy:
        assert fitted.node_std_m == pytest.approx(0.2, rel=0.2)


def test_curve_is_as_good_as_it_says(noisy: list[tuple[Fit, Line]]) -> None:
    left, turn, across_std, yaw_std, bent = ([] for _ in range(5))
    for fitted, line in noisy:
        found = errors(fitted, line)
        for series, value in zip(
            (left, turn, across_std, yaw_std, bent),
            (found[0], found[1], fitted.across_std_m, fitted.yaw_std_rad, found[3]),
            strict=True,
        ):
            series.append(value[5:-5])
    across = np.concatenate(left) / np.concatenate(across_std)
    heading = np.concatenate(turn) / np.concatenate(yaw_std)
    curvature = np.abs(np.concatenate(bent))
    assert np.sqrt(np.mean(np.concatenate(left) ** 2)) < 0.2  # nodes, with 15 m between them
    assert np.degrees(np.sqrt(np.mean(np.concatenate(turn) ** 2))) < 0.8
    for chosen in (curvature > 1 / 60, (curvature > 0) & (curvature <= 1 / 60), curvature == 0):
        # Three rides of 12 km, correlated over tens of metres: the means are good to 0.2.
        assert 0.6 < np.mean(across[chosen] ** 2) < 1.6
        assert 0.6 < np.mean(heading[chosen] ** 2) < 1.8


def test_errors_at_left_out_nodes_are_as_stated(noisy: list[tuple[Fit, Line]]) -> None:
    for fitted, _ in noisy:
        share = np.abs(fitted.left_out.error_m / fitted.left_out.std_m)
        assert len(share) > 80
        assert np.mean(np.minimum(share, 4.0) ** 2) == pytest.approx(1.0, abs=0.01)
        assert np.percentile(share, 68.3) == pytest.approx(1.0, abs=0.25)


def test_exact_nodes_are_passed_through_and_curvature_is_the_tracks() -> None:
    segments = [
        Segment(60.0),
        *curve(20.0, math.radians(90.0)),
        Segment(40.0),
        *curve(50.0, -1.0),
        Segment(80.0),
    ]
    line = Line(segments, [0.0], LocalLevel(0.87, 0.25, 300.0))
    at = np.arange(0.0, line.length_m, 3.0)
    nodes = line.position_l(at)[:, :2]
    fitted = fit(one(nodes), node_std_m=0.02)
    assert fitted.node_std_m == 0.02
    left, turn, bend, bent = errors(fitted, line)
    assert np.max(np.abs(left)) < 2 * CM
    assert np.degrees(np.max(np.abs(turn))) < 0.6
    assert np.sqrt(np.mean(bend**2)) < 0.003
    arc = (np.abs(bent) > 0.0499) & (np.abs(bent) < 0.0501)
    assert np.median(fitted.curvature_per_m[arc]) == pytest.approx(0.05, rel=0.03)
    distance = np.min(
        np.hypot(*(fitted.position[:, None] - nodes[None]).transpose(2, 0, 1)), axis=0
    )
    assert np.max(distance) < 0.55  # half the spacing of samples


def test_samples_are_even_and_close(noisy: list[tuple[Fit, Line]]) -> None:
    fitted, line = noisy[0]
    steps = np.hypot(*np.diff(fitted.position, axis=0).T)
    arcs = steps * (1 + (fitted.curvature_per_m[:-1] * steps) ** 2 / 24)
    spacing = fitted.length_m[0] / (len(fitted.position) - 1)
    assert spacing <= 1.0
    np.testing.assert_allclose(arcs, spacing, atol=1 * MM)
    assert fitted.length_m[0] == pytest.approx(line.length_m, rel=1e-3)
    assert fitted.node_arc_m[0] == 0.0
    assert fitted.node_arc_m[-1] == pytest.approx(fitted.length_m[0])
    assert np.all(np.diff(fitted.node_arc_m) > 0)
    np.testing.assert_allclose(np.diff(fitted.yaw_rad), 0.0, atol=0.1)  # continuous


def test_curve_does_not_depend_on_the_way_the_track_is_drawn() -> None:
    line = built_in_line()
    rng = default_rng(3)
    plan = line.position_l(map_nodes(line, 0.1, rng)[:120])[:, :2]
    plan += rng.normal(0.0, 0.1, plan.shape)
    there, back = fit(one(plan)), fit(one(plan[::-1].copy()))
    assert there.length_m == pytest.approx(back.length_m, abs=1 * CM)
    np.testing.assert_allclose(there.position, back.position[::-1], atol=1 * CM)
    np.testing.assert_allclose(there.curvature_per_m, -back.curvature_per_m[::-1], atol=2e-3)


@pytest.mark.parametrize(
    "points",
    [
        [[0.0, 0.0], [5.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [300.0, 1.0], [300.0, 1.0], [301.0, 40.0]],
        [[0.0, 0.0], [10.0, 0.0], [0.0, 0.1], [10.0, 0.2]],
    ],
)
def test_odd_chains_give_numbers(points: list[list[float]]) -> None:
    fitted = fit(one(np.array(points)))
    for series in (fitted.position, fitted.yaw_rad, fitted.across_std_m, fitted.yaw_std_rad):
        assert np.all(np.isfinite(series))
    assert fitted.length_m[0] > 0


# Algebra ------------------------------------------------------------------------------------------
def smoothed(u: Array, points: Array, q: Array, sigma: float) -> tuple[Array, Array, Array, float]:
    """States, their covariances, those of neighbours, logarithm of the likelihood."""
    n = len(u)
    x, ahead_x = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    P, ahead_P, cross = (np.empty((n, 3, 3)) for _ in range(3))
    starts = np.array([0, n])
    told = filter_curves(starts, u, points, q, sigma**2, x, P, ahead_x, ahead_P)
    smooth_curves(starts, u, q, x, P, ahead_x, ahead_P, cross, np.empty((n, 2)))
    return x, P, cross, told


def transition(h: float) -> Array:
    return np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])


def noise(h: float) -> Array:
    return np.array(
        [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
    )


def test_smoother_is_the_dense_solution() -> None:
    rng = default_rng(1)
    steps, n, sigma = rng.uniform(2.0, 9.0, 7), 8, 0.3
    u, q = np.concatenate([[0.0], np.cumsum(steps)]), rng.uniform(1e-4, 1e-3, 8)
    points = np.column_stack([u, 3 * np.sin(u / 9)]) + rng.normal(0.0, sigma, (8, 2))
    x, P, cross, _ = smoothed(u, points, q, sigma)
    # The joint Gaussian of all states, then conditioned on all nodes at once.
    prior = np.zeros((3 * n, 3 * n))
    prior[:3, :3] = np.diag([1e4 * sigma**2, DIRECTION_STD**2, CURVATURE_STD_PER_M**2])
    chord = points[1] - points[0]
    mean = np.zeros((2, 3 * n))
    mean[:, :3] = np.column_stack([points[0], chord / np.hypot(*chord), np.zeros(2)])
    for k, h in enumerate(steps):
        a, b = slice(3 * k, 3 * k + 3), slice(3 * k + 3, 3 * k + 6)
        F = transition(h)
        prior[b, : 3 * k + 3] = F @ prior[a, : 3 * k + 3]
        prior[: 3 * k + 3, b] = prior[b, : 3 * k + 3].T
        prior[b, b] = F @ prior[a, a] @ F.T + q[k] * noise(h)
        mean[:, b] = mean[:, a] @ F.T
    H = np.zeros((n, 3 * n))
    H[np.arange(n), 3 * np.arange(n)] = 1.0
    gain = np.linalg.solve(H @ prior @ H.T + sigma**2 * np.eye(n), H @ prior).T
    for axis in range(2):
        dense = mean[axis] + gain @ (points[:, axis] - H @ mean[axis])
        np.testing.assert_allclose(x[:, axis].ravel(), dense, rtol=1e-6, atol=1e-7)
    after = prior - gain @ H @ prior
    for k in range(n - 1):
        a, b = slice(3 * k, 3 * k + 3), slice(3 * k + 3, 3 * k + 6)
        np.testing.assert_allclose(P[k], after[a, a], rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(cross[k], after[a, b], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_bridge_is_the_process_tied_at_both_ends(share: float) -> None:
    h, q = 7.0, 2e-4
    first, F = q * noise(share * h), transition((1 - share) * h)
    whole = F @ first @ F.T + q * noise((1 - share) * h)
    tied = first - first @ F.T @ np.linalg.solve(whole, F @ first)
    found = bridge_variances(np.array([h]), np.array([share]), np.array([q]))
    assert found[0][0] == pytest.approx(tied[0, 0], rel=1e-9)
    assert found[1][0] == pytest.approx(tied[1, 1], rel=1e-9)


def test_quintic_meets_its_states_and_its_variances_those_of_nodes() -> None:
    rng = default_rng(2)
    begin, end, h = rng.normal(size=(4, 2, 3)), rng.normal(size=(4, 2, 3)), rng.uniform(1, 9, 4)
    for derivative in range(3):
        np.testing.assert_allclose(between(begin, end, h, 0.0, derivative), begin[..., derivative])
        np.testing.assert_allclose(
            between(begin, end, h, 1.0, derivative), end[..., derivative], atol=1e-12
        )
    A = rng.normal(size=(4, 6, 6))
    joint = A @ A.transpose(0, 2, 1)
    parts = joint[:, :3, :3], joint[:, :3, 3:], joint[:, 3:, 3:]
    across, turning = variances(parts, h, np.ones(4), np.ones(4))
    np.testing.assert_allclose(across, joint[:, 3, 3])
    np.testing.assert_allclose(turning, joint[:, 4, 4])


def test_length_of_a_circle() -> None:
    angle, radius = np.linspace(0.0, 1.0, 5), 20.0
    u = radius * angle
    states = np.stack(
        [
            np.stack([radius * np.sin(angle), np.cos(angle), -np.sin(angle) / radius], axis=1),
            np.stack([-radius * np.cos(angle), np.sin(angle), np.cos(angle) / radius], axis=1),
        ],
        axis=1,
    )
    found = lengths_m(states[:-1], states[1:], np.diff(u))
    np.testing.assert_allclose(found, 5.0, atol=1e-6)
