"""The map matcher with the whole ride known, and for traces that no filter has seen.

Every hypothesis has a lineage; each change of run leaves an event. At the end the likeliest one is
followed back to its beginning: that is the path with the greatest probability given all that was
seen, as Viterbi's algorithm finds it, among those that were likely enough to be kept on the way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.clock import S
from tramstream.config import Map
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import HEADING_UNKNOWN, TRACKING, Estimate, values_of
from tramstream.geodesy import LocalLevel
from tramstream.processors.matching import hypotheses as kernels
from tramstream.processors.matching.matcher import FORGET_S, Matcher
from tramstream.tracks.map_frame import MapFrame
from tramstream.tracks.network import Network
from tramstream.tracks.rails import beside

TRACE_STEP_S = 0.5
TRACE_STD_M = 5.0
"""Of fixes that do not say how good they are."""
HEADING_M = 8.0
"""The direction of a trace is that of so long a piece of it."""
TRACE_YAW_STD_RAD = 0.25
TURN_M = 3.0
"""Who goes back by less has not turned."""
JUMP_M = 50.0
"""No estimate without a heading moves by more between two; what does is of another ride."""
STANDS_MPS = 0.4
LONGEST_GAP_S = 60.0
"""A trace that is silent for longer is two."""


class Place(NamedTuple):
    """Where the vehicle was at one instant."""

    stamp_ns: int
    run: int
    """-1: off the map."""
    chainage_m: float
    across_m: float
    """How far left of the track the estimate was."""
    probability: float
    """As it was known at that instant, of this run."""


class Leg(NamedTuple):
    """A run of the path."""

    run: int
    """-1: off the map."""
    begin_ns: int
    end_ns: int
    begin_m: float
    end_m: float
    probability: float
    """Least that this run had while the vehicle was on it and its heading known, but for its first
    and last metres."""


class Path(NamedTuple):
    """A whole ride on the network."""

    places: list[Place]
    legs: list[Leg]


class PathFinder:
    """Takes estimates in the order of time; at the end it knows the path.

    Parameters
    ----------
    network : Network
    settings : Map
    forget_s : float
        See `Matcher`.
    """

    def __init__(self, network: Network, settings: Map, forget_s: float = FORGET_S) -> None:
        self._network = network
        self._matcher = Matcher(network, settings, forget_s)
        self._came_from: dict[int, tuple[int, int, int]] = {}  # lineage: parent, run, step
        self._stamps: list[int] = []
        self._plan: list[tuple[float, float]] = []
        self._known: list[dict[int, float]] = []
        self._headed: list[bool] = []
        self._ends: list[tuple[int, int]] = []  # step and lineage where hypotheses ended
        self._on_map = False

    def take(self, estimate: Estimate, frame: MapFrame) -> None:
        """Take the next estimate."""
        matcher, memory = self._matcher, self._matcher.memory
        best = self._best()
        match = matcher.step(estimate, frame)
        if match is None:
            return
        step = len(self._stamps)
        count = int(memory[kernels.EVENTS])
        events = memory[kernels.LOG : kernels.LOG + kernels.EVENT * kernels.EVENT_COUNT]
        if match.run < 0 and best >= 0 and self._on_map:
            self._ends.append((step, best))
        self._on_map = match.run >= 0
        for lineage, parent, run, _ in events.reshape(-1, kernels.EVENT)[:count].tolist():
            begun_anew = parent < 0.0 and best >= 0 and self._on_map
            if begun_anew and (not self._ends or self._ends[-1][0] != step):
                self._ends.append((step, best))
            self._came_from[int(lineage)] = int(parent), int(run), step
        memory[kernels.EVENTS] = 0.0
        self._stamps.append(estimate.stamp_ns)
        self._plan.append((matcher.east, matcher.north))
        known = {each.run >> 1: each.probability for each in match.others}
        if match.run >= 0:
            known[match.run >> 1] = known.get(match.run >> 1, 0.0) + match.probability
        self._known.append(known)
        self._headed.append(match.headed)

    def _best(self) -> int:
        """Lineage of the likeliest hypothesis; -1 without any."""
        memory, best, lineage = self._matcher.memory, -math.inf, -1
        for k in range(int(memory[kernels.COUNT])):
            h = kernels.row(memory, k)
            if h[kernels.WEIGHT] > max(best, memory[kernels.OFF]):
                best, lineage = h[kernels.WEIGHT], int(h[kernels.OWN])
        return lineage

    def path(self) -> Path:
        """Follow the likeliest hypotheses back."""
        runs = np.full(len(self._stamps), -1, dtype=np.int64)
        for end, lineage in [*self._ends, (len(self._stamps), self._best())]:
            while lineage >= 0 and lineage in self._came_from:
                parent, run, begin = self._came_from[lineage]
                runs[begin:end] = run
                end = min(end, begin)
                lineage = parent
        self._before_heading(runs)
        places = list(self._places(runs))
        return Path(places, _legs(places, self._headed))

    def _before_heading(self, runs: NDArray[np.int64]) -> None:
        """Where the heading was not known yet, the vehicle was where it set off from."""
        for k in range(len(runs) - 2, -1, -1):
            step = np.subtract(self._plan[k + 1], self._plan[k])
            if not self._headed[k] and runs[k + 1] >= 0 and math.hypot(*step) < JUMP_M:
                runs[k] = runs[k + 1]

    def _places(self, runs: NDArray[np.int64]) -> Iterator[Place]:
        rails, last, s = self._matcher.rails, -1, 0.0
        forwards = _directions(runs, np.array(self._plan), self._headed, self._network)
        for stamp_ns, run, (east, north), known, onwards in zip(
            self._stamps, runs.tolist(), self._plan, self._known, forwards, strict=True
        ):
            if run < 0:
                last = -1
                yield Place(stamp_ns, -1, 0.0, 0.0, 0.0)
                continue
            length = float(rails.length_m[run >> 1])
            if run != last:
                s = self._nearest(run, east, north)
            s, across, _, _ = beside(rails, run, s, east, north)
            last, s = run, min(max(s, 0.0), length)
            probability = known.get(run >> 1, 0.0)
            if onwards:
                yield Place(stamp_ns, run, s, across, probability)
            else:
                yield Place(stamp_ns, run ^ 1, length - s, -across, probability)

    def _nearest(self, run: int, east: float, north: float) -> float:
        """Chainage of the sample of a run that is nearest to a place."""
        part, track = self._network.samples_of(run >> 1), run >> 1
        away = np.hypot(self._network.east[part] - east, self._network.north[part] - north)
        s = float(np.argmin(away)) * float(self._network.spacing_m[track])
        return s if run % 2 == 0 else float(self._network.length_m[track]) - s


def _directions(
    runs: NDArray[np.int64], plan: Array, headed: list[bool], network: Network
) -> list[bool]:
    """Whether the vehicle moves along its x axis, point by point: by the run's rules and its way.

    It turned back where it was farthest, once it has gone `TURN_M` the other way: the errors of a
    vehicle that stands are no motion.
    """
    onwards = np.ones(len(runs), dtype=bool)
    gone, farthest, far, sign = 0.0, 0.0, 0, 0
    for k in range(1, len(runs)):
        # Without a heading estimates are as restless as fixes.
        if runs[k] < 0 or not (headed[k - 1] and headed[k]):
            continue
        step, part = plan[k] - plan[k - 1], network.samples_of(int(runs[k]) >> 1)
        near = np.hypot(network.east[part] - plan[k, 0], network.north[part] - plan[k, 1])
        yaw = float(network.yaw_rad[part][int(np.argmin(near))])
        along = step[0] * math.cos(yaw) + step[1] * math.sin(yaw)
        gone += along if runs[k] % 2 == 0 else -along
        ahead = gone - farthest
        if abs(ahead) > TURN_M and ahead * sign <= 0.0:
            sign = 1 if ahead > 0.0 else -1
            onwards[far:] = sign > 0
        if ahead * sign > 0.0:
            farthest, far = gone, k
    return [bool(each) for each in onwards]


def _legs(places: list[Place], headed: list[bool]) -> list[Leg]:
    legs: list[Leg] = []
    begin = 0
    for k in range(1, len(places) + 1):
        if k < len(places) and places[k].run == places[begin].run:
            continue
        part = places[begin:k]
        sure = [each for each, known in zip(part, headed[begin:k], strict=True) if known] or part
        inner = [
            each.probability
            for each in sure
            if abs(each.chainage_m - part[0].chainage_m) > HEADING_M
            and abs(each.chainage_m - part[-1].chainage_m) > HEADING_M
        ]
        whole = inner or [each.probability for each in sure]
        first, last = part[0], part[-1]
        legs.append(
            Leg(
                first.run,
                first.stamp_ns,
                last.stamp_ns,
                first.chainage_m,
                last.chainage_m,
                min(whole),
            )
        )
        begin = k
    return legs


def find_path(
    network: Network,
    settings: Map,
    estimates: Iterable[tuple[Estimate, LocalLevel]],
    forget_s: float = FORGET_S,
) -> Path:
    """Match a whole ride.

    Parameters
    ----------
    estimates : iterable of (Estimate, LocalLevel)
        In the order of time, each with the frame of its position.
    """
    finder = PathFinder(network, settings, forget_s)
    frame: MapFrame | None = None
    for estimate, level in estimates:
        if frame is None or frame.level is not level:
            frame = MapFrame(network, level)
        finder.take(estimate, frame)
    return finder.path()


def trace_estimates(
    stamp_ns: NDArray[np.int64], geodetic: Array, std_m: Array
) -> Iterator[tuple[Estimate, LocalLevel]]:
    """Make estimates of a trace that has fixes only: speed and heading are those of its way.

    Parameters
    ----------
    stamp_ns : ndarray, shape (n,)
        Ascending.
    geodetic : ndarray, shape (n, 2)
        Latitude, longitude, rad.
    std_m : ndarray, shape (n,)
        Deviation per axis; NaN where the trace does not say.
    """
    level = LocalLevel(float(geodetic[0, 0]), float(geodetic[0, 1]), 0.0)
    rows = np.column_stack([geodetic[:, :2], np.zeros(len(geodetic))])
    p_l = level.from_geodetic(rows)[:, :2]
    time_s = (stamp_ns - stamp_ns[0]) / S
    std = np.where(np.isfinite(std_m), std_m, TRACE_STD_M)
    count = math.ceil(time_s[-1] / TRACE_STEP_S)
    at = np.linspace(0.0, time_s[-1], count + 1)
    after = np.minimum(np.searchsorted(time_s, at), len(time_s) - 1)
    gap = np.append(0.0, np.diff(time_s))[after]
    p = np.stack([np.interp(at, time_s, p_l[:, axis]) for axis in (0, 1)], axis=1)
    deviation = np.interp(at, time_s, std)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p, axis=0).T))])
    speed = np.gradient(way, at) if len(at) > 1 else np.zeros(len(at))
    yaw: float | None = None
    for k, t in enumerate(at.tolist()):
        if gap[k] > LONGEST_GAP_S:
            continue
        behind = p[k] - p[np.searchsorted(way, way[k] - HEADING_M)]
        if math.hypot(*behind) > HEADING_M / 2:
            yaw = math.atan2(behind[1], behind[0])
        standing = bool(speed[k] < STANDS_MPS)
        covariance = np.zeros((7, 7))
        covariance[0, 0] = covariance[1, 1] = deviation[k] ** 2
        covariance[6, 6] = TRACE_YAW_STD_RAD**2
        motion = (*p[k], 0.0, 0.0 if standing else speed[k], 0.0, 0.0, yaw or 0.0)
        yield (
            Estimate(
                int(stamp_ns[0]) + round(t * S),
                HEADING_UNKNOWN if yaw is None else TRACKING,
                values_of(motion, covariance, 0.0, 0.0),
                standing,
            ),
            level,
        )
