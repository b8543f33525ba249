"""What can be made to happen on a simulated ride: kinds of events, each a value of a scenario.

An event begins at a time, at a stop or at a place, and lasts. Kinds of two families: what happens
to vehicle and signals (jumps, tunnels, slips: `simulation.events` works them out before the sensors
measure), and faults of sensors, which change messages after they were made (`simulation.faults`).
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tramstream.config import NotNegative, Positive, Struct, Vector

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Axis = Literal["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
AXES: tuple[Axis, ...] = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
"""Of the IMU's case; names of the columns of `ImuBatch`."""
Sensor = Literal["imu", "gnss", "wheels"]


class Event(Struct, frozen=True, kw_only=True, tag_field="kind"):
    """Something that happens at a time, at a stop, or at a place; `kind` says what."""

    start_s: NotNegative | None = None
    """Time of the ride,"""
    start_m: NotNegative | None = None
    """or arc length at which it begins,"""
    stop: Annotated[int, Meta(ge=1)] | None = None
    """or number of the stop (1 is the first) with whose standing still it begins."""
    after_s: float = 0.0
    """Begins so much after that."""
    duration_s: Positive | None = None
    """How long it lasts,"""
    end_m: NotNegative | None = None
    """or arc length at which it ends; at a stop, if neither is given, with the departure."""

    def __post_init__(self) -> None:
        if sum(each is not None for each in (self.start_s, self.start_m, self.stop)) != 1:
            raise ValueError("an event begins at one of `start_s`, `start_m` and `stop`")
        ends = sum(each is not None for each in (self.duration_s, self.end_m))
        if ends > 1 or (ends == 0 and self.stop is None):
            raise ValueError("an event ends by one of `duration_s` and `end_m`")


class GnssJump(Event, frozen=True, kw_only=True, tag="gnss_jump"):
    """Fixes jump away, and back at the end."""

    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0


class GnssDrift(Event, frozen=True, kw_only=True, tag="gnss_drift"):
    """Fixes wander off evenly, and come back evenly within `recovery_s`."""

    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0
    recovery_s: Positive = 5.0
    velocity: bool = False
    """Whether the velocity in the fixes goes with them, as a spoofer's does."""


class Tunnel(Event, frozen=True, kw_only=True, tag="tunnel"):
    """No fix."""


class Slip(Event, frozen=True, kw_only=True, tag="slip"):
    """Wheels turn faster than the vehicle moves: by a factor, or by a speed."""

    wheels: tuple[Side, ...] = SIDES
    factor: NotNegative | None = None
    """Speed of the wheel over that of the vehicle."""
    speed_error_mps: float | None = None
    """In the direction of travel; one of the two must be given."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.factor is None) == (self.speed_error_mps is None):
            raise ValueError("wheels slip or slide by one of `factor` and `speed_error_mps`")


class Slide(Slip, frozen=True, kw_only=True, tag="slide"):
    """Wheels turn more slowly than the vehicle moves, or not at all."""


# Faults of sensors -------------------------------------------------------------------------------
class Fault(Event, frozen=True, kw_only=True):
    """What a sensor's messages say is not what the sensor measured."""


class ImuStuck(Fault, frozen=True, kw_only=True, tag="imu_stuck"):
    """Axes repeat what they read last; of all axes, the IMU repeats itself."""

    axes: tuple[Axis, ...] = AXES


class ImuDead(Fault, frozen=True, kw_only=True, tag="imu_dead"):
    """Axes read 0."""

    axes: tuple[Axis, ...] = AXES


class ImuSaturated(Fault, frozen=True, kw_only=True, tag="imu_saturated"):
    """Axes read the end of their range."""

    axes: tuple[Axis, ...] = ("gyro_z",)
    counts: int = 32767
    """That end; below 0 for the other one."""


class ImuMoved(Fault, frozen=True, kw_only=True, tag="imu_moved"):
    """The IMU's case is turned in the vehicle, all at once: its gyroscopes do not feel that."""

    turned_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation vector about the axes of the case."""


class ImuLost(Fault, frozen=True, kw_only=True, tag="imu_lost"):
    """Samples get lost between sensor and record."""

    straight: bool = False
    """The logger draws straight lines between what it has, and says nothing of it."""


class GnssFrozen(Fault, frozen=True, kw_only=True, tag="gnss_frozen"):
    """The receiver repeats its last fix, with new times, and calls it valid."""

    velocity: Literal["kept", "zero", "absent"] = "absent"
    """What becomes of the velocity in it."""


class GnssHold(Fault, frozen=True, kw_only=True, tag="gnss_hold"):
    """Static hold: while the receiver sees less than `below_mps` it repeats the place, speed 0."""

    below_mps: Positive = 1.0


class GnssStated(Fault, frozen=True, kw_only=True, tag="gnss_stated"):
    """The receiver states deviations that are so many times what it stated before."""

    factor: Positive = 0.1


class GnssRateLost(Fault, frozen=True, kw_only=True, tag="gnss_lost"):
    """Fixes get lost between receiver and record, but for one in `keeps`."""

    keeps: Annotated[int, Meta(ge=0)] = 0
    """0: none is kept."""


class GnssJammed(Fault, frozen=True, kw_only=True, tag="gnss_jammed"):
    """A jammer nearby: fewer satellites, and errors that nobody states."""

    std_m: NotNegative = 10.0
    """Of the additional error, per axis; it lasts for some seconds."""
    satellites: Annotated[int, Meta(ge=0)] = 5
    """That are left; with less than 4 there is no fix."""
    stated_factor: Positive = 1.0
    """What is stated over what was stated before."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Of the error."""


class WheelsFrozen(Fault, frozen=True, kw_only=True, tag="wheels_frozen"):
    """Wheels stop telling how they turn; what was not counted is not made up for afterwards."""

    wheels: tuple[Side, ...] = SIDES
    holds: Literal["count", "speed"] = "count"
    """The count stays (a torn wire), or goes on as fast as in the reading before (a gateway that
    repeats its last speed)."""


class ClockOff(Fault, frozen=True, kw_only=True, tag="clock_off"):
    """Stamps of a sensor are off."""

    sensor: Sensor
    offset_s: float
    """Later than the truth by so much."""


AnyEvent = (
    GnssJump
    | GnssDrift
    | Tunnel
    | Slip
    | Slide
    | ImuStuck
    | ImuDead
    | ImuSaturated
    | ImuMoved
    | ImuLost
    | GnssFrozen
    | GnssHold
    | GnssStated
    | GnssRateLost
    | GnssJammed
    | WheelsFrozen
    | ClockOff
)
