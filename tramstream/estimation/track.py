"""The track near a place, as a circle, and what a vehicle beside it is told by that.

A map matcher says it (`TrackGeometry`) of the vehicle at one instant. A localisation filter takes
it later, at a delay that is the same wherever the matcher runs: it goes back from where it is by
what its predictions have moved it since (`Trail`). What updates have moved since stays in it, so
the innovation is the one that the state of that instant has now.

Equations: docs/theory.md, section 11.6.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from tramstream.clock import S
from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.proto.estimate_pb2 import TrackGeometry

CERTAIN = 0.995
"""A filter is put onto a track that is so likely: of 1,000 stretches believed, five are wrong."""
SHARPEST = 0.2
"""Of 1 − curvature times distance: what is farther inside a curve than that has no one place."""
MARGIN_S = 0.1
"""How much longer than the delay a trail is: frames come at their own pace."""

Pose = tuple[float, float, float, float]
"""East, north (m), yaw, pitch (rad) of the point that follows the rails, in `l`."""


class OnTrack(NamedTuple):
    """That the vehicle is on a track, of which it is thought to be off: a measurement by the map.

    Variances are those of white noise once a metre that tells as much as the map does.
    """

    normal_east: float
    normal_north: float
    """Left unit normal of the track, in `l`."""
    across_m: float
    """How far left of the track it is thought to be."""
    yaw_off_rad: float
    """How much further left than along the track it heads."""
    bend_per_m: float
    """How much the track turns left for each metre that the vehicle goes along it."""
    across_variance: float
    yaw_variance: float
    grade_rad: float
    """Uphill positive along x of the vehicle; NaN where the map does not know."""
    grade_variance: float


class LocalTrack(NamedTuple):
    """The circle that a track is near a place, in `l`."""

    stamp_ns: int
    """Of the vehicle that it speaks of."""
    east: float
    north: float
    """The place, on the track, m."""
    yaw_rad: float
    """Of the track there, along x of the vehicle."""
    curvature_per_m: float
    """By which it turns left."""
    grade_rad: float
    """Uphill positive; NaN where the map does not know."""
    across_variance: float
    yaw_variance: float
    grade_variance: float
    ahead_m: float
    behind_m: float
    """How far it stands for the track."""

    def told(self, east: float, north: float, yaw_rad: float) -> OnTrack | None:
        """Tell a vehicle how far it is off; None if it is not where this stands for the track."""
        cos, sin, k = math.cos(self.yaw_rad), math.sin(self.yaw_rad), self.curvature_per_m
        de, dn = east - self.east, north - self.north
        along, left = cos * de + sin * dn, cos * dn - sin * de
        # The radius less the distance from the centre, written so that a straight is one of them.
        twice = 2.0 * left - k * (along * along + left * left)
        root = 1.0 - k * twice
        if root <= SHARPEST * SHARPEST:
            return None
        across = twice / (1.0 + math.sqrt(root))
        turned = math.atan2(k * along, 1.0 - k * left)
        way = turned / k if abs(k * along) > 1e-9 else along
        if not -self.behind_m <= way <= self.ahead_m:
            return None
        yaw = self.yaw_rad + turned
        return OnTrack(
            normal_east=-math.sin(yaw),
            normal_north=math.cos(yaw),
            across_m=across,
            yaw_off_rad=math.remainder(yaw_rad - yaw, math.tau),
            bend_per_m=k / max(1.0 - k * across, SHARPEST),
            across_variance=self.across_variance,
            yaw_variance=self.yaw_variance,
            grade_rad=self.grade_rad,
            grade_variance=self.grade_variance,
        )


def in_level(message: TrackGeometry, level: LocalLevel, height_m: float) -> LocalTrack | None:
    """Give what a message says in `level`; None if it is no number.

    Parameters
    ----------
    height_m : float
        Of the vehicle above the ellipsoid: the message has none, and far from the origin of `level`
        its plane leans.
    """
    latitude, longitude = math.radians(message.latitude_deg), math.radians(message.longitude_deg)
    variances = message.across_variance_m2, message.yaw_variance_rad2
    numbers = (latitude, longitude, message.yaw_rad, message.curvature_per_m, *variances)
    reach = message.ahead_m, message.behind_m
    if not (math.isfinite(sum(numbers)) and math.isfinite(sum(reach)) and min(variances) > 0.0):
        return None
    east, north, _ = level.place(latitude, longitude, height_m)
    known = message.HasField("grade_rad") and message.grade_variance_rad2 > 0.0
    return LocalTrack(
        message.stamp_ns,
        east,
        north,
        message.yaw_rad + float(convergence_rad(level, longitude)),
        message.curvature_per_m,
        message.grade_rad if known else math.nan,
        *variances,
        message.grade_variance_rad2,
        *reach,
    )


@dataclass
class TrailMemory:
    """What a `Trail` remembers."""

    carried: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])
    """East, north, yaw, pitch by which all predictions together have moved the filter."""
    rows: deque[tuple[int, Pose]] = field(default_factory=deque)
    """How far it had been carried, by stamp."""


class Trail:
    """How far predictions have carried a filter in its last moments.

    Parameters
    ----------
    span_s : float
        So long ago may be asked about.
    memory : TrailMemory or None
        Part of its owner's memory; one of its own by default.
    """

    def __init__(self, span_s: float, memory: TrailMemory | None = None) -> None:
        self._span_ns = int((span_s + MARGIN_S) * S)
        self.memory = TrailMemory() if memory is None else memory
        self.carried = self.memory.carried
        """See `TrailMemory`."""
        self._rows = self.memory.rows

    def carry(self, before: Pose, after: Pose) -> None:
        """Take note that a prediction has moved the filter."""
        for k, (a, b) in enumerate(zip(before, after, strict=True)):
            self.carried[k] += b - a

    def pass_by(self, stamp_ns: int) -> None:
        """Take note that the filter is at an instant now."""
        rows = self._rows
        while rows and rows[-1][0] >= stamp_ns:
            rows.pop()
        east, north, yaw, pitch = self.carried
        rows.append((stamp_ns, (east, north, yaw, pitch)))
        oldest_ns = stamp_ns - self._span_ns
        while rows[0][0] < oldest_ns:
            rows.popleft()

    def at(self, stamp_ns: int, now: Pose) -> Pose | None:
        """Give where a filter that is at `now` was at an instant, by all that it knows now.

        None if it was not under way then, or too long ago.
        """
        rows = self._rows
        k = bisect_left(rows, stamp_ns, key=_stamp)
        if k == len(rows) or (k == 0 and rows[0][0] != stamp_ns):
            return None
        later_ns, carried = rows[k]
        if later_ns != stamp_ns:
            earlier_ns, before = rows[k - 1]
            share = (stamp_ns - earlier_ns) / (later_ns - earlier_ns)
            carried = _sum(before, carried, share)
        e, n, yaw, pitch = (
            here - (total - then)
            for here, total, then in zip(now, self.carried, carried, strict=True)
        )
        return e, n, yaw, pitch


def _sum(first: Pose, second: Pose, share: float) -> Pose:
    e, n, yaw, pitch = (a + share * (b - a) for a, b in zip(first, second, strict=True))
    return e, n, yaw, pitch


def _stamp(row: tuple[int, Pose]) -> int:
    return row[0]
