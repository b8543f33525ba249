"""The map matcher as a processor: the states of any localiser in, the track and its geometry out.

It knows nothing of the localiser but its messages (`[map] source`), and nothing of who takes what
it says: a localisation filter takes `map/matcher/track` like any measurement, at a delay of its own
(`ekf.track_delay_s`). A network that cannot be read is said in health, and nothing is matched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from tramstream import keys
from tramstream.clock import S
from tramstream.config import MATCHER, Map, Vehicle
from tramstream.errors import ConfigError
from tramstream.estimation.followed import followed
from tramstream.events import declared
from tramstream.events.kinds import Event
from tramstream.keys import Key
from tramstream.memory.stage import assign
from tramstream.processor import Processor, Sample
from tramstream.processors.matching import events as own_events
from tramstream.processors.matching.events import MAP_FAR, MAP_REFUSED
from tramstream.processors.matching.matcher import (
    TRACE_FORGET_S,
    HypothesesMemory,
    Match,
    Matcher,
)
from tramstream.processors.matching.messages import geometry_of, location_of, message_of
from tramstream.processors.matching.source import (
    FixesMemory,
    ReceiverFixes,
    Source,
    States,
    StatesMemory,
)
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.tracks import network as networks
from tramstream.tracks.linear_reference import references
from tramstream.tracks.map_frame import MapFrame

FAR_M = 2000.0
"""A vehicle that is farther from all tracks has another city's map."""
LOCATION_S = 0.1
"""Viewers draw maps at 10 Hz."""
FIX_GAP_S = 5.0
"""Receivers give a fix a second at least; after so many seconds nobody knows which way was gone."""


@dataclass
class MatcherMemory:
    """What the map matcher remembers."""

    matcher: HypothesesMemory | None = None
    """None where there is no network."""
    states: StatesMemory = field(default_factory=StatesMemory)
    fixes: FixesMemory = field(default_factory=FixesMemory)
    """Of the one or the other it is followed."""
    located_ns: int = 0
    """Stamp of the last place for viewers."""
    told_far: bool = False
    """Whether it has been said that the map is another city's."""
    told_unread: bool = False
    """Whether it has been said that the network cannot be read."""


class MapMatcher(Processor):
    """Which track the vehicle is on, and how that track runs near by.

    Raises
    ------
    ConfigError
        If `[map] source` is a key of something that is no place.
    """

    name = MATCHER
    inputs: tuple[Key, ...] = (keys.EST_STATE,)
    outputs = (keys.MAP_MATCH, keys.MAP_LOCATION, keys.MAP_TRACK)
    events = declared(own_events)
    Memory = MatcherMemory
    memory: MatcherMemory

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self._vehicle = vehicle
        self._matcher: Matcher | None = None
        self._frame: MapFrame | None = None
        self._unread: Event | None = None
        if vehicle.map is None:
            return
        key = followed("map.source", vehicle.map.source, (keys.GNSS_FIX,))
        self.inputs = (key,)
        self._of_fixes = key.type is GnssFix
        self._source = self._followed()
        try:
            network = networks.load(Path(vehicle.map.network))
        except ConfigError as error:
            self._unread = MAP_REFUSED(reason=error.reason, advice=error.cure)
            return
        self._references = references(network)
        self._network = network
        self._matcher = self._remembering(vehicle.map)

    def _followed(self) -> Source:
        """Who is followed, as it is remembered."""
        return ReceiverFixes(self.memory.fixes) if self._of_fixes else States(self.memory.states)

    def _remembering(self, settings: Map) -> Matcher:
        """Give a matcher whose memory is part of this processor's, and goes on from it."""
        matcher, known = self._fresh(settings), self.memory.matcher
        if known is not None:
            assign(matcher.remembered, known)
        self.memory.matcher = matcher.remembered
        return matcher

    def _fresh(self, settings: Map) -> Matcher:
        vehicle = self._vehicle
        lever_m = math.hypot(*vehicle.gnss.lever_arm_m[:2]) if vehicle.gnss is not None else 0.0
        if self._of_fixes:  # that of a fix is the antenna's place, whatever the heading
            return Matcher(self._network, settings, TRACE_FORGET_S, gap_s=FIX_GAP_S)
        pivot_m = vehicle.ekf.pivot_m
        return Matcher(self._network, settings, pivot_m=pivot_m, lever_m=lever_m)

    def step(self, sample: Sample) -> list[Sample]:
        matcher, stamp_ns = self._matcher, sample.stamp_ns
        if matcher is None:
            if self._unread is None or self.memory.told_unread:
                return []
            self.memory.told_unread = True
            return self.raise_event(self._unread, stamp_ns)
        source = self._source
        estimate = source.take(sample.message)
        if estimate is None:
            return []
        level = source.ground.level
        assert level is not None  # there is an estimate
        frame = self._frame
        if frame is None or frame.level is not level:
            frame = self._frame = MapFrame(matcher.network, level)
            frame.follow(0.0, 0.0, 0.0)
        match = matcher.step(estimate, frame, source.held, source.alone)
        return (
            [] if match is None else self._found(matcher, match, frame, sample, estimate.standing)
        )

    def _found(
        self, matcher: Matcher, match: Match, frame: MapFrame, sample: Sample, standing: bool
    ) -> list[Sample]:
        """Put what was found into messages."""
        stamp_ns, memory = sample.stamp_ns, self.memory
        message = message_of(matcher, matcher.said(match), frame, standing)
        made = [self.emit(keys.MAP_MATCH, message, stamp_ns)]
        if match.run < 0:
            return made + self._tell_far(matcher, stamp_ns)
        for each in self._references.at(match.run, match.chainage_m):
            line = matcher.network.lines[each.line]
            message.references.add(
                line=line.line, direction=line.direction, chainage_m=each.chainage_m
            )
        if match.circle is not None:
            geometry = geometry_of(matcher, match.circle, frame)
            made.append(self.emit(keys.MAP_TRACK, geometry, stamp_ns))
        if not 0 <= stamp_ns - memory.located_ns < LOCATION_S * S:
            memory.located_ns = stamp_ns
            made.append(self.emit(keys.MAP_LOCATION, location_of(message), stamp_ns))
        return made

    def _tell_far(self, matcher: Matcher, stamp_ns: int) -> list[Sample]:
        if self.memory.told_far:
            return []
        away_m = matcher.away_m()
        if away_m <= FAR_M:
            return []
        self.memory.told_far = True
        source = matcher.network.source or "of unknown source"
        far = MAP_FAR(distance_m=away_m, source=source, limit_m=FAR_M)
        return self.raise_event(far, stamp_ns)

    # Memory --------------------------------------------------------------------------------------
    def restored(self) -> None:
        self._frame = None
        settings = self._vehicle.map
        if self._matcher is not None and settings is not None:
            self._matcher, self._source = self._remembering(settings), self._followed()
