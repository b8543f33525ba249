"""What the study of the map matcher counts on rides, and how rides are summed up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tramstream.analysis.studies.matching_judge import EDGES, Reliability
from tramstream.tracks.network import Array

TRACK = "right_track"
"""Of all points since the first answer, standing ones too; no answer is a wrong one."""
STANDING, MOVING = "right_track_standing", "right_track_moving"
BESIDE = "right_track_beside_parallel"
"""Of the points where the true track has a parallel neighbour."""
STRICT = "right_track_at_switches_too"
"""The same without leave for rails that have not parted yet."""
DIRECTION = "right_direction"
"""Of the points on the right track since the matcher knows its direction."""
SWITCHES = ("right_way_30_m", "right_way_15_m", "right_way_parted")
"""Of the facing switches passed, so far beyond each; 30 m or where the rails have parted."""
TWO_SIGMA = "along_within_2_sigma"
"""0.954 where the stated deviation is right."""
NEAREST_FIX, NEAREST_STATE = "nearest_to_fix", "nearest_to_filter_without_map"
"""Nearest-track matching of every fix, and of the position of a filter that has no map."""
TALLIES = (
    TRACK, STANDING, MOVING, BESIDE, STRICT, DIRECTION, *SWITCHES, TWO_SIGMA, NEAREST_FIX,
    NEAREST_STATE,
)  # fmt: skip

WANTED = {TRACK: 0.995, SWITCHES[0]: 0.99}
"""Least shares that were demanded (docs/accuracy.md, *Which track*)."""
WANTED_OF_90 = (0.87, 0.93)
"""Of what is called 90 %, between these are right."""
PERCENTILES = (50, 90, 99)


class Tally(NamedTuple):
    """So many right ones of so many."""

    right: int
    total: int

    @property
    def share(self) -> float | None:
        return self.right / self.total if self.total else None


class Mistake(NamedTuple):
    """A stretch of points on a wrong track, or a switch beyond which the way was wrong."""

    kind: str
    """`track` or `switch`."""
    start_s: float
    """Of the ride,"""
    end_s: float
    route_m: float
    """along the route, at its start."""
    standing: bool
    """At its start."""
    true: str
    """Name of the run, at its start."""
    true_run: int
    said: str
    """Empty: no answer."""
    said_run: int
    """Shorter than their names, which tables have no room for."""
    probability: float
    """Said at its start."""


class Figures(NamedTuple):
    """One ride."""

    route: str
    seed: int
    length_m: float
    """Of the way gone since the first answer."""
    duration_s: float
    starting_s: float
    """From the filter's first position until the first answer."""
    step_us: float
    """Processor time of filter and matcher for one frame, this machine."""
    tallies: dict[str, Tally]
    along_m: Array
    """Once a second, ahead of the truth; of answers on the route."""
    best: Reliability
    """Of the most probable run,"""
    candidates: Reliability
    """and of it and all alternatives."""
    mistakes: tuple[Mistake, ...]


@dataclass(frozen=True)
class Total:
    """Several rides together."""

    name: str
    rides: int
    length_m: float
    duration_s: float
    starting_s: float
    """Mean."""
    step_us: float
    """Mean."""
    tallies: dict[str, Tally]
    along_m: tuple[float, ...]
    """`PERCENTILES` of the distance along the track from the truth; NaN without any."""
    best: Reliability
    candidates: Reliability


class Bin(NamedTuple):
    """One line of a reliability table."""

    low: float
    high: float
    points: int
    episodes: int
    stated: float
    """Mean probability."""
    right: float
    """Share."""
    std: float
    """Deviation of that share if each episode were one throw."""


def total(name: str, figures: Sequence[Figures]) -> Total:
    """Add up rides; there is at least one."""
    along_m = np.abs(np.concatenate([each.along_m for each in figures]))
    known = tuple(np.percentile(along_m, PERCENTILES).tolist()) if len(along_m) else ()
    return Total(
        name=name,
        rides=len(figures),
        length_m=sum(each.length_m for each in figures),
        duration_s=sum(each.duration_s for each in figures),
        starting_s=float(np.mean([each.starting_s for each in figures])),
        step_us=float(np.mean([each.step_us for each in figures])),
        tallies={name: _sum([each.tallies[name] for each in figures]) for name in TALLIES},
        along_m=known or (float("nan"),) * len(PERCENTILES),
        best=_added([each.best for each in figures]),
        candidates=_added([each.candidates for each in figures]),
    )


def totals(figures: Sequence[Figures]) -> list[Total]:
    """Each route's rides, in the order in which they come, and all together."""
    routes: dict[str, list[Figures]] = {}
    for each in figures:
        routes.setdefault(each.route, []).append(each)
    found = [total(route, rides) for route, rides in routes.items()]
    return [*found, total("all", figures)] if len(found) > 1 else found


def bins(reliability: Reliability) -> list[Bin]:
    """The lines of a reliability table that have anything in them."""
    highs = [*EDGES[1:].tolist(), 1.0]
    found = []
    for low, high, points, stated, right, episodes in zip(
        EDGES.tolist(), highs, *(column.tolist() for column in reliability), strict=True
    ):
        if points:
            share = right / points
            # One more of either kind: a bin without a mistake is not without doubt.
            guess = (share * episodes + 1.0) / (episodes + 2.0)
            std = float(np.sqrt(guess * (1.0 - guess) / episodes))
            found.append(Bin(low, high, int(points), int(episodes), stated / points, share, std))
    return found


def _sum(tallies: Sequence[Tally]) -> Tally:
    return Tally(sum(each.right for each in tallies), sum(each.total for each in tallies))


def _added(several: Sequence[Reliability]) -> Reliability:
    return Reliability(*(np.sum(columns, axis=0) for columns in zip(*several, strict=True)))
