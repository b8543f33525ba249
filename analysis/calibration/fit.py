"""N, B, T_b and K of an axis by maximum likelihood, all together; what is not seen gets a limit.

A coefficient is seen where the likelihood falls by `WALK_SEEN` or `INSTABILITY_SEEN` without it.
What is seen has a deviation from the curvature of the likelihood's logarithm, and an interval that
is symmetric on a logarithmic scale; what is not has the largest value that the record allows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from tramstream.analysis.calibration.blocks import Blocks
from tramstream.analysis.calibration.likelihood import Found, likelihood
from tramstream.analysis.calibration.noise import Noise

Array = NDArray[np.float64]

NONE = Noise(math.nan)
WALK_SEEN = 6.63
"""Twice the logarithm of the likelihood's ratio without K: by chance in 0.5 % of all records."""
WALK_KEPT = 0.5
"""Beside an instability a walk that is not seen stays in the model from here on: left out, it would
be taken for a part of B and T_b."""
INSTABILITY_SEEN = 12.0
"""Likewise for B with its T_b, which can be put anywhere: about one record in a thousand."""
LIMIT = 2.71
"""Where the likelihood has fallen so much, a larger value is excluded in 95 % of all records."""
TEMPERATURE_SEEN_DEGC = 0.5
"""Range of temperature below which nothing is said of its effect."""
_NOT_WHITE = 4.0
"""Deviations by which an octave within blocks differs from white noise that is none."""
_FEWEST_TIMES = 4.0
"""The slowest bias instability that is told from a walk: so many T_b in a record."""
_LIMIT_TIMES = 20.0
"""The same for a limit on B."""
_STARTS = 4
_ROUGH = {"xatol": 0.1, "maxiter": 9}
"""Of the best K at the limit of B, which itself is good to a tenth."""


@dataclass(frozen=True)
class Fit:
    """What a record tells of an axis; counts, or SI after `scaled`."""

    noise: Noise
    """Most likely values of what is in the model; zero for what is not."""
    std: dict[str, float] = field(default_factory=dict)
    """Of the logarithm of each coefficient that is seen, by its name: the relative deviation."""
    limit: dict[str, float] = field(default_factory=dict)
    """Of those that are not seen: at most so much, 95 %."""
    limit_time_s: float = math.nan
    """T_b at which the limit of B holds; for others it is smaller."""
    full: Noise = NONE
    """Most likely values with all four, seen or not."""
    white_from_s: float = 0.0
    """The shortest time at which the noise is white; what is faster is left out."""
    per_degc: float = math.nan
    """What the bias gains with a degree; NaN where the temperature did not change."""
    per_degc_std: float = math.nan

    @property
    def temperature_matters(self) -> bool:
        """Whether the temperature's effect is told from chance."""
        return abs(self.per_degc) > 4 * self.per_degc_std

    def interval(self, name: str) -> tuple[float, float]:
        """Where a coefficient that is seen lies, 95 %."""
        value = value_of(self.noise, name)
        factor = math.exp(min(1.96 * self.std[name], 50.0))
        return value / factor, value * factor

    def scaled(self, unit: float) -> Fit:
        """The same in SI, `unit` being one count."""
        return Fit(
            noise=_times(self.noise, unit),
            std=self.std,
            limit={name: value * unit for name, value in self.limit.items()},
            limit_time_s=self.limit_time_s,
            full=_times(self.full, unit),
            white_from_s=self.white_from_s,
            per_degc=self.per_degc * unit,
            per_degc_std=self.per_degc_std * unit,
        )


def value_of(noise: Noise, name: str) -> float:
    """A coefficient by the name that people have for it."""
    return {"N": noise.white, "B": noise.instability, "T_b": noise.time_s, "K": noise.walk}[name]


def _times(noise: Noise, unit: float) -> Noise:
    return Noise(noise.white * unit, noise.instability * unit, noise.time_s, noise.walk * unit)


def fit(blocks: Blocks) -> Fit:
    """Estimate the noise of an axis."""
    spread_degc = np.ptp(blocks.temperature) if len(blocks.temperature) else math.nan
    search = _Search(blocks, temperature=bool(spread_degc >= TEMPERATURE_SEEN_DEGC))
    return search.result()


class _Search:
    """All likelihoods of one axis; parameters are ln B/N, ln T_b, ln K/N."""

    def __init__(self, blocks: Blocks, temperature: bool) -> None:
        self._blocks = blocks
        self._temperature = temperature
        self._octaves = 0
        self._duration_s = len(blocks.mean) * blocks.block_s
        shortest, longest = 2 * blocks.block_s, self._duration_s / _FEWEST_TIMES
        self._times_s = (shortest, max(longest, 2 * shortest))
        self._walks = (
            math.log(1e-3 / self._duration_s),
            math.log(20.0 / blocks.block_s),
        )
        self._white_from_s = blocks.block_s

    def _found(self, noise: Noise) -> Found:
        return likelihood(self._blocks, noise, self._octaves, self._temperature)

    def _of(self, names: str, x: Array) -> Noise:
        """The model that parameters mean; `names` has B (with T_b) and K in it, or not."""
        values = iter(np.clip(x, -60.0, 60.0).tolist())
        instability, time_s, walk = 0.0, 1.0, 0.0
        if "B" in names:
            instability = math.exp(next(values))
            time_s = min(max(math.exp(next(values)), self._times_s[0]), self._times_s[1])
        if "K" in names:
            walk = math.exp(next(values))
        return Noise(1.0, instability, time_s, walk)

    def _deviance(self, names: str) -> Callable[[Array], float]:
        return lambda x: self._found(self._of(names, x)).deviance

    # Searching ------------------------------------------------------------------------------------
    def _walk_alone(self) -> tuple[float, Array]:
        """The best K without B."""
        deviance = self._deviance("K")
        grid = np.linspace(*self._walks, 16)
        heights = [deviance(np.array([each])) for each in grid]
        best = int(np.argmin(heights))
        around = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        found = optimize.minimize_scalar(
            lambda each: deviance(np.array([each])), bounds=around, method="bounded"
        )
        return float(found.fun), np.array([found.x])

    def _polished(self, names: str, start: Array, calls: int = 500) -> tuple[float, Array]:
        count = len(start)
        simplex = np.vstack([start, start + 0.4 * np.eye(count)])
        found: Any = optimize.minimize(
            self._deviance(names),
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 2e-3, "fatol": 2e-3, "maxfev": calls},
        )
        return float(found.fun), np.asarray(found.x, dtype=float)

    def _with_instability(self, walk: float) -> Array:
        """All three, roughly, begun at several T_b."""
        times_s = np.geomspace(*self._times_s, _STARTS + 2)[1:-1]
        starts = []
        for time_s in times_s:
            for size, less in itertools.product((0.3, 3.0), (0.0, -1.5)):
                # z_b as large as white noise, or ten times as large, in the mean of T_b
                instability = math.log(size / math.sqrt(time_s))
                starts.append(np.array([instability, math.log(time_s), walk + less]))
        deviance = self._deviance("BK")
        starts.sort(key=deviance)
        others = [each for each in starts if each[1] != starts[0][1]]
        best = (self._polished("BK", each, 60) for each in (starts[0], others[0]))
        return min(best, key=lambda found: found[0])[1]

    def _choose_octaves(self, x: Array) -> None:
        """Use octaves within blocks, from the longest, as long as they are white noise."""
        blocks, noise = self._blocks, self._of("BK", x)
        for number in range(1, len(blocks.half_s) + 1):
            which = len(blocks.half_s) - number
            count, half_s = int(blocks.details[which]), float(blocks.half_s[which])
            known = self._found(noise)
            expected = 2 * known.white**2 * float(noise.allan_variance(half_s))
            ratio = float(blocks.squares[which]) / max(count, 1) / expected
            # Beside a strong walk means of blocks know N less well than their number says.
            std = self._std("BK", "BK", x, known)["N"]
            spread = math.sqrt(2 / max(count, 1) + 4 * std**2)
            if not ratio > 0 or abs(math.log(ratio)) > _NOT_WHITE * spread:
                return
            self._octaves = number
            self._white_from_s = half_s

    # What comes of it -----------------------------------------------------------------------------
    def result(self) -> Fit:
        """Search, decide what is seen, and reckon how well."""
        _, walk = self._walk_alone()
        x = self._with_instability(float(walk[0]))
        self._choose_octaves(x)
        alone, walk = self._walk_alone()
        whole, x = self._polished("BK", x)
        without_walk, unstable = self._polished("B", x[:2])
        white = self._deviance("")(np.zeros(0))
        whole = min(whole, without_walk, alone)
        unstable_seen = alone - whole > INSTABILITY_SEEN
        if unstable_seen:
            gain = without_walk - whole
            names, best = ("BK", x) if gain > WALK_KEPT else ("B", unstable)
        else:
            gain = white - alone
            names, best = ("K", walk) if gain > WALK_SEEN else ("", np.zeros(0))
        seen = names if gain > WALK_SEEN else names.replace("K", "")
        limits, limit_time_s = self._limits(names, seen, best)
        noise = self._of(names, best)
        found = self._found(noise)
        full = self._of("BK", x)
        return Fit(
            noise=_times(noise, found.white),
            std=self._std(names, seen, best, found),
            limit={name: value * found.white for name, value in limits.items()},
            limit_time_s=limit_time_s,
            full=_times(full, self._found(full).white),
            white_from_s=self._white_from_s,
            per_degc=found.per_degc if self._temperature else math.nan,
            per_degc_std=found.per_degc_std if self._temperature else math.nan,
        )

    def _std(self, names: str, seen: str, best: Array, found: Found) -> dict[str, float]:
        """Relative deviations from the curvature; that of N with what the others cost it."""
        count, step = len(best), 0.05
        deviance = self._deviance(names)
        size = 1 / (2 * max(found.numbers, 1))
        if not count:
            return {"N": math.sqrt(size)}
        shifts = step * np.eye(count)
        hessian = np.empty((count, count))
        gradient = np.empty(count)
        for i, j in itertools.combinations_with_replacement(range(count), 2):
            pairs = [
                a * b * deviance(best + a * shifts[i] + b * shifts[j])
                for a, b in itertools.product((1, -1), repeat=2)
            ]
            hessian[i, j] = hessian[j, i] = sum(pairs) / (4 * step**2)
        for i in range(count):
            up, down = (self._found(self._of(names, best + a * shifts[i])).white for a in (1, -1))
            gradient[i] = (math.log(up) - math.log(down)) / (2 * step)
        values, vectors = np.linalg.eigh(hessian / 2)
        covariance = vectors / np.maximum(values, 1e-6) @ vectors.T
        of_white = size + float(gradient @ covariance @ gradient)
        with_white = covariance @ gradient
        std = {"N": math.sqrt(of_white)}
        order = [*(("B", "T_b") if "B" in names else ()), *(("K",) if "K" in names else ())]
        for i, name in enumerate(order):
            own = float(covariance[i, i])
            if name != "T_b":  # B and K were sought over N
                own += of_white + 2 * float(with_white[i])
            std[name] = math.sqrt(max(own, 0.0))
        return {name: value for name, value in std.items() if name != "K" or "K" in seen}

    def _limits(self, names: str, seen: str, best: Array) -> tuple[dict[str, float], float]:
        """Largest values of what is not seen, over N, and the T_b of that of B."""
        limits: dict[str, float] = {}
        time_s = math.nan
        lowest = self._deviance(names)(best)
        if "K" not in seen:
            start = float(best[-1]) if "K" in names else self._walks[0]
            limits["K"] = self._limit(lambda walk: self._at_walk(walk, names, best), lowest, start)
        if "B" not in names:
            shortest = self._times_s[0] * 2
            longest = max(self._duration_s / _LIMIT_TIMES, 2 * shortest)
            model, found = self._of(names, best), []
            for each in np.geomspace(shortest, longest, 4).tolist():
                # A flat part half as high as what is there is a guess that is never far off.
                start = math.log(math.sqrt(float(model.allan_variance(1.89 * each))) / 1.3)
                deviance = self._at_instability(each, names, best)
                found.append((self._limit(deviance, lowest, start), each))
            limits["B"], time_s = max(found)
        return limits, time_s

    def _limit(self, deviance: Callable[[float], float], lowest: float, start: float) -> float:
        """The value at which a deviance, of its logarithm, has risen by `LIMIT` for good."""
        low = high = start
        while deviance(low) - lowest > LIMIT:
            high, low = low, low - 1.0
            if low < -60.0:
                return 0.0
        while high == low or deviance(high) - lowest < LIMIT:
            low, high = high, high + 1.0
            if high > 20.0:
                return math.inf
        while high - low > 0.1:
            middle = (low + high) / 2
            low, high = (middle, high) if deviance(middle) - lowest < LIMIT else (low, middle)
        return math.exp(high)

    def _at_walk(self, walk: float, names: str, best: Array) -> float:
        """The deviance at a given K, B and T_b the best for it."""
        if "B" not in names:
            return self._deviance("K")(np.array([walk]))
        deviance = self._deviance("BK")
        found: Any = optimize.minimize(
            lambda x: deviance(np.append(x, walk)),
            best[:2],
            method="Nelder-Mead",
            options={"xatol": 0.02, "fatol": 0.02, "maxfev": 60},
        )
        return float(found.fun)

    def _at_instability(self, time_s: float, names: str, best: Array) -> Callable[[float], float]:
        """The deviance over ln B at a given T_b, K the best for it."""

        def deviance(size: float) -> float:
            noise = Noise(1.0, math.exp(size), time_s)

            def over(walk: float) -> float:
                return self._found(noise._replace(walk=math.exp(walk))).deviance

            if "K" not in names:
                return over(self._walks[0])
            walk = float(best[-1])
            found = optimize.minimize_scalar(
                over, bounds=(walk - 4.0, walk + 0.5), method="bounded", options=_ROUGH
            )
            return min(float(found.fun), over(self._walks[0]))

        return deviance
