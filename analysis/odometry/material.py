"""What a record says of a ride by its raw readings, as columns: IMU, wheels, fixes.

The readings are those of the devices (`raw/…`), not those that a filter was given: a clock that is
seconds off would have lost them there. Inertial samples are brought to twenty means a second, each
at the mean instant of its samples; the mean of a rate, added up, is the angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.calibration.inertial import inertial_samples
from tramstream.clock import S
from tramstream.config import Gnss, Vehicle
from tramstream.estimation.fixes import antenna_l, deviations, place_deg, unusable, velocity_l
from tramstream.geodesy import LocalLevel
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.recorder.identity import identity_of
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import vehicle_of

Array = NDArray[np.float64]

MEAN_S = 0.05
"""Inertial samples are averaged over so long: a tram moves slowly, and a delay shows all the
same."""
STUCK_S = 2.0
"""An axis whose means do not change for longer is stuck: a sensor that lives is never so quiet."""
PULSES = 1 << 34
"""A counter that falls by more does not know what was between (`WheelReading.pulses`)."""
UNSTATED_STD_MPS = 0.5
"""Deviation of a velocity whose receiver states none."""
AXES = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z")


@dataclass(frozen=True)
class Inertial:
    """Means of the IMU, in the axes of its case."""

    time_s: Array
    """Since `Ride.origin_ns`."""
    rate_radps: Array
    """(n, 3)."""
    force_mps2: Array
    """(n, 3)."""
    trouble: tuple[str, ...] = ()
    """Axes that are stuck or dead, by name."""


@dataclass(frozen=True)
class WheelWay:
    """What one wheel has counted, m by the configured constants."""

    name: str
    time_s: Array
    """Arrival of each reading, the configured delay taken off."""
    way_m: Array
    left_m: float
    """How far left of the middle it stands."""
    m_per_pulse: float
    """By which pulses were turned into metres; 0 where the bus gives a speed."""


@dataclass(frozen=True)
class FixColumns:
    """Valid fixes in the local level at the first of them."""

    time_s: Array
    p_l: Array
    """(n, 3), m."""
    velocity_l: NDArray[np.complex128]
    """East and north, m/s; NaN where the receiver gives none."""
    std_m: Array
    """Horizontal, as stated, per axis."""
    up_std_m: Array
    speed_std_mps: Array


@dataclass(frozen=True)
class Ride:
    """A record for calibration."""

    vehicle: Vehicle
    name: str
    """Of the vehicle."""
    origin_ns: int
    duration_s: float
    digest: str
    imu: Inertial
    wheels: tuple[WheelWay, ...]
    fixes: FixColumns
    damaged: str = ""
    left_out: str = ""


def read_ride(paths: Path | Sequence[Path], vehicle: Vehicle | None = None) -> Ride:
    """Read a record: a file, a folder with the parts of one, or the parts.

    Parameters
    ----------
    paths : Path or sequence of Path
    vehicle : Vehicle, optional
        Configuration; by default that of the record.

    Raises
    ------
    RecordError
        If it is no record.
    ConfigError
        If there is no configuration.
    """
    with open_record(paths) as record:
        first = paths if isinstance(paths, Path) else paths[0]
        known = vehicle if vehicle is not None else vehicle_of(record, first)
        origin_ns = record.start_ns
        imu = _inertial(record, origin_ns)
        wheels, fixes = _others(record, known, origin_ns)
        return Ride(
            vehicle=known,
            name=record.vehicle or known.vehicle,
            origin_ns=origin_ns,
            duration_s=(record.end_ns - record.start_ns) / S,
            digest=identity_of(record),
            imu=imu,
            wheels=wheels,
            fixes=fixes,
            damaged=record.damaged,
            left_out=record.left_out,
        )


# IMU ----------------------------------------------------------------------------------------------
def _inertial(record: Record, origin_ns: int) -> Inertial:
    """Means of all inertial samples; a mean that two blocks share is put together again."""
    numbers, sums = [], []
    for samples in inertial_samples(record):
        count = int(samples.length.sum())
        if not count:
            continue
        message = np.repeat(np.arange(len(samples.length)), samples.length)
        within = np.arange(count) - np.repeat(
            np.cumsum(samples.length) - samples.length, samples.length
        )
        start_s = (samples.stamp_ns - origin_ns) / S
        time_s = start_s[message] + within * samples.period_ns[message] / S
        number = np.floor(time_s / MEAN_S).astype(np.int64)
        first = int(number.min())
        columns = [np.ones(count), time_s]
        scales = (samples.gyro_scale_radps, samples.accel_scale_mps2)
        columns += [samples.counts[k, :count] * scales[k // 3][message] for k in range(6)]
        at = number - first
        size = int(at.max()) + 1
        total = np.stack([np.bincount(at, each, size) for each in columns])
        there = total[0] > 0
        numbers.append(np.flatnonzero(there) + first)
        sums.append(total[:, there])
    if not numbers:
        nothing = np.empty((0, 3))
        return Inertial(np.empty(0), nothing, nothing)
    every, place = np.unique(np.concatenate(numbers), return_inverse=True)
    together = np.concatenate(sums, axis=1)
    total = np.stack([np.bincount(place, row, len(every)) for row in together])
    mean = total[1:] / total[0]
    force, rate = mean[4:7].T.copy(), mean[1:4].T.copy()
    return Inertial(mean[0], rate, force, _stuck(np.concatenate([rate, force], axis=1)))


def _stuck(values: Array) -> tuple[str, ...]:
    """Axes that read one and the same number for long."""
    length = round(STUCK_S / MEAN_S)
    found = []
    for axis, name in enumerate(AXES):
        column = values[:, axis]
        same = np.abs(np.diff(column)) <= 1e-12 * np.maximum(np.abs(column[1:]), 1e-9)
        run = np.convolve(same, np.ones(length), "valid") if len(same) >= length else np.zeros(1)
        if run.max() > length - 0.5:
            found.append(name)
    return tuple(found)


# Wheels and fixes ---------------------------------------------------------------------------------
@dataclass
class _Wheel:
    """Readings of one wheel while they are read."""

    time_s: list[float] = field(default_factory=list)
    way_m: list[float] = field(default_factory=list)
    pulses: int | None = None
    speed: bool = False


def _others(
    record: Record, vehicle: Vehicle, origin_ns: int
) -> tuple[tuple[WheelWay, ...], FixColumns]:
    types: dict[str, type[Message]] = {
        keys.ODO_WHEELS.path: Odometry,
        keys.GNSS_FIX.path: GnssFix,
    }
    topics = {
        topic
        for topic in record.channels
        if (type_ := types.get(keys.split(topic)[1])) is not None
        and record.type_of(topic) == type_.DESCRIPTOR.full_name
    }
    wheels: dict[str, _Wheel] = {}
    fixes: list[GnssFix] = []
    for _, message in record.decoded(topics.__contains__):
        if isinstance(message, GnssFix):
            if message.valid and unusable(message, None) is None:
                fixes.append(message)
        else:
            time_s = (message.stamp_ns - origin_ns) / S - vehicle.wheels.delay_s
            for reading in message.wheels:
                _read(wheels.setdefault(reading.wheel, _Wheel()), reading, time_s, vehicle)
    return (
        tuple(_way(name, wheel, vehicle) for name, wheel in sorted(wheels.items())),
        _columns(fixes, origin_ns, vehicle.gnss or Gnss(device="")),
    )


def _read(wheel: _Wheel, reading: WheelReading, time_s: float, vehicle: Vehicle) -> None:
    """Add a reading; one that is not newer than the last is left out."""
    if wheel.time_s and time_s <= wheel.time_s[-1]:
        return
    gone = wheel.way_m[-1] if wheel.way_m else 0.0
    if reading.HasField("pulses"):
        pulses: int = reading.pulses
        step = 0 if wheel.pulses is None else pulses - wheel.pulses
        wheel.pulses = pulses
        if abs(step) < PULSES:
            gone += step * vehicle.wheels.m_per_pulse
    elif reading.HasField("speed_mps"):
        wheel.speed = True
        if wheel.time_s:
            gone += reading.speed_mps * (time_s - wheel.time_s[-1])
    else:
        return
    wheel.time_s.append(time_s)
    wheel.way_m.append(gone)


def _way(name: str, wheel: _Wheel, vehicle: Vehicle) -> WheelWay:
    half = 0.5 * vehicle.wheels.track_m
    known = vehicle.odometer.wheels.get(name) if vehicle.odometer is not None else None
    side = known.side if known is not None and known.side else name.lower()
    left_m = half if "left" in side else -half if "right" in side else 0.0
    constant = 0.0 if wheel.speed else vehicle.wheels.m_per_pulse
    return WheelWay(name, np.array(wheel.time_s), np.array(wheel.way_m), left_m, constant)


def _columns(fixes: list[GnssFix], origin_ns: int, gnss: Gnss) -> FixColumns:
    if not fixes:
        nothing = np.empty(0)
        velocity = np.empty(0, dtype=complex)
        return FixColumns(nothing, np.empty((0, 3)), velocity, nothing, nothing, nothing)
    fixes = sorted(fixes, key=lambda each: each.stamp_ns)
    level = LocalLevel.at_deg(*place_deg(fixes[0]))
    std = np.array([deviations(each, gnss.error_floor_m) for each in fixes])
    untold = (np.nan, np.nan)
    velocity = np.array([complex(*(velocity_l(each, level) or untold)) for each in fixes])
    stated = np.array([each.speed_std_mps for each in fixes])
    return FixColumns(
        time_s=np.array([(each.stamp_ns - origin_ns) / S for each in fixes]),
        p_l=np.array([antenna_l(each, level) for each in fixes]),
        velocity_l=velocity,
        std_m=std[:, 0],
        up_std_m=std[:, 1],
        speed_std_mps=np.where(stated > 0.0, stated, UNSTATED_STD_MPS),
    )
