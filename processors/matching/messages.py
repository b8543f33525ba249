"""How the map matcher publishes what it has found."""

from __future__ import annotations

import math
from typing import cast

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream.geodesy import convergence_rad
from tramstream.processors.matching.hypotheses import ROTATION
from tramstream.processors.matching.matcher import Circle, Match, Matcher
from tramstream.proto.estimate_pb2 import MapAlternative, MapMatch, TrackGeometry
from tramstream.tracks.map_frame import MapFrame
from tramstream.tracks.network import PARTNER_LEFT, PARTNER_RIGHT, Network

_SIDES = {
    0: MapMatch.SINGLE,
    PARTNER_LEFT: MapMatch.RIGHT,
    PARTNER_RIGHT: MapMatch.LEFT,
    PARTNER_LEFT | PARTNER_RIGHT: MapMatch.MIDDLE,
}
_ON_TRACK = MapMatch.ON_TRACK
_APPROXIMATED = LocationFix.PositionCovarianceType.APPROXIMATED


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
    message = MapMatch()  # field by field: by keywords it takes twice as long
    message.state = _ON_TRACK
    message.edge = matcher.name_of(match.run)
    message.run = match.run
    message.chainage_m = match.chainage_m
    message.chainage_std_m = match.chainage_std_m
    message.probability = match.probability
    message.off_probability = match.off_probability
    message.side = cast("MapMatch.Side", side_of(network, matcher, match))
    message.standing = standing
    message.direction_known = match.headed
    message.latitude_deg, message.longitude_deg = frame.geodetic_deg(match.east, match.north)
    if alternatives:
        message.alternatives.extend(alternatives)
    return message


def side_of(network: Network, matcher: Matcher, match: Match) -> int:
    """Side of the street that a match is on, one of `MapMatch.Side`."""
    partner = int(network.partner[matcher.sample_at(match.run, match.chainage_m)])
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


def geometry_of(matcher: Matcher, circle: Circle, frame: MapFrame) -> TrackGeometry:
    """Give the track near the vehicle as it is published."""
    latitude_deg, longitude_deg = frame.geodetic_deg(circle.east, circle.north)
    # Into the frame of the estimate, and from there to east of the place.
    yaw = circle.yaw_rad - float(frame.numbers[ROTATION])
    yaw -= float(convergence_rad(frame.level, math.radians(longitude_deg)))
    message = TrackGeometry(
        edge=matcher.name_of(circle.run),
        run=circle.run,
        chainage_m=circle.chainage_m,
        probability=circle.probability,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        yaw_rad=math.remainder(yaw, math.tau),
        curvature_per_m=circle.curvature_per_m,
        across_variance_m2=circle.across_variance,
        yaw_variance_rad2=circle.yaw_variance,
        curvature_variance_per_m2=circle.curvature_variance,
        ahead_m=circle.ahead_m,
        behind_m=circle.behind_m,
    )
    if not math.isnan(circle.grade_rad):
        message.grade_rad, message.grade_variance_rad2 = circle.grade_rad, circle.grade_variance
    return message
