"""What `tramstream map match` matches: the states of a record, or a trace of a phone or tracker."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate.source import holds, vehicle_in
from tramstream.clock import S
from tramstream.config import Map
from tramstream.errors import RecordError
from tramstream.estimation.localiser import Estimate, values_of
from tramstream.estimation.series import Instants, StateSeries
from tramstream.geodesy import LocalLevel
from tramstream.lines import traces
from tramstream.processors.matching.matcher import FORGET_S, TRACE_FORGET_S
from tramstream.processors.matching.offline import Path as MatchedPath
from tramstream.processors.matching.offline import find_path, trace_estimates
from tramstream.processors.matching.source import SATELLITES, TRACK
from tramstream.recorder.columns import read_ride
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import rerun
from tramstream.tracks.network import Array, Network

STATE_HZ = 10.0
"""So many states a second are matched: a tram moves 2 m in between at most."""
_UNKNOWN_STD_M = 10.0
"""Of states without a covariance."""


_RADIUS_STDS = 1.515
"""Loggers state the radius that holds 68 % of their errors; it is so many deviations per axis."""


class Source(NamedTuple):
    """A ride to match."""

    stamp_ns: Instants
    plan: Array
    """East, north in the network's plan, m, shape (n, 2); what the ride was seen as."""
    utc_offset_ns: int | None
    """UTC minus the stamps; None if that is not known."""
    path: MatchedPath
    kind: str
    """What was matched, for people."""
    notes: tuple[str, ...]

    def time(self, stamp_ns: int) -> str:
        """A stamp for people: UTC, or seconds since the beginning."""
        if self.utc_offset_ns is None:
            return f"{(stamp_ns - int(self.stamp_ns[0])) / S:.1f} s"
        instant = datetime.fromtimestamp((stamp_ns + self.utc_offset_ns) / S, UTC)
        return f"{instant:%Y-%m-%d %H:%M:%S}"


def match(file: Path, network: Network, net: Path, say: Callable[[str], None]) -> Source:
    """Match a record, or a folder of one, or a trace.

    Raises
    ------
    ConfigError, RecordError
        If the file cannot be read, or holds neither states nor what makes them.
    """
    if file.is_dir() or file.suffix == ".mcap":
        return _of_record(file, network, net, say)
    return _of_trace(file, network, net)


def _of_trace(file: Path, network: Network, net: Path) -> Source:
    trace = traces.read(file)
    geodetic = np.column_stack([trace.latitude_rad, trace.longitude_rad])
    std_m = trace.accuracy_m / _RADIUS_STDS
    estimates = trace_estimates(trace.stamp_ns, geodetic, std_m)
    path = find_path(network, Map(network=str(net)), estimates, TRACE_FORGET_S)
    plan = network.plan_of(geodetic)
    offset_ns = 0 if trace.timed else None
    kind = f"trace of {len(plan)} points"
    return Source(trace.stamp_ns, plan, offset_ns, path, kind, trace.notes)


def _of_record(file: Path, network: Network, net: Path, say: Callable[[str], None]) -> Source:
    notes: list[str] = []
    with open_record(file) as record:
        vehicle, offset_ns = vehicle_in(record, say), utc_offset_ns(record)
        found = _states(record)
        if found is None and vehicle is None:
            return _of_fixes(record, network, net, offset_ns)
        if record.damaged:
            notes.append(f"{record.damaged}; `tramstream recover` saves the rest.")
        if record.left_out:
            notes.append(f"{record.left_out}.")
    if found is None:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "states.mcap"
            rerun(file, out, None)
            with open_record(out) as record:
                found = _states(record)
        notes.append("The record has no states; they were made anew from its raw messages.")
    if found is None:
        raise RecordError(
            f"{file}: has no {keys.EST_STATE.path}, and none can be made of it; match a record of "
            "`tramstream run` or `reprocess`"
        )
    states, level = found
    of_vehicle = vehicle.map if vehicle is not None else None
    settings = of_vehicle or Map(network=str(net))
    forget_s = TRACE_FORGET_S if _alone(states) else FORGET_S
    path = find_path(network, settings, estimates_of(states, level), forget_s)
    plan = network.plan_of(states.geodetic)
    kind = f"{keys.EST_STATE.path}, {len(states)} states"
    return Source(states.stamp_ns, plan, offset_ns, path, kind, tuple(notes))


def _alone(states: StateSeries) -> bool:
    """Whether the states are of a filter that took nothing but fixes and the track."""
    names = states.innovations.names
    others = [name for name in names if not name.startswith((SATELLITES, TRACK))]
    return bool(names) and not others


def _of_fixes(record: Record, network: Network, net: Path, offset_ns: int | None) -> Source:
    """Of a record without a configuration: its fixes are a trace."""
    ride = read_ride(record, fixes=True) if holds(record, keys.GNSS_FIX.path) else None
    fixes = ride.fixes if ride is not None else None
    usable = fixes.take(np.flatnonzero(fixes.valid)) if fixes is not None else None
    if ride is None or ride.level is None or usable is None or len(usable) < 2:
        raise RecordError(
            f"{record.paths[0]}: has neither {keys.EST_STATE.path} nor fixes; match a record of "
            "`tramstream run` or `reprocess`, or of a receiver at least"
        )
    geodetic = ride.level.to_geodetic(usable.p_l)[:, :2]
    unknown = np.full(len(usable), np.nan)
    estimates = trace_estimates(usable.stamp_ns, geodetic, unknown)
    path = find_path(network, Map(network=str(net)), estimates, TRACE_FORGET_S)
    kind = f"{keys.GNSS_FIX.path}, {len(usable)} fixes"
    notes = ("The record has no states and no configuration: its fixes were matched.",)
    return Source(usable.stamp_ns, network.plan_of(geodetic), offset_ns, path, kind, notes)


def _states(record: Record) -> tuple[StateSeries, LocalLevel] | None:
    """States of a record, thinned to `STATE_HZ`, and their frame; None if it has none."""
    key = keys.EST_STATE.path
    if not holds(record, key):
        return None
    ride = read_ride(record, (key,))
    if ride.level is None or key not in ride.states:
        return None
    states = ride.states[key]
    slot = (states.stamp_ns - states.stamp_ns[0]) // round(S / STATE_HZ)
    return states.take(np.flatnonzero(np.diff(slot, prepend=-1))), ride.level


def estimates_of(states: StateSeries, level: LocalLevel) -> Iterator[tuple[Estimate, LocalLevel]]:
    """Give states as a matcher takes them, each with the frame of its position."""
    usual = np.diag([_UNKNOWN_STD_M**2] * 2 + [1.0] * 5)
    for k in range(len(states)):
        covariance = states.covariance[k]
        if not math.isfinite(float(covariance.sum())):
            covariance = usual
        motion = (*states.p_l[k], states.speed_mps[k], *states.attitude_rad[k])
        acceleration, yaw_rate = states.acceleration_mps2[k], states.yaw_rate_radps[k]
        values = values_of(motion, covariance, float(acceleration), float(yaw_rate))
        standing = bool(states.standing[k])
        yield Estimate(int(states.stamp_ns[k]), int(states.mode[k]), values, standing), level


def utc_offset_ns(record: Record) -> int | None:
    """UTC minus vehicle clock, as the record tells first."""
    for _, reference in record.decoded(lambda topic: keys.split(topic)[1] == keys.CLOCK.path):
        return int(reference.host_utc_ns - reference.stamp_ns)
    return None
