"""What the localisation filter as a processor has to say of its state and of the track."""

from __future__ import annotations

from tramstream.events.kinds import ERROR, define

NO_NUMBER = define(
    "ekf.no_number",
    "the filter's state was no number; it starts again",
    cause="A bug in the filter, or an input that it should have refused.",
    severity=ERROR,
)
MAP_UNMATCHED = define(
    "ekf.map_unmatched",
    "there is a map and $.processors does not name map_matcher; localisation goes on without the "
    "map",
    cause="The configuration has a section [map], and its own list of processors.",
    cure="add map_matcher to $.processors",
)
TRACK_UNHEARD = define(
    "ekf.track_unheard",
    "nothing has been heard of the track for {way_m}, limit {limit_m}; localisation goes on "
    "without the map",
    cause="The map matcher does not run, or the vehicle has left the map.",
    cure="look at what map_matcher says",
    way_m=float,
    limit_m=float,
)
