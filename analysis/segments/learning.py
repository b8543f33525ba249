"""A line's signature learned from rides that went along all of it, without any map.

Each ride gives its headings metre by metre and its stands (`trace_of`). The others are laid onto
the first: way on way by the curves, which says how much longer each ride's wheels count (`laid`).
What the rides agree on is the line, how far they differ its spread.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.config import Vehicle
from tramstream.errors import TramstreamError
from tramstream.processor import Sample
from tramstream.processors.segments.kernels import Ix
from tramstream.processors.segments.ledger import Ledger, LedgerMemory
from tramstream.processors.segments.motion import Motion, MotionMemory
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.proto.estimate_pb2 import SegmentEvent
from tramstream.tracks.signature import STEP_M, Signature

Array = NDArray[np.float64]

SHORTEST_M = 300.0
"""A ride that is shorter shows no line."""
LAID_M = 4.0
"""Way between two looks at how rides lie on each other."""
APART_M = 60.0
"""So far, beside one factor, rides may be off each other on the way."""
SHIFT_M = 0.5
HEADING_STD_RAD = 0.02
SHIFT_COST = 2.0
"""Of a change by `SHIFT_M` within `LAID_M`: an eighth of the way is rare."""
BEGIN_STD_M = 3.0
"""Rides begin at the same stop."""
STOP_NEAR_M = 25.0
"""Stands of several rides that are so near each other are at one stop."""
STOP_SHARE = 0.5
"""Of the rides that stand at a place which is a stop."""
LEAST_STOP_STD_M = 3.0
LEAST_YAW_STD_RAD = 0.006
LENGTHS_PART = 0.15
"""Rides along one line whose ways differ by more have not gone all of it."""


class Trace(NamedTuple):
    """What one ride shows."""

    yaw_rad: Array
    """Each metre of its own way, from the first stand on."""
    stands_m: Array
    """Where it stood, along its own way."""
    doors: NDArray[np.bool_]
    """Whether doors opened there; all of them where nobody tells."""


@dataclass
class _Collected:
    yaw: list[float]
    stands: list[tuple[float, bool]]


def trace_of(vehicle: Vehicle, frames: Iterable[Sample]) -> Trace:
    """Follow a ride's frames, as the processor does.

    Raises
    ------
    TramstreamError
        If it goes less than `SHORTEST_M`.
    """
    settings = SegmentFinder(vehicle).settings
    motion = Motion(vehicle, settings, MotionMemory())
    ledger = Ledger(motion, 0.1, LedgerMemory())
    found = _Collected([], [])
    before = (0.0, 0.0)
    told = False
    for sample in frames:
        epoch = motion.take(sample.message)
        if epoch is None:
            continue
        now = (motion.gone_m, float(motion.memory.x[Ix.YAW]))
        while len(found.yaw) * STEP_M <= now[0]:
            way = now[0] - before[0]
            share = (len(found.yaw) * STEP_M - before[0]) / way if way > 0.0 else 1.0
            share = min(max(share, 0.0), 1.0)
            found.yaw.append(before[1] + share * (now[1] - before[1]))
        before = now
        for event in ledger.take(epoch):
            if event.kind == SegmentEvent.STOP:
                found.stands.append((event.start_m, event.doors_opened))
                told = told or event.doors_opened
    if ledger.memory.halted:
        found.stands.append((ledger.memory.halt_m, ledger.memory.doors))
    if len(found.yaw) < SHORTEST_M:
        raise TramstreamError(
            f"a ride of {len(found.yaw)} m shows no line; give rides from first stop to last"
        )
    stands = np.array([each for each, _ in found.stands])
    doors = np.array([opened or not told for _, opened in found.stands], dtype=bool)
    return Trace(np.array(found.yaw), stands, doors)


def laid(reference: Array, yaw: Array) -> Array:
    """Where along `reference` each `LAID_M` of another ride lies, by the turns of both; m.

    The ways are taken for equal but for one factor, and what is off beside that for slowly
    changing: the likeliest course of shifts (Viterbi's algorithm over a band of ±`APART_M`).
    """
    factor = (len(reference) - 1) / (len(yaw) - 1)
    own = np.arange(0.0, len(yaw) - 1.0, LAID_M)
    turned = np.diff(np.interp(own, np.arange(len(yaw)), yaw))
    shifts = np.arange(-APART_M, APART_M + SHIFT_M / 2, SHIFT_M)
    at = factor * own[:, None] + shifts[None, :]
    heading = np.interp(at, np.arange(len(reference)), reference)
    off = (turned[:, None] - np.diff(heading, axis=0)) / HEADING_STD_RAD
    fits = np.minimum(0.5 * off**2, 12.0)  # a switch that was gone otherwise is no reason to jump
    cost = 0.5 * (shifts / BEGIN_STD_M) ** 2
    came = np.zeros(fits.shape, dtype=np.int8)
    for k in range(len(fits)):
        stay, left, right = cost, np.roll(cost, 1) + SHIFT_COST, np.roll(cost, -1) + SHIFT_COST
        left[0] = right[-1] = np.inf
        choices = np.stack([stay, left, right])
        came[k] = choices.argmin(axis=0)
        cost = choices.min(axis=0) + fits[k]
    path = np.empty(len(own), dtype=np.int64)
    path[-1] = int(cost.argmin())
    for k in range(len(fits) - 1, -1, -1):
        path[k] = path[k + 1] - (0, 1, -1)[came[k, path[k + 1]]]
    found: Array = factor * own + _smooth(shifts[path])
    return found


def _smooth(shift: Array) -> Array:
    """Steps of half a metre are no jumps of the wheels."""
    size = 2 * round(30.0 / LAID_M) + 1
    padded = np.pad(shift, size // 2, mode="edge")
    smooth: Array = np.convolve(padded, np.full(size, 1.0 / size), "valid")
    return smooth


def learn(traces: Sequence[Trace], line: str, direction: str) -> Signature:
    """Make one line of rides along it.

    Raises
    ------
    TramstreamError
        If there is none, or one of them has not gone all of the line.
    """
    if not traces:
        raise TramstreamError("no ride was given; a line is learned from at least one")
    lengths = np.array([len(each.yaw_rad) for each in traces], dtype=float)
    middle = float(np.median(lengths))
    short = np.flatnonzero(np.abs(lengths / middle - 1.0) > LENGTHS_PART)
    if len(short):
        number = int(short[0])
        raise TramstreamError(
            f"ride {number + 1} goes {lengths[number]:.0f} m, the others {middle:.0f} m; "
            "give rides along all of the line"
        )
    reference = traces[int(np.argmin(np.abs(lengths - middle)))]
    count = round(float(lengths.mean()))
    at = np.arange(count) * STEP_M
    turned, stands = [], []
    for trace in traces:
        along = laid(reference.yaw_rad, trace.yaw_rad)
        own = np.arange(len(along)) * LAID_M
        scaled = np.maximum.accumulate(along) * (count - 1) / (len(reference.yaw_rad) - 1)
        place_of = np.interp(at, scaled + 1e-9 * own, own)
        yaw = np.interp(place_of, np.arange(len(trace.yaw_rad)), trace.yaw_rad)
        turned.append(np.diff(yaw))
        stands.append(np.interp(trace.stands_m, own, scaled)[trace.doors])
    rate = np.array(turned)
    yaw = np.concatenate([[0.0], np.cumsum(np.median(rate, axis=0) if len(rate) > 2 else rate[0])])
    if len(rate) == 2:
        yaw = np.concatenate([[0.0], np.cumsum(rate.mean(axis=0))])
    stops, stop_std = _stops(stands)
    return Signature(
        line,
        direction,
        yaw,
        stops,
        tuple(f"stop {k + 1}" for k in range(len(stops))),
        yaw_std_rad=_spread(rate, yaw),
        stop_std_m=stop_std,
        rides=len(traces),
    )


def _spread(rate: Array, yaw: Array) -> float:
    """How far headings of a ride are off the line's within 30 m: gyroscopes' drift left out."""
    if len(rate) < 2:
        return 2.0 * LEAST_YAW_STD_RAD
    off = np.cumsum(rate, axis=1) - yaw[None, 1:]
    size = 100
    mean = np.array([np.convolve(row, np.full(size, 1.0 / size), "same") for row in off])
    rest = (off - mean)[:, size:-size]
    std = 1.5 * float(np.median(np.abs(rest))) * math.sqrt(1.0 + 1.0 / len(rate))
    return max(std, LEAST_YAW_STD_RAD)


def _stops(stands: Sequence[Array]) -> tuple[Array, float]:
    """Where most rides have stood, and how far apart they did."""
    rows = sorted((float(at), k) for k, each in enumerate(stands) for at in each)
    groups: list[list[tuple[float, int]]] = []
    for row in rows:
        if groups and row[0] - groups[-1][-1][0] < STOP_NEAR_M:
            groups[-1].append(row)
        else:
            groups.append([row])
    kept = [g for g in groups if len({k for _, k in g}) >= STOP_SHARE * len(stands)]
    stops = np.array([np.mean([at for at, _ in group]) for group in kept])
    off = [at - np.mean([a for a, _ in group]) for group in kept for at, _ in group]
    return stops, max(LEAST_STOP_STD_M, 1.5 * float(np.std(off)) if off else 0.0)
