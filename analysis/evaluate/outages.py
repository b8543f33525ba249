"""What an estimate does without GNSS: errors at the end of gaps in the valid fixes, and the start.

A gap runs from one valid fix to the next, or from the last one to the last error known. Its error
is that of the last instant before the fix that ends it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tramstream.analysis.evaluate.errors import Errors
from tramstream.clock import S
from tramstream.estimation.series import FixSeries, Instants, StateSeries, TruthSeries
from tramstream.proto.estimate_pb2 import MotionState

STALE_S = 1.0
"""An error older than this when the fix comes back says nothing of the end of the gap."""
EDGES_S = (10.0, 30.0, 60.0, 120.0)
"""Upper ends of the groups of gaps; the last group has none."""


@dataclass(frozen=True)
class Outage:
    """One gap in the valid fixes, and the error at its end."""

    start_ns: int
    duration_s: float
    distance_m: float
    """Travelled in it; NaN if the truth does not know."""
    horizontal_m: float
    along_m: float
    across_m: float


@dataclass(frozen=True)
class OutageGroup:
    """Gaps no longer than `to_s`, and longer than those of the group before."""

    to_s: float
    count: int
    distance_m: float
    """Mean of those where it is known."""
    horizontal_rms_m: float
    along_rms_m: float
    across_rms_m: float


@dataclass(frozen=True)
class Start:
    """From the first valid fix to the first state, and to the first that tracks; None: never."""

    to_state_s: float | None
    to_tracking_s: float | None


def start(states: StateSeries, fixes: FixSeries) -> Start | None:
    """How long the estimate took to begin; None without a valid fix."""
    valid_ns = fixes.stamp_ns[fixes.valid]
    if not len(valid_ns):
        return None

    def after_s(stamp_ns: Instants) -> float | None:
        return int(stamp_ns[0] - valid_ns[0]) / S if len(stamp_ns) else None

    begun = states.mode != MotionState.STARTING
    tracking = states.mode == MotionState.TRACKING
    return Start(after_s(states.stamp_ns[begun]), after_s(states.stamp_ns[tracking]))


def outages(
    errors: Errors, fixes: FixSeries, truth: TruthSeries, longer_than_s: float
) -> list[Outage]:
    """Gaps in the valid fixes that are longer than `longer_than_s` and whose end has an error."""
    if not len(errors):
        return []
    valid_ns = fixes.stamp_ns[fixes.valid]
    last_ns = errors.stamp_ns[-1]
    ends_ns = (
        np.append(valid_ns, last_ns + 1) if len(valid_ns) and valid_ns[-1] < last_ns else valid_ns
    )
    found = []
    for gap in np.flatnonzero(np.diff(ends_ns) > longer_than_s * S):
        begin_ns, end_ns = int(ends_ns[gap]), int(ends_ns[gap + 1])
        last = int(np.searchsorted(errors.stamp_ns, end_ns)) - 1
        if last < 0 or errors.stamp_ns[last] < max(begin_ns, end_ns - STALE_S * S):
            continue
        found.append(
            Outage(
                start_ns=begin_ns,
                duration_s=(end_ns - begin_ns) / S,
                distance_m=distance_m(truth, begin_ns, end_ns),
                horizontal_m=float(errors.horizontal_m[last]),
                along_m=float(errors.along_m[last]),
                across_m=float(errors.across_m[last]),
            )
        )
    return found


def distance_m(truth: TruthSeries, start_ns: int, end_ns: int) -> float:
    """Way travelled between two instants, backwards counted too.

    The integral of the speed's size where it is known, else the length of the positions' polygon.
    NaN with less than two instants.
    """
    inside = truth.take((truth.stamp_ns >= start_ns) & (truth.stamp_ns <= end_ns))
    if len(inside) < 2:
        return float("nan")
    if np.isfinite(inside.speed_mps).all():
        size = np.abs(inside.speed_mps)
        return float(np.sum((size[1:] + size[:-1]) / 2 * np.diff(inside.stamp_ns) / S))
    return float(np.linalg.norm(np.diff(inside.p_l, axis=0), axis=1).sum())


def grouped(found: Sequence[Outage]) -> list[OutageGroup]:
    """Root mean squares by duration; groups without a gap are left out."""
    groups = []
    for low, high in zip((0.0, *EDGES_S), (*EDGES_S, float("inf")), strict=True):
        members = [each for each in found if low < each.duration_s <= high]
        if not members:
            continue
        distances = [each.distance_m for each in members if np.isfinite(each.distance_m)]
        groups.append(
            OutageGroup(
                to_s=high,
                count=len(members),
                distance_m=float(np.mean(distances)) if distances else float("nan"),
                horizontal_rms_m=_rms([each.horizontal_m for each in members]),
                along_rms_m=_rms([each.along_m for each in members]),
                across_rms_m=_rms([each.across_m for each in members]),
            )
        )
    return groups


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else np.nan
