"""Do errors of the fixes last for minutes? Hypotheses of their sizes, weighed by what is seen.

The error is taken for the sum of two, one that lasts the correlation time and one that lasts for
`SLOW_TAU_S`, of unknown sizes: each hypothesis is a pair of variances over the stated one. Seen is
how the fixes drift against the way that the filter goes by itself, which is free of the place that
they gave it. Each hypothesis follows that with a small Kalman filter (an unknown constant and both
errors, on either axis) and weighs as much as it foretells, beside what was thought of receivers
before any was seen. A drift that none of them foretells tells nothing of them.

Equations: docs/theory.md, section 6.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tramstream.clock import S
from tramstream.estimation.kalman import Array

SLOW_TAU_S = 600.0
"""For so long a slow error lasts: ionosphere, orbits, base station; chosen by hand."""
SAMPLE_S = 5.0
"""Drifts are looked at so far apart in time, whatever the rate of the fixes; chosen by hand."""
FAST = (0.03, 0.1, 0.35, 1.0, 2.0, 4.0, 9.0, 25.0, 100.0)
FAST_PRIOR = (0.05, 0.05, 0.15, 0.3, 0.25, 0.08, 0.05, 0.04, 0.03)
SLOW = (0.03, 0.15, 0.6, 2.0, 5.0, 12.0)
SLOW_PRIOR = (0.85, 0.1, 0.03, 0.01, 0.006, 0.004)
"""Variances over the stated one, and how likely each is thought to be before anything is seen; of
the slow ones where the fast is as stated or more. Chosen by hand: see docs/accuracy.md, *Fixes that
are not as they say*."""
BELIEVED = 0.8
DISBELIEF = 2.0
"""A receiver whose error in all is less than the first of these times the stated variance is
thought rare, by the second as a power of what is missing; chosen by hand."""
MISSING_PRIOR = (0.1, 0.2, 0.3, 0.2, 0.12, 0.08)
"""As `SLOW_PRIOR`, where the fast one is less than stated: the rest is somewhere; by hand."""
FORGET_S = 1800.0
"""What was seen so long ago weighs 1/e; chosen by hand."""
WHITE_SHARE, WHITE_FLOOR_M = 0.1, 0.02
"""Part of the stated deviation, and least deviation, that drifts err by at each look."""
ASTRAY_SHARE, ASTRAY_M = 0.01, 10.0
"""How often, and by how much, fixes jump or the filter goes astray; chosen by hand."""
LOST_S = 12.0
"""What has jumped for so long is a new constant; chosen by hand, longer than multipath jumps."""
COUNT = len(FAST) * len(SLOW)
_FAST = np.repeat(FAST, len(SLOW))
_SLOW = np.tile(SLOW, len(FAST))
_FAST_STD, _SLOW_STD = np.sqrt(_FAST), np.sqrt(_SLOW)


def _prior() -> Array:
    """Logarithm of what each pair is thought to be worth."""
    missing = np.minimum((_FAST + _SLOW) / BELIEVED, 1.0) ** DISBELIEF
    slow = np.where(_FAST < 1.0, np.tile(MISSING_PRIOR, len(FAST)), np.tile(SLOW_PRIOR, len(FAST)))
    weight: Array = np.log(np.repeat(FAST_PRIOR, len(SLOW)) * slow * missing)
    return weight


_PRIOR = _prior()


class Sizes(NamedTuple):
    """Variances over the stated one: squares of mean deviations."""

    fast: float
    """Of what lasts for the correlation time,"""
    slow: float
    """and of what lasts for minutes."""


def _sizes(weight: Array) -> Sizes:
    """Give how large the errors are by the logarithms of what the hypotheses are worth."""
    shares = np.exp(weight - weight.max())
    shares /= shares.sum()
    return Sizes(float(shares @ _FAST_STD) ** 2, float(shares @ _SLOW_STD) ** 2)


_UNSEEN = _sizes(_PRIOR)


@dataclass
class SlowFixErrorMemory:
    """What `SlowFixError` remembers."""

    stamp_ns: int = 0
    """Of the last look; 0 before the first."""
    weight: Array = field(default_factory=lambda: np.zeros(COUNT))
    """Sum of log-likelihoods of each hypothesis, the best at 0."""
    x: Array = field(default_factory=lambda: np.zeros((COUNT, 2, 3)))
    """By hypothesis and axis: constant, fast and slow error, m."""
    P: Array = field(default_factory=lambda: np.zeros((COUNT, 3, 3)))
    """Of either axis, m²."""
    astray_s: float = 0.0
    """For how long none of the likely ones has foretold what was seen."""
    begun: bool = False
    sizes: Sizes = _UNSEEN
    """By what was seen until the last look: they are asked for several times with each fix."""


class SlowFixError:
    """Weighs how large a slow error of the fixes is.

    Parameters
    ----------
    tau_s : float
        Correlation time that the configuration gives.
    """

    def __init__(self, tau_s: float, memory: SlowFixErrorMemory | None = None) -> None:
        self._tau_s = max(tau_s, SAMPLE_S)
        self.memory = SlowFixErrorMemory() if memory is None else memory

    @property
    def slow(self) -> float:
        """Variance of what lasts for minutes, over the stated one."""
        return self.memory.sizes.slow

    @property
    def fast(self) -> float:
        """The same of what lasts for the correlation time."""
        return self.memory.sizes.fast

    def forget(self) -> None:
        """Begin anew with a constant that nothing is known of; weights stay."""
        self.memory.begun = False

    def see(
        self, stamp_ns: int, east_m: float, north_m: float, stated_m: float, way_m2: float
    ) -> bool:
        """Take how far the fixes have drifted against the way; whether that was looked at.

        Parameters
        ----------
        stated_m : float
            Deviation of an axis, as the receiver states it.
        way_m2 : float
            Variance of the way since the last look, an axis.
        """
        memory = self.memory
        dt_s = (stamp_ns - memory.stamp_ns) / S
        if memory.begun and dt_s < SAMPLE_S - 0.01:
            return False
        variance = stated_m * stated_m
        seen = np.array([east_m, north_m])
        memory.stamp_ns = stamp_ns
        if not memory.begun:
            memory.begun, memory.astray_s = True, 0.0
            self._begin(seen, variance)
            return True
        self._go_on(dt_s, variance, way_m2)
        noise = max(WHITE_SHARE * WHITE_SHARE * variance, WHITE_FLOOR_M * WHITE_FLOOR_M)
        astray = self._update(seen, noise, math.exp(-dt_s / FORGET_S))
        memory.astray_s = memory.astray_s + dt_s if astray else 0.0
        if memory.astray_s > LOST_S:
            memory.begun = False
        return True

    def _begin(self, seen: Array, variance: float) -> None:
        """Know nothing of the constant, and of the errors how large they may be."""
        memory = self.memory
        memory.x[:], memory.P[:] = 0.0, 0.0
        memory.x[:, :, 0] = seen
        # Of the constant what the errors leave: the sum of all is what has just been seen.
        fast, slow = variance * _FAST, variance * _SLOW
        memory.P[:, 0, 0], memory.P[:, 1, 1], memory.P[:, 2, 2] = fast + slow, fast, slow
        memory.P[:, 0, 1] = memory.P[:, 1, 0] = -fast
        memory.P[:, 0, 2] = memory.P[:, 2, 0] = -slow

    def _go_on(self, dt_s: float, variance: float, way_m2: float) -> None:
        memory = self.memory
        fast, slow = math.exp(-dt_s / self._tau_s), math.exp(-dt_s / SLOW_TAU_S)
        keep = np.array([1.0, fast, slow])
        memory.x *= keep
        memory.P *= np.outer(keep, keep)
        memory.P[:, 0, 0] += way_m2
        memory.P[:, 1, 1] += variance * _FAST * (1.0 - fast * fast)
        memory.P[:, 2, 2] += variance * _SLOW * (1.0 - slow * slow)

    def _update(self, seen: Array, noise: float, remembered: float) -> bool:
        """Let each hypothesis take what was seen; whether the likeliest does not foretell it."""
        memory = self.memory
        y = seen - memory.x.sum(axis=2)
        gain = memory.P.sum(axis=2)
        variance = gain.sum(axis=1) + noise
        distance = (y * y).sum(axis=1)
        foretold = -0.5 * distance / variance - np.log(variance)
        far = ASTRAY_M * ASTRAY_M
        astray = math.log(ASTRAY_SHARE / far) - 0.5 * distance / far
        fits = foretold > astray
        likeliest = int((memory.weight + _PRIOR).argmax())
        weight = remembered * memory.weight + np.maximum(foretold, astray)
        memory.weight[:] = weight - weight.max()
        memory.sizes = _sizes(memory.weight + _PRIOR)
        K = np.where(fits, 1.0 / variance, 0.0)[:, None] * gain
        memory.x += K[:, None, :] * y[:, :, None]
        memory.P -= K[:, :, None] * gain[:, None, :]
        return not bool(fits[likeliest])
