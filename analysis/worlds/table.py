"""The worlds in which the localisation is tried: what is true, what its operator has configured.

A world is a value. `true` changes the base scenario into what the simulator does; `told` changes it
into what the configuration is made from. So the filter is told what an operator knows of the
vehicle as it should be, and never the simulator's own parameters: where `told` is empty it has the
configuration of the base scenario, whatever happens. `events` are made from the ride, for many are
at a speed or in a curve of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from msgspec.structs import replace

from tramstream.analysis.worlds.moments import (
    Events,
    corner_gaps,
    departure_jump,
    drift,
    from_start,
    lasting,
)
from tramstream.simulation.body import Body
from tramstream.simulation.event_kinds import (
    ClockOff,
    GnssFrozen,
    GnssHold,
    GnssJammed,
    GnssJump,
    GnssStated,
    ImuDead,
    ImuSaturated,
    ImuStuck,
    Slip,
    WheelsFrozen,
)
from tramstream.simulation.roughness import Roughness
from tramstream.simulation.scenario import Scenario, load
from tramstream.simulation.track_rides import MapError

Changes = Mapping[str, Any]
AS_IT_IS: Changes = {}
TODAY = "as today"
SLOW_TAU_S = 600.0
DECAY_OF_600_S = math.exp(-1.0 / SLOW_TAU_S)


class Wanted(NamedTuple):
    """What is wanted of a world beside figures."""

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
    events: Events | None = None
    """Of a ride that ends at a time; the first is the fault whose saying is timed."""
    wanted: Wanted = Wanted()
    moving: bool = False
    """The fault is there from the start and shows with the first departure."""
    map_error: MapError = MapError()
    lacks_m: float | None = None
    """The map lacks the track that the line takes so far on: it was built later."""
    duration_s: float | None = None
    """Its rides are no longer."""
    bound: bool = False
    """The posterior Cramér-Rao bound holds its noise, but for multipath and drifts at stops."""


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


# Changes ------------------------------------------------------------------------------------------
def _turned(roll_deg: float = 0.0, yaw_deg: float = 0.0) -> Changes:
    """The case is mounted otherwise than configured; the base's own misalignment stays."""
    return {"imu": {"misalignment_deg": (0.4 + roll_deg, -0.7, 0.9 + yaw_deg)}}


def _shaken(force_mps2: float, rate_radps: float) -> Changes:
    rough = Roughness(waves_mps2=(force_mps2,) * 3, waves_radps=(rate_radps,) * 3)
    return {"track": {"roughness": rough}}


def _gear(name: str) -> Changes:
    """Body and rails of a scenario."""
    chosen = load(name)
    return {"body": chosen.body, "track": chosen.track}


def _told(bogies_m: float) -> Changes:
    """What an operator knows of a body whose first bogies are so far apart."""
    return {
        "ekf": {"pivot_m": bogies_m / 2, "bogie_distance_m": bogies_m},
        "wheels": {"bogie": "front"},
    }


_BOGIES_M, _FIRST_PART_M = 6.4, 8.9
_STIFF = Body(pivots_m=(0.0, -_BOGIES_M), pitch_deg_per_mps2=0.0, roll_deg_per_mps2=0.0)
_SHORT = Body(pivots_m=(0.0, -1.8))
"""A truck of two axles, on springs: its chord is nearly the track."""
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
    World(TODAY, "scenario city as it stands, its IMU read at 400 Hz", bound=True),
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
        bound=True,
    ),
    World(
        "slow fix errors",
        "errors of fixes last ten minutes, configured as ever (19.5 s)",
        {"gnss": {"errors": {"decay": DECAY_OF_600_S}}},
        bound=True,
    ),
    World(
        "25 fixes a second",
        "the same errors, five times as often",
        {"gnss": {"rate_hz": 25.0}},
        bound=True,
    ),
    World(
        "boastful receiver",
        "σ stated ten times too small",
        events=from_start(GnssStated, factor=0.1),
        wanted=_GROSS,
        moving=True,
    ),
    World(
        "frozen fixes",
        "the last fix for 30 s, valid, without velocity",
        events=lasting(GnssFrozen, 30.0),
        wanted=_DEAD,
    ),
    World(
        "frozen fixes and velocity",
        "the last fix for 30 s, valid, with its velocity",
        events=lasting(GnssFrozen, 30.0, velocity="kept"),
        wanted=_DEAD,
    ),
    World(
        "spoofed jump",
        "fixes jump by 200 m for 60 s",
        events=lasting(GnssJump, 60.0, east_m=120.0, north_m=160.0),
        wanted=Wanted(10.0, sensible=False),
    ),
    World(
        "spoofed drift",
        "fixes and their velocity drift off by 0.2 m/s until the end",
        events=drift(0.2),
        wanted=Wanted(None, sensible=False),
    ),
    World(
        "jammed receiver",
        "errors of 10 m that it does not state, for 30 s",
        events=lasting(GnssJammed, 30.0),
    ),
    World(
        "static hold",
        "place held and speed 0 below 1 m/s",
        events=from_start(GnssHold, below_mps=1.0),
    ),
    World(
        "heavy tails",
        "white errors of 0.7 m, of Student's t with 3 degrees of freedom",
        {"gnss": {"errors": {"white_horizontal_std_m": 0.7, "white_dof": 3.0}}},
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
    World("IMU stuck", "repeats itself for 60 s", events=lasting(ImuStuck, 60.0), wanted=_DEAD),
    World(
        "IMU axis saturated",
        "yaw gyroscope at the end of its range for 60 s",
        events=lasting(ImuSaturated, 60.0),
        wanted=_DEAD,
    ),
    World("IMU all zero", "for 60 s", events=lasting(ImuDead, 60.0), wanted=_DEAD),
    World(
        "IMU gaps drawn straight",
        "1.5 s in each corner, by the logger; fixes as ever",
        events=corner_gaps,
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
        events=corner_gaps,
    ),
    World(
        "wheels 0 from the start",
        "both, all the way",
        events=from_start(WheelsFrozen),
        wanted=_DEAD,
        moving=True,
    ),
    World(
        "wheels frozen",
        "both stop counting at speed, for 60 s",
        events=lasting(WheelsFrozen, 60.0),
        wanted=_DEAD,
    ),
    World(
        "wheels repeat their speed",
        "both go on counting as fast as at a moment, for 60 s",
        events=lasting(WheelsFrozen, 60.0, holds="speed"),
        wanted=_DEAD,
    ),
    World(
        "one wheel frozen",
        "the left one stops counting at speed, for 60 s",
        events=lasting(WheelsFrozen, 60.0, wheels=("left",)),
        wanted=_DEAD,
    ),
    World(
        "slip for a minute",
        "both wheels turn 10 % too fast for 60 s",
        events=lasting(Slip, 60.0, factor=1.1),
    ),
    World(
        "wheel clock 1 s off",
        "stamps of the wheels 1 s late, all the way",
        events=from_start(ClockOff, sensor="wheels", offset_s=1.0),
        wanted=_GROSS,
        moving=True,
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
    World("two bogies", "6.4 m apart, without springs", {"body": _STIFF}),
    World(
        "two bogies, pivot learned",
        "the same, pivot_m = 0 and pivot_std_m = 3 configured",
        {"body": _STIFF},
        {"ekf": {"pivot_std_m": 3.0}},
    ),
    World(
        "two bogies, pivot known",
        "the same, pivot_m = 3.2 configured: their middle",
        {"body": _STIFF},
        {"ekf": {"pivot_m": _BOGIES_M / 2}},
    ),
    World("two bogies, known", "the same, configured as it is", {"body": _STIFF}, _told(_BOGIES_M)),
    World(
        "springs", "a short truck whose body nods and leans by 0.3° for 1 m/s²", {"body": _SHORT}
    ),
    World("vibration", "waves of 0.3 m/s² and 1 °/s at 10 m/s", _shaken(0.3, math.radians(1.0))),
    World(
        "vibration and springs",
        "both",
        {"body": _SHORT, **_shaken(0.3, math.radians(1.0))},
    ),
    World(
        "tram",
        "two bogies, configured; springs and rails of scenario tram",
        _gear("tram"),
        _told(_BOGIES_M),
    ),
    World(
        "articulated tram",
        "three parts on four bogies, configured; sensors in the first, scenario tram_articulated",
        _gear("tram_articulated"),
        _told(_FIRST_PART_M),
    ),
    World(
        "IMU in another part",
        "the same with the IMU in the middle part, configured at its place",
        {**_gear("tram_articulated"), "imu": {"part": 2, "lever_arm_m": (-12.0, 0.4, 0.6)}},
        {"imu": {"lever_arm_m": (-12.0, 0.4, 0.6)}, **_told(_FIRST_PART_M)},
    ),
    World("map 1 m beside", "the rails are 1 m to the left", map_error=MapError(beside_m=1.0)),
    World("map 2 m beside", "the rails are 2 m to the left", map_error=MapError(beside_m=2.0)),
    World(
        "map in another datum",
        "the rails are 0.8 m to the east and 0.6 m to the north of the map",
        map_error=MapError(east_m=0.8, north_m=0.6),
    ),
    World(
        "map turned",
        "the rails are turned by 0.2 mrad about the middle of the line: 1.2 m at its ends",
        map_error=MapError(turned_rad=2e-4),
    ),
    World(
        "track moved",
        "rails were laid anew, 4 m to the left of the map from 1,000 to 1,300 m on",
        map_error=MapError(moved_m=4.0, moved_from_m=1000.0, moved_to_m=1300.0),
    ),
    World("track not mapped", "the map lacks the track that is taken at 2 km", lacks_m=2000.0),
    World(
        "position-only receiver",
        "no IMU, no wheels, fixes of 0.5 m without velocity",
        _POSITION_ONLY,
        {"imu": None, "wheels": None},
    ),
    World(
        "first departure",
        "a fix jumps by 15 m around it; the ride ends a minute later",
        events=departure_jump,
        duration_s=90.0,
    ),
)


def world_of(name: str) -> World | None:
    """The world of a name."""
    return next((world for world in WORLDS if world.name == name), None)
