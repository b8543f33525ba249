"""What the localisation filter as a processor has to say of its state and its map."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, define

NO_NUMBER = define(
    "ekf.no_number",
    "the filter's state was no number; it starts again",
    cause="A bug in the filter, or an input that it should have refused.",
    severity=ERROR,
)
MAP_REFUSED = define(
    "ekf.map_refused",
    "$.map.network: {reason}; localisation goes on without the map",
    cause="The track network cannot be read.",
    cure="{advice}",
    severity=ERROR,
    reason=str,
    advice=str,
)
MAP_FAR = define(
    "ekf.map_far",
    "the vehicle is {distance_m} from the nearest track of the map ({source}), limit {limit_m}; "
    "localisation goes on without",
    cause="The map is another city's, or its extract ends before the line does.",
    cure="build the network from an extract that holds the line ($.map.network)",
    distance_m=float,
    source=str,
    limit_m=float,
)
