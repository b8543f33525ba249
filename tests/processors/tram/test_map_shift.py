"""A map that is beside the rails as a whole: two kinds of maps, and what the rides show of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import test_tram_kernels as held
from rides import altered

from tramstream.config import Map, Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import TRACKING
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.gnss_position import GnssPosition
from tramstream.processors.tram_model.map_shift import TRUE, TRUE_SHARE
from tramstream.processors.tram_model.states import SIZE, Ix
from tramstream.processors.tram_model.track import TrackDistance

SHIFT_STD_M = 1.0
FIX_STD_M = 0.6


def with_map() -> Vehicle:
    return altered(held.vehicle(), map=Map(network="any.tracks", std_m=0.5, shift_over_std=2.0))


def told(shift_std_m: float, across_m: list[float]) -> tuple[TramFilter, float]:
    """A filter that was shown fixes so far left of a track that goes east, and their likelihood.

    Its heading is known, its antenna is where the fixes are: only place and shift are open.
    """
    ekf = TramFilter(with_map(), held.GRAVITY)
    P = np.zeros((SIZE, SIZE))
    P[Ix.EAST, Ix.EAST] = P[Ix.NORTH, Ix.NORTH] = 100.0
    P[Ix.MAP_EAST, Ix.MAP_EAST] = P[Ix.MAP_NORTH, Ix.MAP_NORTH] = shift_std_m**2
    ekf.x, ekf.P = np.zeros(SIZE), P
    antenna = held.vehicle().gnss
    assert antenna is not None
    ahead, left, _ = antenna.lever_arm_m
    log_likelihood = 0.0
    for each in across_m:
        x = ekf.state
        off = x[Ix.NORTH] - x[Ix.MAP_NORTH]
        ekf.apply(TrackDistance(0.0, 1.0, off, 0.3, held.INFINITE))
        log_likelihood += ekf.log_likelihood
        ekf.apply(GnssPosition(ahead, left + each, FIX_STD_M**2, 0.0, held.INFINITE, held.INFINITE))
        log_likelihood += ekf.log_likelihood
    return ekf, log_likelihood


def plain(ekf: TramFilter) -> tuple[Array, Array]:
    """Motion and its covariance by the states themselves."""
    return ekf.x[:7, 0].copy(), ekf.P[:7, :7].copy()


@pytest.mark.parametrize("across_m", [[0.1, -0.2, 0.1], [1.4, 0.9], [2.0, 1.7, 2.2, 1.9]])
def test_estimate_is_the_mean_of_two_filters_each_of_which_knows_its_kind_of_map(
    across_m: list[float],
) -> None:
    """Identity: a bank of two filters, weighed by all their innovations, has the same."""
    far, far_log = told(SHIFT_STD_M, across_m)
    near, near_log = told(TRUE * SHIFT_STD_M, across_m)
    odds = TRUE_SHARE / (1.0 - TRUE_SHARE) * math.exp(near_log - far_log)
    weights = odds / (1.0 + odds), 1.0 / (1.0 + odds)
    kinds = plain(near), plain(far)
    mean = sum(weight * x for weight, (x, _) in zip(weights, kinds, strict=True))
    spread = sum(
        weight * (P + np.outer(x - mean, x - mean))
        for weight, (x, P) in zip(weights, kinds, strict=True)
    )
    said = far.estimate(0, TRACKING, False, [])
    np.testing.assert_allclose(said.motion, mean, atol=1e-9)
    np.testing.assert_allclose(said.covariance, spread, atol=1e-9)


def test_filter_without_a_map_says_its_states() -> None:
    ekf = TramFilter(held.vehicle(), held.GRAVITY)
    rng = np.random.default_rng(1)
    x, P = held.state(rng), held.covariance(rng)
    x[[Ix.PIVOT, Ix.GNSS_DELAY]] = 0.0
    ekf.x, ekf.P = x, P
    np.testing.assert_allclose(ekf.estimate(0, TRACKING, False, []).motion[2:], x[2:7])


def test_shift_never_becomes_less_certain_than_it_was() -> None:
    ekf = TramFilter(with_map(), held.GRAVITY)
    for slot, variance in ((Ix.MAP_EAST, SHIFT_STD_M**2), (Ix.MAP_NORTH, 0.01)):
        ekf.reset(slot, 0.0, math.sqrt(variance))
    for _ in range(20_000):
        ekf.walk_map()
    assert ekf.variances[Ix.MAP_EAST] == pytest.approx(SHIFT_STD_M**2)
    assert ekf.variances[Ix.MAP_NORTH] == pytest.approx(SHIFT_STD_M**2, rel=0.01)
