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
FIX_SPOOFED = define(
    "fix.spoofed",
    "{key}: a fix is not used, the receiver itself says that its signals are forged ({state}); it "
    "claims {accuracy_m} with {satellites} satellites",
    cause="Somebody sends what looks like satellites, or repeats their signals into a hall. The "
    "receiver's detector can be wrong, too.",
    cure="see raw/gnss/interference, and whether the other sensors agree with the fixes",
    key=str,
    state=str,
    accuracy_m=float,
    satellites=int,
)
FIX_JAMMED = define(
    "fix.jammed",
    "{key}: a fix is not used, the receiver itself says that interference leaves none ({state}); "
    "it claims {accuracy_m} with {satellites} satellites",
    cause="A jammer, a modem or a defective antenna beside the receiver.",
    cure="see raw/gnss/interference, and look for what was switched on",
    key=str,
    state=str,
    accuracy_m=float,
    satellites=int,
)
