"""What the map matcher has to say of its map."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, define

MAP_REFUSED = define(
    "map_matcher.map_refused",
    "$.map.network: {reason}; localisation goes on without the map",
    cause="The track network cannot be read.",
    cure="{advice}",
    severity=ERROR,
    reason=str,
    advice=str,
)
MAP_FAR = define(
    "map_matcher.map_far",
    "the vehicle is {distance_m} from the nearest track of the map ({source}), limit {limit_m}; "
    "localisation goes on without",
    cause="The map is another city's, or its extract ends before the line does.",
    cure="build the network from an extract that holds the line ($.map.network)",
    distance_m=float,
    source=str,
    limit_m=float,
)
