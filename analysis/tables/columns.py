"""Columns of a table in SI and in our frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.tables.mapping import (
    AnyTable,
    Attitude,
    Axes,
    Column,
    GnssTable,
    Mapping,
    OdometryTable,
    Position,
    Quality,
    Quantity,
    Spread,
    Velocity,
    parts,
)
from tramstream.analysis.tables.reader import Array, Content, Stamps, same
from tramstream.analysis.tables.units import UNITS, Clock
from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel, geodetic_from_ecef

Mask = NDArray[np.bool_]

NEAR = 0.75
"""How far from an instant a row may be to stand for it, in usual steps between rows: half of one
if rows were even, more because they are not."""
MAX_HEIGHT_M = 20_000.0
"""Nothing that is imported flies higher: the frame or a unit is wrong."""


@dataclass(frozen=True)
class Placed:
    """A table that has been read, on the record's clock."""

    index: int
    table: AnyTable
    content: Content
    stamps: Stamps
    clock: Clock

    @property
    def place(self) -> str:
        """Where it stands in the mapping."""
        return f"$.tables[{self.index}]"


def number_columns(table: AnyTable) -> list[Column]:
    """Columns in which numbers are wanted."""
    found: list[Column | None] = []
    for _, item in parts(table, ""):
        if isinstance(item, Quantity):
            found.append(item.column)
        elif isinstance(item, Spread | Position | Velocity | Axes | Attitude):
            found += item.columns
    if isinstance(table, GnssTable):
        found.append(table.satellites)
    elif isinstance(table, OdometryTable):
        found.append(table.doors_open)
    return list(dict.fromkeys(column for column in found if column is not None))


def text_columns(table: AnyTable) -> list[Column]:
    """Columns in which words are wanted."""
    return [item.column for _, item in parts(table, "") if isinstance(item, Quality)]


def quantity(content: Content, wanted: Quantity) -> Array:
    """One figure a row, SI."""
    factor = UNITS[wanted.dimension][wanted.unit]
    if wanted.column is not None:
        return content.numbers[wanted.column] * factor
    assert wanted.value is not None  # load() has seen to it
    return np.full(len(content.time_ns), wanted.value * factor)


def spread_m(content: Content, wanted: Spread) -> Array:
    """Deviation of the horizontal distance, as u-blox's hAcc: both axes together."""
    rows = len(content.time_ns)
    sides = [content.numbers[column] for column in wanted.columns] or [
        np.full(rows, value) for value in wanted.values
    ]
    factor = UNITS[wanted.dimension][wanted.unit]
    total: Array = np.abs(sides[0]) if len(sides) == 1 else np.hypot(*sides)
    return total * factor


def columns(content: Content, names: tuple[Column, ...], factor: float) -> Array:
    """Several columns side by side, shape (n, k)."""
    return np.stack([content.numbers[name] for name in names], axis=1) * factor


def geodetic(placed: Placed, position: Position, level: LocalLevel | None) -> Array:
    """Positions as geodetic rows; rad, rad, m.

    Raises
    ------
    ConfigError
        If they are not on Earth.
    """
    content, unit = placed.content, position.unit
    if position.frame == "geodetic":
        angle = UNITS["angle"][unit]
        found = columns(content, position.columns[:2], angle)
        if position.height_m is not None:
            height = np.full((len(found), 1), position.height_m)
        else:
            height = columns(content, position.columns[2:], UNITS["length"][position.height_unit])
        found = np.hstack([found, height])
    else:
        p = columns(content, position.columns, UNITS["length"][unit])
        if position.frame == "ecef":
            found = geodetic_from_ecef(p)
        else:
            assert level is not None  # load() has seen to it
            found = level.to_geodetic(p if position.frame == "enu" else _swapped(p))
    latitude, longitude, height = np.abs(found).max(axis=0)
    if latitude > np.pi / 2 or longitude > 2 * np.pi or height > MAX_HEIGHT_M:
        raise ConfigError(
            f"{content.path}: positions up to {np.degrees(latitude):.5g}°, "
            f"{np.degrees(longitude):.5g}°, {height:.5g} m; are the frame and the units of "
            f"{placed.place}.position right?"
        )
    return found


def velocity_l(content: Content, velocity: Velocity) -> Array:
    """East, north, up, m/s; of a course only the first two, shape (n, 2)."""
    factor = UNITS["speed"][velocity.unit]
    if velocity.frame == "course":
        speed = content.numbers[velocity.columns[0]] * factor
        course = content.numbers[velocity.columns[1]] * UNITS["angle"][velocity.course_unit]
        return np.stack([speed * np.sin(course), speed * np.cos(course)], axis=1)
    v = columns(content, velocity.columns, factor)
    return v if velocity.frame == "enu" else _swapped(v)


def attitude_rad(content: Content, attitude: Attitude) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw of docs/theory.md, section 1.2; of yaw alone the others are empty."""
    angles = columns(content, attitude.columns, UNITS["angle"][attitude.unit])
    yaw = angles[:, -1]
    roll, pitch = (angles[:, 0], angles[:, 1]) if angles.shape[1] == 3 else (yaw[:0], yaw[:0])
    if attitude.convention == "frd":
        pitch, yaw = -pitch, np.pi / 2 - yaw
    return roll, pitch, -np.remainder(np.pi - yaw, 2 * np.pi) + np.pi


def grades(content: Content, quality: Quality | None) -> tuple[Mask, Mask, Mask]:
    """Which fixes are valid, and which have a fixed, which a float carrier phase."""
    rows = len(content.time_ns)
    if quality is None:
        return np.ones(rows, bool), np.zeros(rows, bool), np.zeros(rows, bool)
    cells = content.texts[quality.column]

    def among(values: tuple[str | float, ...]) -> Mask:
        return np.array([any(same(cell, value) for value in values) for cell in cells], bool)

    fixed, floating = among(quality.fixed), among(quality.float_)
    return among(quality.valid) | fixed | floating, fixed, floating


def nearest_to_multiples(stamps: Stamps, every_ns: int) -> Mask:
    """Of each multiple of `every_ns` the row nearest to it, if one is `NEAR` enough."""
    multiple = (stamps + every_ns // 2) // every_ns
    distance = np.abs(stamps - multiple * every_ns)
    order = np.lexsort((distance, multiple))
    nearest = order[np.concatenate(([True], np.diff(multiple[order]) != 0))]
    step_ns = float(np.median(np.diff(stamps))) if len(stamps) > 1 else every_ns
    kept = np.zeros(len(stamps), bool)
    kept[nearest[distance[nearest] <= NEAR * step_ns]] = True
    return kept


def level_of(mapping: Mapping, tables: list[Placed]) -> LocalLevel | None:
    """The frame that enu and ned are counted in; None if the mapping has none.

    Raises
    ------
    ConfigError
        If the table that should tell it is not there, or is itself counted from it.
    """
    origin = mapping.origin
    if origin is None:
        return None
    if origin.ecef_m is not None:
        latitude, longitude, height = geodetic_from_ecef(origin.ecef_m)
        return LocalLevel(float(latitude), float(longitude), float(height))
    if origin.first is None:
        assert None not in (origin.latitude_deg, origin.longitude_deg, origin.height_m)
        return LocalLevel.at_deg(
            float(origin.latitude_deg or 0.0),
            float(origin.longitude_deg or 0.0),
            float(origin.height_m or 0.0),
        )
    for placed in tables:
        tag = placed.table.__struct_config__.tag
        position = getattr(placed.table, "position", None)
        if tag == origin.first and position is not None:
            if position.frame not in ("geodetic", "ecef"):
                raise ConfigError(
                    f"$.origin.first: {placed.place} is itself counted from the origin"
                )
            latitude, longitude, height = geodetic(placed, position, None)[0]
            return LocalLevel(float(latitude), float(longitude), float(height))
    raise ConfigError(f"$.origin.first: there is no table of kind {origin.first!r}")


def _swapped(ned: Array) -> Array:
    """North, east, down as east, north, up."""
    return ned[:, [1, 0, 2]] * (1.0, 1.0, -1.0)
