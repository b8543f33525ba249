"""What a report is made of: the series of one ride, read in few passes.

Outputs of `reprocess` lie in a record of their own; inputs and truth are then in its source.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.evaluate.judgement import Terms, terms_of
from tramstream.boundary import Undecodable
from tramstream.clock import S
from tramstream.config import Vehicle, Wheels
from tramstream.estimation.series import (
    Array,
    FixSeries,
    GradeSeries,
    Instants,
    Slot,
    StateSeries,
)
from tramstream.recorder.columns import RideSeries
from tramstream.recorder.describe import Description, describe
from tramstream.recorder.health import HEALTH_TYPES, Health
from tramstream.recorder.reader import Entry, Record

OUTAGE_S = 5.0
"""A longer gap in the valid fixes is an outage, as it is for `evaluate`."""
AWAY = ("SILENT", "LOST")
"""States of a device that gives nothing: without a word, or unplugged. Then"""
AWAY_S = 1.0
"""without a fix for longer is an outage."""
STAND_NS = 3 * S
"""Shorter standstills are not marked as stops."""
STILL_MPS = 0.2
"""Below this a receiver or the wheels are taken to stand, where no filter says so."""
PULSE_SPAN_NS = S // 5
"""Pulses are turned into speeds over so long: one pulse is then 5 mm/s."""
RATE_BIN_S, RATE_BINS = 5.0, 240
"""Least width and most number of the bins that rates are counted in."""


class Level(NamedTuple):
    """A speed that is not a filter's: wheels, distance filter."""

    stamp_ns: Instants
    speed_mps: Array
    std_mps: Array | None = None


class Parameter(NamedTuple):
    """One learned quantity over time."""

    unit: str
    stamp_ns: Instants
    value: Array
    std: Array


class Runs(NamedTuple):
    """Parts of a ride."""

    start_ns: Instants
    end_ns: Instants


@dataclass
class Material:
    """Everything that a page shows, as arrays."""

    description: Description
    """Of the record that was asked for."""
    source: Description | None
    """Of the record that it was reprocessed from, if that is here."""
    ride: RideSeries
    health: Health
    wheels: Level | None
    distance: Level | None
    parameters: dict[str, Parameter]
    utc_offset_ns: int | None
    """UTC minus vehicle clock; None if nobody told."""
    rate_edges_ns: Instants
    rates_hz: dict[str, Array]
    estimate: str
    """Key path of the states."""
    terms: Terms
    start_ns: int
    end_ns: int
    receiver: bool
    """Whether the vehicle has a receiver, plugged in or not."""
    standing: Runs = field(init=False)
    outages: Runs = field(init=False)

    def __post_init__(self) -> None:
        self.standing = self._standing()
        self.outages = self._outages()

    @property
    def states(self) -> StateSeries | None:
        return self.ride.states.get(self.estimate)

    @property
    def smoothed(self) -> StateSeries | None:
        return self.ride.states.get(keys.EST_SMOOTHED.path)

    @property
    def grade(self) -> GradeSeries | None:
        return self.ride.grade

    @property
    def fixes(self) -> FixSeries | None:
        """Valid ones."""
        fixes = self.ride.fixes
        return fixes.take(fixes.valid) if fixes is not None else None

    @property
    def damaged(self) -> str:
        """One sentence, empty if nothing is known to be damaged."""
        source = self.source.damaged if self.source is not None else ""
        return self.description.damaged or source

    @property
    def left_out(self) -> str:
        """One sentence about messages that could not be decoded, empty without any."""
        source = self.source.left_out if self.source is not None else ""
        return "; ".join(filter(None, (self.description.left_out, source)))

    @property
    def speed(self) -> tuple[str, Instants, Array] | None:
        """The best speed there is."""
        if self.states is not None:
            return "filter", self.states.stamp_ns, self.states.speed_mps
        for name, level in (("distance filter", self.distance), ("wheels", self.wheels)):
            if level is not None:
                return name, level.stamp_ns, level.speed_mps
        if self.fixes is not None and len(self.fixes):
            return "GNSS", self.fixes.stamp_ns, self.fixes.speed_mps
        truth = self.ride.truth
        return ("truth", truth.stamp_ns, truth.speed_mps) if truth is not None else None

    def _standing(self) -> Runs:
        if self.states is not None:
            return long_runs(self.states.standing, self.states.stamp_ns, STAND_NS)
        if self.speed is None:
            return Runs(*_nothing())
        _, stamp_ns, speed = self.speed
        return long_runs(np.abs(speed) < STILL_MPS, stamp_ns, STAND_NS)

    def _outages(self) -> Runs:
        """Where no valid fix came, or the receiver was away; none for a vehicle without one."""
        fixes = self.ride.fixes
        if not self.receiver:
            return Runs(*_nothing())
        known = fixes.stamp_ns[fixes.valid] if fixes is not None else _nothing()[0]
        bounds = np.concatenate([[self.start_ns], known, [self.end_ns]]).astype(np.int64)
        gaps = np.diff(bounds)
        silent = gaps > OUTAGE_S * S
        for run in self.health.devices.get(keys.GNSS_FIX.source, ()):
            if run.state in AWAY:
                beside = (bounds[:-1] < run.end_ns) & (bounds[1:] > run.start_ns)
                silent |= beside & (gaps > AWAY_S * S)
        return Runs(bounds[:-1][silent], bounds[1:][silent])


def read_material(
    record: Record,
    source: Record | None,
    ride: RideSeries,
    vehicle: Vehicle | None,
    estimate: str,
) -> Material:
    """Read what `ride` does not hold: health, wheels, parameters, rates.

    Parameters
    ----------
    record : Record
        The one that was asked for.
    source : Record or None
        Where its inputs are, if it was reprocessed.
    ride : RideSeries
        States, truth and fixes of both.
    vehicle : Vehicle or None
        The configuration, if it is known.
    estimate : str
        Key path of the states.
    """
    scan = _Scan(vehicle.wheels if vehicle is not None else Wheels())
    inputs = source if source is not None else record
    of_source = scan.read(source) if source is not None else None
    description = scan.read(record)
    edges_ns = _edges(inputs)
    start_ns, end_ns = _bounds(ride, inputs)
    return Material(
        description=description,
        source=of_source,
        ride=ride,
        health=scan.health,
        wheels=scan.wheels(),
        distance=scan.distance(),
        parameters=scan.parameters(),
        utc_offset_ns=scan.utc_offset_ns(),
        rate_edges_ns=edges_ns,
        rates_hz=scan.rates_hz(edges_ns),
        estimate=estimate,
        terms=terms_of(vehicle, record.start_ns, 0.0, OUTAGE_S),
        start_ns=start_ns,
        end_ns=end_ns,
        receiver=ride.fixes is not None
        or keys.GNSS_FIX.source in scan.health.devices
        or (vehicle is not None and vehicle.gnss is not None),
    )


class _Scan:
    """What one pass over a record leaves: arrivals of all messages, and a few kinds decoded."""

    def __init__(self, wheels: Wheels) -> None:
        self.health = Health()
        self._m_per_pulse = wheels.m_per_pulse
        self._arrivals: dict[str, array[int]] = {}
        self._wheels, self._distance = array("d"), array("d")
        self._wheel_stamps, self._distance_stamps = array("q"), array("q")
        self._parameters: dict[str, tuple[str, list[int], list[float], list[float]]] = {}
        self._utc_offsets_ns: list[int] = []

    def read(self, record: Record) -> Description:
        """Read a record through and describe it."""
        by_path = {
            keys.ODO_WHEELS.path: self._add_wheels,
            keys.EST_DISTANCE.path: self._add_distance,
            keys.EST_PARAMETERS.path: self._add_parameters,
            keys.GNSS_FIX.path: self._add_utc,
        }
        known: dict[str, tuple[Callable[[int], None], Callable[[Any], None] | None]] = {}
        for topic in record.channels:
            path = keys.split(topic)[1]
            key, type_name = keys.find(path), record.type_of(topic)
            take = by_path.get(path)
            if key is None or key.type.DESCRIPTOR.full_name != type_name:
                take = None
            elif type_name in HEALTH_TYPES:
                take = partial(self.health.add, topic)
            known[topic] = (self._arrivals.setdefault(path or topic, array("q")).append, take)

        def see(entry: Entry) -> None:
            arrive, take = known[entry.topic]
            arrive(entry.log_ns)
            if take is not None:
                message = record.decode(entry)
                if not isinstance(message, Undecodable):
                    take(message)

        return describe(record, see)

    def rates_hz(self, edges_ns: Instants) -> dict[str, Array]:
        """Messages a second of every key, by arrival, between neighbouring `edges_ns`."""
        width_s = np.diff(edges_ns) / S
        return {
            path: np.histogram(np.frombuffer(stamps, dtype=np.int64), edges_ns)[0] / width_s
            for path, stamps in sorted(self._arrivals.items())
            if len(stamps)
        }

    def utc_offset_ns(self) -> int | None:
        """UTC minus vehicle clock, by the receiver, else by the host; None if nobody told."""
        if self._utc_offsets_ns:
            return int(np.median(self._utc_offsets_ns))
        return self.health.utc_offset_ns

    def wheels(self) -> Level | None:
        """Mean speed of all wheels, from what the bus says or from pulses."""
        if not self._wheel_stamps:
            return None
        stamp_ns = np.array(self._wheel_stamps, dtype=np.int64)
        speed, pulses = np.array(self._wheels).reshape(-1, 2).T
        counted_m = pulses * self._m_per_pulse
        before = np.searchsorted(stamp_ns, stamp_ns - PULSE_SPAN_NS, side="right") - 1
        before = np.maximum(before, 0)
        dt_s = (stamp_ns - stamp_ns[before]) / S
        with np.errstate(invalid="ignore", divide="ignore"):
            from_pulses = np.where(dt_s > 0, (counted_m - counted_m[before]) / dt_s, np.nan)
        return Level(stamp_ns, np.where(np.isfinite(speed), speed, from_pulses))

    def distance(self) -> Level | None:
        """Speed of the distance filter."""
        if not self._distance_stamps:
            return None
        speed, std = np.array(self._distance).reshape(-1, 2).T
        return Level(np.array(self._distance_stamps, dtype=np.int64), speed, std)

    def parameters(self) -> dict[str, Parameter]:
        """What the filter learned, by name."""
        return {
            name: Parameter(unit, np.array(stamps), np.array(values), np.array(stds))
            for name, (unit, stamps, values, stds) in self._parameters.items()
        }

    def _add_wheels(self, message: Any) -> None:
        told = [wheel.speed_mps for wheel in message.wheels if wheel.HasField("speed_mps")]
        counted = [wheel.pulses for wheel in message.wheels if wheel.HasField("pulses")]
        if told or counted:
            self._wheel_stamps.append(message.stamp_ns)
            self._wheels.append(sum(told) / len(told) if told else np.nan)
            self._wheels.append(sum(counted) / len(counted) if counted else np.nan)

    def _add_distance(self, message: Any) -> None:
        self._distance_stamps.append(message.stamp_ns)
        self._distance.extend((message.speed_mps, message.speed_std_mps))

    def _add_parameters(self, message: Any) -> None:
        for each in message.parameters:
            _, stamps, values, stds = self._parameters.setdefault(
                each.name, (each.unit, [], [], [])
            )
            stamps.append(message.stamp_ns)
            values.append(each.value)
            stds.append(each.std)

    def _add_utc(self, message: Any) -> None:
        if message.valid and message.utc_ns:
            self._utc_offsets_ns.append(message.utc_ns - message.stamp_ns)


def long_runs(mask: NDArray[np.bool_], stamp_ns: Instants, least_ns: int) -> Runs:
    """Where `mask` holds without a break, no shorter than `least_ns`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    first, last = edges[::2], edges[1::2] - 1
    long = stamp_ns[last] - stamp_ns[first] >= least_ns
    return Runs(stamp_ns[first[long]], stamp_ns[last[long]])


def inside(stamp_ns: Instants, runs: Runs) -> NDArray[np.bool_]:
    """Which stamps lie in one of `runs`."""
    index = np.searchsorted(runs.start_ns, stamp_ns, side="right") - 1
    found: NDArray[np.bool_] = np.zeros(len(stamp_ns), dtype=bool)
    if len(runs.start_ns):
        found = (index >= 0) & (stamp_ns <= runs.end_ns[index])
    return found


def std_of(states: StateSeries, slot: Slot) -> Array:
    """Stated standard deviation; NaN where the state has no covariance."""
    with np.errstate(invalid="ignore"):
        std: Array = np.sqrt(states.covariance[:, slot, slot])
    return std


def _nothing() -> tuple[Instants, Instants]:
    return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)


def _bounds(ride: RideSeries, inputs: Record) -> tuple[int, int]:
    """First and last instant of the ride, by stamps and by arrivals."""
    series: Sequence[Any] = [*ride.states.values(), ride.truth, ride.fixes]
    stamps = [each.stamp_ns[[0, -1]] for each in series if each is not None and len(each)]
    starts, ends = [inputs.start_ns], [inputs.end_ns]
    for first, last in stamps:
        starts.append(int(first))
        ends.append(int(last))
    return min(starts), max(ends)


def _edges(record: Record) -> Instants:
    """Of the bins that rates are counted in."""
    end_ns = max(record.end_ns, record.start_ns + S)
    length_ns = end_ns - record.start_ns
    bins = int(min(max(length_ns / S / RATE_BIN_S, 1), RATE_BINS))
    # Whole numbers: a record may begin in 1970 and end in 2262, where floats run over.
    edges = [record.start_ns + length_ns * number // bins for number in range(bins + 1)]
    return np.array(edges, dtype=np.int64)
