"""How well a noise model explains an axis at standstill: the exact likelihood of its block means.

Bias and walk z_k and the unstable part z_b are the states of a Kalman filter (docs/theory.md,
section 3.1); a block's mean is their mean over the block plus white noise, whose covariance with
what drives the states is not neglected. The first mean of a stretch sets the level. Details of the
octaves within a block (`blocks`) are independent, with twice the Allan variance as their variance.
The size of all noise and what the bias does with temperature are found in closed form, so that the
search has three numbers at most: B and K over N, and T_b.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.calibration.blocks import Blocks
from tramstream.analysis.calibration.noise import Noise
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]

STEADY = 1e-11
"""Change of the covariance in a block, as a part of it, from which the gains stay as they are."""
_SLOW = 0.01
"""Block over T_b below which series are used: the closed forms lose their digits there."""


class Step(NamedTuple):
    """One block of the model, white noise of density 1."""

    keep: float
    """Of z_b from the beginning of the block to its end."""
    share: float
    """Of z_b at the beginning in its mean over the block."""
    walk: float
    """Variance of what z_k gains,"""
    unstable: float
    """and of what z_b is driven by."""
    mean: float
    """Variance of the block's mean around what the states at its beginning say."""
    walk_mean: float
    """Covariances of the gains with the mean."""
    unstable_mean: float
    steady: float
    """Variance of z_b."""


def step_of(noise: Noise, block_s: float) -> Step:
    """The model of one block; `noise.white` is taken to be 1."""
    past = block_s / noise.time_s
    keep = math.exp(-past)
    share = -math.expm1(-past) / past
    if past < _SLOW:
        spread = past * (2 / 3 - past * (1 / 2 - past * 7 / 30))
    else:
        spread = 2 * (past + math.expm1(-past)) / past**2 - share**2
    variance, walk = noise.stationary_std**2, noise.walk**2 * block_s
    return Step(
        keep=keep,
        share=share,
        walk=walk,
        unstable=-variance * math.expm1(-2 * past),
        mean=1 / block_s + walk / 3 + variance * spread,
        walk_mean=walk / 2,
        unstable_mean=-variance * share * math.expm1(-past),
        steady=variance,
    )


class Sums(NamedTuple):
    """What a filter leaves of two series: the readings and the temperature."""

    readings: float
    """Squared innovations over their variance, summed."""
    both: float
    """The same of the products of both series' innovations,"""
    temperature: float
    """and of the temperature's."""
    log_variance: float
    numbers: int


@compiled
def innovations(readings: Array, temperature: Array, restarts: NDArray[np.bool_], s: Step) -> Sums:
    """Filter both series with the same gains.

    State: z_k with the bias, and z_b, at the beginning of a block.
    """
    yy, yt, tt, log_variance = 0.0, 0.0, 0.0, 0.0
    count = 0
    k_y, b_y, k_t, b_t = 0.0, 0.0, 0.0, 0.0
    p_kk, p_kb, p_bb = 0.0, 0.0, 0.0
    variance, gain_k, gain_b, height = 1.0, 0.0, 0.0, 0.0
    h, steady = s.share, False
    for i in range(len(readings)):
        if restarts[i]:  # the limit of a level that nothing was known of
            k_y, b_y, k_t, b_t = readings[i], 0.0, temperature[i], 0.0
            p_kk = s.walk - 2 * s.walk_mean + s.mean + h * h * s.steady
            p_kb = -(s.keep * h * s.steady + s.unstable_mean)
            p_bb = s.steady
            steady = False
            continue
        e_y = readings[i] - k_y - h * b_y
        e_t = temperature[i] - k_t - h * b_t
        if not steady:
            variance = p_kk + 2 * h * p_kb + h * h * p_bb + s.mean
            gain_k = (p_kk + h * p_kb + s.walk_mean) / variance
            gain_b = (s.keep * (p_kb + h * p_bb) + s.unstable_mean) / variance
            height = math.log(variance)
            now_kk = p_kk + s.walk - gain_k * gain_k * variance
            now_kb = s.keep * p_kb - gain_k * gain_b * variance
            now_bb = s.keep * s.keep * p_bb + s.unstable - gain_b * gain_b * variance
            change = abs(now_kk - p_kk) + abs(now_kb - p_kb) + abs(now_bb - p_bb)
            steady = change < STEADY * (p_kk + p_bb)
            p_kk, p_kb, p_bb = now_kk, now_kb, now_bb
        yy += e_y * e_y / variance
        yt += e_y * e_t / variance
        tt += e_t * e_t / variance
        log_variance += height
        count += 1
        k_y += gain_k * e_y
        b_y = s.keep * b_y + gain_b * e_y
        k_t += gain_k * e_t
        b_t = s.keep * b_t + gain_b * e_t
    return Sums(yy, yt, tt, log_variance, count)


class Found(NamedTuple):
    """A model's likelihood with what is found in closed form."""

    deviance: float
    """−2 ln L, up to a constant."""
    white: float
    """N, counts/√Hz."""
    per_degc: float
    """What the bias gains with a degree, counts; 0 where temperature is left out."""
    per_degc_std: float
    numbers: int
    """Of numbers that were explained."""


def likelihood(blocks: Blocks, noise: Noise, octaves: int, temperature: bool = False) -> Found:
    """Likelihood of a model whose B and K are given over N.

    Parameters
    ----------
    blocks : Blocks
    noise : Noise
        B/N, T_b, K/N; its `white` is 1.
    octaves : int
        How many of the octaves within blocks are used, from the longest.
    temperature : bool
        Whether the bias may follow the temperature.
    """
    other = blocks.temperature if temperature else np.zeros(len(blocks.mean))
    found = innovations(blocks.mean, other, blocks.restarts, step_of(noise, blocks.block_s))
    used = slice(len(blocks.half_s) - octaves, None)
    variance = 2 * noise.allan_variance(blocks.half_s[used])
    count = found.numbers + int(np.sum(blocks.details[used]))
    squares = found.readings + float(np.sum(blocks.squares[used] / variance))
    per_degc = per_degc_std = 0.0
    if temperature and found.temperature > 0:
        per_degc = found.both / found.temperature
        squares -= found.both * per_degc
    log_variance = found.log_variance + float(np.sum(blocks.details[used] * np.log(variance)))
    size = max(squares, 1e-300) / max(count, 1)
    if temperature and found.temperature > 0:
        per_degc_std = math.sqrt(size / found.temperature)
    deviance = count * math.log(size) + log_variance
    return Found(deviance, math.sqrt(size), per_degc, per_degc_std, count)
