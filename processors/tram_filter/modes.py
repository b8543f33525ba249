"""The situations of the filter `tram`: its phases with what ends each, and what drives its motion.

Two things change with the situation, each an explicit mode with one table:

- the *phase* of the localiser (`Phase`): `TRANSITIONS` says which event leads from which to which,
  and an event that has no place there is a bug;
- the *drive* of the prediction (`Drive`): what tells how the vehicle moves. Every drive may follow
  every other, for the frame decides; `drive_by_reading` and `drive_without_reading` are that table.

Whether the vehicle stands is `standstill.py`'s word, frame by frame, in every phase. What is
published (`published_mode`) follows from the phase and the age of the last accepted fix.

docs/localisation.md, *Modes*, shows the tables; equations: docs/theory.md, section 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

from tramstream.clock import S
from tramstream.estimation.localiser import DEAD_RECKONING, HEADING_UNKNOWN, STARTING, TRACKING

DEAD_RECKONING_S = 5.0
"""Without an accepted fix for so long it is dead reckoning; chosen by hand, no study."""
HELD_S = 0.1
"""An inertial reading is good for so long: ten of them were due; chosen by hand, no study."""
RATE_HELD_S = 1.0
"""A yaw rate of the bus, which comes less often, is good for so long; chosen by hand, no study."""
BRIDGED_S = 2.0
"""Over a shorter pause, the mean of the readings on either side is better than none; chosen by
hand, guarded by `tests/processors/tram/test_tram_outages.py`."""


class Phase(Enum):
    """How far the localiser is."""

    WAITING = "waiting"
    """No usable fix yet: nothing is known."""
    RESTING = "resting"
    """The filter runs without a heading, which a vehicle that stands does not need."""
    SEEKING = "seeking"
    """Coarse alignment: the vehicle moves, and its heading is sought."""
    RUNNING = "running"
    """The heading is known."""


WAITING, RUNNING = Phase.WAITING, Phase.RUNNING
"""Asked for with every frame: a member is looked up in an enumeration eight times as long."""


class Event(Enum):
    """What ends a phase."""

    FIRST_FIX = "first usable fix"
    DEPARTURE = "the vehicle moves"
    ALIGNED = "heading found"
    ALIGNMENT_FAILED = "stands too early, or after 120 s"
    SENSORS_SILENT = "no inertial and no wheel reading for 5 s"
    PARKED_RESUMED = "a parked vehicle has not moved"
    CONTRADICTED = "several sources contradict the filter"
    WHEELS_LIED = "it moved while all wheels stood"
    MOUNTING_WRONG = "the IMU is mounted otherwise than configured"
    RESTART = "the filter begins anew"


_PLACED = (Phase.RESTING, Phase.SEEKING, Phase.RUNNING)
TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = MappingProxyType(
    {
        (Phase.WAITING, Event.FIRST_FIX): Phase.RESTING,
        (Phase.RESTING, Event.DEPARTURE): Phase.SEEKING,
        (Phase.SEEKING, Event.ALIGNED): Phase.RUNNING,
        (Phase.SEEKING, Event.ALIGNMENT_FAILED): Phase.RESTING,
        (Phase.SEEKING, Event.SENSORS_SILENT): Phase.RESTING,
        (Phase.RUNNING, Event.SENSORS_SILENT): Phase.RESTING,
        (Phase.RUNNING, Event.CONTRADICTED): Phase.RUNNING,
        **{(phase, Event.WHEELS_LIED): Phase.RESTING for phase in _PLACED},
        (Phase.SEEKING, Event.MOUNTING_WRONG): Phase.RESTING,
        (Phase.RUNNING, Event.MOUNTING_WRONG): Phase.RESTING,
        **{(phase, Event.PARKED_RESUMED): Phase.RUNNING for phase in _PLACED},
        **{(phase, Event.RESTART): Phase.WAITING for phase in Phase},
    }
)
"""Which event leads from which phase to which."""


def published_mode(phase: Phase, since_accepted_s: float) -> int:
    """What `MotionState.mode` says, by the phase and the age of the last accepted fix."""
    if phase is WAITING:
        return STARTING
    if phase is not RUNNING:
        return HEADING_UNKNOWN
    return DEAD_RECKONING if since_accepted_s > DEAD_RECKONING_S else TRACKING


class Drive(Enum):
    """What tells the filter how the vehicle moves."""

    INERTIAL = "inertial readings"
    BRIDGED = "the readings on either side of a pause"
    YAW_RATE = "the bus' own yaw rate"
    COASTING = "nothing"


INERTIAL, BRIDGED, COASTING = Drive.INERTIAL, Drive.BRIDGED, Drive.COASTING
"""Asked for with every reading; see `RUNNING`."""


def drive_by_reading(pause_s: float, one_before: bool) -> Drive:
    """What drives the motion up to a usable inertial reading.

    Parameters
    ----------
    pause_s : float
        Since the reading before.
    one_before : bool
        Whether there is a reading of the accelerometer before it that could stand for the pause.
    """
    if pause_s <= HELD_S:
        return INERTIAL
    return BRIDGED if one_before and pause_s <= BRIDGED_S else COASTING


def drive_without_reading(
    since_reading_ns: int, since_rate_ns: int, rate_read: bool
) -> Drive | None:
    """What drives the motion through a frame without a usable inertial reading; None: as before.

    Parameters
    ----------
    since_reading_ns, since_rate_ns : int
        Since the last inertial reading, and since the last usable yaw rate of the bus.
    rate_read : bool
        Whether this frame brings one.
    """
    if since_reading_ns < HELD_S * S:
        return None
    if rate_read:
        return Drive.YAW_RATE
    return COASTING if since_rate_ns > RATE_HELD_S * S else None
