"""Records aligned: each read, cut into rides, and the rides of one vehicle put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tramstream.analysis.mounting.align import Answer, Ride, align_ride, answer
from tramstream.analysis.mounting.checks import sensor_troubles
from tramstream.analysis.mounting.known import Settings
from tramstream.analysis.mounting.read import drives_of
from tramstream.config import Vehicle
from tramstream.recorder.reader import Record
from tramstream.recorder.reprocess.run import vehicle_of


def align(
    records: Sequence[tuple[Path, Record]],
    settings: Settings,
    vehicle: Vehicle | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Answer:
    """Find the mounting out of records of one vehicle.

    Parameters
    ----------
    records : sequence
        Paths and opened records.
    settings : Settings
    vehicle : Vehicle, optional
        Instead of the configuration that each record holds.
    say : callable
        Told what is being done.
    """
    rides: list[Ride] = []
    troubles: list[str] = []
    for path, record in records:
        say(f"{path.name}: reading")
        known = vehicle or vehicle_of(record, path)
        drives, readings = drives_of(record, known)
        if readings is None:
            troubles.append(f"{path.name}: there are no inertial samples")
            continue
        troubles += [f"{path.name}: {each}" for each in sensor_troubles(readings)]
        for number, drive in enumerate(drives, 1):
            name = path.name if len(drives) == 1 else f"{path.name}, part {number}"
            say(f"{name}: aligning {drive.duration_s:.0f} s")
            rides.append(align_ride(name, drive, known, settings))
        if not drives:
            troubles.append(f"{path.name}: no ride of a minute without a gap")
    return answer(rides, troubles)
