"""The map matcher: which run of a network the vehicle is on, and where, with what probability.

It takes what a localisation filter says, step by step and causally, and keeps hypotheses over the
runs (`matching_kernels`). Where the heading is not known yet, it says on which tracks the vehicle
may stand, anew every second; with the heading, hypotheses begin on every track near by, in both
directions. A vehicle that leaves the map is said to be off it, and looked for again as it goes on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tramstream.clock import S
from tramstream.config import Map
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import HEADING_UNKNOWN, STARTING, Estimate
from tramstream.machine.kernels import bound
from tramstream.processors.matching import hypotheses as kernels
from tramstream.processors.matching import step as steps
from tramstream.processors.matching.parting import beyond_switch_m, surest
from tramstream.tracks.map_frame import MapFrame
from tramstream.tracks.network import Network
from tramstream.tracks.rails import Rails, Search, nearest_sample, rails_of, views_of

SEARCH_STDS = 3.5
SEARCH_MORE_M, SEARCH_MOST_M = 10.0, 150.0
"""Tracks are looked for within so many deviations of the estimate, and a bit."""
WRONG_WAY = 1e-4
"""Share of vehicles that are met where trams are not meant to go."""
HEADS_RAD = math.radians(60.0)
"""No vehicle heads so far off its track, whatever its filter believes at first."""
GAP_S = 1.0
"""After a longer silence of a filter tracks are looked for anew: who knows which way was gone."""
AGAIN_S = 1.0
AGAIN_M = 10.0
"""Tracks are looked for again after so long without a heading, after so long a way off the map."""
LOST = 0.5
"""Off the map, if that is likelier than this."""
SUREST_OFF = math.log1p(-1e-9)
UNSURE = math.log(0.005)
"""Tracks are looked for again while a track that the map lacks is likelier than this."""
FORGET_S = 300.0
"""Time in which errors of a filter with inertial sensors forget themselves: it averages its fixes
over minutes."""
TRACE_FORGET_S = 15.0
"""The same of fixes alone, and of a filter that has nothing but them: it follows them."""
MOVES_MPS = 0.3
"""From here on the sign of the speed tells the direction of travel."""


class Candidate(NamedTuple):
    """A run that the vehicle may be on."""

    run: int
    chainage_m: float
    probability: float


class Circle(NamedTuple):
    """The track near the vehicle, in the plan; see the message `TrackGeometry`."""

    run: int
    """In the direction of the vehicle's x axis."""
    chainage_m: float
    probability: float
    east: float
    north: float
    yaw_rad: float
    curvature_per_m: float
    across_variance: float
    yaw_variance: float
    curvature_variance: float
    grade_rad: float
    """NaN where the map does not know."""
    grade_variance: float
    ahead_m: float
    behind_m: float


class Match(NamedTuple):
    """What the matcher says at one instant."""

    run: int
    """In the direction of motion; -1 off the map."""
    chainage_m: float
    chainage_std_m: float
    probability: float
    off_probability: float
    east: float
    north: float
    """Of the place on the track, in the plan, m."""
    others: tuple[Candidate, ...]
    circle: Circle | None
    """Once a metre, while the vehicle moves and its heading is known."""
    headed: bool
    """Whether the vehicle's heading is known: before, the direction of a run is a guess."""


def _no_hypotheses() -> Array:
    numbers = np.zeros(kernels.MEMORY)
    numbers[kernels.SYNCED], numbers[kernels.DIRECTION] = kernels.NONE, 1.0
    numbers[kernels.FLOOR] = kernels.OFF_FLOOR
    return numbers


@dataclass
class HypothesesMemory:
    """What a `Matcher` remembers."""

    numbers: Array = field(default_factory=_no_hypotheses)
    """See `hypotheses`."""
    stamp_ns: int = 0
    looked_ns: int = 0
    way_m: float = 0.0
    """Since tracks were looked for."""
    headed: bool = False
    left: bool = False
    """Whether the vehicle has left the map and was not found on it again."""
    guessed: bool = False
    """The direction of travel."""


class Matcher:
    """Keeps hypotheses over the runs of a network.

    Parameters
    ----------
    network : Network
    settings : Map
    forget_s : float
        Time in which errors of the estimates forget themselves.
    pivot_m : float
        The vehicle's origin before the point that follows the rails.
    lever_m : float
        How far the antenna is from the vehicle's origin, in plan.
    gap_s : float
        After a longer silence tracks are looked for anew.
    """

    def __init__(
        self,
        network: Network,
        settings: Map,
        forget_s: float = FORGET_S,
        pivot_m: float = 0.0,
        lever_m: float = 0.0,
        gap_s: float = GAP_S,
    ) -> None:
        self.network = network
        self._rails = rails_of(network)
        self._views = views_of(self._rails)
        self._names: dict[int, str] = {}
        self._search = Search(network)
        self._beyond_m = beyond_switch_m(network)
        self._gap_s = gap_s
        self.remembered = HypothesesMemory()
        self.memory = self.remembered.numbers
        self._forget_s = forget_s
        self._constants = np.array(
            [forget_s, settings.std_m, settings.correlation_m, pivot_m, lever_m]
        )
        self._motion = np.zeros(kernels.MOTION)
        self._out = np.zeros(steps.OUT)
        values = frame = np.zeros(0)
        known = self.memory, self._rails, values, frame, self._constants, self._motion, self._out
        self._advance = bound(steps.advance, *known)

    @property
    def rails(self) -> Rails:
        """The network as kernels read it."""
        return self._rails

    def sample_at(self, run: int, chainage_m: float) -> int:
        """Give the sample of the network nearest to a place on a run."""
        return nearest_sample(self._views, run, chainage_m)

    def name_of(self, run: int) -> str:
        """Name of a run; kept, for it is asked a hundred times a second."""
        name = self._names.get(run)
        if name is None:
            name = self._names[run] = self.network.name_of(run)
        return name

    @property
    def east(self) -> float:
        """Of the last estimate in the plan, m."""
        return float(self._motion[kernels.EAST])

    @property
    def north(self) -> float:
        """See `east`."""
        return float(self._motion[kernels.NORTH])

    @property
    def yaw_rad(self) -> float:
        """See `east`."""
        return float(self._motion[kernels.YAW])

    def away_m(self) -> float:
        """How far the last estimate is from the nearest track."""
        return self._search.away_m(self.east, self.north)

    @property
    def hypotheses(self) -> int:
        """How many there are."""
        return int(self.memory[kernels.COUNT])

    def step(
        self, estimate: Estimate, frame: MapFrame, held: bool = False, alone: bool = False
    ) -> Match | None:
        """Take an estimate; None while nothing is known.

        Parameters
        ----------
        frame : MapFrame
            Between the estimate's frame `l` and the network's plan; moved along.
        held : bool
            Whether the filter that the estimate is of is held to `Match.circle`: then it knows by
            itself what the map tells.
        alone : bool
            Whether the estimate is of fixes alone, and forgets its errors as soon as they do.
        """
        if estimate.mode == STARTING:
            return None
        frame.follow(*estimate.p_l)
        self._constants[kernels.FORGET_S] = TRACE_FORGET_S if alone else self._forget_s
        z = self._motion
        dt = (estimate.stamp_ns - self.remembered.stamp_ns) / S if self.remembered.stamp_ns else 0.0
        headed = estimate.mode != HEADING_UNKNOWN
        gap = dt > self._gap_s
        z[kernels.STEP] = min(max(dt, 0.0), self._gap_s)
        z[kernels.STANDING], z[kernels.HEADED] = estimate.standing, headed
        self.remembered.stamp_ns = estimate.stamp_ns
        self._advance(
            self.memory,
            self._rails,
            estimate.values,
            frame.numbers,
            self._constants,
            z,
            self._out,
        )
        if self._due(estimate, headed) or gap:
            self._look(headed)
            steps.summary(self.memory, self._rails, z, self._constants, False, self._out)
        if not held:
            self.memory[kernels.SYNCED] = kernels.NONE
        return self._match(headed)

    # Where hypotheses come from ------------------------------------------------------------------
    def _due(self, estimate: Estimate, headed: bool) -> bool:
        """Whether tracks are to be looked for."""
        z = self._motion
        if headed != self.remembered.headed:
            self.remembered.headed = headed
            return True
        if not headed:
            return estimate.stamp_ns - self.remembered.looked_ns >= AGAIN_S * S
        if self.remembered.guessed and abs(z[kernels.SPEED]) > MOVES_MPS:
            self.remembered.guessed = False
            return bool(z[kernels.SPEED] * self.memory[kernels.DIRECTION] < 0.0)
        doubted = self.memory[kernels.FLOOR] > UNSURE
        if math.exp(self.memory[kernels.OFF]) < LOST and self.hypotheses and not doubted:
            return False
        self.remembered.way_m += abs(z[kernels.SPEED]) * z[kernels.STEP]
        return self.remembered.way_m >= AGAIN_M

    def _look(self, headed: bool) -> None:
        """Begin anew with all tracks near the estimate."""
        z, memory = self._motion, self.memory
        off = headed and self.remembered.looked_ns > 0 and math.exp(memory[kernels.OFF]) >= LOST
        left = self.remembered.left or off
        self.remembered.looked_ns, self.remembered.way_m = self.remembered.stamp_ns, 0.0
        memory[kernels.COUNT] = memory[kernels.WAY] = 0.0
        memory[kernels.SYNCED] = kernels.NONE
        speed = z[kernels.SPEED]
        self.remembered.guessed = abs(speed) <= MOVES_MPS
        if not self.remembered.guessed:
            memory[kernels.DIRECTION] = math.copysign(1.0, speed)
        std = math.sqrt(max(z[kernels.P_EE], z[kernels.P_NN], 0.0))
        radius = min(SEARCH_STDS * std + SEARCH_MORE_M, SEARCH_MOST_M)
        place = float(z[kernels.EAST]), float(z[kernels.NORTH])
        found = self._search.near(*place, radius)
        limit = HEADS_RAD + 2.0 * math.sqrt(z[kernels.P_YAW])
        direction = float(memory[kernels.DIRECTION])
        begun = []
        for near in found:
            for back in (0, 1):
                run = 2 * near.track + back
                yaw = near.yaw_rad + math.pi * back
                if headed and abs(math.remainder(yaw - z[kernels.YAW], math.tau)) > limit:
                    continue
                length = float(self._rails.length_m[near.track])
                s = length - near.chainage_m if back else near.chainage_m
                legal = steps.allowed(self._rails, run, direction)
                begun.append((run, s, 1.0 if legal else WRONG_WAY))
        memory[kernels.OFF] = math.log(kernels.OFF_PRIOR / (2.0 * kernels.OFF_RADIUS_M))
        if headed:
            memory[kernels.OFF] -= math.log(math.tau)
        for run, s, prior in begun[: kernels.MOST]:
            kernels.seed(memory, self._rails, z, self._constants, run, s, prior / len(begun))
        memory[kernels.FLOOR] = floor = self._beside_all(left)
        self.remembered.left = left and floor > UNSURE
        kernels.tidy(memory)

    def _beside_all(self, left: bool) -> float:
        """How likely the vehicle is on a track that the map lacks, beside those just found."""
        memory = self.memory
        share = kernels.UNMAPPED_LEFT if left else kernels.UNMAPPED
        unmapped = float(memory[kernels.OFF]) + math.log(share / kernels.OFF_PRIOR)
        weights = [kernels.row(memory, k)[kernels.WEIGHT] for k in range(self.hypotheses)]
        others = sum(math.exp(float(weight) - unmapped) for weight in weights)
        return min(max(-math.log1p(others), kernels.OFF_FLOOR), SUREST_OFF)

    # What comes out ------------------------------------------------------------------------------
    def _match(self, headed: bool) -> Match:
        out: list[float] = self._out.tolist()
        best, off = out[steps.BEST], out[steps.OFF_PROBABILITY]
        others = tuple(self._other(out, k) for k in range(int(out[steps.OTHERS])))
        if best < 0.0 or off > LOST:
            return Match(-1, 0.0, 0.0, 0.0, off, 0.0, 0.0, others, None, headed)
        circle = None
        if out[steps.TOLD]:
            told = out[steps.TOLD + 1 : steps.OUT]
            circle = Circle(int(told[0]), *told[1:])
        return Match(
            int(out[steps.EDGE]),
            out[steps.EDGE_CHAINAGE],
            out[steps.ALONG_STD],
            out[steps.PROBABILITY],
            off,
            out[steps.MATCHED_EAST],
            out[steps.MATCHED_NORTH],
            others,
            circle,
            headed,
        )

    def said(self, match: Match) -> Match:
        """Give what may be said of a match: no surer than maps of switches are (`parting`)."""
        if match.run < 0:
            return match
        most = surest(float(self._beyond_m[match.run]) + match.chainage_m)
        if match.probability <= most:
            return match
        rest = sum(each.probability for each in match.others)
        more = 1.0 + (match.probability - most) / rest if rest > 0.0 else 1.0
        others = tuple(each._replace(probability=more * each.probability) for each in match.others)
        return match._replace(probability=most, others=others)

    def _other(self, out: list[float], k: int) -> Candidate:
        """Another run, in the direction of motion."""
        run, s, probability = out[steps.OTHER + 3 * k : steps.OTHER + 3 * k + 3]
        length = float(self._rails.length_m[int(run) >> 1])
        s = min(max(s, 0.0), length)
        if self.memory[kernels.DIRECTION] > 0.0:
            return Candidate(int(run), s, probability)
        return Candidate(int(run) ^ 1, length - s, probability)
