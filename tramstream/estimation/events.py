"""Why a fix that its receiver calls valid is not used by any localiser: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import define

_RECEIVER = "The receiver errs, or its messages are made by somebody who does."

FIX_NO_NUMBER = define(
    "fix.no_number",
    "{key}: a fix is not used, its position is no number",
    cause=_RECEIVER,
    cure="look at the receiver's own position",
    key=str,
)
FIX_NOWHERE = define(
    "fix.nowhere",
    "{key}: a fix is not used, {latitude_deg} {longitude_deg} is nowhere on the Earth",
    cause=_RECEIVER,
    cure="look at the receiver's own position",
    key=str,
    latitude_deg=float,
    longitude_deg=float,
)
FIX_TOO_HIGH = define(
    "fix.too_high",
    "{key}: a fix is not used, its height of {height_m} is not near the ground, limit {limit_m}",
    cause=_RECEIVER + " The limit is that of the highest mountain.",
    cure="look at the receiver's own position",
    key=str,
    height_m=float,
    limit_m=float,
)
FIX_TOO_POOR = define(
    "fix.too_poor",
    "{key}: a fix is not used, the receiver itself says {accuracy_m}, limit {limit_m}",
    cause="Few satellites, or jamming: a fix of this accuracy tells nothing.",
    cure="look at the antenna and its view of the sky",
    key=str,
    accuracy_m=float,
    limit_m=float,
)
FIX_TOO_FAR = define(
    "fix.too_far",
    "{key}: a fix is not used, it is {distance_m} from where the ride began, limit {limit_m}",
    cause="The first fix of the ride was wrong, this one is, or somebody replays another ride.",
    cure="see whether the next fixes are there too: then the ride begins anew by itself",
    key=str,
    distance_m=float,
    limit_m=float,
)
