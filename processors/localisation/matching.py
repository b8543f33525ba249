"""The map matcher beside a localisation filter: network, frame, and how a match is published."""

from __future__ import annotations

import math
from pathlib import Path
from typing import cast

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.estimation.localiser import Estimate, OnTrack
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.processor import State
from tramstream.processors.localisation.events import MAP_FAR, MAP_REFUSED
from tramstream.processors.matching.matcher import Match, Matcher
from tramstream.proto.estimate_pb2 import MapAlternative, MapMatch
from tramstream.tracks import network as networks
from tramstream.tracks.linear_reference import references
from tramstream.tracks.map_frame import FrameMemory, MapFrame
from tramstream.tracks.network import PARTNER_LEFT, PARTNER_RIGHT, Network
from tramstream.tracks.rails import sample_at

FAR_M = 2000.0
"""A vehicle that is farther from all tracks has another city's map."""
_SIDES = {
    0: MapMatch.SINGLE,
    PARTNER_LEFT: MapMatch.RIGHT,
    PARTNER_RIGHT: MapMatch.LEFT,
    PARTNER_LEFT | PARTNER_RIGHT: MapMatch.MIDDLE,
}
_APPROXIMATED = LocationFix.PositionCovarianceType.APPROXIMATED


class Matched:
    """Matches of one vehicle's estimates with its map.

    Parameters
    ----------
    vehicle : Vehicle
        Its map is configured. A network that cannot be read is said in `complaints`, and nothing
        matches: localisation goes on without the map.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        assert vehicle.map is not None
        self.complaints: list[Event] = []
        self._matcher: Matcher | None = None
        self._frame: MapFrame | None = None
        self._told_far = False
        try:
            network = networks.load(Path(vehicle.map.network))
        except ConfigError as error:
            self.complaints.append(MAP_REFUSED(reason=error.reason, advice=error.cure))
            return
        lever_m = math.hypot(*vehicle.gnss.lever_arm_m[:2]) if vehicle.gnss is not None else 0.0
        self._matcher = Matcher(network, vehicle.map, pivot_m=vehicle.ekf.pivot_m, lever_m=lever_m)
        self._references = references(network)

    def take(self, estimate: Estimate, level: LocalLevel) -> tuple[MapMatch, OnTrack | None] | None:
        """Match an estimate; None while there is nothing to say."""
        matcher = self._matcher
        if matcher is None:
            return None
        frame = self._frame
        if frame is None or frame.level is not level:
            frame = self._frame = MapFrame(matcher.network, level)
        match = matcher.step(estimate, frame)
        if match is None:
            return None
        if match.run < 0:
            self._tell_far(matcher)
        message = message_of(matcher, match, frame, estimate.standing)
        if match.run >= 0:
            for each in self._references.at(match.run, match.chainage_m):
                line = matcher.network.lines[each.line]
                message.references.add(
                    line=line.line, direction=line.direction, chainage_m=each.chainage_m
                )
        return message, match.on_track

    def _tell_far(self, matcher: Matcher) -> None:
        if self._told_far:
            return
        away_m = matcher.away_m()
        if away_m > FAR_M:
            self._told_far = True
            source = matcher.network.source or "of unknown source"
            self.complaints.append(MAP_FAR(distance_m=away_m, source=source, limit_m=FAR_M))

    def snapshot(self) -> State:
        matcher, frame = self._matcher, self._frame
        return {
            "matcher": None if matcher is None else matcher.snapshot(),
            "frame": None if frame is None else to_plain(frame.memory),
            "told_far": self._told_far,
        }

    def restore(self, state: State, level: LocalLevel | None) -> None:
        """Go on from `state`; `level` is the filter's frame."""
        self._frame, self._told_far = None, state["told_far"]
        if self._matcher is None or state["matcher"] is None:
            return
        self._matcher.restore(state["matcher"])
        if state["frame"] is not None and level is not None:
            self._frame = MapFrame(self._matcher.network, level)
            assign(self._frame.memory, from_plain(FrameMemory, state["frame"]))


def message_of(matcher: Matcher, match: Match, frame: MapFrame, standing: bool) -> MapMatch:
    """Give a match as it is published."""
    network = matcher.network
    alternatives = [
        MapAlternative(
            edge=matcher.name_of(each.run),
            run=each.run,
            chainage_m=each.chainage_m,
            probability=each.probability,
        )
        for each in match.others
    ]
    if match.run < 0:
        return MapMatch(
            state=MapMatch.OFF_MAP,
            run=-1,
            off_probability=match.off_probability,
            standing=standing,
            direction_known=match.headed,
            alternatives=alternatives,
        )
    latitude_deg, longitude_deg = frame.geodetic_deg(match.east, match.north)
    return MapMatch(
        state=MapMatch.ON_TRACK,
        edge=matcher.name_of(match.run),
        run=match.run,
        chainage_m=match.chainage_m,
        chainage_std_m=match.chainage_std_m,
        probability=match.probability,
        off_probability=match.off_probability,
        side=cast("MapMatch.Side", side_of(network, matcher, match)),
        standing=standing,
        direction_known=match.headed,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        alternatives=alternatives,
    )


def side_of(network: Network, matcher: Matcher, match: Match) -> int:
    """Side of the street that a match is on, one of `MapMatch.Side`."""
    partner = int(network.partner[sample_at(matcher.rails, match.run, match.chainage_m)])
    if match.run % 2:
        partner = (partner & 1) << 1 | partner >> 1
    return _SIDES[partner]


def location_of(match: MapMatch) -> LocationFix:
    """Give the place on the track as viewers know it."""
    variance = match.chainage_std_m**2
    return LocationFix(
        frame_id="track",
        latitude=match.latitude_deg,
        longitude=match.longitude_deg,
        position_covariance=(variance, 0, 0, 0, variance, 0, 0, 0, 0),
        position_covariance_type=_APPROXIMATED,
    )
