"""Settings of the section `[grade]`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from tramstream import keys
from tramstream.config import NotNegative, Number, Positive, Struct


class GradeSettings(Struct, frozen=True, kw_only=True):
    """The slope of the track, the vehicle's mass, and how far it goes until it stands."""

    source: Annotated[str, Meta(pattern=r"^[^/*]+/[^/*]+/[^/*]+$")] = keys.EST_STATE.path
    """Key of the localiser's state that gives speed, acceleration and the body's pitch."""
    delay_s: Annotated[float, Meta(ge=0.02, le=2.0)] = 0.2
    """The slope at an instant is said so long after its frame: until then the state and the match
    of that instant come, wherever they are made. What comes later is counted and not used."""
    pitch_deg_per_mps2: Number = 0.2
    """How far springs let the body nod for each m/s² of force along the track, bow up when it
    speeds up. The processor learns it; a stop and a departure tell."""
    pitch_std_deg_per_mps2: NotNegative = 0.2
    """How well that is known. A Tatra T3's kind nods by 0.3° (scenario `tram`), a truck on the rail
    not at all."""
    mass_kg: Positive = 60_000.0
    """What is set in motion, passengers and turning wheels included; learned where the vehicle bus
    tells the motor force."""
    mass_std_kg: Positive = 60_000.0
    """How well that is known."""
    rolling_resistance: NotNegative = 0.002
    """Force of rolling per weight; learned likewise. chladek2023 has 0.00005, a tram in grooved
    rail 0.002 to 0.006."""
    rolling_resistance_std: NotNegative = 0.002
    """How well that is known."""
    drag_n_per_mps2: NotNegative = 9.13
    """Force of the air at 1 m/s, ½ c_w A ρ of chladek2023 (docs/theory.md, section 3.6)."""
    decelerations_mps2: Annotated[tuple[Positive, ...], Meta(min_length=1, max_length=8)] = (
        1.0,
        1.55,
    )
    """Of braking on the level, for the distances to stop: in service, and with all brakes."""
    reaction_s: Annotated[float, Meta(ge=0, le=10)] = 0.0
    """The vehicle rolls on so long until the brakes hold."""
