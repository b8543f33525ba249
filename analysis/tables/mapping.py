"""Mapping files: what the columns of somebody's tables mean (docs/import-tables.md).

A mapping is TOML. Its structs are read as strictly as a vehicle's configuration; units are checked
here, so that whoever reads a table finds only known ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from tramstream.analysis.tables.units import UNITS, Clock, instant_ns
from tramstream.config import Number, Positive, Struct, Vector, Vehicle
from tramstream.errors import ConfigError
from tramstream.input_file import TEXT_LIMIT_BYTES, read_limited
from tramstream.strict_toml import decode_toml

Column = str | int
"""A column by its name in the header, or by its place, the first being 0."""
Value = str | float
"""What a cell is compared with: text as it stands, a number as a number."""


class Time(Struct, frozen=True, kw_only=True):
    """The column that tells when a row was true."""

    column: Column | tuple[Column, ...]
    """Several (a date, a time of day) are joined by a blank."""
    unit: Literal["s", "ms", "us", "ns", "datetime"]
    offset_s: Number = 0.0
    """Added to every stamp: negative where the table's stamps are late."""


class Quantity(Struct, frozen=True, kw_only=True):
    """One figure a row, or one that the table does not have and everybody knows."""

    column: Column | None = None
    value: Number | None = None
    unit: str
    dimension: ClassVar[str]


class Length(Quantity, frozen=True, kw_only=True):
    dimension = "length"


class Speed(Quantity, frozen=True, kw_only=True):
    dimension = "speed"


class Acceleration(Quantity, frozen=True, kw_only=True):
    dimension = "acceleration"


class TurnRate(Quantity, frozen=True, kw_only=True):
    dimension = "turn rate"


class Force(Quantity, frozen=True, kw_only=True):
    dimension = "force"


class Temperature(Quantity, frozen=True, kw_only=True):
    dimension = "temperature"


class WheelColumn(Quantity, frozen=True, kw_only=True):
    """A speed, the pulses since the row before, or a total that never wraps."""

    dimension = "wheel"


class Spread(Struct, frozen=True, kw_only=True):
    """A horizontal deviation: one figure for the distance (u-blox's hAcc), two for the axes."""

    columns: Annotated[tuple[Column, ...], Meta(max_length=2)] = ()
    values: Annotated[tuple[Positive, ...], Meta(max_length=2)] = ()
    unit: str
    dimension: ClassVar[str] = "length"


class Position(Struct, frozen=True, kw_only=True):
    """Where something was."""

    frame: Literal["geodetic", "ecef", "enu", "ned"]
    """geodetic: latitude, longitude, ellipsoidal height. enu, ned: level at the origin."""
    columns: Annotated[tuple[Column, ...], Meta(min_length=2, max_length=3)]
    unit: str
    """Of latitude and longitude if geodetic, else of all three."""
    height_unit: str = "m"
    height_m: float | None = None
    """Of every row, where a geodetic table has but two columns."""


class Velocity(Struct, frozen=True, kw_only=True):
    """How the antenna moved."""

    frame: Literal["enu", "ned", "course"]
    """course: speed over ground, and its direction clockwise from north."""
    columns: Annotated[tuple[Column, ...], Meta(min_length=2, max_length=3)]
    unit: str
    course_unit: str = "deg"


class Axes(Struct, frozen=True, kw_only=True):
    """x, y, z of a sensor, along its own case."""

    columns: tuple[Column, Column, Column]
    unit: str
    dimension: ClassVar[str]


class TurnRates(Axes, frozen=True, kw_only=True):
    dimension = "turn rate"


class SpecificForce(Axes, frozen=True, kw_only=True):
    dimension = "acceleration"


class Attitude(Struct, frozen=True, kw_only=True):
    """Roll, pitch, yaw of the vehicle, or one column with its yaw alone."""

    convention: Literal["flu", "frd"]
    """flu: ours (docs/theory.md, section 1.2: nose down is positive pitch, yaw counter-clockwise
    from east). frd: as in aviation (nose up is positive pitch, heading clockwise from north)."""
    columns: Annotated[tuple[Column, ...], Meta(min_length=1, max_length=3)]
    unit: str
    dimension: ClassVar[str] = "angle"


class Quality(Struct, frozen=True, kw_only=True):
    """A column that grades fixes; what is in none of the lists is not valid."""

    column: Column
    valid: tuple[Value, ...] = ()
    fixed: tuple[Value, ...] = ()
    float_: tuple[Value, ...] = msgspec.field(default=(), name="float")


class Rows(Struct, frozen=True, kw_only=True):
    """The rows that belong to this table, where a file mixes several kinds."""

    column: Column
    equals: Value


class Table(Struct, frozen=True, kw_only=True):
    """A file of rows in the order of time, and what all kinds of tables share."""

    file: str
    delimiter: Literal[",", ";", "tab", "whitespace"] = ","
    header: bool = True
    """Whether the first row names the columns."""
    comment: str = ""
    """Lines that begin with it are left out."""
    rows: Rows | None = None
    time: Time
    clock: Clock | None = None
    """Of this table; else the mapping's."""


class ImuTable(Table, frozen=True, kw_only=True, tag_field="kind", tag="imu"):
    """Turn rates and specific force."""

    gyro: TurnRates
    accel: SpecificForce
    temperature: Temperature | None = None


class GnssTable(Table, frozen=True, kw_only=True, tag_field="kind", tag="gnss"):
    """Fixes."""

    position: Position
    horizontal_std: Spread
    vertical_std: Length
    velocity: Velocity | None = None
    speed_std: Speed | None = None
    quality: Quality | None = None
    """Without it every row is a valid fix."""
    satellites: Column | None = None
    every_s: Positive | None = None
    """Keep the fixes nearest to the multiples of this; all others are withheld."""
    cuts: tuple[tuple[float, float], ...] = ()
    """Begin and end, after the drive's first row: fixes in between are withheld."""
    withheld: Literal["drop", "truth"] = "drop"


class OdometryTable(Table, frozen=True, kw_only=True, tag_field="kind", tag="odometry"):
    """Wheels and what else a vehicle's bus tells."""

    wheels: Annotated[dict[str, WheelColumn], Meta(min_length=1)]
    yaw_rate: TurnRate | None = None
    """Left positive."""
    motor_force: Force | None = None
    doors_open: Column | None = None
    """0 or 1."""


class TruthTable(Table, frozen=True, kw_only=True, tag_field="kind", tag="truth"):
    """What a reference says of the vehicle's origin."""

    position: Position
    position_std: Spread | None = None
    speed: Speed | None = None
    acceleration: Acceleration | None = None
    yaw_rate: TurnRate | None = None
    attitude: Attitude | None = None
    arc_length: Length | None = None


class Origin(Struct, frozen=True, kw_only=True):
    """Where east, north and up, or north, east and down, are counted from."""

    latitude_deg: float | None = None
    longitude_deg: float | None = None
    height_m: float | None = None
    ecef_m: Vector | None = None
    first: Literal["truth", "gnss"] | None = None
    """The first row of the first such table."""


AnyTable = ImuTable | GnssTable | OdometryTable | TruthTable


class Mapping(Struct, frozen=True, kw_only=True):
    """A whole mapping file."""

    clock: Clock | None = None
    origin: Origin | None = None
    tables: Annotated[tuple[AnyTable, ...], Meta(min_length=1)]
    vehicle: Vehicle | None = None
    """Goes into the record, for those who process it."""


def load(path: Path) -> Mapping:
    """Read a mapping file.

    Raises
    ------
    ConfigError
        One sentence with the file, the path of the field and the cure.
    """
    try:
        data = read_limited(path, TEXT_LIMIT_BYTES)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot read the mapping ({error.strerror}); docs/import-tables.md shows one"
        ) from error
    mapping = decode_toml(data, Mapping, str(path))
    try:
        _check_origin(mapping)
        if mapping.clock is not None:
            _check_clock(mapping.clock, "$.clock")
        for index, table in enumerate(mapping.tables):
            if mapping.clock is None and table.clock is None:
                raise ValueError(
                    f"$.tables[{index}].clock: missing; say what its time counts from, here or "
                    "for all tables in $.clock"
                )
            for place, item in parts(table, f"$.tables[{index}]"):
                _check(item, place)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    return mapping


def parts(item: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Every struct in `item`, itself included, with its path."""
    if isinstance(item, msgspec.Struct):
        yield place, item
        for field in msgspec.structs.fields(item):
            yield from parts(getattr(item, field.name), f"{place}.{field.encode_name}")
    elif isinstance(item, dict):
        for name, value in item.items():
            yield from parts(value, f"{place}.{name}")


def _check(item: Any, place: str) -> None:
    """Raise ValueError for what the types alone let pass."""
    if isinstance(item, Clock):
        _check_clock(item, place)
    if isinstance(item, Quantity) and (item.column is None) == (item.value is None):
        raise ValueError(f"{place}: give either a column or a value")
    if isinstance(item, Spread) and bool(item.columns) == bool(item.values):
        raise ValueError(f"{place}: give either columns or values")
    if isinstance(item, Quantity | Spread | Axes | Attitude):
        _check_unit(item.unit, item.dimension, f"{place}.unit")
    elif isinstance(item, Position):
        geodetic = item.frame == "geodetic"
        _check_unit(item.unit, "angle" if geodetic else "length", f"{place}.unit")
        _check_unit(item.height_unit, "length", f"{place}.height_unit")
        if (len(item.columns) == 2) != (item.height_m is not None) or not (
            geodetic or len(item.columns) == 3
        ):
            raise ValueError(
                f"{place}.columns: give three, or of a geodetic position two and height_m"
            )
    elif isinstance(item, Velocity):
        _check_unit(item.unit, "speed", f"{place}.unit")
        _check_unit(item.course_unit, "angle", f"{place}.course_unit")
        if len(item.columns) != (2 if item.frame == "course" else 3):
            raise ValueError(f"{place}.columns: give three, or two in the frame course")
    if isinstance(item, Attitude) and len(item.columns) == 2:
        raise ValueError(f"{place}.columns: give roll, pitch and yaw, or yaw alone")
    if isinstance(item, GnssTable) and any(end <= start for start, end in item.cuts):
        raise ValueError(f"{place}.cuts: each must end after it starts")


def _check_unit(unit: str, dimension: str, place: str) -> None:
    if unit not in UNITS[dimension]:
        article = "an" if dimension[0] in "aeiou" else "a"
        raise ValueError(
            f"{place}: {unit!r} is not the unit of {article} {dimension}; "
            f"there are: {', '.join(UNITS[dimension])}"
        )


def _check_clock(clock: Clock, place: str) -> None:
    if clock.kind == "gps_week" and (clock.week is None) == (not clock.date):
        raise ValueError(f"{place}: gps_week needs either a week or a date in it")
    if clock.kind == "relative" and not clock.start:
        raise ValueError(f"{place}.start: missing; what shall the record call second zero?")
    for name in ("date", "start"):
        text = getattr(clock, name)
        if text and instant_ns(text) is None:
            raise ValueError(f"{place}.{name}: {text!r} is no date; write 2025-07-08T19:34:00")


def _check_origin(mapping: Mapping) -> None:
    origin = mapping.origin
    frames = {getattr(getattr(t, "position", None), "frame", "") for t in mapping.tables}
    if origin is None:
        if frames & {"enu", "ned"}:
            raise ValueError("$.origin: missing; positions in enu or ned are counted from it")
        return
    geodetic = (origin.latitude_deg, origin.longitude_deg, origin.height_m)
    ways = [None not in geodetic, origin.ecef_m is not None, origin.first is not None]
    if sum(ways) != 1 or (not ways[0] and geodetic != (None, None, None)):
        raise ValueError(
            "$.origin: give latitude_deg, longitude_deg and height_m, or ecef_m, or first"
        )
