"""Settings of the section `[segments]`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from tramstream.config import FilePath, NotNegative, Positive, Struct


class Area(Struct, frozen=True, kw_only=True):
    """A circle on the map whose borders are told when they are passed."""

    latitude_deg: Annotated[float, Meta(ge=-90, le=90)] = 0.0
    """Of the middle."""
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    """Of the middle."""
    radius_m: Positive = 50.0
    """From the middle to the border."""


class SegmentsSettings(Struct, frozen=True, kw_only=True):
    """Stops, turns and the place on a line, by inertial data and wheels alone."""

    mounting: Literal["auto", "calibrated", "own"] = "auto"
    """How the IMU lies in the vehicle. calibrated: as `[imu]` says. own: found on the run, at the
    first stand and departure. auto: as `[imu]` says, unless gravity contradicts it."""
    wheels: bool = True
    """Whether wheels and doors are looked at where there are any."""
    least_turn_deg: NotNegative = 5.0
    """Turns of less are not told."""
    lines: tuple[str, ...] = ()
    """Lines that the vehicle may be on, as the network calls them ("7", or "7/0" for one
    direction); empty: all of them. Without a section [map] that has lines, and without
    `signatures`, no place is looked for."""
    signatures: tuple[FilePath, ...] = ()
    """Files of lines that `tramstream learn-line` has made of rides."""
    scale_std: Positive = 0.03
    """How well the wheels' way is known where no place has told it yet, as a part of it. Both
    sides of it are looked at up to three times that."""
    heading_noise: Positive = 1.0
    """How far a line's headings may be off its rails, in times what maps and rides show."""
    areas: dict[str, Area] = field(default_factory=dict)
    """Places whose borders are told when they are passed, one section each; the name is free."""
