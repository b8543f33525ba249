"""Columns of tables as messages, one kind of table after another."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from tramstream import keys
from tramstream.analysis.tables import columns, imu
from tramstream.analysis.tables.columns import Mask, Placed
from tramstream.analysis.tables.mapping import GnssTable, ImuTable, OdometryTable, TruthTable
from tramstream.analysis.tables.reader import Array
from tramstream.bridges.gnss import messages
from tramstream.bridges.gnss.clock import MS, WEEK_NS, leap_seconds_on
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Gnss, Vehicle
from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.keys import Key
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry, TruthState, WheelReading

UNKNOWN_SPEED_STD_MPS = 1000.0
"""Of a fix without a velocity: nobody shall take its zero for a standstill."""


class Row(NamedTuple):
    """A message, when it was true, and when it came."""

    key: Key
    message: Any
    stamp_ns: int
    arrival_ns: int


def _now(key: Key, message: Any, stamp_ns: int) -> Row:
    return Row(key, message, stamp_ns, stamp_ns)


def inertial(
    placed: Placed, table: ImuTable, vehicle: Vehicle
) -> tuple[list[Row], dict[str, float]]:
    """Batches, and what there is to tell of them."""
    if vehicle.imu is None:
        raise ConfigError(
            f"$.vehicle.imu: missing; {placed.place} is an IMU's: its rate, mounting and noise "
            "are wanted"
        )
    made, rate_hz, jitter_s = imu.batches(placed.content, placed.stamps, table, vehicle.imu)
    rows = []
    for batch in made:
        last_ns = batch.stamp_ns + round(batch.period_ns * (len(batch.gyro_x) - 1))
        rows.append(Row(keys.IMU_BATCH, batch, batch.stamp_ns, last_ns))
    return rows, {"batches": len(made), "rate_hz": rate_hz, "jitter_s": jitter_s}


def fixes(
    placed: Placed, table: GnssTable, level: LocalLevel | None, gnss: Gnss | None
) -> list[GnssFix]:
    """Every row of the table as a fix."""
    content = placed.content
    positions = columns.geodetic(placed, table.position, level)
    degrees = np.degrees(positions[:, :2]).tolist()
    horizontal_m = columns.spread_m(content, table.horizontal_std)
    vertical_m = columns.quantity(content, table.vertical_std)
    valid, fixed, floating = columns.grades(content, table.quality)
    if gnss is not None:
        valid &= horizontal_m <= gnss.max_accuracy_m
    carriers = np.where(fixed, GnssFix.FIXED, np.where(floating, GnssFix.FLOAT, GnssFix.NONE))
    made = []
    for index, stamp_ns in enumerate(placed.stamps.tolist()):
        fix = GnssFix(
            stamp_ns=stamp_ns,
            source=content.path.name,
            fix_type=GnssFix.FIX_3D if valid[index] else GnssFix.NO_FIX,
            valid=bool(valid[index]),
            carrier=int(carriers[index]),  # type: ignore[arg-type]
            latitude_deg=degrees[index][0],
            longitude_deg=degrees[index][1],
            height_ellipsoid_m=float(positions[index, 2]),
            horizontal_std_m=float(horizontal_m[index]),
            vertical_std_m=float(vertical_m[index]),
            speed_std_mps=UNKNOWN_SPEED_STD_MPS,
            course_std_deg=180.0,
        )
        if placed.clock.kind != "relative":
            fix.gps_time_ns = stamp_ns - GPS_EPOCH_UNIX_S * S
            fix.itow_ms = fix.gps_time_ns % WEEK_NS // MS
            fix.utc_ns = stamp_ns - leap_seconds_on(stamp_ns) * S
        made.append(fix)
    if table.satellites is not None:
        for fix, count in zip(made, content.numbers[table.satellites].tolist(), strict=True):
            fix.satellites_used = max(0, round(count))
    if table.velocity is not None:
        _add_velocity(made, columns.velocity_l(content, table.velocity), placed, table)
    return made


def _add_velocity(made: list[GnssFix], v_l: Array, placed: Placed, table: GnssTable) -> None:
    speed = np.hypot(v_l[:, 0], v_l[:, 1])
    course = np.degrees(np.arctan2(v_l[:, 0], v_l[:, 1])) % 360.0
    std: Array = np.zeros(len(made))
    if table.speed_std is not None:
        std = columns.quantity(placed.content, table.speed_std)
    course_std = np.degrees(np.arctan2(std, speed))
    for index, fix in enumerate(made):
        if v_l.shape[1] == 3:  # a course does not tell how fast it rises
            fix.vel_e_mps, fix.vel_n_mps, up_mps = v_l[index].tolist()
            fix.vel_d_mps = 0.0 - up_mps
        fix.speed_mps, fix.speed_std_mps = float(speed[index]), float(std[index])
        fix.course_deg, fix.course_std_deg = float(course[index]), float(course_std[index])


def positioning(found: list[GnssFix], given: Mask, keep_as_truth: bool) -> list[Row]:
    """Fixes for the filter; those withheld from it are what it is judged by."""
    made = []
    for fix, used in zip(found, given.tolist(), strict=True):
        if used:
            made.append(_now(keys.GNSS_FIX, fix, fix.stamp_ns))
            made.append(_now(keys.GNSS_LOCATION, messages.location(fix), fix.stamp_ns))
        elif keep_as_truth and fix.valid:
            state = TruthState(
                stamp_ns=fix.stamp_ns,
                latitude_deg=fix.latitude_deg,
                longitude_deg=fix.longitude_deg,
                height_ellipsoid_m=fix.height_ellipsoid_m,
                position_std_m=fix.horizontal_std_m / sqrt(2.0),
            )
            made.append(_now(keys.TRUTH_STATE, state, fix.stamp_ns))
    return made


def odometry(placed: Placed, table: OdometryTable) -> list[Row]:
    """Every row as one reading of the wheels."""
    content = placed.content
    wheels = {name: columns.quantity(content, wheel) for name, wheel in table.wheels.items()}
    for name, wheel in table.wheels.items():
        if wheel.unit == "pulses":
            wheels[name] = np.cumsum(wheels[name])
    counting = {name: "pulses" in wheel.unit for name, wheel in table.wheels.items()}
    yaw_rate = columns.quantity(content, table.yaw_rate) if table.yaw_rate else None
    force = columns.quantity(content, table.motor_force) if table.motor_force else None
    doors = content.numbers[table.doors_open] if table.doors_open is not None else None
    made = []
    for index, stamp_ns in enumerate(placed.stamps.tolist()):
        message = Odometry(stamp_ns=stamp_ns)
        for name, values in wheels.items():
            value = float(values[index])
            message.wheels.append(
                WheelReading(wheel=name, pulses=round(value))
                if counting[name]
                else WheelReading(wheel=name, speed_mps=value)
            )
        if yaw_rate is not None:
            message.yaw_rate_radps = float(yaw_rate[index])
        if force is not None:
            message.motor_force_n = float(force[index])
        if doors is not None:
            message.doors_open = bool(doors[index])
        made.append(_now(keys.ODO_WHEELS, message, stamp_ns))
    return made


def truth(placed: Placed, table: TruthTable, level: LocalLevel | None) -> list[Row]:
    """Every row as a state, of which is present what the table knows."""
    content = placed.content
    positions = columns.geodetic(placed, table.position, level)
    optional: dict[str, Array] = {}
    for name, wanted in {
        "speed_mps": table.speed,
        "acceleration_mps2": table.acceleration,
        "yaw_rate_radps": table.yaw_rate,
        "arc_length_m": table.arc_length,
    }.items():
        if wanted is not None:
            optional[name] = columns.quantity(content, wanted)
    if table.position_std is not None:
        optional["position_std_m"] = columns.spread_m(content, table.position_std) / sqrt(2.0)
    if table.attitude is not None:
        roll, pitch, optional["yaw_rad"] = columns.attitude_rad(content, table.attitude)
        if len(roll):
            optional |= {"roll_rad": roll, "pitch_rad": pitch}
    degrees = np.degrees(positions[:, :2]).tolist()
    made = []
    for index, stamp_ns in enumerate(placed.stamps.tolist()):
        state = TruthState(
            stamp_ns=stamp_ns,
            latitude_deg=degrees[index][0],
            longitude_deg=degrees[index][1],
            height_ellipsoid_m=float(positions[index, 2]),
        )
        for name, values in optional.items():
            setattr(state, name, float(values[index]))
        made.append(_now(keys.TRUTH_STATE, state, stamp_ns))
    return made
