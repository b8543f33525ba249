"""The overlapping Allan deviation beside allantools, and what the noise model expects of it."""

from __future__ import annotations

import itertools
import math

import allantools
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate

from tramstream.analysis.calibration.allan import Run, octaves, overlapping, tangents
from tramstream.analysis.calibration.noise import Noise, gauss_markov, whittle_bound

RATE_HZ = 250.0
REFERENCE = Noise(0.00022563, 0.000035316, 100.0, 9e-7)
"""The reference accelerometer: docs/theory.md, section 3.9."""


def walk(count: int, dtype: type, seed: int = 1) -> NDArray[np.int32]:
    rng = np.random.default_rng(seed)
    found = 9810 + 20 * rng.standard_normal(count) + np.cumsum(0.3 * rng.standard_normal(count))
    counts: NDArray[np.int32] = np.rint(found).astype(dtype)
    return counts


@pytest.mark.parametrize("count", [3, 17, 64, 1000, 20_001])
@pytest.mark.parametrize("dtype", [np.int16, np.int32])
def test_deviation_is_that_of_allantools_on_every_tau(count: int, dtype: type) -> None:
    counts = walk(count, dtype)
    averaged = [m for m in (1, 2, 3, 4, 7, 8, 16, 100, 1024, 5000) if 2 * m + 1 <= count]
    own = overlapping(counts, [Run(0, count)], RATE_HZ, averaged)
    tau_s, deviation, _, _ = allantools.oadev(
        counts.astype(float), rate=RATE_HZ, data_type="freq", taus=np.array(averaged) / RATE_HZ
    )
    assert len(tau_s) > 0
    # It leaves a τ out that has too few terms for a deviation of its own.
    np.testing.assert_allclose(own.tau_s[: len(tau_s)], tau_s, rtol=1e-12)
    np.testing.assert_allclose(own.deviation[: len(tau_s)], deviation, rtol=1e-9)


def test_no_term_reaches_out_of_its_run() -> None:
    counts = walk(5000, np.int32)
    inside = overlapping(counts[1000:3000], [Run(0, 2000)], RATE_HZ, [1, 4, 64])
    counts[:1000] += 1000
    counts[3000:] -= 77
    part = overlapping(counts, [Run(1000, 3000)], RATE_HZ, [1, 4, 64])
    np.testing.assert_array_equal(part.deviation, inside.deviation)
    np.testing.assert_array_equal(part.terms, 2001 - 2 * np.array([1, 4, 64]))


def test_runs_count_by_their_terms() -> None:
    counts, runs = walk(3000, np.int32), [Run(0, 1000), Run(1500, 3000)]
    both = overlapping(counts, runs, RATE_HZ, [8])
    each = [overlapping(counts, [run], RATE_HZ, [8]) for run in runs]
    terms = np.array([int(one.terms[0]) for one in each])
    mean = np.sum(terms * [float(one.deviation[0]) ** 2 for one in each]) / terms.sum()
    assert both.terms[0] == terms.sum()
    assert both.deviation[0] == pytest.approx(math.sqrt(mean), rel=1e-12)


def test_octaves_end_where_nine_averages_fit() -> None:
    assert octaves([Run(0, 8)]) == []
    assert octaves([Run(0, 9)]) == [1]
    assert octaves([Run(5, 30), Run(100, 172)]) == [1, 2, 4, 8]


def test_model_expects_the_deviation_that_its_spectrum_gives() -> None:
    """IEEE Std 952-1997: σ²(τ) = 4 ∫ S(f) sin⁴(π f τ) / (π f τ)² df, S two-sided."""
    noise = Noise(1.0, 0.8, 3.0, 0.2)
    for tau_s in (0.5, 3.0, 40.0):

        def part(log_f: float, tau_s: float = tau_s) -> float:
            f = math.exp(log_f)
            response = math.sin(math.pi * f * tau_s) ** 4 / (math.pi * f * tau_s) ** 2
            return 4 * float(noise.density(f)) * response * f

        edges = np.linspace(math.log(1e-7), math.log(3e3 / tau_s), 2000)
        whole = sum(
            integrate.fixed_quad(np.vectorize(part), a, b, n=20)[0]
            for a, b in itertools.pairwise(edges)
        )
        assert whole == pytest.approx(float(noise.allan_variance(tau_s)), rel=2e-3)


def test_gauss_markov_has_its_series_and_its_peak() -> None:
    x = np.array([0.9e-3, 1.1e-3])
    np.testing.assert_allclose(gauss_markov(x), 2 * x / 3 - x**2 / 2, rtol=1e-6)
    grid = np.linspace(1.0, 3.0, 2001)
    peak = float(grid[np.argmax(gauss_markov(grid))])
    assert peak == pytest.approx(
        1.89, abs=0.01
    )  # the work's constants: docs/theory.md, section 3.1
    flat = math.sqrt(float(Noise(1e-9, 1.0, 1.0).allan_variance(peak)))
    assert flat == pytest.approx(0.664, abs=0.003)


def test_bound_of_white_noise_alone_is_that_of_a_variance() -> None:
    assert whittle_bound(Noise(2.0), 100.0, 50.0) == {"N": pytest.approx(1 / math.sqrt(2 * 5000))}
    bounds = whittle_bound(REFERENCE, 21600.0, 2000.0)
    assert bounds["N"] == pytest.approx(1 / math.sqrt(2 * 21600 * 2000), rel=0.01)
    assert all(0.01 < bounds[name] < 0.5 for name in ("B", "T_b", "K"))


def test_bound_falls_with_the_length_of_the_record() -> None:
    short, long = (whittle_bound(REFERENCE, hours * 3600.0, 100.0) for hours in (3, 12))
    assert all(long[name] < 0.75 * short[name] for name in short)


def test_tangents_of_lines_are_their_coefficients() -> None:
    curve = overlapping(walk(4000, np.int32), [Run(0, 4000)], 1.0, octaves([Run(0, 4000)]))
    tau = np.geomspace(0.001, 1e4, 60)

    def read(noise: Noise) -> tuple[float, float, float, float]:
        deviation = np.sqrt(noise.allan_variance(tau))
        made = curve._replace(
            tau_s=tau, deviation=deviation, low=deviation, high=deviation, terms=np.ones(60, int)
        )
        return tangents(made)

    only_white = read(Noise(2.0))
    assert only_white[0] == pytest.approx(2.0, rel=0.01)
    assert all(map(math.isnan, only_white[1:]))
    n, b, time_s, k = read(Noise(0.01, 0.1, 1.0, 1e-4))
    assert n == pytest.approx(0.01, rel=0.1)
    assert b == pytest.approx(0.1, rel=0.1)
    assert time_s == pytest.approx(1.0, rel=0.3)
    assert k == pytest.approx(1e-4, rel=0.2)
