"""The place on a line, out of no idea where it is: particles that are drawn, moved and told.

It begins with all lines at once and ends with one place; where the lines stop to fit, those that
were on none of them begin anew everywhere, so that a detour, a line that was not looked for, and a
wrong place that had looked right are found out. Chance is drawn from the number of the step: the
same ride gives the same places, bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from tramstream.machine.kernels import bound
from tramstream.memory.annotations import VARYING
from tramstream.processors.segments import particles as kernels
from tramstream.processors.segments.particles import COLUMNS, Pt, Step
from tramstream.processors.segments.possible import Place, place_of
from tramstream.processors.segments.turning_back import beside, other_of
from tramstream.tracks.signature import Signature

Array = NDArray[np.float64]
Rows = Annotated[NDArray[np.float64], VARYING]

STEP_M = 4.0
"""Way between two looks at the heading."""
SPACING_M = 3.0
"""Between particles at the begin, all lines together;"""
MOST, LEAST = 12_000, 1200
"""so many at most, and at least when the place is known."""
PER_CELL = 40
"""Particles for each cell of `CELL_M` in which there are any that count."""
CELL_M = 10.0
NONE_PRIOR = 0.01
"""That the vehicle is on none of the lines, at the begin;"""
LEAVES_PER_M = 1e-5
"""that it leaves them, and"""
JOINS_PER_M = 3e-4
"""that it comes back, anywhere."""
BIRTH_M = 60.0
"""Way after which some that are on none of the lines begin anew."""
BIRTHS = 0.25
"""Share of new particles then, at most."""
AGAINST = 0.1
"""Share at the begin that go against x of the vehicle's first motion."""
WAY_STD_M = 0.03
"""Of a metre of way: creep, slip; it walks."""
ROUGHEN_M, ROUGHEN_SCALE = 0.25, 0.0006
"""What is added to those that are drawn again, so that no two are the same; more, by the root of
how many were one, where few have come through: a thousand heirs of one know its scale no better
than it did."""
ROUGHEN_MOST = 8.0
ROUGHEN_MOST_SCALE = 20.0
STAND_SHARE = 0.6
"""Of stands without doors that are at stops,"""
STAND_DOORS_SHARE = 0.95
"""and of those with doors."""
TOGETHER_M = 30.0
"""Particles that are so near the likeliest place are one place with it."""
ALTERNATIVES = 4
LEAST_PROBABILITY = 0.01


@dataclass
class PlaceMemory:
    """What a `PlaceFinder` remembers."""

    particles: Rows = field(default_factory=lambda: np.zeros((0, COLUMNS)))
    weights: Rows = field(default_factory=lambda: np.zeros(0))
    """Of the particles; they add up to one less `none`."""
    none: float = NONE_PRIOR
    """Probability of being on none of the lines."""
    steps: int = 0
    gone_m: float = 0.0
    born_m: float = 0.0
    """Way at the last births."""
    way_m: float = math.nan
    """Along x and heading at the last step."""
    yaw_rad: float = 0.0
    yaw_variance: float = 0.0
    turned_rad: float = 0.0
    """Within the last step."""
    sure_m: float = -1.0
    """Way at which the likeliest place became sure; negative while it is not."""
    off_m: float = -1.0
    """Way at which no line fitted any more; negative while one does."""
    direction: float = 1.0
    """Of the last step along x."""


class PlaceFinder:
    """Finds the place among lines.

    Parameters
    ----------
    signatures : sequence of Signature
    body : (float, float)
        Pivot behind the vehicle's origin, and distance of its bogies, m.
    scale_std : float
        Of the counted way, before a place has told it.
    noise : float
        Of headings, in times what the signatures state.
    memory : PlaceMemory
    """

    def __init__(
        self,
        signatures: Sequence[Signature],
        body: tuple[float, float],
        scale_std: float,
        noise: float,
        memory: PlaceMemory,
    ) -> None:
        self.signatures = tuple(signatures)
        self.memory = memory
        self._scale_std = scale_std
        rows = [each.seen_by(*body) for each in signatures]
        self._yaw = np.concatenate(rows)
        self._starts = np.cumsum([0, *map(len, rows)]).astype(np.int64)
        self._stops = np.concatenate([each.stops_m for each in signatures])
        counts = [0, *(len(each.stops_m) for each in signatures)]
        self._stop_starts = np.cumsum(counts).astype(np.int64)
        self._lengths = np.array([each.length_m for each in signatures])
        self._stop_std_m = max(each.stop_std_m for each in signatures)
        self._others = [other_of(self.signatures, k) for k in range(len(self.signatures))]
        self._known: list[Place] | None = None
        self._step = np.zeros(kernels.STEP)
        self._step[Step.LINE_STD] = noise * max(each.yaw_std_rad for each in signatures)
        empty = np.zeros((1, COLUMNS))
        self._move = bound(
            kernels.move, empty, np.zeros((1, 2)), self._step, self._yaw, self._starts
        )
        self._near = bound(
            kernels.near_stops, empty, self._stops, self._stop_starts, 6.0, 0.5, 400.0
        )
        origin = np.zeros(1, dtype=np.int64)
        self._resample = bound(kernels.resample, empty, np.zeros(1), 0.5, empty, origin)

    # Ways ----------------------------------------------------------------------------------------
    def go(self, way_m: float, yaw_rad: float, yaw_variance: float, doubt: float) -> bool:
        """Go on to a way along x and a heading; whether that was far enough to be looked at.

        Parameters
        ----------
        doubt : float
            Deviation of the way's scale beside what is the same all the time: none where wheels
            count it, several percent where the speed is integrated.
        """
        memory = self.memory
        if math.isnan(memory.way_m):
            memory.way_m, memory.yaw_rad, memory.yaw_variance = way_m, yaw_rad, yaw_variance
            self._scatter()
        step_m = way_m - memory.way_m
        if abs(step_m) < STEP_M:
            return False
        if memory.steps == 0 and step_m < 0.0:
            memory.particles[:, Pt.WAY] *= -1.0  # the rear cab leads
        elif memory.steps and step_m * memory.direction < 0.0:
            self._turn_back()
        row, count = self._step, len(memory.particles)
        row[Step.WAY_M], row[Step.YAW] = step_m, yaw_rad
        row[Step.TURNED] = yaw_rad - memory.yaw_rad
        row[Step.BEFORE], memory.turned_rad = memory.turned_rad, yaw_rad - memory.yaw_rad
        row[Step.DRIFT_STD] = math.sqrt(max(yaw_variance - memory.yaw_variance, 1e-8))
        row[Step.WAY_STD] = WAY_STD_M * math.sqrt(abs(step_m)) + doubt * abs(step_m)
        row[Step.SCALE_STD] = 0.02 * doubt
        memory.way_m, memory.yaw_rad, memory.yaw_variance = way_m, yaw_rad, yaw_variance
        memory.steps += 1
        memory.gone_m += abs(step_m)
        memory.direction = math.copysign(1.0, step_m)
        rng = self._chance()
        none = self._move(
            memory.particles, rng.standard_normal((count, 2)), row, self._yaw, self._starts
        )
        self._weigh(none)
        self._leave(abs(step_m))
        self._keep(rng)
        return True

    def _chance(self) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=self.memory.steps))

    def _scatter(self) -> None:
        """Begin everywhere."""
        memory = self.memory
        count = min(int(self._lengths.sum() / SPACING_M), MOST)
        memory.particles = self._anywhere(count, self._chance(), 1.0)
        memory.weights = np.full(count, (1.0 - memory.none) / count)

    def _anywhere(self, count: int, rng: np.random.Generator, way: float) -> Array:
        ends = np.cumsum(self._lengths)
        at = (np.arange(count) + rng.random()) / count * ends[-1]
        line = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
        made = np.zeros((count, COLUMNS))
        made[:, Pt.AT_M] = at - (ends - self._lengths)[line]
        made[:, Pt.LINE] = line
        made[:, Pt.SCALE] = self._scale_std * rng.standard_normal(count)
        made[:, Pt.WAY] = way * np.where(rng.random(count) < AGAINST, -1.0, 1.0)
        made[:, Pt.VARIANCE] = -1.0
        return made

    def _turn_back(self) -> None:
        """The other cab leads from here on: back on the same track, or on the other one beside it.

        Half of the particles of each line go over to its other direction, to the nearest point.
        """
        memory = self.memory
        rows, weights = memory.particles, memory.weights
        over, over_weights = [], []
        for k, line in enumerate(self.signatures):
            other = self._others[k]
            of = rows[:, Pt.LINE] == k
            if other < 0 or not of.any():
                continue
            moved = rows[of].copy()
            moved[:, Pt.AT_M] = beside(line, self.signatures[other], moved[:, Pt.AT_M])
            moved[:, Pt.LINE] = other
            moved[:, Pt.WAY] *= -1.0
            moved[:, Pt.VARIANCE] = -1.0
            over.append(moved)
            over_weights.append(weights[of] / 2.0)
            weights[of] /= 2.0
        if over:
            memory.particles = np.concatenate([rows, *over])
            memory.weights = np.concatenate([weights, *over_weights])

    # Weights -------------------------------------------------------------------------------------
    def _weigh(self, none: float) -> None:
        """Take the particles' log-weights into the weights, against that of none of the lines."""
        memory, self._known = self.memory, None
        told = memory.particles[:, Pt.LOG_WEIGHT]
        most = max(float(told.max()), none)
        memory.weights = memory.weights * np.exp(told - most)
        memory.none *= math.exp(none - most)
        told[:] = 0.0
        total = float(memory.weights.sum()) + memory.none
        memory.weights /= total
        memory.none /= total

    def _leave(self, way_m: float) -> None:
        memory = self.memory
        leaving = LEAVES_PER_M * way_m
        memory.none += leaving * (1.0 - memory.none)
        memory.weights *= 1.0 - leaving

    def stand(self, doors: bool) -> None:
        """The vehicle stands as at a stop."""
        memory = self.memory
        if not len(memory.particles):
            return
        share = STAND_DOORS_SHARE if doors else STAND_SHARE
        apart_m = float(self._lengths.sum()) / max(len(self._stops), 1)
        args = (self._stops, self._stop_starts, self._stop_std_m, share, apart_m)
        self._near(memory.particles, *args)
        self._weigh(0.0)
        if memory.steps == 0:
            self._begin_there()

    def _begin_there(self) -> None:
        """Draw as many as before where it may have begun, each with a scale of its own."""
        memory, rng = self.memory, self._chance()
        count, on = len(memory.weights), float(memory.weights.sum())
        out, origin = np.zeros((count, COLUMNS)), np.zeros(count, dtype=np.int64)
        self._resample(memory.particles, memory.weights / on, float(rng.random()), out, origin)
        out[:, Pt.AT_M] += SPACING_M / 2.0 * rng.standard_normal(count)
        out[:, Pt.SCALE] = self._scale_std * rng.standard_normal(count)
        memory.particles, memory.weights = out, np.full(count, on / count)

    def pass_landmark(
        self, lines: Sequence[int], at_m: float, std_m: float, probability: float
    ) -> None:
        """Something has been passed whose place on some lines is known."""
        memory = self.memory
        rows = memory.particles
        if not len(rows):
            return
        of = np.isin(rows[:, Pt.LINE], np.array(lines))
        away = (rows[:, Pt.AT_M] - at_m) / std_m
        near = np.exp(-0.5 * away**2) / (std_m * math.sqrt(math.tau)) * self._lengths.sum()
        fits = 1.0 - probability + probability * np.where(of, near / max(len(lines), 1), 0.0)
        rows[:, Pt.LOG_WEIGHT] = np.log(np.maximum(fits, 1e-12))
        self._weigh(math.log(max(1.0 - probability, 1e-12)))

    # Drawing anew --------------------------------------------------------------------------------
    def _keep(self, rng: np.random.Generator) -> None:
        memory = self.memory
        weights, count = memory.weights, len(memory.weights)
        on = float(weights.sum())
        birth = memory.gone_m - memory.born_m >= BIRTH_M
        effective = on * on / max(float(weights @ weights), 1e-300)
        if not birth and effective > 0.5 * count:
            return
        wanted = min(max(PER_CELL * self._cells(on), LEAST), count if not birth else MOST)
        if not birth and wanted > 0.7 * count and effective > 0.3 * count:
            return
        out = np.zeros((min(wanted, MOST), COLUMNS))
        origin = np.zeros(len(out), dtype=np.int64)
        share = weights / max(on, 1e-300)
        self._resample(memory.particles, share, float(rng.random()), out, origin)
        heirs = np.bincount(origin, minlength=count)[origin]
        more = np.sqrt(heirs)
        away = np.minimum(more, ROUGHEN_MOST) * rng.standard_normal(len(out))
        out[:, Pt.AT_M] += ROUGHEN_M * away
        longer = np.minimum(more, ROUGHEN_MOST_SCALE) * rng.standard_normal(len(out))
        out[:, Pt.SCALE] += ROUGHEN_SCALE * longer
        new = np.full(len(out), on / len(out))
        if birth:
            out, new = self._give_birth(out, new, rng)
        memory.particles, memory.weights = out, new

    def _cells(self, on: float) -> int:
        """How many cells hold what counts."""
        memory = self.memory
        found = memory.weights > 1e-2 * on / len(memory.weights)
        rows = memory.particles[found]
        cell = np.floor(rows[:, Pt.AT_M] / CELL_M) + 1e5 * rows[:, Pt.LINE]
        return len(np.unique(cell))

    def _give_birth(
        self, rows: Array, weights: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        memory = self.memory
        gone_m, memory.born_m = memory.gone_m - memory.born_m, memory.gone_m
        joining = memory.none * min(JOINS_PER_M * gone_m, 0.5)
        if joining < 1e-9:
            return rows, weights
        room = min(int(BIRTHS * MOST), int(self._lengths.sum() / SPACING_M))
        count = max(int(room * min(1.0, 0.02 + memory.none)), 200)
        way = 1.0 if not len(rows) else math.copysign(1.0, float(rows[:, Pt.WAY].sum()) or 1.0)
        born = self._anywhere(count, rng, way)
        memory.none -= joining
        more = np.full(count, joining / count)
        return np.concatenate([rows, born]), np.concatenate([weights, more])

    # Places --------------------------------------------------------------------------------------
    def places(self) -> list[Place]:
        """Places that were possible at the last step, likeliest first."""
        if self._known is None:
            self._known = self._places()
        return self._known

    def forget(self) -> None:
        """Memory was put back: what was derived from it is none any more."""
        self._known = None

    def _places(self) -> list[Place]:
        memory = self.memory
        rows, weights = memory.particles, memory.weights.copy()
        if not len(rows):
            return []
        line = rows[:, Pt.LINE].astype(np.int64)
        cell_m = TOGETHER_M / 2.0
        cells = int(self._lengths.max() / cell_m) + 12
        cell = np.clip((rows[:, Pt.AT_M] / cell_m).astype(np.int64) + 4, 0, cells - 1)
        cell += line * cells
        found: list[Place] = []
        for _ in range(ALTERNATIVES + 1):
            held = np.bincount(cell, weights, minlength=cells * len(self.signatures))
            spread = held.copy()
            spread[1:] += held[:-1]
            spread[:-1] += held[1:]
            best = int(spread.argmax())
            if spread[best] < LEAST_PROBABILITY:
                break
            of, middle = best // cells, (best % cells - 3.5) * cell_m
            near = (line == of) & (np.abs(rows[:, Pt.AT_M] - middle) < TOGETHER_M)
            share = weights[near]
            mean = float(share @ rows[near, Pt.AT_M]) / float(share.sum())
            near = (line == of) & (np.abs(rows[:, Pt.AT_M] - mean) < TOGETHER_M)
            found.append(place_of(of, rows[near], weights[near]))
            weights[near] = 0.0
        return found

    def of_lines(self) -> Array:
        """Probability of each line."""
        memory = self.memory
        line = memory.particles[:, Pt.LINE].astype(np.int64)
        counts = np.bincount(line, memory.weights, minlength=len(self.signatures))
        found: Array = counts.astype(np.float64)
        return found
