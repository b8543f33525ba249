"""What the odometer bridge has to say: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import INFO, define

READ_LATE = define(
    "odometer.read_late",
    "{message}: read up to {late_s} after it was sent; stamped by its cycle of {cycle_s}, {late} "
    "messages so far",
    cause="This computer is busy, and nobody but the reader stamps the frames of this adapter. The "
    "readings keep their weight.",
    cure="an adapter with a kernel driver (socketcan) stamps frames as they come",
    severity=INFO,
    message=str,
    late_s=float,
    cycle_s=float,
    late=int,
)
WAY_UNKNOWN = define(
    "odometer.way_unknown",
    "wheel {wheel}: the way of the last {gap_s} is not known, {reason}",
    cause="Frames are missing for so long that the counter may have gone round, or its ECU was "
    "started again; pulses fall by 2^36 there, and whoever reads them begins anew.",
    cure="look for what interrupts the bus; a counter of more bits goes round less often",
    wheel=str,
    gap_s=float,
    reason=str,
)
OTHER_SENDER = define(
    "odometer.other_sender",
    "{message} comes from source address {heard}, {wanted} is wanted; not used",
    cause="J1939: several ECUs send one parameter group, or the DBC names another sender than this "
    "vehicle has.",
    cure="give the message that source address in the DBC, or FE for the first that is heard",
    message=str,
    heard=str,
    wanted=str,
)
UNHEARD = define(
    "odometer.unheard",
    "{frames} frames came in {heard_s}, none of them {messages}",
    cause="Another bus than the DBC's, another DBC than the vehicle's, or an ECU that is off.",
    cure="look at channel, dbc and wheels of $.odometer (tramstream doctor tells what makes sense)",
    frames=int,
    heard_s=float,
    messages=str,
)
