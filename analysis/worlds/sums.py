"""Rides of worlds summed up by seeds, beside the world as simulated today."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tramstream.analysis.worlds.study import Case, Figures, said
from tramstream.analysis.worlds.table import TODAY, world_of

RATIO, OVER_BOUND, NEES, BEYOND, TRACK = 1.5, 1.15, (0.5, 2.0), 0.01, 0.995
"""Wanted (docs/accuracy.md, *Worlds*): P90 over today's, or over its own bound, NEES a dimension,
share of a world's time beyond the protection level, right track."""
DIMENSIONS = 2


@dataclass(frozen=True)
class Sum:
    """One world with or without a map: means over seeds, the worst where it is about the worst."""

    world: str
    line: str
    with_map: bool
    asked_s: float
    """Length of its rides, if their line is no shorter."""
    rides: int
    p50_m: float
    p90_m: float
    moving_p90_m: float
    """Since the first departure."""
    rms_m: float
    max_m: float
    """The largest."""
    ratio: float
    """P90 since the departure over that of the same rides as today, NaN without these."""
    over_bound: float | None
    """The same over that of the posterior Cramér-Rao bound, where that holds the world's noise."""
    nees: float
    beyond_share: float | None
    beyond_worst_share: float | None
    protection_m: float | None
    heading_rms_deg: float
    right_track_share: float | None
    said_s: tuple[float | None, ...] | None
    """After the fault, ride by ride; None where it was not said, or where nothing needs to be."""
    said_by: tuple[str, ...]
    """Kinds of events that said it."""
    failed: tuple[str, ...]
    """What of that it does not meet."""


def sums(figures: Sequence[Figures]) -> list[Sum]:
    """Sum up, in the order in which worlds come; today's rides are taken from among them."""
    kinds: dict[tuple[Case, bool], list[Figures]] = {}
    for each in figures:
        kinds.setdefault((each.case._replace(seed=0), each.with_map), []).append(each)
    today = {
        (each.case, each.duration_s, each.with_map): each
        for each in figures
        if each.case.world == TODAY
    }
    return [_sum(rides, today) for rides in kinds.values()]


def _sum(rides: list[Figures], today: dict[tuple[Case, float, bool], Figures]) -> Sum:
    def mean(name: str) -> float:
        return float(np.mean([getattr(each, name) for each in rides]))

    def squares(name: str) -> float:
        return math.sqrt(float(np.mean([getattr(each, name) ** 2 for each in rides])))

    def known(name: str) -> list[float]:
        return [value for each in rides if (value := getattr(each, name)) is not None]

    first = rides[0]
    same = [today.get((each.case.today, each.duration_s, each.with_map)) for each in rides]
    pairs = [(each, beside) for each, beside in zip(rides, same, strict=True) if beside]
    beyond, track, protection = (
        known("beyond_share"),
        known("right_track_share"),
        known("protection_m"),
    )
    bounds = known("bound_p90_m")
    found = [said(each, beside.raised) for each, beside in pairs if each.fault_s is not None]
    asked = [each.fault_s for each, _ in pairs if each.fault_s is not None]
    made = Sum(
        world=first.case.world,
        line=first.case.line,
        with_map=first.with_map,
        asked_s=first.case.duration_s,
        rides=len(rides),
        p50_m=mean("p50_m"),
        p90_m=mean("p90_m"),
        moving_p90_m=mean("moving_p90_m"),
        rms_m=squares("rms_m"),
        max_m=max(each.max_m for each in rides),
        ratio=float(np.mean([each.moving_p90_m / beside.moving_p90_m for each, beside in pairs]))
        if pairs
        else math.nan,
        over_bound=mean("moving_p90_m") / float(np.mean(bounds)) if bounds else None,
        nees=mean("nees"),
        beyond_share=float(np.mean(beyond)) if beyond else None,
        beyond_worst_share=max(beyond) if beyond else None,
        protection_m=float(np.mean(protection)) if protection else None,
        heading_rms_deg=squares("heading_rms_deg"),
        right_track_share=float(np.mean(track)) if track else None,
        said_s=tuple(
            None if each is None else each.time_s - begin_s
            for each, begin_s in zip(found, asked, strict=True)
        )
        if asked
        else None,
        said_by=tuple(sorted({each.kind for each in found if each is not None})),
        failed=(),
    )
    return _judged(made)


def _judged(made: Sum) -> Sum:
    """Hold a sum to what is wanted."""
    world = world_of(made.world)
    failed = []
    if world is not None and world.wanted.sensible:
        bound = made.over_bound is not None and made.over_bound <= OVER_BOUND
        if made.world != TODAY and made.ratio > RATIO and not bound:
            failed.append("P90")
        if not NEES[0] <= made.nees / DIMENSIONS <= NEES[1]:
            failed.append("NEES")
    if (made.beyond_worst_share or 0.0) > BEYOND:
        failed.append("PL")
    if made.right_track_share is not None and made.right_track_share < TRACK:
        failed.append("track")
    limit_s = None if world is None else world.wanted.said_s
    if limit_s is not None and any(each is None or each > limit_s for each in made.said_s or ()):
        failed.append("said")
    fields = {name: getattr(made, name) for name in made.__dataclass_fields__}
    return Sum(**{**fields, "failed": tuple(failed)})


def all_beyond_share(figures: Sequence[Figures], with_map: bool) -> float | None:
    """Share of all time beyond the protection level, of worlds that a sensible operator meets."""
    rides = [
        each
        for each in figures
        if each.with_map == with_map
        and each.beyond_share is not None
        and (world := world_of(each.case.world)) is not None
        and world.wanted.sensible
    ]
    total = sum(each.states for each in rides)
    if not total:
        return None
    return sum((each.beyond_share or 0.0) * each.states for each in rides) / total
