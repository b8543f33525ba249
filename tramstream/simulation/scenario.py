"""Scenarios: how a simulated ride is driven, what its sensors do wrong, and what happens on it.

A scenario is a TOML file, read as strictly as a vehicle's configuration; unknown fields are
refused. A sensor whose section is absent is not there. The scenarios of the published works and
`city`, ours, are part of the package (`names`). What the vehicle's configuration would say of the
sensors and what is true of them are two things: `…_error_…`, `misalignment_deg` and `timing` are
known to the simulation alone.
"""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from tramstream import config, geodesy
from tramstream.config import NotNegative, Positive, Struct, Vector, VehicleId
from tramstream.errors import ConfigError
from tramstream.input_file import TEXT_LIMIT_BYTES, read_limited
from tramstream.simulation.body import Body, Number
from tramstream.simulation.event_kinds import (
    SIDES,
    AnyEvent,
    Event,
    GnssDrift,
    GnssJump,
    Side,
    Slide,
    Slip,
    Tunnel,
)
from tramstream.simulation.imu import ImuErrors, ImuScales
from tramstream.simulation.receiver import GnssErrors
from tramstream.simulation.roughness import Roughness
from tramstream.simulation.speed_plan import Limits
from tramstream.simulation.wheels import Axle
from tramstream.strict_toml import decode_toml

__all__ = [
    "SIDES",
    "Event",
    "Gnss",
    "GnssDrift",
    "GnssJump",
    "Imu",
    "Scenario",
    "Side",
    "Slide",
    "Slip",
    "Timing",
    "Track",
    "Tunnel",
    "Wheels",
    "load",
    "names",
    "parse",
    "stated_std_m",
]


Delay = Annotated[float, Meta(ge=0, le=100_000)]
Offset = Annotated[float, Meta(ge=-100_000, le=100_000)]
"""Seconds of a day: several deviations more are still instants that a stamp can hold."""


class Timing(Struct, frozen=True, kw_only=True):
    """When a sensor's message says that it was true, and when it is published."""

    stamp_offset_s: Offset = 0.0
    """The stamp is later than the truth by so much."""
    stamp_jitter_s: Delay = 0.0
    """Deviation of the stamp around that."""
    latency_s: Delay = 0.0
    """From the truth until publication at the earliest; a stamp is never published before its
    time."""
    latency_jitter_s: Delay = 0.0
    """Up to so much later, all delays alike."""


class Imu(Struct, frozen=True, kw_only=True):
    """The inertial sensor."""

    rate_hz: Positive = 2000.0
    batch: Annotated[int, Meta(ge=1, le=200)] = 20
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """From the vehicle's origin, as the configuration says."""
    lever_arm_error_m: Vector = (0.0, 0.0, 0.0)
    """To be added for the truth."""
    mounting_deg: Vector = (0.0, 0.0, 0.0)
    """Ψ = roll, pitch, yaw of the case, as the configuration says."""
    mounting_std_deg: NotNegative = 1.0
    """As the configuration says."""
    part: Number = 1
    """Of the body that it is fixed to, from the front."""
    misalignment_deg: Vector = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the true case against the one that the configuration means."""
    timing: Timing = Timing()
    errors: ImuErrors = ImuErrors()
    scales: ImuScales = ImuScales()


class Gnss(Struct, frozen=True, kw_only=True):
    """The receiver."""

    rate_hz: Positive = 5.0
    velocity: bool = True
    """Whether fixes carry velocity."""
    part: Number = 1
    """Of the body that the antenna is fixed to, from the front."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """Antenna from the vehicle's origin, as the configuration says."""
    lever_arm_error_m: Vector = (0.0, 0.0, 0.0)
    """To be added for the truth."""
    stated_horizontal_std_m: Positive | None = None
    """Per axis, what the receiver believes of itself; None: the truth of `errors`."""
    stated_vertical_std_m: Positive | None = None
    jumps_per_min: NotNegative = 0.0
    """Multipath: how often a fix jumps away for a while, on average."""
    jump_std_m: NotNegative = 5.0
    """Deviation of a jump per horizontal axis."""
    jump_max_m: Positive | None = None
    """A jump that would be longer is so long."""
    jump_duration_s: Positive = 8.0
    """Mean of the exponential distribution."""
    reacquisition_s: NotNegative = 2.0
    """From the end of a tunnel until the next fix."""
    timing: Timing = Timing()
    errors: GnssErrors = GnssErrors()


class Wheels(Struct, frozen=True, kw_only=True):
    """Wheel encoders, doors and motor force on the vehicle's bus."""

    rate_hz: Positive = 50.0
    wheels: tuple[Side, ...] = SIDES
    doors: bool = True
    motor_force: bool = True
    axle: Axle = Axle()
    bogie: Literal["", "front"] = ""
    """`wheels.bogie` of the configuration; those of a simulated body are on its first bogie."""
    stated_delay_s: float = 0.0
    """`wheels.delay_s` of the configuration; the truth is `timing.stamp_offset_s`."""
    slides_per_stop: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Share of stops at which wheels slide while braking."""
    slips_per_stop: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Share of departures at which wheels slip."""
    timing: Timing = Timing()

    def __post_init__(self) -> None:
        if not self.wheels or len(set(self.wheels)) < len(self.wheels):
            raise ValueError("`wheels` must name one wheel or both, each once")


class Track(Struct, frozen=True, kw_only=True):
    """What of the line's properties counts."""

    cant: bool = True
    geoid_m: float = geodesy.PRAGUE_GEOID_M
    """Height of the geoid above the ellipsoid; a map's heights are above the geoid."""
    roughness: Roughness = Roughness()


class Scenario(Struct, frozen=True, kw_only=True):
    """A whole scenario."""

    vehicle: VehicleId = "simulated"
    reverse: bool = False
    """The rear cab leads all the way: x of the vehicle points against the direction of travel."""
    truth_rate_hz: Positive = 20.0
    end_s: NotNegative = 5.0
    """The sensors go on for so long after standstill at the last stop."""
    duration_s: Positive | None = None
    """All ends after so long, wherever the vehicle is by then; None: at the last stop."""
    track: Track = Track()
    body: Body | None = None
    """None: a point that follows the rail, its axes those of the track."""
    driver: Limits = Limits()
    imu: Imu | None = None
    gnss: Gnss | None = None
    wheels: Wheels | None = None
    events: tuple[AnyEvent, ...] = ()
    resampler: config.Resampler | None = None
    """Of the configuration; None: 100 Hz."""
    ekf: config.Ekf = config.Ekf()
    """Of the configuration."""

    def __post_init__(self) -> None:
        parts = self.body.parts if self.body is not None else 1
        for name, sensor in (("imu", self.imu), ("gnss", self.gnss)):
            if sensor is not None and sensor.part > parts:
                raise ValueError(f"`{name}.part` is {sensor.part}; the body has {parts}")


def names() -> list[str]:
    """Scenarios of the package."""
    folder = resources.files("tramstream") / "data" / "scenarios"
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    )


def load(name: str) -> Scenario:
    """Read a scenario: the name of one of the package, or a TOML file.

    Raises
    ------
    ConfigError
        One sentence with the file, the path of the field and what was expected.
    """
    known = names()
    if name in known:
        file = resources.files("tramstream") / "data" / "scenarios" / f"{name}.toml"
        return parse(file.read_bytes(), f"scenario {name}")
    try:
        return parse(read_limited(Path(name), TEXT_LIMIT_BYTES), name)
    except OSError as error:
        raise ConfigError(
            f"scenario {name}: cannot be read ({error.strerror}); give a file or one of "
            f"{', '.join(known)}"
        ) from error


def parse(data: bytes, name: str) -> Scenario:
    """Decode the text of a scenario; `name` is for the sentence of a ConfigError."""
    return decode_toml(data, Scenario, name)


def stated_std_m(gnss: Gnss) -> tuple[float, float]:
    """Deviation per horizontal axis and vertical that the receiver states."""
    errors = gnss.errors
    horizontal = gnss.stated_horizontal_std_m
    vertical = gnss.stated_vertical_std_m
    return (
        math.hypot(errors.horizontal_std_m, errors.white_horizontal_std_m)
        if horizontal is None
        else horizontal,
        math.hypot(errors.vertical_std_m, errors.white_vertical_std_m)
        if vertical is None
        else vertical,
    )
