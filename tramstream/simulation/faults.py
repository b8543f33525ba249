"""Faults of sensors as stages over messages: what a sensor said goes in, what is recorded comes
out.

A fault is a value (`simulation.event_kinds.Fault`) with a begin and an end. Its stage changes the
messages of one sensor between the two and lets all others through as they are, the same objects.
It knows nothing of the simulation, so that it can be laid over a recording as well. An instant is
that of the stamp; of a batch, that of each sample.

Samples that a logger has drawn straight over a gap are known once the gap has ended: until then
their batches are held back. When they are published does not change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.clock import S
from tramstream.keys import Key
from tramstream.mounting import matrix_of
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import ImuBatch, Odometry
from tramstream.simulation.event_kinds import (
    AXES,
    Axis,
    ClockOff,
    Fault,
    GnssFrozen,
    GnssHold,
    GnssJammed,
    GnssRateLost,
    GnssStated,
    ImuDead,
    ImuLost,
    ImuMoved,
    ImuSaturated,
    ImuStuck,
    WheelsFrozen,
)
from tramstream.simulation.fault_stage import Stage, Timed, copied
from tramstream.simulation.fix_faults import Jammed, Kept, Repeated, Stated

__all__ = ["Timed", "faulted"]

KEYS: dict[str, Key] = {"imu": keys.IMU_BATCH, "gnss": keys.GNSS_FIX, "wheels": keys.ODO_WHEELS}


def faulted(samples: Iterable[Sample], faults: Iterable[Timed]) -> Iterator[Sample]:
    """Lay faults over samples, one after another in the order given."""
    for timed in faults:
        samples = _through(_STAGES[type(timed.fault)](timed), samples)
    return iter(samples)


def _through(stage: Stage, samples: Iterable[Sample]) -> Iterator[Sample]:
    for sample in samples:
        yield from stage.step(sample)
    yield from stage.end()


# The inertial sensor ------------------------------------------------------------------------------
def _instants_ns(batch: ImuBatch) -> list[int]:
    """When each sample of a batch was taken."""
    return [batch.stamp_ns + round(row * batch.period_ns) for row in range(len(batch.gyro_x))]


class _Axes(Stage):
    """Axes that read something else."""

    key = keys.IMU_BATCH

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        fault = timed.fault
        assert isinstance(fault, ImuStuck | ImuDead | ImuSaturated)
        self._axes: tuple[Axis, ...] = fault.axes
        self._instead: dict[Axis, int] = {}
        """What an axis reads; of stuck ones what they read last."""
        self._stuck = isinstance(fault, ImuStuck)
        if isinstance(fault, ImuDead):
            self._instead = dict.fromkeys(fault.axes, 0)
        elif isinstance(fault, ImuSaturated):
            self._instead = dict.fromkeys(fault.axes, fault.counts)

    def _take(self, sample: Sample) -> list[Sample]:
        batch: ImuBatch = sample.message
        wrong = [self.timed.lasts(each) for each in _instants_ns(batch)]
        if not any(wrong):
            if self._stuck and batch.stamp_ns < self.timed.start_ns:
                self._instead = {axis: getattr(batch, axis)[-1] for axis in self._axes}
            return [sample]
        changed = copied(batch)
        for axis in self._axes:
            column = getattr(changed, axis)
            for row, is_wrong in enumerate(wrong):
                if is_wrong:
                    column[row] = self._instead.setdefault(axis, column[row])
                elif self._stuck and _before(self.timed, batch, row):
                    self._instead[axis] = column[row]
        return [sample._replace(message=changed)]


def _before(timed: Timed, batch: ImuBatch, row: int) -> bool:
    return batch.stamp_ns + round(row * batch.period_ns) < timed.start_ns


class _Turned(Stage):
    """A case that was turned: what it reads is turned the other way, and rounded again."""

    key = keys.IMU_BATCH

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        assert isinstance(timed.fault, ImuMoved)
        turn = np.radians(timed.fault.turned_deg)
        half = 0.5 * float(np.linalg.norm(turn))
        x, y, z = (turn * (0.5 * np.sinc(half / np.pi))).tolist()
        self._turn: NDArray[np.float64] = np.array(matrix_of((np.cos(half), x, y, z))).T

    def _take(self, sample: Sample) -> list[Sample]:
        batch: ImuBatch = sample.message
        wrong = np.array([self.timed.lasts(each) for each in _instants_ns(batch)])
        if not wrong.any():
            return [sample]
        changed = copied(batch)
        for axes in (AXES[:3], AXES[3:]):
            counts = np.array([getattr(batch, axis) for axis in axes])
            counts[:, wrong] = np.rint(self._turn @ counts[:, wrong]).astype(int)
            for axis, column in zip(axes, counts.tolist(), strict=True):
                changed.ClearField(axis)
                getattr(changed, axis).extend(column)
        return [sample._replace(message=changed)]


class _Lost(Stage):
    """Inertial samples that are lost, or drawn straight between what is left.

    A gap within one batch takes the rest of the batch with it: what is behind it has no number.
    """

    key = keys.IMU_BATCH

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        assert isinstance(timed.fault, ImuLost)
        self._straight = timed.fault.straight
        self._held: list[tuple[Sample, list[bool]]] = []
        self._last: dict[Axis, int] | None = None
        """Readings before the gap."""

    def _take(self, sample: Sample) -> list[Sample]:
        batch: ImuBatch = sample.message
        wrong = [self.timed.lasts(each) for each in _instants_ns(batch)]
        if not self._straight:
            return self._without(sample, wrong)
        if wrong and wrong[-1]:
            self._held.append((sample, wrong))
            return []
        if self._held or any(wrong):
            first = wrong.index(False, wrong.index(True)) if any(wrong) else 0
            after = {axis: int(getattr(batch, axis)[first]) for axis in AXES}
            drawn = self._drawn([*self._held, (sample, wrong)], after)
            self._held = []
            return drawn
        self._last = {axis: getattr(batch, axis)[-1] for axis in AXES}
        return [sample]

    def end(self) -> list[Sample]:
        """Give what a gap without an end has held back: the line stays level."""
        held, self._held = self._held, []
        return self._drawn(held, None) if held else []

    def _without(self, sample: Sample, wrong: list[bool]) -> list[Sample]:
        """Give what is left: batches hold no gap."""
        if not any(wrong):
            return [sample]
        parts, begin = [], 0
        for row in range(1, len(wrong) + 1):
            if row == len(wrong) or wrong[row] != wrong[begin]:
                if not wrong[begin]:
                    parts.append(_part(sample, begin, row))
                begin = row
        return parts[:1]

    def _drawn(
        self, held: list[tuple[Sample, list[bool]]], after: dict[Axis, int] | None
    ) -> list[Sample]:
        """Straight lines from the reading before the gap to the one behind it."""
        before = self._last or after or {}
        first, wrong_first = held[0]
        if not wrong_first[0] and any(wrong_first):  # the gap begins within this batch
            row = wrong_first.index(True) - 1
            before = {axis: int(getattr(first.message, axis)[row]) for axis in AXES}
        total = sum(sum(wrong) for _, wrong in held)
        number, made = 0, []
        for sample, wrong in held:
            changed = copied(sample.message)
            for row, is_wrong in enumerate(wrong):
                if is_wrong:
                    number += 1
                    share = number / (total + 1)
                    for axis in AXES:
                        end = before[axis] if after is None else after[axis]
                        drawn = before[axis] + share * (end - before[axis])
                        getattr(changed, axis)[row] = round(drawn)
            made.append(sample._replace(message=changed))
        self._last = {axis: getattr(made[-1].message, axis)[-1] for axis in AXES}
        return made


def _part(sample: Sample, begin: int, end: int) -> Sample:
    """Rows of a batch as one of their own."""
    part = copied(sample.message)
    for axis in AXES:
        column = getattr(part, axis)[begin:end]
        part.ClearField(axis)
        getattr(part, axis).extend(column)
    part.first_sample_sequence += begin
    part.stamp_ns += round(begin * part.period_ns)
    return sample._replace(message=part, stamp_ns=part.stamp_ns)


# Wheels -------------------------------------------------------------------------------------------
class _Frozen(Stage):
    """Counts that stay, or go on as before."""

    key = keys.ODO_WHEELS

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        fault = timed.fault
        assert isinstance(fault, WheelsFrozen)
        self._wheels = fault.wheels
        self._goes_on = fault.holds == "speed"
        self._true: dict[str, int] = {}
        """What each wheel has truly counted so far,"""
        self._step: dict[str, int] = {}
        """by how much with the last reading before the fault,"""
        self._missing: dict[str, int] = {}
        """and by how much what is said is behind that."""

    def _take(self, sample: Sample) -> list[Sample]:
        odometry: Odometry = sample.message
        lasts = self.timed.lasts(sample.stamp_ns)
        for reading in odometry.wheels:
            if reading.wheel in self._wheels:
                self._count(reading.wheel, reading.pulses, lasts)
        if not any(self._missing.values()):
            return [sample]
        changed = copied(odometry)
        for reading in changed.wheels:
            reading.pulses -= self._missing.get(reading.wheel, 0)
        return [sample._replace(message=changed)]

    def _count(self, wheel: str, pulses: int, lasts: bool) -> None:
        counted = pulses - self._true.get(wheel, 0)
        self._true[wheel] = pulses
        if lasts:
            said = self._step.get(wheel, 0) if self._goes_on else 0
            self._missing[wheel] = self._missing.get(wheel, 0) + counted - said
        elif wheel not in self._missing:
            self._step[wheel] = counted


# Clocks -------------------------------------------------------------------------------------------
class _Clock(Stage):
    """Stamps that are off; nothing is published before its stamp."""

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        fault = timed.fault
        assert isinstance(fault, ClockOff)
        self.key = KEYS[fault.sensor]
        self._offset_ns = round(fault.offset_s * S)
        self._last_ns = 0

    def _take(self, sample: Sample) -> list[Sample]:
        made = sample
        if self.timed.lasts(sample.stamp_ns):
            changed = copied(sample.message)
            changed.stamp_ns += self._offset_ns
            made = sample._replace(message=changed, stamp_ns=changed.stamp_ns)
        publish_ns = max(made.publish_ns, made.stamp_ns, self._last_ns + 1)
        self._last_ns = publish_ns
        return [made if publish_ns == made.publish_ns else made._replace(publish_ns=publish_ns)]


_STAGES: dict[type[Fault], Callable[[Timed], Stage]] = {
    ImuStuck: _Axes,
    ImuDead: _Axes,
    ImuSaturated: _Axes,
    ImuMoved: _Turned,
    ImuLost: _Lost,
    GnssFrozen: Repeated,
    GnssHold: Repeated,
    GnssStated: Stated,
    GnssRateLost: Kept,
    GnssJammed: Jammed,
    WheelsFrozen: _Frozen,
    ClockOff: _Clock,
}
