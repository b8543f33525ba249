"""Geofences: circles on the map, entered and left."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from tramstream.estimation.fixes import unusable
from tramstream.processors.segments.settings import Area
from tramstream.proto.estimate_pb2 import SegmentEvent
from tramstream.proto.sync_pb2 import SyncFrame

EARTH_RADIUS_M = 6_371_000.0
MARGIN = 1.1
"""An area is left a tenth outside of where it was entered, so that nobody stands on its border."""
LEAST_MARGIN_M = 5.0


@dataclass
class AreasMemory:
    """Areas that the vehicle is in, and since when."""

    inside: dict[str, int] = field(default_factory=dict)
    entered_m: dict[str, float] = field(default_factory=dict)


class Areas:
    """Says which borders a new place has passed."""

    def __init__(self, areas: Mapping[str, Area], memory: AreasMemory) -> None:
        self.memory = memory
        self._areas = dict(areas)

    def take(
        self, latitude_rad: float, longitude_rad: float, gone_m: float, stamp_ns: int, source: str
    ) -> list[SegmentEvent]:
        """Take a place; the borders that lie between it and the one before."""
        made, inside = [], self.memory.inside
        for name, area in self._areas.items():
            away_m = _away_m(area, latitude_rad, longitude_rad)
            within = name in inside
            margin_m = max((MARGIN - 1.0) * area.radius_m, LEAST_MARGIN_M) if within else 0.0
            if (away_m <= area.radius_m + margin_m) == within:
                continue
            event = SegmentEvent(
                kind=SegmentEvent.AREA_LEFT if within else SegmentEvent.AREA_ENTERED,
                start_ns=inside.pop(name) if within else stamp_ns,
                end_ns=stamp_ns,
                start_m=self.memory.entered_m.pop(name, gone_m) if within else gone_m,
                end_m=gone_m,
                probability=1.0,
                name=name,
                inputs=[source],
            )
            if not within:
                inside[name] = stamp_ns
                self.memory.entered_m[name] = gone_m
            made.append(event)
        return made


def of_fixes(frame: SyncFrame) -> tuple[float, float] | None:
    """Latitude and longitude, rad, of the newest usable fix of a frame."""
    for fix in reversed(frame.gnss):
        if fix.valid and unusable(fix, None) is None:
            return math.radians(fix.latitude_deg), math.radians(fix.longitude_deg)
    return None


def _away_m(area: Area, latitude_rad: float, longitude_rad: float) -> float:
    north = latitude_rad - math.radians(area.latitude_deg)
    east = math.remainder(longitude_rad - math.radians(area.longitude_deg), math.tau)
    east *= math.cos(latitude_rad)
    return EARTH_RADIUS_M * math.hypot(north, east)
