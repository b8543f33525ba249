"""The worlds in which the localisation is tried: what is true, what its operator has configured.

A world is a value. `true` changes the base scenario into what the simulator does; `told` changes it
into what the configuration is made from. So the filter is told what an operator knows of the
vehicle as it should be, and never the simulator's own parameters: where `told` is empty it has the
configuration of the base scenario, whatever happens. `events` are made from the ride, for many are
at a speed or in a curve of it. Issue 11 lists the worlds and what it wants of each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from tramstream.simulation.event_kinds import (
    AnyEvent,
    GnssDrift,
    GnssFrozen,
    GnssJump,
    GnssStated,
    ImuDead,
    ImuLost,
    ImuSaturated,
    ImuStuck,
    WheelsFrozen,
)
from tramstream.simulation.ride import Ride
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.track_rides import MapError

Changes = Mapping[str, Any]
AS_IT_IS: Changes = {}
TODAY = "as today"
AT_SPEED_MPS = 6.0
FAULT_SHARE = 0.4
"""Of the ride, before a fault: the filter knows by then what it can learn."""
SLOW_TAU_S = 600.0
DECAY_OF_600_S = math.exp(-1.0 / SLOW_TAU_S)
CORNER_PER_M = 1.0 / 60.0
"""Curves that are tighter are corners of streets."""
APART_S = 20.0
"""Between two gaps in corners, at least."""


class Wanted(NamedTuple):
    """What the issue wants of a world beside figures."""

    said_s: float | None = None
    """The fault is to be said so long after it began; None: nothing needs to be said."""
    sensible: bool = True
    """A sensible operator can meet it: P90 within 1.5 of today's world, protection levels hold."""


class World(NamedTuple):
    """One world."""

    name: str
    what: str
    """For people."""
    true: Changes = AS_IT_IS
    """Of the base scenario: sections as dictionaries, None leaves a sensor out."""
    told: Changes = AS_IT_IS
    """What of that the operator knows."""
    events: Callable[[Ride, float], tuple[AnyEvent, ...]] | None = None
    """Of a ride that ends at a time; the first is the fault whose saying is timed."""
    wanted: Wanted = Wanted()
    moving: bool = False
    """The fault is there from the start and shows with the first departure."""
    map_error: MapError = MapError()
    duration_s: float | None = None
    """Its rides are no longer."""


def changed(base: Scenario, changes: Changes) -> Scenario:
    """Give a scenario with some fields changed; a dictionary changes fields of a section."""
    made: Scenario = _changed(base, changes)
    return made


def _changed(base: Any, changes: Changes) -> Any:
    fields = {
        name: _changed(getattr(base, name), value) if isinstance(value, Mapping) else value
        for name, value in changes.items()
    }
    return replace(base, **fields)


# Times --------------------------------------------------------------------------------------------
def at_speed_s(ride: Ride, end_s: float, share: float = FAULT_SHARE) -> float:
    """First time after a share of the ride from which on the vehicle goes fast for ten seconds."""
    time_s = np.arange(share * end_s, end_s, 0.5)
    fast = np.abs(ride.motion(time_s).speed_mps) > AT_SPEED_MPS
    lasting = np.convolve(fast, np.ones(20), "full")[19:] == 20
    return float(time_s[int(np.argmax(lasting))])


def corners_s(ride: Ride, end_s: float) -> list[float]:
    """When the vehicle is in the middle of entering tight curves, from the second minute on."""
    time_s = np.arange(60.0, end_s, 0.2)
    motion = ride.motion(time_s)
    bent = np.abs(ride.line.curvature_per_m(motion.arc_length_m)) > CORNER_PER_M
    moving = np.abs(motion.speed_mps) > 2.0
    begins = time_s[1:][(bent & moving)[1:] & ~(bent & moving)[:-1]]
    found: list[float] = []
    for begin in begins.tolist():
        if not found or begin > found[-1] + APART_S:
            found.append(begin)
    return found


# Events -------------------------------------------------------------------------------------------
def _lasting(
    kind: Callable[..., AnyEvent], duration_s: float, **fields: Any
) -> Callable[[Ride, float], tuple[AnyEvent, ...]]:
    """A fault that begins at speed."""
    return lambda ride, end_s: (
        kind(start_s=at_speed_s(ride, end_s), duration_s=duration_s, **fields),
    )


def _from_start(
    kind: Callable[..., AnyEvent], **fields: Any
) -> Callable[[Ride, float], tuple[AnyEvent, ...]]:
    return lambda _, end_s: (kind(start_s=0.0, duration_s=end_s + 60.0, **fields),)


def _drift(speed_mps: float) -> Callable[[Ride, float], tuple[AnyEvent, ...]]:
    """Fixes, and velocities in them, wander off until the ride ends."""

    def events(ride: Ride, end_s: float) -> tuple[AnyEvent, ...]:
        start_s = at_speed_s(ride, end_s)
        east_m = speed_mps * (end_s - start_s)
        return (
            GnssDrift(start_s=start_s, duration_s=end_s - start_s, east_m=east_m, velocity=True),
        )

    return events


def _corner_gaps(ride: Ride, end_s: float) -> tuple[AnyEvent, ...]:
    return tuple(
        ImuLost(start_s=start_s, duration_s=1.5, straight=True)
        for start_s in corners_s(ride, end_s)
    )


def _departure_jump(ride: Ride, _: float) -> tuple[AnyEvent, ...]:
    departure_s = float(ride.dwells_s[0, 1])
    return (
        GnssJump(start_s=max(departure_s - 3.0, 0.0), duration_s=10.0, east_m=9.0, north_m=-12.0),
    )


def _turned(roll_deg: float = 0.0, yaw_deg: float = 0.0) -> Changes:
    """The case is mounted otherwise than configured; the base's own misalignment stays."""
    return {"imu": {"misalignment_deg": (0.4 + roll_deg, -0.7, 0.9 + yaw_deg)}}


_POSITION_ONLY: Changes = {
    "imu": None,
    "wheels": None,
    "gnss": {
        "velocity": False,
        "jumps_per_min": 0.0,
        "stated_horizontal_std_m": 0.5,
        "errors": {"horizontal_std_m": 0.5, "standing_drift_mps": 0.0},
    },
}
_GROSS, _DEAD, _JUMP = Wanted(60.0), Wanted(5.0), Wanted(10.0)

# The table ----------------------------------------------------------------------------------------
WORLDS: tuple[World, ...] = (
    World(TODAY, "scenario city as it stands, its IMU read at 400 Hz"),
    World(
        "honest receiver",
        "σ stated as it is, no jumps, no drift at stops",
        {
            "gnss": {
                "stated_horizontal_std_m": None,
                "stated_vertical_std_m": None,
                "jumps_per_min": 0.0,
                "errors": {"standing_drift_mps": 0.0},
            }
        },
    ),
    World(
        "slow fix errors",
        "errors of fixes last ten minutes, configured as ever (19.5 s)",
        {"gnss": {"errors": {"decay": DECAY_OF_600_S}}},
    ),
    World("25 fixes a second", "the same errors, five times as often", {"gnss": {"rate_hz": 25.0}}),
    World(
        "boastful receiver",
        "σ stated ten times too small",
        events=_from_start(GnssStated, factor=0.1),
        wanted=_GROSS,
        moving=True,
    ),
    World(
        "frozen fixes",
        "the last fix for 30 s, valid, without velocity",
        events=_lasting(GnssFrozen, 30.0),
        wanted=_DEAD,
    ),
    World(
        "frozen fixes and velocity",
        "the last fix for 30 s, valid, with its velocity",
        events=_lasting(GnssFrozen, 30.0, velocity="kept"),
        wanted=_DEAD,
    ),
    World(
        "spoofed jump",
        "fixes jump by 200 m for 60 s",
        events=_lasting(GnssJump, 60.0, east_m=120.0, north_m=160.0),
        wanted=Wanted(10.0, sensible=False),
    ),
    World(
        "spoofed drift",
        "fixes and their velocity drift off by 0.2 m/s until the end",
        events=_drift(0.2),
        wanted=Wanted(None, sensible=False),
    ),
    World(
        "antenna 1 m ahead",
        "of where it is configured",
        {"gnss": {"lever_arm_error_m": (1.1, 0.05, 0.05)}},
    ),
    World("mounting 10° off", "in yaw", _turned(yaw_deg=10.0), wanted=_GROSS, moving=True),
    World(
        "mounting 90° off",
        "in yaw",
        _turned(yaw_deg=90.0),
        wanted=Wanted(60.0, sensible=False),
        moving=True,
    ),
    World(
        "mounting upside down",
        "by 180° in roll",
        _turned(roll_deg=180.0),
        wanted=Wanted(60.0, sensible=False),
        moving=True,
    ),
    World("IMU stuck", "repeats itself for 60 s", events=_lasting(ImuStuck, 60.0), wanted=_DEAD),
    World(
        "IMU axis saturated",
        "yaw gyroscope at the end of its range for 60 s",
        events=_lasting(ImuSaturated, 60.0),
        wanted=_DEAD,
    ),
    World("IMU all zero", "for 60 s", events=_lasting(ImuDead, 60.0), wanted=_DEAD),
    World(
        "IMU gaps drawn straight",
        "1.5 s in each corner, by the logger; fixes as ever",
        events=_corner_gaps,
    ),
    World(
        "corner gaps, slow fixes",
        "the same with fixes of 0.5 m without jumps every 2 s",
        {
            "gnss": {
                "rate_hz": 0.5,
                "jumps_per_min": 0.0,
                "stated_horizontal_std_m": 0.5,
                "errors": {"horizontal_std_m": 0.5, "standing_drift_mps": 0.0},
            },
            "wheels": None,
        },
        {"wheels": None},
        events=_corner_gaps,
    ),
    World(
        "wheels 0 from the start",
        "both, all the way",
        events=_from_start(WheelsFrozen),
        wanted=_DEAD,
        moving=True,
    ),
    World(
        "wheels frozen",
        "both stop counting at speed, for 60 s",
        events=_lasting(WheelsFrozen, 60.0),
        wanted=_DEAD,
    ),
    World(
        "wheels repeat their speed",
        "both go on counting as fast as at a moment, for 60 s",
        events=_lasting(WheelsFrozen, 60.0, holds="speed"),
        wanted=_DEAD,
    ),
    World(
        "one wheel frozen",
        "the left one stops counting at speed, for 60 s",
        events=_lasting(WheelsFrozen, 60.0, wheels=("left",)),
        wanted=_DEAD,
    ),
    World(
        "warming IMU",
        "from −10 to 50 °C with a time constant of 300 s",
        {
            "imu": {
                "errors": {
                    "temperature_start_degc": -10.0,
                    "temperature_degc": 50.0,
                    "temperature_time_s": 300.0,
                }
            }
        },
    ),
    World("map 1 m beside", "the rails are 1 m to the left", map_error=MapError(beside_m=1.0)),
    World("map 2 m beside", "the rails are 2 m to the left", map_error=MapError(beside_m=2.0)),
    World(
        "position-only receiver",
        "no IMU, no wheels, fixes of 0.5 m without velocity",
        _POSITION_ONLY,
        {"imu": None, "wheels": None},
    ),
    World(
        "first departure",
        "a fix jumps by 15 m around it; the ride ends a minute later",
        events=_departure_jump,
        duration_s=90.0,
    ),
)


def world_of(name: str) -> World | None:
    """The world of a name."""
    return next((world for world in WORLDS if world.name == name), None)
