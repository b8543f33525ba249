"""The joint fit of N, B, T_b and K, held to processes whose coefficients are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from standing import drawn

from tramstream.analysis.calibration.allan import Run
from tramstream.analysis.calibration.blocks import Blocks, block_size, blocks_of
from tramstream.analysis.calibration.fit import Fit, fit, value_of
from tramstream.analysis.calibration.likelihood import innovations, likelihood, step_of
from tramstream.analysis.calibration.noise import Noise, whittle_bound

Array = NDArray[np.float64]
NOISE = Noise(2.0, 1.5, 30.0, 0.05)
BLOCK_S, COUNT, OCTAVES = 1.0, 6000, 5
SEEDS = 8


def fits(noise: Noise, seeds: int = SEEDS, count: int = COUNT) -> list[Fit]:
    return [
        fit(drawn(noise, BLOCK_S, count, np.random.default_rng((7, seed)), OCTAVES))
        for seed in range(seeds)
    ]


def normal_covariance(noise: Noise, block_s: float, count: int, inner: int) -> Array:
    """Covariance of block means, white noise of density 1, straight from the definition."""
    time_s = (np.arange(count * inner) + 0.5) * block_s / inner
    walk = noise.walk**2 * np.minimum.outer(time_s, time_s)
    apart = np.abs(np.subtract.outer(time_s, time_s))
    unstable = noise.stationary_std**2 * np.exp(-apart / noise.time_s)
    means = (walk + unstable).reshape(count, inner, count, inner).mean((1, 3))
    found: Array = means + np.eye(count) / block_s
    return found


@pytest.mark.parametrize("time_s", [3.0, 40.0, 1e4])
def test_likelihood_is_the_normal_density_of_the_means(time_s: float) -> None:
    noise, count, block_s = Noise(1.0, 0.7, time_s, 0.2), 30, 2.0
    covariance = normal_covariance(noise, block_s, count, 80)
    rng = np.random.default_rng(3)
    mean = np.linalg.cholesky(covariance) @ rng.standard_normal(count) + 5.0
    warm = rng.standard_normal(count)
    # The level is unknown: what is known is what differs.
    apart = np.diff(np.eye(count), axis=0)
    inverse = np.linalg.inv(apart @ covariance @ apart.T)
    restarts = np.arange(count) == 0
    found = innovations(mean, warm, restarts, step_of(noise, block_s))
    y, t = apart @ mean, apart @ warm
    assert found.numbers == count - 1
    assert found.readings == pytest.approx(y @ inverse @ y, rel=1e-3)
    assert found.both == pytest.approx(y @ inverse @ t, rel=1e-3)
    assert found.temperature == pytest.approx(t @ inverse @ t, rel=1e-3)
    log_size = np.linalg.slogdet(apart @ covariance @ apart.T)[1]
    assert found.log_variance == pytest.approx(log_size, abs=0.02)


def test_series_and_closed_form_of_a_slow_process_meet() -> None:
    below, above = (step_of(Noise(1.0, 1.0, 100.0 * each), 1.0) for each in (1.0001, 0.9999))
    for a, b in zip(below, above, strict=True):
        assert a == pytest.approx(b, rel=1e-3)


def test_stretches_are_independent_and_each_has_its_level() -> None:
    rng = np.random.default_rng(1)
    mean = rng.standard_normal(60)
    none, restarts = np.zeros(60), np.isin(np.arange(60), (0, 25))
    step = step_of(Noise(1.0, 0.5, 10.0, 0.1), 1.0)
    both = innovations(mean, none, restarts, step)
    moved = mean + np.where(np.arange(60) < 25, 0.0, 100.0)
    assert innovations(moved, none, restarts, step).readings == pytest.approx(both.readings)
    parts = [
        innovations(m, none[: len(m)], np.arange(len(m)) == 0, step) for m in np.split(mean, [25])
    ]
    assert both.readings == pytest.approx(sum(each.readings for each in parts))
    assert both.numbers == 58


def test_errors_are_those_that_the_bound_allows_and_the_fit_knows_them() -> None:
    found = fits(NOISE)
    bounds = whittle_bound(NOISE, COUNT * BLOCK_S, 2**OCTAVES / BLOCK_S)
    for name in ("N", "B", "T_b", "K"):
        true = value_of(NOISE, name)
        error = np.array([value_of(each.full, name) / true - 1 for each in found])
        assert bounds[name] < 0.5
        assert float(np.sqrt(np.mean(error**2))) < 1.5 * bounds[name], name
        seen = [each for each in found if name in each.std]
        assert len(seen) > SEEDS / 2
        scaled = np.array(
            [math.log(value_of(each.noise, name) / true) / each.std[name] for each in seen]
        )
        low, high = stats.chi2.ppf([0.001, 0.999], len(seen)) / len(seen)
        assert low < float(np.mean(scaled**2)) < high, name
        inside = [low <= true <= high for low, high in (each.interval(name) for each in seen)]
        assert np.mean(inside) > 0.7


def test_what_is_not_there_is_not_seen_and_its_limit_holds() -> None:
    for each in fits(Noise(2.0), 3, 3000):
        assert set(each.std) == {"N"}
        assert set(each.limit) == {"B", "K"}
        assert 0 < each.limit["K"] < 0.05
    bounded = [
        each.limit["K"] for each in fits(Noise(2.0, walk=1e-4), 3, 3000) if "K" in each.limit
    ]
    assert all(limit > 1e-4 for limit in bounded)


def test_flat_part_below_a_strong_walk_gets_a_limit_and_no_figure() -> None:
    """The reference gyroscope's: its walk is 300 times as strong (docs/theory.md, section 3.9)."""
    noise = Noise(0.00011344, 0.000029088, 100.0, 0.000075630)
    for each in fits(noise, 2, 3000):
        assert "B" not in each.std
        assert each.limit["B"] > noise.instability
        assert each.noise.walk == pytest.approx(noise.walk, rel=5 * each.std["K"])


def test_temperature_is_told_from_the_walk_and_taken_out() -> None:
    per_degc, errors = 0.8, []
    for seed in range(4):
        blocks = drawn(NOISE, BLOCK_S, 3000, np.random.default_rng((9, seed)), OCTAVES)
        degc = 20 + 5 * np.sin(np.arange(3000) / 300)
        warm = blocks._replace(mean=blocks.mean + per_degc * degc, temperature=degc)
        found = fit(warm)
        errors.append((found.per_degc - per_degc) / found.per_degc_std)
        assert found.noise.white == pytest.approx(fit(blocks).noise.white, rel=1e-3)
        still = fit(blocks._replace(temperature=np.full(3000, 20.0)))
        assert math.isnan(still.per_degc)
        assert not still.temperature_matters
    low, high = stats.chi2.ppf([0.001, 0.999], len(errors)) / len(errors)
    assert low < np.mean(np.square(errors)) < high


def test_fast_noise_that_is_not_white_is_left_out() -> None:
    blocks = drawn(NOISE, BLOCK_S, 3000, np.random.default_rng(2), OCTAVES)
    filtered = blocks.squares.copy()
    filtered[:2] *= (0.3, 0.8)  # a sensor that has a low-pass of its own
    found = fit(blocks._replace(squares=filtered))
    assert found.white_from_s == pytest.approx(float(blocks.half_s[2]))
    assert found.noise.white == pytest.approx(NOISE.white, rel=5 * found.std["N"])
    assert fit(blocks).white_from_s == pytest.approx(float(blocks.half_s[0]))


def test_blocks_keep_all_squares_of_the_samples() -> None:
    rng = np.random.default_rng(5)
    counts = np.rint(300 * rng.standard_normal(200_000)).astype(np.int16)
    runs = [Run(10, 150_010), Run(150_100, 199_000)]
    size = block_size(runs, 50.0)
    none: Array = np.zeros(0)
    blocks = blocks_of(counts, runs, 50.0, (none, none))
    assert size == 32  # 12,000 blocks at most
    assert np.count_nonzero(blocks.restarts) == 2
    for run, first in zip(runs, np.flatnonzero(blocks.restarts).tolist(), strict=True):
        part = counts[run.start : run.start + size].astype(float)
        assert blocks.mean[first] == part.mean()
    energy = size * float(blocks.mean @ blocks.mean)
    halves = blocks.half_s * 50.0
    energy += float(np.sum(halves / 2 * blocks.squares))
    whole = [counts[run.start : run.start + (run.end - run.start) // size * size] for run in runs]
    expected = float(sum(np.sum(part.astype(float) ** 2) for part in whole))
    assert energy == pytest.approx(expected, rel=1e-12)


def test_temperature_of_a_block_is_what_was_read_in_it() -> None:
    counts = np.zeros(20_000 * 64, np.int16)
    number = np.arange(19, len(counts), 20).astype(float)
    blocks = blocks_of(counts, [Run(0, len(counts))], 100.0, (number, 20 + number / len(counts)))
    size = block_size([Run(0, len(counts))], 100.0)
    centre = np.arange(len(blocks.mean)) * size + size / 2
    np.testing.assert_allclose(blocks.temperature, 20 + centre / len(counts), atol=1e-4)


def test_deviance_does_not_hang_on_the_unit() -> None:
    blocks = drawn(NOISE, BLOCK_S, 500, np.random.default_rng(4), OCTAVES)
    noise = Noise(1.0, 0.7, 20.0, 0.01)
    one = likelihood(blocks, noise, OCTAVES)
    larger = Blocks(*(blocks._replace(mean=1e3 * blocks.mean, squares=1e6 * blocks.squares)))
    other = likelihood(larger, noise, OCTAVES)
    assert other.white == pytest.approx(1e3 * one.white)
    assert other.deviance - one.deviance == pytest.approx(2 * one.numbers * math.log(1e3), rel=1e-9)


def test_blocks_are_half_a_second_long_where_there_are_enough_of_them() -> None:
    assert block_size([Run(0, 7000)], 20.0) == 8
    assert block_size([Run(0, 2000)], 100.0) == 8  # 250 blocks
    assert block_size([Run(0, 100)], 100.0) == 1
    assert block_size([Run(0, 43_200_000)], 2000.0) == 4096
