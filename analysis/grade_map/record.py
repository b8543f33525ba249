"""A record becomes the passes of a ride: smoothed if it has to be, matched, put on the cells.

**No grade is counted twice.** A filter that was held to a map's grades says them again. So a ride
is taken from `est/ekf/smoothed` as it is only where its record says that no grades were in it; else
it is smoothed anew from the measurements over the same network without grades; and where there are
no measurements, it is refused.

**No ride is counted twice.** A record is known by its digest; what `reprocess` made of it carries
the digest of the record that it was made from.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate.source import holds
from tramstream.analysis.grade_map.cells import cells_of
from tramstream.analysis.grade_map.passes import Ride, passes_of
from tramstream.analysis.studies.match_source import estimates_of, utc_offset_ns
from tramstream.config import MATCHER, Map, Vehicle
from tramstream.errors import ConfigError, DamagedRecordError, RecordError
from tramstream.estimation.series import StateSeries
from tramstream.geodesy import LocalLevel
from tramstream.processors.matching.offline import find_path
from tramstream.recorder.columns import read_ride
from tramstream.recorder.identity import identity_of
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import rerun, vehicle_of
from tramstream.tracks.grades import GRADES_ENTRY, NO_GRADES
from tramstream.tracks.network import Network, load


class Refused(NamedTuple):
    """A record that the map does without."""

    name: str
    digest: str
    why: str
    damaged: bool = False


def identity(path: Path) -> str:
    """Give the digest of a ride, or of the ride that a record was made from.

    Raises
    ------
    RecordError
        If there is no record.
    """
    with open_record(path) as record:
        return identity_of(record)


def level_ground(network: Network) -> Network:
    """The same network without grades: what rides for a grade map are smoothed over."""
    unknown = np.full(len(network.east), np.nan, dtype=np.float32)
    unknown.flags.writeable = False
    return replace(network, grade_rad=unknown, grade_std_rad=unknown)


def ride_of(path: Path, level_net: Path) -> Ride | Refused:
    """Read a ride; what is wrong with a record is an answer, for it must not end those of others.

    Parameters
    ----------
    path : Path
        A record, or a folder with the parts of one.
    level_net : Path
        The network without grades, `level_ground`.
    """
    digest = ""
    try:
        with open_record(path) as record:
            digest = identity_of(record)
            return _ride(record, path, digest, level_net)
    except DamagedRecordError as error:
        return Refused(str(path), digest, str(error), damaged=True)
    except (RecordError, ConfigError) as error:
        return Refused(str(path), digest, str(error))


def _ride(record: Record, path: Path, digest: str, level_net: Path) -> Ride:
    network = load(level_net)
    vehicle = _vehicle(record, path)
    why = why_anew(record, vehicle)
    offset_ns = utc_offset_ns(record) or 0
    if why:
        states, level = _smoothed_anew(record, path, vehicle, level_net, why)
    else:
        states, level = _smoothed(record, path)
    if record.damaged:
        raise DamagedRecordError(
            f"{record.damaged}; `tramstream recover` saves the rest", cure="recover it"
        )
    settings = vehicle.map if vehicle is not None and vehicle.map is not None else None
    settings = settings or Map(network=str(level_net))
    path_found = find_path(network, settings, estimates_of(states, level))
    pivot_m = vehicle.ekf.pivot_m if vehicle is not None else 0.0
    places = path_found.places
    passes, way, slope = passes_of(network, cells_of(network), states, places, pivot_m)
    if not len(passes.cell):
        raise RecordError(f"{path}: is on no track of this network for sure; is it this city's?")
    start_ns = int(states.stamp_ns[0]) + offset_ns if offset_ns else 0
    return Ride(
        path.name,
        digest,
        record.vehicle,
        start_ns,
        slope.nod.value,
        slope.nod.std,
        bool(why),
        way.whole,
        way.off_map,
        way.doubtful,
        way.contradicting,
        passes,
    )


def _vehicle(record: Record, path: Path) -> Vehicle | None:
    try:
        return vehicle_of(record, path)
    except ConfigError:
        return None


def why_anew(record: Record, vehicle: Vehicle | None) -> str:
    """Why a ride has to be smoothed from its measurements; empty where it has not."""
    if not holds(record, keys.EST_SMOOTHED.path):
        return f"has no {keys.EST_SMOOTHED.path}"
    told = record.metadata.get(GRADES_ENTRY)
    if told is None and vehicle is not None:
        mapped = vehicle.map is not None and MATCHER in vehicle.processors
        told = None if mapped else NO_GRADES
    if told is None:
        return "does not say to which grades of a map its filter was held"
    if told != NO_GRADES:
        return f"has a filter that was held to the grades {told} of its map"
    return ""


def _smoothed(record: Record, path: Path) -> tuple[StateSeries, LocalLevel]:
    key = keys.EST_SMOOTHED.path
    found = read_ride(record, (key,))
    if found.level is None or key not in found.states:
        raise RecordError(f"{path}: has no {key} that can be read")
    return found.states[key], found.level


def _smoothed_anew(
    record: Record, path: Path, vehicle: Vehicle | None, level_net: Path, why: str
) -> tuple[StateSeries, LocalLevel]:
    """Run the processors over the measurements, held to no grades.

    Raises
    ------
    RecordError
        If the record has no measurements, or no configuration.
    """
    if not holds(record, keys.IMU_BATCH.path):
        raise RecordError(
            f"{path}: {why}, and has no measurements to smooth it from without them; it would "
            "count what the map said already",
            cure="give the record that it was made from",
        )
    if vehicle is None:
        raise RecordError(f"{path}: {why}, and no configuration that it could be smoothed with")
    if vehicle.map is not None:
        level_map = msgspec.structs.replace(vehicle.map, network=str(level_net))
        vehicle = msgspec.structs.replace(vehicle, map=level_map)
    with tempfile.TemporaryDirectory(prefix="tramstream-") as folder:
        out = Path(folder) / "smoothed.mcap"
        done = rerun(path, out, vehicle, fresh=True, smooth=True)
        if done.damaged:
            raise DamagedRecordError(
                f"{done.damaged}; `tramstream recover` saves the rest", cure="recover it"
            )
        with open_record(out) as made:
            return _smoothed(made, path)
