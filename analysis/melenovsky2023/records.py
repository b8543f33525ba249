"""The work's two stages on a record: its initial estimate, and its filter from there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tramstream.analysis.melenovsky2023 import iekf
from tramstream.analysis.melenovsky2023.initial import Initial, initial
from tramstream.analysis.mounting.drive import Array, Drive
from tramstream.analysis.mounting.known import Settings, known_of
from tramstream.analysis.mounting.read import drives_of
from tramstream.config import Vehicle
from tramstream.recorder.reader import Record
from tramstream.recorder.reprocess.run import vehicle_of

AFTER_INITIAL_RAD = math.radians(1.0)
"""How well the work's filter takes a good first estimate to be."""


class Estimate(NamedTuple):
    """What both stages say of one ride."""

    name: str
    initial: Initial
    psi_rad: Array
    """(3,): roll, pitch, yaw of the case by the filter; NaN where it did not run."""
    std_rad: Array
    """(3,): its own deviations, of the Euler angles."""
    trouble: str


def estimates(
    records: Sequence[tuple[Path, Record]], vehicle: Vehicle | None = None
) -> Iterator[Estimate]:
    """Estimate each ride of records by itself: the work does not put rides together."""
    for path, record in records:
        known = vehicle or vehicle_of(record, path)
        drives, _ = drives_of(record, known)
        for number, drive in enumerate(drives, 1):
            name = path.name if len(drives) == 1 else f"{path.name}, part {number}"
            yield estimate(name, drive, known)


def estimate(name: str, drive: Drive, vehicle: Vehicle) -> Estimate:
    """Run both stages on one ride."""
    nothing = np.full(3, np.nan)
    told = drive.fixes.vel_l[:, 0]
    if not len(told) or not np.isfinite(told).all():
        begun = Initial(np.nan, np.nan, np.nan, 0, 0)
        return Estimate(name, begun, nothing, nothing, "the work wants fixes with velocity")
    begun = initial(drive)
    psi = np.array([begun.roll_rad, begun.pitch_rad, begun.yaw_rad])
    if not np.all(np.isfinite(psi)):
        trouble = "no stand, or no straight braking: the initial estimate has no samples"
        return Estimate(name, begun, nothing, nothing, trouble)
    noise = known_of(vehicle, drive, Settings()).noise
    sensors = iekf.Sensors(
        float(noise.accel.max()), float(noise.gyro.max()), noise.accel_walk, noise.gyro_walk
    )
    course = iekf.run(drive, psi, sensors, iekf.Tuning(mounting_rad=AFTER_INITIAL_RAD))
    return Estimate(name, begun, course.psi_rad[-1], course.psi_std_rad[-1], "")
